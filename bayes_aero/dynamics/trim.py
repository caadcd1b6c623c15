"""Trim of any model, found from its own coefficients: level flight, its airspeed, and the control that pitches."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from bayes_aero.dynamics.aircraft import HELD, RigidBody
from bayes_aero.dynamics.flight import AircraftDynamics, Dynamics, LinearDynamics, Values
from bayes_aero.effect import Effect, Stage
from bayes_aero.errors import InputError
from bayes_aero.model import observations as observations
from bayes_aero.model.model import Model
from bayes_aero.physics.aircraft import GRAVITY, Aircraft, Axis, air
from bayes_aero.physics.coefficients import moments, specific_force
from bayes_aero.physics.kinematics import RATES
from bayes_aero.processes import compiled_at

CONTROLS = ("elevator", "stabilizer")  # of the pitching moment; the pilot uses the first one with an effect
SIGNALS = frozenset((  # signals that effects may read in the simulation; there is no canard
    "time", "alpha", "alpha_dot", "airspeed", "altitude", "p", "q", "r", "phi", "theta", "beta", "elevator",
    "stabilizer", "rudder", "spoiler_left", "spoiler_right", "dlc_left", "dlc_right", "flap", "mach", "density",
    "thrust",
))  # fmt: skip


def can_simulate(effect: Effect, signals: frozenset[str] = SIGNALS) -> bool:
    """Whether the simulation has all channels of an effect."""
    return effect.stage <= Stage.AIRCRAFT or signals.issuperset(effect.channels)


def refuse_unsimulated(effect: Effect, signals: frozenset[str] = SIGNALS) -> None:
    """Raise `InputError` for an effect with channels that the simulation lacks."""
    if not can_simulate(effect, signals):
        lacks = ", ".join(channel for channel in effect.channels if channel not in signals)
        raise InputError(f"the simulated aircraft cannot fly effect {effect.name}: it has no {lacks}; ask for another")


GRID = np.deg2rad(np.linspace(-4.0, 20.0, 97))  # alpha tried for trim
TRAVEL = 0.2  # rad either side of the pilot's command over which the pitch acceleration is taken as linear


class Trim(NamedTuple):
    """Level flight: angle of attack in rad, thrust in N, the pilot's command beyond that of attached flow in rad."""

    alpha: float
    thrust: float
    command: float


def at_rest(alpha: Any, airspeed: Any, altitude: Any) -> dict[str, Any]:
    """Signals of steady flight without rates, thrust, sideslip or deflections, each of the shape of `alpha`."""
    zero = jnp.zeros_like(alpha)
    density, sound = air(zero + altitude)
    rest = dict.fromkeys((*SIGNALS, "aileron"), zero) | {"alpha": alpha, "theta": alpha, "airspeed": zero + airspeed}
    return rest | {"altitude": zero + altitude, "mach": airspeed / sound, "density": density}


def lead(
    model: Model, values: Values, aircraft: Aircraft, alpha: Float[Array, "*n"], airspeed: Any, altitude: Any
) -> tuple[Float[Array, " 2"], Float[Array, "*n"]]:
    """How a model is led along `alpha` (rad): the share of the command in each of `CONTROLS`, and the command. It is
    led by the first control that pitches it; a command of 0 where none does, a positive one pitches down. It balances
    the pitching moment of attached flow by one Newton step from zero: what that leaves is for feedback and trim."""
    rest = at_rest(jnp.asarray(0.0), airspeed, altitude)

    def moment(deflections):
        signals = rest | dict(zip(CONTROLS, deflections, strict=True))
        return model.flow(values, signals, aircraft, X=jnp.asarray(1.0))["Cm"]

    slopes = jax.jacfwd(moment)(jnp.zeros(len(CONTROLS)))
    works = slopes != 0.0
    first = jnp.where(jnp.any(works), works & (jnp.cumsum(works) == 1), jnp.arange(len(CONTROLS)) == 0)
    effectiveness = jnp.sum(first * jnp.abs(slopes))
    Cm = model.attached(values, at_rest(alpha, airspeed, altitude), aircraft)["Cm"]
    command = jnp.where(effectiveness > 0.0, Cm / jnp.where(effectiveness > 0.0, effectiveness, 1.0), 0.0)
    return jnp.where(first, jnp.where(slopes > 0.0, -1.0, 1.0), 0.0), command


