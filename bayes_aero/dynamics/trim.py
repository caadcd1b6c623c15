"""Trim of any model, found from its own coefficients: level flight, its airspeed, and the control that pitches."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from bayes_aero.dynamics.aircraft import RigidBody
from bayes_aero.dynamics.system import Row, System
from bayes_aero.effect import Effect, Stage
from bayes_aero.errors import InputError
from bayes_aero.model import observations as observations
from bayes_aero.model.model import Model
from bayes_aero.physics.aircraft import GRAVITY, Aircraft, air
from bayes_aero.physics.coefficients import accelerometers, moments, motion_of_aircraft, specific_force
from bayes_aero.physics.kinematics import RATES, down_of, euler_rates

GRID = np.deg2rad(np.linspace(-4.0, 20.0, 97))  # alpha tried for trim
TRAVEL = 0.2  # rad either side of the pilot's command over which the pitch acceleration is taken as linear

Values = Mapping[str, Any]


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


@eqx.filter_jit
def _balance(model: Model, values: Any, aircraft: Aircraft, airspeed: Any, altitude: Any, *rows: Any):
    """CL, CD and pitch acceleration in steady level flight at each alpha, thrust and further command of `rows`."""
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


# --- Steady flight in six degrees of freedom: straight or turning, with sideslip, bank or unequal engines.

MOMENTS = ("Cm", "Cl", "Cn")
MAX_ITERATIONS, MAX_STEP = 60, 0.1  # of Newton's method; rad, or shares of the weight
TOLERANCE = 1e-9  # m/s2, rad/s2
ANGLE_LIMITS = {"alpha": 0.6, "beta": 0.6, "phi": 1.4, "theta": 1.4}  # rad, either side of zero
MAX_DEFLECTION = 1.0  # rad, of a control

SURFACES = ("spoiler_left", "spoiler_right", "dlc_left", "dlc_right", "flap", "time")  # zero in trim


@dataclass(frozen=True)
class Condition:
    """Steady flight in SI. Two of sideslip, bank and turn rate are given, and the third one (None) follows. `climb` is
    the angle of the flight path, rad; `unequal` the left engine's thrust less the right one's over their sum: 1 with
    the left engine alone."""

    airspeed: float
    altitude: float
    sideslip: float | None = 0.0
    bank: float | None = None
    turn_rate: float | None = 0.0
    climb: float = 0.0
    unequal: float = 0.0

    def __post_init__(self) -> None:
        """Check that exactly one of sideslip, bank and turn rate is free."""
        if sum(x is None for x in (self.sideslip, self.bank, self.turn_rate)) != 1:
            raise InputError("steady flight has two of sideslip, bank and turn rate given; the third one follows")


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

    def found(deflections):
        flow = model.flow(values, rest | deflections, aircraft, X=jnp.ones(()))
        return {name: flow[name] for name in MOMENTS}

    slopes = jax.jacfwd(found)({n: jnp.zeros(()) for n in (*CONTROLS, "aileron", "rudder")})
    chosen = {}
    for name, tried in (("Cm", CONTROLS), ("Cl", ("aileron",)), ("Cn", ("rudder",))):
        working = [n for n in tried if float(slopes[name][n]) != 0.0]
        if working:
            chosen[name] = (working[0], float(np.sign(slopes[name][working[0]])))
    return chosen


def rigid_trim(model: Model, values: Values, aircraft: Aircraft, condition: Condition) -> RigidTrim:
    """Angles, thrust and controls of steady flight: Newton's method on the accelerations and the climb."""
    values = {name: jnp.asarray(x, float) for name, x in values.items()}
    controls = tuple(name for name, _ in control_signs(model, values, aircraft, condition.airspeed).values())
    body = RigidBody(model, values, aircraft)
    attitude = {"beta": condition.sideslip, "phi": condition.bank, "turn_rate": condition.turn_rate}
    angles = ("alpha", "theta", *(n for n, x in attitude.items() if x is None))
    given = {name: x for name, x in asdict(condition).items() if name not in ("sideslip", "bank", "turn_rate")}
    given |= {name: x for name, x in attitude.items() if x is not None}
    given = {name: jnp.asarray(x, float) for name, x in given.items()}  # arrays: one program for every condition
    unknown = np.zeros(len(angles) + 1 + len(controls))
    unknown[:2], unknown[len(angles)] = 0.08, 0.1
    for _ in range(MAX_ITERATIONS):
        imbalance, slope = _linear(body, given, angles, controls, jnp.asarray(unknown))
        imbalance, slope = np.asarray(imbalance), np.asarray(slope)
        if not (np.all(np.isfinite(imbalance)) and np.all(np.isfinite(slope))):
            break
        if np.max(np.abs(imbalance)) < TOLERANCE:
            attained = {n: float(x or 0.0) for n, x in attitude.items()}
            attained |= dict(zip(angles, map(float, unknown), strict=False))
            deflections = dict(zip(controls, map(float, unknown[len(angles) + 1 :]), strict=True))
            inside = all(abs(attained[n]) < most for n, most in ANGLE_LIMITS.items())
            if not inside or any(abs(x) > MAX_DEFLECTION for x in deflections.values()):
                break
            down = down_of(np.float64(attained["phi"]), np.float64(attained["theta"]))
            state = {n: attained[n] for n in ("alpha", "beta", "phi", "theta")}
            state |= {"airspeed": condition.airspeed, "altitude": condition.altitude, "psi": 0.0}
            state |= {n: attained["turn_rate"] * float(x) for n, x in zip(RATES, down, strict=True)}
            return RigidTrim(state, deflections, float(unknown[len(angles)]) * float(aircraft.mass) * GRAVITY)
        step = -np.linalg.lstsq(slope, imbalance, rcond=1e-12)[0]
        unknown = unknown + step * min(1.0, MAX_STEP / max(np.max(np.abs(step)), 1e-12))
    asked = {"sideslip": condition.sideslip, "bank": condition.bank, "turn rate": condition.turn_rate}
    degrees = ", ".join(f"{name} {np.degrees(x):.3g} deg" for name, x in asked.items() if x)
    raise InputError(
        f"there is no steady flight at {condition.airspeed:.0f} m/s and {condition.altitude:.0f} m"
        f"{f' with {degrees}' if degrees else ''} that {', '.join(controls) or 'no control'} can hold; change the "
        "speed or add a control to the model"
    )


