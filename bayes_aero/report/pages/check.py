"""What is shown before anything is fitted: a check of records, a starter card, a simulated record, the catalogue."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from bayes_aero.flight.channel import STANDARD_CHANNELS
from bayes_aero.report.page import Block, Facts, Plot, Report, Text, fold, section
from bayes_aero.report.pages import parts
from bayes_aero.report.phrases import for_people, not_testable_sentences, plain_unit, sentence, several
from bayes_aero.report.plots import COLOURS, Line, Panel, measured_panel
from bayes_aero.report.screen import Screen, claims, doubts_of
from bayes_aero.report.table import NONE, Column, Table, TextTable, columns_of
from bayes_aero.units import number

if TYPE_CHECKING:
    from bayes_aero.diagnosis.result import CheckReport
    from bayes_aero.flight.reading import RecordReport
    from bayes_aero.flight.record import FlightRecord
    from bayes_aero.jobs.preparing import Starter

MAX_PARTS = 12  # of a file in a sentence; the JSON has all
MOST_PANELS = 16
CHANNELS = (
    "airspeed", "altitude", "alpha", "theta", "q", "az", "ax", "elevator", "stabilizer", "thrust", "beta", "phi",
)  # fmt: skip


def check_screen(report: CheckReport, failures: Sequence[str] = ()) -> Screen:
    """What each record is fit for, the faults of its channels, and what to do with it."""
    sound = [r.record for r in report.records if r.record is not None]
    problems = [f"{r.path}: {p}." for r in report.records for p in r.problems]
    record, mend = parts.record_block(sound, report.health, report.consistency, problems)
    able = [name for name, why in report.uses.items() if not why]
    unable = [f"{name}: {why}." for name, why in report.uses.items() if why]
    usable = "usable" if not mend else "usable_then"
    shown: list[str | Table] = [sentence(usable, names=able) if report.usable else sentence("unusable")]
    errors = {name: parts.error_sizes(error).removeprefix(f"{name} ") for name, error in report.sensors.errors.items()}
    columns = Column([*errors], page="error of a sensor"), Column([*errors.values()], page="size ± standard error")
    shown += [Table(columns)] if errors else []
    untestable = [sentence("not_testable_count", n=len(report.not_testable))] if report.not_testable else []
    disagreement = parts.consistency_sentences(report.consistency, corrects=False)[1:]
    given = " ".join([*(r.path for r in report.records), "--model", report.card.path or report.card.name])
    then = [sentence("next_diagnose" if "diagnose" in able else "next_fly", given=given)] if report.usable else []
    places = [f"{r.path}@{p.part}" for r in report.records for p in r.proposals if p.what == "manoeuvre"]
    several_in_one = len(places) > len(report.records)
    parts_of = [sentence("give_these", listed=parts.several(places, parts.MOST_FILES))] if several_in_one else []
    doubts = [*problems[parts.MOST_FAULTS :], *failures, *claims(doubts_of(disagreement)), *unable]
    doubts += [*report.left_out, *untestable]
    return Screen(record, shown, doubts, [*mend, *parts_of, *then])


def part_sentences(record: RecordReport) -> list[str]:
    sentences = []
    for what, words in (("in flight", "parts in flight"), ("manoeuvre", "manoeuvres")):
        if places := [f"{record.path}@{p.part}" for p in record.proposals if p.what == what]:
            more = f" and {len(places) - MAX_PARTS} more" if len(places) > MAX_PARTS else ""
            sentences.append(f"{words}: {', '.join(places[:MAX_PARTS])}{more}")
    return [*sentences, sentence("give_parts")] if sentences else []


def card_sentences(report: CheckReport) -> list[str]:
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


def left_over(report: CheckReport) -> str:
    """Root mean square residual of the flight path by signal, before and after correction."""
    left, shown = [], slice(1 if not report.sensors.errors else 2)
    for name, pair in report.sensors.rms.items():
        unit, factor = for_people(STANDARD_CHANNELS[name].unit)
        left.append(f"{name} {' → '.join(number(factor * x) for x in pair[shown])} {unit}")
    return f"root mean square residual: {', '.join(left)}"


def sampling(record: RecordReport) -> str:
    rate = f"{1.0 / record.dt:.4g} Hz" if record.dt > 0.0 else "no sampling rate"
    return f"{record.samples} samples, {record.duration:.6g} s, {rate}"


def channel_table(record: RecordReport) -> Table:
    """A row for each channel: where it is taken from, its unit and range; values are in the file's own units."""
    column = columns_of(record.channels)
    marks = ((["sign reversed"] * (c.sign < 0), ["does not move"] * (not c.moves)) for c in record.channels)
    remarks = [", ".join([*turned, *still]) for turned, still in marks]
    unit, values = "unit → inside", "range in the file"
    return Table(
        [
            column(lambda c: c.name, "", "channel"),
            column(lambda c: c.place, "", "taken from", words=True),
            column(lambda c: c.unit if c.unit == c.si else f"{c.unit} → {c.si}", "", unit),
            column(lambda c: f"{c.lowest:.5g} to {c.highest:.5g}", "", values),
            Column(remarks, "", "remark" if any(remarks) else None, words=True),
        ],
        f"{sampling(record)}; {record.gaps} gaps, {record.uneven} uneven steps",
    )


