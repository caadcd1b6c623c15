"""What is shown before anything is fitted: a check of records, a starter card, a simulated record, the catalogue."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from bayes_aero.flight.channel import STANDARD_CHANNELS
from bayes_aero.flight.health import Agreement
from bayes_aero.report.page import HtmlTable, Plot, Report, fold, page_table, section
from bayes_aero.report.pages import parts
from bayes_aero.report.phrases import (
    for_people,
    not_testable_sentences,
    sentence,
    several,
    symbol,
    unit_behind,
)
from bayes_aero.report.plots import COLOURS, SAMPLE, TIME, Line, Panel
from bayes_aero.report.table import Column, Table, columns_of
from bayes_aero.units import number

if TYPE_CHECKING:
    from bayes_aero.diagnosis.result import CheckReport
    from bayes_aero.flight.reading import RecordReport
    from bayes_aero.flight.record import FlightRecord

MAX_PARTS = 12  # of a file in a sentence; the JSON has all
CHANNELS = (
    "airspeed", "altitude", "alpha", "theta", "q", "az", "ax", "elevator", "stabilizer", "thrust", "beta", "phi",
)  # fmt: skip


def headline(report: CheckReport) -> str:
    """The verdict in a sentence."""
    if report.usable:
        able = [name for name, why in report.uses.items() if not why]
        wrong = {
            Agreement.EXPLAINED: f"; the sensors disagree ({several(report.sensors.errors)})",
            Agreement.UNEXPLAINED: ", but the sensors disagree and no known error explains it",
        }.get(report.consistency.agreement, "")
        if any(finding.grave for finding in report.health):  # the apparent sensor error would be an error of the card
            wrong = ", but first correct the card or the file: channels are faulty (see the warnings)"
        return f"Usable for {', '.join(able)}{wrong}."
    problems = [p for r in report.records for p in r.problems] or [f"{n}: {w}" for n, w in report.uses.items() if w]
    more = f" (and {len(problems) - 1} more)" if len(problems) > 1 else ""
    return f"Not usable as it is: {problems[0]}{more}." if problems else "Not usable as it is."


def part_sentences(record: RecordReport) -> list[str]:
    """The parts of a file that may be analysed in place of the whole, as they are written on the command line."""
    sentences = []
    for what, words in (("in flight", "parts in flight"), ("manoeuvre", "manoeuvres")):
        if places := [f"{record.path}@{p.part}" for p in record.proposals if p.what == what]:
            more = f" and {len(places) - MAX_PARTS} more" if len(places) > MAX_PARTS else ""
            sentences.append(f"{words}: {', '.join(places[:MAX_PARTS])}{more}")
    return [*sentences, sentence("give_parts")] if sentences else []


def unused_columns(report: CheckReport) -> list[tuple[str, ...]]:
    """Columns of each record that the card does not map; of records with the same ones, at the first of them."""
    seen: set[tuple[str, ...]] = set()
    return [() if r.unused in seen or seen.add(r.unused) else r.unused for r in report.records]


def card_sentences(report: CheckReport) -> list[str]:
    """Channels that the card adds to the files."""
    card, units = report.card, {"thrust": "N"} | {name: c.unit for name, c in STANDARD_CHANNELS.items()}
    behind = {name: f" {units[name]}".removesuffix(" 1") if name in units else " in SI" for name in card.constants}
    sentences = [f"constant from the card: {name} = {x:g}{behind[name]}" for name, x in card.constants.items()]
    for rule in dict.fromkeys(card.derived.values()):
        formed = ", ".join(name for name, of in card.derived.items() if of == rule)
        sentences.append(f"computed by the card's rule, where not recorded ({rule}): {formed}")
    sentences += [f"table from the card: {name} over {table.said}" for name, table in card.tables.items()]
    for name, summands in card.sums.items():
        factors = [("-" if k < 0 else "+", "" if abs(k) == 1.0 else f"{abs(k):g} ", n) for n, k in summands.items()]
        formula = " ".join(f"{sign} {factor}{part}" for sign, factor, part in factors).removeprefix("+ ")
        sentences.append(f"sum from the card: {name} = {formula}")
    return sentences


def use_sentences(report: CheckReport) -> list[str]:
    """Possible uses of the records, and effects that cannot be tested on them."""
    uses = [f"{name}: {f'not possible, {why}' if why else 'possible'}" for name, why in report.uses.items()]
    return [*report.left_out, *uses, *not_testable_sentences(report.not_testable)]


def sensor_sentences(report: CheckReport) -> list[str]:
    """Whether the sensors agree, and errors that are found although they are within the noise."""
    slight = report.sensors.errors and not report.consistency.disagrees
    within = ["Errors within this noise, which diagnose includes:"] if slight else []
    return [*parts.consistency_sentences(report.consistency, corrects=False), *within]


def left_over(report: CheckReport) -> str:
    """Root mean square residual of the flight path by signal, before and after correction."""
    left, shown = [], slice(1 if not report.sensors.errors else 2)
    for name, pair in report.sensors.rms.items():
        unit, factor = for_people(STANDARD_CHANNELS[name].unit)
        left.append(f"{name} {' → '.join(number(factor * x) for x in pair[shown])} {unit}")
    return f"root mean square residual: {', '.join(left)}"


def sampling(record: RecordReport) -> str:
    """Samples, duration and rate."""
    rate = f"{1.0 / record.dt:.4g} Hz" if record.dt > 0.0 else "no sampling rate"
    return f"{record.samples} samples, {record.duration:.6g} s, {rate}"


def channel_table(record: RecordReport) -> Table:
    """A row for each channel: where it is taken from, its unit and range; values are in the file's own units."""
    column = columns_of(record.channels)
    marks = ((["sign reversed"] * (c.sign < 0), ["does not move"] * (not c.moves)) for c in record.channels)
    unit, values = "unit → inside", "range in the file"
    return Table(
        [
            column(lambda c: c.name, "", "channel", "channel"),
            column(lambda c: c.place, "", "taken from", "taken from", words=True),
            column(lambda c: c.unit if c.unit == c.si else f"{c.unit} → {c.si}", "", unit, unit),
            column(lambda c: f"{c.lowest:.5g} to {c.highest:.5g}", "", values, values),
            Column([", ".join([*turned, *still]) for turned, still in marks], "", "remark", "", words=True),
        ],
        f"{sampling(record)}; {record.gaps} gaps, {record.uneven} uneven steps",
        terminal_title="",
    )


