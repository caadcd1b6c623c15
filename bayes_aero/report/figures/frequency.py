"""Estimates in the frequency domain while the record grows."""

from __future__ import annotations

import math

import numpy as np
from matplotlib.figure import Figure

from bayes_aero.diagnosis.trajectories.results import TrajectoryFit
from bayes_aero.report.colours import COLOURS
from bayes_aero.report.style import NotDrawn, housed
from bayes_aero.report.text.phrases import bracket, plain_unit

BAND = 1.96  # standard errors
COLUMNS = 3
SHOWN = 6.0  # last standard errors to either side that an axis shows at least


@housed
def running(found: TrajectoryFit) -> Figure:
    """Every parameter against time with its 95 % band, and output error of the whole record.

    Raises:
        NotDrawn: no band was asked for.
    """
    if found.running is None:
        raise NotDrawn("no band was asked for")
    run, whole = found.running, dict(zip(found.fit.names, found.fit.estimate, strict=True))
    rows = math.ceil(len(run.names) / COLUMNS)
    figure = Figure(figsize=(9.6, 1.9 * rows + 0.6), layout="constrained")
    axes = figure.subplots(rows, COLUMNS, squeeze=False, sharex=True).ravel()
    for axis, name, unit, value, sd in zip(axes, run.names, run.units, run.value.T, run.sd.T, strict=False):
        axis.fill_between(run.time, value - BAND * sd, value + BAND * sd, color=COLOURS["after"], alpha=0.25, lw=0.0)
        axis.plot(run.time, value, color=COLOURS["after"], label="so far, in the band")
        axis.axhline(whole[name], color=COLOURS["before"], linestyle="--", label="output error, whole record")
        late = value[len(value) // 2 :]
        reach = SHOWN * sd[-1]
        axis.set_ylim(np.nanmin(np.append(late, whole[name])) - reach, np.nanmax(np.append(late, whole[name])) + reach)
        axis.set_ylabel(f"{name} {bracket(plain_unit(unit))}")
    for axis in axes[len(run.names) :]:
        axis.set_visible(False)
    for axis in axes[max(0, len(run.names) - COLUMNS) : len(run.names)]:
        axis.tick_params(labelbottom=True)
        axis.set_xlabel("recorded time [s]")
    axes[0].legend(loc="best", fontsize=7.5)
    figure.suptitle("Parameters while the record grows, with 95 % bands", fontsize=10.0)
    return figure