def check_page(report: CheckReport, source: Mapping[str, Any]) -> Report:
    sound = [r.record for r in report.records if r.record is not None]
    wrong = [f"{r.path}: {p}" for r in report.records for p in r.problems]
    more, *plots = recorded(sound)
    faults, untestable = [*wrong, *report.cautions], parts.not_testable_list(report.not_testable)
    uses = [f"{name}: {f'not possible, {why}' if why else 'possible'}" for name, why in report.uses.items()]
    uses = [*report.left_out, *uses, *not_testable_sentences(report.not_testable)]
    uses += [text for r in report.records for text in part_sentences(r)]
    return Report(
        title=f"Record check: {report.card.title}",
        subtitle="Channels, units, sampling, and whether the sensors agree; no aerodynamics is fitted",
        verdict=check_screen(report, report.failures),
        lead=plots[:1],
        sections=[
            section("uses", "Use of the records", lambda: (parts.warnings(faults), uses, untestable)),
            section("sensors", "Do the sensors agree?", lambda: _sensors(report)),
            section("records", "The records at a glance", lambda: sound and parts.at_a_glance(sound, report.card)),
            section("channels", "Source of each channel", lambda: _channels(report)),
            section("histories", "More records", lambda: (more, plots[1:])),
            parts.provenance_section(source),
        ],
    )


def recorded(records: Sequence[FlightRecord]) -> list[Any]:
    """Each record's main channels over time; the first few where there are many."""
    some = [(r.name, r.time, [measured_panel(n, r[n]) for n in CHANNELS if r.has(n)]) for r in records]
    some = [each for each in some if each[-1]]
    return parts.flights([name for name, *_ in some], "recorded", "Recorded channels", lambda k, _: some[k][1:])


def _sensors(report: CheckReport) -> tuple[Any, ...]:
    sentences, errors = parts.consistency_sentences(report.consistency, corrects=False), report.sensors.errors
    if errors and not report.consistency.disagrees:
        sentences.append("Errors within this noise, which diagnose includes:")
    if report.sensors.note:
        return (sentences,)
    faint = " (too small to be named)"
    sizes = {name: f"{parts.error_sizes(e)}{faint if e['minor'] else ''}" for name, e in errors.items()}
    rows = tuple((name, e["claim"], sizes[name]) for name, e in errors.items())
    table = TextTable("Errors estimated along the flight path", ("error", "claim", "size ± sd"), rows, words=(1, 2))
    left = left_over(report)
    return sentences, table if rows else None, f"{left[:1].upper()}{left[1:]}."


def _channels(report: CheckReport) -> list[Any]:
    tables, seen = [], list[tuple[str, ...]]()
    for r in report.records:
        columns = () if r.unused in seen else r.unused  # of records with the same ones, at the first of them
        seen.append(r.unused)
        remarks = [f"On the card, not in the file (not required): {', '.join(r.missing)}."] if r.missing else []
        remarks += [f"In the file, not on the card: {', '.join(columns)}."] if columns else []
        tables.append(fold(r.path, channel_table(r), [*remarks, *r.remarks]))
    return [*tables, card_sentences(report)]


