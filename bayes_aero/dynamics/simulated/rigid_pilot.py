"""Simulation of a model in six degrees of freedom: controls about a trim, with a pilot who controls alpha, bank,
sideslip.

The same `Pilot` as in three degrees of freedom; bank and sideslip are commanded here, not prescribed. Flat earth, no
wind.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from bayes_aero.dynamics.aircraft.rigid_body import RigidBody
from bayes_aero.dynamics.simulated.plant import CONTROLS
from bayes_aero.dynamics.simulated.rigid_trim import SURFACES, Condition, RigidTrim, control_signs, rigid_trim
from bayes_aero.dynamics.simulated.simulate import Pilot
from bayes_aero.dynamics.system import Row, integrate
from bayes_aero.effect import Stage
from bayes_aero.flight.aircraft import Aircraft
from bayes_aero.model.model import Model
from bayes_aero.physics.atmosphere import GRAVITY, air

BANK, ROLL, SLIP, YAW = 0.6, 0.5, 0.5, 0.7  # aileron per bank and roll rate, rudder per sideslip and yaw rate; s
LATERAL_CONTROLS = ("aileron", "rudder")
DISTURBED_COEFFICIENTS = ("CL", "CD", "Cm")
MAX_SUBSTEPS = 16  # integration steps a sample, for a separation point with a short lag
MAX_DEFLECTION = 0.5  # rad of any control
REFERENCE_SIDESLIP = 0.05  # rad, of the steady sideslip that gives the controls per sideslip


class PilotedBody(RigidBody):
    """A rigid body with feedback of its state to the controls; the pilot's pitch trim, rad, is a further state.

    `gains`: of the elevator on alpha, q and the integral of alpha. `pilots`: for each moment, its control and the sign
    of the control's effect. The disturbance is multiplied by 1 + `buffet` (1 - X).
    """

    gains: Any = (0.0, 0.0, 0.0)
    buffet: Any = 0.0
    pilots: tuple[tuple[str, str, float], ...] = eqx.field(static=True, default=())

    @property
    def states(self) -> tuple[str, ...]:
        """States of the body, the trim, and lagged separation points."""
        return self._with_trim(super().states)

    @property
    def start(self) -> tuple[str, ...]:
        """The states with angles of attitude."""
        return self._with_trim(super().start)

    def _with_trim(self, names: tuple[str, ...]) -> tuple[str, ...]:
        flying = len(names) - len(self.points)
        return (*names[:flying], "trim", *names[flying:])

    def flow_signals(self, x: Float[Array, " s"], u: Row) -> dict[str, Any]:
        """Signals of the flow, with the pilot's controls."""
        return super().flow_signals(x, dict(u) | self._controls(self.named(x), u))

    def flow(self, state: Mapping[str, Any], s: Mapping[str, Any]) -> dict[str, Any]:
        """Flow with the disturbances of the coefficients."""
        known = super().flow(state, s)
        growth = 1.0 + self.buffet * (1.0 - known["X"])
        return known | {name: known[name] + growth * s[f"d{name}"] for name in DISTURBED_COEFFICIENTS}

    def motion(self, x: Float[Array, " s"], u: Row) -> tuple[Float[Array, " s"], dict[str, Any]]:
        """Derivative of the state, and outputs with the controls."""
        state = self.named(x)
        rates, outputs = self.rates(x, u)
        rates.insert(self.states.index("trim"), self.gains[2] * (state["alpha"] - u["led_alpha"]))
        return jnp.stack(rates), outputs | self._controls(state, u)

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
    """Simulate a flight from `trim`; commanded bank gives a coordinated turn.

    Returns:
        All signals by the names of recorded channels, the coefficients and X; (n,), SI.
    """
    values = {name: jnp.asarray(x, float) for name, x in values.items()}
    lag = float(model.lag(values))
    if lag == 0.0:  # a separation point without lag is no state
        model = Model.of([e for e in model.effects if e.stage is not Stage.LAG], axes=model.axes)
    chosen = control_signs(model, values, aircraft, trim.state["airspeed"])
    pilots = tuple((moment, control, sign) for moment, (control, sign) in chosen.items())
    gains = tuple(jnp.asarray(x, float) for x in (pilot.alpha_gain, pilot.rate_gain, pilot.trim_gain))
    body = PilotedBody(model, values, aircraft, gains=gains, buffet=jnp.asarray(pilot.buffet, float), pilots=pilots)
    inputs = _inputs(pilot, trim, chosen)
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


def _inputs(pilot: Pilot, trim: RigidTrim, chosen: Mapping[str, tuple[str, float]]) -> dict[str, Float[Array, " n"]]:
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
