"""Flights that would decide undecided tolerances: a table, and what it says."""

from __future__ import annotations

from dataclasses import asdict

from bayes_aero.qualification.result import Further, Kind, OpenTolerance
from bayes_aero.report.design.points import order_sentence, point_columns
from bayes_aero.report.tables.table import Column, Table
from bayes_aero.report.text.phrases import SYMBOLS, several

MOST = 6  # tests that are named in a sentence


def further_table(found: Further) -> Table:
    """A row for each test point, in the order of flying."""
    columns = point_columns([asdict(p) for p in found.points])
    decidable = [(k, test) for k, test in enumerate(found.tests) if test.decidable]
    for k, test in decidable:
        head = _label(test).replace(" of ", "\n", 1)
        columns.append(Column([p.expected[k] for p in found.points], page=head, form=".2f", group="then probability"))
    return Table(
        columns,
        "Test points that would decide tolerances, in the order of flying",
        "Amplitude: factor on the standard input. The last columns: probability to pass, expected with the records, "
        "this point and those before it, if the estimates do not move.",
    )


def further_sentences(found: Further | None) -> tuple[str, ...]:
    """What to fly, and which tests no flight decides."""
    if found is None:
        return ()
    if found.why_not:
        return (f"No test points for the undecided tolerances: {found.why_not}.",)
    said = []
    open_ = [t for t in found.tests if not t.decidable]
    if found.points:
        last = found.points[-1].expected
        said.append(order_sentence([asdict(p) for p in found.points]))
        chances = [
            f"{_label(t)} {x:.2f} (now {t.present:.2f})" for t, x in zip(found.tests, last, strict=True) if t.decidable
        ]
        said.append(f"Expected probabilities to pass with these points: {several(chances[:MOST])}.")
    elif len(open_) < len(found.tests):
        said.append("No standard manoeuvre inside the envelope narrows the undecided tests enough to be worth flying.")
    if open_:
        listed = several(map(_label, open_[:MOST]))
        more = f" and {len(open_) - MOST} more" if len(open_) > MOST else ""
        said.append(
            f"Undecided even if the parameters were known: {listed}{more}. Errors of the model's structure or gusts "
            "leave them open, not parameters: improve the model (diagnose)."
        )
    return tuple(said)


def _label(test: OpenTolerance) -> str:
    """Output, manoeuvre, and whether it is flown on the next flight."""
    ahead = " on the next flight" if test.kind is Kind.NEXT else ""
    return f"{SYMBOLS.get(test.output, test.output)} of {test.manoeuvre}{ahead}"
