"""Figures over time and frequency: manoeuvres, fits of coefficients, simulated trajectories, gusts, responses."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from bayes_aero.flight.channel import STANDARD_CHANNELS
from bayes_aero.physics.aircraft import LATERAL
from bayes_aero.report import style
from bayes_aero.report.phrases import bracket
from bayes_aero.report.plots import COLOURS, FLOWN, MODELS, Panel, extremes, measured_panel, output_panels, scale

if TYPE_CHECKING:
    import pandas as pd

    from bayes_aero.diagnosis.result import ProcessNoise, TrajectoryFit, View
    from bayes_aero.inference.results import Identification

# Channels of figure 1, in the seed paper's order, then what else tells a manoeuvre.
HISTORY = ("alpha", "theta", "q", "elevator", "ax", "az", "airspeed", "altitude", "mach", "thrust")
BAND = 1.96  # standard deviations
MET = {"gust_w": "vertical gust [m/s]", "gust_u": "longitudinal gust [m/s]", "buffet": "buffet [CL of separated flow]"}
KNOWN = 0.3  # largest standard error, of the value, with which a measured response is shown
DECIBEL = 20.0 / math.log(10.0)  # of a relative change
MOST_RESPONSES = 8


def drawn(columns: Sequence[tuple[str, np.ndarray, Sequence[Panel]]], title: str) -> Figure:
    """The panels of a page for paper: a column for each manoeuvre (name, time, panels), whose time starts at zero."""
    style.refuse_many(len(columns))
    labels = list(dict.fromkeys(panel.label for _, _, panels in columns for panel in panels))
    tall = float(np.clip(8.0 / len(labels), 1.35, 2.6))
    size = (style.column_width(len(columns)) * len(columns), tall * len(labels) + 1.3)
    figure, axes = style.panels(len(labels), len(columns), size, sharex="col", sharey="row")
    reach: dict[str, list[tuple[float, float]]] = {}
    for column, (_, time, panels) in zip(axes.T, columns, strict=True):
        for panel in panels:
            draw_panel(column[labels.index(panel.label)], time - time[0], panel)
            reach.setdefault(panel.label, []).append(scale(panel.lines, panel.band))
    for ax, label in zip(axes[:, 0], labels, strict=True):
        low, high = zip(*reach[label], strict=True)  # the panels of a row share their scale
        ax.set(ylim=(min(low), max(high)), ylabel=label)
    for ax in (ax for ax in axes.ravel() if not ax.has_data()):
        ax.text(0.5, 0.5, "not recorded", transform=ax.transAxes, ha="center", va="center", color="#777777")
    style.finish(figure, axes, title, [name for name, _, _ in columns])
    return figure


def draw_panel(ax: Axes, time: np.ndarray, panel: Panel) -> None:
    kept = extremes([line.values for line in panel.lines])
    t, values = time[kept], [line.values[kept] for line in panel.lines]
    if panel.band is not None:
        ax.fill_between(t, values[0] - panel.band, values[0] + panel.band, color="#dddddd", lw=0.0, label="tolerance")
    for first, second in panel.shade:
        ax.fill_between(t, values[first], values[second], color=panel.lines[second].colour, alpha=0.3, lw=0.0)
    for line, y in zip(panel.lines, values, strict=True):
        ax.plot(t, y, color=line.colour, ls=line.style, lw=0.75 * line.width, label=line.label)
    ax.margins(x=0.01)
    ax.yaxis.set_major_locator(MaxNLocator(4, steps=[1, 2, 2.5, 5, 10]))
    ax.text(0.01, 0.95, panel.note, transform=ax.transAxes, va="top", **style.NOTE)


@style.housed
def time_history(identification: Identification) -> Figure:
    """Recorded channels: one column per manoeuvre, one row per channel, angles in degrees."""
    columns = []
    for r in identification.records:
        panels = [measured_panel(name, r[name]) for name in HISTORY if r.has(name)]
        columns.append((f"{r.name} ({r.n} samples, {1.0 / r.dt:.0f} Hz)", r.time, panels))
    return drawn(columns, f"Manoeuvres flown: {identification.card.title}")


def predicted(identification: Identification, coefficient: str) -> pd.DataFrame:
    """Predictions at the chosen split's test points (all its folds) by sample; without a GP the fit at all samples."""
    import pandas as pd  # it takes half a second to load

    o, gp = identification.observations, identification.gp
    if coefficient not in o.coefficients:
        raise style.NotDrawn(f"the model has no {coefficient}")
    if gp is None:
        column = o.coefficients.index(coefficient)
        return pd.DataFrame({"measured": np.asarray(o.measured)[:, column], "mle": identification.fitted[:, column]})
    keys, v = ("measured", "mle", "gp", "gp_low", "gp_high"), gp.pooled(gp.chosen, coefficient)
    return pd.DataFrame({key: getattr(v, key) for key in keys}, index=v.test).sort_index(kind="stable")


