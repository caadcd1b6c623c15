"""The figures of a diagnosis: residuals, candidates, gains, parameter changes, unexplained structure."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from bayes_aero.flight.channel import STANDARD_CHANNELS
from bayes_aero.report import style
from bayes_aero.report.figures.time_histories import draw_panel, drawn
from bayes_aero.report.phrases import WORDS, bracket, channel_axis, size_text
from bayes_aero.report.plots import COLOURS, MODELS, Panel, compared_panel, output_panels

if TYPE_CHECKING:
    from bayes_aero.diagnosis.result import Fitted, Ranking, View

PROFILES = 3  # channels shown for each coefficient
COPY = 0.95  # correlation beyond which two channels tell the same
LONGEST_LAG = 10.0  # s
TIGHT = {"fc": "white", "ec": "none", "alpha": 0.85, "pad": 0.3}


def models_of(view: View) -> list[tuple[str, str, Fitted]]:
    """What is compared: label, colour, model: the card's, and the extended one where there is one."""
    models = zip(MODELS.values(), (COLOURS["before"], COLOURS["after"]), (view.card, view.extended), strict=True)
    return list(models)[: 1 + view.changed]


def coefficient_panels(view: View, number: int) -> list[Panel]:
    """A panel for each coefficient of one manoeuvre, measured and by the models."""
    mine, panels = view.manoeuvre == number, []
    for c, name in enumerate(view.coefficients):
        z = view.measured[mine, c]
        residuals = {label: fitted.residual[mine, c] for label, _, fitted in models_of(view)}
        r2 = " → ".join(f"{1.0 - np.mean(e**2) / np.var(z):.3f}" for e in residuals.values())
        panels.append(compared_panel(name, "1", z, {label: z - e for label, e in residuals.items()}, f"R² {r2}"))
    return panels


@style.housed
def measured_simulated(view: View) -> Figure:
    """Coefficients measured and simulated by both models; a column per manoeuvre."""
    columns = [(name, view.time[view.manoeuvre == k], coefficient_panels(view, k)) for k, name in enumerate(view.names)]
    return drawn(columns, "Measured and simulated coefficients, the error of the last model shaded")


def _rows_of(ax: Axes, names: Sequence[str]) -> None:
    ax.set_yticks(range(len(names)), names)
    ax.set_ylim(len(names) - 0.4, -0.6)
    ax.grid(False, axis="y")


@style.housed
def gain(view: View) -> Figure:
    """R2 and RMSE of each coefficient on data that were not fitted, along the chain of causes."""
    causes = style.needed([c for c in view.diagnosis.causes if c.gain.before], "no cause was added")
    links = [("card's model", COLOURS["before"], causes[0].gain.before)]
    for k, cause in enumerate(causes):
        if k and cause.stage != causes[k - 1].stage:
            links.append(("sensors corrected", COLOURS["candidate"], cause.gain.before))
        confirmed = cause.confirmed
        label, colour = (f"+ {cause.name}", "candidate") if confirmed else (f"(+ {cause.name})", "unconfirmed")
        links.append((label, COLOURS[colour], cause.gain.after))
    size = 4.0 * len(view.coefficients) + 1.0, 2 * (0.30 * len(links) + 1.0) + 0.8
    figure, axes = style.panels(2, len(view.coefficients), size, sharey=True)
    for row, key, label, form in zip(axes, ("r2", "rmse"), ("R²", "RMSE"), ("%.3f", "%.4f"), strict=True):
        for ax, name in zip(row, view.coefficients, strict=True):
            values = [getattr(scores[name], key) for _, _, scores in links]
            shown = np.maximum(values, -1.0)  # a bar that leaves the axes would have no number
            bars = ax.barh(range(len(links)), shown, color=[colour for _, colour, _ in links], height=0.7)
            ax.bar_label(bars, [form % value for value in values], padding=2, fontsize=7.5)
            _rows_of(ax, [label for label, _, _ in links])
            ax.set_xlim(max(-1.0, min(0.0, *values)), 1.25 * (1.0 if key == "r2" else np.nanmax(values)))
            ax.set_xlabel(f"{label} of {name} [-]")
    brackets = "; in brackets: not confirmed, and not in what follows" if any(not c.confirmed for c in causes) else ""
    figure.suptitle(f"On hold-out data ({WORDS['splits'][view.diagnosis.split]}), cause after cause{brackets}")
    return figure


