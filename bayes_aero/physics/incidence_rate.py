"""Rate of change of the angle of attack from vane, gyro and accelerometer, its noise apart from that of lift.

Newton's law across the flight path: alpha-dot is pitch rate, less what specific force and gravity turn the path by.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from bayes_aero.physics.filters import LONG_REACH, differentiate_joined, inside_joined, smooth_joined, smooth_long
from bayes_aero.physics.kinematics import RATES, Rotation, lever_arm

KNOTS = (0.4, 0.6, 0.75, 0.85, 0.93)  # shares of the samples at lower alpha; dense where the flow separates
CURVES = 2  # times the one-sided hysteresis is taken from the last alpha-dot
RIDGE = 1e-6  # of the mean square of a column

Operator = Callable[[Float[Array, " n"]], Float[Array, " n"]]


class LiftRegression(NamedTuple):
    """What the specific force adds to alpha-dot, regressed on what lift depends on.

    `share` (c,) of each cause (see `_causes`), `knots` (j,) in rad, and the part of alpha-dot (n,) in rad/s that the
    hysteresis was taken with.
    """

    share: Float[Array, " c"]
    knots: Float[Array, " j"]
    before: Float[Array, " n"]


def alpha_rate(
    s: Mapping[str, Array],
    regression: LiftRegression,
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
        s: channels (n,), SI, with `p_dot`, `q_dot`, `r_dot` in rad/s2.
        regression: of the record as it was recorded (`lift_regression`), held whatever is corrected in `s`.
        dt: sampling interval, s.
        first, last: the ends of each sample's manoeuvre.

    Source: Klein and Morelli, *Aircraft System Identification*, 2006, ch. 10 (kinematics); two-stage least squares:
    Wooldridge, *Econometric Analysis of Cross Section and Panel Data*, 2010, ch. 5.
    """
    smooth, fast, base = _parts(s, dt, first, last)
    raw = regression.share @ _causes(s, base + regression.before, regression.knots)
    return base + fast(raw, smooth(raw))


def lift_regression(
    s: Mapping[str, Array],
    accelerometer: tuple[Any, Any, Any],
    dt: Float[Array, " n"],
    first: Int[Array, " n"],
    last: Int[Array, " n"],
) -> LiftRegression:
    """Regression of the fast part that specific force adds to alpha-dot on lift's causes; arguments as `alpha_rate`.

    `accelerometer` is its position from the CG, m.
    """
    smooth, fast, base = _parts(s, dt, first, last)
    names = [name for name in ("alpha", "q", "airspeed", "density", "elevator") if name in s]
    smoothed = dict(zip(names, jax.vmap(smooth)(jnp.stack([s[name] for name in names])), strict=True))
    known = smooth(_from_force(s, accelerometer))
    response = fast(known, known)
    knots = jnp.quantile(smoothed["alpha"], jnp.asarray(KNOTS))
    before = part = jnp.zeros_like(base)
    share = jnp.zeros(0)
    for _ in range(CURVES):
        causes = _causes(smoothed, smooth(base + part), knots)
        even = jax.vmap(fast)(causes, causes)
        size = jnp.sqrt(jnp.mean(even**2, axis=1) + 1e-30)
        gram = even @ even.T / jnp.outer(size, size) / even.shape[1]
        right = even @ response / size / even.shape[1]
        share = jnp.linalg.solve(gram + RIDGE * jnp.eye(len(size)), right) / size
        raw = share @ _causes(s, base + part, knots)
        before, part = part, fast(raw, smooth(raw))
    return LiftRegression(share, knots, before)


def _parts(
    s: Mapping[str, Array], dt: Float[Array, " n"], first: Int[Array, " n"], last: Int[Array, " n"]
) -> tuple[Operator, Callable[[Array, Array], Array], Float[Array, " n"]]:
    """The smoothing filter, what takes the fast part of a signal, and alpha-dot without the specific force's part."""

    def smooth(x):
        return smooth_joined(x, first, last)

    vane = smooth(s["alpha"])
    alone, long = (differentiate_joined(x, dt, first, last) for x in (vane, smooth_long(vane)))
    inside = inside_joined(vane.shape[0], first, last) >= LONG_REACH

    def fast(x, smoothed):
        return jnp.where(inside, x - smooth_long(smoothed), 0.0)

    turning = s["q"]
    if "beta" in s:
        turning = turning - (s["p"] * jnp.cos(s["alpha"]) + s["r"] * jnp.sin(s["alpha"])) * jnp.tan(s["beta"])
    return smooth, fast, jnp.where(inside, long, alone) + fast(turning, smooth(turning))


def _from_force(s: Mapping[str, Array], accelerometer: tuple[Any, Any, Any]) -> Float[Array, " n"]:
    """What specific force at the CG adds to alpha-dot, rad/s."""
    rotation = Rotation(*(s[name] for name in (*RATES, *(f"{name}_dot" for name in RATES))))
    arm_x, _, arm_z = lever_arm(rotation, accelerometer)
    return ((s["az"] - arm_z) * jnp.cos(s["alpha"]) - (s["ax"] - arm_x) * jnp.sin(s["alpha"])) / s["airspeed"]


def _causes(s: Mapping[str, Array], rate: Float[Array, " n"], knots: Float[Array, " j"]) -> Float[Array, "c n"]:
    """What lift over mass and airspeed depends on: rows of a regression."""
    weight = s["density"] * s["airspeed"]
    pieces = jnp.maximum(s["alpha"] - knots[:, None], 0.0)
    falling = jnp.minimum(rate, 0.0)
    rows = [s["alpha"][None], pieces, falling[None], falling * pieces, s["q"][None]]
    if "elevator" in s:
        rows.append(s["elevator"][None])
    return weight * jnp.concatenate(rows)