def level_speed(
    model: Model, values: Values, aircraft: Aircraft, alpha: float, altitude: float, mach: float | None = None
) -> float:
    """Airspeed at which the attached lift carries the weight, controls at rest, m/s; `mach` given is not adjusted."""
    numbers = {name: float(x) for name, x in values.items()}
    density = float(air(jnp.asarray(altitude))[0])
    area, speed = float(aircraft.wing_area), 60.0
    for _ in range(20):
        signals = {name: np.asarray(x) for name, x in at_rest(jnp.asarray(alpha), speed, altitude).items()}
        signals |= {} if mach is None else {"mach": np.asarray(mach)}
        CL = float(model.attached(numbers, signals, aircraft)["CL_attached"])
        speed = float(np.sqrt(2.0 * float(aircraft.mass) * GRAVITY / (density * area * CL)))
    return speed


def trimmed(model: Model, values: Values, aircraft: Aircraft, airspeed: float, altitude: float) -> Trim:
    """Level flight at `airspeed` in m/s and `altitude` in m."""
    values = {name: jnp.asarray(x, float) for name, x in values.items()}
    pressure = 0.5 * float(air(jnp.asarray(altitude))[0]) * airspeed**2 * aircraft.wing_area
    weight, nothing = float(aircraft.mass) * GRAVITY, np.zeros_like(GRID)
    CL, CD, _ = _balance(model, values, aircraft, airspeed, altitude, GRID, nothing, nothing)
    lift = pressure * (np.asarray(CL) + np.asarray(CD) * np.tan(GRID))
    enough = np.flatnonzero(lift >= weight)
    if not len(enough) or enough[0] == 0:
        raise InputError(f"level flight at {airspeed:.0f} m/s and {altitude:.0f} m needs no angle of attack in range")
    i = int(enough[0])
    alpha = float(np.interp(weight, lift[i - 1 : i + 1], GRID[i - 1 : i + 1]))
    thrust = pressure * float(np.interp(alpha, GRID, np.asarray(CD))) / np.cos(alpha)
    tried = np.linspace(-TRAVEL, TRAVEL, len(GRID))
    moment = np.asarray(
        _balance(model, values, aircraft, airspeed, altitude, alpha + nothing, thrust + nothing, tried)[2]
    )
    if np.ptp(moment) == 0.0:
        raise InputError(f"the model cannot be trimmed: neither {' nor '.join(CONTROLS)} pitches it")
    slope, offset = np.polyfit(tried, moment, 1)
    return Trim(alpha, float(thrust), float(-offset / slope))


@compiled_at(0)
def _balance(model: Model, values: Any, aircraft: Aircraft, airspeed: Any, altitude: Any, *rows: Any):
    alpha, thrust, further = (jnp.asarray(row) for row in rows)
    shares, command = lead(model, values, aircraft, alpha, airspeed, altitude)
    controls = {name: share * (command + further) for name, share in zip(CONTROLS, shares, strict=True)}
    s = at_rest(alpha, airspeed, altitude) | {"thrust": thrust} | controls
    static = model.static_separation(values, s, aircraft)
    flow = model.flow(values, s, aircraft, X=jnp.where(model.lag(values) > 0.0, 1.0, static))
    pressure = 0.5 * s["density"] * jnp.square(s["airspeed"])
    fx, fz = specific_force(flow["CL"], flow["CD"], alpha, pressure, thrust, aircraft)
    pitching = moments(flow, (fx, jnp.zeros_like(fx), fz), s, aircraft)[1]
    return flow["CL"], flow["CD"], pitching / aircraft.Iy


