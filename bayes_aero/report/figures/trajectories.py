"""Simulated trajectories over the measured ones: of `fly`, and of `diagnose` before and after the extension."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from functools import partial

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from bayes_aero.diagnosis.trajectories.results import FITTED, START, Path, TrajectoryFit
from bayes_aero.diagnosis.view.results import View
from bayes_aero.flight.channel import STANDARD_CHANNELS
from bayes_aero.report.colours import COLOURS
from bayes_aero.report.style import NotDrawn, column_width, housed, panels, refuse_many
from bayes_aero.report.text.phrases import SYMBOLS, bracket, for_people, short

MODELS = (("card", "card's model", COLOURS["before"]), ("extended", "extended model", COLOURS["after"]))
FLOWN = ((START, "start", COLOURS["before"]), (FITTED, "fitted", COLOURS["after"]))
Curve = tuple[Path, str, str]
"""A path with its label and colour."""


def _shown(view: View, split: str) -> Figure:
    flown = view.trajectories
    if flown is None:
        raise NotDrawn("nothing was simulated")
    names = list(dict.fromkeys(p.manoeuvre for p in flown.paths if p.split == split))
    if not names:
        raise NotDrawn(f"no manoeuvre is {split}")
    columns = {
        name: [(p, label, colour) for key, label, colour in MODELS if (p := flown.path(name, key, split)) is not None]
        for name in names
    }
    captions = {
        "hold_out": "Simulated from the measured initial state, with parameters fitted without this flight",
        "fitted": "Simulated with parameters fitted to all of it",
    }
    return over_measured(columns, {name: STANDARD_CHANNELS[name].unit for name in flown.outputs}, captions[split])


def over_measured(columns: Mapping[str, Sequence[Curve]], outputs: Mapping[str, str], title: str) -> Figure:
    """A row of panels for each output (with its SI unit), a column for each manoeuvre."""
    tall = 1.35 if len(outputs) > 1 else 2.6
    size = (column_width(len(columns)) * len(columns), tall * len(outputs) + 1.3)
    figure, axes = panels(len(outputs), len(columns), size, sharex="col", sharey="row")
    reach: dict[int, list[tuple[float, float]]] = {}
    for column, (name, curves) in enumerate(columns.items()):
        for row, (output, unit) in enumerate(outputs.items()):
            reach.setdefault(row, []).append(_panel(axes[row, column], curves, output, unit))
        axes[0, column].set_title(name)
        axes[-1, column].set_xlabel("time from start of record [s]")
    for row, (output, unit) in enumerate(outputs.items()):
        low, high = zip(*reach[row], strict=True)  # the panels of a row share their scale
        axes[row, 0].set_ylim(min(low), max(high))
        axes[row, 0].set_ylabel(f"{SYMBOLS.get(output, output)} {bracket(for_people(unit)[0])}")
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4)
    figure.align_ylabels(list(axes[:, 0]))
    figure.suptitle(title)
    return figure


def _panel(ax: Axes, paths: Sequence[Curve], output: str, unit: str) -> tuple[float, float]:
    """Draw one; what is measured reaches from and to there, with room: a lost simulation would flatten all else."""
    _, factor = for_people(unit)
    first = paths[0][0]
    time, measured = first.time - first.time[0], factor * first.measured[output]
    tolerance = first.errors[output].tolerance
    if tolerance is not None:
        width = factor * tolerance
        ax.fill_between(time, measured - width, measured + width, color="#dddddd", lw=0.0, label="tolerance")
    ax.plot(time, measured, color=COLOURS["measured"], lw=0.8, label="measured")
    for path, label, colour in paths:
        ax.plot(time, factor * path.simulated[output], color=colour, lw=1.0, label=label)
    ax.margins(x=0.01)
    text = ", ".join(f"{label.split()[0]} {short(factor * p.errors[output].rms)}" for p, label, _ in paths)
    box = {"fc": "white", "ec": "none", "alpha": 0.85, "pad": 1.0}
    ax.text(0.01, 0.95, f"RMS: {text}", transform=ax.transAxes, va="top", fontsize=7.5, bbox=box)
    low, high = float(measured.min()), float(measured.max())
    reach = max(0.35 * (high - low), 1.5 * factor * (tolerance or 0.0))
    return low - reach, high + reach


@housed
def trajectories_hold_out(view: View) -> Figure:
    """Every manoeuvre simulated with the fit to the others, from its measured initial state."""
    return _shown(view, "hold_out")


@housed
def trajectories_fitted(view: View) -> Figure:
    """Every manoeuvre simulated with the joint fit, initial states included."""
    return _shown(view, "fitted")


DIAGNOSIS_FIGURES = {"trajectories_hold_out": trajectories_hold_out, "trajectories_fitted": trajectories_fitted}
AFTER_TRAJECTORIES = ("trajectories_hold_out", "trajectories_fitted")


def fly_figures(flown: TrajectoryFit) -> dict[str, Callable[[TrajectoryFit], Figure]]:
    """A figure for each output, by the stem of its file."""
    return {stem_of(n): housed(partial(_of, n)) for n in flown.outputs}


def stem_of(output: str) -> str:
    """The file of an output's figure, without its ending."""
    return f"trajectory_{re.sub(r'[^A-Za-z0-9_-]', '_', output)}"


def _of(output: str, flown: TrajectoryFit) -> Figure:
    refuse_many(len(flown.manoeuvres))
    columns = {
        name: [(flown.path(name, model), label, colour) for model, label, colour in FLOWN] for name in flown.manoeuvres
    }
    title = "Measured; simulated from the first values; simulated with parameters and initial state fitted"
    return over_measured(columns, {output: flown.units[output]}, title)
