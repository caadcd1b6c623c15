"""The report of a check: what is in the records, what they are good for, whether the sensors agree."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from bayes_aero.diagnosis.result import CheckReport
from bayes_aero.flight.card import Card
from bayes_aero.flight.channel import STANDARD_CHANNELS
from bayes_aero.flight.record import FlightRecord
from bayes_aero.parameter import Parameter
from bayes_aero.report.colours import COLOURS
from bayes_aero.report.html import page as html
from bayes_aero.report.html.page import Block, Fold, HtmlTable, Text, bullets, page_table, section
from bayes_aero.report.html.plots import SAMPLE, TIME, Line, Panel
from bayes_aero.report.tables.table import channel_table
from bayes_aero.report.text import check as text
from bayes_aero.report.text.phrases import axis_label, bracket, for_people, plain_unit, several
from bayes_aero.units import number

SHOWN = ("airspeed", "altitude", "alpha", "theta", "q", "az", "ax", "elevator", "stabilizer", "thrust", "beta", "phi")
LEGEND = (("recorded", COLOURS["measured"], "solid"),)


def check_page(report: CheckReport, source: Mapping[str, Any]) -> html.Report:
    """The page; the first record's time histories stand at its top."""
    sound = [r.record for r in report.records if r.record is not None]
    wrong = [f"{r.path}: {p}" for r in report.records for p in r.problems]
    plots = recorded(sound)
    parts = [sentence for r in report.records for sentence in text.part_sentences(r)]  # worth a record of their own

    def uses() -> tuple[Block, ...]:
        sentences = [*text.use_sentences(report), *parts]
        return (*bullets(sentences), *html.not_testable_list(report.not_testable))

    return html.Report(
        title=f"Record check: {report.card.title}",
        subtitle="Channels, units, sampling, and whether the sensors agree; no aerodynamics is fitted",
        verdict=text.headline(report),
        doubts=(
            *html.consistency_lead(report.consistency, corrects=False),
            *(Text(w, "warning") for w in (*wrong, *report.cautions)),
        ),
        lead=plots[:1],
        sections=html.filled(
            section("uses", "Use of the records", uses),
            section("sensors", "Do the sensors agree?", lambda: _sensors(report)),
            section(
                "records", "The records at a glance", lambda: html.at_a_glance(sound, report.card) if sound else ()
            ),
            section("channels", "Source of each channel", lambda: _channels(report)),
            section("histories", "More records", lambda: plots[1:]),
            section("provenance", "Provenance", lambda: html.provenance_blocks(source)),
        ),
    )


def recorded(records: list[FlightRecord]) -> tuple[Block, ...]:
    """Each record's main channels over time; the first few where there are many."""
    shown, remark = html.first([record.name for record in records])
    plots = []
    for order, record in enumerate(records[: len(shown)]):
        units = {name: STANDARD_CHANNELS[name].unit for name in SHOWN if record.has(name)}
        panels = [_panel(axis_label(n, unit), for_people(unit)[1] * record[n]) for n, unit in units.items()]
        if panels:
            key = f"time-recorded-{order}"
            plots.append(html.histories(record.name, key, record.time, panels, LEGEND, "Recorded channels"))
    return (*plots, *remark)


def _panel(label: str, values: np.ndarray) -> Panel:
    return Panel(label, (Line("recorded", COLOURS["measured"], values),))


def _sensors(report: CheckReport) -> tuple[Block, ...]:
    said, errors = bullets(text.sensor_sentences(report)), report.sensors.errors
    if report.sensors.note:
        return said
    faint = {True: "too small to be named", False: ""}
    rows = tuple((name, e["claim"], text.sizes(e), faint[e["minor"]]) for name, e in errors.items())
    head = ("error", "claim", "size ± sd", "remark")
    table = HtmlTable("Errors estimated along the flight path", head, rows, words=(1, 2, 3)).lean()
    left = text.left_over(report)
    return (
        *said,
        *html.open_list(report.consistency),
        *((table,) if rows else ()),
        Text(f"{left[:1].upper()}{left[1:]}."),
    )


def _channels(report: CheckReport) -> tuple[Block, ...]:
    tables = []
    for r, columns in zip(report.records, text.unused_columns(report), strict=True):
        remarks = [f"On the card, not in the file (not required): {', '.join(r.missing)}."] if r.missing else []
        remarks += [f"In the file, not on the card: {', '.join(columns)}."] if columns else []
        tables.append(Fold(r.path, (page_table(channel_table(r)).lean(), *bullets([*remarks, *r.remarks]))))
    return (*tables, *bullets(text.card_sentences(report)))


# --- The report of a starter card: which column was taken for what, why, and what only its user can know.

MOST_PANELS = 16
TAKEN = "recorded, with the sign and in the unit that were guessed"
ASIS = "recorded, as it is in the file"
WITHOUT = "identify needs {} to form coefficients, diagnose then works from trajectories alone"


@dataclass(frozen=True)
class Taken:
    """A column of the file taken for a channel: (n,) `values` in the file's numbers, its unit, and why."""

    channel: str
    place: str
    unit: str | None
    sign: int
    evidence: str
    values: np.ndarray
    doubt: str = ""  # why it stands in the card as a comment only; empty where it was taken


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
    todo: Sequence[tuple[str, str]]  # key, and what the card says of it
    blind: Sequence[str] = ()  # accelerations that were not found


