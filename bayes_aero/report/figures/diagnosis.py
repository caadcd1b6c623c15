"""The figures of a diagnosis: residuals, candidates, gains, parameter changes, unexplained structure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from scipy.signal import welch

from bayes_aero.diagnosis.result import FLIGHT_PATH
from bayes_aero.flight.channel import STANDARD_CHANNELS
from bayes_aero.inference.results import Scores, score
from bayes_aero.report import style
from bayes_aero.report.colours import COLOURS
from bayes_aero.report.figures.time_histories import drawn
from bayes_aero.report.html.plots import Line, Panel
from bayes_aero.report.phrases import WORDS, bracket, channel_axis, for_people, short, size_text

if TYPE_CHECKING:
    from bayes_aero.diagnosis.result import Fitted, Ranking, Trajectories, View

PROFILES = 3  # channels shown for each coefficient
COPY = 0.95  # correlation beyond which two channels tell the same
LONGEST_LAG = 10.0  # s
LABELS = {"before": "card's model", "after": "extended model"}
TIGHT = {"fc": "white", "ec": "none", "alpha": 0.85, "pad": 0.3}


def models_of(view: View) -> list[tuple[str, str, Fitted]]:
    """What is compared: label, colour, model: the card's, and the extended one where there is one."""
    found = [
        (LABELS[when], COLOURS[when], fitted) for when, fitted in (("before", view.card), ("after", view.extended))
    ]
    return found if view.changed else found[:1]


def coefficient_panels(view: View, number: int) -> list[Panel]:
    """A panel for each coefficient of one manoeuvre, measured and by the models; the last model's error shaded."""
    mine, models, panels = view.manoeuvre == number, models_of(view), []
    for c, name in enumerate(view.coefficients):
        z = view.measured[mine, c]
        curves = [z - fitted.residual[mine, c] for _, _, fitted in models]
        found = [score(z, x) for x in curves]
        lines = [Line("measured", COLOURS["measured"], z, width=1.0)]
        for (label, colour, fitted), x in zip(models, curves, strict=True):
            lines.append(Line(label, colour, x, "dashed" if fitted is view.card else "solid"))
        r2, rmse = " → ".join(f"{s.r2:.3f}" for s in found), " → ".join(f"{s.rmse:.2g}" for s in found)
        panels.append(Panel(name, "1", tuple(lines), ((0, len(models)),), note=f"R² {r2}, RMSE {rmse}"))
    return panels


@style.housed
def measured_simulated(view: View) -> Figure:
    """Coefficients measured and simulated by both models; a column per manoeuvre."""
    columns = [(name, view.time[view.manoeuvre == k], coefficient_panels(view, k)) for k, name in enumerate(view.names)]
    return drawn(columns, "Measured and simulated coefficients, the error of the last model shaded")


@style.housed
def ranking(view: View) -> Figure:
    """Score of every candidate in the first screening of each stage, and the level of selection."""
    if not view.rankings:
        raise style.NotDrawn("no screening was done")
    rows = [len(r.candidate_scores) + 1.0 for r in view.rankings]
    figure, axes = style.panels(len(rows), 1, (8.5, 0.2 * sum(rows) + 0.9 * len(rows) + 0.6), height_ratios=rows)
    for ax, one in zip(axes[:, 0], view.rankings, strict=True):
        causes = {c.name for c in view.diagnosis.causes if c.stage == one.stage}
        scores = [s.score for s in one.candidate_scores]
        colours = [COLOURS["chosen" if s.effect in causes else "candidate"] for s in one.candidate_scores]
        widest = max(*scores, one.threshold) if np.isfinite(one.threshold) else max(*scores, 1e-9)
        ax.barh(range(len(scores)), scores, color=colours, height=0.75)
        for y, x in enumerate(scores):
            crossed = TIGHT if -0.06 * widest < x - one.threshold <= 0.0 else None  # by the line of the level
            ax.text(x + 0.01 * widest, y, f"{x:.1f}", va="center", fontsize=7.0, bbox=crossed, zorder=5)
        if np.isfinite(one.threshold):
            ax.axvline(one.threshold, color=COLOURS["measured"], ls="--", lw=1.0)
            label = f"noise alone exceeds\n{one.threshold:.1f} in {100.0 * one.level:g} % of replicates"
            ax.text(0.99, 0.02, label, transform=ax.transAxes, va="bottom", ha="right", **style.NOTE)
        _rows_of(ax, [s.effect for s in one.candidate_scores])
        ax.set_xlim(0.0, 1.1 * widest)
        ax.set_xlabel("estimate over its standard error, autocorrelation included [-]")
        ax.set_title(f"Stage: {one.stage}")
    figure.suptitle("Candidates before any addition\n(named causes in colour; later screenings may reorder them)")
    return figure


