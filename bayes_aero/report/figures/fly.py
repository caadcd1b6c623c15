"""A model's trajectories over the measured ones, a figure for each output; and the gusts that were met."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

from matplotlib.figure import Figure

from bayes_aero.diagnosis.trajectories.results import FITTED, START, ProcessNoise, TrajectoryFit
from bayes_aero.report.colours import COLOURS
from bayes_aero.report.figures.trajectories import over_measured
from bayes_aero.report.style import NotDrawn, housed, refuse_many

MET = {"gust_w": "vertical gust [m/s]", "gust_u": "longitudinal gust [m/s]", "buffet": "buffet [CL of separated flow]"}
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
    labels = {name: MET.get(name, name) for name in found.histories[0].gusts}
    figure, axes = banded_rows({h.manoeuvre: (h.time, h.gusts) for h in found.histories}, labels)
    for axis in axes.flat:
        axis.axhline(0.0, color="#999999", linewidth=0.6)
    figure.suptitle("Gusts met, with 95 % bands", fontsize=10.0)
    return figure


def banded_rows(rows: Mapping[str, tuple[Any, Mapping[str, tuple[Any, Any]]]], labels: Mapping[str, str]):
    """Means with bands over time: rows by manoeuvre (time, mean and standard deviation by name), columns by label."""
    figure = Figure(figsize=(4.2 * len(labels) + 1.2, 1.9 * len(rows) + 0.9), layout="constrained")
    axes = figure.subplots(len(rows), len(labels), squeeze=False, sharey="col")
    for row, (manoeuvre, (time, found)) in zip(axes, rows.items(), strict=True):
        for axis, (name, label) in zip(row, labels.items(), strict=True):
            mean, sd = found[name]
            axis.fill_between(
                time, mean - BAND * sd, mean + BAND * sd, color=COLOURS["after"], alpha=0.25, linewidth=0.0
            )
            axis.plot(time, mean, color=COLOURS["after"])
            axis.set_title(manoeuvre, loc="left")
            axis.set_ylabel(label)
            axis.set_xlabel("time [s]")
    return figure, axes
