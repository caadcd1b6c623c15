"""The Gaussian process of more samples than the exact one can take: inducing points, with the error measured.

SE is replaced by Q = K_nz K_zz^-1 K_zn through q inducing points z (Nystroem; predictions as in Titsias 2009,
"Variational learning of inducing variables"), n q^2 instead of n^3: R becomes V'V + g I with V = L^-1 K_zn and
L L' = K_zz, and by the inversion lemma R^-1 b = (b - V' B^-1 V b / g) / g with B = I + V V' / g. All else is as in
`reduced.py`.

The points are chosen greedily, each where the ones before leave most variance (partial pivoted Cholesky; Burt,
Rasmussen and van der Wilk 2020, JMLR 21(131)), at the most probable length scales.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.linalg import cho_solve, cholesky, solve_triangular

from bayes_aero.inference.gp.kernel import noise_to_signal, scaled_distance_kernel
from bayes_aero.inference.gp.predict import gaussian_parts
from bayes_aero.inference.gp.reduced import ReducedData

__all__ = ["SUBSET", "Approximation", "SparseData", "choose_inducing", "measured_error", "sparse_parts"]

SUBSET = 3000  # samples, drawn at random, on which the hyperparameters are found exactly
MAX_INDUCING = 600
CANDIDATES = 10_000  # samples among which inducing points are chosen
MAX_RESIDUAL_VARIANCE = 1e-3  # of the noise's variance: no more points are added when all leave less
JITTER = 1e-8  # of the signal's variance, on the diagonal of K_zz
BLOCK_SAMPLES = 8192  # samples at a time
CHECK_SAMPLES = 1000  # samples at which the error is measured


class SparseData(NamedTuple):
    """All training data, scaled, and the inducing points z (q, d) in the order in which they were chosen."""

    x: Float[np.ndarray, "n d"]
    fy: Float[np.ndarray, "n m"]
    z: Float[np.ndarray, "q d"]


@dataclass(frozen=True)
class Approximation:
    """What was approximated, and by how much it errs.

    `against_exact`: root mean square of the difference of the predicted means, and of the predicted sds, to the exact
    process trained on the same `subset` samples, in units of the exact sd of a new measurement. `halved`: the same
    difference at all `n` samples when every other inducing point is taken away: what more points could still change.
    """

    n: int
    subset: int
    inducing: int
    against_exact: tuple[float, float]
    halved: tuple[float, float]

    @property
    def sentence(self) -> str:
        """For the user."""
        return (
            f"{self.n} samples through {self.inducing} inducing points, hyperparameters from {self.subset} of them; on "
            f"those it is {self.against_exact[0]:.1%} of a predictive deviation from the exact one in its means and "
            f"{self.against_exact[1]:.1%} in its deviations, and half the points would change it by "
            f"{self.halved[0]:.1%} and {self.halved[1]:.1%}"
        )


def choose_inducing(
    theta: Float[np.ndarray, " p"], x: Float[np.ndarray, "n d"], seed: int, most: int = MAX_INDUCING
) -> Float[np.ndarray, "q d"]:
    """At most `most` of the samples x (scaled), each where those before leave most of SE's variance."""
    u = noise_to_signal(theta)
    length, enough = np.exp(u[:-1]), MAX_RESIDUAL_VARIANCE * np.exp(u[-1])
    if len(x) > CANDIDATES:
        x = x[np.sort(np.random.default_rng(seed).choice(len(x), CANDIDATES, replace=False))]
    scaled = x / length
    most = min(most, len(x))
    rows, left = np.zeros((most, len(x))), np.ones(len(x))
    chosen: list[int] = []
    for k in range(most):
        at = int(np.argmax(left))
        if left[at] < max(enough, JITTER) and k:
            break
        column = scaled_distance_kernel(scaled[at][None], scaled)[0] - rows[:k, at] @ rows[:k]
        rows[k] = column / np.sqrt(left[at])
        left = np.maximum(left - rows[k] ** 2, 0.0)
        left[at] = 0.0
        chosen.append(at)
    return np.ascontiguousarray(x[chosen])


class _Factor(NamedTuple):
    """Cholesky factors of K_zz and of B, and V [F y] (q, m)."""

    lower: Float[np.ndarray, "q q"]
    inner: Float[np.ndarray, "q q"]
    v_fy: Float[np.ndarray, "q m"]


