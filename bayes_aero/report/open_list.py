"""Errors of sensors that the flight path cannot tell from others, one by one, for a fold of a page."""

from __future__ import annotations

from bayes_aero.flight.agreement import Consistency
from bayes_aero.report.page import Fold, Table
from bayes_aero.report.phrases import several
from bayes_aero.report.words_consistency import among_text


def open_list(found: Consistency) -> tuple[Fold, ...]:
    """Each error that others imitate, which those are, and how well it is known with them possible."""
    alike = [e for e in found.open if not e.asked]
    if not alike:
        return ()
    rows = tuple((e.name, several(e.imitators), f"± {among_text(e)}") for e in alike)
    table = Table(
        "Errors of sensors and winds that others imitate along this flight path",
        ("error", "cannot be told from", "standard error\nif those are possible"),
        rows,
        words=(1,),
    )
    return (Fold(f"The {len(alike)} errors that are not testable along this flight path", (table,)),)
