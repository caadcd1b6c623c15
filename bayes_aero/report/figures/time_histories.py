"""Figures over time: manoeuvres, fits of coefficients, simulated trajectories, innovations."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from bayes_aero.diagnosis.result import FITTED, START
from bayes_aero.flight.channel import STANDARD_CHANNELS
from bayes_aero.inference.results import score
from bayes_aero.model.records import with_sums
from bayes_aero.physics.aircraft import LATERAL
from bayes_aero.report import style
from bayes_aero.report.colours import COLOURS
from bayes_aero.report.html.plots import Line, Panel, extremes, scale
from bayes_aero.report.phrases import bracket, channel_axis, for_people, short, symbol

if TYPE_CHECKING:
    from bayes_aero.diagnosis.result import ProcessNoise, SimulatedManoeuvre, TrajectoryFit, View
    from bayes_aero.inference.results import Identification

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
    card, columns = identification.card, []
    formed = {*card.sums, *card.tables, *card.derived}  # by the card, of recorded ones
    for record in identification.records:
        made, panels = with_sums(record, card) if formed & set(HISTORY) else {}, []
        for name in HISTORY:
            values = record[name] if record.has(name) else made.get(name) if name in formed else None
            if values is not None:
                shown, unit, factor = channel_axis(name)
                panels.append(Panel(shown, unit, (Line("measured", COLOURS["measured"], factor * values),)))
        columns.append((f"{record.name} ({record.n} samples, {1.0 / record.dt:.0f} Hz)", record.time, panels))
    return drawn(columns, f"Manoeuvres flown: {card.title}")


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

MODELS = (
    ("card", "card's model", COLOURS["before"], "dashed"),
    ("extended", "extended model", COLOURS["after"], "solid"),
)
FLOWN = ((START, "first values", COLOURS["before"], "dashed"), (FITTED, "fitted model", COLOURS["after"], "solid"))


class Curve(NamedTuple):
    """A simulated manoeuvre and how it is drawn."""

    path: SimulatedManoeuvre
    label: str
    colour: str
    style: str


def output_panels(curves: Sequence[Curve], units: Mapping[str, str]) -> list[Panel]:
    """A panel for each output of `units` (SI) of one manoeuvre, the last curve's error shaded."""
    path, panels = curves[0].path, []
    for output in (name for name in units if name in path.measured):
        (unit, factor), tolerance = for_people(units[output]), path.errors[output].tolerance
        lines = [Line("measured", COLOURS["measured"], factor * path.measured[output], width=1.0)]
        with np.errstate(over="ignore"):  # first values of parameters may fly anywhere
            lines += [Line(c.label, c.colour, factor * c.path.simulated[output], c.style) for c in curves]
        band = None if tolerance is None else factor * tolerance
        note = f"RMS error {' → '.join(short(factor * c.path.errors[output].rms) for c in curves)}"
        panels.append(Panel(symbol(output), unit, tuple(lines), ((0, len(curves)),), band, note=note))
    return panels


def drawn(columns: Sequence[tuple[str, np.ndarray, Sequence[Panel]]], title: str) -> Figure:
    """The panels of a page for paper: a column for each manoeuvre (name, time, panels), whose time starts at zero."""
    style.refuse_many(len(columns))
    labels = list(dict.fromkeys(panel.label for _, _, panels in columns for panel in panels))
    tall = float(np.clip(8.0 / len(labels), 1.35, 2.6))
    size = (style.column_width(len(columns)) * len(columns), tall * len(labels) + 1.3)
    figure, axes = style.panels(len(labels), len(columns), size, sharex="col", sharey="row")
    reach: dict[int, list[tuple[float, float]]] = {}
    for column, (_, time, panels) in zip(axes.T, columns, strict=True):
        for panel in panels:
            row = labels.index(panel.label)
            _draw(column[row], time - time[0], panel)
            reach.setdefault(row, []).append(scale(panel.lines, panel.band))
    for row, label in enumerate(labels):
        low, high = zip(*reach[row], strict=True)  # the panels of a row share their scale
        axes[row, 0].set_ylim(min(low), max(high))
        axes[row, 0].set_ylabel(label)
    for ax in (ax for ax in axes.ravel() if not ax.has_data()):
        ax.text(0.5, 0.5, "not recorded", transform=ax.transAxes, ha="center", va="center", color="#777777")
    style.name_panels(axes, [name for name, _, _ in columns])
    style.legend_below(figure, axes[0, 0])
    figure.suptitle(title)
    return figure


def _draw(ax: Axes, time: np.ndarray, panel: Panel) -> None:
    kept = extremes([line.values for line in panel.lines])
    t, values = time[kept], [line.values[kept] for line in panel.lines]
    if panel.band is not None:
        ax.fill_between(t, values[0] - panel.band, values[0] + panel.band, color="#dddddd", lw=0.0, label="tolerance")
    for first, second in panel.shade:
        colour = panel.lines[second].colour
        ax.fill_between(t, values[first], values[second], color=colour, alpha=0.3, lw=0.0)
    for line, y in zip(panel.lines, values, strict=True):
        ax.plot(t, y, color=line.colour, ls=line.style, lw=0.75 * line.width, label=line.label)
    ax.margins(x=0.01)
    ax.yaxis.set_major_locator(MaxNLocator(4, steps=[1, 2, 2.5, 5, 10]))
    ax.text(0.01, 0.95, panel.note, transform=ax.transAxes, va="top", **style.NOTE)


