"""The aircraft flown through recorded inputs: longitudinal equations of motion with the effects of any model.

States airspeed, alpha, theta, q, altitude, the gusts of the model and, where the separation point lags, X. What the
aircraft does laterally is prescribed as recorded: p, r, beta, phi and the lateral specific force, which follows from
the others where no accelerometer gives it. Flat earth. In gusts airspeed and alpha are states over ground; vane, pitot
tube and aerodynamics have those of the flow. A gust is the same over the whole aircraft, and does not turn it.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from bayes_aero.dynamics.output_channels import FLIGHT
from bayes_aero.dynamics.system import Row, System
from bayes_aero.effect import Stage
from bayes_aero.flight.aircraft import Aircraft
from bayes_aero.model.model import Model
from bayes_aero.physics.atmosphere import air
from bayes_aero.physics.flightpath import motion_of_path, side_force
from bayes_aero.physics.forces import pitch_acceleration, specific_force
from bayes_aero.physics.kinematics import Rotation, lever_arm

ENVELOPE = {"airspeed": (5.0, 1500.0), "alpha": (-1.0, 1.2), "theta": (-1.5, 1.5), "q": (-4.0, 4.0), "X": (-0.5, 1.5)}
LATERAL = ("p", "r", "p_dot", "r_dot", "beta", "phi", "ay")  # at rest where they were not recorded
LEAST_LAG = 0.2  # chords: some hundredth of a second, and slow enough for the finest step; less is no lag
TOLERANCE = 1e-12  # rad/s, of alpha-dot
UNIQUE = 0.1  # least slope of the equation of alpha-dot; at zero two motions meet
MOST = 60  # iterations: bisection alone would need 45


class Longitudinal(System):
    """One aircraft with its model at given parameter values; `aircraft` is the actual one.

    `altitude` says whether the altitude is a state. Without a recorded density it must be: density is then ISA's.
    """

    model: Model = eqx.field(static=True)
    values: dict[str, Any]
    aircraft: Aircraft
    altitude: bool = eqx.field(static=True, default=True)

    @property
    def lagged(self) -> bool:
        """Whether the separation point is a state."""
        return any(e.stage is Stage.LAG for e in self.model.acting)

    @property
    def states(self) -> tuple[str, ...]:
        """Flight states, gusts, and X where it lags."""
        gusts = tuple(d.state for d in self.model.disturbances)
        return (*FLIGHT, *(("altitude",) if self.altitude else ()), *gusts, *(("X",) if self.lagged else ()))

    @property
    def shown(self) -> tuple[str, ...]:
        """All, but in gusts vane and pitot tube show the flow."""
        return tuple(name for name in self.states if not (self.model.disturbances and name in ("airspeed", "alpha")))

    @property
    def envelope(self) -> Mapping[str, tuple[float, float]]:
        """Far beyond any flight: where the equations lose their meaning."""
        return ENVELOPE

    @property
    def implicit(self) -> bool:
        """Whether lift depends on alpha-dot at the same instant: directly, or through a separation without lag."""
        before = (Stage.INCIDENCE, Stage.SEPARATION)
        asking = [e.stage for e in self.model.acting if "alpha_dot" in e.channels]
        return any(not self.lagged if stage in before else True for stage in asking)

    def motion(self, x: Float[Array, " s"], u: Row) -> tuple[Float[Array, " s"], dict[str, Any]]:
        """Derivative of the state, and everything that can be measured."""
        state, s = self._signals(x, u)
        over_ground = {name: state[name] for name in ("airspeed", "alpha")}
        decay, gust_rate = self._gusts(state, s)
        pressure = 0.5 * s["density"] * jnp.square(s["airspeed"])
        nothing = jnp.zeros_like(s["alpha"])
        lateral = {name: u.get(name, nothing) for name in LATERAL}

        still = Rotation(lateral["p"], s["q"], lateral["r"], lateral["p_dot"], nothing, lateral["r_dot"])
        side_arm = lever_arm(still, self.aircraft.accelerometer)[1]  # q-dot does not enter it

        def path(rate):
            """Flow at this alpha-dot, the specific force at the CG and the flight path's motion that follows."""
            known = self._flow(state, s | {"alpha_dot": rate + gust_rate})
            fx, fz = specific_force(known["CL"], known["CD"], s["alpha"], pressure, s["thrust"], self.aircraft)
            moving, side = lateral | s | over_ground, nothing
            if "ay" in u:
                side = lateral["ay"] - side_arm
            elif "beta_dot" in u:
                side = side_force(moving, fx, fz)
            return known, (fx, fz), motion_of_path(moving, (fx, side, fz))

        rate = self._alpha_dot(lambda a: path(a)[2]["alpha"]) if self.implicit else path(nothing)[2]["alpha"]
        known, (fx, fz), moved = path(rate)
        total = (known["CL"], known["CD"], known["Cm"])
        p, r = lateral["p"], lateral["r"]
        q_dot = pitch_acceleration(*total, s["alpha"], pressure, s["thrust"], p, r, self.aircraft)
        rotation = Rotation(p, s["q"], r, lateral["p_dot"], q_dot, lateral["r_dot"])
        arm_x, _, arm_z = lever_arm(rotation, self.aircraft.accelerometer)
        derivative = [moved["airspeed"], rate, moved["theta"], q_dot]
        if self.altitude:
            derivative.append(moved["altitude"])
        derivative += decay
        if self.lagged:
            static = self.model.static_separation(self.values, s | {"alpha_dot": rate + gust_rate}, self.aircraft)
            lag = jnp.maximum(self.model.lag(self.values), LEAST_LAG) * self.aircraft.chord / s["airspeed"]
            derivative.append((static - state["X"]) / lag)
        outputs = state | {name: s[name] for name in ("airspeed", "alpha")}
        outputs |= {"ax": fx + arm_x, "az": fz + arm_z, "q_dot": q_dot, "alpha_dot": rate + gust_rate, "X": known["X"]}
        return jnp.stack(derivative), outputs | dict(zip(("CL", "CD", "Cm"), total, strict=True))

    def settled(self, x: Float[Array, " s"], u: Row) -> Float[Array, " s"]:
        """Begins with the separation point at its static value."""
        if not self.lagged:
            return x
        _, s = self._signals(x, u)
        static = self.model.static_separation(self.values, s | {"alpha_dot": jnp.zeros_like(s["alpha"])}, self.aircraft)
        return x.at[-1].set(static)

    def noise_density(self, x: Float[Array, " s"], u: Row) -> Float[Array, " s"]:
        """Of the gusts: twice their variance over their correlation time."""
        power = {d.state: 2.0 * jnp.square(self.values[d.intensity]) for d in self.model.disturbances}
        return self.decay(x, u) * jnp.stack([jnp.asarray(power.get(name, 0.0)) for name in self.states])

    def decay(self, x: Float[Array, " s"], u: Row) -> Float[Array, " s"]:
        """Of the gusts: one over their correlation time."""
        _, s = self._signals(x, u)
        rate = {d.state: d.rate(self.values, s, self.aircraft) for d in self.model.disturbances}
        return jnp.stack([rate.get(name, jnp.zeros_like(x[0])) for name in self.states])

    def start_covariance(self, x: Float[Array, " s"], u: Row, deviation: Float[Array, " s"]) -> Float[Array, "s s"]:
        """Gusts begin anywhere in their stationary distribution; the flow was measured, the motion over ground not."""
        intensity = {d.state: self.values[d.intensity] for d in self.model.disturbances}
        spread = jnp.stack([intensity.get(name, y) for name, y in zip(self.states, deviation, strict=True)])
        places = jnp.array([self.states.index(name) for name in ("airspeed", "alpha")])

        def flow(x):
            _, s = self._signals(x, u)
            return x.at[places].set(jnp.stack([s["airspeed"], s["alpha"]]))

        factor = jnp.linalg.solve(jax.jacfwd(flow)(x), jnp.diag(spread))
        return factor @ factor.T

    def _gusts(self, state: Mapping[str, Any], s: Mapping[str, Any]) -> tuple[list[Any], Any]:
        """Mean rates of the gust states, and that of alpha which they bring; their white noise has no rate."""
        gusts = {d.state: state[d.state] for d in self.model.disturbances}
        decay = {d.state: -d.rate(self.values, s, self.aircraft) * state[d.state] for d in self.model.disturbances}
        over_ground = dict(s) | {name: state[name] for name in ("airspeed", "alpha")}
        alpha = lambda g: self.model.inflow(self.values, over_ground | g, self.aircraft)["alpha"]  # noqa: E731
        return list(decay.values()), jax.jvp(alpha, (gusts,), (decay,))[1] if gusts else jnp.zeros_like(s["alpha"])

    def _signals(self, x: Float[Array, " s"], u: Row) -> tuple[dict[str, Any], dict[str, Any]]:
        """The state by name, and what effects may depend on, of the flow, by the names of the recorded channels."""
        state = dict(zip(self.states, x, strict=True))
        s = dict(u) | {name: value for name, value in state.items() if name != "X"}
        s |= self.model.inflow(self.values, s, self.aircraft)
        if "density" not in s:
            s["density"] = air(s["altitude"])[0]
        if "sound" in u or "altitude" in s:
            s["mach"] = s["airspeed"] / (u["sound"] if "sound" in u else air(s["altitude"])[1])
        s.setdefault("thrust", jnp.zeros_like(s["alpha"]))
        return state, s

    def _flow(self, state: Mapping[str, Any], s: Mapping[str, Any]) -> dict[str, Any]:
        if self.lagged:
            return self.model.flow(self.values, s, self.aircraft, X=state["X"])
        return self.model.flow(self.values, s, self.aircraft)

    def _alpha_dot(self, rate_of) -> Float[Array, ""]:
        """Solve rate = rate_of(rate): through the separation point lift depends on alpha-dot itself.

        The right side falls as alpha-dot rises (more separation costs lift while alpha falls), so the root lies between
        zero and rate_of(0); Newton's steps that leave the shrinking bracket are replaced by its middle. A fixed-point
        iteration, of gain 0.9 to 2.7, would not do. Derivatives are those of the implicit function. Where the right
        side rises (a negative hysteresis time) the motion is soon not unique any more: then the result is not a number.
        """

        def bracketed(excess, first):
            def going(state):
                _, _, _, step, _, count = state
                return (jnp.abs(step) > TOLERANCE) & (count < MOST)

            def closer(state):
                low, high, rate, _, _, count = state
                value, slope = jax.jvp(excess, (rate,), (jnp.ones_like(rate),))
                low, high = jnp.where(value < 0.0, rate, low), jnp.where(value > 0.0, rate, high)
                newton = rate - value / jnp.where(slope > 0.0, slope, 1.0)
                outside = (newton < low) | (newton > high) | ~(slope > 0.0)
                new = jnp.where(outside, 0.5 * (low + high), newton)
                return low, high, new, new - rate, slope, count + 1

            endless, one = jnp.full_like(first, jnp.inf), jnp.ones_like(first)
            begin = (jnp.minimum(first, 0.0), jnp.maximum(first, 0.0), 0.5 * first, endless, one, 0)
            _, _, rate, _, slope, _ = jax.lax.while_loop(going, closer, begin)
            return rate, slope

        first = rate_of(jnp.zeros(()))
        root = jax.lax.custom_root(
            lambda rate: rate - rate_of(rate), first, bracketed, lambda g, y: y / g(1.0), has_aux=True
        )
        rate, slope = root  # type: ignore[misc]
        return jnp.where(slope > UNIQUE, rate, jnp.nan)
