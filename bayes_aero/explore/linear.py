"""A linear system on the page: a group of sliders for each of its rows."""

from __future__ import annotations

from collections.abc import Mapping

from bayes_aero.explore.sliders import Group, slider
from bayes_aero.jobs.handover.identified_linear import IdentifiedLinear

LIMITS = (
    "The card states a linear system: it has no effects to switch or to add, no coefficients, and no form in another "
    "simulator."
)


def linear_groups(found: IdentifiedLinear, errors: Mapping[str, float]) -> tuple[Group, ...]:
    """The parameters of each row, every parameter once, with the row that the card writes first.

    Args:
        found: the system with its values.
        errors: standard errors, SI, where they are known.
    """
    rows, free = found.rows, {p.name: p for p in found.fitted.free}
    many = {name: found.fitted.names_of(name) for name in rows.by_manoeuvre}
    titles = [f"rate of {name}" for name in rows.states] + [f"output {name}" for name in rows.outputs]
    parts = [[term.parameter for term in row] for _, row in rows.rows]
    titles, parts = [*titles, "delays"], [*parts, [parameter for _, parameter in rows.delays]]
    groups, seen = [], set()
    for title, part in zip(titles, parts, strict=True):
        names = [n for parameter in part for n in many.get(parameter, [parameter]) if n in free and n not in seen]
        seen |= {*names}
        sliders = []
        for name in dict.fromkeys(names):
            p, value = free[name], found.values[name]
            sliders.append(slider(p, value, errors.get(name, 0.0), abs(p.start) or 1.0))
        if sliders:
            groups.append(Group(title, f"{title} of the linear system", False, tuple(sliders), switch=False))
    return tuple(groups)
