"""Rate of change of the angle of attack from vane, gyro and accelerometer, with noise independent of that of lift.

Newton's law normal to the flight path: alpha-dot is the pitch rate less the rotation of the path by specific force and
gravity.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from bayes_aero.physics.filters import LONG_REACH, differentiate_joined, inside_joined, smooth_joined, smooth_long
from bayes_aero.physics.flightpath import RATES, Rotation, lever_arm

KNOTS = (0.4, 0.6, 0.75, 0.85, 0.93)  # shares of the samples at lower alpha; dense where the flow separates
ITERATIONS = 2  # of the regression, because the hysteresis depends on alpha-dot
RIDGE = 1e-6  # of the mean square of a column

Series = Float[Array, " n"]
Index = Int[Array, " n"]
Operator = Callable[[Series], Series]


class LiftRegression(NamedTuple):
    """Regression of the part of alpha-dot due to specific force on the variables on which lift depends."""

    share: Float[Array, " c"]  # coefficients of the regressors (see `_causes`)
    knots: Float[Array, " j"]  # rad
    before: Series  # part of alpha-dot due to specific force, rad/s, of which the hysteresis was computed


def alpha_rate(s: Mapping[str, Array], regression: LiftRegression, dt: Series, first: Index, last: Index) -> Series:
    """alpha-dot, rad/s, of manoeuvres laid end to end: slow part from the vane, fast part from gyro and lift.

    The differentiated noise of a vane is several times that of gyro and accelerometer, and a one-sided hysteresis turns
    it into a bias. Offsets of gyro and accelerometer, and gravity, are slow. The measured part due to specific force is
    the measured lift; as a regressor of the lift coefficient it would explain the noise of the lift, and the estimates
    of lift due to pitch rate and to alpha-dot would be large with opposite signs. It is therefore regressed on the
    variables on which lift depends (angle of attack in pieces, their hysteresis, elevator, pitch rate), and the
    prediction is used: two-stage least squares. Near the ends of a manoeuvre only the smoothed vane is used.

    `s` are the channels (n,), SI, with `p_dot`, `q_dot`, `r_dot` in rad/s2; `first` and `last` the ends of each
    sample's manoeuvre. `regression` is that of the uncorrected record; it is not changed by corrections of `s`.

    Source: Klein and Morelli, *Aircraft System Identification*, 2006, ch. 10 (kinematics); two-stage least squares:
    Wooldridge, *Econometric Analysis of Cross Section and Panel Data*, 2010, ch. 5.
    """
    smooth, fast, base = _parts(s, dt, first, last)
    raw = regression.share @ _causes(s, base + regression.before, regression.knots)
    return base + fast(raw, smooth(raw))


def lift_regression(
    s: Mapping[str, Array], accelerometer: tuple[Any, Any, Any], dt: Series, first: Index, last: Index
) -> LiftRegression:
    """Regression of the fast part of alpha-dot due to specific force on the causes of lift; arguments as `alpha_rate`.
    `accelerometer` is its position from the CG, m."""
    smooth, fast, base = _parts(s, dt, first, last)
    names = [name for name in ("alpha", "q", "airspeed", "density", "elevator") if name in s]
    smoothed = dict(zip(names, jax.vmap(smooth)(jnp.stack([s[name] for name in names])), strict=True))
    rotation = Rotation(*(s[name] for name in (*RATES, *(f"{name}_dot" for name in RATES))))
    arm_x, _, arm_z = lever_arm(rotation, accelerometer)
    at_cg = (s["az"] - arm_z) * jnp.cos(s["alpha"]) - (s["ax"] - arm_x) * jnp.sin(s["alpha"])
    known = smooth(at_cg / s["airspeed"])  # the part of alpha-dot due to specific force at the CG
    response = fast(known, known)
    knots = jnp.quantile(smoothed["alpha"], jnp.asarray(KNOTS))
    before = part = jnp.zeros_like(base)
    share = jnp.zeros(0)
    for _ in range(ITERATIONS):
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
    s: Mapping[str, Array], dt: Series, first: Index, last: Index
) -> tuple[Operator, Callable[[Array, Array], Array], Series]:
    """The smoothing filter, the high-pass filter, and alpha-dot without the part due to specific force."""

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


def _causes(s: Mapping[str, Array], rate: Series, knots: Float[Array, " j"]) -> Float[Array, "c n"]:
    """Regressors of lift over mass and airspeed, as rows."""
    weight = s["density"] * s["airspeed"]
    pieces = jnp.maximum(s["alpha"] - knots[:, None], 0.0)
    falling = jnp.minimum(rate, 0.0)
    rows = [s["alpha"][None], pieces, falling[None], falling * pieces, s["q"][None]]
    if "elevator" in s:
        rows.append(s["elevator"][None])
    return weight * jnp.concatenate(rows)
