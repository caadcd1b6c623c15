"""Histories of parameters that drift."""

from __future__ import annotations

from matplotlib.figure import Figure

from bayes_aero.diagnosis.trajectories.results import ProcessNoise
from bayes_aero.report.colours import COLOURS
from bayes_aero.report.figures.fly import BAND, banded_rows
from bayes_aero.report.style import NotDrawn, housed, refuse_many
from bayes_aero.report.text.phrases import plain_unit


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
    figure, axes = banded_rows(rows, labels)
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
