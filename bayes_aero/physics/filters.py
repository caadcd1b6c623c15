"""Smoothing and differentiation of evenly sampled signals, as the published coefficients were formed; the separation.

Source: R. V. Jategaonkar, *Flight Vehicle System Identification*, 2nd ed., AIAA 2015 (companion data set of the ATTAS
stall). Both operators are linear, keep the length and act on one manoeuvre at a time, never across a seam.
"""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.special import expit

from bayes_aero.arrays import AnyArray, Samples, namespace, xp
from bayes_aero.physics.aircraft import Aircraft
from bayes_aero.physics.kinematics import across_flow

Series = Float[AnyArray, " n"]
Index = Int[AnyArray, " n"]
SPENCER = np.array([-3, -6, -5, 3, 21, 46, 67, 74, 67, 46, 21, 3, -5, -6, -3]) / 320.0
SHORT_SMOOTHER = np.array([7, 24, 34, 24, 7]) / 96.0
EIGHTH_ORDER = np.array([
    0.88888888887637, -0.31111111109862, 0.11313131312500, -0.03535353535135, 0.00870240870185, -0.00155400155390,
    0.00017760017759, -0.00000971250971,
])  # fmt: skip
FOURTH_ORDER = np.array([2.0 / 3.0, -1.0 / 12.0])
FILTER_STEP = 5  # samples; Spencer's filter passes half the power at 0.095 cycles a sample: one in 5 keeps all
LONG = 3
LONG_REACH = (LONG + 1) * (len(SPENCER) // 2) + len(EIGHTH_ORDER)  # samples: smoothed, smoothed long, differentiated


def smooth(x: Series) -> Series:
    """`smooth_joined` of one manoeuvre."""
    x = namespace(x).asarray(x)
    return smooth_joined(x, *_ends(x))


def _ends(x: Series) -> tuple[Int[np.ndarray, " n"], Int[np.ndarray, " n"]]:
    """First and last sample of the one manoeuvre that there is."""
    return np.zeros(x.shape[0], int), np.full(x.shape[0], x.shape[0] - 1)


def _central(x: Float[AnyArray, "*r n"], weights: np.ndarray) -> Float[AnyArray, "*r m"]:
    """Antisymmetric central difference per sample at the n - 2 len(weights) samples that have all neighbours."""
    half, n = len(weights), x.shape[-1]
    lags = enumerate(weights, 1)
    terms = (w * (x[..., half + k : n - half + k] - x[..., half - k : n - half - k]) for k, w in lags)
    return sum(terms, start=namespace(x).zeros((*x.shape[:-1], n - 2 * half)))


def differentiate(x: Series, dt: float | Float[AnyArray, ""] | Series) -> Series:
    """Time derivative: 8th-order central difference, 4th-order in samples 3 to 8 from an end, constant beyond."""
    x = namespace(x).asarray(x)
    return differentiate_joined(x, dt, *_ends(x))


def smooth_joined(x: Series, first: Index, last: Index) -> Series:
    """Fifteen-point Spencer filter, n >= 20; five points in samples 4 to 7 from an end; the outer three stay."""
    # Manoeuvres are laid end to end, `first` and `last` the ends of that of each sample. One program for any number of
    # any lengths: cut into pieces, every new length would be compiled.
    xp, inside = namespace(x, first, last), inside_joined(x.shape[0], first, last)
    wide, short = (xp.convolve(x, xp.asarray(kernel), mode="same") for kernel in (SPENCER, SHORT_SMOOTHER))
    return xp.where(inside >= 7, wide, xp.where(inside >= 3, short, x))


def smooth_long(x: Series) -> Series:
    """The Spencer filter over every `LONG`-th sample of a smoothed signal; wrong near the ends."""
    kernel = np.zeros(LONG * (len(SPENCER) - 1) + 1)
    kernel[::LONG] = SPENCER
    xp = namespace(x)
    return xp.convolve(x, xp.asarray(kernel), mode="same")


def differentiate_joined(
    x: Float[AnyArray, "*r n"], dt: float | Float[AnyArray, ""] | Series, first: Index, last: Index
) -> Float[AnyArray, "*r n"]:
    """`differentiate` of manoeuvres laid end to end, each at least 20 samples long; rows are different records."""
    xp, n = namespace(x, dt, first, last), x.shape[-1]
    rows = [(0, 0)] * (x.ndim - 1)
    inner, near = (_central(xp.pad(x, [*rows, (len(w), len(w))]), w) for w in (EIGHTH_ORDER, FOURTH_ORDER))
    slope = xp.where(inside_joined(n, first, last) >= 8, inner, near)
    return slope[..., xp.clip(xp.arange(n), first + 2, last - 2)] / dt


def inside_joined(n: int, first: Index, last: Index) -> Index:
    """Number of samples to the nearer end of the manoeuvre."""
    xp = namespace(first, last)
    place = xp.arange(n)
    return xp.minimum(place - first, last - place)


def recurrence(keep: Float[AnyArray, "n ..."], drive: Float[AnyArray, "n ..."]) -> Float[AnyArray, "n ..."]:
    """x[k] = keep[k] x[k-1] + drive[k] along the first axis, x before the first sample being zero. A plain scan: the
    associative one runs no faster at some thousand samples and takes many times longer to compile."""

    import jax
    import jax.numpy as jnp

    return jax.lax.scan(_kept_and_driven, jnp.zeros_like(drive[0]), (keep, drive))[1]


def _kept_and_driven(x, row):
    """A step of the recurrence; not made anew at every call, or JAX compiles it anew."""
    x = row[0] * x + row[1]
    return x, x


def advance(x: Series, seconds: Float[AnyArray, ""], dt: Series, first: Index, last: Index) -> Series:
    """x(t + seconds), by cubic convolution between samples, constant beyond the manoeuvre's `first` and `last` sample.
    Third-order accurate and differentiable in `seconds`; source: Keys, IEEE Trans. ASSP 29 (1981) 1153, a = -1/2."""
    xp = namespace(x, seconds, dt)
    x = xp.asarray(x)
    place = xp.arange(x.shape[0]) + seconds / dt
    base = xp.floor(place).astype(int)  # a whole number has no derivative
    u = place - base
    before, here, after, beyond = (x[xp.clip(base + k, first, last)] for k in (-1, 0, 1, 2))
    slope, next_slope = 0.5 * (after - before), 0.5 * (beyond - here)
    rise = after - here
    inside = here + u * (slope + u * (3.0 * rise - 2.0 * slope - next_slope + u * (slope + next_slope - 2.0 * rise)))
    return xp.where(place <= first, x[first], xp.where(place >= last, x[last], inside))


# --- The flow separation point X on the upper surface: 1 attached, 0 separated from the leading edge.
# Source: Goman and Khrabrov, J. Aircraft 31 (1994) 1109; Fischenberg and Jategaonkar, RTO MP-11 (1999) paper 17.

Scalar = Float[AnyArray, ""]


def separation_point(a1: Scalar, alpha: Samples, alpha_star: Scalar) -> Samples:
    """Static X = (1 - tanh(a1 (alpha - alpha_star)))/2, with alpha in rad and a1 in 1/rad. Written as a logistic so
    that X and its root keep finite derivatives when the flow is fully separated."""
    depth = -2.0 * a1 * (alpha - alpha_star)
    if namespace(depth) is np:
        return expit(depth)
    import jax

    return jax.nn.sigmoid(depth)


def root(X: Samples) -> Samples:
    """sqrt X with a finite derivative at X = 0 (Kirchhoff's lift uses the root)."""
    return xp.sqrt(xp.maximum(X, 1e-30))


def kirchhoff_factor(X: Samples) -> Samples:
    """((1 + sqrt X)/2)^2: share of the attached lift-curve slope that Kirchhoff's flow keeps."""
    return xp.square((1.0 + root(X)) / 2.0)


def kept_lift(X: Samples, difference: Samples) -> Samples:
    """The same of two wings, half each: mean X, and `difference` of the right one's less the left one's."""
    half = difference / 2.0
    return (kirchhoff_factor(X + half) + kirchhoff_factor(X - half)) / 2.0


def lagged(
    X_static: Float[AnyArray, " n"], tau: Float[AnyArray, " n"], dt: Float[AnyArray, " n"], start: Bool[AnyArray, " n"]
):
    """Solve tau dX/dt + X = X_static over manoeuvres laid end to end; the state restarts where `start` is true. `tau`
    and `dt` (time since the previous sample) in s. Exact for an input linear between samples and tau constant over a
    step; tau = 0 gives X_static exactly, with the correct derivative there: dX/dtau = -dX_static/dt."""
    ratio = tau / dt
    safe = xp.where(ratio > 1e-3, ratio, 1.0)
    decay = xp.where(ratio > 1e-3, xp.exp(-1.0 / safe), 0.0)
    new = 1.0 - ratio * (1.0 - decay)
    old = 1.0 - decay - new
    previous = namespace(X_static).concatenate([X_static[:1], X_static[:-1]])
    drive = xp.where(start, X_static, new * X_static + old * previous)
    keep = xp.where(start, 0.0, decay)

    return recurrence(keep, drive)


# --- Moments due to a difference between the right and the left wing.

CENTROID = 4.0 / (3.0 * math.pi)  # of half an elliptic lift distribution, share of the half span


def moments_of_difference(CL: Samples, CD: Samples, alpha: Samples, aircraft: Aircraft) -> dict[str, Samples]:
    """Cl and Cn, body axes, of lift and drag of a wing with both halves like the right one, less those of both like the
    left one; the force of a half acts at `CENTROID`."""
    CX, CZ = across_flow(CL, CD, alpha)
    arm = 0.5 * CENTROID * aircraft.half_span / aircraft.moment_length
    return {"Cl": arm * CZ, "Cn": -arm * CX}
