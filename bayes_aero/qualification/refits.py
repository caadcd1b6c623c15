"""The same model fitted to all manoeuvres but one, and to each by itself: hold-out errors, and the next flight."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from bayes_aero.diagnosis.trajectories.holdout_fits import CandidateFit, Noise, left_out, masked
from bayes_aero.diagnosis.trajectories.time_histories import posterior_draws
from bayes_aero.dynamics.segments import SegmentTrajectories
from bayes_aero.inference.likelihood.output_error import fit_output_error
from bayes_aero.inference.likelihood.output_error_result import OutputErrorResult, OutputErrorStatus
from bayes_aero.inference.posterior.pooled.hierarchy import Hierarchy, pool
from bayes_aero.inference.posterior.pooled.normal_estimates import from_prior_units, prior_unit, to_prior_units
from bayes_aero.progress import Progress
from bayes_aero.qualification.flights import errors, spread

USABLE = (OutputErrorStatus.CONVERGED, OutputErrorStatus.AT_BOUND)
DRAWS = 40  # of the posterior of a fit without a manoeuvre
NEGLIGIBLE = 1e-8  # eigenvalue of an information matrix over its largest


@dataclass(frozen=True)
class HoldOut:
    """Errors (w, n, c) of manoeuvres that were not fitted, and the mean squares (c,) that parameters explain, SI."""

    errors: Float[np.ndarray, "w n c"]
    explained: Float[np.ndarray, " c"]


def joint_fit(flown: SegmentTrajectories, theta: Float[np.ndarray, " k"], inflation: float) -> OutputErrorResult:
    """Output error from estimates that it has found before."""
    return fit_output_error(flown, start=theta, prior_weight=inflation)


def fits_without(fit: OutputErrorResult, noise: Noise) -> list[OutputErrorResult]:
    """For each manoeuvre the fit to all others."""
    candidate = CandidateFit("qualified", fit)
    silent = {candidate.name: {k: {} for k in range(len(fit.flown.index))}}
    return [found for _, found in left_out([candidate], silent, noise)]


def hold_out(
    wide: SegmentTrajectories, fits: Sequence[OutputErrorResult], inflation: float, seed: int
) -> HoldOut | None:
    """Errors of every manoeuvre by the fit without it; None where one of these fits cannot fly it."""
    found, explained, counts = [], [], []
    for k, fit in enumerate(fits):
        alone = wide.part([k])
        error, _, sound = errors(alone, fit.estimate)
        if not sound[0]:
            return None
        draws = posterior_draws(fit, inflation, seed, DRAWS)
        apart = spread(alone, fit.estimate, draws)[:, alone.inside[0]]
        found.append(error[0])
        explained.append(mean_square(apart))
        counts.append(float(alone.inside.sum()))
    return HoldOut(np.stack(found), np.average(explained, axis=0, weights=counts))


def mean_square(apart: Float[np.ndarray, "m n c"]) -> Float[np.ndarray, " c"]:
    """Of the flights that stay in the envelope; infinite where none does."""
    sound = np.all(np.isfinite(apart), axis=(1, 2))
    return np.mean(apart[sound] ** 2, axis=(0, 1)) if sound.any() else np.full(apart.shape[2], math.inf)


def alone_fits(fit: OutputErrorResult, without: Sequence[OutputErrorResult], inflation: float):
    """Every manoeuvre fitted by itself; of two, the fit without the other."""
    count = len(fit.flown.index)
    if count == 2:
        return [without[1], without[0]]
    options = {"start": fit.estimate, "prior_weight": inflation}
    return [fit_output_error(masked(fit.flown, k, keep=True), **options) for k in range(count)]


def next_parameters(
    alone: Sequence[OutputErrorResult], inflation: float, count: int, seed: int, progress: Progress | None = None
) -> Float[np.ndarray, "m k"] | None:
    """Draws of the parameters of a flight not yet flown, by partial pooling; None with fewer than two usable fits.

    Every manoeuvre enters by the normal approximation of its likelihood, with coloured residuals counted.
    """
    usable = [fit for fit in alone if fit.status in USABLE]
    if len(usable) < 2:
        return None
    y, information = zip(*(_of_data(fit, inflation) for fit in usable), strict=True)
    parameters = usable[0].parameters
    drawn, _ = pool(
        Hierarchy.of([p.name for p in parameters], np.stack(y), np.stack(information)), seed=seed, progress=progress
    )
    following = drawn.following.reshape(-1, len(parameters))
    kept = np.random.default_rng([seed, 11]).choice(len(following), count, replace=len(following) < count)
    found = [from_prior_units(p.prior, following[kept, i]) for i, p in enumerate(parameters)]
    lower, upper = (np.array([p.bounds[i] for p in parameters], float) for i in (0, 1))
    return np.clip(np.stack(found, axis=1), lower, upper)


def _of_data(fit: OutputErrorResult, inflation: float) -> tuple[Float[np.ndarray, " k"], Float[np.ndarray, "k k"]]:
    """The maximum of the likelihood and its information in units of the priors; none of parameters at a bound.

    At the maximum of the density the gradient of the likelihood is minus that of the prior.
    """
    parameters = fit.parameters
    unit = np.array([float(prior_unit(p.prior, x)) for p, x in zip(parameters, fit.estimate, strict=True)])
    mean = np.array([p.prior.normal[0] for p in parameters])
    free = np.array([p.name not in fit.at_bound for p in parameters], float)
    information = fit.information * np.outer(unit * free, unit * free) / inflation
    pulled = fit.priors.precision * unit**2 / inflation * (fit.estimate - mean) / unit * free
    y = np.array([float(to_prior_units(p.prior, x)) for p, x in zip(parameters, fit.estimate, strict=True)])
    return y + np.linalg.pinv(information, rcond=NEGLIGIBLE, hermitian=True) @ pulled, information
