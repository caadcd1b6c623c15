"""Estimated gusts and drifting parameters with their bands."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from matplotlib.figure import Figure

from bayes_aero.diagnosis.trajectories.results import ProcessNoise
from bayes_aero.report.colours import COLOURS
from bayes_aero.report.style import NotDrawn, housed, refuse_many
from bayes_aero.report.text.phrases import plain_unit

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


@housed
def drift(found: ProcessNoise) -> Figure:
    """Parameters that drift with their bands, and their values without drift: a row for each manoeuvre.

    Raises:
        NotDrawn: no parameter was asked to drift.
    """
    if found.drift is None:
        raise NotDrawn("no parameter was asked to drift")
    refuse_many(len(found.drift.histories))
    parameters = found.drift.parameters
    labels = {name: _label(name, p.unit) for name, p in parameters.items()}
    rows = {h.manoeuvre: (h.time, {n: x[:2] for n, x in h.values.items()}) for h in found.drift.histories}
    figure, axes = _banded_rows(rows, labels)
    for row, history in zip(axes, found.drift.histories, strict=True):
        manoeuvre = history.manoeuvre
        for axis, name in zip(row, labels, strict=True):
            value, _, sd = history.values[name]
            dark = {"color": COLOURS["after"], "alpha": 0.35, "linewidth": 0.0, "label": "95 % of the change"}
            axis.fill_between(history.time, value - BAND * sd, value + BAND * sd, **dark)
            axis.axhline(found.estimates[name][0], color=COLOURS["before"], linestyle="--", label="without drift")
            if name in found.drift.changed and parameters[name].changes[manoeuvre].seen:
                half = parameters[name].changes[manoeuvre].times[1]
                axis.axvline(half, color="#999999", linestyle=":", label="half of the change")
    axes[0][0].legend(loc="best", fontsize=7.5)
    figure.suptitle("Parameters that drift, with 95 % bands", fontsize=10.0)
    return figure


def _label(name: str, unit: str) -> str:
    return name if unit == "1" else f"{name} [{plain_unit(unit)}]"


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
