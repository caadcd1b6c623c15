"""The seed paper's figures over time: the manoeuvres, the GP's fit, and the validation of each coefficient."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from bayes_aero.flight.channel import STANDARD_CHANNELS
from bayes_aero.flight.record import FlightRecord
from bayes_aero.inference.identification import Identification
from bayes_aero.inference.scores import score
from bayes_aero.model.derived_channels import with_sums
from bayes_aero.physics.coefficient_names import LATERAL
from bayes_aero.report.colours import COLOURS
from bayes_aero.report.style import Drawing, NotDrawn, column_width, housed, panels, refuse_many
from bayes_aero.report.tables.predictions import Predicted, broken, clock, predicted, what_is_shown
from bayes_aero.report.text.phrases import bracket, for_people

# Channels of figure 1, in the seed paper's order, then what else tells a manoeuvre.
HISTORY = ("alpha", "theta", "q", "elevator", "ax", "az", "airspeed", "altitude", "mach", "thrust")
SYMBOLS = {
    "alpha": "α",
    "theta": "θ",
    "beta": "β",
    "elevator": "δe",
    "aileron": "δa",
    "rudder": "δr",
    "airspeed": "V",
    "altitude": "h",
    "mach": "Mach",
    "thrust": "T",
}
LONG_NAMES = {
    "CL": "lift coefficient CL",
    "CD": "drag coefficient CD",
    "Cm": "pitching-moment coefficient Cm",
    "CY": "side-force coefficient CY",
    "Cl": "rolling-moment coefficient Cl",
    "Cn": "yawing-moment coefficient Cn",
}


def shown_in(channel: str) -> tuple[str, float]:
    """The unit in which people read a channel, and the factor to it from SI."""
    unit = STANDARD_CHANNELS[channel].unit if channel in STANDARD_CHANNELS else "N"
    return for_people(unit)


def _channel(identification: Identification, record: FlightRecord, name: str) -> np.ndarray | None:
    """A recorded channel, or one that the card forms of recorded ones; None where there is neither."""
    card = identification.card
    if record.has(name) or name not in {*card.sums, *card.tables, *card.derived}:
        return record[name] if record.has(name) else None
    return with_sums(record, card).get(name)


@housed
def time_history(identification: Identification) -> Figure:
    """Recorded channels: one column per manoeuvre, one row per channel, angles in degrees."""
    records = identification.records
    refuse_many(len(records))
    values = {name: [_channel(identification, record, name) for record in records] for name in HISTORY}
    rows = [name for name, columns in values.items() if any(c is not None for c in columns)]
    width = column_width(len(records))
    figure, axes = panels(len(rows), len(records), (width * len(records), 1.25 * len(rows) + 0.9), sharex="col")
    for row, name in zip(axes, rows, strict=True):
        unit, factor = shown_in(name)
        for ax, record, column in zip(row, records, values[name], strict=True):
            ax.margins(x=0.01)
            if column is None:
                ax.text(0.5, 0.5, "not recorded", transform=ax.transAxes, ha="center", va="center", color="#777777")
                continue
            ax.plot(record.time - record.time[0], factor * column, color=COLOURS["measured"], lw=0.8)
        _same_limits([ax for ax, c in zip(row, values[name], strict=True) if c is not None])
        row[0].set_ylabel(f"{SYMBOLS.get(name, name)} {bracket(unit)}")
    for ax, record in zip(axes[0], records, strict=True):
        ax.set_title(f"{record.name} ({record.n} samples, {1.0 / record.dt:.0f} Hz)")
    for ax in axes[-1]:
        ax.set_xlabel("time from start of record [s]")
    figure.align_ylabels(list(axes[:, 0]))
    figure.suptitle(f"Manoeuvres flown: {identification.card.title}")
    return figure


def _same_limits(row: list[Axes]) -> None:
    """One vertical scale for a row, so that manoeuvres are comparable."""
    limits = np.array([ax.get_ylim() for ax in row])
    for ax in row:
        ax.set_ylim(limits[:, 0].min(), limits[:, 1].max())


@housed
def gpr_fit(identification: Identification) -> Figure:
    """The Gaussian process's coefficients over the measured ones, with its 95 % predictive band."""
    if identification.gp is None:
        raise NotDrawn("this run has no Gaussian process")
    count = len(identification.observations.names)
    refuse_many(count)
    names = identification.observations.coefficients
    size = (column_width(count) * count, 2.4 * len(names) + 0.8)
    figure, axes = panels(len(names), count, size, sharex="col", sharey="row")
    for row, name in zip(axes, names, strict=True):
        points = predicted(identification, name)
        for number, ax in enumerate(row):
            _history(ax, identification, name, points, number, engines=("gpr",))
        assert points.gp is not None
        r = score(points.measured, points.gp).r
        row[0].set_ylabel(f"{name} [-]")
        note = {"va": "top", "bbox": {"fc": "white", "ec": "none", "alpha": 0.8, "pad": 1.5}, "zorder": 5}
        row[0].text(0.02, 0.96, f"r = {r:.4f} (all test points)", transform=row[0].transAxes, **note)
    _finish(figure, axes, identification, f"Gaussian-process regression of {', '.join(names)}")
    return figure