@style.housed
def residual_profiles(view: View) -> Figure:
    """Mean residual over the channels on which the card's model leaves the clearest trace, before and after."""
    names = view.coefficients
    figure, axes = style.panels(len(names), PROFILES, (13.0, 2.6 * len(names) + 0.4), sharey="row")
    for row, (c, name) in zip(axes, enumerate(names), strict=True):
        channels: list[str] = []  # on which the card's model leaves the clearest trace, none a near copy of another
        for p in view.card.profiles[c]:
            pairs = [(view.channels[p.channel], view.channels[name]) for name in channels]
            if len(channels) < PROFILES and not any(abs(np.corrcoef(*pair)[0, 1]) > COPY for pair in pairs):
                channels.append(p.channel)
        for ax, channel in zip(row, channels, strict=False):
            shown, unit, factor = channel_axis(channel)
            ax.axhline(0.0, color="#777777", lw=0.8, zorder=0)
            ax.set_xlabel(f"{shown} {bracket(unit)}")
            for label, colour, fitted in models_of(view):
                p = next(p for p in fitted.profiles[c] if p.channel == channel)
                look = {"fmt": "o-", "ms": 3.0, "lw": 1.0, "capsize": 2.0, "color": colour}
                ax.errorbar(factor * p.centre, p.mean, yerr=p.deviation, label=label, **look)
        for ax in row[len(channels) :]:
            ax.remove()
        row[0].set_ylabel(f"mean residual of {name} [-]")
    title = "Residuals over the channels with the clearest dependence (bins of equal count, ± one standard error)"
    figure.suptitle(title)
    style.legend_below(figure, axes[0, 0])
    return figure


@style.housed
def residual_colour(view: View) -> Figure:
    names, dt = view.coefficients, view.seconds
    figure, axes = style.panels(1, len(names), (4.0 * len(names) + 1.0, 3.6))
    for c, (name, ax) in enumerate(zip(names, axes[0], strict=True)):
        for label, colour, fitted in models_of(view):
            parts = [fitted.residual[view.manoeuvre == k, c] for k in range(len(view.names))]
            lags, correlation = autocorrelation(parts, round(LONGEST_LAG / dt))
            ax.plot(dt * lags, correlation, color=colour, label=label)
        ax.axhline(0.0, color="#777777", lw=0.8, zorder=0)
        ax.set(title=name, xlabel="lag [s]")
    axes[0, 0].set_ylabel("autocorrelation of the residual [-]")
    style.legend_below(figure, axes[0, 0])
    return figure


def autocorrelation(parts: list[Float[np.ndarray, " _"]], longest: int) -> tuple[np.ndarray, np.ndarray]:
    """Lags and correlation, sums over manoeuvres, each about its own mean."""
    centred = [p - p.mean() for p in parts]
    lags = np.arange(min(longest, min(len(p) for p in parts) - 1) + 1)
    products = [sum(float(p[lag:] @ p[: len(p) - lag]) for p in centred) for lag in lags]
    return lags, np.array(products) / max(products[0], 1e-300)


