"""The report of a starter card: which column was taken for what, why, and what only its user can know."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from bayes_aero.report.page import Block, Page, Plot, Points, Table, Text, filled, section
from bayes_aero.report.page_parts import histories, number, provenance_blocks
from bayes_aero.report.page_plots import Line, Panel
from bayes_aero.report.style import COLOURS, bracket

MOST_PANELS = 16


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
class StarterView:
    """What a starter card was written from: guesses, columns that nothing was guessed for, what is left to fill in."""

    record: str
    card: str
    time: np.ndarray | None
    taken: Sequence[Taken]
    unknown: Sequence[str]
    todo: Sequence[tuple[str, str]]
    """Key, and what the card says of it."""


def card_page(view: StarterView, source: Mapping[str, Any]) -> Page:
    """The page."""
    used = [t for t in view.taken if not t.doubt]
    columns = len(view.taken) + len(view.unknown)
    left = f"{len(view.todo)} entries are to be filled in" if view.todo else "nothing is left to be filled in"
    return Page(
        title=f"Starter card: {view.card}",
        subtitle=f"Written from the columns of {view.record}; every line is a guess to be read",
        verdict=f"{len(used)} of {columns} columns were taken for channels; {left}.",
        lead=_recorded(view, used),
        sections=filled(
            section("todo", "What only you know", lambda: _todo(view.todo)),
            section("guesses", "What was guessed, and why", lambda: _guesses(view.taken)),
            section("unknown", "Columns that nothing was guessed for", lambda: _unknown(view.unknown)),
            section("provenance", "Provenance", lambda: provenance_blocks(source)),
        ),
    )


def _recorded(view: StarterView, used: Sequence[Taken]) -> tuple[Plot, ...]:
    """The channels over time, as far as they are as long as the time."""
    time = view.time
    if time is None or len(time) < 2 or not np.all(np.diff(time) > 0.0):
        return ()
    shown = [t for t in used if t.channel != "time" and len(t.values) == len(time)][:MOST_PANELS]
    panels = [
        Panel(f"{t.channel} {bracket(t.unit or 'unit?')}", (Line("recorded", COLOURS["measured"], t.sign * t.values),))
        for t in shown
    ]
    legend = (("recorded, with the sign and in the unit that were guessed", COLOURS["measured"], "solid"),)
    return (histories(view.record, "time-columns", time, panels, legend, "Recorded columns"),) if panels else ()


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
    said = "Names come from the headings, units and signs from the values' own physics. Read the evidence."
    head = ("channel", "column", "unit", "sign", "range in the file", "evidence")
    return (Text(said), Table("Guesses", head, rows, words=(5,))) if rows else ()


def _unknown(unknown: Sequence[str]) -> tuple[Block, ...]:
    said = "They stand in the card as comments; give them a name there if the model needs them."
    return (Text(said), Points(tuple(unknown))) if unknown else ()