def _validation(identification: Identification, name: str) -> Figure:
    """One coefficient over time, measured and predicted, with the errors below; a column per manoeuvre."""
    count = len(identification.observations.names)
    refuse_many(count)
    size = (column_width(count) * count, 6.5)
    figure, axes = panels(2, count, size, sharex="col", sharey="row", height_ratios=(2, 1))
    points = predicted(identification, name)
    engines = ("mle",) if points.gp is None else ("mle", "gpr")
    for number, (above, below) in enumerate(axes.T):
        _history(above, identification, name, points, number, engines)
        _errors(below, identification, points, number)
    axes[0, 0].set_ylabel(f"{name} [-]")
    axes[1, 0].set_ylabel(f"measured - predicted {name} [-]")
    _finish(figure, axes, identification, f"Validation of the {LONG_NAMES[name]}")
    return figure


def _history(
    ax: Axes, identification: Identification, name: str, points: Predicted, number: int, engines: tuple[str, ...]
) -> None:
    """Measured thin, predictions at their test points: the band and the dots of the GP, the line of the ML model."""
    o = identification.observations
    mine, time = o.manoeuvre == number, clock(identification)
    z = np.asarray(o.measured)[:, o.coefficients.index(name)]
    shown = points.of(mine)
    at = time[shown.index]
    if "gpr" in engines and shown.gp is not None and shown.low is not None and shown.high is not None:
        t, low, high = broken(at, shown.low, shown.high)
        band = {"color": COLOURS["gpr"], "alpha": 0.22, "lw": 0.0, "zorder": 1}
        ax.fill_between(t, low, high, label="GPR, 95 % predictive", **band)
        ax.plot(at, shown.gp, ".", ms=2.2, color=COLOURS["gpr"], zorder=4, label="GPR")
    ax.plot(time[mine], z[mine], color=COLOURS["measured"], lw=0.6, zorder=2, label="measured")
    if "mle" in engines:
        ax.plot(*broken(at, shown.mle), color=COLOURS["mle"], lw=1.2, zorder=3, label="maximum likelihood")
    ax.margins(x=0.01)


def _errors(ax: Axes, identification: Identification, points: Predicted, number: int) -> None:
    shown = points.of(identification.observations.manoeuvre == number)
    at = clock(identification)[shown.index]
    ax.axhline(0.0, color="#777777", lw=0.8)
    ax.plot(*broken(at, shown.measured - shown.mle), color=COLOURS["mle"], lw=0.9)
    if shown.gp is not None:
        ax.plot(at, shown.measured - shown.gp, ".", ms=2.2, color=COLOURS["gpr"])


def _finish(figure: Figure, axes: np.ndarray, identification: Identification, title: str) -> None:
    names = identification.observations.names
    for ax, name in zip(axes[0], names, strict=True):
        ax.set_title(name)
    for ax in axes[-1]:
        ax.set_xlabel("time from start of record [s]")
    figure.align_ylabels(list(axes[:, 0]))
    figure.suptitle(f"{title}: {what_is_shown(identification)}")
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=len(labels), markerscale=4)


def of_coefficient(draw: Callable[[Identification, str], Figure], name: str) -> Drawing:
    """A figure of one coefficient; not drawn for a model without it."""

    def drawn(identification: Identification) -> Figure:
        if name not in identification.observations.coefficients:
            raise NotDrawn(f"the model has no {name}")
        return draw(identification, name)

    return housed(drawn)


FIGURES = {
    "fig1_time_history": time_history,
    "fig2_gpr_fit": gpr_fit,
    "fig3_validation_CL": of_coefficient(_validation, "CL"),
    "fig6_validation_CD": of_coefficient(_validation, "CD"),
    "fig8_validation_Cm": of_coefficient(_validation, "Cm"),
    **{f"validation_{name}": of_coefficient(_validation, name) for name in LATERAL},
}