def card_page(view: StarterView, source: Mapping[str, Any]) -> html.Report:
    """The page."""
    used, many = [t for t in view.taken if not t.doubt], len(view.blind) > 1
    columns = len(view.taken) + len(view.unknown)
    left = f"{len(view.todo)} entries are to be filled in" if view.todo else "no entry is left to be filled in"
    without = WITHOUT.format("them" if many else "it")
    blind = f" {' and '.join(view.blind)} {'were' if many else 'was'} not found: {without}." if view.blind else ""
    panels = [
        _panel(f"{t.channel} {bracket(t.unit or 'unit?')}", t.sign * t.values) for t in used if t.channel != "time"
    ]
    todo = [HtmlTable("Entries that say TODO", ("entry", "what it is"), tuple(view.todo), words=(1,))]
    return html.Report(
        title=f"Starter card: {view.card}",
        subtitle=f"Written from the columns of {view.record}; every line is a proposal to be checked",
        verdict=f"{len(used)} of {columns} columns were assigned to channels; {left}.{blind}",
        lead=_drawn(view, "time-columns", "Recorded columns", TAKEN, panels),
        sections=html.filled(
            section("todo", "To be completed", lambda: todo if view.todo else ()),
            section("guesses", "Proposals and their evidence", lambda: _guesses(view.taken)),
            section("unknown", "Columns without a proposal", lambda: _unknown(view)),
            section("provenance", "Provenance", lambda: html.provenance_blocks(source)),
        ),
    )


def _drawn(view: StarterView, key: str, title: str, said: str, panels: Sequence[Panel]) -> tuple[html.Plot, ...]:
    """Columns over time, or over the number of the sample where no time was found; those of one length."""
    time = view.time
    known = time is not None and len(time) > 1 and bool(np.all(np.diff(time) > 0.0))
    longest = max((len(p.lines[0].values) for p in panels), default=0)
    x, over = (np.asarray(time), TIME) if known else (np.arange(longest, dtype=float), SAMPLE)
    shown = [p for p in panels if len(p.lines[0].values) == len(x) > 1][:MOST_PANELS]
    legend = ((said, COLOURS["measured"], "solid"),)
    return (html.histories(view.record, key, x, shown, legend, title, over),) if shown else ()


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
    said = "Names are from the headings, units and signs from the physics of the values. Read the evidence."
    head = ("channel", "column", "unit", "sign", "range in the file", "evidence")
    return (Text(said), HtmlTable("Guesses", head, rows, words=(5,))) if rows else ()


def _unknown(view: StarterView) -> tuple[Block, ...]:
    if not view.unknown:
        return ()
    said = "They stand in the card as comments; give them a name there if the model needs them."
    places = tuple(rest.place + (": no numbers" if rest.values is None else "") for rest in view.unknown)
    known = [(f"{rest.place} {bracket(rest.unit or 'unit?')}", rest.values) for rest in view.unknown]
    panels = [_panel(label, values) for label, values in known if values is not None]
    return (Text(said), html.Points(places), *_drawn(view, "time-rest", "Columns without a name", ASIS, panels))


# --- The page of a simulated record: channels, true parameters, hidden effects.


def simulated_page(
    record: FlightRecord, card: Card, truth: Mapping[str, Any], parameters: Sequence[Parameter]
) -> html.Report:
    """The page; `truth` is what stands in the file beside the record, `parameters` are those that were flown."""
    units = {p.name: plain_unit(p.unit) for p in parameters}
    behind = {name: "" if unit == "-" else f" {unit}" for name, unit in units.items()}
    hidden = []
    for effect, values in truth["effects"].items():
        sizes = (f"{name} = {number(x)}{behind.get(name, ' in SI')}" for name, x in values.items())
        hidden.append(f"{effect} ({', '.join(sizes)})")
    verdict = f"A simulated record of {record.time[-1] - record.time[0]:.0f} s; " + (
        f"hidden effect: {several(hidden)}." if hidden else "no effect is hidden in it."
    )

    def true() -> tuple[Block, ...]:
        asked = {name for values in truth["effects"].values() for name in values}
        rows = tuple(
            (f"{name} {bracket(units.get(name, '-'))}", number(x, 6), "hidden" if name in asked else "")
            for name, x in truth["parameters"].items()
        )
        sensors = {name: plain_unit(channel.unit) for name, channel in STANDARD_CHANNELS.items()}
        noise = [(name, number(x)) for name, x in truth["disturbance"].items()]
        noise += [(f"{name} {bracket(sensors.get(name, '-'))}", number(x)) for name, x in truth["sensor_noise"].items()]
        title = "Noise: disturbances of the coefficients, and standard deviations of the sensors in SI"
        return (
            HtmlTable("True parameters, SI and radians", ("parameter", "value", "remark"), rows, words=(2,)).lean(),
            HtmlTable(title, ("", "value"), tuple(noise)),
            html.symbols(parameters, [p.name for p in parameters]),
        )

    return html.Report(
        title=f"Simulated record: {record.name}",
        subtitle="A synthetic flight record and its true parameters",
        verdict=verdict,
        lead=(*(Text(note, "warning") for note in truth["notes"]), *recorded([record])),
        sections=html.filled(
            section("records", "The record at a glance", lambda: html.at_a_glance([record], card)),
            section("truth", "True parameters", true),
            section("provenance", "Provenance", lambda: html.provenance_blocks(truth["provenance"])),
        ),
    )
