"""The test points that decide what the records leave open: a table, and what it says."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from bayes_aero.report.tables.table import Column, Table
from bayes_aero.report.text.phrases import several

UNITS = {"alpha": "deg", "beta": "deg", "phi": "deg", "airspeed": "m/s", "load_factor": "g", "altitude_loss": "m"}
HEADS = {"alpha": "alpha", "airspeed": "airspeed", "load_factor": "load factor", "altitude_loss": "altitude loss"}


def point_columns(points: Sequence[Mapping[str, Any]]) -> list[Column]:
    """Test points in the order of flying: what is flown, and the ranges that it needs."""
    columns = [
        Column(list(range(1, len(points) + 1)), "point", "point", "", form="d"),
        Column([str(p["manoeuvre"]).replace("_", " ") for p in points], "manoeuvre", "manoeuvre", "manoeuvre"),
        Column(
            [p["amplitude"] for p in points], "amplitude", "amplitude\n[standard inputs]", "size\n[inputs]", form=".1f"
        ),
        Column([p["airspeed"] for p in points], "airspeed", "from airspeed\n[m/s]", "from\n[m/s]", form=".0f"),
        Column([p["altitude"] for p in points], "altitude", "from altitude\n[m]", form=".0f"),
        Column([p["seconds"] for p in points], "seconds", "time\n[s]", "time\n[s]", form=".0f"),
    ]
    for name, head in HEADS.items():
        found = [p["excursion"].get(name) for p in points]
        columns.append(Column([_of_people(name, x) for x in found], "", f"{head}\n[{UNITS[name]}]", form=str))
        columns.append(Column([None if x is None else x[0] for x in found], f"{name}_least"))
        columns.append(Column([None if x is None else x[1] for x in found], f"{name}_greatest"))
    return columns


def points_table(told: Mapping[str, Any]) -> Table:
    """A row for each test point, in the order of flying, from `test_points` of diagnosis.json."""
    points = told["points"]
    columns = point_columns(points)
    for k, question in enumerate(told["questions"]):
        label = " or ".join(question["effects"])
        values = [p["standard_errors"][k] for p in points]
        columns.append(
            Column(
                values, f"standard_errors_{'_or_'.join(question['effects'])}", label, label, ".1f", group="then apart"
            )
        )
    enough = max(q["enough"] for q in told["questions"])
    note = (
        "Amplitude: factor on the standard input. The last columns: by how many standard errors the rivals are "
        "expected to differ with the records, this point and those before it, under the records' coloured noise; "
        f"{enough:.0f} decide."
    )
    return Table(columns, "Test points that would decide what is open, in the order of flying", note)


def _of_people(name: str, pair: Sequence[float] | None) -> str:
    """A range as people read it; of the altitude loss the greatest alone."""
    if pair is None:
        return ""
    factor = 180.0 / np.pi if UNITS[name] == "deg" else 1.0
    low, high = (factor * x for x in pair)
    if name == "altitude_loss":
        return f"{max(high, 0.0):.0f}"
    digits = 2 if name == "load_factor" else 0
    return f"{low:.{digits}f} to {high:.{digits}f}"


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
    questions = [
        (
            " or ".join(q["effects"]),
            q["present"],
            points[-1]["standard_errors"][k] if points else q["present"],
            q["enough"],
        )
        for k, q in enumerate(told["questions"])
    ]
    sentences = []
    if points:
        sentences.append(order_sentence(points))
    for label, before, after, enough in questions:
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