def check_page(report: CheckReport, source: Mapping[str, Any]) -> Report:
    """The page; the first record's time histories stand at its top."""
    sound = [r.record for r in report.records if r.record is not None]
    wrong = [f"{r.path}: {p}" for r in report.records for p in r.problems]
    plots = recorded(sound)
    uses = [*use_sentences(report), *(said for r in report.records for said in part_sentences(r))]
    return Report(
        title=f"Record check: {report.card.title}",
        subtitle="Channels, units, sampling, and whether the sensors agree; no aerodynamics is fitted",
        verdict=headline(report),
        doubts=[parts.doubts(report.consistency), parts.warnings([*wrong, *report.cautions])],
        lead=plots[:1],
        sections=[
            section("uses", "Use of the records", lambda: (uses, parts.not_testable_list(report.not_testable))),
            section("sensors", "Do the sensors agree?", lambda: _sensors(report)),
            section("records", "The records at a glance", lambda: sound and parts.at_a_glance(sound, report.card)),
            section("channels", "Source of each channel", lambda: _channels(report)),
            section("histories", "More records", lambda: plots[1:]),
            parts.provenance_section(source),
        ],
    )


def recorded(records: Sequence[FlightRecord]) -> tuple[Plot | str, ...]:
    """Each record's main channels over time; the first few where there are many."""
    shown, remark = parts.first([record.name for record in records])
    plots = []
    for order, record in enumerate(records[: len(shown)]):
        known = {n: for_people(STANDARD_CHANNELS[n].unit) for n in CHANNELS if record.has(n)}
        panels = [_panel(symbol(n), unit, factor * record[n]) for n, (unit, factor) in known.items()]
        if panels:
            what = "Recorded channels"
            plots.append(parts.histories(record.name, f"time-recorded-{order}", record.time, panels, what))
    return (*plots, remark)


def _panel(name: str, unit: str, values: np.ndarray) -> Panel:
    return Panel(name, unit, (Line("recorded", COLOURS["measured"], values),))


def _sensors(report: CheckReport) -> tuple[Any, ...]:
    said, errors = sensor_sentences(report), report.sensors.errors
    if report.sensors.note:
        return (said,)
    faint = {True: "too small to be named", False: ""}
    rows = tuple((name, e["claim"], parts.error_sizes(e), faint[e["minor"]]) for name, e in errors.items())
    head = ("error", "claim", "size ± sd", "remark")
    table = HtmlTable("Errors estimated along the flight path", head, rows, words=(1, 2, 3)).lean()
    left = left_over(report)
    return said, table if rows else None, f"{left[:1].upper()}{left[1:]}."


def _channels(report: CheckReport) -> list[Any]:
    tables = []
    for r, columns in zip(report.records, unused_columns(report), strict=True):
        remarks = [f"On the card, not in the file (not required): {', '.join(r.missing)}."] if r.missing else []
        remarks += [f"In the file, not on the card: {', '.join(columns)}."] if columns else []
        tables.append(fold(r.path, page_table(channel_table(r)).lean(), [*remarks, *r.remarks]))
    return [*tables, card_sentences(report)]


# --- The report of a starter card: which column was taken for what, why, and what only its user can know.

MOST_PANELS = 16


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


