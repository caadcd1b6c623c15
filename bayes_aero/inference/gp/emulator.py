"""Emulator (stand-in) of the n x n statistics near the optimum: polynomials in (log l, log g), fitted with gradients.

`logdet` and the logarithmic Cholesky factor of `gram` are smooth functions of u = (log l_1..d, log g), d + 1 numbers;
every exact evaluation gives their values and all first derivatives, so a few tens of evaluations determine a full
cubic. `posterior.reweight` measures the error of the stand-in on exact evaluations and removes it.
"""

from __future__ import annotations

import math
from itertools import combinations_with_replacement
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int
from scipy.linalg import get_lapack_funcs, solve_triangular

from bayes_aero.inference.compiled_programs import blas_threads
from bayes_aero.inference.gp.kernel import scaled_distance_kernel

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
    """Polynomial stand-in of degree <= 4 in the whitened t: coefficients of s_a s_b, where s = (t, 1) x (t, 1)."""

    # Each monomial keeps one place in that tensor, the others are zero: dense products beat gathers in XLA, and the
    # shape does not depend on the degree, so that one compiled sampler serves every round.
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

    value, slopes = pack(point.stats.logdet, np.log(np.diag(lower)), lower), []
    if point.gradient is None:
        return value, np.full((point.u.size, value.size), np.nan)
    for d_logdet, d_gram in zip(point.gradient.logdet, point.gradient.gram, strict=True):
        inner = solve_triangular(lower, d_gram, lower=True)
        inner = solve_triangular(lower, inner.T, lower=True)
        d_lower = lower @ (np.tril(inner, -1) + 0.5 * np.diag(np.diag(inner)))
        slopes.append(pack(d_logdet, np.diag(d_lower) / np.diag(lower), d_lower))
    return value, np.array(slopes)


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
    """Weighted least squares on values and gradients of `points`, with the highest degree that they determine."""
    # The weight of a point follows from its `log_posterior`. Coordinates are whitened by the points near the best one.
    u, gap = np.array([p.u for p in points]), np.max(log_posterior) - log_posterior
    d = u.shape[1]
    near = gap <= max(SUPPORT_GAP, np.sort(gap)[min(3 * d, gap.size - 1)])
    centre, root = u[near].mean(axis=0), np.linalg.cholesky(np.cov(u[near].T))
    whiten = solve_triangular(root, np.eye(d), lower=True)
    t = (u - centre) @ whiten.T
    rows = sum(1 if p.gradient is None else d + 1 for p in points)
    while degree > 1 and ROWS_PER_TERM[degree] * math.comb(d + degree, degree) > rows:
        degree -= 1
    # Factor indices of every monomial up to this degree, padded with d (which stands for 1).
    powers = np.array(list(combinations_with_replacement(range(d + 1), degree)))
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


# --- The n x n part of the marginal likelihood: what is needed of (length scales, noise-to-signal), and no more.
# Write K = sf^2 (R + F D F'), R = SE(l) + g I, F = [1, X], D = diag(s0^2, s_1^2 .. s_d^2)/sf^2. Then log|K| and
# y'K^-1 y follow exactly, by the matrix determinant and inversion lemmas, from
# logdet = log|R| and gram = [F y]' R^-1 [F y], (d + 2) x (d + 2),
# which depend on u = (log l_1..d, log g) alone. So the expensive function has d + 1 arguments, not 2d + 3, and
# smooth, small outputs; the other hyperparameters cost microseconds (`optimum.slopes`).
# The gradient is analytic. With V = R^-1 [F y]: d gram = -V' dR V, and d logdet = tr(R^-1 dR). The SE part has
# dR/dlog l_k = SE o (x_ik - x_jk)^2 (elementwise), and sum_ij M_ij (x_ik - x_jk)^2 for a symmetric M needs only M's
# row sums and M x: no n x n x p array is ever formed. LAPACK potrf + potri, n^3 flops together.

DEPENDENT = 1e-6  # of singular values: its square is lost in the rounding of a gram that R^-1 stretches
dpotrf, dpotrs, dpotri = get_lapack_funcs(("potrf", "potrs", "potri"), dtype=np.float64)