def what_is_shown(identification: Identification) -> str:
    gp = identification.gp
    return "fit to all samples" if gp is None else f"test points of the {gp.chosen} split"


def broken(time: np.ndarray, *columns: np.ndarray | pd.Series, gap: float = 1.0) -> tuple[np.ndarray, ...]:
    """The columns with NaN put in wherever time jumps by more than `gap` seconds, so that a line breaks there."""
    at = np.flatnonzero(np.diff(time) > gap) + 1
    return tuple(np.insert(np.asarray(c, float), at, np.nan) for c in (time, *columns))


def _over_time(identification: Identification, title: str, names: Sequence[str], *, errors: bool) -> Figure:
    """Coefficients measured and predicted, a column per manoeuvre; with the ML model and the `errors` below, or not."""
    o = identification.observations
    style.refuse_many(len(o.names))
    begin = np.array([o.time[o.manoeuvre == k][0] for k in range(len(o.names))])
    time, every = o.time - begin[o.manoeuvre], {name: predicted(identification, name) for name in names}
    size = style.column_width(len(o.names)) * len(o.names), 6.5 if errors else 2.4 * len(names) + 0.8
    shape = len(names) + errors, len(o.names), size
    figure, axes = style.panels(*shape, sharex="col", sharey="row", height_ratios=[2] * len(names) + [1] * errors)
    for row, (name, points) in zip(axes, every.items(), strict=False):
        row[0].set_ylabel(f"{name} [-]")
        z = np.asarray(o.measured)[:, o.coefficients.index(name)]
        for k, ax in enumerate(row):
            mine, shown = o.manoeuvre == k, points[o.manoeuvre[points.index] == k]
            at, dots = time[shown.index], {"ms": 2.2, "color": COLOURS["gpr"]}
            if "gp" in shown:
                t, low, high = broken(at, shown.gp_low, shown.gp_high)
                band = {"color": COLOURS["gpr"], "alpha": 0.22, "lw": 0.0, "zorder": 1}
                ax.fill_between(t, low, high, label="GPR, 95 % predictive", **band)
                ax.plot(at, shown.gp, ".", zorder=4, label="GPR", **dots)
            ax.plot(time[mine], z[mine], color=COLOURS["measured"], lw=0.6, zorder=2, label="measured")
            ax.margins(x=0.01)
            if errors:
                mle, below = {"color": COLOURS["mle"], "zorder": 3}, axes[-1, k]
                ax.plot(*broken(at, shown.mle), lw=1.2, label="maximum likelihood", **mle)
                below.axhline(0.0, color="#777777", lw=0.8)
                below.plot(*broken(at, shown.measured - shown.mle), lw=0.9, **mle)
                if "gp" in shown:
                    below.plot(at, shown.measured - shown.gp, ".", **dots)
    if errors:
        axes[-1, 0].set_ylabel(f"measured - predicted {names[0]} [-]")
    style.finish(figure, axes, f"{title}: {what_is_shown(identification)}", o.names, markerscale=4)
    return figure


@style.housed
def gpr_fit(identification: Identification) -> Figure:
    """The Gaussian process's coefficients over the measured ones, with its 95 % predictive band."""
    style.needed(identification.gp, "this run has no Gaussian process")
    names = identification.observations.coefficients
    return _over_time(identification, f"Gaussian-process regression of {', '.join(names)}", names, errors=False)


VALIDATIONS = {"CL": "fig3_validation_CL", "CD": "fig6_validation_CD", "Cm": "fig8_validation_Cm"}
VALIDATIONS |= {name: f"validation_{name}" for name in LATERAL}
FIGURES = {"fig1_time_history": time_history, "fig2_gpr_fit": gpr_fit}
for name, stem in VALIDATIONS.items():
    FIGURES[stem] = style.housed(partial(_over_time, title=f"Validation of {name}", names=(name,), errors=True))


# --- Simulated trajectories over the measured ones: of `fly`, and of `diagnose` before and after the extension.


@style.housed
def hold_out(view: View) -> Figure:
    flown = style.needed(view.trajectories, "nothing was simulated")
    units, columns = {name: STANDARD_CHANNELS[name].unit for name in flown.outputs}, []
    for name in dict.fromkeys(p.manoeuvre for p in flown.paths if p.split == "hold_out"):
        paths = {label: p for model, label in MODELS.items() if (p := flown.path(name, model, "hold_out"))}
        columns.append((name, next(iter(paths.values())).time, output_panels(paths, units)))
    style.needed(columns, "no manoeuvre is held out")
    return drawn(columns, "Simulated from the measured initial state, with parameters fitted without this flight")


