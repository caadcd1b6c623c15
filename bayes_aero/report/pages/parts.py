"""What pages share: whether the sensors agree, records at a glance, time histories, the stall, provenance."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from bayes_aero.flight.card import Card, channel_units
from bayes_aero.flight.channel import STANDARD_CHANNELS
from bayes_aero.flight.health import Agreement, Consistency, HealthFinding, OpenError
from bayes_aero.physics.aircraft import Axis
from bayes_aero.report.page import Facts, Fold, Plot, Section, Text, fold, section
from bayes_aero.report.phrases import (
    WORDS,
    axis_label,
    for_people,
    plain_unit,
    sentence,
    several,
    size_text,
    unit_behind,
)
from bayes_aero.report.plots import LOW, MOST, Panel, linked, measured_panel
from bayes_aero.report.table import TextTable
from bayes_aero.units import instant, number

if TYPE_CHECKING:
    from pathlib import Path

    from bayes_aero.flight.record import FlightRecord
    from bayes_aero.inference.results import Interval, Stall
    from bayes_aero.parameter import Parameter

DEG = 180.0 / np.pi

SHOWN = 4  # departures in the sentence
GLANCE = ("airspeed", "alpha", "altitude", "elevator", "q")
LATERAL_GLANCE = (
    "airspeed", "alpha", "beta", "altitude", "elevator", "aileron", "aileron_right", "rudder", "p", "q", "r",
)  # fmt: skip
MOST_SHOWN = 6  # manoeuvres whose time histories are on the page: each costs a browser a second on a phone
CONTEXT = ("alpha", "elevator", "stabilizer", "q", "thrust", "airspeed")
SIX_CONTEXT = ("alpha", "beta", "elevator", "aileron", "rudder", "p")
MOST_PLACES = 6  # digits behind the point


def consistency_sentences(sensors: Consistency, *, corrects: bool) -> list[str]:
    """The answer, then its limits. `corrects`: whether the command corrects known sensor errors by itself."""
    if sensors.agreement is Agreement.NOT_CHECKED:
        return [sentence("not_checked", why=sensors.why_not)]
    sentences = [_answer(sensors, corrects=corrects)]
    if sensors.unchecked:  # channels that could not be checked, and channels that were taken as zero
        sentences.append(sentence("unchecked", channels=sensors.unchecked))
    if assumed := dict.fromkeys(name for check in sensors.recorded for name in check.assumed):
        sentences.append(sentence("taken_as_zero", channels=assumed))
    return [*sentences, *open_sentences(sensors)]


def _answer(sensors: Consistency, *, corrects: bool) -> str:
    if sensors.agreement is Agreement.AGREE:
        return sentence("agree")
    departures, listed = sorted(sensors.departures, key=lambda d: -d.rms / d.permitted), []
    for d in departures[:SHOWN]:  # the largest first
        standard = STANDARD_CHANNELS[d.channel]
        unit, factor = for_people(standard.unit)
        span = {"begin": instant(d.begin), "end": instant(d.end), "follows": WORDS["follows"][d.channel], "unit": unit}
        sizes = {"rms": factor * d.rms, "permitted": factor * d.permitted, "description": standard.description}
        listed.append(sentence("departure", d=d, **span, **sizes))
    listed += [f"and {len(departures) - SHOWN} more"] if len(departures) > SHOWN else []
    where, errors, names = "; ".join(listed), [], dict.fromkeys(d.channel for d in departures)
    for name, error in (sensors.errors or {}).items():
        joint = joint_text(error.get("joint", {}))
        together = f"; estimated together with {joint}: neither holds alone" if joint else ""
        errors.append(f"{name} ({error_sizes(error)}{together})")
    if sensors.agreement is Agreement.EXPLAINED:
        mend = "It is corrected here" if corrects else "It is not corrected here, diagnose corrects it"
        names = list(sensors.errors or {})
        return sentence("disagree_explained", names=names, mend=mend, errors=errors, where=where)
    beside = f", after correction for {several(errors)}" if errors else ""
    unsought = f" Known errors could not be tested: {sensors.unsought}." if sensors.unsought else ""
    return sentence("disagree_unexplained", names=names, where=where, beside=beside, unsought=unsought)


def joint_text(joint: Mapping[str, float]) -> str:
    return several(f"{other} (correlation {correlation:+.2f})" for other, correlation in joint.items())


def open_sentences(sensors: Consistency) -> list[str]:
    """Sensor errors that the flight path does not determine: fitted but not confirmed, then not testable."""
    sentences, sizes = [], {e.name: f"{e.name} {size_text(e.mean, e.sd, e.unit)}" for e in sensors.open}
    if sought := [e for e in sensors.open if e.asked]:
        imitated = {e.name: sentence("imitated", e=e, among=_among(e)) if e.imitators else "" for e in sought}
        listed = "; ".join(f"{sizes[name]}{others}" for name, others in imitated.items())
        sentences.append(sentence("unconfirmed", names=[e.name for e in sought], listed=listed))
    if either := [e for e in sensors.open if e.imitators and e.name in (sensors.errors or {})]:
        listed = (f"{e.name} or {several(e.imitators)} (± {_among(e)} of {e.name} if all are possible)" for e in either)
        sentences.append(sentence("same_effect", listed="; ".join(listed)))
    if joint := [e for e in sensors.open if e.joint]:
        listed = (f"{sizes[e.name]}, together with {joint_text(e.joint)}" for e in joint)
        sentences.append(sentence("together", listed="; ".join(listed)))
    # not testable, for others have the same effect; those that were found say so themselves
    rest = [e for e in sensors.open if not e.asked and not e.joint and e.name not in (sensors.errors or {})]
    if alike := [e.name for e in rest]:
        sentences.append(sentence("alike", n=len(alike), names=alike))
    return sentences


def _among(error: OpenError) -> str:
    """The standard error of an error with its imitators possible, as people read it."""
    unit, factor = for_people(error.unit)
    return f"{factor * error.among:.2g}{unit_behind(unit)}"


def error_sizes(error: Mapping[str, Any]) -> str:
    listed = error["parameters"].items()
    return ", ".join(f"{name} {size_text(size['mean'], size['sd'], size['unit'])}" for name, size in listed)


def warnings(sentences: Iterable[str]) -> list[Text]:
    return [Text(text, "warning") for text in sentences]


# --- The first block of a screen: whether the record is fit for use, or what to mend first.

MOST_FAULTS = 2  # lines
MOST_FILES = 3  # that are named


def fault_lines(health: Iterable[HealthFinding]) -> list[tuple[str, str]]:
    """One line for all faults of a kind, over records and channels, and how to mend it."""
    by_kind: dict[str, list[HealthFinding]] = {}
    for finding in health:
        by_kind.setdefault(finding.fault, []).append(finding)
    lines = []
    for same in by_kind.values():
        records, claims = (list(dict.fromkeys(x)) for x in ([f.record for f in same], [f.claim for f in same]))
        if len(claims) == 1:
            where = sentence("in_records", n=len(records))
            text = f"{claims[0]} {where}." if len(records) > 1 else f"{records[0]}: {claims[0]}."
        else:
            channels = several(dict.fromkeys(f.channel for f in same), SHOWN)
            text = sentence("more_of_kind", claim=f"{same[0].record}: {claims[0]}", n=len(same) - 1, channels=channels)
        lines.append((text, same[0].mend))
    return lines


def record_block(
    records: Sequence[FlightRecord],
    health: Sequence[HealthFinding],
    sensors: Consistency | None,
    problems: Sequence[str] = (),
    *,
    corrects: bool = False,
) -> tuple[list[str], list[str]]:
    """Whether the records can be trusted, in lines, and what to mend first. `problems`: why some cannot be used."""
    grave, harmless = fault_lines(f for f in health if f.grave), sum(not f.grave for f in health)
    answer = [] if sensors is None else consistency_sentences(sensors, corrects=corrects)[:1]
    explained = sensors is not None and corrects and sensors.agreement is Agreement.EXPLAINED
    disagree = sensors is not None and sensors.disagrees and not explained
    seconds = number(sum(float(r.time[-1] - r.time[0]) for r in records), 3)
    rates = several(dict.fromkeys(f"{1.0 / r.dt:.3g}" for r in records))
    size = sentence("records_size", n=len(records), seconds=seconds, rates=rates) if records else "."
    lines = [WORDS["records"]["not_fit" if grave or problems else "in_doubt" if disagree else "fit"] + size]
    lines += [*problems[:MOST_FAULTS], *(text for text, _ in grave[:MOST_FAULTS])]
    lines += [sentence("more_faults", n=len(grave) - MOST_FAULTS)] if len(grave) > MOST_FAULTS else []
    lines += [getattr(text, "claim", text) for text in answer]
    lines += [sentence("harmless", n=harmless)] if harmless else []
    repairs = [*(do for _, do in grave), *(getattr(text, "do", "") for text in answer if disagree)]
    return lines, [do for do in repairs if do]


def given(records: Sequence[FlightRecord], card: Card) -> str:
    """Records and card as the next command is given them; `RECORDS` for many, and for what is in no file."""
    paths = dict.fromkeys(f"{r.read['path']}{'@' * bool(r.read['part'])}{r.read['part']}" for r in records if r.read)
    whole = all(r.read and not r.read["windows"] for r in records)
    listed = [shlex.quote(path) for path in paths] if whole and len(paths) <= MOST_FILES else ["RECORDS"]
    again = dict.fromkeys(f"--resample {r.read['resample']:g}" for r in records if r.read and r.read["resample"])
    return " ".join([*listed, "--model", shlex.quote(card.path or card.name), *again])


class PageContext(NamedTuple):
    """What a page shows: card, records, provenance, drawn figures by stem, and the result of the job."""

    card: Card
    records: Sequence[FlightRecord]
    source: Mapping[str, Any]
    figures: Mapping[str, Path]
    result: Any  # with `notes`, `consistency`, `failures`, `health`, and what its page shows


def at_a_glance(records: Sequence[FlightRecord], card: Card) -> tuple[Any, ...]:
    """Manoeuvres and recorded channels: the main ones are those of most flights, or of a linear card's rows."""
    names = LATERAL_GLANCE if Axis.LATERAL in card.axes else GLANCE
    units = {name: STANDARD_CHANNELS[name].unit for name in names}
    if (rows := card.linear) is not None:
        units = {name: channel_units(card)[name] for name in (*rows.states, *rows.outputs, *rows.inputs)}
    shown = [name for name in units if any(record.has(name) for record in records)]
    heads = [axis_label(name, units[name]).replace(" [", "\n[") for name in shown]
    seconds, lines = [float(record.time[-1] - record.time[0]) for record in records], []
    for r, s in zip(records, seconds, strict=True):
        ranges = []
        for name in shown:
            low, high = (for_people(units[name])[1] * f(r[name]) for f in (np.min, np.max)) if r.has(name) else (0, 0)
            places = 0 if abs(high) >= 1000.0 else 1
            ranges.append(f"{low:.{places}f} to {high:.{places}f}" if r.has(name) else "–")
        lines.append((r.name, f"{s:.1f}", str(r.n), f"{1.0 / r.dt:.4g}", str(len(r.channels)), *ranges))
    many = f"{len(records)} manoeuvres" if len(records) > 1 else "One manoeuvre"
    title = "Records: smallest to largest value of the main channels"
    head = ("record", "duration\n[s]", "samples", "rate\n[Hz]", "channels", *heads)
    return (
        f"{many}, {sum(seconds):.0f} s in all. Aircraft and model: {card.title} (card “{card.name}”).",
        TextTable(title, head, tuple(lines)),
    )