@style.housed
def hold_out(view: View) -> Figure:
    """Every manoeuvre, simulated with the fit to the others."""
    flown = view.trajectories
    if flown is None:
        raise style.NotDrawn("nothing was simulated")
    units, columns = {name: STANDARD_CHANNELS[name].unit for name in flown.outputs}, []
    for name in dict.fromkeys(p.manoeuvre for p in flown.paths if p.split == "hold_out"):
        curves = [Curve(p, *how) for model, *how in MODELS if (p := flown.path(name, model, "hold_out"))]
        columns.append((name, curves[0].path.time, output_panels(curves, units)))
    if not columns:
        raise style.NotDrawn("no manoeuvre is held out")
    return drawn(columns, "Simulated from the measured initial state, with parameters fitted without this flight")


def fly_figures(flown: TrajectoryFit) -> dict[str, Callable[[TrajectoryFit], Figure]]:
    """A figure for each output, by the stem of its file."""
    return {stem_of(n): style.housed(partial(_simulated, n)) for n in flown.outputs}


def stem_of(output: str) -> str:
    """The file of an output's figure, without its ending."""
    return f"trajectory_{re.sub(r'[^A-Za-z0-9_-]', '_', output)}"


def _simulated(output: str, flown: TrajectoryFit) -> Figure:
    columns, unit = [], {output: flown.units[output]}
    for name in flown.manoeuvres:
        curves = [Curve(flown.path(name, model), *how) for model, *how in FLOWN]
        columns.append((name, curves[0].path.time, output_panels(curves, unit)))
    return drawn(columns, "Measured and simulated: with the first values, and with parameters and initial state fitted")


# --- Estimated gusts with their bands.

MET = {
    "gust_w": ("vertical gust", "m/s"),
    "gust_u": ("longitudinal gust", "m/s"),
    "buffet": ("buffet", "CL of separated flow"),
}
"""Gusts by name: as people call them, and their unit."""
BAND = 1.96  # standard deviations


@style.housed
def gusts(found: ProcessNoise) -> Figure:
    """Estimated gusts with their bands: a row for each manoeuvre, a column for each gust."""
    if not found.histories:
        raise style.NotDrawn("no gust has an intensity")
    style.refuse_many(len(found.histories))
    known = {name: MET.get(name, (name, "1")) for name in found.histories[0].gusts}
    labels = {name: f"{words} {bracket(unit)}" for name, (words, unit) in known.items()}
    rows = len(found.histories)
    figure, axes = style.panels(rows, len(labels), (4.2 * len(labels) + 1.2, 1.9 * rows + 0.9), sharey="col")
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


# --- What the validation figures draw: measured and predicted coefficients at the chosen split's test points.

GAP = 1.0  # s; a line is broken where its neighbouring points are further apart


@dataclass(frozen=True)
class PredictedPoints:
    """One coefficient at `index` (ascending) of the observations; `gp`, `low`, `high` are None without a GP."""

    index: np.ndarray
    measured: np.ndarray
    mle: np.ndarray
    gp: np.ndarray | None = None
    low: np.ndarray | None = None
    high: np.ndarray | None = None

    def of(self, manoeuvre: np.ndarray) -> PredictedPoints:
        """Only the points whose sample is marked in `manoeuvre`, a mask over all samples."""
        keep = manoeuvre[self.index]
        cut = (None if part is None else part[keep] for part in (self.gp, self.low, self.high))
        return PredictedPoints(self.index[keep], self.measured[keep], self.mle[keep], *cut)


def predicted(identification: Identification, coefficient: str) -> PredictedPoints:
    """Predictions at the chosen split's test points (all its folds); without a GP the fit at all samples."""
    if identification.gp is None:
        o = identification.observations
        column = o.coefficients.index(coefficient)
        return PredictedPoints(np.arange(o.n), np.asarray(o.measured)[:, column], identification.fitted[:, column])
    folds = [fold[coefficient] for fold in identification.gp.splits[identification.gp.chosen]]
    names = ("test", "measured", "mle", "gp", "gp_low", "gp_high")
    index, *columns = (np.concatenate([getattr(v, name) for v in folds]) for name in names)
    order = np.argsort(index, kind="stable")
    return PredictedPoints(index[order], *(column[order] for column in columns))


def what_is_shown(identification: Identification) -> str:
    """What the predictions were trained on and where they are shown, for titles."""
    if identification.gp is None:
        return "fit to all samples"
    text = {
        "random": "trained on a random 70 % of the samples, shown on the rest",
        "block": "trained on 70 % of the contiguous blocks, shown on the rest",
        "manoeuvre": "each manoeuvre predicted from the others",
    }
    return text.get(identification.gp.chosen, f"{identification.gp.chosen} split, test points")


def broken(time: np.ndarray, *columns: np.ndarray, gap: float = GAP) -> tuple[np.ndarray, ...]:
    """The columns with NaN put in wherever time jumps by more than `gap`, so that a line breaks there."""
    at = np.flatnonzero(np.diff(time) > gap) + 1
    return tuple(np.insert(np.asarray(c, float), at, np.nan) for c in (time, *columns))


def clock(identification: Identification) -> np.ndarray:
    """Time of every sample from the start of its manoeuvre, s."""
    o = identification.observations
    begin = np.array([o.time[o.manoeuvre == m][0] for m in range(len(o.names))])
    return o.time - begin[o.manoeuvre]
