"""Estimated gusts with their bands."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from matplotlib.figure import Figure

from bayes_aero.diagnosis.trajectories.results import ProcessNoise
from bayes_aero.report.colours import COLOURS
from bayes_aero.report.style import NotDrawn, housed, refuse_many

MET = {"gust_w": "vertical gust [m/s]", "gust_u": "longitudinal gust [m/s]", "buffet": "buffet [CL of separated flow]"}
BAND = 1.96  # standard deviations


@housed
def gusts(found: ProcessNoise) -> Figure:
    """Estimated gusts with their bands: a row for each manoeuvre, a column for each gust.

    Raises:
        NotDrawn: no gust has an intensity.
    """
    if not found.histories:
        raise NotDrawn("no gust has an intensity")
    refuse_many(len(found.histories))
    labels = {name: MET.get(name, name) for name in found.histories[0].gusts}
    figure, axes = _banded_rows({h.manoeuvre: (h.time, h.gusts) for h in found.histories}, labels)
    for axis in axes.flat:
        axis.axhline(0.0, color="#999999", linewidth=0.6)
    figure.suptitle("Estimated gusts, with 95 % bands", fontsize=10.0)
    return figure


def _banded_rows(rows: Mapping[str, tuple[Any, Mapping[str, tuple[Any, Any]]]], labels: Mapping[str, str]):
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
