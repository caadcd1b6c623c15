"""What is reported of a change: the parameter before and after, when, and what else explains as much."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from bayes_aero.diagnosis.result import ParameterChange
from bayes_aero.diagnosis.screening.autocorrelation import autocorrelation_of
from bayes_aero.diagnosis.screening.partialled_regression import inflation_along
from bayes_aero.diagnosis.screening.screening import ScreeningResult, uncertainty
from bayes_aero.diagnosis.screening.selection_state import Component, SelectionState
from bayes_aero.diagnosis.structure.changes import Change, Sought, manoeuvres
from bayes_aero.diagnosis.structure.components import with_components
from bayes_aero.inference.variance.variance_inflation import nats

NEAREST = 200  # moments that are compared with the best one, those that explain most


def told(
    state: SelectionState, found: Sought, chosen: Sequence[Component], election: ScreeningResult | None
) -> ParameterChange:
    """A change with its sizes beside all that is in the state and `chosen`; `election` is that which added nothing."""
    change, span = found.change, found.change.span
    begin = int(np.argmax(state.responses.manoeuvre == span.manoeuvre))
    before, after, size = _sizes(state, change, chosen)
    nearest, rivals, inflation = _as_good(state, found)
    seconds, parameter = state.responses.seconds, state.full.model.free[change.column]  # a block is as fine as it gets
    known = [] if election is None else election.candidate_scores
    effects = [s.effect for s in known if nats(found.gain - s.gain, inflation) < state.settings.ambiguous]
    return ParameterChange(
        parameter=parameter.name,
        unit=parameter.unit,
        manoeuvre=state.responses.flights.names[span.manoeuvre],
        at=(span.begin - begin) * seconds,
        interval=(max(nearest[0] - 1 - begin, 0) * seconds, (nearest[1] + 1 - begin) * seconds),
        lasts=span.end == len(state.residual),
        before=before,
        after=after,
        size=size,
        share=found.share,
        p_value=found.p_value,
        gain=nats(found.gained, inflation),
        ambiguous_with=tuple(dict.fromkeys([*rivals, *effects])),
    )


Value = tuple[float, float]


def _sizes(state: SelectionState, change: Change, chosen: Sequence[Component]) -> tuple[Value, Value, Value]:
    """Value before, after, and their difference, with standard errors; all that is in is fitted beside."""
    whole = with_components(state, (), chosen, manoeuvres(state))
    fit = whole.fit()
    covariance = uncertainty(whole, fit, autocorrelation_of(whole.left(fit), whole.folds))
    widths = [c.basis.shape[2] for c in chosen]
    own = len(fit.columns) - sum(widths) + sum(widths[: [c is change.component for c in chosen].index(True)])
    at = int(np.flatnonzero(fit.columns == change.column)[0])
    combinations = np.zeros((3, len(fit.columns)))
    combinations[[0, 1], at], combinations[[1, 2], own] = 1.0, change.unit
    sd = np.sqrt(np.maximum(np.einsum("ai,ij,aj->a", combinations, covariance, combinations), 0.0))
    values = combinations @ fit.step + state.theta[change.column] * np.array([1.0, 1.0, 0.0])
    before, after, size = ((float(x), float(s)) for x, s in zip(values, sd, strict=True))
    return before, after, size


def _as_good(state: SelectionState, found: Sought) -> tuple[tuple[int, int], list[str], float]:
    """First and last block from which the change may as well begin; other parameters that explain about as much; and
    the variance inflation of the change itself.

    Two changes are told from each other by the residual along the difference of what they explain.
    """
    scan, settings, (span, parameter) = found.scan, state.settings, found.change.at
    estimates = scan.estimates(found.residual)
    gains, own = scan.gains(estimates), scan.over[span]
    same = [i for i, one in enumerate(scan.over) if (one.manoeuvre, one.end) == (own.manoeuvre, own.end)]
    same = sorted(same, key=lambda i: -gains[i, parameter])[:NEAREST]
    best = np.argmax(gains, axis=0)
    others = [(int(best[p]), p) for p in range(len(scan.columns)) if p != parameter]
    places = [(span, parameter), *((i, parameter) for i in same), *others]

    def explained(place: tuple[int, int]) -> Float[np.ndarray, "m c"]:
        return scan.explained(*place, float(estimates[place]))

    leader = explained((span, parameter))
    apart = np.stack([leader, *(leader - explained(place) for place in places[1:])], axis=2)
    inflation = inflation_along(apart, scan.weight, found.folds, found.colour)
    lost = [nats(float(gains[span, parameter] - gains[p]), float(x)) for p, x in zip(places, inflation, strict=True)]
    times = [scan.over[i].begin for i, x in zip(same, lost[1:], strict=False) if x <= settings.change_interval]
    names = [state.full.model.names[scan.columns[p]] for _, p in others]
    rivals = sorted((x, name) for x, name in zip(lost[1 + len(same) :], names, strict=True) if x < settings.ambiguous)
    return (min(times), max(times)), [name for _, name in rivals], float(inflation[0])
