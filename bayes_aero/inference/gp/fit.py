"""Gaussian-process regression of one output on a few inputs: `fit_gp`, and its result `GPFit`.

fit = fit_gp(X, y, input_names=("alpha", "elevator", "q", "V"), sample=True, seed=1)
fit.predict(X_new).mean;  fit.posterior;  fit.status.value;  fit.k_hat
"""

import sys
from collections.abc import Callable
from dataclasses import dataclass

import jax
import numpy as np
import xarray as xr
from jaxtyping import Float
from tqdm import tqdm

from bayes_aero.errors import InputError
from bayes_aero.inference.gp.groups import posterior_tree, systematic_resample
from bayes_aero.inference.gp.kernel import Scaling, noise_to_signal
from bayes_aero.inference.gp.optimum import SAME_OPTIMUM, MapStatus, Optimum, distinct, find_map, maximise
from bayes_aero.inference.gp.posterior import Budget, Sampled, sample_posterior
from bayes_aero.inference.gp.predict import Prediction, gaussian_parts, mixture
from bayes_aero.inference.gp.priors import Priors
from bayes_aero.inference.gp.reduced import ReducedData
from bayes_aero.inference.gp.sampling.reweight import SampleStatus

__all__ = ["MAX_SAMPLES", "GPFit", "fit_gp"]

MAX_SAMPLES = 8000
Matrix = Float[np.ndarray, "n d"] | Float[jax.Array, "n d"]
Vector = Float[np.ndarray, " n"] | Float[jax.Array, " n"]


@dataclass(frozen=True, eq=False)
class GPFit:
    """A trained GP.

    `optima`: the distinct optima found, best first. `status`: result of the sampling (`.value` is advice).
    `posterior`: DataTree with posterior, sample_stats, prior and proposal groups, hyperparameters in physical
    units; None unless the status is accepted. `draws` (S, 2d + 3): the posterior's theta, log scaled, equal weight.
    """

    input_names: tuple[str, ...]
    output_name: str
    scaling: Scaling
    priors: Priors
    data: ReducedData
    optima: tuple[Optimum, ...]
    status: SampleStatus
    sampled: Sampled | None
    draws: Float[np.ndarray, "draws p"] | None
    posterior: xr.DataTree | None

    @property
    def map(self) -> dict[str, np.ndarray]:
        """Most probable hyperparameters in physical units (density of their logarithms)."""
        return self.scaling.physical(self.optima[0].theta)

    @property
    def map_status(self) -> MapStatus:
        """How the search for them ended."""
        return self.optima[0].status

    @property
    def k_hat(self) -> float:
        """Pareto k of the re-weighting to the exact posterior; NaN where it was not reached."""
        weighted = self.sampled.weighted if self.sampled else None
        return weighted.k_hat if weighted else float("nan")

    def predict(self, X_new: Matrix, *, draws: int = 24) -> Prediction:
        """Predictive distribution of new measurements at X_new (k, d), physical units.

        Over `draws` posterior draws where sampling was accepted, else at the MAP only (then the intervals leave
        the hyperparameters' uncertainty out). Each draw costs one n x n factorisation: 24 bound the Monte Carlo
        error of the mean by a fifth of the (small) spread between draws.
        """
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
        parts = [gaussian_parts(t, self.data, x_new) for t in thetas]
        means, latent = (np.array(p) for p in zip(*parts, strict=True))
        rms = self.scaling.rms
        return mixture(rms * means, rms**2 * latent, rms**2 * np.exp(2.0 * thetas[:, -1]))