def _rows_of(ax: Axes, names: Sequence[str]) -> None:
    """Names of horizontal bars, the first at the top."""
    ax.set_yticks(range(len(names)), names)
    ax.set_ylim(len(names) - 0.4, -0.6)
    ax.grid(False, axis="y")


@style.housed
def gain(view: View) -> Figure:
    """R2 and RMSE of each coefficient on data that were not fitted, along the chain of causes."""
    causes = [c for c in view.diagnosis.causes if c.gain.before]
    if not causes:
        raise style.NotDrawn("no cause was added")
    links: list[tuple[str, dict[str, Scores]]] = [("card's model", dict(causes[0].gain.before))]
    colours, stage = [COLOURS["before"]], causes[0].stage
    for cause in causes:
        if cause.stage != stage:
            links.append(("sensors corrected", dict(cause.gain.before)))
            colours.append(COLOURS["candidate"])
            stage = cause.stage
        links.append((f"+ {cause.name}" if cause.confirmed else f"(+ {cause.name})", dict(cause.gain.after)))
        colours.append(COLOURS["candidate"] if cause.confirmed else COLOURS["unconfirmed"])
    last = max((k for k, colour in enumerate(colours) if k and colour == COLOURS["candidate"]), default=0)
    colours[last] = COLOURS["after"] if last else colours[0]
    place, names = np.arange(len(links)), view.coefficients
    size = 4.0 * len(names) + 1.0, 2 * (0.30 * len(links) + 1.0) + 0.8
    figure, axes = style.panels(2, len(names), size, sharey=True)
    for row, (key, label) in zip(axes, (("r2", "R²"), ("rmse", "RMSE")), strict=True):
        for ax, name in zip(row, names, strict=True):
            values = np.array([getattr(scores[name], key) for _, scores in links])
            shown = np.maximum(values, -1.0) if key == "r2" else values
            ax.barh(place, shown, color=colours, height=0.7)
            for y, x, value in zip(place, shown, values, strict=True):
                ax.text(max(x, 0.0), y, f" {value:.3f}" if key == "r2" else f" {value:.4f}", va="center", fontsize=7.5)
            _rows_of(ax, [text for text, _ in links])
            ax.set_ylim(len(links) - 0.5, -0.5)
            finite = shown[np.isfinite(shown)]
            left = min(0.0, float(finite.min())) if key == "r2" else 0.0
            ax.set_xlim(left, 1.22 if key == "r2" else 1.25 * float(finite.max()))
            ticks = MaxNLocator(5).tick_values(*ax.get_xlim())
            ax.set_xticks([x for x in ticks if left <= x and (key == "rmse" or x <= 1.0)])
            ax.set_xlabel(f"{label} of {name} [-]")
    brackets = "; in brackets: not confirmed, and not in what follows" if any(not c.confirmed for c in causes) else ""
    figure.suptitle(f"On hold-out data ({WORDS['splits'][view.diagnosis.split]}), cause after cause{brackets}")
    return figure


