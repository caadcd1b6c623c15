"""Two named terms that cancel: what the record knows of them is one combination, not either.

Pitch rate and the rate of the angle of attack move together in most manoeuvres. A fit then sets a large term against
another large one; neither is measured. The combination of the two with the least variance is.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations, product

import numpy as np

from bayes_aero.diagnosis.screening.autocorrelation import autocorrelation_of
from bayes_aero.diagnosis.screening.screening import uncertainty
from bayes_aero.diagnosis.screening.selection_state import SelectionState
from bayes_aero.diagnosis.selection.forward_selection import Extension


@dataclass(frozen=True)
class CancellingPair:
    """The combination `parameters[0] + factor parameters[1]` of two effects, with its deviation, SI.

    `correlation` is that of the two estimates; departures from neutral are meant.
    """

    effects: tuple[str, str]
    parameters: tuple[str, str]
    factor: float
    mean: float
    sd: float
    unit: str
    correlation: float


def cancelling(extension: Extension, causes: Sequence[str]) -> tuple[CancellingPair, ...]:
    """Pairs of the named causes whose estimates are correlated and whose contributions cancel."""
    state = extension.state
    found = []
    for effects, names, C in _correlated_parameters(extension, causes):
        i, j = (int(state.full.columns([name])[0]) for name in names)
        if _cancel(state, i, j):
            found.append(_together(state, effects, names, C))
    return tuple(found)


def correlated(extension: Extension, effects: Sequence[str]) -> dict[str, dict[str, float]]:
    """Additions whose estimates are correlated, each with its partners and the correlation: the size of one holds only
    beside that of the other."""
    found: dict[str, dict[str, float]] = {}
    for (one, other), _, C in _correlated_parameters(extension, effects):
        found.setdefault(one, {})[other] = found.setdefault(other, {})[one] = _correlation(C)
    return found


def _correlated_parameters(
    extension: Extension, effects: Sequence[str]
) -> Iterator[tuple[tuple[str, str], tuple[str, str], np.ndarray]]:
    """Pairs of effects, one parameter of each, and the covariance of these two where they are correlated."""
    state, fit = extension.state, extension.fit
    if len(effects) < 2:
        return
    covariance = uncertainty(state, fit, autocorrelation_of(state.left(fit), state.folds))
    at = {int(c): k for k, c in enumerate(fit.columns)}
    for one, other in combinations(effects, 2):
        for a, b in product(state.full.parameters_of(one), state.full.parameters_of(other)):
            places = [at[c] for c in map(int, state.full.columns([a, b])) if c in at]
            C = covariance[np.ix_(places, places)]
            if len(places) == 2 and abs(_correlation(C)) > state.settings.correlated:
                yield (one, other), (a, b), C


def _correlation(C: np.ndarray) -> float:
    return float(C[0, 1] / np.sqrt(C[0, 0] * C[1, 1]))


def _cancel(state: SelectionState, i: int, j: int) -> bool:
    """Whether what two parameters do to the outputs, means aside, is less together than either alone."""
    weight = 1.0 / np.mean(state.residual[state.inside] ** 2, axis=0)
    moved = [state.scaled[state.inside][:, :, c] * state.departure[c] for c in (i, j)]
    moved = [x - x.mean(axis=0) for x in moved]
    one, other, both = (float(np.sum(weight * x**2)) for x in (*moved, moved[0] + moved[1]))
    return both < min(one, other)


def _together(state: SelectionState, effects: tuple[str, str], names: tuple[str, str], C: np.ndarray) -> CancellingPair:
    """The combination of least variance; a sum or a difference where that is nearly it."""
    i, j = (int(state.full.columns([name])[0]) for name in names)
    units = [state.full.model.free[c].unit for c in (i, j)]
    factor = -float(C[0, 1] / C[1, 1])
    if units[0] == units[1] and abs(abs(factor) - 1.0) < state.settings.near_one:
        factor = float(np.sign(factor))
    variance = float(C[0, 0] + 2.0 * factor * C[0, 1] + factor**2 * C[1, 1])
    mean = float(state.departure[i] + factor * state.departure[j])
    sd = float(np.sqrt(max(variance, 0.0)))
    return CancellingPair(effects, names, factor, mean, sd, units[0], _correlation(C))
