"""Figures over time: manoeuvres, fits of coefficients, simulated trajectories, innovations."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from functools import partial

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from bayes_aero.diagnosis.trajectory_result import FITTED, START, ProcessNoise, SimulatedManoeuvre, TrajectoryFit, View
from bayes_aero.flight.channel import STANDARD_CHANNELS
from bayes_aero.flight.record import FlightRecord
from bayes_aero.inference.results import Identification
from bayes_aero.inference.scores import score
from bayes_aero.model.records import with_sums
from bayes_aero.physics.aircraft import LATERAL
from bayes_aero.report import style
from bayes_aero.report.colours import COLOURS
from bayes_aero.report.tables.across_cases import PredictedPoints, broken, clock, predicted, what_is_shown
from bayes_aero.report.text.phrases import axis_label, channel_axis, for_people, short

# Channels of figure 1, in the seed paper's order, then what else tells a manoeuvre.
HISTORY = ("alpha", "theta", "q", "elevator", "ax", "az", "airspeed", "altitude", "mach", "thrust")
LONG_NAMES = {
    "CL": "lift coefficient CL",
    "CD": "drag coefficient CD",
    "Cm": "pitching-moment coefficient Cm",
    "CY": "side-force coefficient CY",
    "Cl": "rolling-moment coefficient Cl",
    "Cn": "yawing-moment coefficient Cn",
}


@style.housed
def time_history(identification: Identification) -> Figure:
    """Recorded channels: one column per manoeuvre, one row per channel, angles in degrees."""
    records, card = identification.records, identification.card
    style.refuse_many(len(records))
    formed = {*card.sums, *card.tables, *card.derived}  # by the card, of recorded ones

    def values_of(record: FlightRecord, name: str) -> np.ndarray | None:
        if record.has(name) or name not in formed:
            return record[name] if record.has(name) else None
        return with_sums(record, card).get(name)

    values = {name: [values_of(record, name) for record in records] for name in HISTORY}
    rows = [name for name, columns in values.items() if any(c is not None for c in columns)]
    width = style.column_width(len(records))
    figure, axes = style.panels(len(rows), len(records), (width * len(records), 1.25 * len(rows) + 0.9), sharex="col")
    for row, name in zip(axes, rows, strict=True):
        label, factor = channel_axis(name)
        for ax, record, column in zip(row, records, values[name], strict=True):
            ax.margins(x=0.01)
            if column is None:
                ax.text(0.5, 0.5, "not recorded", transform=ax.transAxes, ha="center", va="center", color="#777777")
                continue
            ax.plot(record.time - record.time[0], factor * column, color=COLOURS["measured"], lw=0.8)
        drawn = [ax for ax, c in zip(row, values[name], strict=True) if c is not None]
        low, high = zip(*(ax.get_ylim() for ax in drawn), strict=True)
        for ax in drawn:  # one vertical scale for a row, so that manoeuvres are comparable
            ax.set_ylim(min(low), max(high))
        row[0].set_ylabel(label)
    style.name_panels(axes, [f"{record.name} ({record.n} samples, {1.0 / record.dt:.0f} Hz)" for record in records])
    figure.suptitle(f"Manoeuvres flown: {card.title}")
    return figure


@style.housed
def gpr_fit(identification: Identification) -> Figure:
    """The Gaussian process's coefficients over the measured ones, with its 95 % predictive band."""
    if identification.gp is None:
        raise style.NotDrawn("this run has no Gaussian process")
    count = len(identification.observations.names)
    style.refuse_many(count)
    names = identification.observations.coefficients
    size = (style.column_width(count) * count, 2.4 * len(names) + 0.8)
    figure, axes = style.panels(len(names), count, size, sharex="col", sharey="row")
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
    style.refuse_many(count)
    size = (style.column_width(count) * count, 6.5)
    figure, axes = style.panels(2, count, size, sharex="col", sharey="row", height_ratios=(2, 1))
    points = predicted(identification, name)
    engines = ("mle",) if points.gp is None else ("mle", "gpr")
    for number, (above, below) in enumerate(axes.T):
        _history(above, identification, name, points, number, engines)
        shown = points.of(identification.observations.manoeuvre == number)
        at = clock(identification)[shown.index]
        below.axhline(0.0, color="#777777", lw=0.8)
        below.plot(*broken(at, shown.measured - shown.mle), color=COLOURS["mle"], lw=0.9)
        if shown.gp is not None:
            below.plot(at, shown.measured - shown.gp, ".", ms=2.2, color=COLOURS["gpr"])
    axes[0, 0].set_ylabel(f"{name} [-]")
    axes[1, 0].set_ylabel(f"measured - predicted {name} [-]")
    _finish(figure, axes, identification, f"Validation of the {LONG_NAMES[name]}")
    return figure


