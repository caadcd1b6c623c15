"""Gaussian-process regression of one output on a few inputs: `fit_gp`, and its result `GPFit`.

fit = fit_gp(X, y, names=("alpha", "elevator", "q", "V", "CL"), sample=True)
fit.predict(X_new).mean;  fit.posterior;  fit.status.value;  fit.k_hat
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import jax
import numpy as np
import xarray as xr
from jaxtyping import Float
from scipy.linalg import cho_solve, cholesky, solve_triangular
from scipy.special import ndtr
from tqdm import tqdm

from bayes_aero.errors import InputError
from bayes_aero.inference.gp.kernel import (
    FLAT,
    SAME_OPTIMUM,
    HyperPrior,
    MapStatus,
    Optimum,
    Priors,
    ReducedData,
    Scaling,
    distinct,
    factorise,
    find_map,
    maximise,
    noise_to_signal,
    scaled_distance_kernel,
)
from bayes_aero.inference.gp.posterior import (
    Budget,
    Sampled,
    SampleStatus,
    posterior_tree,
    sample_posterior,
    systematic_resample,
)
from bayes_aero.processes import blas_threads

__all__ = ["FLAT", "Budget", "GPFit", "HyperPrior", "MapStatus", "Prediction", "Priors", "SampleStatus", "fit_gp"]

MAX_SAMPLES = 8000
Matrix = Float[np.ndarray, "n d"] | Float[jax.Array, "n d"]
Vector = Float[np.ndarray, " n"] | Float[jax.Array, " n"]


@dataclass(frozen=True, eq=False)
class GPFit:
    """A trained GP."""

    input_names: tuple[str, ...]
    scaling: Scaling
    priors: Priors
    data: ReducedData
    optima: tuple[Optimum, ...]  # the distinct ones found, best first
    status: SampleStatus  # result of the sampling (`.value` is advice)
    sampled: Sampled | None
    draws: Float[np.ndarray, "draws p"] | None  # the posterior's theta, log scaled, equal weight
    posterior: xr.DataTree | None  # hyperparameters in physical units (`posterior_tree`); None unless accepted

    @property
    def map(self) -> dict[str, np.ndarray]:
        return self.scaling.physical(self.optima[0].theta)

    @property
    def map_status(self) -> MapStatus:
        return self.optima[0].status

    @property
    def k_hat(self) -> float:
        """Pareto k of the re-weighting to the exact posterior; NaN where it was not reached."""
        weighted = self.sampled.weighted if self.sampled else None
        return weighted.k_hat if weighted else float("nan")

    def predict(self, X_new: Matrix, *, draws: int = 24) -> Prediction:
        """Predictive distribution at X_new (k, d), physical units, over `draws` of the posterior or at the MAP."""
        X_new = np.asarray(X_new, float)
        if X_new.ndim != 2 or X_new.shape[1] != len(self.input_names) or not np.all(np.isfinite(X_new)):
            raise InputError(
                f"Inputs to predict at must be finite, (k, {len(self.input_names)}) for "
                f"{', '.join(self.input_names)}; got shape {X_new.shape}."
            )
        thetas = self.optima[0].theta[None]
        if self.draws is not None:
            count = min(draws, len(self.draws))
            thetas = self.draws[np.linspace(0, len(self.draws) - 1, count).round().astype(int)]
        x_new = self.scaling.inputs(X_new)
        with blas_threads(self.data.n):
            parts = [gaussian_parts(t, self.data, x_new) for t in thetas]
        means, latent = (np.array(p) for p in zip(*parts, strict=True))
        rms = self.scaling.rms
        return Prediction.of_mixture(rms * means, rms**2 * latent, rms**2 * np.exp(2.0 * thetas[:, -1]))


def fit_gp(
    X: Matrix,
    y: Vector,
    *,
    names: tuple[str, ...] = (),
    priors: Priors = Priors(),
    sample: bool = True,
    budget: Budget = Budget(),
    progress: Callable[[str], None] | None = None,
) -> GPFit:
    """Train a DPSE Gaussian process on inputs X (n, d) and output y (n,), any units; `sample` adds the posterior."""
    # `names` of the inputs, and of the output behind them.
    X, y = np.asarray(X, float), np.asarray(y, float)
    names = names or (*(f"x{i}" for i in range(X.shape[-1])), "y")
    names, output_name, seed = names[:-1], names[-1], budget.seed
    if len(X) > MAX_SAMPLES:
        raise InputError(too_many(len(X)))
    if sample and not priors.proper:
        raise InputError("A flat hyperparameter prior is improper: set sample=False or give proper priors.")
    scaling = Scaling.of(X, y, names)
    data = ReducedData.of(scaling.inputs(X), y / scaling.rms)
    with tqdm(disable=progress is not None or not sys.stderr.isatty(), unit="", leave=False) as bar:

        def show(text: str) -> None:
            bar.set_description(f"{output_name}: {text}", refresh=False)
            bar.update()

        tell = progress or show
        optima = tuple(find_map(data, priors, starts=budget.starts, seed=seed, progress=tell))
        status, sampled, draws, tree = SampleStatus.not_sampled, None, None, None
        if sample and optima[0].status is MapStatus.not_positive_definite:
            status = SampleStatus.no_optimum
        elif sample and data.dependent:
            status = SampleStatus.dependent
        elif sample:
            sampled = sample_posterior(optima[0], data, priors, budget=budget, tell=tell)
            status = sampled.status
    if sampled is not None and sampled.weighted is not None and status is SampleStatus.accepted:
        weighted = sampled.weighted
        flat = weighted.theta.reshape(-1, weighted.theta.shape[-1])
        best = flat[int(np.argmax(weighted.exact))]  # perhaps near an optimum that the starts did not find
        if np.max(np.abs(noise_to_signal(best) - optima[0].u)) > SAME_OPTIMUM:
            another = maximise(noise_to_signal(best), data, priors, w=best[: len(names) + 2])
            optima = tuple(distinct([*optima, another], len(optima) + 1))
        at = systematic_resample(weighted.log_weight, seed)
        draws = flat[at]
        tree = posterior_tree(sampled, at, scaling, priors, names, output_name, seed)
    return GPFit(names, scaling, priors, data, optima, status, sampled, draws, tree)


def too_many(n: int) -> str:
    """Why so many samples are refused, and the alternatives."""
    return (
        f"n = {n} samples exceed the bound of {MAX_SAMPLES} of the exact Gaussian process (about "
        f"{5 * 8 * n**2 / 2**30:.0f} GiB and n^3 time); give shorter parts of the records, or a longer time step "
        "(--resample)"
    )


# --- Predictions of the GP: mean, standard deviation and quantiles, at the MAP or over the posterior of theta.
# Over the posterior, the predictive distribution is an equal-weight mixture of Gaussians, one for each of a few
# draws; its quantiles are those of the mixture, not of a Gaussian with the mixture's sd. All are of the *measured*
# output: latent function plus white noise (see the caveat in `kernel.py` on what white noise means here).


LEVELS = (0.5, 0.9, 0.95)


class Prediction(NamedTuple):
    """Predictive distribution at n points, in the unit of the output."""

    mean: Float[np.ndarray, " n"]  # of a new measurement, as `sd`
    sd: Float[np.ndarray, " n"]
    latent_sd: Float[np.ndarray, " n"]  # of the function without noise
    levels: tuple[float, ...]  # of the central intervals from `low` to `high`
    low: Float[np.ndarray, "levels n"]
    high: Float[np.ndarray, "levels n"]
    component_mean: Float[np.ndarray, "draws n"]  # of the Gaussians of the mixture
    component_sd: Float[np.ndarray, "draws n"]

    @classmethod
    def of_mixture(
        cls,
        means: Float[np.ndarray, "draws n"],
        latent: Float[np.ndarray, "draws n"],
        noise: Float[np.ndarray, " draws"],
    ) -> Prediction:
        """Equal-weight mixture of Gaussians with `means`, latent variances and noise variances."""
        between, sds = means.var(axis=0), np.sqrt(latent + noise[:, None])
        sd = np.sqrt(between + np.mean(sds**2, axis=0))

        def quantile(probability: float) -> np.ndarray:
            """By bisection: the cdf is monotone and the ends bracket every component's quantile."""
            low, high = (means - 9.0 * sds).min(axis=0), (means + 9.0 * sds).max(axis=0)
            for _ in range(50):
                middle = 0.5 * (low + high)
                below = ndtr((middle - means) / sds).mean(axis=0) < probability
                low, high = np.where(below, middle, low), np.where(below, high, middle)
            return 0.5 * (low + high)

        tails = [(1.0 - level) / 2.0 for level in LEVELS]
        low, high = (np.array([quantile(p) for p in ps]) for ps in (tails, [1.0 - tail for tail in tails]))
        latent_sd = np.sqrt(between + latent.mean(axis=0))
        return cls(means.mean(axis=0), sd, latent_sd, LEVELS, low, high, means, sds)

    def coverage(self, measured: Float[np.ndarray, " n"]) -> dict[float, float]:
        """Share of `measured` inside each central interval, by level."""
        z = np.asarray(measured, float)
        inside = (z >= self.low) & (z <= self.high)
        return dict(zip(self.levels, inside.mean(axis=1).tolist(), strict=True))


