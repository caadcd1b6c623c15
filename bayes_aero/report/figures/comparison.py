"""Bounds and credible intervals: forest plot, and every standard error as a multiple of the Cramer-Rao bound."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, MaxNLocator, NullFormatter

from bayes_aero.inference.identification import Identification
from bayes_aero.inference.pooled_result import NextFlight
from bayes_aero.inference.posterior.posterior import Marginal
from bayes_aero.report.colours import COLOURS
from bayes_aero.report.style import MOST_MANOEUVRES, NotDrawn, grid_of, housed, panels
from bayes_aero.report.tables.comparison import Method, alone, bounds, methods, ordered, scatter, unit_of
from bayes_aero.report.tables.table import NORMAL95, Estimate
from bayes_aero.report.text.phrases import bracket, plus_minus

MARKERS = {"crb": "|", "crb_corrected": "s", "white": "D", "emcee": "o", "nuts": "^", "scatter": "*"}


@dataclass(frozen=True)
class _Row:
    """One line of a forest panel; `inner` is a narrower interval drawn thick, where there are two."""

    label: str
    colour: str
    centre: float
    sd: float
    low: float
    high: float
    inner: float | None = None


def _rows(identification: Identification, name: str) -> list[_Row]:
    rows = []
    for method in methods(identification):
        e = method.estimates.get(name)
        if e is not None and np.isfinite(e.sd):
            rows.append(_Row(method.label, COLOURS.get(method.key, "#555555"), e.centre, e.sd, e.low, e.high))
    for manoeuvre, (x, crb, corrected) in alone(identification, name).items():
        reach = NORMAL95 * corrected
        rows.append(
            _Row(f"{manoeuvre} alone, ML", COLOURS["alone"], x, corrected, x - reach, x + reach, NORMAL95 * crb)
        )
    return rows


@housed
def forest(identification: Identification) -> Figure:
    """Every parameter by every method, with 95 % intervals and numbers; one panel per parameter, in its own unit."""
    names = ordered(identification.mle.names, identification.mle.parameters)
    table = {name: _rows(identification, name) for name in names}
    labels = list(dict.fromkeys(row.label for rows in table.values() for row in rows))
    columns = min(2, len(names))  # three would not be legible on a page
    figure, axes = grid_of(len(names), columns, (5.4, 0.2 * len(labels) + 0.85))
    for number, (ax, name) in enumerate(zip(axes, names, strict=True)):
        _forest_panel(ax, table[name], labels, first=number % columns == 0)
        ax.set_xlabel(f"{name} {bracket(unit_of(identification, name))}", labelpad=1)
    figure.suptitle(
        "Estimates with 95 % intervals, and estimate ± standard deviation\n"
        "one manoeuvre alone: thick Cramér-Rao, thin corrected bound (the number's ±)"
    )
    return figure


def _forest_panel(ax: Axes, rows: list[_Row], labels: list[str], *, first: bool) -> None:
    for row in rows:
        y = labels.index(row.label)
        ax.plot([row.low, row.high], [y, y], color=row.colour, lw=1.6, solid_capstyle="butt")
        if row.inner is not None:
            ax.plot([row.centre - row.inner, row.centre + row.inner], [y, y], color=row.colour, lw=4.0, alpha=0.6)
        ax.plot(row.centre, y, "o", ms=4.0, color=row.colour, mec="white", mew=0.5)
        text = plus_minus(row.centre, row.sd)
        ax.text(1.02, y, text, transform=ax.get_yaxis_transform(), va="center", fontsize=7.5, color="#333333")
    if rows:
        ax.axvline(rows[0].centre, color=COLOURS["crb"], lw=0.8, zorder=0)
    ax.set_yticks(range(len(labels)), labels if first else [""] * len(labels))
    ax.set_ylim(len(labels) - 0.4, -0.6)
    ax.xaxis.set_major_locator(MaxNLocator(5))
    ax.grid(axis="y", visible=False)
    ax.tick_params(axis="y", length=0)


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
        ratio = _ratios(names, crb, method)
        style = {"color": COLOURS.get(method.key, "#555555"), "ms": 6.0, "mec": "white", "mew": 0.5}
        ax.plot(ratio, rows + offset, MARKERS.get(method.key, "o"), label=method.label, **style)
    between = [scatter(identification, name) for name in names]
    if any(s is not None for s in between):
        ratio = [s.sd / crb.estimates[n].sd if s else np.nan for s, n in zip(between, names, strict=True)]
        style = {"color": COLOURS["scatter"], "ms": 10.0, "mec": "white", "mew": 0.5}
        ax.plot(
            ratio,
            rows,
            MARKERS["scatter"],
            label=f"sd of {len(identification.alone)} manoeuvres fitted alone",
            zorder=4,
            **style,
        )
    ax.set_xscale("log")
    _decades(ax)
    ax.set_yticks(rows, names)
    ax.set_ylim(len(names) - 0.4, -0.6)
    ax.set_xlabel("standard deviation / Cramér-Rao standard deviation [-]")
    ax.set_title("How much wider than the Cramér-Rao bound?")
    figure.legend(loc="outside lower center", ncols=2)
    return figure


def _ratios(names: list[str], crb: Method, method: Method) -> list[float]:
    return [method.estimates[n].sd / crb.estimates[n].sd if n in method.estimates else np.nan for n in names]


def _decades(ax: Axes) -> None:
    """Plain numbers at 1, 2 and 5 of every decade."""
    low, high = ax.get_xlim()
    low, high = min(low, 0.7), max(high, 1.5)
    ax.set_xlim(low, high)
    ticks = [m * 10.0**k for k in range(-6, 9) for m in (1, 2, 5)]
    ax.set_xticks([t for t in ticks if low <= t <= high])
    ax.xaxis.set_major_formatter(FuncFormatter(lambda x, _: f"{x:g}"))
    ax.xaxis.set_minor_formatter(NullFormatter())
    ax.minorticks_off()


@housed
def next_flight(identification: Identification) -> Figure:
    """Joint fit, manoeuvres alone and pooled, aircraft and next flight, with 95 % intervals; a panel a parameter."""
    found = identification.next_flight
    if found is None:
        raise NotDrawn("the manoeuvres were not pooled; ask for the next flight")
    if len(found.manoeuvres) > MOST_MANOEUVRES:
        raise NotDrawn(f"there are more than {MOST_MANOEUVRES} manoeuvres")
    names = ordered(found.aircraft, found.parameters)
    table = {name: _pooled_rows(identification, found, name) for name in names}
    labels = list(dict.fromkeys(row.label for rows in table.values() for row in rows))
    columns = min(2, len(names))
    figure, axes = grid_of(len(names), columns, (5.4, 0.2 * len(labels) + 0.85))
    for number, (ax, name) in enumerate(zip(axes, names, strict=True)):
        _forest_panel(ax, table[name], labels, first=number % columns == 0)
        ax.set_xlabel(f"{name} {bracket(unit_of(identification, name))}", labelpad=1)
    figure.suptitle("Manoeuvres alone and pooled, and the next flight\n95 % intervals; numbers: ± standard deviation")
    return figure


def _pooled_rows(identification: Identification, found: NextFlight, name: str) -> list[_Row]:
    mle = identification.mle
    joint = bounds(mle, mle.crb_corrected)[name]
    rows = [_Row("joint fit", COLOURS["mle"], *joint)] if np.isfinite(joint.sd) else []
    for m in found.manoeuvres:
        if name in found.alone[m]:
            rows.append(_Row(f"{m} alone", COLOURS["prior"], *Estimate.normal(*found.alone[m][name])))
        rows.append(_Row(f"{m} pooled", COLOURS["alone"], *_estimate(found.pooled[m][name])))
    rows.append(_Row("aircraft", COLOURS["nuts"], *_estimate(found.aircraft[name])))
    return [*rows, _Row("next flight", COLOURS["scatter"], *_estimate(found.following[name]))]


def _estimate(m: Marginal) -> Estimate:
    return Estimate(m.mean, m.sd, *m.ci95)


FIGURES = {"next_flight": next_flight, "forest": forest, "crb_vs_credible": crb_vs_credible}