@style.housed
def moves(view: View) -> Figure:
    """Change of the card's parameters, in their standard error after the causes are added."""
    if not view.changed or not view.moves:
        raise style.NotDrawn("nothing was added, so nothing moved")
    names = list(view.moves)
    place = np.arange(len(names))
    figure, axes = style.panels(1, 1, (9.5, 0.32 * len(names) + 1.6))
    ax = axes[0, 0]
    for shift, when in ((-0.14, "before"), (0.14, "after")):
        centre, sd = [], []
        for move in view.moves.values():
            size = max(move.sd_after, 1e-300)
            centre.append((getattr(move, when) - move.before) / size)
            sd.append(getattr(move, f"sd_{when}") / size)
        look = {"fmt": "o", "ms": 4.0, "lw": 1.2, "capsize": 2.0, "color": COLOURS[when]}
        ax.errorbar(centre, place + shift, xerr=sd, label=LABELS[when], **look)
    for y, move in zip(place, view.moves.values(), strict=True):
        unit, factor = for_people(move.unit)
        sizes = (move.before, move.sd_before), (move.after, move.sd_after)
        before, after = (size_text(factor * x, factor * sd, "1") for x, sd in sizes)
        text = f"{before}  →  {after} {'' if unit == '1' else bracket(unit)}"
        ax.text(1.01, y, text, transform=ax.get_yaxis_transform(), va="center", fontsize=8.0)
    ax.axvline(0.0, color="#777777", lw=0.8, zorder=0)
    ax.set_yticks(place, names)
    ax.set_ylim(len(names) - 0.5, -0.5)
    ax.set_xlabel("distance from the card's estimate, in standard errors after [-]")
    ax.legend(loc="upper center", bbox_to_anchor=(0.5, -0.55 / (0.32 * len(names) + 1.0)), ncols=2)
    figure.suptitle("Change of the card's parameters (bars: one standard error, autocorrelation included)")
    return figure


def channel_label(name: str) -> tuple[str, float]:
    """Label with unit for an axis, and the factor from SI."""
    plain = {
        "X": ("separation point X [-]", 1.0),
        "elapsed": ("time from start of record [s]", 1.0),
        "alpha_dot": ("α̇ [deg/s]", 180.0 / np.pi),
        "mach": ("Mach [-]", 1.0),
    }
    if name in plain:
        return plain[name]
    shown, unit, factor = channel_axis(name)
    return f"{shown.replace('_', ' ')} {bracket(unit)}", factor


@style.housed
def residual_profiles(view: View) -> Figure:
    """Mean residual over the channels on which the card's model leaves the clearest trace, before and after."""
    names = view.coefficients
    figure, axes = style.panels(len(names), PROFILES, (13.0, 2.6 * len(names) + 0.4), sharey="row")
    for row, (c, name) in zip(axes, enumerate(names), strict=True):
        channels: list[str] = []  # on which the card's model leaves the clearest trace, none a near copy of another
        for p in view.card.profiles[c]:
            pairs = [(view.channels[p.channel], view.channels[name]) for name in channels]
            if not any(abs(np.corrcoef(*pair)[0, 1]) > COPY for pair in pairs):
                channels.append(p.channel)
        channels = channels[:PROFILES]
        for label, colour, fitted in models_of(view):
            found = {p.channel: p for p in fitted.profiles[c]}
            for ax, channel in zip(row, channels, strict=False):
                text, factor = channel_label(channel)
                p, look = found[channel], {"fmt": "o-", "ms": 3.0, "lw": 1.0, "capsize": 2.0, "color": colour}
                ax.errorbar(factor * p.centre, p.mean, yerr=p.deviation, label=label, **look)
                ax.set_xlabel(text)
        for ax in row[: len(channels)]:
            ax.axhline(0.0, color="#777777", lw=0.8, zorder=0)
        for ax in row[len(channels) :]:
            ax.remove()
        row[0].set_ylabel(f"mean residual of {name} [-]")
    title = "Residuals over the channels with the clearest dependence (bins of equal count, ± one standard error)"
    figure.suptitle(title)
    style.legend_below(figure, axes[0, 0])
    return figure


@style.housed
def residual_colour(view: View) -> Figure:
    """Autocorrelation and spectrum of the residuals, before and after."""
    figure, axes = style.panels(2, len(view.coefficients), (4.0 * len(view.coefficients) + 1.0, 6.4), sharex="row")
    dt = view.seconds
    for label, colour, fitted in models_of(view):
        for c, name in enumerate(view.coefficients):
            parts = [fitted.residual[view.manoeuvre == k, c] for k in range(len(view.names))]
            lags, correlation = autocorrelation(parts, round(LONGEST_LAG / dt))
            axes[0, c].plot(dt * lags, correlation, color=colour, label=label)
            frequency, density = spectrum(parts, dt)
            axes[1, c].loglog(frequency[1:], density[1:], color=colour)
            axes[0, c].set_title(name)
    for ax in axes[0]:
        ax.axhline(0.0, color="#777777", lw=0.8, zorder=0)
        ax.set_xlabel("lag [s]")
    for ax in axes[1]:
        ax.set_xlabel("frequency [Hz]")
    axes[0, 0].set_ylabel("autocorrelation of the residual [-]")
    axes[1, 0].set_ylabel("power spectral density [1/Hz]")
    figure.suptitle("Autocorrelation of the residuals")
    style.legend_below(figure, axes[0, 0])
    return figure


