"""The identified model simulated with the recorded inputs: errors of its trajectories, and time histories."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import islice

from bayes_aero.diagnosis.trajectories.results import Path
from bayes_aero.flight.card.card import Card
from bayes_aero.flight.channel import STANDARD_CHANNELS
from bayes_aero.report.colours import COLOURS
from bayes_aero.report.html.page import Block, Table, Text
from bayes_aero.report.html.parts import MOST_SHOWN, first
from bayes_aero.report.pages.trajectories import Curve, over_measured, sources
from bayes_aero.report.text.phrases import axis_label, for_people, short


def given_flights(paths: Sequence[Path], card: Card) -> tuple[Block, ...]:
    """A table of errors, then each manoeuvre with the error shaded; nothing if nothing was simulated."""
    if not paths:
        return ()
    units = {name: STANDARD_CHANNELS[name].unit for name in paths[0].errors}
    _, told = first([path.manoeuvre for path in paths])
    said = (
        "A simulation with the fitted coefficients and the recorded inputs from the measured initial state, without "
        "correction by measurements. Small errors of a coefficient accumulate here, so trajectories can drift although "
        "the coefficients agree. Nothing was fitted to these trajectories: bayes-aero fly fits trajectories, and "
        "bayes-aero diagnose names missing effects."
    )
    if any(error.tolerance is not None for error in paths[0].errors.values()):
        said += " The grey band is the tolerance about the measurement."
    what = "Measured outputs, and those simulated with the fitted coefficients,"
    plots = [
        over_measured(
            path.manoeuvre, f"time-given-{order}", [Curve(path, "simulation", COLOURS["mle"], "solid")], units, what
        )
        for order, path in enumerate(islice(paths, MOST_SHOWN))
    ]
    lost = [
        Text(f"The simulation of {path.manoeuvre} leaves the flight envelope.", "warning")
        for path in paths
        if not path.inside
    ]
    return (Text(said), *lost, *told, *plots, _errors(paths), *sources(card, units))


def _errors(paths: Sequence[Path]) -> Table:
    names = list(paths[0].errors)
    rows = []
    for path in paths:
        cells = [path.manoeuvre]
        for name in names:
            error = path.errors[name]
            cells.append(short(for_people(STANDARD_CHANNELS[name].unit)[1] * error.rms))
            cells.append("–" if error.within is None else f"{error.within:.0%}")
        rows.append(tuple(cells))
    return Table(
        "Error of the simulated trajectories",
        ("flight", *(["RMS", "inside"] * len(names))),
        tuple(rows),
        (("", 1), *((axis_label(n, STANDARD_CHANNELS[n].unit), 2) for n in names)),
        note="RMS: root mean square. Inside: share of the time within the tolerance, where the card has one.",
    )
