"""Equations of motion at one instant: from the flow's coefficients to the motion of the aircraft in pitch and climb.

What it does laterally (sideslip, bank, roll and yaw rate) is given. Flat earth. Sources: Etkin and Reid, *Dynamics of
Flight*, 3rd ed. 1996, ch. 4; Klein and Morelli, *Aircraft System Identification*, 2006, ch. 3.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from bayes_aero.flight.aircraft import Aircraft
from bayes_aero.physics.flightpath import motion_of_path, side_force
from bayes_aero.physics.forces import pitch_acceleration, specific_force
from bayes_aero.physics.kinematics import Rotation, lever_arm

TOLERANCE = 1e-12  # rad/s, of alpha-dot
UNIQUE = 0.1  # least slope of the equation of alpha-dot; at zero two motions meet
MOST = 60  # iterations: bisection alone would need 50


class Motion(NamedTuple):
    """Flow at one instant (CL, CD, Cm and all else that effects build); specific force at the CG along body axes, m/s2;
    time derivatives of airspeed (m/s2), alpha, theta (rad/s) and altitude (m/s); pitch acceleration, rad/s2."""

    flow: Mapping[str, Any]
    force: tuple[Any, Any, Any]
    rates: Mapping[str, Any]
    q_dot: Any


def motion_of_aircraft(
    flow: Callable[[Any], Mapping[str, Any]],
    air: Mapping[str, Any],
    path: Mapping[str, Any],
    aircraft: Aircraft,
    *,
    implicit: bool,
) -> Motion:
    """Forces, moments and the motion that follows.

    The lateral specific force follows from `ay` at the accelerometer, else from the sideslip's rate `beta_dot`, else 0.

    Args:
        flow: what effects build, CL, CD and Cm among it, at an alpha-dot in rad/s.
        air: `alpha`, `airspeed` and `density` of the air that is met, and `thrust`; SI.
        path: the motion over ground, SI: `airspeed`, `alpha`, `beta`, `theta`, `phi`, `p`, `q`, `r`; with `ay` also
            `p_dot` and `r_dot`.
        aircraft: the actual one.
        implicit: whether the flow depends on alpha-dot at all.
    """
    nothing = jnp.zeros_like(air["alpha"])
    pressure = 0.5 * air["density"] * jnp.square(air["airspeed"])

    def follow(rate: Any) -> tuple[Mapping[str, Any], tuple[Any, Any, Any], dict[str, Any]]:
        known = flow(rate)
        fx, fz = specific_force(known["CL"], known["CD"], air["alpha"], pressure, air["thrust"], aircraft)
        side = nothing
        if "ay" in path:
            side = path["ay"] - _lever_arm(path, nothing, aircraft)[1]  # q-dot does not enter it
        elif "beta_dot" in path:
            side = side_force(path, fx, fz)
        return known, (fx, side, fz), motion_of_path(path, (fx, side, fz))

    rate = alpha_dot(lambda rate: follow(rate)[2]["alpha"]) if implicit else follow(nothing)[2]["alpha"]
    known, force, rates = follow(rate)
    CL, CD, Cm = (known[name] for name in ("CL", "CD", "Cm"))
    q_dot = pitch_acceleration(CL, CD, Cm, air["alpha"], pressure, air["thrust"], path["p"], path["r"], aircraft)
    return Motion(known, force, rates | {"alpha": rate}, q_dot)


def accelerometers(now: Motion, path: Mapping[str, Any], aircraft: Aircraft) -> dict[str, Any]:
    """What accelerometers away from the CG feel, m/s2; `path` as in `motion_of_aircraft`, with `p_dot` and `r_dot`."""
    arm = _lever_arm(path, now.q_dot, aircraft)
    return {name: f + x for name, f, x in zip(("ax", "ay", "az"), now.force, arm, strict=True)}


def _lever_arm(path: Mapping[str, Any], q_dot: Any, aircraft: Aircraft) -> tuple[Any, Any, Any]:
    rotation = Rotation(path["p"], path["q"], path["r"], path["p_dot"], q_dot, path["r_dot"])
    return lever_arm(rotation, aircraft.accelerometer)


def alpha_dot(rate_of: Callable[[Any], Any]) -> Float[Array, ""]:
    """Solve rate = rate_of(rate): through the separation point lift depends on alpha-dot itself.

    As a rule the right side falls as alpha-dot rises (more separation costs lift while alpha falls): the root lies
    between zero and rate_of(0). Where it rises (a negative `CLadot` or hysteresis time) the root lies beyond, and soon
    the motion is not unique any more: then the result is not a number. Newton's steps that leave the shrinking bracket
    are replaced by its middle. A fixed-point iteration, of gain 0.9 to 2.7, would not do. Derivatives are those of the
    implicit function.
    """

    def bracketed(excess, first):
        def going(state):
            _, _, _, step, _, count = state
            return (jnp.abs(step) > TOLERANCE) & (count < MOST)

        def closer(state):
            low, high, rate, _, least, count = state
            value, slope = jax.jvp(excess, (rate,), (jnp.ones_like(rate),))
            low, high = jnp.where(value < 0.0, rate, low), jnp.where(value > 0.0, rate, high)
            newton = rate - value / jnp.where(slope > 0.0, slope, 1.0)
            outside = (newton < low) | (newton > high) | ~(slope > 0.0)
            new = jnp.where(outside, 0.5 * (low + high), newton)
            return low, high, new, new - rate, jnp.minimum(slope, least), count + 1

        endless = jnp.full_like(first, jnp.inf)
        farthest = first / UNIQUE  # of a slope that is nowhere less
        begin = (jnp.minimum(farthest, 0.0), jnp.maximum(farthest, 0.0), 0.5 * first, endless, endless, 0)
        _, _, rate, _, least, _ = jax.lax.while_loop(going, closer, begin)
        return rate, least

    first = rate_of(jnp.zeros(()))
    root = jax.lax.custom_root(
        lambda rate: rate - rate_of(rate), first, bracketed, lambda g, y: y / g(1.0), has_aux=True
    )
    rate, least = root  # type: ignore[misc]
    return jnp.where(least > UNIQUE, rate, jnp.nan)
