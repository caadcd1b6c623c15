"""The report of a check: what is in the records, what they are good for, whether the sensors agree."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from bayes_aero.diagnosis.result import CheckReport
from bayes_aero.flight.card.card import Card
from bayes_aero.flight.channel import STANDARD_CHANNELS
from bayes_aero.flight.reading.inspection import RecordReport
from bayes_aero.flight.record import FlightRecord
from bayes_aero.parameter import Parameter
from bayes_aero.report.colours import COLOURS
from bayes_aero.report.html.page import (
    Block,
    Fold,
    HtmlTable,
    Page,
    Plot,
    Points,
    Text,
    at_a_glance,
    bullets,
    consistency_lead,
    filled,
    first,
    histories,
    provenance_blocks,
    section,
    symbols,
)
from bayes_aero.report.html.parts import not_testable_list, open_list, page_table
from bayes_aero.report.html.plots import SAMPLE, TIME, Line, Panel
from bayes_aero.report.tables.table import channel_table
from bayes_aero.report.text.check import (
    card_sentences,
    headline,
    left_over,
    part_sentences,
    sensor_sentences,
    sizes,
    unused_columns,
    use_sentences,
)
from bayes_aero.report.text.phrases import axis_label, bracket, for_people, plain_unit, several
from bayes_aero.units import number

SHOWN = ("airspeed", "altitude", "alpha", "theta", "q", "az", "ax", "elevator", "stabilizer", "thrust", "beta", "phi")
LEGEND = (("recorded", COLOURS["measured"], "solid"),)


def check_page(report: CheckReport, source: Mapping[str, Any]) -> Page:
    """The page; the first record's time histories stand at its top."""
    sound = [r.record for r in report.records if r.record is not None]
    wrong = [f"{r.path}: {p}" for r in report.records for p in r.problems]
    plots = list(recorded(sound))
    return Page(
        title=f"Record check: {report.card.title}",
        subtitle="Channels, units, sampling, and whether the sensors agree; no aerodynamics is fitted",
        verdict=headline(report),
        doubts=(
            *consistency_lead(report.consistency, corrects=False),
            *(Text(w, "warning") for w in (*wrong, *report.cautions)),
        ),
        lead=tuple(plots[:1]),
        sections=filled(
            section(
                "uses",
                "Use of the records",
                lambda: (*bullets(_uses(report)), *not_testable_list(report.not_testable)),
            ),
            section("sensors", "Do the sensors agree?", lambda: _sensors(report)),
            section("records", "The records at a glance", lambda: at_a_glance(sound, report.card) if sound else ()),
            section("channels", "Source of each channel", lambda: _channels(report)),
            section("histories", "More records", lambda: plots[1:]),
            section("provenance", "Provenance", lambda: provenance_blocks(source)),
        ),
    )


def _uses(report: CheckReport) -> list[str]:
    """What can be done with the records, and which parts of them are worth a record of their own."""
    return [*use_sentences(report), *(sentence for r in report.records for sentence in part_sentences(r))]


def recorded(records: list[FlightRecord]) -> tuple[Block, ...]:
    """Each record's main channels over time; the first few where there are many."""
    shown, remark = first([record.name for record in records])
    plots = [_plot(record, f"time-recorded-{order}") for order, record in enumerate(records[: len(shown)])]
    return (*(plot for plot in plots if plot is not None), *remark)


def _plot(record: FlightRecord, key: str) -> Plot | None:
    panels = []
    for name in (n for n in SHOWN if record.has(n)):
        unit = STANDARD_CHANNELS[name].unit
        line = Line("recorded", COLOURS["measured"], for_people(unit)[1] * record[name])
        panels.append(Panel(axis_label(name, unit), (line,)))
    return histories(record.name, key, record.time, panels, LEGEND, "Recorded channels") if panels else None


