"""Fits with parameters that drift: how fast, whether the record needs it, and their histories.

The intensity of each drift is found by maximum likelihood with all else. A history given all samples has the variance
of the smoother, at known parameters, and that which the estimated ones bring. Sources: Rauch, Tung, Striebel 1965,
AIAA J. 3, 1445; Hamilton 1986, J. Econometrics 33, 387 (variance of estimated parameters).
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
from bayes_aero.dynamics.filtering.innovations import filtered
from bayes_aero.dynamics.filtering.kalman import log_likelihood, smoothed
from bayes_aero.dynamics.segments import SegmentTrajectories
from bayes_aero.inference.likelihood.normal_equations import departures
from bayes_aero.inference.likelihood.prediction_error import (
    LEAST,
    PredictionErrorResult,
    PredictionErrorStatus,
    fit_prediction_error,
)

TRIED = np.logspace(0.0, 2.5, 6)  # intensities to start from: change over a manoeuvre, in errors of the parameter
UNKNOWN = 2.0  # error of a logarithm of F or R from which it is not determined, and moves nothing
NONE = 10.0 * LEAST  # an intensity at its bound
SHIFT = 0.1  # errors by which parameters are moved for a derivative of the histories


@dataclass(frozen=True)
class DriftFit:
    """The fit with m drifting parameters.

    `intensity` (m, 2): unit of each per square root of a second, and the standard error of its logarithm; 0: none.
    `ratios` (m,): likelihood ratio, twice the gain in log density, by which the fit needs the drift of each beside
    those of the others; `ratio` that of all. `usable`: whether every fit converged.
    """

    flown: SegmentTrajectories
    drifting: tuple[str, ...]
    fit: PredictionErrorResult
    ratio: float
    ratios: Float[np.ndarray, " m"]
    usable: bool

    @property
    def intensity(self) -> Float[np.ndarray, "m 2"]:
        """Of each drift, and its error."""
        k, at = len(self.fit.names), self._states
        found = np.stack([self.fit.F[at], np.sqrt(np.diag(self.fit.covariance)[k:][at])], axis=1)
        return np.where(found[:, :1] > NONE, found, 0.0)

    @property
    def _states(self) -> list[int]:
        return [self.fit.states.index(PREFIX + name) for name in self.drifting]


class Histories(NamedTuple):
    """Given all samples (w segments): drifts and, with the parameters they start from, values, (w, n, m) each; their
    standard deviations, those of the values with the errors of all parameters."""

    drift: Float[np.ndarray, "w n m"]
    drift_sd: Float[np.ndarray, "w n m"]
    value: Float[np.ndarray, "w n m"]
    value_sd: Float[np.ndarray, "w n m"]


def fit_drifting(
    flown: SegmentTrajectories,
    still: PredictionErrorResult,
    names: Sequence[str],
    *,
    priors: bool = True,
) -> DriftFit:
    """Fit with parameters `names` drifting, then without the drift of each that has an intensity, in turn.

    Args:
        flown: segments of flights, whole manoeuvres.
        still: the fit without drift.
        names: free parameters.
        priors: whether the parameters' priors count.

    Raises:
        InputError: a parameter cannot drift.
    """
    moving = replace(flown, dynamics=drifting(flown.dynamics, names))
    begun = np.append(still.F, _begun(moving, still, names))
    fit = fit_prediction_error(moving, begun, still.R, start=still.estimate, priors=priors)
    gain = max(2.0 * (still.cost - fit.cost), 0.0)
    own = np.arange(len(fit.F)) - len(still.F)
    walking = np.flatnonzero(fit.F[len(still.F) :] > NONE)
    ratios, fits = np.zeros(len(names)), [still, fit]
    ratios[walking] = gain
    for i in walking if len(walking) > 1 else ():  # the only one's is that of all
        F = np.where((own == i) | (own >= 0) & (fit.F <= NONE), 0.0, fit.F)
        fits.append(fit_prediction_error(moving, F, fit.R, start=fit.estimate, priors=priors))
        ratios[i] = min(max(2.0 * (fits[-1].cost - fit.cost), 0.0), gain)  # without any drift it fits no better
    usable = all(one.status is PredictionErrorStatus.CONVERGED for one in fits)
    return DriftFit(moving, tuple(names), fit, gain, ratios, usable)


@eqx.filter_jit
def _smooth(flown, theta, deviation, F, R):
    """Log likelihood, and states given all samples with their variances, (w, n, s)."""
    found = filtered(flown, theta, deviation, F, R)
    x, P = jax.vmap(smoothed)(found)
    return jnp.sum(jax.vmap(log_likelihood)(found)), x, jnp.diagonal(P, axis1=2, axis2=3)


def _deviation(flown: SegmentTrajectories) -> Array:
    """Of the measured initial state, as `fit_prediction_error` has it by default."""
    s = len(flown.dynamics.states)
    return jnp.asarray(np.zeros(s) if flown.fixed is not None else departures(flown.dynamics))


def _begun(flown: SegmentTrajectories, still: PredictionErrorResult, names: Sequence[str]) -> Float[np.ndarray, " m"]:
    """Intensities to start from: of each alone, that of `TRIED` with the highest likelihood."""
    seconds = float(np.max(flown.inside.sum(axis=1) * flown.dt))
    nameless, deviation = flown.nameless, _deviation(flown)
    begun = []
    for i, name in enumerate(names):
        at = still.names.index(name)
        size = float(still.sd[at]) or abs(float(still.estimate[at])) or 1.0  # of what the record does not tell
        tried = size * TRIED / np.sqrt(seconds)
        found = []
        for sigma in tried:
            F = np.append(still.F, np.where(np.arange(len(names)) == i, sigma, 0.0))
            found.append(float(_smooth(nameless, *map(jnp.asarray, (still.estimate, deviation, F, still.R)))[0]))
        begun.append(tried[int(np.argmax(np.nan_to_num(found, nan=-np.inf)))])
    return np.array(begun)


def histories(found: DriftFit) -> Histories:
    """Drifts and values at every sample, given all samples."""
    fit, k, s = found.fit, len(found.fit.names), len(found.fit.states)
    at, own = found._states, [fit.names.index(name) for name in found.drifting]
    nameless, deviation = found.flown.nameless, _deviation(found.flown)
    point = np.concatenate([fit.estimate, np.log(np.maximum(fit.F, LEAST)), np.log(fit.R)])

    def path(point: Float[np.ndarray, " j"]) -> tuple[np.ndarray, np.ndarray]:
        F, R = np.exp(point[k : k + s]), np.exp(point[k + s :])
        _, x, variance = _smooth(nameless, *map(jnp.asarray, (point[:k], deviation, F, R)))
        return np.asarray(x)[..., at], np.asarray(variance)[..., at]

    drift, variance = path(point)
    extra = [np.zeros_like(drift), np.zeros_like(drift)]
    for column in _columns(fit):
        slope = (path(point + SHIFT * column)[0] - path(point - SHIFT * column)[0]) / (2.0 * SHIFT)
        extra[0] += slope**2
        extra[1] += (slope + column[own]) ** 2
    sds = [np.sqrt(np.maximum(variance + more, 0.0)) for more in extra]
    return Histories(drift, sds[0], fit.estimate[own] + drift, sds[1])


def _columns(fit: PredictionErrorResult) -> Float[np.ndarray, "i j"]:
    """Rows that squared and added are the covariance, of what is determined."""
    sd, k = np.sqrt(np.diag(fit.covariance)), len(fit.names)
    known = (sd > 0.0) & ((np.arange(len(sd)) < k) | (sd < UNKNOWN))
    scaled = fit.covariance[np.ix_(known, known)] / np.outer(sd[known], sd[known])
    size, towards = np.linalg.eigh(scaled)
    rows = np.zeros((int(known.sum()), len(sd)))
    rows[:, known] = (towards * np.sqrt(np.maximum(size, 0.0))).T * sd[known]
    return rows