# --- Steady straight level flight in six degrees of freedom, with sideslip or without.

MAX_ITERATIONS, MAX_STEP = 60, 0.1  # of Newton's method; rad, or shares of the weight
TOLERANCE = 1e-9  # m/s2, rad/s2
ANGLES = ("alpha", "theta", "phi")
ANGLE_LIMITS = np.array([0.6, 1.4, 1.4])  # rad, either side of zero
MAX_DEFLECTION = 1.0  # rad, of a control
SURFACES = ("spoiler_left", "spoiler_right", "dlc_left", "dlc_right", "flap", "time")  # zero in trim


class Condition(NamedTuple):
    """Straight level flight in SI; the bank that holds the sideslip follows."""

    airspeed: Any
    altitude: Any
    sideslip: Any = 0.0


@dataclass(frozen=True)
class RigidTrim:
    """State of steady flight by channel, SI; its controls, rad; thrust of all engines, N."""

    state: Mapping[str, float]
    controls: Mapping[str, float]
    thrust: float


def control_signs(model: Model, values: Values, aircraft: Aircraft, airspeed: float) -> dict[str, tuple[str, float]]:
    """For each moment coefficient the first control with an effect on it, and the sign of the effect."""
    rest = {n: jnp.zeros(()) for n in (*SIGNALS, *CONTROLS, "aileron", "rudder", "alpha_dot")}
    rest |= {"airspeed": jnp.asarray(airspeed), "density": jnp.ones(()), "mach": jnp.asarray(0.3)}
    tried = {"Cm": CONTROLS, "Cl": ("aileron",), "Cn": ("rudder",)}

    def moments_of(deflections):
        flow = model.flow(values, rest | deflections, aircraft, X=jnp.ones(()))
        return {name: flow[name] for name in tried}

    slopes = jax.jacfwd(moments_of)({n: jnp.zeros(()) for n in (*CONTROLS, "aileron", "rudder")})
    working = {name: [n for n in controls if float(slopes[name][n]) != 0.0] for name, controls in tried.items()}
    return {name: (n[0], float(np.sign(slopes[name][n[0]]))) for name, n in working.items() if n}


def rigid_trim(model: Model, values: Values, aircraft: Aircraft, condition: Condition) -> RigidTrim:
    """Angles, thrust and controls of steady flight: Newton's method on the accelerations and the climb."""
    values = {name: jnp.asarray(x, float) for name, x in values.items()}
    controls = tuple(name for name, _ in control_signs(model, values, aircraft, condition.airspeed).values())
    body = RigidBody(model, values, aircraft)
    given = Condition(*(jnp.asarray(x, float) for x in condition))  # arrays: one program for every condition
    unknown = np.array([0.08, 0.08, 0.0, 0.1] + [0.0] * len(controls))
    for _ in range(MAX_ITERATIONS):
        imbalance, slope = map(np.asarray, _linear(body, given, controls, jnp.asarray(unknown)))
        if not (np.all(np.isfinite(imbalance)) and np.all(np.isfinite(slope))):
            break
        if np.max(np.abs(imbalance)) < TOLERANCE:
            angles, deflections = unknown[:3], unknown[4:]
            if np.any(np.abs(angles) >= ANGLE_LIMITS) or np.any(np.abs(deflections) > MAX_DEFLECTION):
                break
            state = dict(zip(ANGLES, map(float, angles), strict=True)) | {"beta": condition.sideslip}
            state |= {"airspeed": condition.airspeed, "altitude": condition.altitude, "psi": 0.0}
            thrust = float(unknown[3]) * float(aircraft.mass) * GRAVITY
            return RigidTrim(
                state | dict.fromkeys(RATES, 0.0), dict(zip(controls, map(float, deflections), strict=True)), thrust
            )
        step = -np.linalg.lstsq(slope, imbalance, rcond=1e-12)[0]
        unknown = unknown + step * min(1.0, MAX_STEP / max(np.max(np.abs(step)), 1e-12))
    sideslip = f" with sideslip {np.degrees(condition.sideslip):.3g} deg" if condition.sideslip else ""
    raise InputError(
        f"there is no steady flight at {condition.airspeed:.0f} m/s and {condition.altitude:.0f} m{sideslip} that "
        f"{', '.join(controls) or 'no control'} can hold; change the speed or add a control to the model"
    )


