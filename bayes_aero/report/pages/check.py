"""The report of a check: what is in the records, what they are good for, whether the sensors agree."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from bayes_aero.diagnosis.consistency.check_result import CheckReport
from bayes_aero.flight.channel import STANDARD_CHANNELS
from bayes_aero.flight.reading.inspection import RecordReport
from bayes_aero.flight.record import FlightRecord
from bayes_aero.report.colours import COLOURS
from bayes_aero.report.html.folded_lists import not_testable_list, open_list
from bayes_aero.report.html.page import Block, Fold, Page, Plot, Table, Text, filled, section
from bayes_aero.report.html.page_table import page_table
from bayes_aero.report.html.parts import at_a_glance, bullets, consistency_lead, first, histories, provenance_blocks
from bayes_aero.report.html.plots import Line, Panel
from bayes_aero.report.tables.channels import channel_table
from bayes_aero.report.text.check import (
    card_sentences,
    headline,
    left_over,
    part_sentences,
    sensor_sentences,
    unused_columns,
    use_sentences,
)
from bayes_aero.report.text.consistency import sizes
from bayes_aero.report.text.phrases import axis_label, for_people

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
    table = Table("Errors estimated along the flight path", head, rows, words=(1, 2, 3)).lean()
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