def card_page(view: StarterView, source: Mapping[str, Any]) -> Report:
    """The page."""
    used = [t for t in view.taken if not t.doubt]
    columns = len(view.taken) + len(view.unknown)
    left = f"{len(view.todo)} entries are to be filled in" if view.todo else "no entry is left to be filled in"
    blind = f" {sentence('blind', names=view.blind)}" if view.blind else ""
    panels = [_panel(t.channel, t.unit or "unit?", t.sign * t.values) for t in used if t.channel != "time"]
    todo = HtmlTable("Entries that say TODO", ("entry", "what it is"), tuple(view.todo), words=(1,))
    taken = "recorded, with the sign and in the unit that were guessed"
    return Report(
        title=f"Starter card: {view.card}",
        subtitle=f"Written from the columns of {view.record}; every line is a proposal to be checked",
        verdict=f"{len(used)} of {columns} columns were assigned to channels; {left}.{blind}",
        lead=[_drawn(view, "time-columns", "Recorded columns", taken, panels)],
        sections=[
            section("todo", "To be completed", lambda: todo if view.todo else None),
            section("guesses", "Proposals and their evidence", lambda: _guesses(view.taken)),
            section("unknown", "Columns without a proposal", lambda: _unknown(view)),
            parts.provenance_section(source),
        ],
    )


def _drawn(view: StarterView, key: str, title: str, said: str, panels: Sequence[Panel]) -> Plot | None:
    """Columns over time, or over the number of the sample where no time was found; those of one length."""
    time = view.time
    known = time is not None and len(time) > 1 and bool(np.all(np.diff(time) > 0.0))
    longest = max((len(p.lines[0].values) for p in panels), default=0)
    x, over = (np.asarray(time), TIME) if known else (np.arange(longest, dtype=float), SAMPLE)
    shown = [p for p in panels if len(p.lines[0].values) == len(x) > 1][:MOST_PANELS]
    return parts.histories(view.record, key, x, shown, f"{title}, {said},", over) if shown else None


def _guesses(taken: Sequence[Taken]) -> tuple[Any, ...]:
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
    return (said, HtmlTable("Guesses", head, rows, words=(5,))) if rows else ()


def _unknown(view: StarterView) -> tuple[Any, ...]:
    said = "They stand in the card as comments; give them a name there if the model needs them."
    places = [rest.place + (": no numbers" if rest.values is None else "") for rest in view.unknown]
    panels = [_panel(r.place, r.unit or "unit?", r.values) for r in view.unknown if r.values is not None]
    as_is = "recorded, as it is in the file"
    return (said, places, _drawn(view, "time-rest", "Columns without a name", as_is, panels)) if places else ()


# --- An effect of the catalogue on a terminal.

Described = Mapping[str, Any]
"""An effect as the catalogue describes it."""


def facts(effect: Described) -> list[tuple[str, str]]:
    """Name and text of what holds for the effect as a whole."""
    channel = effect["stage"] == "channel"
    stage = "acts on the recorded channels" if channel else f"acts at the stage {effect['stage']}"
    known = [
        ("kind", f"{effect['kind']}; {stage}"),
        ("axes", " and ".join(effect["axes"])),
        ("formula", " ".join(effect["formula"].split()) or "not stated"),
        ("needs", ", ".join(effect["needs"]) or "nothing"),
    ]
    if effect["rests_on"]:
        known.append(("uses", ", ".join(effect["rests_on"]) + " of other effects in the model"))
    if effect["model"] is not None:
        known.append(("card", "in the card's model" if effect["model"] else "not in the card's model"))
    if not effect["proposed_by_diagnose"]:
        known.append(("diagnose", "never proposes it; a card may name it"))
    return known


def parameter_facts(p: Mapping[str, Any]) -> list[tuple[str, str]]:
    """The same of one of its parameters, beside its description."""
    known = [
        ("neutral", f"{shown(p['neutral'])}{unit_behind(p['unit'])}: there the effect is absent"),
        ("bounds", f"{shown(p['bounds'][0])} to {shown(p['bounds'][1])}"),
        ("prior", f"{p['prior']['text']} ({p['prior']['source']})"),
    ]
    if p["least_worth_modelling"] is not None:
        least, most = shown(p["least_worth_modelling"]), shown(p["largest_plausible"])
        known.append(("sizes", f"smallest worth modelling {least} from neutral, largest plausible {most}"))
    return known


def worked(effect: Described) -> str:
    """The worked example in a sentence."""
    example = effect["example"]
    given, added = (
        ", ".join(f"{name} = {shown(value)}" for name, value in values.items())
        for values in (example["parameters"] | example["signals"] | example["known"], example["increments"])
    )
    return f"{given} adds {added} ({example['source']})"


def shown(value: Any) -> str:
    """A number, or numbers in brackets."""
    if isinstance(value, Sequence):
        return "(" + ", ".join(shown(x) for x in value) + ")"
    if math.isinf(value):
        return "-infinity" if value < 0.0 else "infinity"
    return f"{value:g}"
