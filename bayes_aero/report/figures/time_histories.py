"""Figures over time: manoeuvres, fits of coefficients, simulated trajectories, innovations."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from bayes_aero.diagnosis.trajectories.results import FITTED, START, ProcessNoise, SimulatedManoeuvre, TrajectoryFit
from bayes_aero.diagnosis.view.results import View
from bayes_aero.flight.channel import STANDARD_CHANNELS
from bayes_aero.flight.record import FlightRecord
from bayes_aero.inference.identification import Identification
from bayes_aero.inference.scores import score
from bayes_aero.model.derived_channels import with_sums
from bayes_aero.physics.coefficient_names import LATERAL
from bayes_aero.report.colours import COLOURS
from bayes_aero.report.style import Drawing, NotDrawn, column_width, housed, panels, refuse_many
from bayes_aero.report.tables.across_cases import Predicted, broken, clock, predicted, what_is_shown
from bayes_aero.report.text.phrases import GREEK, bracket, for_people, short

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


# --- Simulated trajectories over the measured ones: of `fly`, and of `diagnose` before and after the extension.

MODELS = (("card", "card's model", COLOURS["before"]), ("extended", "extended model", COLOURS["after"]))
FLOWN = ((START, "start", COLOURS["before"]), (FITTED, "fitted", COLOURS["after"]))
Curve = tuple[SimulatedManoeuvre, str, str]
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
        axes[row, 0].set_ylabel(f"{GREEK.get(output, output)} {bracket(for_people(unit)[0])}")
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


# --- Estimated gusts with their bands.

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
