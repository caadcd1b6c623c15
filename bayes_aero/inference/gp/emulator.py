"""Emulator (stand-in) of the n x n statistics near the optimum: polynomials in (log l, log g), fitted with gradients.

`logdet` and the logarithmic Cholesky factor of `gram` are smooth functions of u = (log l_1..d, log g), d + 1 numbers;
every exact evaluation gives their values and all first derivatives, so a few tens of evaluations determine a full
cubic. `reweight.py` measures the error of the stand-in on exact evaluations and removes it.
"""

import math
from itertools import combinations_with_replacement
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int
from scipy.linalg import solve_triangular

from bayes_aero.inference.gp.reduced import ReducedGradient, ReducedStats

__all__ = ["Emulator", "ExactPoint", "fit_emulator"]

DEGREE = 4  # also the order of the coefficient tensor below
# With fewer rows than this times its terms, a degree is too high.
ROWS_PER_TERM = (0.0, 2.0, 2.0, 2.0, 3.0)
REACH = 2.0  # whitened distance from a supporting point up to which the stand-in is used
SUPPORT_GAP = 12.0  # nats below the best point up to which a point supports; others train with a small weight
PAD = 64  # the list of supporting points is padded to this times a power of two: few lengths, few compiled samplers


class ExactPoint(NamedTuple):
    """One exact evaluation for training: u, the statistics and, where they were computed, their derivatives."""

    u: Float[np.ndarray, " u"]
    stats: ReducedStats
    gradient: ReducedGradient | None


class Emulator(eqx.Module):
    """Polynomial stand-in of degree <= 4 in the whitened t: coefficients of s_a s_b, where s = (t, 1) x (t, 1).

    Each monomial keeps one place in that tensor, the others are zero: dense products beat gathers in XLA, and the
    shape does not depend on the degree, so that one compiled sampler serves every round.
    """

    centre: Float[Array, " u"]
    whiten: Float[Array, "u u"]
    coefficients: Float[Array, "pairs pairs outputs"]
    support: Float[Array, "points u"]

    def __call__(self, u: Float[Array, " u"]) -> tuple[Float[Array, ""], Float[Array, "m m"], Float[Array, ""]]:
        """(logdet, gram, penalty) at u; the penalty, <= 0, excludes regions far from exact points."""
        t = self.whiten @ (u - self.centre)
        away = t - self.support
        squares = jnp.sum(away * away, axis=1)
        nearest = jnp.argmin(squares)
        distance = jnp.sqrt(squares[nearest] + 1e-12)
        outside = jnp.maximum(distance - REACH, 0.0)
        t = t - away[nearest] * outside / distance  # a polynomial is wrong far from its data: hold it at the border
        t1 = jnp.append(t, 1.0)
        pairs = (t1[:, None] * t1).ravel()
        z = pairs @ jnp.tensordot(pairs, self.coefficients, 1)
        m = u.shape[0] + 1
        lower = jnp.zeros((m, m)).at[np.tril_indices(m, -1)].set(z[m + 1 :])
        lower = lower + jnp.diag(jnp.exp(z[1 : m + 1]))
        return z[0], lower @ lower.T, -8.0 * outside**2


def outputs(point: ExactPoint) -> tuple[Float[np.ndarray, " outputs"], Float[np.ndarray, "u outputs"]]:
    """(logdet, log diagonal, strict lower part of chol gram) and their derivatives by u, NaN if unknown."""
    m = point.stats.gram.shape[0]
    lower = np.linalg.cholesky(point.stats.gram)
    rows = np.tril_indices(m, -1)

    def pack(logdet, diagonal, factor):
        return np.concatenate([[logdet], diagonal, factor[rows]])

    value = pack(point.stats.logdet, np.log(np.diag(lower)), lower)
    slopes = []
    if point.gradient is None:
        return value, np.full((point.u.size, value.size), np.nan)
    for d_logdet, d_gram in zip(point.gradient.logdet, point.gradient.gram, strict=True):
        inner = solve_triangular(lower, d_gram, lower=True)
        inner = solve_triangular(lower, inner.T, lower=True)
        d_lower = lower @ (np.tril(inner, -1) + 0.5 * np.diag(np.diag(inner)))
        slopes.append(pack(d_logdet, np.diag(d_lower) / np.diag(lower), d_lower))
    return value, np.array(slopes)


def monomials(d: int, degree: int) -> Int[np.ndarray, "terms degree"]:
    """Factor indices of every monomial in d variables up to `degree`, padded with d (which stands for 1)."""
    return np.array(list(combinations_with_replacement(range(d + 1), degree)))


def design(
    t: Float[np.ndarray, "points u"], powers: Int[np.ndarray, "terms degree"]
) -> Float[np.ndarray, "rows terms"]:
    """Rows of the least-squares problem: monomial values at t, then their derivatives by each coordinate."""
    points, d = t.shape
    padded = np.hstack([t, np.ones((points, 1))])
    factors = padded[:, powers]  # (points, terms, degree)
    blocks = [factors.prod(axis=2)]
    for k in range(d):
        slope = np.zeros(factors.shape[:2])
        for j in range(powers.shape[1]):
            others = np.delete(factors, j, axis=2).prod(axis=2)
            slope += np.where(powers[:, j] == k, others, 0.0)
        blocks.append(slope)
    return np.concatenate(blocks)


def fit_emulator(
    points: list[ExactPoint], log_posterior: Float[np.ndarray, " points"], degree: int = DEGREE
) -> Emulator:
    """Weighted least squares on values and gradients of `points`, with the highest degree that they determine.

    The weight of a point follows from its `log_posterior`. Coordinates are whitened by the points near the best one.
    """
    u, gap = np.array([p.u for p in points]), np.max(log_posterior) - log_posterior
    d = u.shape[1]
    near = gap <= max(SUPPORT_GAP, np.sort(gap)[min(3 * d, gap.size - 1)])
    centre, root = u[near].mean(axis=0), np.linalg.cholesky(np.cov(u[near].T))
    whiten = solve_triangular(root, np.eye(d), lower=True)
    t = (u - centre) @ whiten.T
    rows = sum(1 if p.gradient is None else d + 1 for p in points)
    while degree > 1 and ROWS_PER_TERM[degree] * len(monomials(d, degree)) > rows:
        degree -= 1
    powers = monomials(d, degree)
    values, slopes = zip(*(outputs(p) for p in points), strict=True)
    by_t = np.einsum("jk,pjz->kpz", root, np.array(slopes)).reshape(d * len(u), -1)
    weight = np.tile(1.0 / (1.0 + gap / SUPPORT_GAP) ** 2, d + 1)[:, None]
    left, right = design(t, powers) * weight, np.vstack([values, by_t]) * weight
    known = np.all(np.isfinite(right), axis=1)
    coefficients, *_ = np.linalg.lstsq(left[known], right[known], rcond=1e-12)
    support = t[near]
    length = PAD * 2 ** max(0, math.ceil(math.log2(len(support) / PAD)))
    support = np.concatenate([support, np.repeat(support[:1], length - len(support), axis=0)])
    padded = np.pad(powers, ((0, 0), (0, DEGREE - powers.shape[1])), constant_values=d)
    tensor = np.zeros(((d + 1) ** 4, coefficients.shape[1]))
    tensor[np.ravel_multi_index(tuple(padded.T), (d + 1,) * 4)] = coefficients
    tensor = tensor.reshape((d + 1) ** 2, (d + 1) ** 2, -1)
    return Emulator(jnp.asarray(centre), jnp.asarray(whiten), jnp.asarray(tensor), jnp.asarray(support))