@eqx.filter_jit
def _linear(
    body: RigidBody,
    given: Mapping[str, Float[Array, ""]],
    angles: tuple[str, ...],
    controls: tuple[str, ...],
    unknown: Float[Array, " k"],
):
    """Accelerations and climb that are not balanced, and their derivative by the unknowns; `given` by the condition."""
    weight = body.aircraft.mass * GRAVITY

    def imbalance(z):
        s = dict(given) | dict(zip(angles, z, strict=False))
        turn = s.pop("turn_rate")
        thrust = z[len(angles)] * weight
        s |= dict(zip(RATES, (turn * x for x in down_of(s["phi"], s["theta"])), strict=True))
        u = {n: jnp.zeros_like(z[0]) for n in (*CONTROLS, "aileron", "rudder", *SURFACES)}
        u |= dict(zip(controls, z[len(angles) + 1 :], strict=True)) | {"thrust": thrust}
        u |= {f"thrust_{n}": 0.5 * thrust * (1.0 + f * given["unequal"]) for n, f in (("left", 1.0), ("right", -1.0))}
        x = jnp.stack([jnp.asarray(s.get(name, 0.0), float) for name in body.start])
        state = body.state_at_start(body.complete_start(x, u))
        rates = dict(zip(body.states, body.motion(state, u)[0], strict=True))
        climb = rates["altitude"] / given["airspeed"] - jnp.sin(given["climb"])
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


# --- The simulated aircraft in three degrees of freedom: pilot, prescribed turn, and disturbances of the
# coefficients.
# Bank angle and sideslip are prescribed with their rates; the yaw rate follows from them (see `Plant.turn`). Flat
# earth, no wind. The equations of motion are those of `physics.coefficients`.

SIDE_FORCE = -0.7  # 1/rad, CY per sideslip of a transport; our choice, it sets only the yaw rate in sideslip

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


class FlightState(NamedTuple):
    """State of `Plant`; SI."""

    airspeed: Any
    alpha: Any
    theta: Any
    q: Any
    altitude: Any
    lagged_X: Any = 1.0  # the lagged separation point
    trim: Any = 0.0  # the pilot's trim command, rad


PRESCRIBED = ("thrust", "stabilizer", "rudder", "spoiler_left", "spoiler_right", "dlc_left", "dlc_right", "flap")
TURNING = {"phi": "phi_rate", "phi_rate": "phi_acceleration", "beta": "beta_dot", "beta_dot": "beta_acceleration"}
INPUTS = (
    "time", *PRESCRIBED, *dict.fromkeys((*TURNING, *TURNING.values())), "alpha_led", "command", "dCL", "dCD", "dCm",
)  # fmt: skip
"""Inputs of `Plant`, SI: the stabilizer in addition to the pilot's command; bank and sideslip with their derivatives;
the commanded alpha `alpha_led`, and the pilot's command in addition to feedback and trim; disturbances of the
coefficients.
"""