def autocorrelation(parts: list[Float[np.ndarray, " _"]], longest: int) -> tuple[np.ndarray, np.ndarray]:
    """Lags and correlation, sums over manoeuvres, each about its own mean."""
    centred = [p - p.mean() for p in parts]
    lags = np.arange(min(longest, min(len(p) for p in parts) - 1) + 1)
    products = [sum(float(p[lag:] @ p[: len(p) - lag]) for p in centred) for lag in lags]
    return lags, np.array(products) / max(products[0], 1e-300)


def spectrum(parts: list[Float[np.ndarray, " _"]], dt: float) -> tuple[np.ndarray, np.ndarray]:
    """Welch's power spectral density, averaged over manoeuvres by their length."""
    segment = min(*(len(p) for p in parts), round(25.0 / dt))
    found = [welch(p, 1.0 / dt, nperseg=segment) for p in parts]
    return found[0][0], np.average([f[1] for f in found], axis=0, weights=[len(p) for p in parts])


# --- A diagnosis in one figure: the largest error of the card's model, the screening, the error of the extended
# model.

WIDTH = 0.021  # of a letter, in widths of the widest bar


@dataclass(frozen=True)
class Telling:
    """The quantity with the largest gain in one manoeuvre: measured, and by each model with a note of its error."""

    quantity: str
    label: str
    manoeuvre: str
    time: np.ndarray
    measured: np.ndarray
    simulated: Sequence[tuple[str, str, np.ndarray, str]]  # model, colour, values, note


@style.housed
def found(view: View) -> Figure:
    """The quantity with the largest gain, its error by each model shaded, and the deciding screening."""
    shown, causes = telling(view), view.diagnosis.causes
    ranking = view.rankings[-1] if view.rankings else None  # the last stage's, or of that which named the first cause
    if causes:
        ranking = {r.stage: r for r in view.rankings}.get(causes[0].stage)
    rows = "ab"[: len(shown.simulated)]
    options: dict[str, Any] = {"width_ratios": [1.7] if ranking is None else [1.7, 1.0]}
    size, below = (11.0, 1.9 * len(rows) + 1.0), [] if ranking is None else ["R"]
    places: list[Any] = [[row, *below] for row in rows]
    figure = Figure(figsize=size, layout=style.MeasuredOnce())
    axes = figure.subplot_mosaic(places, **options)
    for row, (label, colour, simulated, note) in zip(rows, shown.simulated, strict=True):
        ax = axes[row]
        ax.fill_between(shown.time, shown.measured, simulated, color=colour, alpha=0.35, lw=0.0)
        ax.plot(shown.time, shown.measured, color=COLOURS["measured"], lw=0.6)
        ax.plot(shown.time, simulated, color=colour, lw=1.0)
        ax.margins(x=0.01, y=0.2)
        ax.text(0.01, 0.97, f"{label}: {note}", transform=ax.transAxes, va="top", **style.NOTE)
        ax.set_ylabel(shown.label)
    axes[rows[0]].set_title("Measured (black) and simulated, the error shaded")
    axes[rows[-1]].set_xlabel(f"time from start of {shown.manoeuvre} [s]")
    if ranking is not None:
        _candidates(axes["R"], ranking, view)
    return figure


def telling(view: View) -> Telling:
    """The coefficient (the output, for an error of a sensor, which coefficients may not show) that gains the most."""
    causes = view.diagnosis.causes
    if causes and causes[0].stage == FLIGHT_PATH and view.trajectories is not None:
        output = _output(view.trajectories)
        if output is not None:
            return output
    best = (-np.inf, 0, 0)
    for number in range(len(view.names)):
        mine = view.manoeuvre == number
        for c in range(len(view.coefficients)):
            z = view.measured[mine, c]
            before, after = (score(z, z - m.residual[mine, c]).r2 for m in (view.card, view.extended))
            best = max(best, (after - before if view.changed else -before, c, number))
    _, c, number = best
    mine = view.manoeuvre == number
    z = view.measured[mine, c]
    curves = [(label, colour, z - fitted.residual[mine, c]) for label, colour, fitted in models_of(view)]
    simulated = [(label, colour, x, f"R² = {score(z, x).r2:.3f}") for label, colour, x in curves]
    name = view.coefficients[c]
    return Telling(name, f"{name} [-]", view.names[number], view.time[mine], z, simulated)