def card_page(starter: Starter, record: str, card: str, source: Mapping[str, Any]) -> Report:
    """The page of the card `card`, written from the file `record`."""
    taken = {name: g for name, g in starter.found.items() if not starter.doubt(name)}
    columns = len(starter.found) + len(starter.unknown)
    left = f"{len(starter.todo)} entries are to be filled in" if starter.todo else "no entry is left to be filled in"
    blind = f" {sentence('blind', names=starter.blind)}" if starter.blind else ""
    time = starter.found["time"].si if "time" in starter.found else np.zeros(0)

    def drawn(key: str, what: str, columns: Iterable[tuple[str, str | None, np.ndarray | None]]) -> Plot | None:
        """Columns over time, if that is known."""
        same = [(name, unit, x) for name, unit, x in columns if x is not None and len(x) == len(time)]
        shown = [(name, unit or "unit?", (Line("recorded", COLOURS["measured"], x),)) for name, unit, x in same]
        panels = [Panel(*each) for each in shown[:MOST_PANELS]]
        increasing = panels and len(time) > 1 and np.all(np.diff(time) > 0.0)
        return parts.histories(record, key, time, panels, what) if increasing else None

    caption = "Recorded columns, recorded, with the sign and in the unit that were guessed,"
    guesses = [(name, g.unit, g.sign * g.values) for name, g in taken.items() if name != "time"]
    rest = "Columns without a name, recorded, as it is in the file,"
    todo = TextTable("Entries that say TODO", ("entry", "what it is"), tuple(starter.todo), words=(1,))
    places = [column.place + (": no numbers" if column.values is None else "") for column in starter.unknown]

    def unknown() -> tuple[Any, ...]:
        plot = drawn("time-rest", rest, ((c.place, c.unit, c.values) for c in starter.unknown))
        return ("They stand in the card as comments; give them a name there if the model needs them.", places, plot)

    return Report(
        title=f"Starter card: {card}",
        subtitle=f"Written from the columns of {record}; every line is a proposal to be checked",
        verdict=f"{len(taken)} of {columns} columns were assigned to channels; {left}.{blind}",
        lead=[drawn("time-columns", caption, guesses) or "Nothing is drawn: no time that increases was found."],
        sections=[
            section("todo", "To be completed", lambda: todo if starter.todo else None),
            section("guesses", "Proposals and their evidence", lambda: _guesses(starter)),
            section("unknown", "Columns without a proposal", lambda: unknown() if places else None),
            parts.provenance_section(source),
        ],
    )


def _guesses(starter: Starter) -> tuple[Any, ...]:
    rows = []
    for name, g in starter.found.items():
        sign, doubt = "turned" if g.sign < 0 else "as it is", starter.doubt(name)
        low, high = (number(float(f(g.values)), 4) for f in (np.min, np.max))
        evidence = g.evidence + (f"; not taken, {doubt}" if doubt else "")
        rows.append((name, g.column.place, g.unit or "unknown", sign, f"{low} to {high}", evidence))
    caution = "Names are from the headings, units and signs from the physics of the values. Read the evidence."
    head = ("channel", "column", "unit", "sign", "range in the file", "evidence")
    return (caution, TextTable("Guesses", head, tuple(rows), words=(5,))) if rows else ()


# --- The catalogue of effects, on a terminal.


def effects_table(facts: Sequence[Mapping[str, Any]]) -> TextTable:
    """All effects by kind, with their parameters."""
    rows, stars = [], "*: in the card's model. " if any(effect["model"] for effect in facts) else ""
    for effect in sorted(facts, key=lambda effect: effect["kind"]):
        parameters = "\n".join(f"{p['name']} [{plain_unit(p['unit'])}]" for p in effect["parameters"])
        claim = f"{effect['claim']} It needs {several(effect['needs']) or 'nothing'}."
        rows.append((f"{effect['name']}{' *' * bool(effect['model'])}\n{effect['kind']}", parameters, claim))
    note = f"{len(facts)} effects. {stars}bayes-aero effects NAME explains one."
    return TextTable("", ("effect\nkind", "parameters", "claim"), tuple(rows), words=(1, 2), note=note)


def effect_blocks(effect: Mapping[str, Any]) -> list[Block]:
    """What one effect says and needs, and a row for each of its parameters."""
    example, about, rows = effect["example"], [], []
    for side in (example["parameters"] | example["signals"] | example["known"], example["increments"]):
        about.append(", ".join(f"{name} = {numbers(value)}" for name, value in side.items()))
    facts = {
        "kind": f"{effect['kind']}, at the stage {effect['stage']}, {' and '.join(effect['axes'])}",
        "formula": " ".join(effect["formula"].split()) or "not stated",
        "needs": several(effect["needs"]) or "nothing",
        "uses": f"{several(effect['rests_on']) or 'nothing'} of other effects in the model",
        "diagnose": "proposes it" if effect["proposed_by_diagnose"] else "never proposes it; a card may name it",
        "example": f"{' adds '.join(about)} ({example['source']})",
        "source": effect["source"],
    }
    for p in effect["parameters"]:
        name = f"{p['name']} [{plain_unit(p['unit'])}]"
        prior = f"{p['prior']['family']} {p['prior']['text']}\n({p['prior']['source']})"
        bounds = " to ".join(map(numbers, p["bounds"]))
        least, most = numbers(p["least_worth_modelling"]), numbers(p["largest_plausible"])
        rows.append((name, p["description"], numbers(p["neutral"]), bounds, prior, f"{least} to {most}"))
    head = "parameter", "what it is", "absent at", "bounds", "prior", "sizes worth\nmodelling"
    table = TextTable("", head, tuple(rows), words=(1, 3, 4, 5))
    return [Text(f"{effect['name']}: {effect['claim']}"), Facts(tuple(facts.items())), table]


def numbers(value: Any) -> str:
    if isinstance(value, Sequence):
        return f"({', '.join(map(numbers, value))})"
    return NONE if value is None else f"{value:g}"