def records_section(card: Card, records: Sequence[FlightRecord], health: Sequence[HealthFinding]) -> Section:
    """`at_a_glance`, and all faults of channels."""
    grave, minor = ([f"{finding.sentence}." for finding in health if finding.grave is x] for x in (True, False))
    return section("records", "The records at a glance", lambda: (warnings(grave), minor, at_a_glance(records, card)))


def symbols(card: Card, parameters: Iterable[Parameter], names: Iterable[str], *, degrees: bool = False) -> Fold | None:
    """Meaning of each parameter, axes and signs of the card's model; `degrees` where the page shows angles so."""
    by_name, key = {p.name: p for p in parameters}, "lateral" if Axis.LATERAL in card.axes else ""
    units = {name: for_people(p.unit)[0] if degrees else p.unit for name, p in by_name.items()}
    facts = [(f"{n} [{plain_unit(units[n])}]", by_name[n].description) for n in names if n in by_name]
    about = WORDS["conventions"]
    signs = about["linear"] if card.linear is not None else f"{about['model']} {about.get(key, '')}"
    return fold("What the parameters mean", Facts(tuple(facts)), signs)


def not_testable_list(reasons: Mapping[str, str]) -> Fold | None:
    listed: dict[str, list[str]] = {}
    for name, reason in reasons.items():
        listed.setdefault(reason, []).append(name)
    rows = tuple((reason, ", ".join(names)) for reason, names in listed.items())
    table = TextTable("Effects that are not testable on this record", ("reason", "effects"), rows, words=(1,))
    return fold(f"The {len(reasons)} effects that are not testable", table if rows else None)


