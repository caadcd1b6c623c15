"""What is wrong with one channel of one record, and the words that all kinds of fault share."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from bayes_aero.flight.card.card import Card
from bayes_aero.flight.channel import STANDARD_CHANNELS, Channel
from bayes_aero.flight.record import FlightRecord
from bayes_aero.units import instant, same_unit, to_si


@dataclass(frozen=True)
class HealthFinding:
    """One fault of one channel."""

    record: str
    channel: str  # "record" where all of them are meant
    fault: str  # short key of the kind of fault, e.g. "frozen"
    begin: float | None  # first time that is concerned, s, as in the record; None where it is the whole record
    end: float | None  # last such time, s
    sentence: str  # channel, when, what it looks like, how to mend it
    grave: bool  # whether results that rest on the channel cannot be trusted


Findings = Iterator[HealthFinding]


def only_following(health: Iterable[HealthFinding]) -> tuple[str, ...]:
    """Surfaces that only follow the outputs: no derivative with respect to them is known."""
    return tuple(dict.fromkeys(finding.channel for finding in health if finding.fault == "feedback"))


def found(
    record: FlightRecord,
    channel: str,
    fault: str,
    sentence: str,
    *,
    at: tuple[int, int] | None = None,
    grave: bool = True,
) -> HealthFinding:
    """A finding whose sentence begins with the record's name; `at` are its first and last sample."""
    begin, end = (None, None) if at is None else (float(record.time[at[0]]), float(record.time[at[1]]))
    return HealthFinding(record.name, channel, fault, begin, end, f"{record.name}: {sentence}", grave)


def declared(card: Card, name: str) -> Channel:
    """What the card says of a channel; of one that it does not map, the program's own unit."""
    for channel in card.channels:
        if channel.name == name:
            return channel
    standard = STANDARD_CHANNELS.get(name)
    return Channel(name, standard.unit if standard else "1")


def other_units(card: Card, name: str, units: Iterable[str]) -> Iterator[tuple[str, float]]:
    """Of these units those that the card does not state, and the factor by which SI values would be larger in them."""
    channel = declared(card, name)
    for unit in units:
        if same_unit(unit, channel.unit) is False:
            yield unit, float(to_si(1.0, unit, name, channel.si) / to_si(1.0, channel.unit, name, channel.si))


def as_filed(card: Card, name: str, values: np.ndarray | float) -> np.ndarray:
    """SI values of a channel in the unit and with the sign of the file, rounded to six digits to undo conversion."""
    channel = declared(card, name)
    raw = channel.filed(np.asarray(values, float))
    with np.errstate(all="ignore"):
        digits = 10.0 ** (5.0 - np.floor(np.log10(np.where(raw == 0.0, 1.0, np.abs(raw)))))
        return np.where(np.abs(raw) < 1e-9, 0.0, np.round(raw * digits) / digits)


def shown(card: Card, name: str, value: float, *, size: bool = False) -> str:
    """A value with the card's unit: "3.2 deg"; a size is without sign."""
    unit = declared(card, name).unit
    filed = float(as_filed(card, name, value))
    return f"{abs(filed) if size else filed:.4g}" + ("" if unit == "1" else f" {unit}")


def span(record: FlightRecord, first: int, last: int) -> str:
    """From when to when, in words."""
    return f"from {instant(record.time[first])} to {instant(record.time[last])} s"


# --- What was decided when the record was read.


def decided(record: FlightRecord, _card: Card) -> Findings:
    """Optional channels that no sound record could have and that were left out; text that could mean two things."""
    for name, why in record.dropped.items():
        yield found(record, name, "left_out", f"{why}; it is not required and was left out", grave=False)
    for remark in record.remarks:
        yield found(record, "record", "read", remark, grave=False)


# --- Records too short for the filters and for the motion of the aircraft.

ENDS = 30  # samples at both ends together that the smoother (7) and the differentiator (8) distort
SHARE = 0.25  # of a record that may be ends
CHORDS = 120.0  # lengths travelled: two short periods, or a separation and, at 20 to 30 chords, its reattachment
LEAST = 5.0  # s, where the card states no chord


def short(record: FlightRecord, card: Card) -> Findings:
    """A finding if the record is shorter than a manoeuvre must be to be identified by itself."""
    lasts = float(record.time[-1] - record.time[0])
    chord = float(card.aircraft.chord)
    speed = float(np.median(record["airspeed"])) if record.has("airspeed") else np.nan
    motion = CHORDS * chord / speed if np.isfinite(chord) and chord > 0.0 and speed > 5.0 else LEAST
    ends = 0.0 if card.linear is not None else ENDS / SHARE * record.dt  # a linear model is flown, nothing is filtered
    motion = min(motion, LEAST) if card.linear is not None else motion
    needed = max(motion, ends)
    if lasts >= needed:
        return
    why = (
        f"{CHORDS:.0f} chords of flight, in which an aircraft has answered a control and a stall has come and gone"
        if motion >= ends
        else f"{ENDS} samples at the ends, which the filters distort, must not be more than a quarter of it"
    )
    least, has = np.ceil(10.0 * needed) / 10.0, np.floor(10.0 * lasts) / 10.0  # never the same number
    sentence = (
        f"the record is too short: {has:g} s, and {least:g} s are needed ({why}); estimates can be off by "
        "several standard errors, so give the whole manoeuvre with some seconds of trimmed flight before it"
    )
    yield found(record, "record", "short", sentence, at=(0, record.n - 1))
