"""How far estimates may be off: the residuals' colour, and the noise of what the regressors were recorded with.

What effects act through is recorded with noise, then smoothed and differentiated. Least squares on such regressors is
not consistent, and its residuals do not show it. Noise of the size that is there already, added once more, moves the
estimates by about as much as the noise that is there has moved them: the bias grows with the noise's variance. Source:
simulation extrapolation (SIMEX), Cook and Stefanski 1994, J. Am. Stat. Assoc. 89, 1314.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int
from scipy.optimize import linprog

from bayes_aero.diagnosis.candidate_set import by_manoeuvre
from bayes_aero.diagnosis.screening.parameter_fit import local_fit
from bayes_aero.diagnosis.screening.regression import RegressionFit, inverse
from bayes_aero.diagnosis.screening.screening import CandidateScore, uncertainty
from bayes_aero.diagnosis.screening.selection_state import SelectionState
from bayes_aero.effect import Effect
from bayes_aero.flight.health.finding import noise_of
from bayes_aero.model.joined_records import Flights
from bayes_aero.parameter import Parameter

PAIRS = 10  # of records with the same noise added and subtracted, which cancels what is linear in it
REGRESSORS = ("alpha", "airspeed", "q", "elevator")
AT_BOUND = 1e-6  # of a parameter's value, within which it lies on a bound: fits stop 1e-9 short
SLOW = 100.0  # largest variance of slow noise over that of the white noise beside it: ten times its size; our choice
FILTERED = -0.5  # lag-1 correlation of third differences above which they are not white noise's


@dataclass(frozen=True)
class Size:
    """Estimate of one parameter of a cause, SI, freed of what recording noise adds; see `sizes`."""

    mean: float
    sd: float
    unit: str
    at_bound: bool = False  # the fit wants to go on beyond the parameter's bounds: this is no measurement of it

    @property
    def ci95(self) -> tuple[float, float]:
        """Mean -+ 1.96 deviations."""
        return self.mean - 1.96 * self.sd, self.mean + 1.96 * self.sd


def implausible(effect: Effect, sizes: Mapping[str, Size]) -> dict[str, float]:
    """Parameters (1/e for one of infinite neutral value) with an estimate beyond the largest plausible size; that."""
    found = {}
    for p in (p for p in effect.parameters if p.name in effect.sizes and p.name in sizes):
        largest = effect.sizes[p.name][1]
        if abs(p.away(sizes[p.name].mean, sizes[p.name].sd)[0]) > largest:
            found[p.name if math.isfinite(p.neutral) else f"1/{p.name}"] = largest
    return found


def implausible_candidate(effect: Effect, standing: CandidateScore) -> bool:
    """Whether a candidate would be `implausible` at its first-order estimate, or at the value at which it was tried."""
    if standing.value is None:
        told = {
            p.name: Size(p.neutral + x, 0.0, p.unit) for p, x in zip(effect.parameters, standing.step, strict=False)
        }
    else:
        tried = next(name for name, values in effect.scan.items() if standing.value in values)
        told = {tried: Size(standing.value, 0.0, "")}
    return bool(implausible(effect, {n: size for n, size in told.items() if math.isfinite(size.mean)}))


def recording_noise(flights: Flights) -> dict[str, float]:
    """Standard deviation of the white part of every recorded channel, SI (see `noise_of`)."""
    return {name: noise_of(*by_manoeuvre(np.asarray(flights.channels[name]), flights)) for name in flights.recorded}


def filtered_channels(flights: Flights) -> tuple[str, ...]:
    """Channels behind the regressors whose noise was filtered before it was recorded, so that it cannot be read off."""
    # Third differences of white noise have a lag-1 correlation of -0.75; what is filtered, or motion, has not.
    found = []
    for name in (name for name in REGRESSORS if name in flights.recorded):
        rough = np.concatenate([np.diff(part, 3) for part in by_manoeuvre(np.asarray(flights.channels[name]), flights)])
        limit = 5.0 * np.median(np.abs(rough))
        inside = np.clip(rough, -limit, limit)
        if limit > 0.0 and np.corrcoef(inside[1:], inside[:-1])[0, 1] > FILTERED:
            found.append(name)
    return tuple(found)


def noise_effect(
    state: SelectionState, fit: RegressionFit, seed: int = 0
) -> tuple[Float[np.ndarray, " k"], Float[np.ndarray, " k"]]:
    """What recording noise does to the estimate of each of the fit's columns: its bias, and its standard deviation.

    `state` is at its optimum. Columns that are no parameters get zeros."""
    flights = state.responses.flights
    noise, rng = recording_noise(flights), np.random.default_rng(seed)
    parameters = fit.columns < len(state.theta)
    at = fit.columns[parameters]

    def step(extra: dict[str, np.ndarray], sign: float) -> np.ndarray:
        """The Gauss-Newton step from the optimum with more noise."""
        channels = flights.channels | {name: flights.channels[name] + sign * e for name, e in extra.items()}
        there = replace(state, responses=state.responses.with_channels(channels))
        # Variances held: grown by the noise they would let the prior pull more, which is no bias of the regressors.
        found = local_fit(there, state.theta, at, range(len(state.folds)), fit.variance)[0]
        return found.step[: len(at)]

    even, odd = [], []
    for _ in range(PAIRS):
        extra = {name: sd * rng.standard_normal(flights.n) for name, sd in noise.items()}
        there, back = step(extra, 1.0), step(extra, -1.0)
        even.append((there + back) / 2.0)
        odd.append((there - back) / 2.0)
    bias, spread = np.zeros((2, len(fit.columns)))
    bias[parameters] = np.mean(even, axis=0) - step({}, 0.0)
    spread[parameters] = np.sqrt(np.mean(np.square(odd), axis=0))
    return bias, spread


def largest_noise_bias(state: SelectionState, fit: RegressionFit, seed: int = 1) -> dict[str, tuple[float, float]]:
    """Lowest and highest bias of each parameter of the additions by noise of the recorded channels, of any size that
    the residuals permit.

    What is left of an output holds the noise of the channels that enter it, so their variances, each times what it adds
    to the output, sum up to no more than is left. The bias is linear in these variances, too. Slow noise cannot be told
    from motion in a channel by itself, so it is not estimated: it may be `SLOW` times what is read off as white.

    Source: Klepper and Leamer, Econometrica 52 (1984) 163 (estimates consistent with errors in all variables)."""
    flights, rng = state.responses.flights, np.random.default_rng(seed)
    parameters = fit.columns < len(state.theta)
    at, own = fit.columns[parameters], state.full.own_columns(*state.active)
    covariance = inverse(fit.normal)[np.isin(fit.columns, own)]
    keep = state.kept_outputs
    S, weight = state.scaled[state.inside][:, :, fit.columns], 1.0 / fit.variance
    biases, added = [], []
    for name, sd in recording_noise(flights).items():
        channel = flights.channels[name]
        if not sd > 0.0:
            continue
        noisy = flights.channels | {name: channel + sd * rng.standard_normal(flights.n)}
        residual, slopes = state.responses.with_channels(noisy).linearise(state.theta, at)
        dr = ((residual[:, keep] - state.residual) / state.noise_growth)[state.inside]
        dS = np.zeros_like(S)
        dS[:, :, parameters] = (slopes[:, keep] / state.noise_growth[:, :, None])[state.inside] - S[:, :, parameters]
        added.append(np.mean(dr**2, axis=0) * weight)
        biases.append(covariance @ np.einsum("mck,mc,c->k", dS, dr, weight))
    if not np.any(added):
        return {}
    scale = np.maximum(np.max(added, axis=1), 1e-12)  # a channel that adds to no output has no bias either
    limits = np.array(added).T / scale
    most = [(0.0, min(1.0, SLOW * float(x))) for x in scale]

    def least(row: Float[np.ndarray, " f"]) -> float:
        """Least of row x with limits x <= 1 and x within `most`; without the limits where the solver fails."""
        size = float(np.max(np.abs(row)))
        if size == 0.0:
            return 0.0
        found = linprog(row / size, limits, np.ones(len(limits)), bounds=most).fun
        return float(size * found) if found is not None else float(np.minimum(row, 0.0) @ np.array(most)[:, 1])

    names = [state.full.model.names[column] for column in fit.columns[np.isin(fit.columns, own)]]
    return {name: (least(row), -least(-row)) for name, row in zip(names, np.array(biases).T / scale, strict=True)}


def normal_draws(
    mean: Float[np.ndarray, " k"],
    columns: Int[np.ndarray, " j"],
    covariance: Float[np.ndarray, "j j"],
    parameters: Sequence[Parameter],
    seed: int,
    count: int,
) -> Float[np.ndarray, "r k"]:
    """Parameters drawn from the normal distribution of estimates, `columns` of which vary, within their bounds."""
    scale = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    values, vectors = np.linalg.eigh(covariance / np.outer(scale, scale))
    white = np.random.default_rng(seed).standard_normal((count, len(columns)))
    draws = np.tile(mean, (count, 1))
    draws[:, columns] += (white * np.sqrt(np.maximum(values, 0.0))) @ vectors.T * scale
    lower, upper = np.array([p.bounds for p in parameters], float).reshape(-1, 2).T
    return np.clip(draws, np.minimum(lower, mean), np.maximum(upper, mean))


def sizes(state: SelectionState, fit: RegressionFit) -> dict[str, Size]:
    """Every active parameter with its deviation: what coloured residuals leave, what recording noise makes of it."""
    # Recording noise that is integrated along the flight path wanders, and the fit follows it, so the residuals may
    # show less of it than there is: the larger of both deviations counts. The mean is the estimate without its bias,
    # which is itself known to first order only: it counts as a deviation, too.
    variance = np.maximum(np.diag(uncertainty(state, fit)), 0.0)
    bias, spread = noise_effect(state, fit)
    deviation = np.sqrt(np.maximum(variance, spread**2) + bias**2)
    found, free = {}, state.full.model.free
    for c, shift, sd in zip(fit.columns, bias, deviation, strict=True):
        if c < len(free):
            mean, (low, high) = state.theta[c], free[c].bounds
            at_bound = min(abs(mean - low), abs(mean - high)) < AT_BOUND * abs(mean)
            found[free[c].name] = Size(float(np.clip(mean - shift, low, high)), float(sd), free[c].unit, bool(at_bound))
    return found
