"""The aircraft in six degrees of freedom, with the effects of any model; any of its states may be held to the record.

States are airspeed, alpha, beta, p, q, r, the attitude as a quaternion, altitude, the gusts of the model and, with a
lag, the separation point X. Held states and their rates are prescribed as recorded. Forces and moments of an axis
without a model are those of the accelerometers and of the prescribed rates. Flat earth.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Iterable, Mapping
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from bayes_aero.dynamics.system import Row, System
from bayes_aero.effect import Stage
from bayes_aero.flight.card import HOLDABLE
from bayes_aero.model.model import Model
from bayes_aero.physics.aircraft import FLIGHT, RIGID, Aircraft, Axis, air
from bayes_aero.physics.coefficients import accelerometers, motion_of_aircraft
from bayes_aero.physics.kinematics import RATES, Attitude, down_of, euler_rates, motion_of_path

# --- Systems in gusts: states over ground, and the flow at vane, pitot tube and wing.

FLOW = ("airspeed", "alpha", "beta")  # changed by gusts; as states they are over ground


class InGusts(System):
    """Gusts of `model` are among the states, as first-order processes; parameter values are `values`."""

    model: Model = eqx.field(static=True)
    values: dict[str, Any]
    aircraft: Aircraft  # with the corrected constants

    @abstractmethod
    def flow_signals(self, x: Float[Array, " s"], u: Row) -> dict[str, Any]:
        """States and inputs by name; `FLOW` of the flow, not over ground."""

    @property
    def state_outputs(self) -> tuple[str, ...]:
        """All states; in gusts all but `FLOW`, because vane and pitot tube measure the flow."""
        return tuple(name for name in self.states if not (self.model.disturbances and name in FLOW))

    def noise_density(self, x: Float[Array, " s"], u: Row) -> Float[Array, " s"]:
        power = {d.state: 2.0 * jnp.square(self.values[d.intensity]) for d in self.model.disturbances}
        return self.decay(x, u) * jnp.stack([jnp.asarray(power.get(name, 0.0)) for name in self.states])

    def decay(self, x: Float[Array, " s"], u: Row) -> Float[Array, " s"]:
        s = self.flow_signals(x, u)
        rate = {d.state: d.rate(self.values, s, self.aircraft) for d in self.model.disturbances}
        return jnp.stack([rate.get(name, jnp.zeros_like(x[0])) for name in self.states])

    def start_covariance(self, x: Float[Array, " s"], u: Row, deviation: Float[Array, " s"]) -> Float[Array, "s s"]:
        """Gusts start in their stationary distribution; the flow was measured, the motion over ground was not."""
        intensity = {d.state: self.values[d.intensity] for d in self.model.disturbances}
        spread = jnp.stack([intensity.get(name, y) for name, y in zip(self.states, deviation, strict=True)])
        flow_states = tuple(name for name in FLOW if name in self.states)
        places = jnp.array([self.states.index(name) for name in flow_states])

        def flow(x):
            s = self.flow_signals(x, u)
            return x.at[places].set(jnp.stack([s[name] for name in flow_states]))

        factor = jnp.linalg.solve(jax.jacfwd(flow)(x), jnp.diag(spread))
        return factor @ factor.T

    def mean_gust_rates(self, state: Mapping[str, Any], s: Mapping[str, Any]) -> tuple[list[Any], Any]:
        """Mean rates of the gust states and the rate of alpha due to them; `state` over ground, `s` of the flow."""
        gusts = {d.state: state[d.state] for d in self.model.disturbances}
        decay = {d.state: -d.rate(self.values, s, self.aircraft) * state[d.state] for d in self.model.disturbances}
        over_ground = dict(s) | {name: state[name] for name in FLOW if name in state}
        alpha = lambda g: self.model.inflow(self.values, over_ground | g, self.aircraft)["alpha"]  # noqa: E731
        return list(decay.values()), jax.jvp(alpha, (gusts,), (decay,))[1] if gusts else jnp.zeros_like(s["alpha"])


class FlightPath(InGusts):
    """Motion from accelerometers and gyros; `named` are its states without gusts."""

    named: tuple[str, ...] = eqx.field(static=True)

    @property
    def states(self) -> tuple[str, ...]:
        return (*self.named, *(d.state for d in self.model.disturbances))

    def flow_signals(self, x: Float[Array, " s"], u: Row) -> dict[str, Any]:
        s = dict(u) | dict(zip(self.states, x, strict=True))
        return s | self.model.inflow(self.values, s, self.aircraft)

    def motion(self, x: Float[Array, " s"], u: Row) -> tuple[Float[Array, " s"], dict[str, Any]]:
        state = dict(zip(self.states, x, strict=True))
        s, flow = dict(u) | state, self.flow_signals(x, u)
        force = (u["force_x"], u["force_y"], u["force_z"])
        rates = motion_of_path(s, force)
        rates["psi"] = euler_rates((s["p"], s["q"], s["r"]), s["phi"], s["theta"])[2]
        derivative = [*(rates[name] for name in self.named), *self.mean_gust_rates(state, flow)[0]]
        return jnp.stack(derivative), state | {n: flow[n] for n in FLOW if n in state}


# --- The aircraft with its effects.

POINTS = ("X", "X_right", "X_left")  # states of separation points: of the whole wing, or of either one
MIN_LAG = 0.2  # chords: some hundredth of a second, still resolved by the finest step
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


class RigidBody(InGusts):
    """An aircraft in six degrees of freedom with its model at given parameter values. Without `altitude` among the
    states density is an input; without `heading` the heading starts at zero and is no output."""

    altitude: bool = eqx.field(static=True, default=True)
    held: tuple[str, ...] = eqx.field(static=True, default=())
    heading: bool = eqx.field(static=True, default=True)
    euler: bool = eqx.field(static=True, default=False)

    @property
    def envelope(self) -> Mapping[str, tuple[float, float]]:
        return ENVELOPE

    @property
    def lagged(self) -> bool:
        return any(e.stage is Stage.LAG for e in self.model.acting)

    @property
    def points(self) -> tuple[str, ...]:
        """States of the lagged separation points: one, or one for the right and one for the left wing."""
        if not self.lagged:
            return ()
        return POINTS[1:] if self.model.two_wings else POINTS[:1]

    @property
    def after(self) -> tuple[str, ...]:
        gusts = tuple(d.state for d in self.model.disturbances)
        return (*(("altitude",) if self.altitude else ()), *gusts, *self.points)

    @property
    def by_angles(self) -> bool:
        return self.euler or "phi" in self.held or "theta" in self.held

    @property
    def angles(self) -> tuple[str, ...]:
        return tuple(n for n in ANGLES if n not in self.held and (n != "psi" or self.heading))

    @property
    def states(self) -> tuple[str, ...]:
        attitude = self.angles if self.by_angles else QUATERNION
        return (*(n for n in RIGID if n not in self.held), *attitude, *self.after)

    @property
    def start(self) -> tuple[str, ...]:
        return (*(n for n in RIGID if n not in self.held), *self.angles, *self.after)

    @property
    def state_outputs(self) -> tuple[str, ...]:
        computed = (*QUATERNION, "phi", "psi")
        return tuple(name for name in super().state_outputs if name not in computed)

    def state_at_start(self, start: Float[Array, " b"]) -> Float[Array, " s"]:
        if self.by_angles:
            return start
        given = dict(zip(self.start, start, strict=True))
        turned = Attitude.of(given["phi"], given["theta"], given.get("psi", jnp.zeros_like(start[0])))
        given |= dict(zip(QUATERNION, turned, strict=True))
        return jnp.stack([given[name] for name in self.states])

    def complete_start(self, x: Float[Array, " s"], u: Row) -> Float[Array, " s"]:
        """The initial state with the separation points at their static values."""
        if not self.lagged:
            return x
        s = self.flow_signals(self.state_at_start(x), u)
        static = self.model.static_points(self.values, s | {"alpha_dot": jnp.zeros_like(s["alpha"])}, self.aircraft)
        return x.at[-len(static) :].set(jnp.stack(static))

    def named(self, x: Float[Array, " s"]) -> dict[str, Any]:
        state = dict(zip(self.states, x, strict=True))
        if self.by_angles:
            return state
        attitude = Attitude(*(state.pop(name) for name in QUATERNION))
        return state | dict(zip(ANGLES, attitude.angles, strict=True)) | {"down": attitude.down}

    def flow_signals(self, x: Float[Array, " s"], u: Row) -> dict[str, Any]:
        s = dict(u) | {name: value for name, value in self.named(x).items() if name not in POINTS}
        s |= self.model.inflow(self.values, s, self.aircraft)
        if "density" not in s:
            s["density"] = air(s["altitude"])[0]
        if "sound" in u or "altitude" in s:
            s["mach"] = s["airspeed"] / (u["sound"] if "sound" in u else air(s["altitude"])[1])
        s.setdefault("thrust", jnp.zeros_like(s["alpha"]))
        return s

    def flow(self, state: Mapping[str, Any], s: Mapping[str, Any]) -> dict[str, Any]:
        """Flow and coefficients by the effects from these signals, with the lagged separation points."""
        lagging = tuple(state[name] for name in self.points)
        X = lagging if len(lagging) > 1 else next(iter(lagging), None)
        return self.model.flow(self.values, s, self.aircraft, X=X)

    def separation_rates(self, state: Mapping[str, Any], s: Mapping[str, Any]) -> list[Any]:
        """Rates of the states after the gusts, the lagged separation points, 1/s; `s` contains alpha-dot."""
        if not self.lagged:
            return []
        static = self.model.static_points(self.values, s, self.aircraft)
        lag = jnp.maximum(self.model.lag(self.values), MIN_LAG) * self.aircraft.chord / s["airspeed"]
        return [(value - state[name]) / lag for name, value in zip(self.points, static, strict=True)]

    def motion(self, x: Float[Array, " s"], u: Row) -> tuple[Float[Array, " s"], dict[str, Any]]:
        state, s = self.named(x), self.flow_signals(x, u)
        decay, gust_rate = self.mean_gust_rates(state, s)
        path = dict.fromkeys(("beta", "p", "r", "phi"), jnp.zeros_like(s["alpha"])) | s
        path |= {name: state[name] for name in FLOW if name in state}
        path.setdefault("down", down_of(path["phi"], path["theta"]))
        # lift depends on alpha-dot at the same instant: directly, or through a separation without lag
        lagging = (Stage.INCIDENCE, Stage.SEPARATION) if self.lagged else ()
        implicit = any(e.stage not in lagging for e in self.model.acting if "alpha_dot" in e.channels)
        flow = lambda rate: self.flow(state, s | {"alpha_dot": rate + gust_rate})  # noqa: E731
        now = motion_of_aircraft(
            flow, s, path, self.aircraft, implicit=implicit, axes=self.model.axes, prescribed=self.held
        )
        rotation = dict(zip(RATES, now.rotation, strict=True))
        rates, changing = (path["p"], path["q"], path["r"]), {**now.rates, **rotation}
        if self.by_angles:
            changing |= dict(zip(ANGLES, euler_rates(rates, path["phi"], path["theta"]), strict=True))
        else:
            attitude = Attitude(*(x[self.states.index(name)] for name in QUATERNION))
            changing |= dict(zip(QUATERNION, attitude.turned(rates), strict=True))
        s = s | {"alpha_dot": now.rates["alpha"] + gust_rate}
        after = [*([now.rates["altitude"]] if self.altitude else []), *decay, *self.separation_rates(state, s)]
        derivative = [changing[name] for name in self.states[: len(self.states) - len(after)]]
        outputs = accelerometers(now, path, self.aircraft) | {f"{n}_dot": x for n, x in rotation.items()}
        outputs |= {n: s[n] for n in ("alpha_dot", *RIGID, "theta", "altitude") if n in s}
        for n in ("phi", "psi"):
            if n in path:
                turns = TURN * jnp.round((u[f"near_{n}"] - path[n]) / TURN) if f"near_{n}" in u else 0.0
                outputs[n] = path[n] + turns
        return jnp.stack([*derivative, *after]), outputs | {n: now.flow[n] for n in ("X", *self.model.coefficients)}


# --- Longitudinal equations of motion with the effects of any model.
# States are airspeed, alpha, theta, q, altitude, the gusts of the model and, with a lag, the separation point X. The
# lateral motion is prescribed as recorded: p, r, beta, phi and the lateral specific force, which follows from the
# others where no accelerometer measures it. Flat earth. In gusts the states airspeed and alpha are over ground; vane,
# pitot tube and aerodynamics use those of the flow. A gust is uniform over the aircraft and has no angular velocity.

LATERAL = ("p", "r", "p_dot", "r_dot", "beta", "phi", "ay")  # zero where they were not recorded


class Longitudinal(RigidBody):
    """The aircraft in its plane of symmetry."""

    held: tuple[str, ...] = eqx.field(static=True, default=HELD[Axis.LATERAL])

    @property
    def states(self) -> tuple[str, ...]:
        return (*FLIGHT, *self.after)

    start = states
