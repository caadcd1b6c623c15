"""Parts of a page: folded lists, the glossary, and tables of numbers."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import groupby

from bayes_aero.flight.agreement import Consistency
from bayes_aero.report.html import page
from bayes_aero.report.html.page import Facts, Fold, HtmlTable
from bayes_aero.report.tables.table import Table, cell_text
from bayes_aero.report.text.check import among_text, not_told_apart
from bayes_aero.report.text.phrases import several


def not_testable_list(reasons: Mapping[str, str]) -> tuple[Fold, ...]:
    """Every effect that is not testable, by reason, folded."""
    if not reasons:
        return ()
    listed: dict[str, list[str]] = {}
    for name, reason in reasons.items():
        listed.setdefault(reason, []).append(name)
    rows = tuple((reason, ", ".join(names)) for reason, names in listed.items())
    table = HtmlTable("Effects that are not testable on this record", ("reason", "effects"), rows, words=(1,))
    return (Fold(f"The {len(reasons)} effects that are not testable", (table,)),)


def open_list(found: Consistency) -> tuple[Fold, ...]:
    """Each error that others imitate, which those are, and how well it is known with them possible."""
    alike = not_told_apart(found)
    if not alike:
        return ()
    rows = tuple((e.name, several(e.imitators), f"± {among_text(e)}") for e in alike)
    table = HtmlTable(
        "Errors of sensors and winds that others imitate along this flight path",
        ("error", "not distinguishable from", "standard error\nif those are possible"),
        rows,
        words=(1,),
    )
    return (Fold(f"The {len(alike)} errors that are not testable along this flight path", (table,)),)


# --- Terms of a page, each explained in a sentence.

GLOSSARY = {
    "Cramér–Rao bound": "The usual standard error of a maximum-likelihood estimate. It assumes that the errors of "
    "all samples "
    "are independent.",
    "Corrected bound": "The same with the autocorrelation of the residuals (coloured residuals).",
    "White, AR(1) noise": "Noise models: independent samples, and samples that are correlated with their predecessor. "
    "With buffet, the noise grows as the flow separates.",
    "Posterior, 95 % interval": "The probability distribution of a parameter given the data, from prior and "
    "likelihood. The "
    "interval contains the parameter with 95 % probability if the model and the noise model are right.",
    "emcee, NUTS": "Two independent samplers of the same posterior. They should agree.",
    "Lag-1 correlation": "Correlation of a residual with the one a sample earlier: 0 for independent errors, near 1 "
    "for slow ones.",
    "R², r, RMSE, Theil U": "Share of variance explained; correlation; root-mean-square error; Theil's inequality "
    "coefficient, 0 for a perfect fit.",
    "Separation point X": "Where along the chord the flow separates: 1 at the trailing edge (attached), 0 at the "
    "leading edge (stalled).",
    "Hold-out data": "Data that the model was not fitted to: another manoeuvre, or another block of a single one.",
}
FLOWN = {
    "Output error": "Parameters, and initial states unless they are fixed, minimise the difference between measured "
    "outputs and those simulated with the recorded inputs. The simulation is not corrected by measurements.",
    "Cramér–Rao bound": GLOSSARY["Cramér–Rao bound"],
    "Corrected standard error": "The same with the autocorrelation of the residuals and with the prior.",
    "Theil U": "Root-mean-square error over the sum of both signals' root mean squares: 0 for a perfect fit.",
    "Bias, variance, covariance": "Shares of the mean square error: a constant offset, a wrong amplitude, and the "
    "remainder, which includes noise.",
}


def words(terms: dict[str, str]) -> Fold:
    """A glossary behind a line that opens it."""
    return Fold("Terms used here", (Facts(tuple(terms.items())),))


WORDS = words(GLOSSARY)


# --- A table of numbers as a page shows it.


def page_table(table: Table) -> page.HtmlTable:
    """The columns that have a heading on a page, every cell as text."""
    shown = [(head, c, values) for c in table.columns for head, values in c.under(c.page)]
    groups = tuple((group, len(list(some))) for group, some in groupby(c.group for _, c, _ in shown))
    rows = list(zip(*([cell_text(x, c.form) for x in values] for _, c, values in shown), strict=True))
    if len(set(table.below)) > 1:
        first = [k for k, name in enumerate(table.below) if k == 0 or name != table.below[k - 1]]
        for k in reversed(first):
            rows.insert(k, (table.below[k], *[""] * (len(shown) - 1)))
    return page.HtmlTable(
        table.title,
        tuple(head for head, *_ in shown),
        tuple(rows),
        groups if any(group for group, _ in groups) else (),
        tuple(k for k, (_, c, _) in enumerate(shown) if c.words),
        table.note,
    )
