"""The aircraft in six degrees of freedom, with the effects of any model; any of its states may be held to the record.

States are airspeed, alpha, beta, p, q, r, the attitude as a quaternion, altitude, the gusts of the model and, with a
lag, the separation point X. Held states and their rates are prescribed as recorded. Forces and moments of an axis
without a model are those of the accelerometers and of the prescribed rates. Flat earth.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from bayes_aero.dynamics.aircraft.effect_system import POINTS, EffectSystem
from bayes_aero.dynamics.aircraft.gusts import FLOW
from bayes_aero.dynamics.output_channels import RIGID
from bayes_aero.dynamics.system import Row
from bayes_aero.flight.aircraft import Aircraft
from bayes_aero.flight.axes import Axis
from bayes_aero.flight.card.fly_table import HOLDABLE
from bayes_aero.model.model import Model
from bayes_aero.physics.equations_of_motion import accelerometers, motion_of_aircraft
from bayes_aero.physics.kinematics import RATES, Attitude, down_of, euler_rates

ANGLES = ("phi", "theta", "psi")
QUATERNION = Attitude._fields
HELD: Mapping[Axis, tuple[str, ...]] = {
    Axis.LONGITUDINAL: ("airspeed", "alpha", "q", "theta", "altitude"),
    Axis.LATERAL: ("beta", "p", "r", "phi", "psi"),
}
"""States that belong to each axis: held to the record where the model does not have it."""
ENVELOPE = {
    "airspeed": (5.0, 1500.0), "alpha": (-1.0, 1.2), "beta": (-1.2, 1.2), "theta": (-1.5, 1.5), "p": (-12.0, 12.0),
    "q": (-4.0, 4.0), "r": (-4.0, 4.0),
} | dict.fromkeys(POINTS, (-0.5, 1.5))  # fmt: skip
TURN = 2.0 * math.pi


def held_states(axes: Iterable[Axis], more: Iterable[str] = ()) -> tuple[str, ...]:
    """States that are held to the record: those of axes without a model, and `more`."""
    modelled = set(axes)
    held = {name for axis, names in HELD.items() if axis not in modelled for name in names} | set(more)
    return tuple(name for name in HOLDABLE if name in held)


class RigidBody(EffectSystem):
    """An aircraft with its model at given parameter values; `aircraft` has the corrected constants.

    Without `heading` the heading starts at zero and is no output. The states of attitude are Euler angles where one of
    them is `held`, or with `euler`, so that a filter can correct measured states. They are singular at 90 deg of pitch.
    The outputs bank and heading are within half a turn of the inputs `near_phi` and `near_psi`, where there are any.
    """

    model: Model = eqx.field(static=True)
    values: dict[str, Any]
    aircraft: Aircraft
    altitude: bool = eqx.field(static=True, default=True)
    held: tuple[str, ...] = eqx.field(static=True, default=())
    heading: bool = eqx.field(static=True, default=True)
    euler: bool = eqx.field(static=True, default=False)

    @property
    def by_angles(self) -> bool:
        """Whether the states of attitude are Euler angles."""
        return self.euler or "phi" in self.held or "theta" in self.held

    @property
    def angles(self) -> tuple[str, ...]:
        """Simulated angles of attitude."""
        return tuple(n for n in ANGLES if n not in self.held and (n != "psi" or self.heading))

    @property
    def states(self) -> tuple[str, ...]:
        """Flight states, attitude, altitude, gusts, and lagged separation points."""
        attitude = self.angles if self.by_angles else QUATERNION
        return (*(n for n in RIGID if n not in self.held), *attitude, *self.after)

    @property
    def start(self) -> tuple[str, ...]:
        """The same with angles of attitude."""
        return (*(n for n in RIGID if n not in self.held), *self.angles, *self.after)

    @property
    def envelope(self) -> Mapping[str, tuple[float, float]]:
        """Bounds far beyond any flight."""
        return ENVELOPE

    @property
    def state_outputs(self) -> tuple[str, ...]:
        """States that sensors measure directly; bank and heading are computed to the turn."""
        computed = (*QUATERNION, "phi", "psi")
        return tuple(name for name in super().state_outputs if name not in computed)

    def state_at_start(self, start: Float[Array, " b"]) -> Float[Array, " s"]:
        """The state vector from an initial state with angles of attitude."""
        if self.by_angles:
            return start
        given = dict(zip(self.start, start, strict=True))
        turned = Attitude.of(given["phi"], given["theta"], given.get("psi", jnp.zeros_like(start[0])))
        given |= dict(zip(QUATERNION, turned, strict=True))
        return jnp.stack([given[name] for name in self.states])

    def named(self, x: Float[Array, " s"]) -> dict[str, Any]:
        """The state by name, with bank, pitch, heading and the direction of gravity."""
        state = dict(zip(self.states, x, strict=True))
        if self.by_angles:
            return state
        attitude = Attitude(*(state.pop(name) for name in QUATERNION))
        return state | dict(zip(ANGLES, attitude.angles, strict=True)) | {"down": attitude.down}

    def motion(self, x: Float[Array, " s"], u: Row) -> tuple[Float[Array, " s"], dict[str, Any]]:
        """Derivative of the state, and all outputs."""
        rates, outputs = self.rates(x, u)
        return jnp.stack(rates), outputs

    def rates(self, x: Float[Array, " s"], u: Row) -> tuple[list[Any], dict[str, Any]]:
        """Derivatives of the states one by one, and all outputs."""
        state, s = self.named(x), self.flow_signals(x, u)
        nothing = jnp.zeros_like(s["alpha"])
        decay, gust_rate = self.mean_gust_rates(state, s) if self.model.disturbances else ([], nothing)
        path = dict.fromkeys(("beta", "p", "r", "phi"), nothing) | s
        path |= {name: state[name] for name in FLOW if name in state}
        path.setdefault("down", down_of(path["phi"], path["theta"]))
        now = motion_of_aircraft(
            lambda rate: self.flow(state, s | {"alpha_dot": rate + gust_rate}),
            s,
            path,
            self.aircraft,
            implicit=self.implicit,
            axes=self.model.axes,
            prescribed=self.held,
        )
        alpha_dot = now.rates["alpha"] + gust_rate
        changing = dict(now.rates) | dict(zip(RATES, now.rotation, strict=True))
        derivative = [changing[name] for name in RIGID if name not in self.held]
        derivative += self._attitude_rates(x, path)
        if self.altitude:
            derivative.append(changing["altitude"])
        derivative += decay
        derivative += self.separation_rates(state, s | {"alpha_dot": alpha_dot})
        accelerations = {f"{n}_dot": x for n, x in zip(RATES, now.rotation, strict=True)}
        outputs = accelerometers(now, path, self.aircraft) | accelerations | {"alpha_dot": alpha_dot}
        outputs |= {n: s[n] for n in (*RIGID, "theta", "altitude") if n in s}
        outputs |= {n: _near(path[n], u.get(f"near_{n}")) for n in ("phi", "psi") if n in path}
        return derivative, outputs | {n: now.flow[n] for n in ("X", *self.model.coefficients)}

    def _attitude_rates(self, x: Float[Array, " s"], path: Mapping[str, Any]) -> list[Any]:
        rates = (path["p"], path["q"], path["r"])
        if self.by_angles:
            turned = euler_rates(rates, path["phi"], path["theta"])
            return [turned[ANGLES.index(name)] for name in self.angles]
        first = self.states.index(QUATERNION[0])
        return list(Attitude(*(x[first + i] for i in range(4))).turned(rates))


def _near(angle: Any, other: Any) -> Any:
    """The angle plus whole turns that is nearest to `other`, rad."""
    return angle if other is None else angle + TURN * jnp.round((other - angle) / TURN)