def gaussian_parts(
    theta: Float[np.ndarray, " p"], data: ReducedData, x_new: Float[np.ndarray, "k d"]
) -> tuple[Float[np.ndarray, " k"], Float[np.ndarray, " k"]]:
    """Mean and variance of the latent function at scaled inputs x_new (k, d), in scaled output units."""
    # With R, F, D of `kernel`, S = R^-1 F (D^-1 + F'R^-1 F)^-1 and k_*: the explicit-basis form (Rasmussen and
    # Williams 2006, eq. 2.42) with a proper prior D on the basis. One factorisation and one triangular solve.
    d, factor = data.x.shape[1], factorise(noise_to_signal(theta), data)
    if factor is None:
        raise np.linalg.LinAlgError("covariance not positive definite at an accepted draw")
    lower, v = factor
    length, sf2 = np.exp(theta[d + 2 : 2 * d + 2]), np.exp(2.0 * theta[d + 1])
    root = np.exp(theta[: d + 1] - theta[d + 1])
    basis = data.fy[:, : d + 1] * root
    v_basis, v_y = v[:, : d + 1] * root, v[:, d + 1]
    inner = (cholesky(np.eye(d + 1) + basis.T @ v_basis, lower=True), True)
    weight = cho_solve(inner, basis.T @ v_y)  # posterior mean of the basis weights, in units of root
    cross = scaled_distance_kernel(data.x / length, x_new / length)  # (n, k)
    new = np.column_stack([np.ones(len(x_new)), x_new]) * root
    mean = new @ weight + cross.T @ (v_y - v_basis @ weight)
    extra = solve_triangular(inner[0], (new - cross.T @ v_basis).T, lower=True)
    half = solve_triangular(lower, cross, lower=True, check_finite=False)
    variance = 1.0 - np.einsum("ij,ij->j", half, half) + np.einsum("ij,ij->j", extra, extra)
    return mean, sf2 * np.maximum(variance, 0.0)
