"""How far estimates and predictions may be off: sizes with standard errors, noise of the regressors, hold-out data."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.optimize import linprog

from bayes_aero.diagnosis.candidate_set import DEFAULT, DiagnosisSettings, by_manoeuvre
from bayes_aero.diagnosis.result import Confirmation, Size
from bayes_aero.diagnosis.screening import CandidateScore, uncertainty
from bayes_aero.diagnosis.selection_state import (
    Products,
    RegressionFit,
    SelectionState,
    inverse,
    local_fit,
    moved,
    optimum,
)
from bayes_aero.effect import Effect
from bayes_aero.flight.health import noise_of
from bayes_aero.inference.covariance import log_density, log_score_gain
from bayes_aero.inference.results import Scores, score
from bayes_aero.model.records import Flights
from bayes_aero.parameter import Parameter

# --- How far estimates may be off: the residuals' colour, and the noise of what the regressors were recorded with.
# What effects act through is recorded with noise, then smoothed and differentiated. Least squares on such regressors is
# not consistent, and its residuals do not show it. Noise of the size that is there already, added once more, moves the
# estimates by about as much as the noise that is there has moved them: the bias grows with the noise's variance.
# Source: simulation extrapolation (SIMEX), Cook and Stefanski 1994, J. Am. Stat. Assoc. 89, 1314.

PAIRS = 10  # of records with the same noise added and subtracted, which cancels what is linear in it
REGRESSORS = ("alpha", "airspeed", "q", "elevator")
AT_BOUND = 1e-6  # of a parameter's value, within which it lies on a bound: fits stop 1e-9 short
SLOW = 100.0  # largest variance of slow noise over that of the white noise beside it: ten times its size; our choice
FILTERED = -0.5  # lag-1 correlation of third differences above which they are not white noise's


def implausible(effect: Effect, sizes: Mapping[str, Size]) -> dict[str, float]:
    """Parameters (1/e for one of infinite neutral value) with an estimate beyond the largest plausible size; that."""
    exceeded = {}
    for p in (p for p in effect.parameters if p.name in effect.sizes and p.name in sizes):
        largest = effect.sizes[p.name][1]
        if abs(p.away(sizes[p.name].mean, sizes[p.name].sd)[0]) > largest:
            exceeded[p.name if math.isfinite(p.neutral) else f"1/{p.name}"] = largest
    return exceeded


def implausible_candidate(effect: Effect, standing: CandidateScore) -> bool:
    """Whether a candidate would be `implausible` at its first-order estimate, or at the value at which it was tried."""
    if standing.value is None:
        values = {p.name: p.neutral + x for p, x in zip(effect.parameters, standing.step, strict=False)}
    else:
        values = {next(name for name, tried in effect.scan.items() if standing.value in tried): standing.value}
    return bool(implausible(effect, {n: Size(x, 0.0, "") for n, x in values.items() if math.isfinite(x)}))


def recording_noise(flights: Flights) -> dict[str, float]:
    """Standard deviation of the white part of every recorded channel, SI (see `noise_of`)."""
    return {name: noise_of(*by_manoeuvre(np.asarray(flights.channels[name]), flights)) for name in flights.recorded}


def filtered_channels(flights: Flights) -> tuple[str, ...]:
    """Channels behind the regressors whose noise was filtered before it was recorded, so that it cannot be read off."""
    # Third differences of white noise have a lag-1 correlation of -0.75; what is filtered, or motion, has not.
    filtered = []
    for name in (name for name in REGRESSORS if name in flights.recorded):
        rough = np.concatenate([np.diff(part, 3) for part in by_manoeuvre(np.asarray(flights.channels[name]), flights)])
        limit = 5.0 * np.median(np.abs(rough))
        inside = np.clip(rough, -limit, limit)
        if limit > 0.0 and np.corrcoef(inside[1:], inside[:-1])[0, 1] > FILTERED:
            filtered.append(name)
    return tuple(filtered)


def noise_effect(state: SelectionState, fit: RegressionFit) -> tuple[Float[np.ndarray, " k"], ...]:
    """What recording noise does to each estimate of a fit at its optimum: its bias, and its standard deviation."""
    flights = state.responses.flights
    noise, rng = recording_noise(flights), np.random.default_rng(0)
    parameters = fit.columns < len(state.theta)
    at = fit.columns[parameters]

    def step(extra: dict[str, np.ndarray], sign: float) -> np.ndarray:
        """The Gauss-Newton step from the optimum with more noise."""
        channels = flights.channels | {name: flights.channels[name] + sign * e for name, e in extra.items()}
        there = replace(state, responses=state.responses.with_channels(channels))
        # Variances held: grown by the noise they would let the prior pull more, which is no bias of the regressors.
        fitted = local_fit(there, state.theta, at, range(len(state.folds)), fit.variance)[0]
        return fitted.step[: len(at)]

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


def largest_noise_bias(state: SelectionState, fit: RegressionFit) -> dict[str, tuple[float, float]]:
    """Lowest and highest bias of each addition's parameters by recording noise of any size that residuals permit."""
    # It is linear in the channels' variances, which sum up to no more than is left of an output; noise may be `SLOW`
    # times what is read off as white. Source: Klepper and Leamer, Econometrica 52 (1984) 163.
    flights, rng = state.responses.flights, np.random.default_rng(1)
    parameters = fit.columns < len(state.theta)
    at, additions = fit.columns[parameters], state.full.own_columns(*state.active)
    covariance = inverse(fit.normal)[np.isin(fit.columns, additions)]
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
        value = linprog(row / size, limits, np.ones(len(limits)), bounds=most).fun
        return float(size * value) if value is not None else float(np.minimum(row, 0.0) @ np.array(most)[:, 1])

    names = [state.full.model.names[column] for column in fit.columns[np.isin(fit.columns, additions)]]
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
    estimates, free = {}, state.full.model.free
    for c, shift, sd in zip(fit.columns, bias, deviation, strict=True):
        if c < len(free):
            mean, (low, high) = state.theta[c], free[c].bounds
            at_bound = min(abs(mean - low), abs(mean - high)) < AT_BOUND * abs(mean)
            mean = float(np.clip(mean - shift, low, high))
            estimates[free[c].name] = Size(mean, float(sd), free[c].unit, bool(at_bound))
    return estimates