@style.housed
def found(view: View) -> Figure:
    """The quantity with the largest gain, its error by each model shaded, and the deciding screening."""
    panel, manoeuvre, time = telling(view)
    causes, rankings = view.diagnosis.causes, {r.stage: r for r in view.rankings}
    last = view.rankings[-1] if view.rankings else None
    ranking = rankings.get(causes[0].stage) if causes else last  # that which named the first cause
    rows = "ab"[: len(panel.lines) - 1]
    places: list[Any] = [[row, "R"] if ranking else [row] for row in rows]
    figure = Figure(figsize=(11.0, 1.9 * len(rows) + 1.0), layout="constrained")
    axes = figure.subplot_mosaic(places, width_ratios=[1.7, 1.0] if ranking else [1.7])
    first, *others = panel.note.split(" → ")
    what, _, number = first.rpartition(" ")
    for row, line, size in zip(rows, panel.lines[1:], (number, *others), strict=True):
        note = f"{line.label}: {what} {size}"
        draw_panel(axes[row], time, Panel(panel.name, panel.unit, (panel.lines[0], line), ((0, 1),), note=note))
        axes[row].margins(y=0.2)
        axes[row].set_ylabel(panel.label)
    axes[rows[0]].set_title("Measured (black) and simulated, the error shaded")
    axes[rows[-1]].set_xlabel(f"time from start of {manoeuvre} [s]")
    if ranking is not None:
        _candidates(axes["R"], ranking, view)
    return figure


def telling(view: View) -> tuple[Panel, str, np.ndarray]:
    """The coefficient whose R² gains the most, or the output whose error falls most for an error of a sensor.

    An error of a sensor may not show in coefficients. With the name of the manoeuvre, and its time from zero.
    """
    causes, flown = view.diagnosis.causes, view.trajectories
    if causes and causes[0].stage == "flight path" and flown is not None:
        falls = {}
        for name in dict.fromkeys(p.manoeuvre for p in flown.paths if p.split == "fitted"):
            paths = {label: flown.path(name, model, "fitted") for model, label in MODELS.items()}
            card, extended = paths.values()
            if card and extended and card.inside and extended.inside:
                for output in flown.outputs:
                    fall = card.errors[output].rms / max(extended.errors[output].rms, 1e-300)
                    falls[output, name] = (fall, paths, card.time - card.time[0])
        if falls:
            output, name = max(falls, key=lambda key: falls[key][0])
            _, paths, time = falls[output, name]
            return output_panels(paths, {output: STANDARD_CHANNELS[output].unit})[0], name, time
    gains = {}
    for k in range(len(view.names)):
        mine = view.manoeuvre == k
        spread = np.var(view.measured[mine], axis=0)
        card, extended = (np.mean(m.residual[mine] ** 2, axis=0) / spread for m in (view.card, view.extended))
        gains |= {(k, c): x for c, x in enumerate(card - extended if view.changed else card)}
    k, c = max(gains, key=lambda key: gains[key])
    return coefficient_panels(view, k)[c], view.names[k], view.time[view.manoeuvre == k]


def _candidates(ax: Axes, ranking: Ranking, view: View) -> None:
    """Candidates in the order in which they are considered; named causes in colour, with their size in the end."""
    named = {c.name: c for c in view.diagnosis.causes}
    leaders = sorted(ranking.leaders, key=lambda s: -s.explains)
    widest = max(100.0 * leaders[0].explains if leaders else 0.0, 1e-9)
    for y, s in enumerate(leaders):
        chance = np.isfinite(ranking.threshold) and s.score < ranking.threshold
        colour, text = COLOURS["chosen" if s.effect in named else "candidate"], f"score {s.score:.1f}"
        ax.barh(y, 100.0 * s.explains, height=0.75, color=colour, alpha=0.45 if chance else 1.0)
        if s.effect in named:
            sizes = {n: size_text(x.mean, x.sd, x.unit) for n, x in named[s.effect].parameters.items()}
            text = "\n".join(f"{n} = {size}" if len(sizes) > 1 else size for n, size in sizes.items())
        size = 6.0 if "\n" in text else 7.5
        ax.text(1.02 * widest, y, text, ha="right", va="center", fontsize=size, bbox=TIGHT, zorder=5)
    _rows_of(ax, [s.effect for s in leaders])
    ax.set_xlim(0.0, 1.03 * widest)
    about = f"pale: scores below {ranking.threshold:.1f} are chance" if np.isfinite(ranking.threshold) else ""
    ax.set_xlabel(f"share of the remaining variance explained [%]\n{about}")
    ax.set_title(f"First screening, {ranking.stage}")


drawings = measured_simulated, gain, residual_profiles, residual_colour, found
DIAGNOSIS_FIGURES = {draw.__name__: draw for draw in drawings}
