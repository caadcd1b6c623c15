"""Frequency responses of a linear card, measured and modelled."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure

from bayes_aero.report.colours import COLOURS
from bayes_aero.report.style import NotDrawn, housed, panels

if TYPE_CHECKING:
    from bayes_aero.diagnosis.result import TrajectoryFit

BAND = 1.96  # standard errors
KNOWN = 0.3  # largest standard error, of the value, with which a measured response is shown
DECIBEL = 20.0 / math.log(10.0)  # of a relative change
MOST_RESPONSES = 8


@housed
def bode(found: TrajectoryFit) -> Figure:
    """Measured and modelled frequency responses: magnitude, phase, coherence; a column for each input and output."""
    if not found.frequency_responses:
        raise NotDrawn("no band was asked for")
    if len(found.frequency_responses) > MOST_RESPONSES:
        raise NotDrawn(f"more than {MOST_RESPONSES} responses")
    columns = len(found.frequency_responses)
    figure, axes = panels(3, columns, (2.6 * columns + 1.2, 5.6), sharex=True, sharey="row")
    for (magnitude, phase, coherence), one in zip(axes.T, found.frequency_responses, strict=True):
        f, seen = one.frequency, np.where(one.error < KNOWN * np.abs(one.measured), 1.0, np.nan)
        middle = np.rad2deg(np.unwrap(np.angle(one.modelled)))
        around = middle + np.angle(one.draws / one.modelled, deg=True)
        for axis, low, centre in (
            (magnitude, 20.0 * np.log10(np.abs(one.draws)), 20.0 * np.log10(np.abs(one.modelled))),
            (phase, around, middle),
        ):
            edges = np.percentile(low, [2.5, 97.5], axis=0)
            axis.fill_between(f, *edges, color=COLOURS["after"], alpha=0.25, linewidth=0.0)
            axis.plot(f, centre, color=COLOURS["after"], label="modelled, with 95 % band")
        dots = {"color": COLOURS["measured"], "linestyle": "none", "marker": "o", "markersize": 3.0, "elinewidth": 0.8}
        share = seen * BAND * one.error / np.abs(one.measured)
        magnitude.errorbar(f, seen * 20.0 * np.log10(np.abs(one.measured)), DECIBEL * share, **dots, label="measured")
        phase.errorbar(f, seen * middle + np.angle(one.measured / one.modelled, deg=True), np.rad2deg(share), **dots)
        coherence.plot(f, one.coherence, color=COLOURS["measured"])
        coherence.set_ylim(0.0, 1.05)
        coherence.set_xlabel("frequency [Hz]")
        magnitude.set_xscale("log")
        magnitude.set_title(f"{one.output} / {one.input}".replace(" and ", ",\n"), fontsize=8.5)
    for axis, label in zip(axes[:, 0], ("magnitude [dB, SI]", "phase [deg]", "coherence"), strict=True):
        axis.set_ylabel(label)
    axes[0][0].legend(loc="best", fontsize=7.0)
    return figure


FREQUENCY_FIGURES = {"bode": bode}
"""What a fit of trajectories shows of a band."""
