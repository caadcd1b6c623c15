"""The same parameters by a filter that estimates gusts, process noise and measurement noise with them.

Parameters may drift. A likelihood ratio of an intensity at its bound of zero is half at zero and half chi-square (Self
and Liang 1987, JASA 82, 605). A record has one walk of each, so that more than half is at zero and these p-values are
rather too large than too small (Shephard and Harvey 1990, J. Time Series Analysis 11, 339). Several: Holm 1979.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from scipy.stats import chi2

from bayes_aero.diagnosis.trajectories.drift import Drift, DriftChange, Drifted, DriftHistory
from bayes_aero.diagnosis.trajectories.results import GustHistory, ProcessNoise, TrajectoryFit
from bayes_aero.dynamics.filtering.innovations import neighbour_correlation, prediction_errors
from bayes_aero.dynamics.filtering.kalman import smooth
from bayes_aero.dynamics.flight import EffectDynamics
from bayes_aero.dynamics.segments import SegmentTrajectories
from bayes_aero.inference.likelihood.disturbed import fit_disturbed
from bayes_aero.inference.likelihood.drifting import DriftFit, Histories, fit_drifting, histories
from bayes_aero.inference.likelihood.prediction_error import PredictionErrorResult, PredictionErrorStatus
from bayes_aero.inference.one_step import one_step
from bayes_aero.inference.posterior.innovations import sample_innovations
from bayes_aero.inference.posterior.posterior import Posterior
from bayes_aero.inference.scores import OneStep
from bayes_aero.inference.threads import blas_threads
from bayes_aero.progress import Progress

SHARES = (0.1, 0.5, 0.9)  # of a change, whose times are told


@blas_threads(0)
def with_process_noise(
    flown: TrajectoryFit, drifting: Sequence[str] = ()
) -> tuple[ProcessNoise, Callable[[int, Progress | None, str], dict[str, Posterior]]]:
    """Fit again, from the estimates of output error, in gusts and with noise of every state that is compared.

    Parameters that are `drifting` drift in a further fit.

    Returns:
        What the fit says, and what samples its posterior from a seed by a sampler.
    """
    fit = flown.fit
    gusty, found = fit_disturbed(fit.flown, fit.estimate, fit.R, priors=flown.setting.priors)

    def sample(seed: int, progress: Progress | None, engine: str) -> dict[str, Posterior]:
        with blas_threads(0):
            return sample_innovations(gusty, found, fit.R, seed=seed, engines=(engine,), progress=progress)

    return _told(flown, gusty, found, drifting), sample


def _told(
    flown: TrajectoryFit, gusty: SegmentTrajectories, found: PredictionErrorResult, drifting: Sequence[str]
) -> ProcessNoise:
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
        with_drift(gusty, found, drifting, priors=flown.setting.priors) if drifting else None,
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


def with_drift(
    flown: SegmentTrajectories,
    still: PredictionErrorResult,
    names: Sequence[str],
    *,
    priors: bool = True,
) -> Drift:
    """Fit with parameters `names` drifting, compared with the fit `still` without drift; see `fit_drifting`."""
    found = fit_drifting(flown, still, names, priors=priors)
    fit, path = found.fit, histories(found)
    p = holm(np.array([at_bound(float(r)) for r in found.ratios]))
    units = {parameter.name: parameter.unit for parameter in found.flown.dynamics.free}
    parts = _parts(found.flown)
    told = {
        name: Drifted(
            units[name],
            (float(found.intensity[i, 0]), float(found.intensity[i, 1])),
            float(found.ratios[i]),
            float(p[i]),
            {manoeuvre: _change(path, k, real, i, time) for manoeuvre, (k, real, time) in parts.items()},
        )
        for i, name in enumerate(names)
    }
    shown = tuple(DriftHistory(m, time, _values(path, k, real, found)) for m, (k, real, time) in parts.items())
    estimates = {n: (float(x), float(s)) for n, x, s in zip(fit.names, fit.estimate, fit.sd, strict=True)}
    alike = neighbour_correlation(fit.found)
    correlation = dict(zip(fit.outputs, map(float, alike), strict=True))
    return Drift(found.usable, found.ratio, at_bound(found.ratio, len(names)), told, estimates, correlation, shown)


def at_bound(ratio: float, m: int = 1) -> float:
    """P-value of the likelihood ratio of `m` independent intensities at zero: each is zero or not, with even odds."""
    if ratio <= 0.0:
        return 1.0
    return float(sum(math.comb(m, i) * 0.5**m * chi2.sf(ratio, i) for i in range(1, m + 1)))


def holm(p: Float[np.ndarray, " m"]) -> Float[np.ndarray, " m"]:
    """P-values of `m` tests together: the smallest counts m times, the next m - 1 times."""
    order = np.argsort(p)
    together = np.empty(len(p))
    together[order] = np.maximum.accumulate(p[order] * np.arange(len(p), 0, -1))
    return np.minimum(together, 1.0)


def _parts(flown: SegmentTrajectories) -> dict[str, tuple[int, np.ndarray, np.ndarray]]:
    """By manoeuvre its segment, which samples are real, and their time from the first."""
    found = {}
    for k, number in enumerate(flown.manoeuvre):
        time = np.asarray(flown.flights.time)[flown.index[k][flown.inside[k]]]
        found[flown.flights.names[int(number)]] = (k, flown.inside[k], time - time[0])
    return found


def _values(path: Histories, k: int, real: np.ndarray, found: DriftFit) -> dict[str, tuple[Any, Any, Any]]:
    value, sd, change_sd = (x[k, real] for x in (path.value, path.value_sd, path.drift_sd))
    return {n: (value[:, i], sd[:, i], change_sd[:, i]) for i, n in enumerate(found.drifting)}


def _change(path: Histories, k: int, real: np.ndarray, i: int, time: Float[np.ndarray, " n"]) -> DriftChange:
    drift, sd = path.drift[k, real, i], path.drift_sd[k, real, i]
    far = int(np.argmax(np.abs(drift)))
    done = drift / drift[-1] if drift[-1] != 0.0 else np.ones_like(drift)
    low, half, high = SHARES
    middle = int(np.argmax(done >= half))
    begun = int(np.max(np.flatnonzero(done[: middle + 1] < low), initial=0))  # the last before it
    over = middle + int(np.argmax(done[middle:] >= high))
    size, farthest = ((float(drift[j]), float(sd[j])) for j in (-1, far))
    return DriftChange(size, farthest, float(time[far]), (float(time[begun]), float(time[middle]), float(time[over])))
