"""A parameter of the model that takes another value during the records: is there one beyond chance, and where.

The largest gain over all parameters and moments is compared with that in noise-only replicates, which make the same
choice. Then the change must explain enough and predict parts of the manoeuvres that it was not fitted to.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from jaxtyping import Float, Int

from bayes_aero.diagnosis.screening.accuracy import recording_noise
from bayes_aero.diagnosis.screening.autocorrelation import (
    Autocorrelation,
    SharedNoise,
    autocorrelation_of,
    autocorrelations_of,
    unbiased,
)
from bayes_aero.diagnosis.screening.parameter_fit import optimum
from bayes_aero.diagnosis.screening.regression import Fit
from bayes_aero.diagnosis.screening.screening import without_active
from bayes_aero.diagnosis.screening.selection_state import TINY, Component, SelectionState, moved
from bayes_aero.diagnosis.selection.cross_validation import holdout_deviance_gain
from bayes_aero.diagnosis.structure.change_scan import ChangeScan, Span, spans
from bayes_aero.diagnosis.structure.components import parts_of, share_of, with_components
from bayes_aero.effect import Kind, Stage
from bayes_aero.inference.variance.autoregression import ORDER


@dataclass(frozen=True)
class Change:
    """The change of the parameter in `column` over a span: what it adds, of which a step of one is `unit`; `at` is its
    place in the scan (span, parameter) that found it."""

    column: int
    span: Span
    component: Component
    unit: float
    at: tuple[int, int]


@dataclass(frozen=True)
class Sought:
    """A change that is beyond chance, with what it was judged by.

    `gain` is the deviance that it takes away, `gained` that of the parts left out.
    """

    change: Change
    state: SelectionState
    scan: ChangeScan
    residual: Float[np.ndarray, "m c"]
    folds: tuple[slice, ...]
    colour: Autocorrelation
    share: float
    p_value: float
    gain: float
    gained: float


def sought_change(
    state: SelectionState, chosen: Sequence[Component], *, seed: int, least: float = 0.0
) -> Sought | None:
    """The change that explains most of what the active effects and the `chosen` components leave, if it is real.

    It must gain more than `least` deviance on parts left out. Without it the other parameters were fitted to both
    values of the changed one, so the problem is linearised again where they are with the change beside them.
    """
    settings, alone = state.settings, len(state.responses.flights.lengths) == 1
    first = _promising(state, chosen, least) if testable(state) else None
    if first is None:
        return None
    state = _beside(state, [*chosen, first[0].component])
    folds = manoeuvres(state)
    whole = with_components(state, (), chosen, folds)
    columns, over, noise = first[1].columns, first[1].over, first[1].noise
    _, wider = fit_with(state, first[0].component, chosen, folds)
    # Under the variances that it leaves: what it explains itself would pass for noise of its coefficient.
    held = whole.products.fit(whole.columns(), whole.mean, whole.precision, held=wider.variance)
    scan, residual = ChangeScan(whole, held, columns, over, noise), whole.left(held)
    change = _change(state, scan, _leader(scan, scan.estimates(residual))[0])
    trial, wider = fit_with(state, change.component, chosen, folds)
    share, gained = share_of(trial, trial.component_columns[0]), holdout_gain_of(state, change.component, chosen)
    if share < (settings.single_share if alone else settings.change_share) or gained <= least:
        return None
    if _by_noise(trial, wider, change, scan):
        return None
    colour, p = _p_value(whole, held, scan, trial.left(wider), seed)
    if p > settings.change_false_alarm_rate:
        return None
    gain = whole.fit().deviance - wider.deviance
    return Sought(change, state, scan, residual, folds, colour, share, p, gain, gained)


def testable(state: SelectionState) -> bool:
    """Whether the state is of coefficients that are modelled, and every manoeuvre long enough to be divided."""
    parts = parts_of(state, state.settings.change_parts)
    long = all(part.stop - part.start > ORDER for part in parts)
    return state.outputs == state.responses.model.coefficients and long and bool(len(_free(state)) and _over(state))


def _promising(state: SelectionState, chosen: Sequence[Component], least: float) -> tuple[Change, ChangeScan] | None:
    """The change that explains most to first order, if that is worth another look."""
    folds = manoeuvres(state)
    whole = state if not chosen and folds == state.folds else with_components(state, (), chosen, folds)
    fit = whole.fit()
    columns = _free(state)
    scan = ChangeScan(whole, fit, columns, _over(state), _noise(state, columns))
    leader, gain = _leader(scan, scan.estimates(whole.left(fit)))
    if gain < state.settings.least_share * len(state.residual):
        return None
    change = _change(state, scan, leader)
    return (change, scan) if holdout_gain_of(state, change.component, chosen) > least else None


def _noise(state: SelectionState, columns: Int[np.ndarray, " p"], seed: int = 0) -> Float[np.ndarray, "m c p"]:
    """What noise of the recorded size adds to the sensitivities to these parameters, scaled as those are.

    Added once more it adds as much as the noise that is there already, as in `accuracy.noise_effect`.
    """
    flights, rng = state.responses.flights, np.random.default_rng(seed)
    added = {n: sd * rng.standard_normal(flights.n) for n, sd in recording_noise(flights).items()}
    noisy = flights.channels | {name: flights.channels[name] + x for name, x in added.items()}
    slopes = state.responses.with_channels(noisy).linearise(state.theta, columns)[1]
    keep = [state.responses.outputs.index(name) for name in state.outputs]
    return slopes[:, keep] / state.noise_growth[:, :, None] - state.scaled[:, :, columns]


def _by_noise(state: SelectionState, fit: Fit, change: Change, scan: ChangeScan) -> bool:
    """Whether one value, made too small by noise on either side of the change, explains it.

    To first order a share s of noise takes s of a value away; what lies between a value and that with twice as much
    given back may be its truth.
    """
    at = int(np.flatnonzero(fit.columns == change.column)[0])
    elsewhere = float(state.theta[change.column] + fit.step[at])
    values = elsewhere + change.unit * float(fit.step[-1]), elsewhere
    shares = scan.noise_shares[:, change.at[0], change.at[1]]
    least, most = np.sort([np.array([x, x / max(1.0 - 2.0 * s, TINY)]) for x, s in zip(values, shares, strict=True)]).T
    return bool(np.max(least) <= np.min(most))


def _beside(state: SelectionState, components: Sequence[Component]) -> SelectionState:
    """The state at the optimum of all active parameters, these components free beside them."""
    place = len(state.theta) + state.nuisance
    columns = np.concatenate([c.basis for c in components], axis=2)
    S = np.concatenate([state.S[:, :, :place], columns, state.S[:, :, place:]], axis=2)
    mean, precision = (np.insert(x, [place] * columns.shape[2], 0.0) for x in (state.mean, state.precision))
    nuisance = state.nuisance + columns.shape[2]
    wide = replace(state, S=S, mean=mean, precision=precision, nuisance=nuisance)
    return moved(state, optimum(wide, range(len(state.folds))))


def holdout_gain_of(state: SelectionState, component: Component, chosen: Sequence[Component]) -> float:
    """Deviance that a component gains on parts of the manoeuvres that were left out, each predicted from the others."""
    trial = with_components(state, (component,), chosen, parts_of(state, state.settings.change_parts))
    return holdout_deviance_gain(trial, np.concatenate([trial.columns(), trial.component_columns[0]]))


def fit_with(
    state: SelectionState, component: Component, chosen: Sequence[Component], folds: Sequence[slice]
) -> tuple[SelectionState, Fit]:
    """A state in which one component is the candidate, and the fit with it in."""
    trial = with_components(state, (component,), chosen, folds)
    wide = np.concatenate([trial.columns(), trial.component_columns[0]])
    return trial, trial.products.fit(wide, trial.mean, trial.precision)


def manoeuvres(state: SelectionState) -> tuple[slice, ...]:
    """The blocks of each manoeuvre."""
    edges = np.flatnonzero(np.diff(state.responses.manoeuvre, prepend=-1, append=-1))
    return tuple(slice(int(a), int(b)) for a, b in pairwise(edges))


def _free(state: SelectionState) -> Int[np.ndarray, " p"]:
    """Columns of the aerodynamic parameters that are free in the model."""
    owners = {p: e for e in state.full.model.effects for p in state.full.parameters_of(e.name)}
    found = []
    for column in state.columns():
        if column < len(state.theta):
            owner = owners[state.full.model.names[column]]
            if owner.kind is Kind.AERODYNAMICS and owner.stage > Stage.INFLOW:
                found.append(column)
    return np.array(found, int)


def _over(state: SelectionState) -> list[Span]:
    least = max(1, round(state.settings.change_least / state.responses.seconds))
    return spans(state.responses.manoeuvre, least, state.settings.change_begins)


def _leader(scan: ChangeScan, estimates: Float[np.ndarray, "n p"]) -> tuple[tuple[int, int], float]:
    """The change that takes most deviance away, and how much."""
    gains = scan.gains(estimates)
    span, parameter = np.unravel_index(int(np.argmax(gains)), gains.shape)
    return (int(span), int(parameter)), float(gains[span, parameter])


def _change(state: SelectionState, scan: ChangeScan, at: tuple[int, int]) -> Change:
    span, column = scan.over[at[0]], int(scan.columns[at[1]])
    basis = np.zeros((*state.residual.shape, 1))
    basis[span.begin : span.end, :, 0] = state.S[span.begin : span.end, :, column]
    unit = 1.0 / float(np.sqrt(np.max(np.mean(basis**2, axis=0))))
    label = f"{state.full.model.names[column]} from block {span.begin}"
    return Change(column, span, Component(label, unit * basis), unit, at)


def _p_value(
    state: SelectionState, fit: Fit, scan: ChangeScan, left: Float[np.ndarray, "m c"], seed: int
) -> tuple[Autocorrelation, float]:
    """The colour of the noise that is `left` with the change in, and how often noise alone shows as much of one.

    What was chosen as the best of many makes the noise look faster than it is; replicates measure by how much.
    """
    noise = SharedNoise(seed, state.folds, left.shape[1], state.settings)

    def drawn(colour: Autocorrelation, white: Float[np.ndarray, "t f r c"]) -> Float[np.ndarray, "r m c"]:
        return without_active(state, fit, colour.coloured(white, state.folds, len(state.residual)))

    def without_leader(residual: Float[np.ndarray, "m c"]) -> Float[np.ndarray, "m c"]:
        estimates = scan.estimates(residual)
        leader, _ = _leader(scan, estimates)
        return residual - scan.explained(*leader, float(estimates[leader]))

    def statistic(residual: Float[np.ndarray, "m c"]) -> float:
        """Deviance that the leader takes away over what it leaves."""
        gain = _leader(scan, scan.estimates(residual))[1]
        return gain / (float(np.sum(residual**2 * scan.weight)) - gain)

    found = autocorrelation_of(left, state.folds)
    again = np.array([without_leader(one) for one in drawn(found, noise.correction)])
    colour = unbiased(found, autocorrelations_of(again, state.folds))
    nulls = np.array([statistic(one) for one in drawn(colour, noise.replicates)])
    return colour, float((1 + np.sum(nulls >= statistic(state.left(fit)))) / (1 + len(nulls)))
