"""The gusts that each manoeuvre met, with their 95 % bands."""

from __future__ import annotations

from matplotlib.figure import Figure

from bayes_aero.diagnosis.trajectories.results import ProcessNoise
from bayes_aero.report.colours import COLOURS
from bayes_aero.report.style import NotDrawn, housed, refuse_many

NAMES = {"gust_w": "vertical", "gust_u": "longitudinal"}
BAND = 1.96  # standard deviations


@housed
def gusts(found: ProcessNoise) -> Figure:
    """A row for each manoeuvre, a column for each gust.

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
            axis.set_ylabel(f"{NAMES.get(name, name)} gust, m/s")
            axis.set_xlabel("time, s")
    figure.suptitle("Gusts met, with 95 % bands", fontsize=10.0)
    return figure
