"""A model's trajectories over the measured ones, a figure for each output: first values and fit."""

from __future__ import annotations

import re
from collections.abc import Callable
from functools import partial

from matplotlib.figure import Figure

from bayes_aero.diagnosis.trajectories.results import FITTED, START, TrajectoryFit
from bayes_aero.report.colours import COLOURS
from bayes_aero.report.figures.trajectories import over_measured
from bayes_aero.report.style import housed, refuse_many

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
