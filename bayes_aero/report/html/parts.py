"""Common parts of pages: the records at a glance, and the provenance."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from bayes_aero.flight.agreement import Agreement, Consistency
from bayes_aero.flight.axes import Axis
from bayes_aero.flight.card.card import Card
from bayes_aero.flight.channel import STANDARD_CHANNELS
from bayes_aero.flight.channel_units import channel_units
from bayes_aero.flight.health import HealthFinding
from bayes_aero.flight.record import FlightRecord
from bayes_aero.parameter import Parameter
from bayes_aero.report.html.page import Block, Facts, Fold, Plot, Points, Table, Text
from bayes_aero.report.html.plots import MOST, TIME, Over, Panel, linked
from bayes_aero.report.text.consistency import consistency_sentences
from bayes_aero.report.text.phrases import SYMBOLS, bracket, for_people, number, plain_unit, several

GLANCE = ("airspeed", "alpha", "altitude", "elevator", "q")
LATERAL_GLANCE = (
    "airspeed",
    "alpha",
    "beta",
    "altitude",
    "elevator",
    "aileron",
    "aileron_right",
    "rudder",
    "p",
    "q",
    "r",
)
MOST_SHOWN = 6  # manoeuvres whose time histories are on the page: each costs a browser a second on a phone


def at_a_glance(records: Sequence[FlightRecord], card: Card) -> tuple[Block, ...]:
    """Manoeuvres and recorded channels."""
    units = _glanced(card)
    shown = [name for name in units if any(record.has(name) for record in records)]
    heads = [f"{_name(name)}\n{bracket(for_people(units[name])[0])}" for name in shown]
    rows = [
        (
            record.name,
            f"{record.time[-1] - record.time[0]:.1f}",
            str(record.n),
            f"{1.0 / record.dt:.4g}",
            str(len(record.channels)),
            *(_range(record, name, units[name]) for name in shown),
        )
        for record in records
    ]
    channels = sorted({name for record in records for name in record.channels})
    total = sum(float(record.time[-1] - record.time[0]) for record in records)
    many = f"{len(records)} manoeuvres" if len(records) > 1 else "One manoeuvre"
    return (
        Text(f"{many}, {total:.0f} s in all. Aircraft and model: {card.title} (card “{card.name}”)."),
        Table(
            "Records: smallest to largest value of the main channels",
            ("record", "duration\n[s]", "samples", "rate\n[Hz]", "channels", *heads),
            tuple(rows),
        ),
        Fold("Channels and signs", (Facts(tuple((n, _described(n)) for n in channels)), Text(conventions(card)))),
    )


def records_and_faults(
    records: Sequence[FlightRecord], card: Card, health: Sequence[HealthFinding]
) -> tuple[Block, ...]:
    """`at_a_glance`, and faults of channels that no result uses; the other faults are in `doubts`."""
    minor = bullets([f"{finding.sentence}." for finding in health if not finding.grave])
    return (*minor, *at_a_glance(records, card))


def doubts(
    health: Sequence[HealthFinding],
    agreement: Consistency | None,
    *,
    corrects: bool,
    failures: Sequence[str] = (),
) -> tuple[Text, ...]:
    """First part of a page: failed parts of the job, disagreement of the sensors, and faulty channels."""
    faults = (Text(f"{finding.sentence}.", "warning") for finding in health if finding.grave)
    failed = (Text(sentence, "warning") for sentence in failures)
    return (*failed, *consistency_lead(agreement, corrects=corrects), *faults)


def consistency_lead(found: Consistency | None, *, corrects: bool) -> tuple[Text, ...]:
    """Disagreement of the sensors, or why it could not be checked."""
    if found is None or found.agreement is Agreement.AGREE:
        return ()
    answer = consistency_sentences(found, corrects=corrects)[0]
    return (Text(answer, "warning") if found.disagrees else Text(answer),)


def _glanced(card: Card) -> dict[str, str]:
    """Main channels with their SI units: those of most flights, or those of a linear card's rows."""
    if card.linear is None:
        names = LATERAL_GLANCE if Axis.LATERAL in card.axes else GLANCE
        return {name: STANDARD_CHANNELS[name].unit for name in names}
    rows, units = card.linear, channel_units(card)
    return {name: units[name] for name in (*rows.states, *rows.outputs, *rows.inputs)}


AXES = "Body axes: x forward, y right, z down. Elevator trailing edge down is positive"
CONVENTIONS = (
    f"{AXES}, so Cmde is negative. CL and CD are in stability axes about the centre of gravity, Cm about the "
    "aerodynamic reference point. Pitch rate enters as q c/V (many texts use q c/2V, which doubles Cmq). tau1 and tau2 "
    "are in chords travelled: times c/V they are seconds."
)


LATERAL_CONVENTIONS = (
    " Sideslip is positive from the right. A positive aileron has the right trailing edge down, a positive rudder the "
    "trailing edge left, so Clda and Cndr are negative. p and r enter as p l/V and r l/V, l the card's "
    "lateral_rate_length (half the span, unless it states another)."
)