@compiled_at(0)
def _linear(body: RigidBody, given: Condition, controls: tuple[str, ...], unknown: Float[Array, " k"]):
    """Accelerations and climb that are not balanced, and their derivative by the unknowns."""

    def imbalance(z):
        s = {"airspeed": given.airspeed, "altitude": given.altitude, "beta": given.sideslip}
        s |= dict(zip(ANGLES, z[:3], strict=True))
        thrust = z[3] * body.aircraft.mass * GRAVITY
        u = {n: jnp.zeros_like(z[0]) for n in (*CONTROLS, "aileron", "rudder", *SURFACES)}
        u |= dict(zip(controls, z[4:], strict=True))
        u |= {"thrust": thrust, "thrust_left": 0.5 * thrust, "thrust_right": 0.5 * thrust}
        x = jnp.stack([jnp.asarray(s.get(name, 0.0), float) for name in body.start])
        state = body.state_at_start(body.complete_start(x, u))
        rates = dict(zip(body.states, body.motion(state, u)[0], strict=True))
        climb = rates["altitude"] / given.airspeed
        return jnp.stack([*(rates[name] for name in ("airspeed", "alpha", "beta", "p", "q", "r")), climb])

    return imbalance(unknown), jax.jacfwd(imbalance)(unknown)


# --- Steady flow: lift, drag and separation of a model at constant angle of attack.

NEAR_STALL = 0.1  # share of the samples, those with the largest lift, that represent the conditions at the stall
STEADY = ("alpha_dot", "beta_dot", "p", "q", "r", "p_dot", "q_dot", "r_dot")


def conditions(signals: Mapping[str, Any]) -> dict[str, float]:
    """One value of every signal (SI): its median over the tenth of the samples with the largest lift; rates are zero.
    Lift and not angle of attack, because in a deep stall the elevator differs from that at the largest lift. Without an
    accelerometer the angle of attack is used."""
    alpha = np.asarray(signals["alpha"])
    lift = alpha
    if {"az", "density", "airspeed"} <= set(signals):
        lift = -np.asarray(signals["az"]) / (np.asarray(signals["density"]) * np.asarray(signals["airspeed"]) ** 2)
    high = lift >= np.quantile(lift, 1.0 - NEAR_STALL)
    arrays = {name: np.asarray(x) for name, x in signals.items()}
    alike = {name: x for name, x in arrays.items() if x.shape == alpha.shape and x.dtype.kind == "f"}
    return {name: float(np.median(x[high])) for name, x in alike.items()} | dict.fromkeys(STEADY, 0.0)


def steady_flow(
    model: Model,
    theta: Float[Array, " k"],
    alpha: Float[Array, " g"],
    alpha_dot: Float[Array, ""],
    reference: Mapping[str, Any],
    aircraft: Aircraft,
) -> dict[str, Float[Array, " g"]]:
    """X, CL, CD, Cm over `alpha` (rad), all other signals at `reference`; separation without lag. `alpha_dot` (rad/s)
    other than zero gives the quasi-steady flow of a model with hysteresis."""
    signals = {name: jnp.full_like(alpha, value) for name, value in reference.items()}
    signals |= {"alpha": alpha, "alpha_dot": jnp.full_like(alpha, alpha_dot)}
    values = model.values(theta)
    X = model.static_separation(values, signals, aircraft)
    flow = model.flow(values, signals, aircraft, X)
    return {name: flow[name] for name in ("X", "CL", "CD", "Cm")}