class Plant(System):
    """The aircraft with its model. The disturbance is multiplied by 1 + `buffet` (1 - X)."""

    model: Model = eqx.field(static=True)
    values: dict[str, Any]
    aircraft: Aircraft
    gains: tuple[Float[Array, ""], Float[Array, ""], Float[Array, ""]]  # on alpha, q and the integral of alpha
    buffet: Float[Array, ""]
    shares: Any = (1.0, 0.0)  # of the pilot's command in each of `CONTROLS`

    @property
    def states(self) -> tuple[str, ...]:
        return FlightState._fields

    def motion(self, x: Float[Array, " s"], u: Row) -> tuple[Float[Array, " s"], dict[str, Any]]:
        """Derivative of the state, and every signal, from the state and `INPUTS`."""
        state = FlightState(*x)
        density, sound = air(state.altitude)
        s = dict(u) | {name: getattr(state, name) for name in ("airspeed", "alpha", "theta", "q", "altitude")}
        feedback = self.gains[0] * (state.alpha - u["alpha_led"]) + self.gains[1] * state.q
        command = u["command"] + feedback + state.trim
        s |= {"elevator": self.shares[0] * command, "stabilizer": u["stabilizer"] + self.shares[1] * command}
        s |= {"density": density, "mach": state.airspeed / sound}
        s |= self.turn(s)

        def flow(alpha_dot):
            """By the effects, with disturbances, and the separation point of steady flow."""
            known = s | {"alpha_dot": alpha_dot}
            static = self.model.static_separation(self.values, known, self.aircraft)
            X = jnp.where(self.model.lag(self.values) > 0.0, state.lagged_X, static)
            known = self.model.flow(self.values, known, self.aircraft, X=X)
            growth = 1.0 + self.buffet * (1.0 - X)
            return known | {"static_X": static} | {n: known[n] + growth * s[f"d{n}"] for n in ("CL", "CD", "Cm")}

        implicit = any("alpha_dot" in effect.channels for effect in self.model.acting)
        now = motion_of_aircraft(flow, s, s, self.aircraft, implicit=implicit)
        rates = {name: now.rates[name] for name in ("airspeed", "alpha", "altitude")} | {"q": now.q_dot}
        rates["theta"] = euler_rates((s["p"], s["q"], s["r"]), s["phi"], s["theta"])[1]
        lag = self.model.lag(self.values) * self.aircraft.chord / state.airspeed
        X_dot = jnp.where(lag > 0.0, (now.flow["static_X"] - state.lagged_X) / jnp.where(lag > 0.0, lag, 1.0), 0.0)
        derivative = FlightState(**rates, lagged_X=X_dot, trim=self.gains[2] * (state.alpha - u["alpha_led"]))
        change = rates | {name: u[rate] for name, rate in TURNING.items()}
        turning = jax.jvp(self.turn, ({name: s[name] for name in change},), (change,))[1]
        now = now._replace(rotation=(turning["p"], now.q_dot, turning["r"]))
        accelerations = accelerometers(now, s, self.aircraft)
        outputs = s | accelerations | {"alpha_dot": rates["alpha"], "q_dot": now.q_dot}
        return jnp.stack(derivative), outputs | {name: now.flow[name] for name in ("X", "CL", "CD", "Cm")}

    def turn(self, s: Mapping[str, Any]) -> dict[str, Any]:
        """Roll, yaw (body axes) and turn rate of a flight with this bank and sideslip, from the kinematic equations and
        the equation of side force. The latter is V (r cos alpha - p sin alpha + beta-dot) = g cos theta sin phi + Y/m
        with Y due to sideslip: without sideslip a coordinated turn. It neglects V-dot tan beta; the side force recorded
        by `ay` does not."""
        V, phi, theta, q = s["airspeed"], s["phi"], s["theta"], s["q"]
        side = 0.5 * air(s["altitude"])[0] * V * self.aircraft.wing_area * SIDE_FORCE * s["beta"] / self.aircraft.mass
        needed = GRAVITY * jnp.cos(theta) * jnp.sin(phi) / V + side - s["beta_dot"]
        sin, cos = jnp.sin(s["alpha"]), jnp.cos(s["alpha"])
        lean = jnp.cos(theta) / jnp.cos(phi)
        rolling = q * jnp.tan(phi) * cos + s["phi_rate"] * sin
        psi_dot = (needed + rolling) / (lean * cos + jnp.sin(theta) * sin)
        p, r = s["phi_rate"] - psi_dot * jnp.sin(theta), psi_dot * lean - q * jnp.tan(phi)
        return {"p": p, "r": r, "psi_dot": psi_dot}
