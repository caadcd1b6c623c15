"""Which form has unexplained structure: forward selection of terms by what they predict of left-out folds.

Of what coefficients leave, noise-only replicates say what is beyond chance. Where a model meets the record in flight,
terms are screened by what they make of the residuals to first order, and must be beyond chance by how far they move
when a part of the flights is left out: a window of trajectories, or some seconds of innovations.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from bayes_aero.diagnosis.result import FoundTerm
from bayes_aero.diagnosis.screening.autocorrelation import SharedNoise, autocorrelation_of
from bayes_aero.diagnosis.screening.parameter_fit import PartialledRegression, inflation_along, largest_p_value
from bayes_aero.diagnosis.screening.regression import RegressionFit
from bayes_aero.diagnosis.screening.screening import (
    CandidateScore,
    ScreeningResult,
    block_jackknife_covariance,
    screen,
    uncertainty,
)
from bayes_aero.diagnosis.screening.selection_state import Component, SelectionState
from bayes_aero.diagnosis.selection.holdout import holdout_deviance_gain
from bayes_aero.diagnosis.structure.components import TermColumn, Trial, chance_of, columns_of, null_shares
from bayes_aero.diagnosis.terms.library import ProductTerm
from bayes_aero.inference.covariance import nats

NEAR = 0.5  # of the best term's gain, below which no other is compared with it; our choice
AS_GOOD = 0.1  # of what the function gains, what terms may gain less: it bends as it likes; our choice
SWING = {"CL": 0.01, "CD": 0.001, "Cm": 0.002, "CY": 0.01, "Cl": 0.001, "Cn": 0.001}
"""The least change of a coefficient worth modelling, as in the catalogue."""


@dataclass(frozen=True)
class SelectedTerm:
    """A term that was added, with the deviance that it gains on left-out folds, and those that are as good."""

    column: TermColumn
    gain: float
    share: float
    inflation: float
    weight: float
    others: tuple[tuple[ProductTerm, float], ...]
    p_value: float
    among: int  # terms of which it was chosen
    elsewhere: tuple[str, ...] = ()  # terms of other coefficients that explain as much

    @property
    def cost(self) -> float:
        """Nats of a parameter and of the choice of a term."""
        return 1.0 + float(np.log(self.among))


def components_of(found: Sequence[SelectedTerm]) -> list[Component]:
    """What selected terms add to the outputs."""
    return [one.column.component for one in found]


def terms_of_coefficient(
    state: SelectionState, coefficient: str, functions: Sequence[Component], *, seed: int
) -> list[SelectedTerm]:
    """Terms that describe what is left of a coefficient as well as the functions of channels by which it was found, the
    first added first; none where none predict as well. `state` has all in that was selected from the catalogue."""
    columns, found, settings = columns_of(state, coefficient), list[SelectedTerm](), state.settings
    for number in range(settings.terms_most):
        one, _, trial = leader(state, columns, [f.column for f in found])
        if nats(one.gain, one.inflation) < settings.ambiguous or one.share < settings.unnamed_share:
            break
        own = trial.component_columns[trial.components.index(one.column.component)]
        wider = trial.fit_columns(trial.wider(own))
        colour = autocorrelation_of(trial.left(wider), trial.folds)
        p = chance_of(one.share, null_shares(trial, colour, wider.variance, seed + number))
        if p > settings.unnamed_false_alarm_rate:
            break
        found.append(replace(one, p_value=p))
    found = reconsidered(state, found)
    if not found:
        return []

    def gain(components: Sequence[Component]) -> float:
        """Deviance of left-out folds that components gain together."""
        wide = state.with_components((), components)
        return holdout_deviance_gain(wide, wide.columns(), state.columns())

    inflation, least = max(one.inflation for one in found), gain(functions)
    missed = nats(least - gain(components_of(found)), inflation)
    return found if missed < max(settings.ambiguous, AS_GOOD * nats(least, inflation)) else []


def reconsidered(state: SelectionState, found: Sequence[SelectedTerm]) -> list[SelectedTerm]:
    """The terms that are still worth their place beside all others, with what each gains there."""
    left = list(found)
    for one in found:
        trial = Trial(state, one.column.component, components_of([f for f in left if f is not one]))
        at, least = left.index(one), state.least_share(state.settings.unnamed_share)
        worth = trial.share >= least and trial.gain > 0.0
        left[at : at + 1] = [replace(one, share=trial.share, gain=trial.gain)] if worth else []
    return left


def leader(
    state: SelectionState, columns: Sequence[TermColumn], chosen: Sequence[TermColumn]
) -> tuple[SelectedTerm, float, SelectionState]:
    """The best term beside those chosen, the nats that it explains, and the state in which the others stand."""
    labels = {c.component.label for c in chosen}
    open_ones = [c for c in columns if c.component.label not in labels]
    trial = state.with_components([c.component for c in open_ones], [c.component for c in chosen])
    fit = trial.fit()
    order, lost, inflation = _ranked(trial, fit)
    weights = weights_of(lost, [open_ones[j].term.cost for j in order])
    equal = [i for i in range(len(order)) if lost[i] < state.settings.ambiguous]
    first = max(equal, key=lambda i: weights[i])
    others = [(open_ones[order[i]].term, float(weights[i])) for i in equal if i != first]
    others.sort(key=lambda other: -other[1])
    column = trial.component_columns[order[first]]
    own = trial.wider(column)
    explained = nats(fit.deviance - trial.fit_columns(own).deviance, inflation)
    one = SelectedTerm(
        open_ones[order[first]], holdout_deviance_gain(trial, own), trial.share_of(column), inflation,
        float(weights[first]), tuple(others), float("nan"), len(columns),
    )  # fmt: skip
    return one, explained, trial


def _ranked(trial: SelectionState, fit: RegressionFit) -> tuple[list[int], Float[np.ndarray, " j"], float]:
    """Terms that gain at least half of what the best one does, the best first; by how many nats each explains less; and
    the variance inflation of the best."""
    projected = PartialledRegression(trial, fit, trial.component_columns)
    place = np.array([p[0] for p in projected.place])
    bread, right = np.array([b[0, 0] for b in projected.bread]), projected.right(trial.left(fit))[place]
    n = float(trial.products.count.sum())
    gains = -n * np.log1p(-np.minimum(right**2 * bread / n, 1.0 - 1e-9))
    order = [int(j) for j in np.argsort(-gains, kind="stable") if gains[j] >= NEAR * gains.max()]
    best = trial.fit_columns(trial.wider(trial.component_columns[order[0]]))
    colour = autocorrelation_of(trial.left(best), trial.folds)
    # Two terms are told from each other by the residual along the difference of what they explain.
    made = projected.P[:, :, place[order]] * (bread * right)[order]
    apart = np.concatenate([made[:, :, :1], made[:, :, :1] - made[:, :, 1:]], axis=2)
    inflation = inflation_along(apart, projected.weight, trial.folds, colour)
    lost = [0.0, *(nats(gains[order[0]] - gains[j], x) for j, x in zip(order[1:], inflation[1:], strict=True))]
    return order, np.array(lost), float(inflation[0])


def weights_of(lost: Float[np.ndarray, " j"], costs: Sequence[int]) -> Float[np.ndarray, " j"]:
    """Posterior probabilities of terms, of which each factor halves the prior one."""
    log = -lost - np.log(2.0) * np.array(costs)
    weights = np.exp(log - log.max())
    return weights / weights.sum()


def sized(state: SelectionState, found: Sequence[SelectedTerm]) -> tuple[FoundTerm, ...]:
    """All terms fitted together, beside the parameters of the model."""
    whole = state.with_components((), components_of(found))
    fit = whole.fit()
    deviation = np.sqrt(np.diag(uncertainty(whole, fit)))[len(fit.columns) - len(found) :]
    if state.responses.jackknife_blocks is not None:  # no smaller than the estimates without each part scatter
        between = np.sqrt(np.diag(block_jackknife_covariance(whole, fit)[1]))
        deviation = np.maximum(deviation, between[len(between) - len(found) :])
    rows = zip(found, fit.step[len(fit.columns) - len(found) :], deviation, strict=True)
    return tuple(
        FoundTerm(
            coefficient=one.column.component.coefficient,
            term=one.column.term,
            size=(float(size) / one.column.scale, float(sd) / one.column.scale),
            share=one.share,
            gain=nats(one.gain, one.inflation),
            weight=one.weight,
            others=one.others,
            least=SWING[one.column.component.coefficient] / max(one.column.spread, 1e-12),
        )
        for one, size, sd in rows
    )


# --- Where a model meets the record in flight.


class _Screened(NamedTuple):
    """The terms of one coefficient that are not chosen, screened beside those that are."""

    columns: Sequence[TermColumn]
    state: SelectionState
    screening: ScreeningResult

    def column(self, standing: CandidateScore) -> TermColumn:
        return next(c for c in self.columns if c.component.label == standing.effect)


def terms_of_flights(state: SelectionState, seed: int) -> list[SelectedTerm]:
    """Terms of all coefficients, the first added first."""
    library = [columns_of(state, name) for name in state.responses.model.coefficients]
    left = list[SelectedTerm]()
    for number in range(state.settings.unnamed_most):
        one = _next(state, library, left, seed + number)
        if one is None:
            break
        left.append(one)
    left = reconsidered(state, left)
    while left:  # those of which, beside the others, nothing sure is left go out, the least sure first
        scores = [abs(one.size[0]) / one.size[1] for one in sized(state, left)]
        if min(scores) >= state.settings.least_score:
            break
        left.pop(scores.index(min(scores)))
    return left


def _next(
    state: SelectionState, library: Sequence[Sequence[TermColumn]], found: Sequence[SelectedTerm], seed: int
) -> SelectedTerm | None:
    """The best term beside those found; None where none is beyond chance, large enough and useful."""
    noise = SharedNoise(seed, state.folds, len(state.outputs), state.settings)
    chosen, screened = [one.column for one in found], []
    for columns in library:
        left = [c for c in columns if c not in chosen]
        trial = state.with_components([c.component for c in left], components_of(found))
        screened.append(_Screened(left, trial, screen(trial, trial.fit(), seed=0, nulls=False, noise=noise)))
    tried = state.settings.candidates_tried
    leaders = [(one, standing) for one in screened for standing in one.screening.candidate_scores[:tried]]
    leaders.sort(key=lambda leader: -leader[1].score)
    among = sum(len(one.columns) for one in screened)
    for one, standing in leaders:
        p = _chance(one.state, standing, among)
        if p <= state.settings.unnamed_false_alarm_rate:
            return _weighed(state, screened, components_of(found), one.column(standing), p)
    return None


def _chance(trial: SelectionState, standing: CandidateScore, among: int) -> float:
    """The chance that noise alone lets some term of the library, of `among`, look as good as one does; 1 where it is
    too small to be worth a verdict, or gains nothing on left-out folds."""
    settings, own = trial.settings, np.array(standing.columns, int)
    alone = len(trial.responses.flights.lengths) == 1
    least = trial.least_share(settings.single_share if alone else settings.unnamed_share)
    if trial.share_of(own) < least or standing.log_bayes <= 0.0:
        return 1.0
    wide = trial.wider(own)
    if nats(holdout_deviance_gain(trial, wide), standing.variance_inflation) < settings.ambiguous:
        return 1.0
    # No stationary colour holds in windows, with a term in or out; and innovations are white only as far as the noise
    # of the filter is right. So it is how far the estimate moves without each part of the flights, Bonferroni over the
    # library.
    blocks, wider = trial.responses.jackknife_blocks, trial.fit_columns(wide)
    assert blocks is not None
    covariance = block_jackknife_covariance(trial, wider)[1]
    return largest_p_value(wider.step[-1:], covariance[-1:, -1:], int(blocks.max()), among)


def _weighed(
    state: SelectionState, screened: Sequence[_Screened], chosen: Sequence[Component], first: TermColumn, p: float
) -> SelectedTerm:
    """The term of the most weight among those of any coefficient that explain about as much as the leader `first`, with
    those of its coefficient, and names of those of others."""
    gains = {t.column(s).component.label: (t.column(s), s.gain) for t in screened for s in t.screening.candidate_scores}
    best = gains[first.component.label][1]
    near = [(c, gain) for c, gain in gains.values() if gain >= NEAR * best]
    near.sort(key=lambda pair: pair[0] is not first)  # the leader is the first
    trial = state.with_components([c.component for c, _ in near], chosen)
    fit = trial.fit()
    colour = autocorrelation_of(trial.left(trial.fit_columns(trial.wider(trial.component_columns[0]))), trial.folds)
    # What tells two of them apart is the residual along the difference of what they explain.
    projected, residual = PartialledRegression(trial, fit, trial.component_columns), trial.left(fit)
    right = projected.right(residual)
    estimates = [bread @ right[place] for bread, place in zip(projected.bread, projected.place, strict=True)]
    apart = projected.apart(residual, estimates, 0, colour, trial.responses.jackknife_blocks)
    lost = np.array([nats(best - gain, x) for (_, gain), x in zip(near, apart, strict=True)])
    weights = weights_of(lost - lost.min(), [c.term.cost for c, _ in near])
    close = np.flatnonzero(lost - lost.min() < state.settings.ambiguous)
    rivals = sorted([(near[i][0], float(weights[i])) for i in close], key=lambda rival: -rival[1])
    (column, weight), component = rivals[0], rivals[0][0].component
    own = [rival for rival in rivals if rival[0].component.coefficient == component.coefficient]
    one = Trial(state, component, chosen)
    standing = screen(one.state, one.state.fit(), seed=0, nulls=False).candidate_scores[0]
    others = tuple((rival.term, x) for rival, x in own[1:])
    elsewhere = tuple(c.component.label for c, _ in rivals if c.component.coefficient != component.coefficient)
    return SelectedTerm(column, one.gain, one.share, standing.variance_inflation, weight, others, p, 1, elsewhere)