# --- Modes of motion about steady flight with fixed controls: eigenvalues of the linearised equations of motion.
# Source: Etkin and Reid, *Dynamics of Flight*, 3rd ed. 1996, ch. 6.

LATERAL = ("beta", "p", "r", "phi")
SPEEDS, HEAVES = ("airspeed", "u"), ("alpha", "w")  # u and w of cards with velocities in body axes, m/s
LONGITUDINAL = (*SPEEDS, *HEAVES, "q", "theta")
WITHOUT_FORCE = ("psi", "altitude")  # no force depends on psi, and hardly any on altitude

SHORT_PERIOD, PHUGOID, DUTCH_ROLL, ROLL, SPIRAL, OTHER = (
    "short period", "phugoid", "Dutch roll", "roll", "spiral", "other",
)  # fmt: skip


@dataclass(frozen=True)
class MotionMode:
    """A mode by name, with its eigenvalue (1/s), the one of positive imaginary part of a pair."""

    name: str
    eigenvalue: complex


@dataclass(frozen=True)
class Steady:
    """Straight level flight, SI; alpha is for cards without the longitudinal axis, which have no trim."""

    airspeed: float
    altitude: float
    alpha: float = 0.0


def modes(dynamics: Dynamics, values: Mapping[str, Any], aircraft: Aircraft, steady: Steady) -> tuple[MotionMode, ...]:
    """Modes of motion about steady flight with fixed controls, longitudinal ones first, the faster ones first."""
    if isinstance(dynamics, LinearDynamics):
        system, states = dynamics.system(values, aircraft), dynamics.states
        A = np.asarray(system.matrix)[: len(states), : len(states)]
        return named_modes(A, states, steady.airspeed)
    if not isinstance(dynamics, AircraftDynamics):
        raise InputError("a flight path of recorded accelerations has no modes of motion; fly a model of the aircraft")
    held = set(dynamics.held) - {"altitude", "psi"}
    if held:
        raise InputError(f"the card holds {', '.join(sorted(held))} to the record; leave [fly] held out for modes")
    model, axes = dynamics.model, set(dynamics.model.axes)
    values = {name: jnp.asarray(x, float) for name, x in values.items()}
    actual = model.actual_aircraft(values, aircraft)
    prescribed = HELD[Axis.LONGITUDINAL] if Axis.LONGITUDINAL not in axes else ()
    wider = model if prescribed else replace(model, axes=tuple(Axis))
    u = dict.fromkeys((*CONTROLS, "aileron", "rudder", *SURFACES), 0.0)
    if prescribed:  # prescribed as in level flight
        x, alpha = {}, steady.alpha
        u |= dict.fromkeys(("q", "alpha_dot", "p_dot", "q_dot", "r_dot", "thrust", "thrust_left", "thrust_right"), 0.0)
        u |= {"airspeed": steady.airspeed, "alpha": alpha, "theta": alpha, "altitude": steady.altitude}
        u |= {"force_x": GRAVITY * math.sin(alpha), "force_z": -GRAVITY * math.cos(alpha)}
    else:
        trim = rigid_trim(wider, values, actual, Condition(steady.airspeed, steady.altitude))
        x, half = trim.state, 0.5 * trim.thrust
        u |= {n: trim.controls[n] for n in u if n in trim.controls} | {"altitude": trim.state["altitude"]}
        u |= {"thrust": trim.thrust, "thrust_left": half, "thrust_right": half}
    # arrays: one program for every trim
    x, u = ({name: jnp.asarray(value, float) for name, value in given.items()} for given in (x, u))
    body = RigidBody(wider, values, actual, altitude=False, held=prescribed, heading=False, euler=True)
    gusts = {d.state for d in wider.disturbances}
    states = tuple(n for n in body.start if n not in gusts)
    A = _linearised(body, states, x, u)
    kept = [k for k, n in enumerate(states) if Axis.LATERAL in axes or n not in LATERAL]
    return named_modes(np.asarray(A)[np.ix_(kept, kept)], [states[k] for k in kept], steady.airspeed)