def _factorise(u: Float[np.ndarray, " u"], data: SparseData) -> _Factor:
    """One pass over the samples, n q^2; a block of them in memory at a time."""
    length, g = np.exp(u[:-1]), float(np.exp(u[-1]))
    z = data.z / length
    lower = cholesky(scaled_distance_kernel(z, z) + JITTER * np.eye(len(z)), lower=True)
    vv, v_fy = np.zeros((len(z), len(z))), np.zeros((len(z), data.fy.shape[1]))
    for begin in range(0, len(data.x), BLOCK_SAMPLES):
        part = slice(begin, begin + BLOCK_SAMPLES)
        v = solve_triangular(lower, scaled_distance_kernel(z, data.x[part] / length), lower=True, check_finite=False)
        vv += v @ v.T
        v_fy += v @ data.fy[part]
    return _Factor(lower, cholesky(np.eye(len(z)) + vv / g, lower=True), v_fy)


def sparse_parts(
    theta: Float[np.ndarray, " p"], data: SparseData, x_new: Float[np.ndarray, "k d"]
) -> tuple[Float[np.ndarray, " k"], Float[np.ndarray, " k"]]:
    """`predict.gaussian_parts` through the inducing points: mean and variance of the latent function, scaled units.

    The variance is never below what the inducing points leave: away from them it returns to the prior's.
    """
    d = data.x.shape[1]
    u = noise_to_signal(theta)
    factor, g = _factorise(u, data), float(np.exp(u[-1]))
    length, sf2 = np.exp(theta[d + 2 : 2 * d + 2]), np.exp(2.0 * theta[d + 1])
    root = np.append(np.exp(theta[: d + 1] - theta[d + 1]), 1.0)
    half = solve_triangular(factor.inner, factor.v_fy * root, lower=True)
    gram = ((data.fy * root).T @ (data.fy * root) - half.T @ half / g) / g  # [F y]' R^-1 [F y], the basis weighed
    inner = cholesky(np.eye(d + 1) + gram[: d + 1, : d + 1], lower=True)
    weight = cho_solve((inner, True), gram[: d + 1, d + 1])
    by_basis = cho_solve((factor.inner, True), factor.v_fy * root) / g  # B^-1 V [F y] / g
    by_rest = by_basis[:, d + 1] - by_basis[:, : d + 1] @ weight
    means, variances = [], []
    for begin in range(0, len(x_new), BLOCK_SAMPLES):
        new_x = x_new[begin : begin + BLOCK_SAMPLES]
        v = scaled_distance_kernel(data.z / length, new_x / length)
        v = solve_triangular(factor.lower, v, lower=True, check_finite=False)
        new = np.column_stack([np.ones(len(new_x)), new_x]) * root[: d + 1]
        means.append(new @ weight + v.T @ by_rest)
        left = solve_triangular(factor.inner, v, lower=True, check_finite=False)
        extra = solve_triangular(inner, (new - v.T @ by_basis[:, : d + 1]).T, lower=True)
        variances.append(1.0 - np.sum(v * v, axis=0) + np.sum(left * left, axis=0) + np.sum(extra * extra, axis=0))
    return np.concatenate(means), sf2 * np.maximum(np.concatenate(variances), 0.0)


def measured_error(theta: Float[np.ndarray, " p"], data: SparseData, subset: ReducedData, seed: int) -> Approximation:
    """Compare with the exact process on `subset`, and with half the inducing points on all samples."""
    rows = np.random.default_rng([seed, 1]).choice(len(data.x), min(CHECK_SAMPLES, len(data.x)), replace=False)
    new, noise = data.x[rows], float(np.exp(2.0 * theta[-1]))
    exact = gaussian_parts(theta, subset, new)
    same = sparse_parts(theta, SparseData(subset.x, subset.fy, data.z), new)
    full, fewer = sparse_parts(theta, data, new), sparse_parts(theta, data._replace(z=data.z[::2]), new)
    return Approximation(
        n=len(data.x),
        subset=subset.n,
        inducing=len(data.z),
        against_exact=_difference(same, exact, noise),
        halved=_difference(fewer, full, noise),
    )


def _difference(one, other, noise: float) -> tuple[float, float]:
    sds = [np.sqrt(latent + noise) for _, latent in (one, other)]
    by_mean, by_sd = (one[0] - other[0]) / sds[1], (sds[0] - sds[1]) / sds[1]
    return float(np.sqrt(np.mean(by_mean**2))), float(np.sqrt(np.mean(by_sd**2)))
