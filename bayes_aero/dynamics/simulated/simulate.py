"""Simulation of a model: longitudinal equations of motion, with the effects of the coefficient fit.

Bank angle and sideslip are prescribed (see `plant`). Flat earth, no wind.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from bayes_aero.dynamics.aircraft import RigidBody
from bayes_aero.dynamics.simulated.trim import (
    CONTROLS,
    SURFACES,
    Condition,
    FlightState,
    Plant,
    RigidTrim,
    Values,
    control_signs,
    lead,
    rigid_trim,
)
from bayes_aero.dynamics.system import Row, System, advance, integrate, later, step
from bayes_aero.effect import Stage
from bayes_aero.flight.aircraft import Aircraft
from bayes_aero.flight.atmosphere import GRAVITY, air
from bayes_aero.model.model import Model
from bayes_aero.physics.filters import differentiate
from bayes_aero.units import number


class Pilot(NamedTuple):
    """Commands of a simulated flight: alpha follows `alpha` (rad) by trim + gains x errors + `excitation` (rad).
    `thrust` in N; `disturbance` (n, 3) times 1 + `buffet` (1 - X) is added to CL, CD, Cm. Bank `phi` and sideslip
    `beta` (rad) are prescribed and must be smooth, because they are differentiated. `stabilizer`, `rudder`, `aileron`,
    `spoiler`, `dlc`, `flap` (rad) act only through effects. `trim_gain` (1/s): feedback on the integral of alpha, as by
    trimming. `uneven`: the left engine's thrust less the right one's over their sum; it acts only on a rigid body.
    Arrays have one row per sample."""

    alpha: Float[Any, " n"]
    thrust: Float[Any, " n"]
    excitation: Float[Any, " n"] | float = 0.0
    disturbance: Float[Any, "n 3"] | float = 0.0
    alpha_gain: Float[Any, ""] | float = 0.7
    rate_gain: Float[Any, ""] | float = 0.2
    phi: Float[Any, " n"] | float = 0.0
    beta: Float[Any, " n"] | float = 0.0
    stabilizer: Float[Any, " n"] | float = 0.0
    rudder: Float[Any, " n"] | float = 0.0
    spoiler: Float[Any, " n"] | float = 0.0
    dlc: Float[Any, " n"] | float = 0.0
    flap: Float[Any, " n"] | float = 0.0
    buffet: Float[Any, ""] | float = 0.0
    trim_gain: Float[Any, ""] | float = 0.0
    aileron: Float[Any, " n"] | float = 0.0
    uneven: Float[Any, " n"] | float = 0.0


def fly(
    model: Model, values: Mapping[str, Any], aircraft: Aircraft, pilot: Pilot, start: FlightState, dt: float
) -> dict[str, Float[Array, " n"]]:
    """All signals of the flight by the names of recorded channels, and CL, CD, Cm, X; (n,), SI. Inputs are linear
    between samples. Held inputs would lag their record by half a sample, which a diagnosis finds as a delay of the
    elevator."""
    numbers, pilot, start = jax.tree.map(lambda x: jnp.asarray(x, float), (dict(values), pilot, start))
    return _fly_one(model, numbers, aircraft, pilot, start, jnp.asarray(dt))


def fly_together(
    model: Model, values: Values, aircraft: Aircraft, pilots: Sequence[Pilot], starts: Sequence[FlightState], dt: float
) -> list[dict[str, np.ndarray]]:
    """As `fly`, for several flights of one length."""
    numbers = {name: jnp.asarray(x, float) for name, x in values.items()}
    rows = [jax.tree.map(lambda *x: np.stack([np.asarray(y, float) for y in x]), *row) for row in (pilots, starts)]
    flights = jax.tree.map(np.asarray, _fly_several(model, numbers, aircraft, *rows, jnp.asarray(dt)))
    return [{name: x[k] for name, x in flights.items()} for k in range(len(pilots))]


def _fly(model: Model, values: dict[str, Any], aircraft: Aircraft, pilot: Pilot, start: FlightState, dt: Any):
    shares, command = lead(model, values, aircraft, pilot.alpha, start.airspeed, start.altitude)
    gains = (pilot.alpha_gain, pilot.rate_gain, pilot.trim_gain)
    plant = Plant(model, values, aircraft, gains, pilot.buffet, shares)  # type: ignore[arg-type]
    inputs = _inputs(pilot, command, dt)
    _, found = jax.lax.scan(lambda x, row: step(plant, x, *row, dt), jnp.stack(start), (inputs, later(inputs)))
    turn = found["psi_dot"]
    return found | {"psi": jnp.cumsum(jnp.pad(0.5 * dt * (turn[1:] + turn[:-1]), (1, 0)))}


_fly_one = eqx.filter_jit(_fly)
_fly_several = eqx.filter_jit(eqx.filter_vmap(_fly, in_axes=(None, None, None, 0, 0, None)))


def outside(flight: Mapping[str, np.ndarray], envelope: Mapping[str, tuple[float, float]]) -> str | None:
    """The first channel outside its range, in words; None where all are inside."""
    for name, (lower, upper) in envelope.items():
        x = flight[name]
        if not (np.all(np.isfinite(x)) and x.min() >= lower and x.max() <= upper):
            return f"{name} {number(x.min())} to {number(x.max())} (allowed {number(lower)} to {number(upper)})"
    return None


def _inputs(pilot: Pilot, command: Float[Array, " n"], dt: Any) -> dict[str, Float[Array, " n"]]:
    """Inputs of `Plant`."""
    n = pilot.alpha.shape[0]
    disturbance = jnp.broadcast_to(pilot.disturbance, (n, 3)).T
    pilot = Pilot(*(jnp.broadcast_to(x, n) if jnp.ndim(x) == 0 else x for x in pilot))
    phi_rate, beta_dot = differentiate(pilot.phi, dt), differentiate(pilot.beta, dt)
    angles = {"phi": pilot.phi, "phi_rate": phi_rate, "phi_acceleration": differentiate(phi_rate, dt)}
    angles |= {"beta": pilot.beta, "beta_dot": beta_dot, "beta_acceleration": differentiate(beta_dot, dt)}
    surfaces = {name: getattr(pilot, name) for name in ("stabilizer", "rudder", "flap")}
    surfaces |= {f"{name}_{side}": getattr(pilot, name) for name in ("spoiler", "dlc") for side in ("left", "right")}
    disturbed = dict(zip(("dCL", "dCD", "dCm"), disturbance, strict=True))
    led = {"alpha_led": pilot.alpha, "command": command + pilot.excitation, "thrust": pilot.thrust}
    return {"time": jnp.arange(n) * dt} | angles | surfaces | disturbed | led


# --- Flights through random gusts: a system whose states include gusts, driven by their white noise.


def through_gusts(
    system: System,
    start: Float[Array, " s"],
    inputs: Mapping[str, Float[Array, " n"]],
    dt: Any,
    white: Float[Array, "n s"],
    outputs: Sequence[str],
    substeps: int = 1,
) -> tuple[Float[Array, "n c"], Bool[Array, " n"]]:
    """Outputs of one flight, and whether each sample was reached inside the envelope; `white`: normal numbers. A random
    process of decay rate a and spectral density q gains the variance q (1 - exp(-2 a dt)) / (2 a) in a sample, so that
    its own distribution is exact; within the sample the other states see its mean."""
    bounds = [system.envelope.get(name, (-jnp.inf, jnp.inf)) for name in system.states]
    lower, upper = (jnp.array([b[i] for b in bounds]) for i in (0, 1))

    def one_sample(x, row):
        now, then, noise = row
        rate = 2.0 * system.decay(x, now)
        gained = system.noise_density(x, now) * jnp.where(rate > 0.0, -jnp.expm1(-rate * dt) / rate, dt)
        found = system.motion(x, now)[1]
        found |= {name: x[i] for i, name in enumerate(system.states) if name in system.state_outputs}
        sound = jnp.all(jnp.isfinite(x)) & jnp.all((x >= lower) & (x <= upper))
        after = advance(system, x, now, then, dt, substeps) + jnp.sqrt(gained) * noise
        return after, (jnp.stack([found[name] for name in outputs]), sound)

    _, (made, sound) = jax.lax.scan(one_sample, start, (dict(inputs), later(inputs), white))
    return made, jnp.cumsum(~sound) == 0


# --- Simulation of a model in six degrees of freedom: controls about a trim, with a pilot who controls alpha, bank,
# sideslip.
# The same `Pilot` as in three degrees of freedom; bank and sideslip are commanded here, not prescribed. Flat earth,
# no wind.

BANK, ROLL, SLIP, YAW = 0.6, 0.5, 0.5, 0.7  # aileron per bank and roll rate, rudder per sideslip and yaw rate; s
LATERAL_CONTROLS = ("aileron", "rudder")
DISTURBED_COEFFICIENTS = ("CL", "CD", "Cm")
MAX_SUBSTEPS = 16  # integration steps a sample, for a separation point with a short lag
MAX_DEFLECTION = 0.5  # rad of any control
REFERENCE_SIDESLIP = 0.05  # rad, of the steady sideslip that gives the controls per sideslip


class PilotedBody(RigidBody):
    """A rigid body with feedback of its state to the controls; the pilot's pitch trim, rad, is a further state. The
    disturbance is multiplied by 1 + `buffet` (1 - X)."""

    gains: Any = (0.0, 0.0, 0.0)  # of the elevator on alpha, q and the integral of alpha
    buffet: Any = 0.0
    pilots: tuple[tuple[str, str, float], ...] = eqx.field(static=True, default=())  # moment, its control, its sign

    @property
    def after(self) -> tuple[str, ...]:
        """States after the flight states, the trim before the lagged separation points."""
        names = super().after
        points = len(names) - len(self.points)
        return (*names[:points], "trim", *names[points:])

    def separation_rates(self, state: Mapping[str, Any], s: Mapping[str, Any]) -> list[Any]:
        """Of the trim and the separation points."""
        return [self.gains[2] * (state["alpha"] - s["led_alpha"]), *super().separation_rates(state, s)]

    def flow_signals(self, x: Float[Array, " s"], u: Row) -> dict[str, Any]:
        return super().flow_signals(x, dict(u) | self._controls(self.named(x), u))

    def flow(self, state: Mapping[str, Any], s: Mapping[str, Any]) -> dict[str, Any]:
        """Flow with the disturbances of the coefficients."""
        known = super().flow(state, s)
        growth = 1.0 + self.buffet * (1.0 - known["X"])
        return known | {name: known[name] + growth * s[f"d{name}"] for name in DISTURBED_COEFFICIENTS}

    def motion(self, x: Float[Array, " s"], u: Row) -> tuple[Float[Array, " s"], dict[str, Any]]:
        rates, outputs = super().motion(x, u)
        return rates, outputs | self._controls(self.named(x), u)

    def _controls(self, state: Mapping[str, Any], u: Row) -> dict[str, Any]:
        """Deflections, rad: command and feedback."""
        errors = {name: state[name] - u[f"led_{name}"] for name in ("alpha", "beta", "phi")}
        pitch = -self.gains[0] * errors["alpha"] - self.gains[1] * state["q"] - state["trim"]
        roll = -BANK * errors["phi"] - ROLL * state["p"]
        yaw = SLIP * errors["beta"] - YAW * (state["r"] - u["led_r"])
        commands = {"Cm": pitch, "Cl": roll, "Cn": yaw}
        deflections = {control: sign * commands[moment] for moment, control, sign in self.pilots}
        names = (*CONTROLS, *LATERAL_CONTROLS)
        return {
            n: u[n] + jnp.clip(deflections[n], -MAX_DEFLECTION, MAX_DEFLECTION) if n in deflections else u[n]
            for n in names
        }


def fly_rigid(
    model: Model, values: Mapping[str, Any], aircraft: Aircraft, pilot: Pilot, trim: RigidTrim, dt: float
) -> dict[str, Float[np.ndarray, " n"]]:
    """All signals of a flight from `trim` by the names of recorded channels, the coefficients and X; (n,), SI.
    Commanded bank gives a coordinated turn."""
    values = {name: jnp.asarray(x, float) for name, x in values.items()}
    lag = float(model.lag(values))
    if lag == 0.0:  # a separation point without lag is no state
        model = Model.of([e for e in model.effects if e.stage is not Stage.LAG], axes=model.axes)
    chosen = control_signs(model, values, aircraft, trim.state["airspeed"])
    pilots = tuple((moment, control, sign) for moment, (control, sign) in chosen.items())
    gains = tuple(jnp.asarray(x, float) for x in (pilot.alpha_gain, pilot.rate_gain, pilot.trim_gain))
    body = PilotedBody(model, values, aircraft, gains=gains, buffet=jnp.asarray(pilot.buffet, float), pilots=pilots)
    inputs = _piloted_inputs(pilot, trim, chosen)
    condition = Condition(trim.state["airspeed"], trim.state["altitude"], trim.state["beta"] + REFERENCE_SIDESLIP)
    sideslipping = rigid_trim(model, values, aircraft, condition).controls if np.any(inputs["led_beta"]) else {}
    for name in LATERAL_CONTROLS:
        slope = (sideslipping.get(name, 0.0) - trim.controls.get(name, 0.0)) / REFERENCE_SIDESLIP
        inputs[name] = inputs[name] + (slope * inputs["led_beta"] if sideslipping else 0.0)
    first = {name: x[0] for name, x in inputs.items()}
    start = jnp.array([trim.state.get(name, 0.0) for name in body.start])
    fast = lag * float(aircraft.chord) / trim.state["airspeed"]
    parts = int(np.clip(np.ceil(2.0 * dt / fast), 1, MAX_SUBSTEPS)) if lag > 0.0 else 1
    found = _integrate(body, body.state_at_start(body.complete_start(start, first)), inputs, jnp.asarray(dt), parts)
    flight = {name: np.asarray(x) for name, x in (inputs | found.outputs).items()}
    flight |= {name: np.unwrap(flight[name]) for name in ("phi", "psi")}
    density, sound = (np.asarray(x) for x in air(found.outputs["altitude"]))
    flight |= {"density": density, "mach": flight["airspeed"] / sound}
    return {name: np.where(found.inside, x, np.nan) for name, x in flight.items()}


_integrate = eqx.filter_jit(integrate)


def _piloted_inputs(
    pilot: Pilot, trim: RigidTrim, chosen: Mapping[str, tuple[str, float]]
) -> dict[str, Float[Array, " n"]]:
    """Inputs of `PilotedBody`: commands about the trim, and thrust."""
    n = np.asarray(pilot.alpha).shape[0]
    whole = lambda x: jnp.broadcast_to(jnp.asarray(x, float), n)  # noqa: E731
    disturbance = jnp.broadcast_to(jnp.asarray(pilot.disturbance, float), (n, 3)).T
    u = {name: whole(trim.controls.get(name, 0.0)) for name in (*CONTROLS, *LATERAL_CONTROLS)}
    pitch, sign = chosen.get("Cm", ("elevator", -1.0))
    u[pitch] = u[pitch] - sign * whole(pilot.excitation)  # a positive command pitches down
    u |= {name: u[name] + whole(getattr(pilot, name)) for name in ("stabilizer", *LATERAL_CONTROLS)}
    surfaces = {name: whole(getattr(pilot, name.split("_")[0], 0.0)) for name in SURFACES if name != "time"}
    speed, phi = trim.state["airspeed"], whole(pilot.phi)
    led = {"led_alpha": whole(pilot.alpha), "led_beta": whole(pilot.beta), "led_phi": phi}
    led["led_r"] = GRAVITY / speed * jnp.sin(phi)
    thrust = whole(pilot.thrust)
    more = thrust * whole(pilot.uneven)
    engines = {"thrust_left": 0.5 * (thrust + more), "thrust_right": 0.5 * (thrust - more), "thrust": thrust}
    noise = dict(zip((f"d{name}" for name in DISTURBED_COEFFICIENTS), disturbance, strict=True))
    return u | surfaces | led | engines | noise
