"""The test points that decide what the records leave open: a table, and what it says."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from bayes_aero.diagnosis.result import CausesInBand, SizeInBand
from bayes_aero.report.frequency import LIMIT, band_text
from bayes_aero.report.html.page import Block, bullets, page_table
from bayes_aero.report.tables.table import Column, Estimate, Table, columns_of, in_brackets, parameter_columns
from bayes_aero.report.text.phrases import WORDS, several

DEG = 180.0 / np.pi
RANGES = {
    "alpha": ("deg", DEG, "{:.0f}"),
    "airspeed": ("m/s", 1.0, "{:.0f}"),
    "load_factor": ("g", 1.0, "{:.2f}"),
    "altitude_loss": ("m", 1.0, "{:.0f}"),  # of which people read the greatest alone
}
"""Unit, factor to it and digits of the ranges that a test point needs."""


def point_columns(points: Sequence[Mapping[str, Any]]) -> list[Column]:
    """Test points in the order of flying: what is flown, and the ranges that it needs."""
    column = columns_of(points)
    columns = [
        Column(list(range(1, len(points) + 1)), "point", "point", "", form="d"),
        column(lambda p: str(p["manoeuvre"]).replace("_", " "), "manoeuvre", "manoeuvre", "manoeuvre"),
        column(lambda p: p["amplitude"], "amplitude", "amplitude\n[standard inputs]", "size\n[inputs]", form=".1f"),
        column(lambda p: p["airspeed"], "airspeed", "from airspeed\n[m/s]", "from\n[m/s]", form=".0f"),
        column(lambda p: p["altitude"], "altitude", "from altitude\n[m]", form=".0f"),
        column(lambda p: p["seconds"], "seconds", "time\n[s]", "time\n[s]", form=".0f"),
    ]
    for name, (unit, factor, form) in RANGES.items():
        found, shown = [p["excursion"].get(name) for p in points], []
        for pair in found:
            low, high = ("", "") if pair is None else (form.format(factor * x) for x in pair)
            greatest = "" if pair is None else form.format(max(factor * pair[1], 0.0))
            shown.append(greatest if name == "altitude_loss" or pair is None else f"{low} to {high}")
        columns.append(Column(shown, "", f"{name.replace('_', ' ')}\n[{unit}]", form=str))
        for k, end in enumerate(("least", "greatest")):
            columns.append(Column([None if x is None else x[k] for x in found], f"{name}_{end}"))
    return columns


def points_table(told: Mapping[str, Any]) -> Table:
    """A row for each test point, in the order of flying, from `test_points` of diagnosis.json."""
    points = told["points"]
    columns = point_columns(points)
    for k, question in enumerate(told["questions"]):
        label, key = (between.join(question["effects"]) for between in (" or ", "_or_"))
        values = [p["standard_errors"][k] for p in points]
        columns.append(Column(values, f"standard_errors_{key}", label, label, ".1f", group="then apart"))
    enough = max(q["enough"] for q in told["questions"])
    note = f"{WORDS['notes']['test_points']} {enough:.0f} decide."
    return Table(columns, "Test points that would decide what is open, in the order of flying", note)


def order_sentence(points: Sequence[Mapping[str, Any]]) -> str:
    """What to fly, in the order of flying."""
    flown = [
        f"{str(p['manoeuvre']).replace('_', ' ')} ({p['amplitude']:g} times the standard input, "
        f"{p['airspeed']:.0f} m/s, {p['seconds']:.0f} s)"
        for p in points
    ]
    return f"Next test points, in this order: {several(flown)}."


def points_sentences(told: Mapping[str, Any]) -> tuple[str, ...]:
    """What to fly next, for each question what it is expected to say, and the envelope."""
    if not told:
        return ()
    points = told["points"]
    sentences = [order_sentence(points)] if points else []
    for k, question in enumerate(told["questions"]):
        label, before, enough = " or ".join(question["effects"]), question["present"], question["enough"]
        after = points[-1]["standard_errors"][k] if points else before
        apart = f"{after:.1f} standard errors apart"
        if after >= enough:
            sentences.append(f"{label}: expected to be decided, {apart} with these points ({before:.1f} now).")
        else:
            sentences.append(
                f"{label}: the manoeuvres of the list that the envelope permits are not expected to decide it: at most "
                f"{apart}, {enough:.0f} needed. A value known from elsewhere would decide it: put it on the card."
            )
    if not told["stated"]:
        sentences.append("The card states no [envelope]: manoeuvres stay inside the program's own, which is wide.")
    return tuple(sentences)


# --- What a diagnosis page shows of the next flight test, and of the causes in a band of frequencies.


def test_point_blocks(told: Mapping[str, Any]) -> Iterator[Block]:
    """What to fly next."""
    yield from bullets(points_sentences(told))
    if told and told["points"]:
        yield page_table(points_table(told))


def in_band_blocks(found: CausesInBand | None) -> tuple[Block, ...]:
    """The third witness: sizes in a band of frequencies."""
    tables = [in_band_table(found)] if found is not None and found.sizes else []
    return (*bullets(in_band_sentences(found)), *map(page_table, tables))


# --- Sizes of the causes in a band of frequencies beside those of the coefficients: a table, and what it says.


def in_band_table(found: CausesInBand) -> Table:
    """A row for each parameter of a cause that the band shows, SI and radians."""
    sizes = found.sizes
    both = (([s.coefficients for s in sizes], "coefficients"), ([s.in_band for s in sizes], "in the band"))
    return Table(
        [
            Column([s.cause for s in sizes], "cause", "cause"),
            *parameter_columns([s.parameter for s in sizes], [s.unit for s in sizes]),
            *(Column([Estimate.normal(*x) for x in values], page=head, form=in_brackets) for values, head in both),
            Column([s.apart for s in sizes], page="difference\n[standard errors]", form=".1f"),
        ],
        f"Sizes from {band_text(found)}, where bias and drift drop out",
        "In brackets: standard error in units of the last digit. SI and radians.",
    )


def in_band_sentences(found: CausesInBand | None) -> tuple[str, ...]:
    """Whether the band confirms the causes."""
    if found is None:
        return ()
    if not found.converged:
        return (f"The causes could not be fitted from {band_text(found)}: the band does not determine them.",)
    sentences, band = [], band_text(found)
    apart = [s for s in found.sizes if s.apart > LIMIT]
    agree = list(dict.fromkeys(s.cause for s in found.sizes if s.cause not in {a.cause for a in apart}))
    if agree:
        sentences.append(f"From {band}, where bias and drift drop out, the sizes agree: {several(agree)}.")
    sentences += [
        f"{one.cause}: from {band} its size is {_size(one.in_band, one)}, {one.apart:.1f} standard errors from "
        f"{_size(one.coefficients, one)} of the whole record: a drift or a slow model error has a part in it."
        for one in apart
    ]
    if found.unseen:
        sentences.append(f"The band does not show {several(found.unseen)}.")
    return tuple(sentences)


def _size(value: tuple[float, float], one: SizeInBand) -> str:
    return f"{in_brackets(Estimate.normal(*value))} {one.unit}"