def terms(table: str) -> Fold | None:
    return fold("Terms used here", Facts(tuple(WORDS[table].items())))


def context_panels(channels: Mapping[str, Any], mine: np.ndarray, *, lateral: bool) -> list[Panel]:
    """Low panels of measured channels (SI) that moved in the samples `mine`, below those of outputs."""
    recorded = {n: np.asarray(channels[n], float)[mine] for n in (SIX_CONTEXT if lateral else CONTEXT) if n in channels}
    return [measured_panel(name, values, height=LOW) for name, values in recorded.items() if np.ptp(values) > 0.0]


def histories(name: str, key: str, time: np.ndarray, panels: Sequence[Panel], what: str) -> Plot:
    """One manoeuvre's panels, the first of which has the curves of the legend; `what` begins the words on them."""
    lines = panels[0].lines
    legend = [(line.label, line.colour, line.style) for line in lines]
    errors = [lines[k] for first, k in panels[0].shade if not first]
    legend += [(f"error of the {line.label}", line.colour, "area") for line in errors]
    legend += [("tolerance", "#999999", "area")] if any(panel.band is not None for panel in panels) else []
    alt = f"{what} of {name} over {time[-1] - time[0]:.0f} s: {several(p.label for p in panels)}."
    caption = sentence("thinned", n=len(time)) if len(time) > MOST else ""
    return Plot(linked(time - time[0], panels, key), tuple(dict.fromkeys(legend)), alt, caption, name)


