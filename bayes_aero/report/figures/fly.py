"""A model's trajectories over the measured ones, a figure for each output; and the gusts that were met."""

from __future__ import annotations

import re
from collections.abc import Callable
from functools import partial

from matplotlib.figure import Figure

from bayes_aero.diagnosis.trajectories.results import FITTED, START, ProcessNoise, TrajectoryFit
from bayes_aero.report.colours import COLOURS
from bayes_aero.report.figures.trajectories import over_measured
from bayes_aero.report.style import NotDrawn, housed, refuse_many

GUSTS = {"gust_w": "vertical", "gust_u": "longitudinal"}
BAND = 1.96  # standard deviations
MODELS = ((START, "start", COLOURS["before"]), (FITTED, "fitted", COLOURS["after"]))


def fly_figures(flown: TrajectoryFit) -> dict[str, Callable[[TrajectoryFit], Figure]]:
    """A figure for each output, by the stem of its file."""
    return {stem_of(n): housed(partial(_of, n)) for n in flown.outputs}


def stem_of(output: str) -> str:
    """The file of an output's figure, without its ending."""
    return f"trajectory_{re.sub(r'[^A-Za-z0-9_-]', '_', output)}"


def _of(output: str, flown: TrajectoryFit) -> Figure:
    refuse_many(len(flown.manoeuvres))
    columns = {
        name: [(flown.path(name, model), label, colour) for model, label, colour in MODELS] for name in flown.manoeuvres
    }
    title = "Measured; simulated from the first values; simulated with parameters and initial state fitted"
    return over_measured(columns, {output: flown.units[output]}, title)


@housed
def gusts(found: ProcessNoise) -> Figure:
    """The gusts that were met, with their bands: a row for each manoeuvre, a column for each gust.

    Raises:
        NotDrawn: no gust has an intensity.
    """
    if not found.histories:
        raise NotDrawn("no gust has an intensity")
    refuse_many(len(found.histories))
    names = list(found.histories[0].gusts)
    rows, columns = len(found.histories), len(names)
    figure = Figure(figsize=(4.2 * columns + 1.2, 1.9 * rows + 0.9), layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False, sharey="col")
    for row, history in zip(axes, found.histories, strict=True):
        for axis, name in zip(row, names, strict=True):
            mean, sd = history.gusts[name]
            axis.axhline(0.0, color="#999999", linewidth=0.6)
            axis.fill_between(
                history.time, mean - BAND * sd, mean + BAND * sd, color=COLOURS["after"], alpha=0.25, linewidth=0.0
            )
            axis.plot(history.time, mean, color=COLOURS["after"])
            axis.set_title(history.manoeuvre, loc="left")
            axis.set_ylabel(f"{GUSTS.get(name, name)} gust, m/s")
            axis.set_xlabel("time, s")
    figure.suptitle("Gusts met, with 95 % bands", fontsize=10.0)
    return figure