# --- What an extension gains on data that it was not fitted to, however the model meets the record.


def split_name(state: SelectionState) -> str:
    return "manoeuvre" if len(state.responses.flights.lengths) > 1 else "block"


@dataclass(frozen=True)
class LeftOut:
    """Residuals of every fold (or flown segment) with parameters fitted to the others."""

    residual: Float[np.ndarray, "m c"]
    noise_growth: Float[np.ndarray, "m c"]
    inside: Bool[np.ndarray, " m"]  # rows that belong to a fold
    names: tuple[str, ...]  # of the outputs
    lengths: Sequence[int]  # rows of each part that is independent of the others
    variance_inflation: float
    by_output: bool = True  # False along the flight path: of its errors the coefficients say what they make worse
    flyable: bool = True  # whether a simulation stays in the envelope

    @classmethod
    def refitted(cls, state: SelectionState) -> LeftOut:
        """With the effects that are in, every fit brought to its own optimum."""

        def fitted(others: list[int]) -> np.ndarray:
            return optimum(state, others, state.settings.hold_out_steps)

        residual = state.responses.holdout(state.folds, fitted, state.outputs)
        return cls._of(state, residual)

    @classmethod
    def first_order(cls, state: SelectionState, effects: Sequence[str]) -> LeftOut:
        """With only `effects` of those that are in, from the sensitivities: a hundredth of the time of `refitted`."""
        fewer = state.without([e for e in state.active if e not in effects])
        residual, columns = fewer.residual.copy(), fewer.columns()
        parameters = ~np.isin(columns, state.offsets)
        for number, fold in enumerate(state.folds):
            step = fewer.products.without(number).fit(columns, fewer.mean, fewer.precision).step
            residual[fold] -= state.S[fold][:, :, columns[parameters]] @ step[parameters]
        return cls._of(state, residual)

    @classmethod
    def _of(cls, state: SelectionState, residual: Float[np.ndarray, "m c"]) -> LeftOut:
        residual = np.where(state.inside[:, None], residual, 0.0)
        offsets = state.S[:, :, state.offsets]
        if offsets.shape[2]:  # where a flight-path integral began is the left-out fold's own to find
            residual -= offsets @ (np.einsum("mco,mc->o", offsets, residual) / np.sum(offsets**2, axis=(0, 1)))
        lengths = [fold.stop - fold.start for fold in state.folds]
        if len(state.responses.flights.lengths) == 1:  # blocks of one flight, one after the other: their colour runs on
            lengths = [sum(lengths)]
        growth, inflation, by_output = state.noise_growth, state.variance_inflation, not state.responses.kinematic
        return cls(residual, growth, state.inside, state.outputs, lengths, inflation, by_output)

    def density(self) -> Float[np.ndarray, " m"]:
        return self.densities().sum(axis=1)

    def densities(self) -> Float[np.ndarray, "m c"]:
        """Log predictive density of every row by output: independent and normal."""
        # With the variance that the left-out residuals themselves have: the variance of the fitted ones would punish a
        # model for the other manoeuvre's stall, whatever its mean.
        residual, noise_growth = self.residual[self.inside], self.noise_growth[self.inside]
        return log_density(residual, np.mean((residual / noise_growth) ** 2, axis=0) * noise_growth**2)

    def gain(self, before: LeftOut) -> tuple[float, float]:
        return log_score_gain(before.density(), self.density(), self.variance_inflation, self.lengths)

    def output_gains(self, before: LeftOut) -> dict[str, tuple[float, float]]:
        """`gain` of each output by itself; empty where that says nothing."""
        if not (self.by_output and before.flyable):
            return {}
        densities = before.densities(), self.densities()
        pairs = zip(self.names, *(density.T for density in densities), strict=True)
        return {n: log_score_gain(a, b, self.variance_inflation, self.lengths) for n, a, b in pairs}

    def scores(self, measured: Float[np.ndarray, "m c"]) -> dict[str, Scores]:
        """Scores of each coefficient over everything left out, against what was recorded (blocks of about 5 Hz)."""
        return scores_of(self.names, measured[self.inside], self.residual[self.inside])


