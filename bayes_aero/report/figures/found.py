"""A diagnosis in one figure: the largest error of the card's model, the screening, the error of the extended model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from bayes_aero.diagnosis.result import FLIGHT_PATH, Cause
from bayes_aero.diagnosis.trajectories.results import Trajectories
from bayes_aero.diagnosis.view.results import Ranking, View
from bayes_aero.flight.channel import STANDARD_CHANNELS
from bayes_aero.inference.scores import score
from bayes_aero.report.colours import COLOURS
from bayes_aero.report.figures.diagnosis import NOTE, TIGHT, models_of
from bayes_aero.report.style import PHONE, housed
from bayes_aero.report.text.phrases import for_people, short, size_text

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


@housed
def found(view: View) -> Figure:
    """The quantity with the largest gain, by each model with its error shaded, and the deciding screening."""
    shown, ranking = telling(view), _decisive(view)
    rows = "ab"[: len(shown.simulated)]
    figure = Figure(figsize=(11.0, 1.9 * len(rows) + 1.0), layout="constrained")
    beside = "" if ranking is None else "R"
    axes = figure.subplot_mosaic(";".join(row + beside for row in rows), width_ratios=[1.7, 1.0][: 1 + len(beside)])
    _fill(axes, shown, ranking, view)
    return figure


@housed
def found_narrow(view: View) -> Figure:
    """The same for a phone: one panel below the other."""
    shown, ranking = telling(view), _decisive(view)
    rows = "ab"[: len(shown.simulated)]
    heights = [1.7] * len(rows) + ([] if ranking is None else [3.2])
    figure = Figure(figsize=(PHONE, sum(heights) + 0.9), layout="constrained")
    below = [] if ranking is None else ["R"]
    axes = figure.subplot_mosaic([[key] for key in (*rows, *below)], height_ratios=heights)
    _fill(axes, shown, ranking, view)
    return figure


def _fill(axes: Mapping[str, Axes], shown: Telling, ranking: Ranking | None, view: View) -> None:
    """Time histories a and b, the screening R."""
    rows = "ab"[: len(shown.simulated)]
    z, t = shown.measured, shown.time
    for row, (label, colour, simulated, note) in zip(rows, shown.simulated, strict=True):
        ax = axes[row]
        ax.fill_between(t, z, simulated, color=colour, alpha=0.35, lw=0.0)
        ax.plot(t, z, color=COLOURS["measured"], lw=0.6)
        ax.plot(t, simulated, color=colour, lw=1.0)
        ax.margins(x=0.01, y=0.2)
        ax.text(0.01, 0.97, f"{label}: {note}", transform=ax.transAxes, va="top", **NOTE)
        ax.set_ylabel(shown.label)
    axes[rows[0]].set_title("Measured (black) and simulated, the error shaded")
    axes[rows[-1]].set_xlabel(f"time from start of {shown.manoeuvre} [s]")
    if ranking is not None:
        _election(axes["R"], ranking, view)


def telling(view: View) -> Telling:
    """The coefficient whose share of explained variance the extension raises most; where the first cause is an error of
    a sensor, which coefficients may not show, the simulated output whose error falls most."""
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
    simulated = [
        (
            label,
            COLOURS[role],
            factor * path.simulated[output],
            f"RMS error {short(factor * path.errors[output].rms)} {unit}",
        )
        for label, role, path in (("card's model", "before", card), ("extended model", "after", extended))
    ]
    z = factor * card.measured[output]
    label = f"{output.replace('_', ' ')} [{unit}]"
    return Telling(output, label, card.manoeuvre, card.time - card.time[0], z, simulated)


def _decisive(view: View) -> Ranking | None:
    """The first screening of the stage that named the first cause; without a cause, of the last stage."""
    stages = {r.stage: r for r in view.rankings}
    if view.diagnosis.causes:
        return stages.get(view.diagnosis.causes[0].stage)
    return view.rankings[-1] if view.rankings else None


def _election(ax: Axes, ranking: Ranking, view: View) -> None:
    """Candidates in the order in which they are considered; named causes in colour, with their size in the end."""
    named = {c.name: c for c in view.diagnosis.causes}
    leaders = sorted(ranking.leaders, key=lambda s: -s.explains)
    share = 100.0 * np.array([s.explains for s in leaders])
    widest = float(np.max([*share, 1e-9]))
    for y, (s, x) in enumerate(zip(leaders, share, strict=True)):
        chance = np.isfinite(ranking.threshold) and s.score < ranking.threshold
        colour = COLOURS["chosen" if s.effect in named else "candidate"]
        ax.barh(y, x, height=0.75, color=colour, alpha=0.45 if chance else 1.0)
        text = _sizes(named[s.effect]) if s.effect in named else f"score {s.score:.1f}"
        wide = WIDTH * max(map(len, text.split("\n"))) * widest
        if wide < x:
            ink = "white" if s.effect in named and not chance else "black"
            style = {"x": x - 0.01 * widest, "ha": "right", "color": ink}
        elif x + wide < widest:
            style = {"x": x + 0.01 * widest, "ha": "left", "color": "black", "bbox": TIGHT}
        else:  # room neither in the bar nor beside it
            style = {"x": 1.02 * widest, "ha": "right", "color": "black", "bbox": TIGHT}
        ax.text(y=y, s=text, va="center", fontsize=6.0 if "\n" in text else 7.5, zorder=5, **style)
    if np.isfinite(ranking.threshold):
        text = f"pale: score below {ranking.threshold:.1f}, which noise\n"
        text += f"alone exceeds in {100.0 * ranking.level:g} % of replicates"
        if (left := len(ranking.candidate_scores) - len(leaders)) > 0:
            text += f"\n{left} more with lower scores: see screen.csv"
        ax.text(0.99, 0.02, text, transform=ax.transAxes, va="bottom", ha="right", **NOTE)
    ax.set_yticks(range(len(leaders)), [s.effect for s in leaders])
    ax.set_ylim(len(leaders) - 0.4, -0.6)
    ax.set_xlim(0.0, 1.03 * widest)
    ax.grid(False, axis="y")
    ax.set_xlabel("share of the remaining variance explained [%]")
    ax.set_title(f"First screening, {ranking.stage}")


def _sizes(cause: Cause) -> str:
    """Sizes; named where there are several, each on its own line where one line would be wider than the panel."""
    sizes = {name: size_text(x.mean, x.sd, x.unit) for name, x in cause.parameters.items()}
    if len(sizes) < 2:
        return "".join(sizes.values())
    listed = [f"{name} = {x}" for name, x in sizes.items()]
    line = ", ".join(listed)
    return line if WIDTH * len(line) < 1.0 else "\n".join(listed)


DIAGNOSIS_FIGURES = {"found": found, "found_narrow": found_narrow}
AFTER_TRAJECTORIES = ("found", "found_narrow")
