"""Folded lists: effects that a record cannot test, sensor errors that others imitate."""

from __future__ import annotations

from collections.abc import Mapping

from bayes_aero.flight.agreement import Consistency
from bayes_aero.report.html.page import Fold, Table
from bayes_aero.report.text.consistency import among_text, not_told_apart
from bayes_aero.report.text.phrases import several


def not_testable_list(reasons: Mapping[str, str]) -> tuple[Fold, ...]:
    """Every effect that is not testable, by reason, folded."""
    if not reasons:
        return ()
    listed: dict[str, list[str]] = {}
    for name, reason in reasons.items():
        listed.setdefault(reason, []).append(name)
    rows = tuple((reason, ", ".join(names)) for reason, names in listed.items())
    table = Table("Effects that are not testable on this record", ("reason", "effects"), rows, words=(1,))
    return (Fold(f"The {len(reasons)} effects that are not testable", (table,)),)


def open_list(found: Consistency) -> tuple[Fold, ...]:
    """Each error that others imitate, which those are, and how well it is known with them possible."""
    alike = not_told_apart(found)
    if not alike:
        return ()
    rows = tuple((e.name, several(e.imitators), f"± {among_text(e)}") for e in alike)
    table = Table(
        "Errors of sensors and winds that others imitate along this flight path",
        ("error", "not distinguishable from", "standard error\nif those are possible"),
        rows,
        words=(1,),
    )
    return (Fold(f"The {len(alike)} errors that are not testable along this flight path", (table,)),)
