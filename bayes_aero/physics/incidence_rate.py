"""Rate of change of the angle of attack from vane, gyro and accelerometer, its noise apart from that of lift.

Newton's law across the flight path: alpha-dot is pitch rate, less what specific force and gravity turn the path by.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from bayes_aero.physics.filters import LONG_REACH, differentiate_joined, inside_joined, smooth_joined, smooth_long
from bayes_aero.physics.kinematics import Rotation, lever_arm

RATES = ("p", "q", "r")
KNOTS = (0.4, 0.6, 0.75, 0.85, 0.93)  # shares of the samples at lower alpha; dense where the flow separates
CURVES = 2  # times the one-sided hysteresis is taken from the last alpha-dot
RIDGE = 1e-6  # of the mean square of a column

Operator = Callable[[Float[Array, " n"]], Float[Array, " n"]]


def alpha_rate(
    s: Mapping[str, Array],
    accelerometer: tuple[Any, Any, Any],
    dt: Float[Array, " n"],
    first: Int[Array, " n"],
    last: Int[Array, " n"],
) -> Float[Array, " n"]:
    """alpha-dot, rad/s, of manoeuvres laid end to end: slow part from the vane, fast part from gyro and lift.

    A vane's noise, differentiated, is several times that of gyro and accelerometer, and a one-sided hysteresis makes a
    bias of it; offsets of gyro and accelerometer and gravity are slow. The part that the specific force adds is not
    taken as measured, for it is the measured lift: a lift coefficient that is explained by it is explained by its own
    noise, and lift due to pitch rate and to alpha-dot then come out large, with opposite signs. It is regressed on what
    lift depends on (angle of attack in pieces, their hysteresis, elevator, pitch rate), and the regression is taken:
    two-stage least squares. Near the ends of a manoeuvre the smoothed vane alone.

    Args:
        s: channels (n,) as recorded, SI, with `p_dot`, `q_dot`, `r_dot` in rad/s2.
        accelerometer: its position from the CG, m.
        dt: sampling interval, s.
        first, last: the ends of each sample's manoeuvre.

    Source: Klein and Morelli, *Aircraft System Identification*, 2006, ch. 10 (kinematics); two-stage least squares:
    Wooldridge, *Econometric Analysis of Cross Section and Panel Data*, 2010, ch. 5.
    """
    turning, across = _kinematic(s, accelerometer)

    def smooth(x):
        return smooth_joined(x, first, last)

    vane = smooth(s["alpha"])
    alone, long = (differentiate_joined(x, dt, first, last) for x in (vane, smooth_long(vane)))
    inside = inside_joined(vane.shape[0], first, last) >= LONG_REACH

    def fast(x, smoothed):
        return jnp.where(inside, x - smooth_long(smoothed), 0.0)

    base = jnp.where(inside, long, alone) + fast(turning, smooth(turning))
    return base + _lift_part(s, across, base, smooth, fast)


def _kinematic(s: Mapping[str, Array], accelerometer: tuple[Any, Any, Any]) -> tuple[Array, Array]:
    """What rotation and what specific force at the CG add to alpha-dot, rad/s."""
    rotation = Rotation(*(s[name] for name in (*RATES, *(f"{name}_dot" for name in RATES))))
    arm_x, _, arm_z = lever_arm(rotation, accelerometer)
    sin, cos = jnp.sin(s["alpha"]), jnp.cos(s["alpha"])
    across = ((s["az"] - arm_z) * cos - (s["ax"] - arm_x) * sin) / s["airspeed"]
    turning = s["q"]
    if "beta" in s:
        turning = turning - (s["p"] * cos + s["r"] * sin) * jnp.tan(s["beta"])
    return turning, across


def _lift_part(
    s: Mapping[str, Array],
    across: Float[Array, " n"],
    rate: Float[Array, " n"],
    smooth: Operator,
    fast: Callable[[Array, Array], Array],
) -> Float[Array, " n"]:
    """The fast part of `across` that lift's causes explain; `rate` is alpha-dot without it."""
    names = [name for name in ("alpha", "q", "airspeed", "density", "elevator") if name in s]
    smoothed = dict(zip(names, jax.vmap(smooth)(jnp.stack([s[name] for name in names])), strict=True))
    known = smooth(across)
    response = fast(known, known)
    knots = jnp.quantile(jax.lax.stop_gradient(smoothed["alpha"]), jnp.asarray(KNOTS))
    part = jnp.zeros_like(across)
    for _ in range(CURVES):
        falling = smooth(rate + part)
        even = jax.vmap(fast)(*(2 * (_causes(smoothed, falling, knots),)))
        size = jnp.sqrt(jnp.mean(even**2, axis=1) + 1e-30)
        gram = even @ even.T / jnp.outer(size, size) / even.shape[1]
        right = even @ response / size / even.shape[1]
        share = jnp.linalg.solve(gram + RIDGE * jnp.eye(len(size)), right) / size
        raw = share @ _causes(s, rate + part, knots)
        part = fast(raw, smooth(raw))
    return part


def _causes(s: Mapping[str, Array], rate: Float[Array, " n"], knots: Float[Array, " j"]) -> Float[Array, "c n"]:
    """What lift over mass and airspeed depends on: rows of a regression."""
    weight = s["density"] * s["airspeed"]
    pieces = jnp.maximum(s["alpha"] - knots[:, None], 0.0)
    falling = jnp.minimum(rate, 0.0)
    rows = [s["alpha"][None], pieces, falling[None], falling * pieces, s["q"][None]]
    if "elevator" in s:
        rows.append(s["elevator"][None])
    return weight * jnp.concatenate(rows)