class ReducedData(NamedTuple):
    """Scaled training data: inputs x (n, d) and F_y = [1, x, y] (n, d + 2)."""

    x: Float[np.ndarray, "n d"]
    fy: Float[np.ndarray, "n m"]

    @classmethod
    def of(cls, x: Float[np.ndarray, "n d"], y: Float[np.ndarray, " n"]) -> "ReducedData":
        """From scaled inputs and output."""
        return cls(np.ascontiguousarray(x), np.column_stack([np.ones(len(x)), x, y]))

    @property
    def n(self) -> int:
        """Number of training samples."""
        return self.x.shape[0]

    @property
    def dependent(self) -> bool:
        """Whether a column of F_y is a combination of the others: an input given twice, or an output that is linear."""
        values = np.linalg.svd(self.fy / np.linalg.norm(self.fy, axis=0), compute_uv=False)
        return bool(values[-1] <= DEPENDENT * values[0])


class ReducedStats(NamedTuple):
    """logdet = log|R| and gram = [F y]'R^-1[F y]. Not positive definite: `ok` is False and both are NaN."""

    logdet: float
    gram: Float[np.ndarray, "m m"]
    ok: bool = True


class ReducedGradient(NamedTuple):
    """Derivatives of logdet (d + 1,) and gram (d + 1, m, m) with respect to u."""

    logdet: Float[np.ndarray, " u"]
    gram: Float[np.ndarray, "u m m"]


def factorise(
    u: Float[np.ndarray, " u"], data: ReducedData, se: Float[np.ndarray, "n n"] | None = None
) -> tuple[Float[np.ndarray, "n n"], Float[np.ndarray, "n m"]] | None:
    """Lower Cholesky factor of R at u = (log l, log g), and R^-1 [F y]; None if R has none. `se`: SE(l), if known."""
    d = data.x.shape[1]
    x = data.x / np.exp(u[:d])
    r = scaled_distance_kernel(x, x) if se is None else se.copy()
    np.fill_diagonal(r, 1.0 + np.exp(u[d]))
    # r is symmetric and C-ordered, so its transpose is the Fortran array that LAPACK overwrites without a copy.
    lower, info = dpotrf(r.T, lower=1, clean=1, overwrite_a=1)
    return None if info != 0 else (lower, dpotrs(lower, data.fy, lower=1)[0])


def _stats(factor: tuple[np.ndarray, np.ndarray] | None, data: ReducedData) -> ReducedStats:
    if factor is None:
        m = data.fy.shape[1]
        return ReducedStats(np.nan, np.full((m, m), np.nan), ok=False)
    lower, v = factor
    gram = data.fy.T @ v
    return ReducedStats(2.0 * float(np.sum(np.log(np.diagonal(lower)))), 0.5 * (gram + gram.T))


def reduced_stats(u: Float[np.ndarray, " u"], data: ReducedData) -> ReducedStats:
    """logdet and gram at u = (log l, log g): one Cholesky factorisation."""
    return _stats(factorise(u, data), data)


def stats_and_gradient(u: Float[np.ndarray, " u"], data: ReducedData) -> tuple[ReducedStats, ReducedGradient]:
    """logdet, gram and their derivatives with respect to u: one factorisation and one inversion."""
    d, m = data.x.shape[1], data.fy.shape[1]
    d_logdet, d_gram = np.full(d + 1, np.nan), np.full((d + 1, m, m), np.nan)
    with blas_threads(data.n):
        x, g = data.x / np.exp(u[:d]), float(np.exp(u[d]))
        se = scaled_distance_kernel(x, x)
        factor = factorise(u, data, se)
        stats = _stats(factor, data)
        if factor is None:
            return stats, ReducedGradient(d_logdet, d_gram)
        lower, v = factor
        xv = [x[:, [k]] * v for k in range(d)]
        se_v = se @ np.concatenate([v, *xv], axis=1)
        for k in range(d):
            cross = (x[:, [k]] * xv[k]).T @ se_v[:, :m]
            d_gram[k] = 2.0 * xv[k].T @ se_v[:, m * (k + 1) : m * (k + 2)] - cross - cross.T
        d_gram[d] = -g * v.T @ v
        inverse, _ = dpotri(lower, lower=1, overwrite_c=1)
        d_logdet[d] = g * np.trace(inverse)
        half = np.multiply(inverse.T, se, out=se)  # one triangle of R^-1 o SE, the other is zero
        d_logdet[:d] = 2.0 * ((x * x).T @ (half.sum(axis=0) + half.sum(axis=1)))
        d_logdet[:d] -= 4.0 * np.einsum("ij,ij->j", x, half @ x)
    return stats, ReducedGradient(d_logdet, d_gram)
