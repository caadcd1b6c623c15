"""Fits with parameters that drift: intensities, likelihood ratios, and histories.

The intensity of each drift is estimated by maximum likelihood together with all other parameters. The variance of a
history is that of the smoother at known parameters, plus that due to the errors of the estimated parameters. Sources:
Rauch, Tung, Striebel 1965, AIAA J. 3, 1445; Hamilton 1986, J. Econometrics 33, 387 (variance of estimated parameters).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from bayes_aero.dynamics.filtering.drifting import PREFIX, drifting
from bayes_aero.dynamics.filtering.innovations import filter_segments
from bayes_aero.dynamics.filtering.kalman import log_likelihood, smooth
from bayes_aero.dynamics.segments import SegmentTrajectories
from bayes_aero.inference.likelihood.normal_equations import initial_state_sd
from bayes_aero.inference.likelihood.prediction_error import (
    MIN_NOISE,
    PredictionErrorResult,
    PredictionErrorStatus,
    fit_prediction_error,
)

START_CHANGES = np.logspace(0.0, 2.5, 6)  # starting intensities: change over a manoeuvre, in standard errors
MAX_LOG_ERROR = 2.0  # standard error of log F or log R from which it is not determined and not propagated
ZERO_INTENSITY = 10.0 * MIN_NOISE  # an intensity at its bound
DIFFERENCE_STEP = 0.1  # standard errors; step of the derivatives of the histories


@dataclass(frozen=True)
class DriftFit:
    """The fit with m drifting parameters.

    `ratios` (m,): likelihood ratio of each drift, twice the loss of log density without it; `ratio` is that of all
    drifts together. `usable`: whether every fit converged.
    """

    flown: SegmentTrajectories
    drifting: tuple[str, ...]
    fit: PredictionErrorResult
    ratio: float
    ratios: Float[np.ndarray, " m"]
    usable: bool

    @property
    def intensity(self) -> Float[np.ndarray, "m 2"]:
        """Intensity of each drift, unit of the parameter per square root of a second, and the standard error of its
        logarithm; 0 where there is no drift."""
        k, drifts = len(self.fit.names), self._drift_states
        found = np.stack([self.fit.F[drifts], np.sqrt(np.diag(self.fit.covariance)[k:][drifts])], axis=1)
        return np.where(found[:, :1] > ZERO_INTENSITY, found, 0.0)

    @property
    def _drift_states(self) -> list[int]:
        return [self.fit.states.index(PREFIX + name) for name in self.drifting]


class Histories(NamedTuple):
    """Smoothed drifts and parameter values (initial value plus drift) of w segments, (w, n, m), and their standard
    deviations; those of the values include the standard errors of all parameters."""

    drift: Float[np.ndarray, "w n m"]
    drift_sd: Float[np.ndarray, "w n m"]
    value: Float[np.ndarray, "w n m"]
    value_sd: Float[np.ndarray, "w n m"]


def fit_drifting(
    flown: SegmentTrajectories,
    without_drift: PredictionErrorResult,
    names: Sequence[str],
    *,
    priors: bool = True,
) -> DriftFit:
    """Fit with the parameters `names` drifting, then without each drift in turn that has an intensity.

    Args:
        flown: segments of flights, whole manoeuvres.
        without_drift: the fit without drift.
        names: free parameters that drift.
        priors: whether the parameters' priors count.

    Raises:
        InputError: a parameter cannot drift.
    """
    drifting_segments = replace(flown, dynamics=drifting(flown.dynamics, names))
    intensities = np.append(without_drift.F, _start_intensities(drifting_segments, without_drift, names))
    fit = fit_prediction_error(
        drifting_segments, intensities, without_drift.R, start=without_drift.estimate, priors=priors
    )
    gain = max(2.0 * (without_drift.cost - fit.cost), 0.0)
    drift_index = np.arange(len(fit.F)) - len(without_drift.F)
    significant = np.flatnonzero(fit.F[len(without_drift.F) :] > ZERO_INTENSITY)
    ratios, fits = np.zeros(len(names)), [without_drift, fit]
    ratios[significant] = gain
    for i in significant if len(significant) > 1 else ():  # one drift alone has the ratio of all
        F = np.where((drift_index == i) | (drift_index >= 0) & (fit.F <= ZERO_INTENSITY), 0.0, fit.F)
        fits.append(fit_prediction_error(drifting_segments, F, fit.R, start=fit.estimate, priors=priors))
        ratios[i] = min(max(2.0 * (fits[-1].cost - fit.cost), 0.0), gain)  # without any drift it fits no better
    usable = all(one.status is PredictionErrorStatus.CONVERGED for one in fits)
    return DriftFit(drifting_segments, tuple(names), fit, gain, ratios, usable)


@eqx.filter_jit
def _smooth(flown, theta, deviation, F, R):
    """Log likelihood, and smoothed states with their variances, (w, n, s)."""
    found = filter_segments(flown, theta, deviation, F, R)
    x, P = jax.vmap(smooth)(found)
    return jnp.sum(jax.vmap(log_likelihood)(found)), x, jnp.diagonal(P, axis1=2, axis2=3)


def _deviation(flown: SegmentTrajectories) -> Array:
    """Standard deviation of the measured initial state; the default of `fit_prediction_error`."""
    s = len(flown.dynamics.states)
    return jnp.asarray(np.zeros(s) if flown.fixed is not None else initial_state_sd(flown.dynamics))


def _start_intensities(
    flown: SegmentTrajectories, without_drift: PredictionErrorResult, names: Sequence[str]
) -> Float[np.ndarray, " m"]:
    """Starting intensity of each drift by itself: the one of `START_CHANGES` with the highest likelihood."""
    seconds = float(np.max(flown.inside.sum(axis=1) * flown.dt))
    nameless, deviation = flown.nameless, _deviation(flown)
    intensities = []
    for i, name in enumerate(names):
        row = without_drift.names.index(name)
        size = float(without_drift.sd[row]) or abs(float(without_drift.estimate[row])) or 1.0  # 0: not determined
        trials = size * START_CHANGES / np.sqrt(seconds)
        likelihoods = []
        for sigma in trials:
            F = np.append(without_drift.F, np.where(np.arange(len(names)) == i, sigma, 0.0))
            point = map(jnp.asarray, (without_drift.estimate, deviation, F, without_drift.R))
            likelihoods.append(float(_smooth(nameless, *point)[0]))
        intensities.append(trials[int(np.argmax(np.nan_to_num(likelihoods, nan=-np.inf)))])
    return np.array(intensities)


def histories(found: DriftFit) -> Histories:
    """Smoothed drifts and parameter values at every sample."""
    fit, k, s = found.fit, len(found.fit.names), len(found.fit.states)
    drifts, rows = found._drift_states, [fit.names.index(name) for name in found.drifting]
    nameless, deviation = found.flown.nameless, _deviation(found.flown)
    point = np.concatenate([fit.estimate, np.log(np.maximum(fit.F, MIN_NOISE)), np.log(fit.R)])

    def path(point: Float[np.ndarray, " j"]) -> tuple[np.ndarray, np.ndarray]:
        F, R = np.exp(point[k : k + s]), np.exp(point[k + s :])
        _, x, variance = _smooth(nameless, *map(jnp.asarray, (point[:k], deviation, F, R)))
        return np.asarray(x)[..., drifts], np.asarray(variance)[..., drifts]

    drift, variance = path(point)
    extra = [np.zeros_like(drift), np.zeros_like(drift)]
    for column in _covariance_root(fit):
        step = DIFFERENCE_STEP * column
        slope = (path(point + step)[0] - path(point - step)[0]) / (2.0 * DIFFERENCE_STEP)
        extra[0] += slope**2
        extra[1] += (slope + column[rows]) ** 2
    sds = [np.sqrt(np.maximum(variance + more, 0.0)) for more in extra]
    return Histories(drift, sds[0], fit.estimate[rows] + drift, sds[1])


def _covariance_root(fit: PredictionErrorResult) -> Float[np.ndarray, "i j"]:
    """Rows V with V' V the covariance of the determined parameters."""
    sd, k = np.sqrt(np.diag(fit.covariance)), len(fit.names)
    known = (sd > 0.0) & ((np.arange(len(sd)) < k) | (sd < MAX_LOG_ERROR))
    scaled = fit.covariance[np.ix_(known, known)] / np.outer(sd[known], sd[known])
    values, vectors = np.linalg.eigh(scaled)
    rows = np.zeros((int(known.sum()), len(sd)))
    rows[:, known] = (vectors * np.sqrt(np.maximum(values, 0.0))).T * sd[known]
    return rows