def scores_of(names: Sequence[str], z: Float[np.ndarray, "m c"], e: Float[np.ndarray, "m c"]) -> dict[str, Scores]:
    return {name: score(z[:, c], z[:, c] - e[:, c]) for c, name in enumerate(names)}


def measured_blocks(state: SelectionState) -> Float[np.ndarray, "m c"]:
    """Coefficients as the card reconstructs them from the record, averaged over blocks."""
    card = state.full.card_only(state.theta)
    return np.asarray(state.responses.block(state.responses.predict(card)["measured"]))


def truncated(state: SelectionState, effects: Sequence[str]) -> SelectionState:
    """The state with only `effects` of its additions in, the others' parameters at neutral."""
    theta = state.full.at_neutral(state.theta, [e for e in state.active if e not in effects])
    return moved(state, theta, tuple(effects))


def holdout_deviance_gain(state: SelectionState, wide: np.ndarray, narrow: np.ndarray | None = None) -> float:
    """Deviance that columns `wide` gain over `narrow` (default: the active ones) on folds that were left out."""

    def deviance(columns: np.ndarray) -> float:
        """n log(mean square) over folds and outputs; the offsets are each fold's own."""
        used = np.unique(np.concatenate([columns, state.offsets]))
        products, mean, precision = state.products.only(used), state.mean[used], state.precision[used]
        columns, offsets = (np.searchsorted(used, own) for own in (columns, state.offsets))
        parameters, deviances = ~np.isin(columns, offsets), []
        for fold in range(len(state.folds)):
            step = products.without(fold).fit(columns, mean, precision).step
            left = products.over([fold]).shifted(columns[parameters], step[parameters])
            n = float(left.count.sum())
            if len(offsets):
                deviances.append(left.fit(offsets, np.zeros_like(mean), np.zeros_like(mean)).deviance)
            else:
                deviances.append(float(n * np.sum(np.log(left.gram[0, :, 0, 0] / n))))
        return float(np.sum(deviances))

    return deviance(state.columns() if narrow is None else narrow) - deviance(wide)