def named_modes(A: Float[np.ndarray, "s s"], states: Sequence[str], airspeed: float) -> tuple[MotionMode, ...]:
    """Eigenvalues of the derivative `A` of the rates of `states` by them, SI, by the names of the modes. Velocities are
    scaled to angles by the airspeed, m/s. A mode whose motion no name fits is called "other"."""
    if not np.all(np.isfinite(A)):
        raise InputError("the equations of motion are not finite about steady flight; check the card's constants")
    kept = [k for k, n in enumerate(states) if n not in WITHOUT_FORCE]
    moving = [states[k] for k in kept]
    eigenvalues, vectors = np.linalg.eig(np.asarray(A, float)[np.ix_(kept, kept)])
    scale = np.array([1.0 / airspeed if n in ("airspeed", "u", "w") else 1.0 for n in moving])
    power = np.square(np.abs(vectors) * scale[:, None])
    power = power / power.sum(axis=0)

    def share(k: int, names: Sequence[str]) -> float:
        """Of these states in the motion of mode k."""
        return float(power[np.isin(moving, names), k].sum())

    order = sorted(map(int, np.flatnonzero(np.imag(eigenvalues) >= 0.0)), key=lambda k: -abs(eigenvalues[k]))
    oscillates = np.imag(eigenvalues) > 0.0
    names = {}
    plane = [k for k in order if share(k, LATERAL) <= 0.5]
    # The faster oscillation is the short period. A single one is it if alpha varies more than speed.
    oscillations = [k for k in plane if oscillates[k]]
    for k in plane:
        name = SHORT_PERIOD if share(k, HEAVES) >= share(k, SPEEDS) else PHUGOID
        names[k] = f"{name}{'' if oscillates[k] else ', aperiodic'}" if share(k, LONGITUDINAL) > 0.5 else OTHER
    if len(oscillations) > 1:
        names |= dict(zip(oscillations, (SHORT_PERIOD, PHUGOID), strict=False))
    # The oscillation with most sideslip is the Dutch roll, the fastest aperiodic mode the roll mode. Without sideslip
    # there is neither a Dutch roll nor a spiral, without bank no spiral.
    lateral = [k for k in order if k not in names]
    oscillations = sorted((k for k in lateral if oscillates[k]), key=lambda k: -share(k, ("beta",)))
    aperiodic = [k for k in lateral if not oscillates[k]]
    names |= dict.fromkeys(lateral, OTHER)
    if "beta" in moving:
        names |= dict(zip(oscillations, (DUTCH_ROLL, "lateral phugoid"), strict=False))
    if {"beta", "phi"} <= set(moving) and len(aperiodic) > 1:
        names[aperiodic[-1]] = SPIRAL
    if "p" in moving and aperiodic:
        names[aperiodic[0] if "beta" in moving else max(aperiodic, key=lambda k: share(k, ("p",)))] = ROLL
    return tuple(MotionMode(names[k], complex(eigenvalues[k])) for k in (*plane, *oscillations, *aperiodic))


@compiled_at(0)
def _linearised(
    body: RigidBody, moving: tuple[str, ...], x: Mapping[str, Any], u: Mapping[str, Any]
) -> Float[Array, "s s"]:
    start = body.complete_start(jnp.stack([jnp.asarray(x.get(name, 0.0), float) for name in body.start]), dict(u))
    places = jnp.array([body.start.index(n) for n in moving])

    def rates(part):
        return body.motion(body.state_at_start(start.at[places].set(part)), dict(u))[0][places]

    return jax.jacfwd(rates)(start[places])
