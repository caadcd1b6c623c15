"""Steady flight in six degrees of freedom: straight or turning, with sideslip, bank or unequal engines."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from bayes_aero.dynamics.aircraft.rigid_body import RigidBody
from bayes_aero.dynamics.simulated.plant import CONTROLS, SIGNALS
from bayes_aero.errors import InputError
from bayes_aero.flight.aircraft import Aircraft
from bayes_aero.model.model import Model
from bayes_aero.physics.atmosphere import GRAVITY
from bayes_aero.physics.kinematics import RATES, down_of

MOMENTS = ("Cm", "Cl", "Cn")
MAX_ITERATIONS, MAX_STEP = 60, 0.1  # of Newton's method; rad, or shares of the weight
TOLERANCE = 1e-9  # m/s2, rad/s2
ANGLE_LIMITS = {"alpha": 0.6, "beta": 0.6, "phi": 1.4, "theta": 1.4}  # rad, either side of zero
MAX_DEFLECTION = 1.0  # rad, of a control

SURFACES = ("spoiler_left", "spoiler_right", "dlc_left", "dlc_right", "flap", "time")  # zero in trim

Values = Mapping[str, Any]


@dataclass(frozen=True)
class Condition:
    """Steady flight in SI. Two of sideslip, bank and turn rate are given, and the third one (None) follows.

    `climb` is the angle of the flight path, rad; `unequal` the left engine's thrust less the right one's over their
    sum: 1 with the left engine alone.
    """

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
        known = model.flow(values, rest | deflections, aircraft, X=jnp.ones(()))
        return {name: known[name] for name in MOMENTS}

    slopes = jax.jacfwd(found)({n: jnp.zeros(()) for n in (*CONTROLS, "aileron", "rudder")})
    chosen = {}
    for name, tried in (("Cm", CONTROLS), ("Cl", ("aileron",)), ("Cn", ("rudder",))):
        working = [n for n in tried if float(slopes[name][n]) != 0.0]
        if working:
            chosen[name] = (working[0], float(np.sign(slopes[name][working[0]])))
    return chosen


def rigid_trim(model: Model, values: Values, aircraft: Aircraft, condition: Condition) -> RigidTrim:
    """Angles, thrust and controls of steady flight: Newton's method on the accelerations and the climb.

    Args:
        model: effects in flight, of both axes.
        values: all parameter values by name.
        aircraft: the actual aircraft.
        condition: the steady flight.

    Raises:
        InputError: there is no such flight, or no control balances a moment.
    """
    values = {name: jnp.asarray(x, float) for name, x in values.items()}
    controls = tuple(name for name, _ in control_signs(model, values, aircraft, condition.airspeed).values())
    body = RigidBody(model, values, aircraft)
    angles = ("alpha", "theta", *(n for n, x in _given_or_free(condition).items() if x is None))
    given = {name: x for name, x in asdict(condition).items() if name not in ("sideslip", "bank", "turn_rate")}
    given |= {name: x for name, x in _given_or_free(condition).items() if x is not None}
    given = {name: jnp.asarray(x, float) for name, x in given.items()}  # arrays: one program for every condition
    unknown = np.zeros(len(angles) + 1 + len(controls))
    unknown[:2], unknown[len(angles)] = 0.08, 0.1
    for _ in range(MAX_ITERATIONS):
        imbalance, slope = _linear(body, given, angles, controls, jnp.asarray(unknown))
        imbalance, slope = np.asarray(imbalance), np.asarray(slope)
        if not (np.all(np.isfinite(imbalance)) and np.all(np.isfinite(slope))):
            break
        if np.max(np.abs(imbalance)) < TOLERANCE:
            return _trim_within_limits(condition, angles, controls, unknown, float(aircraft.mass) * GRAVITY)
        step = -np.linalg.lstsq(slope, imbalance, rcond=1e-12)[0]
        unknown = unknown + step * min(1.0, MAX_STEP / max(np.max(np.abs(step)), 1e-12))
    raise InputError(_refusal(condition, controls))


def _given_or_free(condition: Condition) -> dict[str, float | None]:
    return {"beta": condition.sideslip, "phi": condition.bank, "turn_rate": condition.turn_rate}


@eqx.filter_jit
def _linear(
    body: RigidBody,
    given: Mapping[str, Float[Array, ""]],
    angles: tuple[str, ...],
    controls: tuple[str, ...],
    unknown: Float[Array, " k"],
):
    """Accelerations and climb that are not balanced, and their derivative by the unknowns; `given` is what the
    `Condition` states."""
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


def _trim_within_limits(
    condition: Condition,
    angles: tuple[str, ...],
    controls: tuple[str, ...],
    found: Float[np.ndarray, " k"],
    weight: float,
) -> RigidTrim:
    given = _given_or_free(condition) | dict(zip(angles, map(float, found), strict=False))
    turn, theta, phi = (float(given[n] or 0.0) for n in ("turn_rate", "theta", "phi"))
    deflections = dict(zip(controls, map(float, found[len(angles) + 1 :]), strict=True))
    inside = all(abs(float(given[n] or 0.0)) < most for n, most in ANGLE_LIMITS.items())
    if not inside or any(abs(x) > MAX_DEFLECTION for x in deflections.values()):
        raise InputError(_refusal(condition, controls))
    state = {n: float(given[n] or 0.0) for n in ("alpha", "beta", "phi", "theta")}
    state |= {"airspeed": condition.airspeed, "altitude": condition.altitude, "psi": 0.0}
    state |= {n: turn * float(x) for n, x in zip(RATES, down_of(np.float64(phi), np.float64(theta)), strict=True)}
    return RigidTrim(state, deflections, float(found[len(angles)]) * weight)


def _refusal(condition: Condition, controls: tuple[str, ...]) -> str:
    asked = {"sideslip": condition.sideslip, "bank": condition.bank, "turn rate": condition.turn_rate}
    degrees = ", ".join(f"{name} {np.degrees(x):.3g} deg" for name, x in asked.items() if x)
    return (
        f"there is no steady flight at {condition.airspeed:.0f} m/s and {condition.altitude:.0f} m"
        f"{f' with {degrees}' if degrees else ''} that {', '.join(controls) or 'no control'} can hold; change the "
        "speed or add a control to the model"
    )
