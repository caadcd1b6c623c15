"""The report of a starter card: which column was taken for what, why, and what only its user can know."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from bayes_aero.report.colours import COLOURS
from bayes_aero.report.html.page import Block, Page, Plot, Points, Table, Text, filled, section
from bayes_aero.report.html.parts import histories, provenance_blocks
from bayes_aero.report.html.plots import SAMPLE, TIME, Line, Panel
from bayes_aero.report.text.phrases import bracket, number

MOST_PANELS = 16
TAKEN = "recorded, with the sign and in the unit that were guessed"
ASIS = "recorded, as it is in the file"
WITHOUT = "identify needs {} to form coefficients, diagnose then works from trajectories alone"


@dataclass(frozen=True)
class Taken:
    """A column of the file taken for a channel: (n,) `values` in the file's numbers, its unit, and why.

    `doubt` says why it stands in the card as a comment only; empty where it was taken.
    """

    channel: str
    place: str
    unit: str | None
    sign: int
    evidence: str
    values: np.ndarray
    doubt: str = ""


@dataclass(frozen=True)
class Rest:
    """A column that nothing was guessed for; `values` are (n,) in the file's numbers, None where it holds none."""

    place: str
    unit: str | None
    values: np.ndarray | None


@dataclass(frozen=True)
class StarterView:
    """What a starter card was written from: guesses, columns that nothing was guessed for, what is left to fill in."""

    record: str
    card: str
    time: np.ndarray | None
    taken: Sequence[Taken]
    unknown: Sequence[Rest]
    todo: Sequence[tuple[str, str]]
    """Key, and what the card says of it."""
    blind: Sequence[str] = ()
    """Accelerations that were not found."""


def card_page(view: StarterView, source: Mapping[str, Any]) -> Page:
    """The page."""
    used = [t for t in view.taken if not t.doubt]
    columns = len(view.taken) + len(view.unknown)
    left = f"{len(view.todo)} entries are to be filled in" if view.todo else "no entry is left to be filled in"
    return Page(
        title=f"Starter card: {view.card}",
        subtitle=f"Written from the columns of {view.record}; every line is a proposal to be checked",
        verdict=f"{len(used)} of {columns} columns were assigned to channels; {left}.{_blind(view.blind)}",
        lead=_drawn(
            view, "time-columns", "Recorded columns", TAKEN, [_panel_of(t) for t in used if t.channel != "time"]
        ),
        sections=filled(
            section("todo", "To be completed", lambda: _todo(view.todo)),
            section("guesses", "Proposals and their evidence", lambda: _guesses(view.taken)),
            section("unknown", "Columns without a proposal", lambda: _unknown(view)),
            section("provenance", "Provenance", lambda: provenance_blocks(source)),
        ),
    )


def _blind(names: Sequence[str]) -> str:
    """What cannot be done without accelerations."""
    if not names:
        return ""
    many = len(names) > 1
    return f" {' and '.join(names)} {'were' if many else 'was'} not found: {WITHOUT.format('them' if many else 'it')}."


def _panel_of(taken: Taken) -> Panel:
    line = Line("recorded", COLOURS["measured"], taken.sign * taken.values)
    return Panel(f"{taken.channel} {bracket(taken.unit or 'unit?')}", (line,))


def _drawn(view: StarterView, key: str, title: str, sentences: str, panels: Sequence[Panel]) -> tuple[Plot, ...]:
    """Columns over time, or over the number of the sample where no time was found; those of one length."""
    time = view.time
    known = time is not None and len(time) > 1 and bool(np.all(np.diff(time) > 0.0))
    longest = max((len(p.lines[0].values) for p in panels), default=0)
    over = np.asarray(time) if known else np.arange(longest, dtype=float)
    shown = [p for p in panels if len(p.lines[0].values) == len(over) > 1][:MOST_PANELS]
    legend = ((sentences, COLOURS["measured"], "solid"),)
    return (histories(view.record, key, over, shown, legend, title, over=TIME if known else SAMPLE),) if shown else ()


def _todo(todo: Sequence[tuple[str, str]]) -> tuple[Block, ...]:
    return (Table("Entries that say TODO", ("entry", "what it is"), tuple(todo), words=(1,)),) if todo else ()


def _guesses(taken: Sequence[Taken]) -> tuple[Block, ...]:
    rows = tuple(
        (
            t.channel,
            t.place,
            t.unit or "unknown",
            "turned" if t.sign < 0 else "as it is",
            f"{number(float(np.min(t.values)), 4)} to {number(float(np.max(t.values)), 4)}",
            t.evidence + (f"; not taken, {t.doubt}" if t.doubt else ""),
        )
        for t in taken
    )
    text = "Names are from the headings, units and signs from the physics of the values. Read the evidence."
    head = ("channel", "column", "unit", "sign", "range in the file", "evidence")
    return (Text(text), Table("Guesses", head, rows, words=(5,))) if rows else ()


def _unknown(view: StarterView) -> tuple[Block, ...]:
    if not view.unknown:
        return ()
    text = "They stand in the card as comments; give them a name there if the model needs them."
    places = tuple(rest.place + (": no numbers" if rest.values is None else "") for rest in view.unknown)
    panels = [
        Panel(f"{rest.place} {bracket(rest.unit or 'unit?')}", (Line("recorded", COLOURS["measured"], rest.values),))
        for rest in view.unknown
        if rest.values is not None
    ]
    return (Text(text), Points(places), *_drawn(view, "time-rest", "Columns without a name", ASIS, panels))
