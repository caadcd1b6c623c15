"""What is wrong with one channel of one record, and the words that all kinds of fault share."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from bayes_aero.flight.card.card import Card
from bayes_aero.flight.channel import STANDARD_CHANNELS, Channel
from bayes_aero.flight.record import FlightRecord
from bayes_aero.units import from_si, instant


@dataclass(frozen=True)
class HealthFinding:
    """One fault of one channel.

    Attributes:
        record: name of the record.
        channel: name of the channel; "record" where all of them are meant.
        fault: short key of the kind of fault, e.g. "frozen".
        begin: first time that is concerned, s, as in the record; None where it is the whole record.
        end: last such time, s.
        sentence: channel, when, what it looks like, how to mend it.
        grave: whether results that rest on the channel cannot be trusted.
    """

    record: str
    channel: str
    fault: str
    begin: float | None
    end: float | None
    sentence: str
    grave: bool


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


def as_filed(card: Card, name: str, values: np.ndarray | float) -> np.ndarray:
    """SI values of a channel in the unit and with the sign of the file, rounded to six digits to undo conversion."""
    channel = declared(card, name)
    standard = STANDARD_CHANNELS.get(name)
    raw = from_si(channel.sign * np.asarray(values, float), channel.unit, name, standard.unit if standard else None)
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
