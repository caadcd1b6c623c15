"""Terms that nobody listed where a model meets the record in flight: screened by what they make of the residuals.

The protocol is that of the catalogue's candidates, to first order. A term must gain on left-out folds and be beyond
chance over the whole library, by how far it moves when a part of the flights is left out: a window of trajectories, or
some seconds of innovations.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from bayes_aero.diagnosis.result import UnexplainedStructure
from bayes_aero.diagnosis.screening.autocorrelation import SharedNoise, autocorrelation_of
from bayes_aero.diagnosis.screening.parameter_fit import PartialledRegression, largest_p_value
from bayes_aero.diagnosis.screening.regression import Fit
from bayes_aero.diagnosis.screening.screening import CandidateScore, ScreeningResult, block_jackknife_covariance, screen
from bayes_aero.diagnosis.screening.selection_state import SelectionState
from bayes_aero.diagnosis.selection.forward_selection import Extension
from bayes_aero.diagnosis.selection.holdout import holdout_deviance_gain
from bayes_aero.diagnosis.structure.changes import share_of, with_components
from bayes_aero.diagnosis.structure.unexplained import superfluous, taken_out
from bayes_aero.diagnosis.terms.columns import Column, columns_of
from bayes_aero.diagnosis.terms.forms import Forms, contest, described
from bayes_aero.diagnosis.terms.search import NEAR, Found, reconsidered, sized, weights_of
from bayes_aero.inference.covariance import nats
from bayes_aero.progress import Progress


class FlownForms(NamedTuple):
    """Terms with their sizes, causes that had only stood in for them, and the structure that they describe."""

    forms: Forms
    unknown: tuple[UnexplainedStructure, ...]


class _Trial(NamedTuple):
    """The terms of one coefficient that are not chosen, screened beside those that are."""

    columns: Sequence[Column]
    state: SelectionState
    fit: Fit
    screening: ScreeningResult

    def column(self, standing: CandidateScore) -> Column:
        return next(c for c in self.columns if c.component.label == standing.effect)


class _Rival(NamedTuple):
    """A term that explains about as much as the best one, of any coefficient, and its weight."""

    column: Column
    weight: float


def flown_forms(extension: Extension, *, seed: int, progress: Progress | None = None) -> FlownForms:
    """Terms of all coefficients for what an extended model leaves of flown residuals.

    Args:
        extension: by the catalogue, of a model that meets the record in trajectories or innovations.
        seed: of the noise that corrects autocorrelations.
        progress: told that it begins.
    """
    if progress:
        progress("terms", 0.0)
    instead = contest(extension)
    if instead.terms or instead.replaced:
        return FlownForms(instead, described((), instead))
    state, causes = extension.state, extension.causes
    found, rivals = _sought(state, seed)
    if not found:
        return FlownForms(instead, described((), instead))
    replaced = superfluous(state, causes, [one.column.component for one in found])
    if replaced:
        bare = taken_out(state, replaced)
        again, others = _sought(bare, seed)
        state, found, rivals = (bare, again, others) if again else (state, found, rivals)
        replaced = replaced if again else ()
    unknown = [
        UnexplainedStructure(_coefficient(one.column), one.column.term.name, one.share, one.p_value, names)
        for one, names in zip(found, rivals, strict=True)
    ]
    forms = instead._replace(terms=sized(state, found), replaced=replaced)
    return FlownForms(forms, described(unknown, instead))


def _coefficient(column: Column) -> str:
    return column.component.label.split(" over ")[0]


def _sought(state: SelectionState, seed: int) -> tuple[list[Found], list[tuple[str, ...]]]:
    """Terms, the first added first, and by term those of other coefficients that explain as much."""
    library = [columns_of(state, name) for name in state.responses.model.coefficients]
    found, rivals = list[Found](), dict[str, tuple[str, ...]]()
    for number in range(state.settings.unnamed_most):
        one = _next(state, library, [f.column for f in found], seed + number)
        if one is None:
            break
        found.append(one[0])
        rivals[one[0].column.component.label] = one[1]
    found = _beyond_doubt(state, reconsidered(state, found))
    return found, [rivals[one.column.component.label] for one in found]


def _beyond_doubt(state: SelectionState, found: Sequence[Found]) -> list[Found]:
    """The terms without those of which, beside the others, nothing sure is left; the least sure goes first."""
    left = list(found)
    while left:
        scores = [abs(one.size[0]) / one.size[1] for one in sized(state, left)]
        if min(scores) >= state.settings.least_score:
            break
        left.pop(scores.index(min(scores)))
    return left


def _next(
    state: SelectionState, library: Sequence[Sequence[Column]], chosen: Sequence[Column], seed: int
) -> tuple[Found, tuple[str, ...]] | None:
    """The best term beside those chosen and its rivals in other coefficients; None where none is beyond chance, large
    enough and useful."""
    noise = SharedNoise(seed, state.folds, len(state.outputs), state.settings)
    trials = [_screened(state, columns, chosen, noise) for columns in library]
    leaders = [
        (trial, standing)
        for trial in trials
        for standing in trial.screening.candidate_scores[: state.settings.candidates_tried]
    ]
    leaders.sort(key=lambda leader: -leader[1].score)
    for trial, standing in leaders:
        if not _useful(trial, standing):
            continue
        if (p := _chance(trials, trial, standing)) <= state.settings.unnamed_false_alarm_rate:
            return _told(state, _rivals(state, trials, chosen, trial.column(standing)), chosen, p)
    return None


def _screened(state: SelectionState, columns: Sequence[Column], chosen: Sequence[Column], noise: SharedNoise) -> _Trial:
    left = [c for c in columns if c not in chosen]
    trial = with_components(state, [c.component for c in left], [c.component for c in chosen], state.folds)
    fit = trial.fit()
    return _Trial(left, trial, fit, screen(trial, fit, seed=0, nulls=False, noise=noise))


def _useful(trial: _Trial, standing: CandidateScore) -> bool:
    """Whether a term is large enough to be worth a verdict, and gains on left-out folds."""
    state, own = trial.state, np.array(standing.columns, int)
    settings = state.settings
    alone = len(state.responses.flights.lengths) == 1
    least = state.least_share(settings.single_share if alone else settings.unnamed_share)
    if share_of(state, own) < least or standing.log_bayes <= 0.0:
        return False
    gain = holdout_deviance_gain(state, np.concatenate([state.columns(), own]))
    return nats(gain, standing.variance_inflation) >= settings.ambiguous


def _chance(trials: Sequence[_Trial], trial: _Trial, standing: CandidateScore) -> float:
    """The chance that noise alone lets some term of the library look as good as one does.

    No stationary colour holds in windows, with a term in or out; and innovations are white only as far as the noise of
    the filter is right. So it is how far the estimate moves without each part of the flights, Bonferroni over the
    library.
    """
    blocks, among = trial.state.responses.jackknife_blocks, sum(len(t.columns) for t in trials)
    assert blocks is not None
    own = np.concatenate([trial.state.columns(), np.array(standing.columns, int)])
    wider = trial.state.products.fit(own, trial.state.mean, trial.state.precision)
    covariance = block_jackknife_covariance(trial.state, wider)[1]
    return largest_p_value(wider.step[-1:], covariance[-1:, -1:], int(blocks.max()), among)


def _rivals(state: SelectionState, trials: Sequence[_Trial], chosen: Sequence[Column], leader: Column) -> list[_Rival]:
    """Terms of any coefficient that explain about as much as the leader, by weight.

    What tells two of them apart is the residual along the difference of what they explain.
    """
    gains = {t.column(s).component.label: (t.column(s), s.gain) for t in trials for s in t.screening.candidate_scores}
    best = gains[leader.component.label][1]
    near = [(c, gain) for c, gain in gains.values() if gain >= NEAR * best]
    near.sort(key=lambda pair: pair[0] is not leader)  # the leader is the first
    trial = with_components(state, [c.component for c, _ in near], [c.component for c in chosen], state.folds)
    fit, own = trial.fit(), np.concatenate([trial.columns(), trial.component_columns[0]])
    colour = autocorrelation_of(trial.left(trial.products.fit(own, trial.mean, trial.precision)), trial.folds)
    projected, residual = PartialledRegression(trial, fit, trial.component_columns), trial.left(fit)
    right = projected.right(residual)
    estimates = [bread @ right[place] for bread, place in zip(projected.bread, projected.place, strict=True)]
    apart = projected.apart(residual, estimates, 0, colour, trial.responses.jackknife_blocks)
    lost = np.array([nats(best - gain, x) for (_, gain), x in zip(near, apart, strict=True)])
    weights = weights_of(lost - lost.min(), [c.term.cost for c, _ in near])
    close = np.flatnonzero(lost - lost.min() < state.settings.ambiguous)
    found = [_Rival(near[i][0], float(weights[i])) for i in close]
    return sorted(found, key=lambda rival: -rival.weight)


def _told(
    state: SelectionState, rivals: Sequence[_Rival], chosen: Sequence[Column], p: float
) -> tuple[Found, tuple[str, ...]]:
    """The term of the most weight, with those of its coefficient, and names of those of others."""
    first = rivals[0]
    own = [r for r in rivals if _coefficient(r.column) == _coefficient(first.column)]
    elsewhere = tuple(r.column.component.label for r in rivals if r not in own)
    trial = with_components(state, [first.column.component], [c.component for c in chosen], state.folds)
    fit = trial.fit()
    standing = screen(trial, fit, seed=0, nulls=False).candidate_scores[0]
    columns = trial.component_columns[0]
    gain = holdout_deviance_gain(trial, np.concatenate([trial.columns(), columns]))
    others = tuple((r.column.term, r.weight) for r in own[1:])
    share = share_of(trial, columns)
    return Found(first.column, gain, share, standing.variance_inflation, first.weight, others, p, 1), elsewhere
