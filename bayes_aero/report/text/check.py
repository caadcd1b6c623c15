"""The findings of a check of records, for the terminal and for the page."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from bayes_aero.diagnosis.result import CheckReport
from bayes_aero.flight.channel import STANDARD_CHANNELS
from bayes_aero.flight.health import Agreement, Consistency, OpenError
from bayes_aero.flight.reading import RecordReport
from bayes_aero.report.text.phrases import WORDS, for_people, not_testable_sentences, several, size_text, unit_behind
from bayes_aero.units import instant, number

MAX_PARTS = 12  # of a file in a sentence; the JSON has all


def part_sentences(record: RecordReport) -> list[str]:
    """The parts of a file that may be analysed in place of the whole, as they are written on the command line."""
    sentences = []
    for what, words in (("in flight", "parts in flight"), ("manoeuvre", "manoeuvres")):
        if parts := [f"{record.path}@{p.part}" for p in record.proposals if p.what == what]:
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
    card, units = report.card, {"thrust": "N"} | {name: c.unit for name, c in STANDARD_CHANNELS.items()}
    behind = {name: f" {units[name]}".removesuffix(" 1") if name in units else " in SI" for name in card.constants}
    sentences = [f"constant from the card: {name} = {x:g}{behind[name]}" for name, x in card.constants.items()]
    for rule in dict.fromkeys(card.derived.values()):
        formed = ", ".join(name for name, of in card.derived.items() if of == rule)
        sentences.append(f"computed by the card's rule, where not recorded ({rule}): {formed}")
    sentences += [f"table from the card: {name} over {table.said}" for name, table in card.tables.items()]
    for name, parts in card.sums.items():
        factors = [("-" if k < 0 else "+", "" if abs(k) == 1.0 else f"{abs(k):g} ", part) for part, k in parts.items()]
        terms = " ".join(f"{sign} {factor}{part}" for sign, factor, part in factors).removeprefix("+ ")
        sentences.append(f"sum from the card: {name} = {terms}")
    return sentences


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
    left, shown = [], slice(1 if not report.sensors.errors else 2)
    for name, pair in report.sensors.rms.items():
        unit, factor = for_people(STANDARD_CHANNELS[name].unit)
        left.append(f"{name} {' → '.join(number(factor * x) for x in pair[shown])} {unit}")
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


# --- Agreement of the sensors, in sentences: printed first, and first on a page.

SHOWN = 4  # departures in the sentence


def consistency_sentences(found: Consistency, *, corrects: bool) -> list[str]:
    """The answer, then its limits. `corrects`: whether the command corrects known sensor errors by itself."""
    if found.agreement is Agreement.NOT_CHECKED:
        return [f"Whether the sensors agree was not checked: {found.why_not}."]
    sentences = [_answer(found, corrects=corrects)]
    if found.unchecked:  # channels that could not be checked, and channels that were taken as zero
        verb = "were" if len(found.unchecked) > 1 else "was"
        sentences.append(
            f"{several(found.unchecked)} {verb} not recorded and could not be checked along the flight path."
        )
    if assumed := dict.fromkeys(name for check in found.recorded for name in check.assumed):
        sentences.append(f"Not recorded, and taken as zero along the flight path: {several(assumed)}.")
    return [*sentences, *open_sentences(found)]


def _answer(found: Consistency, *, corrects: bool) -> str:
    if found.agreement is Agreement.AGREE:
        return "The sensors agree along the flight path within their noise."
    where, listed = departures_sentence(found), []
    for name, error in (found.errors or {}).items():
        joint = joint_text(error.get("joint", {}))
        together = f"; estimated together with {joint}: neither holds alone" if joint else ""
        listed.append(f"{name} ({sizes(error)}{together})")
    errors = several(listed)
    if found.agreement is Agreement.EXPLAINED:
        mend = "it is corrected here" if corrects else "it is not corrected here; diagnose corrects it"
        return (
            f"The sensors disagree along the flight path, and a known error explains it ({mend}): {errors}. "
            f"As recorded, {where}."
        )
    beside = f", after correction for {errors}" if errors else ""
    unsought = f" Known errors could not be tested: {found.unsought}." if found.unsought else ""
    return (
        f"The sensors disagree along the flight path, and no known sensor error explains it: {where}{beside}. "
        f"Repair or recalibrate the channel, or cut the record there; the results depend on it.{unsought}"
    )


def joint_text(joint: Mapping[str, float]) -> str:
    """Other errors with the correlation of the estimates."""
    return several(f"{other} (correlation {correlation:+.2f})" for other, correlation in joint.items())


def departures_sentence(found: Consistency) -> str:
    """The departures with their sizes, the largest first."""
    departures, listed = sorted(found.departures, key=lambda d: -d.rms / d.permitted), []
    for d in departures[:SHOWN]:
        standard = STANDARD_CHANNELS[d.channel]
        unit, factor = for_people(standard.unit)
        listed.append(
            f"{d.channel} ({standard.description}) of {d.record} does not follow {WORDS['follows'][d.channel]} from "
            f"{instant(d.begin)} to {instant(d.end)} s, by {factor * d.rms:.2g} {unit} root mean square (noise permits "
            f"{factor * d.permitted:.2g} {unit})"
        )
    listed += [f"and {len(departures) - SHOWN} more"] if len(departures) > SHOWN else []
    return "; ".join(listed)


def open_sentences(found: Consistency) -> list[str]:
    """Sensor errors that the flight path does not determine: fitted but not confirmed, then not testable."""
    sentences = []
    if asked := [e for e in found.open if e.asked]:
        alike = {True: "those are", False: "that is"}
        imitated = {
            e.name: f" (not distinguishable from {several(e.imitators)}: ± {among_text(e)} if "
            f"{alike[len(e.imitators) > 1]} possible)"
            for e in asked
            if e.imitators
        }
        listed = "; ".join(f"{_estimate(e)}{imitated.get(e.name, '')}" for e in asked)
        sentences.append(
            "Errors that would explain much of the residual of the flight path, but that hold-out data do not "
            f"confirm, each as the only error; none is corrected: {listed}."
        )
    if either := [e for e in found.open if e.imitators and e.name in (found.errors or {})]:
        listed = "; ".join(
            f"{e.name} or {several(e.imitators)} (± {among_text(e)} of {e.name} if all are possible)" for e in either
        )
        sentences.append(f"Errors that were found, and others with the same effect along this flight path: {listed}.")
    if joint := [e for e in found.open if e.joint]:
        listed = "; ".join(f"{_estimate(e)}, together with {joint_text(e.joint)}" for e in joint)
        sentences.append(
            "Errors that were estimated together, one of them larger than sensors have, so that none of them is a "
            f"correction by itself: {listed}. Suspect another fault of these channels."
        )
    if alike := not_told_apart(found):
        errors = "errors of sensors or winds are" if len(alike) > 1 else "error of a sensor or wind is"
        sentences.append(
            f"{len(alike)} {errors} not testable along this flight path, because others have the same effect on the "
            f"record: {several(e.name for e in alike)}."
        )
    return sentences


def not_told_apart(found: Consistency) -> list[OpenError]:
    """Errors that are not testable, for others have the same effect; those that were found say so themselves."""
    return [e for e in found.open if not e.asked and not e.joint and e.name not in (found.errors or {})]


def _estimate(error: OpenError) -> str:
    return f"{error.name} {size_text(error.mean, error.sd, error.unit)}"


def among_text(error: OpenError) -> str:
    """The standard error of an error with its imitators possible, as people read it."""
    unit, factor = for_people(error.unit)
    return f"{factor * error.among:.2g}{unit_behind(unit)}"


def sizes(error: Mapping[str, Any]) -> str:
    """A sensor error's parameters with their standard errors."""
    listed = error["parameters"].items()
    return ", ".join(f"{name} {size_text(size['mean'], size['sd'], size['unit'])}" for name, size in listed)