def _history(
    ax: Axes, identification: Identification, name: str, points: PredictedPoints, number: int, engines: tuple[str, ...]
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


def _finish(figure: Figure, axes: np.ndarray, identification: Identification, title: str) -> None:
    style.name_panels(axes, identification.observations.names)
    figure.suptitle(f"{title}: {what_is_shown(identification)}")
    style.legend_below(figure, axes[0, 0], markerscale=4)


def of_coefficient(draw: Callable[[Identification, str], Figure], name: str) -> style.Drawing:
    """A figure of one coefficient; not drawn for a model without it."""

    def drawn(identification: Identification) -> Figure:
        if name not in identification.observations.coefficients:
            raise style.NotDrawn(f"the model has no {name}")
        return draw(identification, name)

    return style.housed(drawn)


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


def _shown(split: str, title: str, view: View) -> Figure:
    """Every manoeuvre of a split: simulated with the fit to the others, or with the joint fit."""
    flown = view.trajectories
    if flown is None:
        raise style.NotDrawn("nothing was simulated")
    names = list(dict.fromkeys(p.manoeuvre for p in flown.paths if p.split == split))
    if not names:
        raise style.NotDrawn(f"no manoeuvre is {split}")
    columns = {
        name: [(p, label, colour) for model, label, colour in MODELS if (p := flown.path(name, model, split))]
        for name in names
    }
    return over_measured(columns, {name: STANDARD_CHANNELS[name].unit for name in flown.outputs}, title)


def over_measured(columns: Mapping[str, Sequence[Curve]], outputs: Mapping[str, str], title: str) -> Figure:
    """A row of panels for each output (with its SI unit), a column for each manoeuvre."""
    tall = 1.35 if len(outputs) > 1 else 2.6
    size = (style.column_width(len(columns)) * len(columns), tall * len(outputs) + 1.3)
    figure, axes = style.panels(len(outputs), len(columns), size, sharex="col", sharey="row")
    reach: dict[int, list[tuple[float, float]]] = {}
    for column, curves in enumerate(columns.values()):
        for row, (output, unit) in enumerate(outputs.items()):
            reach.setdefault(row, []).append(_panel(axes[row, column], curves, output, unit))
    for row, (output, unit) in enumerate(outputs.items()):
        low, high = zip(*reach[row], strict=True)  # the panels of a row share their scale
        axes[row, 0].set_ylim(min(low), max(high))
        axes[row, 0].set_ylabel(axis_label(output, unit))
    style.name_panels(axes, columns)
    style.legend_below(figure, axes[0, 0], 4)
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


DIAGNOSIS_FIGURES = {
    f"trajectories_{split}": style.housed(partial(_shown, split, title))
    for split, title in (
        ("hold_out", "Simulated from the measured initial state, with parameters fitted without this flight"),
        ("fitted", "Simulated with parameters fitted to all of it"),
    )
}
AFTER_TRAJECTORIES = tuple(DIAGNOSIS_FIGURES)


def fly_figures(flown: TrajectoryFit) -> dict[str, Callable[[TrajectoryFit], Figure]]:
    """A figure for each output, by the stem of its file."""
    return {stem_of(n): style.housed(partial(_simulated, n)) for n in flown.outputs}


def stem_of(output: str) -> str:
    """The file of an output's figure, without its ending."""
    return f"trajectory_{re.sub(r'[^A-Za-z0-9_-]', '_', output)}"


def _simulated(output: str, flown: TrajectoryFit) -> Figure:
    style.refuse_many(len(flown.manoeuvres))
    columns = {name: [(flown.path(name, model), x, colour) for model, x, colour in FLOWN] for name in flown.manoeuvres}
    title = "Measured; simulated from the first values; simulated with parameters and initial state fitted"
    return over_measured(columns, {output: flown.units[output]}, title)


# --- Estimated gusts with their bands.

MET = {"gust_w": "vertical gust [m/s]", "gust_u": "longitudinal gust [m/s]", "buffet": "buffet [CL of separated flow]"}
BAND = 1.96  # standard deviations


@style.housed
def gusts(found: ProcessNoise) -> Figure:
    """Estimated gusts with their bands: a row for each manoeuvre, a column for each gust."""
    if not found.histories:
        raise style.NotDrawn("no gust has an intensity")
    style.refuse_many(len(found.histories))
    labels = {name: MET.get(name, name) for name in found.histories[0].gusts}
    rows = len(found.histories)
    figure = Figure(figsize=(4.2 * len(labels) + 1.2, 1.9 * rows + 0.9), layout="constrained")
    axes = figure.subplots(rows, len(labels), squeeze=False, sharey="col")
    for row, h in zip(axes, found.histories, strict=True):
        for ax, (name, label) in zip(row, labels.items(), strict=True):
            mean, sd = h.gusts[name]
            band = {"color": COLOURS["after"], "alpha": 0.25, "linewidth": 0.0}
            ax.fill_between(h.time, mean - BAND * sd, mean + BAND * sd, **band)
            ax.plot(h.time, mean, color=COLOURS["after"])
            ax.set_title(h.manoeuvre, loc="left")
            ax.set(xlabel="time [s]", ylabel=label)
            ax.axhline(0.0, color="#999999", linewidth=0.6)
    figure.suptitle("Estimated gusts, with 95 % bands", fontsize=10.0)
    return figure