def fit_gp(
    X: Matrix,
    y: Vector,
    *,
    input_names: tuple[str, ...] | None = None,
    output_name: str = "y",
    priors: Priors = Priors(),
    sample: bool = True,
    seed: int = 0,
    starts: int = 16,
    budget: Budget = Budget(),
    progress: Callable[[str], None] | None = None,
) -> GPFit:
    """Train a DPSE Gaussian process on inputs X (n, d) and output y (n,), any units; same seed, same numbers.

    `sample` adds the posterior of the hyperparameters at all n points to the MAP: exact after re-weighting, or
    refused with a status. More than `MAX_SAMPLES` samples are refused. `progress` is called with a text at each step;
    default: a progress bar on a terminal.
    """
    X, y = np.asarray(X, float), np.asarray(y, float)
    names = tuple(input_names or (f"x{i}" for i in range(X.shape[-1])))
    _check(X, y, names)
    if sample and not priors.proper:
        raise InputError("A flat hyperparameter prior is improper: set sample=False or give proper priors.")
    scaling = Scaling.of(X, y, names)
    data = ReducedData.of(scaling.inputs(X), y / scaling.rms)
    with tqdm(disable=progress is not None or not sys.stderr.isatty(), unit="", leave=False) as bar:

        def show(text: str) -> None:
            bar.set_description(f"{output_name}: {text}", refresh=False)
            bar.update()

        tell = progress or show
        optima = tuple(find_map(data, priors, starts=starts, seed=seed, progress=tell))
        status, sampled, draws, tree = SampleStatus.not_sampled, None, None, None
        if sample and optima[0].status is MapStatus.not_positive_definite:
            status = SampleStatus.no_optimum
        elif sample and data.dependent:
            status = SampleStatus.dependent
        elif sample:
            sampled = sample_posterior(optima[0], data, priors, budget=budget, seed=seed, tell=tell)
            status = sampled.status
            optima = _with_mode_of_draws(optima, sampled, data, priors)
    if sampled is not None and sampled.weighted is not None and status is SampleStatus.accepted:
        at = systematic_resample(sampled.weighted.log_weight, seed)
        draws = sampled.weighted.theta.reshape(-1, sampled.weighted.theta.shape[-1])[at]
        tree = posterior_tree(sampled, at, scaling, priors, names, output_name, seed)
    return GPFit(names, output_name, scaling, priors, data, optima, status, sampled, draws, tree)


def _with_mode_of_draws(
    optima: tuple[Optimum, ...], sampled: Sampled, data: ReducedData, priors: Priors
) -> tuple[Optimum, ...]:
    """The optima, and the optimum near the best exact draw if it is a new one, which the starts did not find."""
    weighted = sampled.weighted
    if weighted is None or sampled.status is not SampleStatus.accepted:
        return optima
    theta = weighted.theta.reshape(-1, weighted.theta.shape[-1])[int(np.argmax(weighted.exact))]
    if np.max(np.abs(noise_to_signal(theta) - optima[0].u)) <= SAME_OPTIMUM:
        return optima
    another = maximise(noise_to_signal(theta), data, priors, w=theta[: data.x.shape[1] + 2])
    return tuple(distinct([*optima, another], len(optima) + 1))


def _check(X: np.ndarray, y: np.ndarray, names: tuple[str, ...]) -> None:
    """Raise `InputError` for data that cannot be fitted."""
    if X.ndim != 2 or y.shape != X.shape[:1] or len(names) != X.shape[1]:
        raise InputError(f"Inputs {X.shape}, output {y.shape} and {len(names)} input names do not go together.")
    n, d = X.shape
    if n < 2 * d + 4:
        raise InputError(f"{n} samples cannot determine {2 * d + 3} hyperparameters; give more samples.")
    if n > MAX_SAMPLES:
        raise InputError(too_many(n))
    for name, column in (*zip(names, X.T, strict=True), ("output", y)):
        if not np.all(np.isfinite(column)):
            at = int(np.flatnonzero(~np.isfinite(column))[0])
            raise InputError(f"{name} is not finite at sample {at}; remove or repair that sample.")


def too_many(n: int) -> str:
    """Why so many samples are refused, and the alternatives."""
    return (
        f"n = {n} samples exceed the bound of {MAX_SAMPLES} of the exact Gaussian process (about "
        f"{5 * 8 * n**2 / 2**30:.0f} GiB and n^3 time); give shorter parts of the records, or a longer time step "
        "(--resample)"
    )
