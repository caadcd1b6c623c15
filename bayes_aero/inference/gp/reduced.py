"""The n x n part of the marginal likelihood: what is needed of (length scales, noise-to-signal), and no more.

Write K = sf^2 (R + F D F'), R = SE(l) + g I, F = [1, X], D = diag(s0^2, s_1^2 .. s_d^2)/sf^2. Then log|K| and
y'K^-1 y follow exactly, by the matrix determinant and inversion lemmas, from

    logdet = log|R|      and      gram = [F y]' R^-1 [F y],   (d + 2) x (d + 2),

which depend on u = (log l_1..d, log g) alone. So the expensive function has d + 1 arguments, not 2d + 3, and
smooth, small outputs; the other hyperparameters cost microseconds (`density.py`).

The gradient is analytic. With V = R^-1 [F y]:  d gram = -V' dR V, and  d logdet = tr(R^-1 dR). The SE part has
dR/dlog l_k = SE o (x_ik - x_jk)^2 (elementwise), and sum_ij M_ij (x_ik - x_jk)^2 for a symmetric M needs only
M's row sums and M x: no n x n x p array is ever formed. LAPACK potrf + potri, n^3 flops together.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.linalg import get_lapack_funcs

from bayes_aero.inference.gp.kernel import scaled_distance_kernel
from bayes_aero.inference.threads import blas_threads

DEPENDENT = 1e-6  # of singular values: its square is lost in the rounding of a gram that R^-1 stretches
dpotrf, dpotrs, dpotri = get_lapack_funcs(("potrf", "potrs", "potri"), dtype=np.float64)

__all__ = [
    "Factor",
    "ReducedData",
    "ReducedGradient",
    "ReducedStats",
    "factorise",
    "reduced_stats",
    "stats_and_gradient",
]


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


class Factor(NamedTuple):
    """Lower Cholesky factor of R and V = R^-1 [F y] (n, m); None if R has none."""

    lower: Float[np.ndarray, "n n"] | None
    v: Float[np.ndarray, "n m"] | None


def factorise(u: Float[np.ndarray, " u"], data: ReducedData, se: Float[np.ndarray, "n n"] | None = None) -> Factor:
    """Cholesky factor of R at u = (log l, log g); `se` is SE(l) where the caller has it already."""
    d = data.x.shape[1]
    if se is None:
        x = data.x / np.exp(u[:d])
        r = scaled_distance_kernel(x, x)
    else:
        r = se.copy()
    np.fill_diagonal(r, 1.0 + np.exp(u[d]))
    # r is symmetric and C-ordered, so its transpose is the Fortran array that LAPACK overwrites without a copy.
    lower, info = dpotrf(r.T, lower=1, clean=1, overwrite_a=1)
    if info != 0:
        return Factor(None, None)
    v, _ = dpotrs(lower, data.fy, lower=1)
    return Factor(lower, v)


def _stats(factor: Factor, data: ReducedData) -> ReducedStats:
    m = data.fy.shape[1]
    if factor.lower is None or factor.v is None:
        return ReducedStats(np.nan, np.full((m, m), np.nan), ok=False)
    gram = data.fy.T @ factor.v
    logdet = 2.0 * float(np.sum(np.log(np.diagonal(factor.lower))))
    return ReducedStats(logdet, 0.5 * (gram + gram.T))


def reduced_stats(u: Float[np.ndarray, " u"], data: ReducedData) -> ReducedStats:
    """logdet and gram at u = (log l, log g): one Cholesky factorisation."""
    return _stats(factorise(u, data), data)


def stats_and_gradient(u: Float[np.ndarray, " u"], data: ReducedData) -> tuple[ReducedStats, ReducedGradient]:
    """logdet, gram and their derivatives with respect to u: one factorisation and one inversion."""
    with blas_threads(data.n):
        return _stats_and_gradient(u, data)


def _stats_and_gradient(u: Float[np.ndarray, " u"], data: ReducedData) -> tuple[ReducedStats, ReducedGradient]:
    d, m = data.x.shape[1], data.fy.shape[1]
    x, g = data.x / np.exp(u[:d]), float(np.exp(u[d]))
    se = scaled_distance_kernel(x, x)
    factor = factorise(u, data, se)
    stats = _stats(factor, data)
    d_logdet, d_gram = np.full(d + 1, np.nan), np.full((d + 1, m, m), np.nan)
    if factor.lower is None or factor.v is None:
        return stats, ReducedGradient(d_logdet, d_gram)
    v = factor.v
    xv = [x[:, [k]] * v for k in range(d)]
    se_v = se @ np.concatenate([v, *xv], axis=1)
    for k in range(d):
        cross = (x[:, [k]] * xv[k]).T @ se_v[:, :m]
        d_gram[k] = 2.0 * xv[k].T @ se_v[:, m * (k + 1) : m * (k + 2)] - cross - cross.T
    d_gram[d] = -g * v.T @ v
    inverse, _ = dpotri(factor.lower, lower=1, overwrite_c=1)
    d_logdet[d] = g * np.trace(inverse)
    half = np.multiply(inverse.T, se, out=se)  # one triangle of R^-1 o SE, the other is zero
    d_logdet[:d] = 2.0 * ((x * x).T @ (half.sum(axis=0) + half.sum(axis=1)))
    d_logdet[:d] -= 4.0 * np.einsum("ij,ij->j", x, half @ x)
    return stats, ReducedGradient(d_logdet, d_gram)