def fly_figures(flown: TrajectoryFit) -> dict[str, Callable[[TrajectoryFit], Figure]]:
    """A figure for each output, by the stem of its file, and the responses in a band."""
    stems = {n: f"trajectory_{re.sub(r'[^A-Za-z0-9_-]', '_', n)}" for n in flown.outputs}
    return {stem: style.housed(partial(_simulated, n)) for n, stem in stems.items()} | {"bode": bode}


def _simulated(output: str, flown: TrajectoryFit) -> Figure:
    columns = []
    for name in flown.manoeuvres:
        paths = {label: flown.path(name, model) for model, label in FLOWN.items()}
        columns.append((name, paths["fitted model"].time, output_panels(paths, {output: flown.units[output]})))
    return drawn(columns, "Measured and simulated: with the first values, and with parameters and initial state fitted")


@style.housed
def gusts(disturbed: ProcessNoise) -> Figure:
    """Estimated gusts with their bands: a row for each manoeuvre, a column for each gust."""
    histories = style.needed(disturbed.histories, "no gust has an intensity")
    style.refuse_many(len(histories))
    names, rows = list(histories[0].gusts), len(histories)
    figure, axes = style.panels(rows, len(names), (4.2 * len(names) + 1.2, 1.9 * rows + 0.9), sharey="col")
    for row, h in zip(axes, histories, strict=True):
        for ax, name in zip(row, names, strict=True):
            mean, sd = h.gusts[name]
            ax.fill_between(h.time, mean - BAND * sd, mean + BAND * sd, color=COLOURS["after"], alpha=0.25, lw=0.0)
            ax.plot(h.time, mean, color=COLOURS["after"])
            ax.set_title(h.manoeuvre, loc="left")
            ax.set(xlabel="time [s]", ylabel=MET.get(name, f"{name} {bracket('1')}"))
            ax.axhline(0.0, color="#999999", lw=0.6)
    figure.suptitle("Estimated gusts, with 95 % bands", fontsize=10.0)
    return figure


@style.housed
def bode(flown: TrajectoryFit) -> Figure:
    """Measured and modelled frequency responses: magnitude, phase, coherence; a column for each input and output."""
    columns = len(flown.frequency_responses)
    if not 0 < columns <= MOST_RESPONSES:
        raise style.NotDrawn(f"more than {MOST_RESPONSES} responses" if columns else "no band was asked for")
    figure, axes = style.panels(3, columns, (2.6 * columns + 1.2, 5.6), sharex=True, sharey="row")
    for (magnitude, phase, coherence), r in zip(axes.T, flown.frequency_responses, strict=True):
        f, shown = r.frequency, np.where(r.error < KNOWN * np.abs(r.measured), 1.0, np.nan)
        angle, level = np.rad2deg(np.unwrap(np.angle(r.modelled))), 20.0 * np.log10(np.abs(r.modelled))
        error = shown * BAND * r.error / np.abs(r.measured)  # relative, of a measured response
        ratio, drawn_ratio = r.measured / r.modelled, r.draws / r.modelled
        for ax, middle, of, scale_of in (
            (magnitude, level, lambda x: DECIBEL * np.log(np.abs(x)), DECIBEL),
            (phase, angle, lambda x: np.angle(x, deg=True), np.rad2deg(1.0)),
        ):
            edges = np.percentile(middle + of(drawn_ratio), [2.5, 97.5], axis=0)
            ax.fill_between(f, *edges, color=COLOURS["after"], alpha=0.25, lw=0.0)
            ax.plot(f, middle, color=COLOURS["after"], label="modelled, with 95 % band")
            dots = {"color": COLOURS["measured"], "ls": "none", "marker": "o", "ms": 3.0, "elinewidth": 0.8}
            ax.errorbar(f, shown * middle + of(ratio), scale_of * error, **dots, label="measured")
        coherence.plot(f, r.coherence, color=COLOURS["measured"])
        coherence.set(ylim=(0.0, 1.05), xlabel="frequency [Hz]")
        magnitude.set_xscale("log")
        magnitude.set_title(f"{r.output} / {r.input}".replace(" and ", ",\n"), fontsize=8.5)
    for ax, label in zip(axes[:, 0], ("magnitude [dB, SI]", "phase [deg]", "coherence"), strict=True):
        ax.set_ylabel(label)
    axes[0][0].legend(loc="best", fontsize=7.0)
    return figure
