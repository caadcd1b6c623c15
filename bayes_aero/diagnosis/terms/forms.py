"""Names for unexplained structure: terms in place of the functions by which it was found, and of causes beside it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from bayes_aero.diagnosis.screening.parameter_fit import refitted
from bayes_aero.diagnosis.screening.selection_state import Component, SelectionState, moved
from bayes_aero.diagnosis.selection.cross_validation import holdout_deviance, truncated
from bayes_aero.diagnosis.selection.forward_selection import Extension
from bayes_aero.diagnosis.structure.components import is_periodic, with_components
from bayes_aero.diagnosis.structure.unexplained import Left, superfluous, taken_out
from bayes_aero.diagnosis.terms.columns import term_of
from bayes_aero.diagnosis.terms.result import FoundTerm
from bayes_aero.diagnosis.terms.search import Found, forms, gain_of, sized
from bayes_aero.effect import Kind
from bayes_aero.inference.variance.variance_inflation import nats


class Structure(NamedTuple):
    """A coefficient in which structure is left, where its form was sought.

    `own` describes it, by terms or (where these do not) by the functions that show it; `others` is what describes the
    other coefficients.
    """

    state: SelectionState
    coefficient: str
    own: tuple[Component, ...]
    others: tuple[Component, ...]


class Forms(NamedTuple):
    """Terms that were found, causes of which little is left beside them, and where they were sought."""

    terms: tuple[FoundTerm, ...]
    replaced: tuple[str, ...]
    structures: tuple[Structure, ...] = ()
    idle: tuple[str, ...] = ()  # coefficients whose offsets between manoeuvres the terms explain


def forms_of(extension: Extension, left: Left, *, seed: int) -> Forms:
    """Terms for all structure that is `left`; periods have none.

    A cause that only stood in for a term is taken out, and the terms are sought again without it.
    """
    causes = [name for name in extension.causes if name not in left.replaced]
    if (instead := _instead(extension, causes, left, seed)) is not None:
        return instead
    state = taken_out(extension.state, [name for name in left.replaced if name in extension.state.active])
    found = _sought(state, left, seed)
    if not found:
        return Forms((), (), _structures(state, left, found))
    replaced = superfluous(state, causes, [one.column.component for one in found])
    if replaced:
        state = taken_out(state, replaced)
        found = _sought(state, left, seed)
    return Forms(sized(state, found), replaced if found else (), _structures(state, left, found))


def _instead(extension: Extension, causes: Sequence[str], left: Left, seed: int) -> Forms | None:
    """Terms in place of causes of the aerodynamics, and of offsets between manoeuvres, that only stood in for them.

    A wrong form of a coefficient leaves residuals that follow the state, as a stall does, and differ between manoeuvres
    at different states, as offsets do. A cause that is a term of the library keeps its name.
    """
    state, owned = extension.state, {e.name: e for e in extension.state.full.candidates}
    shapes = [name for name in causes if owned[name].kind is Kind.AERODYNAMICS]
    if not (shapes or state.apart):
        return None
    contested = [name for name in shapes if term_of(state, name) is None]
    kept = [e for e in state.active if e not in contested]
    bare = refitted(truncated(state, kept))[0]
    reached = np.any(state.S[:, :, state.full.own_columns(*contested)] != 0.0, axis=(0, 2))
    shown = {f.label.split(" over ")[0] for f in left.functions}
    found, apart = list[Found](), list(state.apart)
    for name, moves in zip(state.outputs, reached, strict=True):
        if name in state.apart or (contested and (moves or name in shown)):
            terms, idle = _of_one(bare, name, seed)
            found += terms
            apart = [n for n in apart if not (idle and n == name)]
    if not found or (not contested and tuple(apart) == state.apart):
        return None
    return _compared(extension, shapes, found, tuple(apart))


def _of_one(state: SelectionState, name: str, seed: int) -> tuple[list[Found], bool]:
    """Terms of a coefficient, and whether they explain what its offsets between manoeuvres would, too."""
    beside = forms(state, name, 0.0, seed=seed)
    if name not in state.apart:
        return beside, False
    fewer = refitted(moved(state, state.theta, apart=tuple(n for n in state.apart if n != name)))[0]
    instead = forms(fewer, name, 0.0, seed=seed)
    inflation, costs = max([one.inflation for one in (*beside, *instead)], default=state.variance_inflation), []
    for one, found in ((state, beside), (fewer, instead), (fewer, beside)):
        wide = with_components(one, (), [f.column.component for f in found], one.folds)
        costs.append(nats(wide.fit().deviance, inflation) + sum(map(_cost, found)))
    spared = len(state.responses.flights.lengths) - 1
    if not (beside or instead) or min(costs[1:]) >= costs[0] + spared:
        return beside, False
    return (instead, True) if costs[1] < costs[2] else (beside, True)


def _cost(one: Found) -> float:
    """Nats of a parameter and of the choice of a term."""
    return 1.0 + float(np.log(one.among))


def _compared(
    extension: Extension,
    shapes: Sequence[str],
    found: Sequence[Found],
    apart: tuple[str, ...],
) -> Forms | None:
    """Terms and what they take the place of, if they explain and predict decisively more.

    They are compared as wholes, for neither explains much beside what the other lacks. Every parameter costs itself and
    the choice that it is. Terms must be identified within manoeuvres, as causes must.
    """
    state, settings, terms = extension.state, extension.state.settings, [one.column.component for one in found]
    gone = list[str]()
    while least := _least_beside(state, [name for name in shapes if name not in gone], gone, terms):
        gone.append(least)
    idle = tuple(name for name in state.apart if name not in apart)
    if not (gone or idle):
        return None
    within = truncated(state, [e for e in state.active if e not in gone])
    fewer = refitted(moved(within, within.theta, apart=apart))[0]
    cost = sum(map(_cost, found))
    owned = {e.name: e for e in state.full.candidates}
    narrow, wide = (with_components(one, (), terms, one.folds) for one in (fewer, within))
    seen = extension.fit.deviance - narrow.fit().deviance
    of_terms = within.fit().deviance - wide.fit().deviance
    unseen = holdout_deviance(state, state.columns()) - holdout_deviance(wide, wide.columns())
    inflation = max(one.inflation for one in found)
    seen, of_terms, unseen = (nats(x, inflation) for x in (seen, of_terms, unseen))
    spared = sum(len(owned[name].parameters) + np.log(len(owned)) for name in gone)
    spared += len(idle) * (len(state.responses.flights.lengths) - 1)
    if min(seen - cost + spared, of_terms - cost, unseen) <= settings.decisive:
        return None
    own: dict[str, list[Component]] = _by_coefficient(terms)
    structures = [
        Structure(fewer, name, tuple(mine), tuple(c for other in own if other != name for c in own[other]))
        for name, mine in own.items()
    ]
    return Forms(sized(fewer, found), tuple(gone), tuple(structures), idle)


def _least_beside(state: SelectionState, causes: Sequence[str], gone: Sequence[str], terms: Sequence[Component]) -> str:
    """The cause of which least is left beside terms and the other causes, if that is too little for a name."""
    kept = [e for e in state.active if e not in gone]
    left = truncated(state, kept)
    whole = with_components(left, (), terms, left.folds).fit()
    least = state.least_share(state.settings.unnamed_share)
    shares = {}
    for name in causes:
        fewer = truncated(state, [e for e in kept if e != name])
        more = with_components(fewer, (), terms, fewer.folds).fit().deviance - whole.deviance
        shares[name] = 1.0 - float(np.exp(-max(more, 0.0) / state.products.count.sum()))
    worst = min(shares, key=lambda name: shares[name], default="")
    return worst if worst and shares[worst] < least else ""


def _sought(state: SelectionState, left: Left, seed: int) -> list[Found]:
    """Terms of every coefficient that shows structure."""
    found: list[Found] = []
    for coefficient, own in _by_coefficient([f for f in left.functions if not is_periodic(f)]).items():
        found += forms(state, coefficient, gain_of(state, own), seed=seed)
    return found


def _structures(state: SelectionState, left: Left, found: Sequence[Found]) -> tuple[Structure, ...]:
    """Every coefficient with structure that may have a form, with the best description of all of them."""
    terms = _by_coefficient([one.column.component for one in found])
    known = {name: terms.get(name, own) for name, own in _by_coefficient(left.functions).items()}
    others = {name: [c for other, own in known.items() if other != name for c in own] for name in known}
    sought = _by_coefficient([f for f in left.functions if not is_periodic(f)])
    return tuple(Structure(state, name, tuple(known[name]), tuple(others[name])) for name in sought)


def _by_coefficient(components: Sequence[Component]) -> dict[str, list[Component]]:
    found: dict[str, list[Component]] = {}
    for one in components:
        found.setdefault(one.label.split(" over ")[0], []).append(one)
    return found