# --- The facts of an effect of the catalogue, for the terminal and for the page.


def facts(effect: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Name and text of what holds for the effect as a whole; `effect` as the catalogue describes it."""
    channel = effect["stage"] == "channel"
    stage = "acts on the recorded channels" if channel else f"acts at the stage {effect['stage']}"
    sentences = [
        ("kind", f"{effect['kind']}; {stage}"),
        ("axes", " and ".join(effect["axes"])),
        ("formula", " ".join(effect["formula"].split()) or "not stated"),
        ("needs", ", ".join(effect["needs"]) or "nothing"),
    ]
    if effect["rests_on"]:
        sentences.append(("uses", ", ".join(effect["rests_on"]) + " of other effects in the model"))
    if effect["model"] is not None:
        sentences.append(("card", "in the card's model" if effect["model"] else "not in the card's model"))
    if not effect["proposed_by_diagnose"]:
        sentences.append(("diagnose", "never proposes it; a card may name it"))
    return sentences


def parameter_facts(p: Mapping[str, Any]) -> list[tuple[str, str]]:
    """The same of one of its parameters, beside its description."""
    unit = unit_behind(p["unit"])
    sentences = [
        ("neutral", f"{shown(p['neutral'])}{unit}: there the effect is absent"),
        ("bounds", f"{shown(p['bounds'][0])} to {shown(p['bounds'][1])}"),
        ("prior", f"{p['prior']['text']} ({p['prior']['source']})"),
    ]
    if p["least_worth_modelling"] is not None:
        least, most = shown(p["least_worth_modelling"]), shown(p["largest_plausible"])
        sentences.append(("sizes", f"smallest worth modelling {least} from neutral, largest plausible {most}"))
    return sentences


def worked(effect: Mapping[str, Any]) -> str:
    """The worked example in a sentence."""
    example = effect["example"]
    known = example["parameters"] | example["signals"] | example["known"]
    return f"{_pairs(known)} adds {_pairs(example['increments'])} ({example['source']})"


def _pairs(values: Mapping[str, Any]) -> str:
    return ", ".join(f"{name} = {shown(value)}" for name, value in values.items())


def shown(value: Any) -> str:
    """A number, or numbers in brackets."""
    if isinstance(value, Sequence):
        return "(" + ", ".join(shown(x) for x in value) + ")"
    if math.isinf(value):
        return "-infinity" if value < 0.0 else "infinity"
    return f"{value:g}"