def flights(
    names: Sequence[str], key: str, what: str, drawn: Callable[[int, str], tuple[np.ndarray, Sequence[Panel]]]
) -> list[Any]:
    """The `histories` of the first manoeuvres, of which `drawn` gives time and panels, and whether there are more."""
    shown = [(name, f"time-{key}-{k}", *drawn(k, name)) for k, name in enumerate(names[:MOST_SHOWN])]
    more = f"The first {MOST_SHOWN} of {len(names)} manoeuvres are shown." if len(names) > MOST_SHOWN else ""
    return [more, *(histories(*each, what) for each in shown)]


def interval(value: Interval, factor: float = 1.0, places: int = 3) -> str:
    """Median and 95 % interval, with more digits where these many show no width."""
    low, middle, high = (factor * x for x in (value.low, value.median, value.high))
    while places < MOST_PLACES and low < high and f"{low:.{places}f}" == f"{high:.{places}f}":
        places += 1
    return f"{middle:.{places}f} ({low:.{places}f} to {high:.{places}f})"


def stall_table(stalls: Mapping[str, Stall], what: str) -> tuple[TextTable | Text, ...]:
    """CLmax and its angle for each model, with a warning where the record does not show them."""
    rows, limits = [], []
    for label, s in stalls.items():
        edge = f"{s.at_edge:.0%}" if s.at_edge in (0.0, 1.0) or s.at_edge >= 0.01 else "< 1%"
        peak, angle = interval(s.CL_max), interval(s.alpha_max, DEG, 1)
        if not s.seen:
            peak = f"at least {peak}"
            angle = "not shown by this record" if s.at_edge > 0.5 else f"at least {angle}"
            limits.append(sentence("stall_unseen", label=f"{label[:1].upper()}{label[1:]}", share=s.at_edge))
        rows.append((label, peak, angle, f"{s.alpha[0] * DEG:.1f} to {s.alpha[-1] * DEG:.1f}", edge))
    reference = next(iter(stalls.values())).reference
    shown = (("airspeed", "V", 1.0, "m/s"), ("mach", "Mach", 1.0, ""), ("elevator", "elevator", DEG, "deg"))
    held = [f"{name} {number(reference[key] * x)} {unit}".strip() for key, name, x, unit in shown if key in reference]
    table = TextTable(
        "Steady stall: highest lift coefficient and its angle of attack, with 95 % intervals",
        ("model", "CLmax [-]", "at α [deg]", "α flown [deg]", "maximum at\nthe edge"),
        tuple(rows),
        words=(1, 2),
        note=sentence("stall_note", held=", ".join(held), what=what),
    )
    return (table, *warnings(limits))


def provenance_section(
    source: Mapping[str, Any],
    notes: Sequence[str] = (),
    seconds: Mapping[str, float] | None = None,
    *,
    folded: bool = False,
) -> Section:
    """The last section of every page: what reproduces the run, with notes before it."""
    title = "Inputs, versions and the command that repeat the run"

    def make() -> Any:
        inputs = [(i["name"], i["source"], i["sha256"] or "–") for i in source.get("inputs", ())]
        inputs += [(str(c["name"]), "card", str(c["sha256"])) for c in (source.get("card"),) if c]
        inputs += [(f["name"], "effects", f["sha256"]) for f in source.get("effect_files", ())]
        facts = {"Command": source.get("command", "–")} | ({"Seed": source["seed"]} if "seed" in source else {})
        facts |= {str(k).replace("_", " "): v for k, v in dict(source.get("settings", {})).items()}
        facts |= {"Written": source.get("written", "–")} | dict(source.get("platform", {}))
        spent = several(f"{stage} {number(float(s), 2)} s" for stage, s in (seconds or {}).items())
        made = (
            warnings(notes),
            Facts(tuple((str(k), str(v)) for k, v in facts.items())),
            TextTable("Inputs", ("name", "file", "SHA-256"), tuple(inputs), words=(1, 2)) if inputs else None,
            fold("Versions", Facts(tuple((k, str(v)) for k, v in dict(source.get("versions", {})).items()))),
            f"Time spent: {spent}." if spent else None,
        )
        return fold(title, made) if folded else made

    return section("provenance", "Provenance", make)
