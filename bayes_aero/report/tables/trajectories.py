"""Tables of simulated trajectories: errors and time inside the tolerances by flight and output."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from bayes_aero.diagnosis.trajectories.results import Error, Path, Trajectories
from bayes_aero.flight.channel import STANDARD_CHANNELS
from bayes_aero.report.tables.table import Change, Column, Table
from bayes_aero.report.text.phrases import axis_label, for_people, short
from bayes_aero.report.text.trajectories import MODELS, status_sentences

TAIL = 6  # characters of a manoeuvre's name on a terminal
SPLIT_NAMES = {"fitted": "fitted", "hold_out": "hold-out"}
"""What people read, by the split of a simulated path."""
BOTH = ("before", "after")
Flights = list[tuple[str, str]]


def error_table(flown: Trajectories) -> Table:
    """Root mean square error of every output, fitted jointly and on hold-out flights: card's model, extended model."""
    flights, columns = _flights(flown)
    for output in flown.outputs:
        label, factor = _label(output), _factor(output)
        errors = _changes(flown, flights, output, lambda e, factor=factor: factor * e.rms)
        columns.append(Column(errors, "", BOTH, label, short, group=label))
    return Table(
        columns,
        "Root-mean-square error of the simulated trajectory: card's model before, extended model after",
        terminal_title="Error of the simulated trajectory (RMS), card's model → extended model",
        terminal_note=" ".join(
            [
                "Fitted: parameters and initial states fitted to all flights. Hold-out: fitted without this flight, "
                "simulated from its measured initial state.",
                *status_sentences(flown),
            ]
        ),
    )


def tolerance_table(flown: Trajectories) -> Table:
    """Share of the time inside the tolerance, and how probably the extended model stays inside all the time."""
    flights, columns = _flights(flown)
    banded = [n for n in flown.outputs if any(p.errors[n].within is not None for p in flown.paths)]
    for output in banded:
        inside = _changes(flown, flights, output, lambda e: e.within)
        columns.append(Column(inside, "", BOTH, form=".0%", group=_label(output)))
    least = []
    for split, name in flights:
        path = flown.path(name, "extended", split)
        chances = [] if path is None else [path.errors[n].probability for n in banded]
        least.append(min((chance for chance in chances if chance is not None), default=None))
    columns.append(Column(least, page="whole flight inside,\nweakest output", form=".0%", group="probability"))
    return Table(
        columns,
        "Share of the time inside the tolerance",
        "The last column is the posterior probability that the whole flight of the extended model stays inside, for "
        "the output with the lowest probability.",
    )


def given_table(paths: Sequence[Path]) -> Table:
    """Errors of one model's simulation by flight and output."""
    columns = [Column([path.manoeuvre for path in paths], page="flight")]
    for output in paths[0].errors:
        errors, factor, label = [path.errors[output] for path in paths], _factor(output), _label(output)
        columns += [
            Column([factor * error.rms for error in errors], page="RMS", form=short, group=label),
            Column([error.within for error in errors], page="inside", form=".0%", group=label),
        ]
    return Table(
        columns,
        "Error of the simulated trajectories",
        "RMS: root mean square. Inside: share of the time within the tolerance, where the card has one.",
    )


def _flights(flown: Trajectories) -> tuple[Flights, list[Column]]:
    """Split and manoeuvre of each flight, and the columns that name them."""
    found = ((split, p.manoeuvre) for split in SPLIT_NAMES for p in flown.paths if p.split == split)
    flights = list(dict.fromkeys(found))
    return flights, [
        Column([_tail(name) for _, name in flights], terminal="manoeuvre"),
        Column([SPLIT_NAMES[split] for split, _ in flights], terminal=""),
        Column([f"{name}, {SPLIT_NAMES[split]}" for split, name in flights], page="flight"),
    ]


def _tail(name: str) -> str:
    """The end of a record's name, which usually distinguishes records, for the width of a terminal."""
    return name if len(name) <= TAIL + 1 else f"…{name[-TAIL:]}"


def _changes(flown: Trajectories, flights: Flights, output: str, get: Callable[[Error], float | None]) -> list[Change]:
    """A number of each flight by the card's and by the extended model."""
    paths = ([flown.path(name, model, split) for model in MODELS] for split, name in flights)
    return [Change(*(None if path is None else get(path.errors[output]) for path in pair)) for pair in paths]


def _label(output: str) -> str:
    return axis_label(output, STANDARD_CHANNELS[output].unit)


def _factor(output: str) -> float:
    return for_people(STANDARD_CHANNELS[output].unit)[1]
