"""Predictions of the GP: mean, standard deviation and quantiles, at the MAP or over the posterior of theta.

Over the posterior, the predictive distribution is an equal-weight mixture of Gaussians, one for each of a few
draws; its quantiles are those of the mixture, not of a Gaussian with the mixture's sd. All are of the *measured*
output: latent function plus white noise (see the caveat in `kernel.py` on what white noise means here).
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.linalg import cho_solve, cholesky, solve_triangular
from scipy.special import ndtr

from bayes_aero.inference.gp.kernel import noise_to_signal, scaled_distance_kernel
from bayes_aero.inference.gp.reduced import ReducedData, factorise
from bayes_aero.inference.threads import blas_threads

__all__ = ["Prediction", "gaussian_parts", "mixture"]

LEVELS = (0.5, 0.9, 0.95)


class Prediction(NamedTuple):
    """Predictive distribution at n points, in the unit of the output.

    `mean`, `sd` (n,) of a new measurement; `latent_sd` (n,) of the function without noise; `low`, `high`
    (levels, n) the ends of the central intervals of `levels`. `component_mean`, `component_sd` (draws, n) are the
    Gaussians of the mixture, for whoever wants another functional of it.
    """

    mean: Float[np.ndarray, " n"]
    sd: Float[np.ndarray, " n"]
    latent_sd: Float[np.ndarray, " n"]
    levels: tuple[float, ...]
    low: Float[np.ndarray, "levels n"]
    high: Float[np.ndarray, "levels n"]
    component_mean: Float[np.ndarray, "draws n"]
    component_sd: Float[np.ndarray, "draws n"]

    def coverage(self, measured: Float[np.ndarray, " n"]) -> dict[float, float]:
        """Share of `measured` inside each central interval, by level."""
        z = np.asarray(measured, float)
        inside = (z >= self.low) & (z <= self.high)
        return dict(zip(self.levels, inside.mean(axis=1).tolist(), strict=True))


def gaussian_parts(
    theta: Float[np.ndarray, " p"], data: ReducedData, x_new: Float[np.ndarray, "k d"]
) -> tuple[Float[np.ndarray, " k"], Float[np.ndarray, " k"]]:
    """Mean and variance of the latent function at scaled inputs x_new (k, d), in scaled output units.

    With R, F, D of `reduced.py`, S = R^-1 F (D^-1 + F'R^-1 F)^-1 and k_*: the explicit-basis form (Rasmussen and
    Williams 2006, eq. 2.42) with a proper prior D on the basis. One factorisation and one triangular solve.
    """
    with blas_threads(data.n):
        return _gaussian_parts(theta, data, x_new)


def _gaussian_parts(
    theta: Float[np.ndarray, " p"], data: ReducedData, x_new: Float[np.ndarray, "k d"]
) -> tuple[Float[np.ndarray, " k"], Float[np.ndarray, " k"]]:
    d = data.x.shape[1]
    factor = factorise(noise_to_signal(theta), data)
    if factor.lower is None or factor.v is None:
        raise np.linalg.LinAlgError("covariance not positive definite at an accepted draw")
    length, sf2 = np.exp(theta[d + 2 : 2 * d + 2]), np.exp(2.0 * theta[d + 1])
    root = np.exp(theta[: d + 1] - theta[d + 1])
    basis = data.fy[:, : d + 1] * root
    v_basis, v_y = factor.v[:, : d + 1] * root, factor.v[:, d + 1]
    inner = (cholesky(np.eye(d + 1) + basis.T @ v_basis, lower=True), True)
    weight = cho_solve(inner, basis.T @ v_y)  # posterior mean of the basis weights, in units of root
    cross = scaled_distance_kernel(data.x / length, x_new / length)  # (n, k)
    new = np.column_stack([np.ones(len(x_new)), x_new]) * root
    mean = new @ weight + cross.T @ (v_y - v_basis @ weight)
    rest = new - cross.T @ v_basis
    extra = solve_triangular(inner[0], rest.T, lower=True)
    half = solve_triangular(factor.lower, cross, lower=True, check_finite=False)
    variance = 1.0 - np.einsum("ij,ij->j", half, half) + np.einsum("ij,ij->j", extra, extra)
    return mean, sf2 * np.maximum(variance, 0.0)


def mixture(
    means: Float[np.ndarray, "draws n"], latent: Float[np.ndarray, "draws n"], noise: Float[np.ndarray, " draws"]
) -> Prediction:
    """Equal-weight mixture of Gaussians with `means`, latent variances and noise variances."""
    mean = means.mean(axis=0)
    between = means.var(axis=0)
    sds = np.sqrt(latent + noise[:, None])
    sd = np.sqrt(between + np.mean(sds**2, axis=0))
    tails = np.array([(1.0 - level) / 2.0 for level in LEVELS])
    low = np.array([_quantile(means, sds, tail) for tail in tails])
    high = np.array([_quantile(means, sds, 1.0 - tail) for tail in tails])
    return Prediction(mean, sd, np.sqrt(between + latent.mean(axis=0)), LEVELS, low, high, means, sds)


def _quantile(
    means: Float[np.ndarray, "draws n"], sds: Float[np.ndarray, "draws n"], probability: float
) -> Float[np.ndarray, " n"]:
    """Quantile of the mixture by bisection: its cdf is monotone and the ends bracket every component's quantile."""
    low, high = (means - 9.0 * sds).min(axis=0), (means + 9.0 * sds).max(axis=0)
    for _ in range(50):
        middle = 0.5 * (low + high)
        below = ndtr((middle - means) / sds).mean(axis=0) < probability
        low, high = np.where(below, middle, low), np.where(below, high, middle)
    return 0.5 * (low + high)
