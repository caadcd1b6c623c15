"""Stacking weights of a term and of those as good as it: how well each predicts left-out data in its place."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from bayes_aero.diagnosis.screening.selection_state import Component, SelectionState
from bayes_aero.diagnosis.selection.cross_validation import LeftOut
from bayes_aero.diagnosis.selection.stacking import blocks_of_time, resampled_weights
from bayes_aero.diagnosis.structure.components import with_components
from bayes_aero.diagnosis.terms.columns import columns_of
from bayes_aero.diagnosis.terms.forms import Structure
from bayes_aero.diagnosis.terms.result import FoundTerm

MOST = 4  # others that are weighed, those with the most probability


def weighed(terms: Sequence[FoundTerm], structures: Sequence[Structure], *, seed: int) -> tuple[FoundTerm, ...]:
    """The terms, with weights where others are as good."""
    of = {one.coefficient: one for one in structures}
    return tuple(_weighed(one, of[one.coefficient], seed) if one.others else one for one in terms)


def _weighed(term: FoundTerm, structure: Structure, seed: int) -> FoundTerm:
    state = structure.state
    components = {c.term.name: c.component for c in columns_of(state, term.coefficient)}
    own = components[term.term.name].label
    beside = [c for c in (*structure.own, *structure.others) if c.label != own]
    names = [term.term.name, *(other.name for other, _ in term.others[:MOST])]
    density = np.stack([_left_out(state, [*beside, components[n]]).density() for n in names], axis=1)
    block = blocks_of_time(state)[state.inside]
    weights = resampled_weights(density, block, state.variance_inflation, seed).mean(axis=0)
    return replace(term, stacking=dict(zip(names, map(float, weights), strict=True)))


def _left_out(state: SelectionState, components: Sequence[Component]) -> LeftOut:
    """What each fold leaves at a fit to the others, to first order, with components in."""
    whole = with_components(state, (), components, state.folds)
    columns, residual = whole.columns(), np.zeros_like(whole.residual)
    for number, fold in enumerate(whole.folds):
        step = whole.products.without(number).fit(columns, whole.mean, whole.precision).step
        residual[fold] = whole.residual[fold] - whole.S[fold][:, :, columns] @ step
    return LeftOut(residual, whole.noise_growth, whole.inside, whole.outputs)