def addition_gain(state: SelectionState, wide: np.ndarray) -> float:
    """Deviance that additions `wide` gain on folds that were left out, where unlike manoeuvres predict each other."""
    gain, card = holdout_deviance_gain(state, wide), state.columns(())
    of_card = np.any(card < len(state.theta))  # sensors along the flight path have no such parameters
    if gain > 0.0 or not of_card or len(state.responses.flights.lengths) < 2:
        return gain
    used = np.unique(np.concatenate([wide, state.columns(), card]))
    products, prior = state.products.only(used), (state.mean[used], state.precision[used])
    everything, active, card = (np.searchsorted(used, columns) for columns in (wide, state.columns(), card))

    def deviance(fold: int, columns: np.ndarray) -> float:
        return integrated_deviance(products, fold, (columns, card), prior, state.variance_inflation)

    return float(np.sum([deviance(fold, active) - deviance(fold, everything) for fold in range(len(state.folds))]))


def integrated_deviance(
    products: Products,
    fold: int,
    columns: tuple[np.ndarray, np.ndarray],
    prior: tuple[np.ndarray, np.ndarray],
    inflation: float,
) -> float:
    """Deviance of a fold, the additions integrated out over their posterior from the other folds."""
    everything, card = columns
    others = products.without(fold).fit(everything, *prior)
    at = np.flatnonzero(~np.isin(everything, card))
    precision_elsewhere = 1.0 / np.diag(inverse(others.normal))[at]
    mean, precision = (x.copy() for x in prior)
    mean[everything[at]], precision[everything[at]] = others.step[at], precision_elsewhere
    posterior = products.over([fold]).fit(everything, mean, precision)
    narrowed = 1.0 / np.diag(inverse(posterior.normal))[at] / precision_elsewhere
    return posterior.deviance + inflation * float(np.sum(np.log(np.maximum(narrowed, 1.0))))


# --- Which additions unseen data confirm.
# An election asks only that a candidate gains at all on data left out, and adds one after the other. Taken together
# some are superfluous, and what is superfluous harms elsewhere: a delay that fits one manoeuvre's noise spoils the
# simulation of the next. So additions are taken out again one at a time, the least useful first, as long as unseen
# data do not miss them, or an output is predicted worse with them than without.


Predicted = Callable[[Sequence[str]], LeftOut]  # unseen data as the model with some of its additions predicts them


def backward_elimination(
    additions: Sequence[str], first_order: Predicted, refitted: Predicted, settings: DiagnosisSettings = DEFAULT
) -> Confirmation:
    """Each addition in turn, least missed to first order first, is taken out and everything fitted again. What stays is
    missed by `settings.hold_out` standard errors of its log density and degrades no output."""

    def gain(without: LeftOut, whole: LeftOut) -> tuple[float, float]:
        return whole.gain(without) if without.flyable else (np.inf, 0.0)

    def less(effects: Sequence[str], gone: str) -> list[str]:
        return [e for e in effects if e != gone]

    plain = settings.hold_out_first_order
    kept, missed, waiting = list(additions), {}, list(additions)
    harmed: dict[str, Mapping[str, tuple[float, float]]] = {}
    whole: LeftOut | None = None
    while waiting:
        near, fewer = first_order(kept), {e: first_order(less(kept, e)) for e in waiting}
        losses = {e: gain(fewer[e], near) for e in waiting}
        harmful = [e for e in waiting if settings.degraded(near.output_gains(fewer[e]))]
        least = min(harmful or waiting, key=lambda e: losses[e][0] - plain * losses[e][1])
        if not harmful and losses[least][0] > plain * losses[least][1]:
            missed |= losses
            break
        whole = whole or refitted(kept)
        without = refitted(less(kept, least))
        missed[least] = gain(without, whole)
        worse = settings.degraded(whole.output_gains(without))
        if worse or not missed[least][0] > settings.hold_out * missed[least][1]:
            kept, whole = less(kept, least), without
            harmed |= {least: worse} if worse else {}
        waiting.remove(least)
    return Confirmation(tuple(kept), {e: missed[e] for e in additions}, harmed)


def confirmation(state: SelectionState) -> Confirmation:
    return backward_elimination(
        state.active,
        lambda effects: LeftOut.first_order(state, effects),
        lambda effects: LeftOut.refitted(truncated(state, effects)),
        state.settings,
    )