def _sensors(report: CheckReport) -> tuple[Block, ...]:
    s = report.sensors
    if s.note:
        return bullets(sensor_sentences(report))
    faint = {True: "too small to be named", False: ""}
    rows = tuple((name, e["claim"], sizes(e), faint[e["minor"]]) for name, e in s.errors.items())
    head = ("error", "claim", "size ± sd", "remark")
    table = HtmlTable("Errors estimated along the flight path", head, rows, words=(1, 2, 3)).lean()
    text = f"{left_over(report)[:1].upper()}{left_over(report)[1:]}."
    listed = open_list(report.consistency)
    return (*bullets(sensor_sentences(report)), *listed, *((table,) if rows else ()), Text(text))


def _channels(report: CheckReport) -> tuple[Block, ...]:
    tables = (_table(r, unused) for r, unused in zip(report.records, unused_columns(report), strict=True))
    return (*tables, *bullets(card_sentences(report)))


def _table(r: RecordReport, columns: tuple[str, ...]) -> Fold:
    absent = [f"On the card, not in the file (not required): {', '.join(r.missing)}."] if r.missing else []
    unused = [f"In the file, not on the card: {', '.join(columns)}."] if columns else []
    return Fold(r.path, (page_table(channel_table(r)).lean(), *bullets([*absent, *unused, *r.remarks])))


# --- The report of a starter card: which column was taken for what, why, and what only its user can know.

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
    return (HtmlTable("Entries that say TODO", ("entry", "what it is"), tuple(todo), words=(1,)),) if todo else ()


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
    return (Text(text), HtmlTable("Guesses", head, rows, words=(5,))) if rows else ()


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


# --- The page of a simulated record: channels, true parameters, hidden effects.


def simulated_page(
    record: FlightRecord,
    card: Card,
    truth: Mapping[str, Any],
    parameters: Sequence[Parameter],
) -> Page:
    """The page; `truth` is what stands in the file beside the record, `parameters` are those that were flown."""
    units = {p.name: p.unit for p in parameters}
    hidden = [f"{name} ({_values(values, units)})" for name, values in truth["effects"].items()]
    verdict = f"A simulated record of {record.time[-1] - record.time[0]:.0f} s; " + (
        f"hidden effect: {several(hidden)}." if hidden else "no effect is hidden in it."
    )
    return Page(
        title=f"Simulated record: {record.name}",
        subtitle="A synthetic flight record and its true parameters",
        verdict=verdict,
        lead=(*(Text(note, "warning") for note in truth["notes"]), *recorded([record])),
        sections=filled(
            section("records", "The record at a glance", lambda: at_a_glance([record], card)),
            section(
                "truth", "True parameters", lambda: (_truth(truth, parameters), _noise(truth), _meaning(parameters))
            ),
            section("provenance", "Provenance", lambda: provenance_blocks(truth["provenance"])),
        ),
    )


def _values(values: Mapping[str, float], units: Mapping[str, str]) -> str:
    behind = {name: "" if unit == "1" else f" {plain_unit(unit)}" for name, unit in units.items()}
    return ", ".join(f"{name} = {number(x)}{behind.get(name, ' in SI')}" for name, x in values.items())


def _truth(truth: Mapping[str, Any], parameters: Sequence[Parameter]) -> HtmlTable:
    units = {p.name: p.unit for p in parameters}
    asked = {name for values in truth["effects"].values() for name in values}
    rows = tuple(
        (f"{name} {bracket(plain_unit(units.get(name, '1')))}", number(x, 6), "hidden" if name in asked else "")
        for name, x in truth["parameters"].items()
    )
    return HtmlTable("True parameters, SI and radians", ("parameter", "value", "remark"), rows, words=(2,)).lean()


def _noise(truth: Mapping[str, Any]) -> HtmlTable:
    rows = [(name, number(x)) for name, x in truth["disturbance"].items()]
    units = {name: channel.unit for name, channel in STANDARD_CHANNELS.items()}
    rows += [
        (f"{name} {bracket(plain_unit(units.get(name, '1')))}", number(x)) for name, x in truth["sensor_noise"].items()
    ]
    return HtmlTable(
        "Noise: disturbances of the coefficients, and standard deviations of the sensors in SI",
        ("", "value"),
        tuple(rows),
    )


def _meaning(parameters: Sequence[Parameter]):
    return symbols(parameters, [p.name for p in parameters])
