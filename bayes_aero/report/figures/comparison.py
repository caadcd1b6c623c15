"""Bounds and credible intervals: forest plot, and every standard error as a multiple of the Cramer-Rao bound."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, MaxNLocator, NullFormatter

from bayes_aero.inference.results import Identification
from bayes_aero.report.colours import COLOURS
from bayes_aero.report.style import MOST_MANOEUVRES, NotDrawn, grid_of, housed, panels
from bayes_aero.report.tables.comparison import alone, bounds, methods, ordered, scatter, unit_of
from bayes_aero.report.tables.table import NORMAL95, Estimate
from bayes_aero.report.text.phrases import bracket, plus_minus

GREY = "#555555"  # of what has no colour of its own
MARKERS = {"crb": "|", "crb_corrected": "s", "white": "D", "emcee": "o", "nuts": "^", "scatter": "*"}


@dataclass(frozen=True)
class ForestLine:
    """One line of a forest panel: an estimate; `inner` is half of a narrower interval, drawn thick."""

    label: str
    colour: str
    estimate: Estimate
    inner: float | None = None


@housed
def forest(identification: Identification) -> Figure:
    """Every parameter by every method, with 95 % intervals and numbers; one panel per parameter, in its own unit."""
    table = {}
    for name in ordered(identification.mle.names, identification.mle.parameters):
        found = [(m, m.estimates[name]) for m in methods(identification) if name in m.estimates]
        table[name] = [ForestLine(m.label, COLOURS.get(m.key, GREY), e) for m, e in found if np.isfinite(e.sd)]
        for manoeuvre, (x, crb, corrected) in alone(identification, name).items():
            estimate, label = Estimate.normal(x, corrected), f"{manoeuvre} alone, ML"
            table[name].append(ForestLine(label, COLOURS["alone"], estimate, NORMAL95 * crb))
    return _forest(
        identification,
        table,
        "Estimates with 95 % intervals, and estimate ± standard deviation\n"
        "one manoeuvre alone: thick Cramér-Rao, thin corrected bound (the number's ±)",
    )


@housed
def next_flight(identification: Identification) -> Figure:
    """Joint fit, manoeuvres alone and pooled, aircraft and next flight, with 95 % intervals; a panel a parameter."""
    found, mle = identification.next_flight, identification.mle
    if found is None:
        raise NotDrawn("the manoeuvres were not pooled; ask for the next flight")
    if len(found.manoeuvres) > MOST_MANOEUVRES:
        raise NotDrawn(f"there are more than {MOST_MANOEUVRES} manoeuvres")
    table, bound = {}, bounds(mle, mle.crb_corrected)
    for name in ordered(found.aircraft, found.parameters):
        joint = bound[name]
        rows = [ForestLine("joint fit", COLOURS["mle"], joint)] if np.isfinite(joint.sd) else []
        for m in found.manoeuvres:
            if name in found.alone[m]:
                rows.append(ForestLine(f"{m} alone", COLOURS["prior"], Estimate.normal(*found.alone[m][name])))
            rows.append(ForestLine(f"{m} pooled", COLOURS["alone"], Estimate.of(found.pooled[m][name])))
        rows.append(ForestLine("aircraft", COLOURS["nuts"], Estimate.of(found.aircraft[name])))
        table[name] = [*rows, ForestLine("next flight", COLOURS["scatter"], Estimate.of(found.following[name]))]
    title = "Manoeuvres alone and pooled, and the next flight\n95 % intervals; numbers: ± standard deviation"
    return _forest(identification, table, title)


def _forest(identification: Identification, table: dict[str, list[ForestLine]], title: str) -> Figure:
    """A panel for each parameter with a line for each of its intervals."""
    labels = list(dict.fromkeys(row.label for rows in table.values() for row in rows))
    columns = min(2, len(table))  # three would not be legible on a page
    figure, axes = grid_of(len(table), columns, (5.4, 0.2 * len(labels) + 0.85))
    for number, (ax, (name, rows)) in enumerate(zip(axes, table.items(), strict=True)):
        for row in rows:
            y, (x, sd, low, high), colour = labels.index(row.label), row.estimate, row.colour
            ax.plot([low, high], [y, y], color=colour, lw=1.6, solid_capstyle="butt")
            if row.inner is not None:
                ax.plot([x - row.inner, x + row.inner], [y, y], color=colour, lw=4.0, alpha=0.6)
            ax.plot(x, y, "o", ms=4.0, color=colour, mec="white", mew=0.5)
            beside = {"transform": ax.get_yaxis_transform(), "va": "center", "fontsize": 7.5, "color": "#333333"}
            ax.text(1.02, y, plus_minus(x, sd), **beside)
        if rows:
            ax.axvline(rows[0].estimate.centre, color=COLOURS["crb"], lw=0.8, zorder=0)
        ax.set_yticks(range(len(labels)), [""] * len(labels) if number % columns else labels)
        ax.set_ylim(len(labels) - 0.4, -0.6)
        ax.xaxis.set_major_locator(MaxNLocator(5))
        ax.grid(axis="y", visible=False)
        ax.tick_params(axis="y", length=0)
        ax.set_xlabel(f"{name} {bracket(unit_of(identification, name))}", labelpad=1)
    figure.suptitle(title)
    return figure


@housed
def crb_vs_credible(identification: Identification) -> Figure:
    """Each method's standard deviation over the Cramer-Rao one, on a log axis, and the scatter between manoeuvres."""
    names = ordered(identification.mle.names, identification.mle.parameters)
    found = methods(identification)
    crb, others = found[0], found[1:]
    if not all(np.isfinite(e.sd) for e in crb.estimates.values()):
        raise NotDrawn("the Cramér-Rao bounds do not exist: the information matrix is singular")
    figure, axes = panels(1, 1, (9.0, 0.36 * len(names) + 2.0))
    ax = axes[0, 0]
    ax.axvline(1.0, color=COLOURS["crb"], lw=1.6, label="Cramér-Rao bound, white residuals")
    rows = np.arange(len(names))
    offsets = np.linspace(-0.24, 0.24, len(others)) if len(others) > 1 else [0.0]
    for method, offset in zip(others, offsets, strict=True):
        ratio = [e.sd / crb.estimates[n].sd if e else np.nan for n, e in zip(names, method.of(names), strict=True)]
        style = {"color": COLOURS.get(method.key, GREY), "ms": 6.0, "mec": "white", "mew": 0.5}
        ax.plot(ratio, rows + offset, MARKERS.get(method.key, "o"), label=method.label, **style)
    between = [scatter(identification, name) for name in names]
    if any(s is not None for s in between):
        ratio = [s.sd / crb.estimates[n].sd if s else np.nan for s, n in zip(between, names, strict=True)]
        style = {"color": COLOURS["scatter"], "ms": 10.0, "mec": "white", "mew": 0.5, "zorder": 4}
        label = f"sd of {len(identification.alone)} manoeuvres fitted alone"
        ax.plot(ratio, rows, MARKERS["scatter"], label=label, **style)
    ax.set_xscale("log")
    low, high = ax.get_xlim()
    low, high = min(low, 0.7), max(high, 1.5)
    ax.set_xlim(low, high)
    ticks = [m * 10.0**k for k in range(-6, 9) for m in (1, 2, 5)]  # plain numbers
    ax.set_xticks([t for t in ticks if low <= t <= high])
    ax.xaxis.set_major_formatter(FuncFormatter(lambda x, _: f"{x:g}"))
    ax.xaxis.set_minor_formatter(NullFormatter())
    ax.minorticks_off()
    ax.set_yticks(rows, names)
    ax.set_ylim(len(names) - 0.4, -0.6)
    ax.set_xlabel("standard deviation / Cramér-Rao standard deviation [-]")
    ax.set_title("How much wider than the Cramér-Rao bound?")
    figure.legend(loc="outside lower center", ncols=2)
    return figure


FIGURES = {"next_flight": next_flight, "forest": forest, "crb_vs_credible": crb_vs_credible}
