"""The most probable s0, s_i and sf at given length scales and noise-to-signal ratio, by Newton's method.

The density is `density.small_posterior`, of a dozen unknowns at most and asked for tens of thousands of times: calls
into compiled code, and compiling it anew for every number of inputs, would cost more than the sums. With r = s/sf,
B = 1 + r G r and y = B^-1 r b (G and b are parts of the gram, Rasmussen and Williams, sec. 2.7)

    d log p/d log s_i = y_i^2/sf^2 - 1 + (B^-1)_ii,

and second derivatives follow in the same way.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from bayes_aero.inference.gp.priors import Priors
from bayes_aero.inference.gp.reduced import ReducedStats

SD_BOUNDS = (-10.0, 6.0)  # log of scaled sds: 5e-5 to 400 times the output's rms
GAIN_TOLERANCE = 1e-12  # expected gain of the last Newton step, relative to the log posterior (at least 1000 nats)
MIN_CURVATURE = 1e-3  # of a direction, so that steps along nearly flat ones stay finite
MAX_STEP, FIRST_STEP = 4.0, 2.0  # in log units
MIN_STEP, MAX_STEPS = 1e-9, 100


class Slopes(NamedTuple):
    """Log posterior at theta, with its derivatives by theta (p,), by w (k,) once and twice, by logdet and by gram."""

    value: float
    by_theta: Float[np.ndarray, " p"]
    by_w: Float[np.ndarray, " k"]
    by_w_twice: Float[np.ndarray, "k k"]
    by_logdet: float
    by_gram: Float[np.ndarray, "m m"]


def assemble(w: Float[np.ndarray, " w"], u: Float[np.ndarray, " u"]) -> Float[np.ndarray, " p"]:
    """theta from w = log (s0, s_i, sf) and u = (log l, log g)."""
    return np.concatenate([w, u[:-1], [w[-1] + 0.5 * u[-1]]])


def slopes(
    w: Float[np.ndarray, " k"], u: Float[np.ndarray, " u"], stats: ReducedStats, n: float, priors: Priors
) -> Slopes:
    """The posterior at (w, u) given the statistics at u; derivatives by w let log sn move with log sf, by theta not."""
    m, gram, log_sf = w.size - 1, stats.gram, w[-1]
    G, b, c, e = gram[:m, :m], gram[:m, m], gram[m, m], np.exp(-2.0 * log_sf)
    r = np.exp(w[:m] - log_sf)
    lower = np.linalg.cholesky(np.eye(m) + r[:, None] * G * r)
    P = np.linalg.inv(lower)
    P = P.T @ P
    y = P @ (r * b)
    quadratic = (c - (r * b) @ y) * e
    log_k = 2.0 * n * log_sf + stats.logdet + 2.0 * np.sum(np.log(np.diagonal(lower)))
    theta = assemble(w, u)
    density, slope, bend = priors.slopes(theta)
    value = -0.5 * (quadratic + log_k + n * np.log(2.0 * np.pi)) + density

    first = np.empty(m + 1)
    first[:m] = y**2 * e - 1.0 + np.diagonal(P)
    first[m] = quadratic - n - first[:m].sum()
    inner = 2.0 * P * (P + 2.0 * e * np.outer(y, y)) - 2.0 * np.diag(e * y**2 + np.diagonal(P))
    mixed = -2.0 * e * y**2
    second = np.empty((m + 1, m + 1))
    second[:m, :m] = inner
    second[:m, m] = second[m, :m] = mixed - inner.sum(axis=1)
    second[m, m] = -2.0 * quadratic - 2.0 * mixed.sum() + inner.sum()

    by_theta = slope.copy()
    by_theta[: m + 1] += first
    first, second = first + slope[: m + 1], second + np.diag(bend[: m + 1])
    first[m], second[m, m] = first[m] + slope[-1], second[m, m] + bend[-1]
    z = r * y
    by_gram = np.zeros_like(gram)
    by_gram[:m, :m] = -0.5 * (e * np.outer(z, z) + r[:, None] * P * r)
    by_gram[:m, m] = e * z
    by_gram[m, m] = -0.5 * e
    return Slopes(float(value), by_theta, first, second, -0.5, by_gram)


def best_sizes(
    w: Float[np.ndarray, " k"], u: Float[np.ndarray, " u"], stats: ReducedStats, n: float, priors: Priors
) -> tuple[Float[np.ndarray, " k"], Slopes]:
    """w at the top of the posterior at u, from a start `w`, within `SD_BOUNDS`; and the posterior there.

    Curvatures count by their size, so that the step leads uphill where the posterior is not concave, too.
    """
    low, high = SD_BOUNDS
    w = np.clip(w, low, high)
    at, radius = slopes(w, u, stats, n, priors), FIRST_STEP
    for _ in range(MAX_STEPS):
        held = ((w <= low) & (at.by_w < 0.0)) | ((w >= high) & (at.by_w > 0.0))
        g = np.where(held, 0.0, at.by_w)
        H = np.where(held[:, None] | held, 0.0, at.by_w_twice)
        values, vectors = np.linalg.eigh(H)
        step = vectors @ (vectors.T @ g / np.maximum(np.abs(values), MIN_CURVATURE))
        promised, length = g @ step, np.max(np.abs(step))
        step *= min(1.0, radius / max(length, 1e-300))
        there = np.clip(w + step, low, high)
        new = _slopes_or_none(there, u, stats, n, priors)
        if new is not None and new.value >= at.value:
            w, at, radius = there, new, min(2.0 * radius, MAX_STEP)
        else:
            radius = 0.25 * min(length, radius)
        if promised < GAIN_TOLERANCE * max(1e3, abs(at.value)) or radius < MIN_STEP:
            break
    return w, at


def _slopes_or_none(w, u, stats, n, priors) -> Slopes | None:
    try:
        return slopes(w, u, stats, n, priors)
    except np.linalg.LinAlgError:  # sds too far apart for double precision
        return None