def conventions(card: Card) -> str:
    """Axes and signs of the card's model."""
    if card.linear is None:
        return CONVENTIONS + (LATERAL_CONVENTIONS if Axis.LATERAL in card.axes else "")
    return f"{AXES}. Derivatives are dimensional, in SI and radians, and multiply whole channels, not departures."


def _name(channel: str) -> str:
    words = {"p": "roll rate p", "q": "pitch rate q", "r": "yaw rate r", "aileron_right": "right aileron"}
    symbol = SYMBOLS.get(channel, channel)
    return words.get(channel, channel if symbol == channel else f"{channel} {symbol}")


def _range(record: FlightRecord, name: str, unit: str) -> str:
    if not record.has(name):
        return "–"
    factor = for_people(unit)[1]
    low, high = (factor * float(f(record[name])) for f in (np.min, np.max))
    places = 0 if abs(high) >= 1000.0 else 1
    return f"{low:.{places}f} to {high:.{places}f}"


def _described(name: str) -> str:
    if name not in STANDARD_CHANNELS:
        return "a channel of the card's own"
    channel = STANDARD_CHANNELS[name]
    return f"{channel.description} [{plain_unit(for_people(channel.unit)[0])}]"


def symbols(
    parameters: Iterable[Parameter], names: Iterable[str], said: str = CONVENTIONS, *, degrees: bool = False
) -> Fold:
    """Meaning of each parameter, and the conventions; `degrees` where the page shows angles in degrees."""
    known = {p.name: p for p in parameters}
    units = {name: for_people(p.unit)[0] if degrees else p.unit for name, p in known.items()}
    facts = [(f"{n} [{plain_unit(units[n])}]", known[n].description) for n in names if n in known]
    return Fold("What the parameters mean", (Facts(tuple(facts)), Text(said)))


def first(names: Sequence[str]) -> tuple[Sequence[str], tuple[Block, ...]]:
    """The manoeuvres whose time histories are shown, and the sentence that says so where there are more."""
    if len(names) <= MOST_SHOWN:
        return names, ()
    return names[:MOST_SHOWN], (Text(f"The first {MOST_SHOWN} of {len(names)} manoeuvres are shown."),)


def histories(
    name: str,
    key: str,
    time: np.ndarray,
    panels: Sequence[Panel],
    legend: tuple[tuple[str, str, str], ...],
    what: str,
    over: Over = TIME,
) -> Plot:
    """One manoeuvre's panels; `what` begins the words that describe them."""
    labels = several(panel.label for panel in panels)
    thinned = (
        f"Drawn from {len(time)} samples, thinned so that every peak stays (least and largest value of each stretch)."
        if len(time) > MOST
        else ""
    )
    spans = "; ".join(
        f"{panel.label} from {number(float(np.nanmin(panel.lines[0].values)))} to "
        f"{number(float(np.nanmax(panel.lines[0].values)))}"
        for panel in panels
    )
    return Plot(
        item=linked(time - time[0], panels, key, over),
        legend=legend,
        alt=f"{what} of {name} over {time[-1] - time[0]:.0f} {over.unit}: {labels}. Measured: {spans}.",
        caption=thinned,
        title=name,
    )


def provenance_blocks(source: Mapping[str, Any], notes: Sequence[str] = (), seconds: Mapping[str, float] | None = None):
    """Inputs, versions and the command, which reproduce the run."""
    inputs = tuple((i["name"], i["source"], i["sha256"] or "–") for i in source.get("inputs", ()))
    cards = tuple((str(c["name"]), "card", str(c["sha256"])) for c in (source.get("card"),) if c)
    files = tuple((f["name"], "effects", f["sha256"]) for f in source.get("effect_files", ()))
    facts = [
        ("Command", str(source.get("command", "–"))),
        *([("Seed", str(source["seed"]))] if "seed" in source else []),
        *((str(k).replace("_", " "), str(v)) for k, v in dict(source.get("settings", {})).items()),
        ("Written", str(source.get("written", "–"))),
        *((str(k), str(v)) for k, v in dict(source.get("platform", {})).items()),
    ]
    blocks: list[Block] = [Text(note, "warning") for note in notes]
    blocks += [
        Facts(tuple(facts)),
        *_inputs((*inputs, *cards, *files)),
        Fold("Versions", (Facts(tuple((k, str(v)) for k, v in dict(source.get("versions", {})).items())),)),
    ]
    if seconds:
        spent = several(f"{stage} {number(float(s), 2)} s" for stage, s in seconds.items())
        blocks.append(Text(f"Time spent: {spent}."))
    return tuple(blocks)


def _inputs(rows: tuple[tuple[str, str, str], ...]) -> tuple[Block, ...]:
    return (Table("Inputs", ("name", "file", "SHA-256"), rows, words=(1, 2)),) if rows else ()


def bullets(items: Iterable[str]) -> tuple[Block, ...]:
    """A list, or nothing."""
    given = tuple(items)
    return (Points(given),) if given else ()