def _output(flown: Trajectories) -> Telling | None:
    """The output and the manoeuvre whose error falls most, fitted to all flights; None where a flight is lost."""
    best = None
    for name in dict.fromkeys(p.manoeuvre for p in flown.paths if p.split == "fitted"):
        card, extended = (flown.path(name, model, "fitted") for model in ("card", "extended"))
        if card is None or extended is None or not (card.inside and extended.inside):
            continue
        for output in flown.outputs:
            fall = card.errors[output].rms / max(extended.errors[output].rms, 1e-300)
            if best is None or fall > best[0]:
                best = (fall, output, card, extended)
    if best is None:
        return None
    _, output, card, extended = best
    unit, factor = for_people(STANDARD_CHANNELS[output].unit)
    simulated = []
    for when, path in (("before", card), ("after", extended)):
        note = f"RMS error {short(factor * path.errors[output].rms)} {unit}"
        simulated.append((LABELS[when], COLOURS[when], factor * path.simulated[output], note))
    z, label = factor * card.measured[output], f"{output.replace('_', ' ')} [{unit}]"
    return Telling(output, label, card.manoeuvre, card.time - card.time[0], z, simulated)


def _candidates(ax: Axes, ranking: Ranking, view: View) -> None:
    """Candidates in the order in which they are considered; named causes in colour, with their size in the end."""
    named = {c.name: c for c in view.diagnosis.causes}
    leaders = sorted(ranking.leaders, key=lambda s: -s.explains)
    share = 100.0 * np.array([s.explains for s in leaders])
    widest = float(np.max([*share, 1e-9]))
    for y, (s, x) in enumerate(zip(leaders, share, strict=True)):
        chance = np.isfinite(ranking.threshold) and s.score < ranking.threshold
        colour = COLOURS["chosen" if s.effect in named else "candidate"]
        ax.barh(y, x, height=0.75, color=colour, alpha=0.45 if chance else 1.0)
        text = f"score {s.score:.1f}"
        if s.effect in named:  # with names where there are several, each on its own line where one would be too wide
            sizes = {n: size_text(x.mean, x.sd, x.unit) for n, x in named[s.effect].parameters.items()}
            listed = [f"{n} = {size}" for n, size in sizes.items()] if len(sizes) > 1 else list(sizes.values())
            line = ", ".join(listed)
            text = line if WIDTH * len(line) < 1.0 or len(listed) < 2 else "\n".join(listed)
        wide = WIDTH * max(map(len, text.split("\n"))) * widest
        if wide < x:
            ink = "white" if s.effect in named and not chance else "black"
            look = {"x": x - 0.01 * widest, "ha": "right", "color": ink}
        elif x + wide < widest:
            look = {"x": x + 0.01 * widest, "ha": "left", "color": "black", "bbox": TIGHT}
        else:  # room neither in the bar nor beside it
            look = {"x": 1.02 * widest, "ha": "right", "color": "black", "bbox": TIGHT}
        ax.text(y=y, s=text, va="center", fontsize=6.0 if "\n" in text else 7.5, zorder=5, **look)
    below = ["share of the remaining variance explained [%]"]
    if any(s.score < ranking.threshold for s in leaders):
        level = f"{100.0 * ranking.level:g} %"
        below += [f"pale: score below {ranking.threshold:.1f}, which noise", f"alone exceeds in {level} of replicates"]
    if np.isfinite(ranking.threshold) and (left := len(ranking.candidate_scores) - len(leaders)) > 0:
        below.append(f"{left} more with lower scores: see screen.csv")
    _rows_of(ax, [s.effect for s in leaders])
    ax.set_xlim(0.0, 1.03 * widest)
    ax.set_xlabel("\n".join(below))
    ax.set_title(f"First screening, {ranking.stage}")


drawings = measured_simulated, ranking, gain, moves, residual_profiles, residual_colour, found
DIAGNOSIS_FIGURES = {draw.__name__: draw for draw in drawings}
