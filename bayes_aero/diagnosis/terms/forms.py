"""Names for unexplained structure: terms in place of the functions by which it was found, and of causes beside it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from bayes_aero.diagnosis.screening.selection_state import Component, SelectionState
from bayes_aero.diagnosis.selection.forward_selection import Extension
from bayes_aero.diagnosis.structure.components import is_periodic
from bayes_aero.diagnosis.structure.unexplained import Left, superfluous, taken_out
from bayes_aero.diagnosis.terms.result import FoundTerm
from bayes_aero.diagnosis.terms.search import Found, forms, gain_of, sized


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


def forms_of(extension: Extension, left: Left, *, seed: int) -> Forms:
    """Terms for all structure that is `left`; periods have none.

    A cause that only stood in for a term is taken out, and the terms are sought again without it.
    """
    causes = [name for name in extension.causes if name not in left.replaced]
    state = taken_out(extension.state, [name for name in left.replaced if name in extension.state.active])
    found = _sought(state, left, seed)
    if not found:
        return Forms((), (), _structures(state, left, found))
    replaced = superfluous(state, causes, [one.column.component for one in found])
    if replaced:
        state = taken_out(state, replaced)
        found = _sought(state, left, seed)
    return Forms(sized(state, found), replaced if found else (), _structures(state, left, found))


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
