"""Simulated trajectories on the page: errors before and after, and time histories with tolerance bands."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from bayes_aero.diagnosis.trajectories.results import Path, Trajectories
from bayes_aero.flight.card.card import Card
from bayes_aero.flight.channel import STANDARD_CHANNELS
from bayes_aero.report.colours import COLOURS
from bayes_aero.report.html.page import Block, Facts, Fold, Plot, Text
from bayes_aero.report.html.page_table import page_table
from bayes_aero.report.html.parts import first, histories
from bayes_aero.report.html.plots import Line, Panel
from bayes_aero.report.tables.trajectories import SPLIT_NAMES, error_table, tolerance_table
from bayes_aero.report.text.phrases import SYMBOLS, axis_label, for_people, number
from bayes_aero.report.text.trajectories import tolerance_origin

MODELS = (
    ("card", "card's model", COLOURS["before"], "dashed"),
    ("extended", "extended model", COLOURS["after"], "solid"),
)
SPLITS = {
    "hold_out": "Hold-out: simulated from the measured initial state with the fit to the other flights",
    "fitted": "Fitted: parameters and initial states fitted to all flights",
}


class Curve(NamedTuple):
    """A simulated manoeuvre and how it is drawn."""

    path: Path
    label: str
    colour: str
    style: str


def trajectories(flown: Trajectories, card: Card) -> tuple[Block, ...]:
    """Tables, then the hold-out flights, then the fitted ones, folded."""
    blocks: list[Block] = [
        Text(
            "Both models simulated with the recorded inputs, without correction by measurements. “Hold-out” "
            "flights were "
            "not used in the fit. The grey band is the tolerance about the measurement. "
            + tolerance_origin({name: t.value for name, t in card.tolerances.items()})
        ),
        page_table(error_table(flown)),
        page_table(tolerance_table(flown)),
    ]
    unseen, fitted = (_flights(flown, split) for split in ("hold_out", "fitted"))
    blocks += unseen
    if fitted:
        blocks.append(Fold("The same, fitted to all flights", fitted))
    return (*blocks, *sources(card, {n: STANDARD_CHANNELS[n].unit for n in flown.outputs}))


def sources(card: Card, units: Mapping[str, str]) -> tuple[Block, ...]:
    """Where the tolerances of outputs (by their SI units) come from; nothing where the card has none."""
    facts = tuple(
        (f"{SYMBOLS.get(n, n)} ± {number(factor * t.value)} {unit}", t.source)
        for n, t in card.tolerances.items()
        if n in units
        for unit, factor in (for_people(units[n]),)
    )
    return (Fold("Origin of the tolerances", (Facts(facts),)),) if facts else ()


def _names(flown: Trajectories, split: str) -> list[str]:
    return list(dict.fromkeys(p.manoeuvre for p in flown.paths if p.split == split))


def _flights(flown: Trajectories, split: str) -> tuple[Block, ...]:
    shown, remark = first(_names(flown, split))
    plots: list[Block] = [*remark]
    units = {name: STANDARD_CHANNELS[name].unit for name in flown.outputs}
    for order, name in enumerate(shown):
        curves = [Curve(p, *how) for key, *how in MODELS if (p := flown.path(name, key, split)) is not None]
        what = f"{SPLITS[split]}: measured and simulated outputs"
        plot = over_measured(name, f"time-{split}-{order}", curves, units, what)
        caption = f"{SPLITS[split]}. {plot.caption}"
        plots.append(replace(plot, caption=caption, title=f"{name}, {SPLIT_NAMES[split]}"))
    return tuple(plots)


def over_measured(
    name: str, key: str, curves: Sequence[Curve], units: Mapping[str, str], what: str, context: Sequence[Panel] = ()
) -> Plot:
    """One manoeuvre: a panel for each output of `units` (SI), the last curve's error shaded; then those of `context`.

    All curves are of the same flight; their tolerances are about what was measured.
    """
    path = curves[0].path
    panels = [_panel(output, unit, curves) for output, unit in units.items() if output in path.measured]
    legend = [
        ("measured", COLOURS["measured"], "solid"),
        *((c.label, c.colour, c.style) for c in curves),
        (f"error of the {curves[-1].label}", curves[-1].colour, "area"),
    ]
    if any(panel.band is not None for panel in panels):
        legend.append(("tolerance", "#999999", "area"))
    return histories(name, key, path.time, [*panels, *context], tuple(legend), what)


def _panel(output: str, unit: str, curves: Sequence[Curve]) -> Panel:
    factor = for_people(unit)[1]
    path = curves[0].path
    lines = [Line("measured", COLOURS["measured"], factor * path.measured[output], width=1.0)]
    with np.errstate(over="ignore"):  # first values of parameters may fly anywhere
        lines += [Line(c.label, c.colour, factor * c.path.simulated[output], c.style) for c in curves]
    tolerance = path.errors[output].tolerance
    band = None if tolerance is None else factor * tolerance
    return Panel(axis_label(output, unit), tuple(lines), shade=((0, len(curves)),), band=band)
