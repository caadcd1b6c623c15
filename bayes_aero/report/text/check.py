"""The findings of a check of records, for the terminal and for the page."""

from __future__ import annotations

from collections.abc import Mapping

from bayes_aero.diagnosis.consistency.check_result import CheckReport
from bayes_aero.flight.agreement import Agreement
from bayes_aero.flight.channel import STANDARD_CHANNELS
from bayes_aero.flight.reading.inspection import RecordReport
from bayes_aero.report.text.consistency import consistency_sentences
from bayes_aero.report.text.phrases import for_people, not_testable_sentences, number, several

MAX_PARTS = 12  # of a file in a sentence; the JSON has all


def part_sentences(record: RecordReport) -> list[str]:
    """The parts of a file that may be analysed in place of the whole, as they are written on the command line."""
    sentences = []
    for what, words in (("in flight", "parts in flight"), ("manoeuvre", "manoeuvres")):
        parts = [f"{record.path}@{p.part}" for p in record.proposals if p.what == what]
        if parts:
            more = f" and {len(parts) - MAX_PARTS} more" if len(parts) > MAX_PARTS else ""
            sentences.append(f"{words}: {', '.join(parts[:MAX_PARTS])}{more}")
    if sentences:
        sentences.append("give these parts instead of the file, or list them on the card under [segments]")
    return sentences


def unused_columns(report: CheckReport) -> list[tuple[str, ...]]:
    """Columns of each record that the card does not map; of records with the same ones, at the first of them."""
    seen: set[tuple[str, ...]] = set()
    return [() if r.unused in seen or seen.add(r.unused) else r.unused for r in report.records]


def card_sentences(report: CheckReport) -> list[str]:
    """Channels that the card adds to the files."""
    card = report.card
    sentences = [f"constant from the card: {name} = {value:g}{_behind(name)}" for name, value in card.constants.items()]
    for rule in dict.fromkeys(card.derived.values()):
        formed = ", ".join(name for name, of in card.derived.items() if of == rule)
        sentences.append(f"computed by the card's rule, where not recorded ({rule}): {formed}")
    sentences += [f"table from the card: {name} over {table.said}" for name, table in card.tables.items()]
    return sentences + [f"sum from the card: {name} = {_sum(parts)}" for name, parts in card.sums.items()]


def _sum(parts: Mapping[str, float]) -> str:
    """The parts of a sum, with the factors that are not 1."""
    sentences = [
        f"{'-' if k < 0 else '+'} {'' if abs(k) == 1.0 else f'{abs(k):g} '}{name}" for name, k in parts.items()
    ]
    return " ".join(sentences).removeprefix("+ ")


def _behind(channel: str) -> str:
    """The SI unit as it stands behind a number, where it is known."""
    unit = {"thrust": "N"} | {name: c.unit for name, c in STANDARD_CHANNELS.items()}
    return f" {unit[channel]}".removesuffix(" 1") if channel in unit else " in SI"


def use_sentences(report: CheckReport) -> list[str]:
    """Possible uses of the records, and effects that cannot be tested on them."""
    sentences = [
        f"{name}: possible" if not why else f"{name}: not possible, {why}" for name, why in report.uses.items()
    ]
    return [*report.left_out, *sentences, *not_testable_sentences(report.not_testable)]


def sensor_sentences(report: CheckReport) -> list[str]:
    """Whether the sensors agree, and errors that are found although they are within the noise."""
    sentences = consistency_sentences(report.consistency, corrects=False)
    if report.sensors.errors and not report.consistency.disagrees:
        sentences.append("Errors within this noise, which diagnose includes:")
    return sentences


def left_over(report: CheckReport) -> str:
    """Root mean square residual of the flight path by signal, before and after correction."""
    left, agree = [], not report.sensors.errors
    for name, (before, after) in report.sensors.rms.items():
        unit, factor = for_people(STANDARD_CHANNELS[name].unit)
        change = number(factor * before) if agree else f"{number(factor * before)} → {number(factor * after)}"
        left.append(f"{name} {change} {unit}")
    return f"root mean square residual: {', '.join(left)}"


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
