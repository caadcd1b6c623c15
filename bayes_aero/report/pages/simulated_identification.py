"""The identified model simulated with the recorded inputs: errors of its trajectories, and time histories."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import islice

from bayes_aero.diagnosis.trajectories.results import Path
from bayes_aero.flight.card.card import Card
from bayes_aero.flight.channel import STANDARD_CHANNELS
from bayes_aero.report.colours import COLOURS
from bayes_aero.report.html.page import Block, Text
from bayes_aero.report.html.page_table import page_table
from bayes_aero.report.html.parts import MOST_SHOWN, first
from bayes_aero.report.pages.trajectories import Curve, over_measured, sources
from bayes_aero.report.tables.trajectories import given_table


def given_flights(paths: Sequence[Path], card: Card) -> tuple[Block, ...]:
    """A table of errors, then each manoeuvre with the error shaded; nothing if nothing was simulated."""
    if not paths:
        return ()
    units = {name: STANDARD_CHANNELS[name].unit for name in paths[0].errors}
    _, listed = first([path.manoeuvre for path in paths])
    text = (
        "A simulation with the fitted coefficients and the recorded inputs from the measured initial state, without "
        "correction by measurements. Small errors of a coefficient accumulate here, so trajectories can drift although "
        "the coefficients agree. Nothing was fitted to these trajectories: bayes-aero fly fits trajectories, and "
        "bayes-aero diagnose names missing effects."
    )
    if any(error.tolerance is not None for error in paths[0].errors.values()):
        text += " The grey band is the tolerance about the measurement."
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
    return (Text(text), *lost, *listed, *plots, page_table(given_table(paths)), *sources(card, units))
