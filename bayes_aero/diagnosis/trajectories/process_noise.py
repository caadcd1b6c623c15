"""The same parameters by a filter that estimates gusts, process noise and measurement noise with them."""

from __future__ import annotations

from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from bayes_aero.diagnosis.trajectories.results import GustHistory, ProcessNoise, TrajectoryFit
from bayes_aero.dynamics.filtering.innovations import neighbour_correlation, prediction_errors
from bayes_aero.dynamics.filtering.kalman import smooth
from bayes_aero.dynamics.flight import EffectDynamics
from bayes_aero.dynamics.segments import SegmentTrajectories
from bayes_aero.inference.likelihood.disturbed import fit_disturbed
from bayes_aero.inference.likelihood.prediction_error import PredictionErrorResult, PredictionErrorStatus
from bayes_aero.inference.one_step import one_step
from bayes_aero.inference.posterior.innovations import sample_innovations
from bayes_aero.inference.posterior.posterior import Posterior
from bayes_aero.inference.scores import OneStep
from bayes_aero.inference.threads import blas_threads
from bayes_aero.progress import Progress


@blas_threads(0)
def with_process_noise(
    flown: TrajectoryFit,
) -> tuple[ProcessNoise, Callable[[int, Progress | None, str], dict[str, Posterior]]]:
    """Fit again, from the estimates of output error, in gusts and with noise of every state that is compared.

    Returns:
        What the fit says, and what samples its posterior from a seed by a sampler.
    """
    fit = flown.fit
    gusty, found = fit_disturbed(fit.flown, fit.estimate, fit.R, priors=flown.setting.priors)

    def sample(seed: int, progress: Progress | None, engine: str) -> dict[str, Posterior]:
        with blas_threads(0):
            return sample_innovations(gusty, found, fit.R, seed=seed, engines=(engine,), progress=progress)

    return _told(flown, gusty, found), sample


def _told(flown: TrajectoryFit, gusty: SegmentTrajectories, found: PredictionErrorResult) -> ProcessNoise:
    fit = flown.fit
    inside = fit.flown.inside
    count = int(inside.sum())
    still = -0.5 * count * float(np.sum(np.log(2.0 * np.pi * fit.R) + 1.0)) - float(
        np.log(fit.flown.noise_growth[inside]).sum()
    )
    estimates = {n: (float(x), float(s)) for n, x, s in zip(found.names, found.estimate, found.sd, strict=True)}
    own = set(fit.flown.dynamics.names) - gusty.dynamics.disturbance_parameters
    converged = found.status is PredictionErrorStatus.CONVERGED
    theirs = [i for i, name in enumerate(found.names) if name in own]
    return ProcessNoise(
        found.status.value,
        converged,
        found.log_likelihood - still,
        {name: value for name, value in estimates.items() if name in own},
        {n: float(x) for n, x in zip(found.states, found.F, strict=True) if n in fit.flown.dynamics.start},
        dict(zip(found.outputs, map(float, np.sqrt(found.R)), strict=True)),
        dict(zip(found.outputs, map(float, neighbour_correlation(found.found)), strict=True)),
        {name: value for name, value in estimates.items() if name not in own},
        _histories(gusty, found),
        _predictions(gusty, found) if converged else None,
        found.covariance[np.ix_(theirs, theirs)],
    )


def _predictions(gusty: SegmentTrajectories, found: PredictionErrorResult) -> OneStep:
    errors = prediction_errors(gusty.nameless, jnp.asarray(found.estimate), found.found)
    return one_step(found.found, np.asarray(errors), found.outputs)


_smoothed = eqx.filter_jit(jax.vmap(smooth))


def _histories(gusty: SegmentTrajectories, found: PredictionErrorResult) -> tuple[GustHistory, ...]:
    """By manoeuvre, by the smoother; only gusts that have an intensity."""
    dynamics, known = gusty.dynamics, dict(zip(found.names, found.estimate, strict=True))
    processes = dynamics.model.disturbances if isinstance(dynamics, EffectDynamics) else ()
    met = {d.state: dynamics.states.index(d.state) for d in processes if known.get(d.intensity, 0.0) > 0.0}
    if not met:
        return ()
    x, P = (np.asarray(y) for y in _smoothed(found.found))
    flights, histories = gusty.flights, []
    for number in np.unique(gusty.manoeuvre):
        parts = [(k, gusty.inside[k]) for k in np.flatnonzero(gusty.manoeuvre == number)]
        time = np.concatenate([np.asarray(flights.time)[gusty.index[k][real]] for k, real in parts])
        gusts = {
            name: (
                np.concatenate([x[k, real, i] for k, real in parts]),
                np.sqrt(np.maximum(np.concatenate([P[k, real, i, i] for k, real in parts]), 0.0)),
            )
            for name, i in met.items()
        }
        histories.append(GustHistory(flights.names[number], time - time[0], gusts))
    return tuple(histories)
