"""Names for unexplained structure: terms in place of the functions by which it was found, and of causes beside it."""

from __future__ import annotations

from typing import NamedTuple

from bayes_aero.diagnosis.screening.selection_state import SelectionState
from bayes_aero.diagnosis.selection.forward_selection import Extension
from bayes_aero.diagnosis.structure.components import is_periodic
from bayes_aero.diagnosis.structure.unexplained import Left, superfluous, taken_out
from bayes_aero.diagnosis.terms.result import FoundTerm
from bayes_aero.diagnosis.terms.search import Found, forms, gain_of, sized


class Forms(NamedTuple):
    """Terms that were found, and causes of which little is left beside them."""

    terms: tuple[FoundTerm, ...]
    replaced: tuple[str, ...]


def forms_of(extension: Extension, left: Left, *, seed: int) -> Forms:
    """Terms for all structure that is `left`; periods have none.

    A cause that only stood in for a term is taken out, and the terms are sought again without it.
    """
    causes = [name for name in extension.causes if name not in left.replaced]
    state = taken_out(extension.state, [name for name in left.replaced if name in extension.state.active])
    found = _sought(state, left, seed)
    if not found:
        return Forms((), ())
    replaced = superfluous(state, causes, [one.column.component for one in found])
    if replaced:
        state = taken_out(state, replaced)
        found = _sought(state, left, seed)
    return Forms(sized(state, found), replaced if found else ())


def _sought(state: SelectionState, left: Left, seed: int) -> list[Found]:
    """Terms of every coefficient that shows structure."""
    functions = [f for f in left.functions if not is_periodic(f)]
    found: list[Found] = []
    for coefficient in dict.fromkeys(f.label.split(" over ")[0] for f in functions):
        own = [f for f in functions if f.label.startswith(f"{coefficient} over ")]
        found += forms(state, coefficient, gain_of(state, own), seed=seed)
    return found
