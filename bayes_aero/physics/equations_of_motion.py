"""Equations of motion at one instant: from the flow's coefficients to the motion of the aircraft.

Six degrees of freedom, of which any may be prescribed. Flat earth. Sources: Etkin and Reid, *Dynamics of Flight*,
3rd ed. 1996, ch. 4; Klein and Morelli, *Aircraft System Identification*, 2006, ch. 3.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from bayes_aero.flight.aircraft import Aircraft
from bayes_aero.flight.channel import Axis
from bayes_aero.physics.coefficients import lateral_force, moments, specific_force
from bayes_aero.physics.flightpath import (
    RATES,
    Rotation,
    angular_accelerations,
    down_of,
    lever_arm,
    motion_in_plane,
    side_force,
    sideslip_rate,
)

TOLERANCE = 1e-12  # rad/s, of alpha-dot
MIN_SLOPE = 0.1  # of the equation of alpha-dot; at zero the motion is not unique
MAX_ITERATIONS = 60  # iterations: bisection alone would need 50
LONGITUDINAL = (Axis.LONGITUDINAL,)


class AircraftMotion(NamedTuple):
    """Motion at one instant."""

    flow: Mapping[str, Any]  # coefficients and other quantities of the effects
    force: tuple[Any, Any, Any]  # specific force at the CG along body axes, m/s2
    rates: Mapping[str, Any]  # time derivatives of airspeed (m/s2), alpha, beta (rad/s) and altitude (m/s)
    rotation: tuple[Any, Any, Any]  # p_dot, q_dot, r_dot, rad/s2

    @property
    def q_dot(self) -> Any:
        """Pitch acceleration, rad/s2."""
        return self.rotation[1]


def motion_of_aircraft(
    flow: Callable[[Any], Mapping[str, Any]],
    air: Mapping[str, Any],
    path: Mapping[str, Any],
    aircraft: Aircraft,
    *,
    implicit: bool,
    axes: Collection[Axis] = LONGITUDINAL,
    prescribed: Collection[str] = ("p", "r"),
) -> AircraftMotion:
    """Forces, moments and the motion that follows.

    Forces of `axes` are those of the flow. Others are given: in the plane of symmetry as `force_x` and `force_z`; the
    lateral one follows from `ay` at the accelerometer, else from the sideslip's rate `beta_dot`, else it is 0.

    `flow` gives the coefficients and other quantities of the effects as a function of alpha-dot in rad/s, on which they
    depend where `implicit`. `air`: `alpha`, `airspeed` and `density` of the flow, and `thrust`; SI. `path`: the motion
    over ground, SI: `airspeed`, `alpha`, `beta`, `p`, `q`, `r`, and `theta` and `phi` or `down`, the direction of
    gravity in body axes; the angular accelerations of `prescribed` rates (else 0). `prescribed`: those of `p`, `q`, `r`
    that are given, and `alpha`, if it is, with its rate `alpha_dot`.
    """
    nothing = jnp.zeros_like(air["alpha"])
    pressure = 0.5 * air["density"] * jnp.square(air["airspeed"])
    down = path["down"] if "down" in path else down_of(path["phi"], path["theta"])

    def forces(known: Mapping[str, Any]) -> tuple[Any, Any, Any]:
        if Axis.LONGITUDINAL in axes:
            fx, fz = specific_force(known["CL"], known["CD"], air["alpha"], pressure, air["thrust"], aircraft)
        else:
            fx, fz = path["force_x"], path["force_z"]
        if Axis.LATERAL in axes:
            return fx, lateral_force(known["CY"], pressure, aircraft), fz
        if "ay" in path:
            p_dot, q_dot, r_dot = (path.get(f"{n}_dot", nothing) for n in RATES)
            spin = Rotation(path["p"], path["q"], path["r"], p_dot, q_dot, r_dot)
            return fx, path["ay"] - lever_arm(spin, aircraft.accelerometer)[1], fz  # q-dot does not enter it
        return fx, side_force(path, fx, fz) if "beta_dot" in path else nothing, fz

    if "alpha" in prescribed:
        rate = path["alpha_dot"]
    elif implicit:
        rate = alpha_dot(lambda rate: motion_in_plane(path, forces(flow(rate)), down)["alpha"])
    else:
        rate = None
    known = flow(nothing if rate is None else rate)
    force = forces(known)
    rates = motion_in_plane(path, force, down) | {"beta": sideslip_rate(path, force, down)}
    rates |= {} if rate is None else {"alpha": rate}
    given = {f"{n}_dot": path.get(f"{n}_dot", nothing) for n in RATES if n in prescribed}
    acting = moments(known, force, air, aircraft)
    rotation = angular_accelerations(acting, tuple(path[n] for n in RATES), aircraft, given)  # type: ignore[arg-type]
    return AircraftMotion(known, force, rates, rotation)


def accelerometers(now: AircraftMotion, path: Mapping[str, Any], aircraft: Aircraft) -> dict[str, Any]:
    """Specific force at the accelerometers, m/s2; `path` has the rates p, q, r."""
    p_dot, q_dot, r_dot = now.rotation
    arm = lever_arm(Rotation(path["p"], path["q"], path["r"], p_dot, q_dot, r_dot), aircraft.accelerometer)
    return {name: f + x for name, f, x in zip(("ax", "ay", "az"), now.force, arm, strict=True)}


def alpha_dot(rate_of: Callable[[Any], Any]) -> Float[Array, ""]:
    """Solve rate = rate_of(rate), because lift depends on alpha-dot through the separation point. Usually the right
    side decreases with alpha-dot, and the root is between zero and rate_of(0). Where it increases (a negative `CLadot`
    or hysteresis time) the root is beyond, and for a larger slope the motion is not unique: the result is then NaN.
    Newton steps that leave the bracket are replaced by bisection. A fixed-point iteration would not converge (gain 0.9
    to 2.7). Derivatives are those of the implicit function."""

    def bracketed(excess, first):
        def not_converged(state):
            _, _, _, step, _, count = state
            return (jnp.abs(step) > TOLERANCE) & (count < MAX_ITERATIONS)

        def iterate(state):
            low, high, rate, _, min_slope, count = state
            value, slope = jax.jvp(excess, (rate,), (jnp.ones_like(rate),))
            low, high = jnp.where(value < 0.0, rate, low), jnp.where(value > 0.0, rate, high)
            newton = rate - value / jnp.where(slope > 0.0, slope, 1.0)
            outside = (newton < low) | (newton > high) | ~(slope > 0.0)
            new = jnp.where(outside, 0.5 * (low + high), newton)
            return low, high, new, new - rate, jnp.minimum(slope, min_slope), count + 1

        infinite = jnp.full_like(first, jnp.inf)
        bound = first / MIN_SLOPE  # of the root, if the slope is nowhere smaller
        begin = (jnp.minimum(bound, 0.0), jnp.maximum(bound, 0.0), 0.5 * first, infinite, infinite, 0)
        _, _, rate, _, min_slope, _ = jax.lax.while_loop(not_converged, iterate, begin)
        return rate, min_slope

    first = rate_of(jnp.zeros(()))
    root = jax.lax.custom_root(
        lambda rate: rate - rate_of(rate), first, bracketed, lambda g, y: y / g(1.0), has_aux=True
    )
    rate, min_slope = root  # type: ignore[misc]
    return jnp.where(min_slope > MIN_SLOPE, rate, jnp.nan)
