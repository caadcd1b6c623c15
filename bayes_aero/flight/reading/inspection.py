"""A look at a record through a card: what was taken from where, and everything that is wrong with it at once."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bayes_aero.errors import InputError
from bayes_aero.flight.card.card import Card
from bayes_aero.flight.channel import STANDARD_CHANNELS, Channel
from bayes_aero.flight.readers.base import Column
from bayes_aero.flight.reading.checks import JITTER, failures
from bayes_aero.flight.reading.plausible import without_bad_options
from bayes_aero.flight.reading.proposals import Proposal, proposals
from bayes_aero.flight.reading.raw import RawColumn, read_raw
from bayes_aero.flight.reading.read_record import in_si, read_record
from bayes_aero.flight.reading.repeats import without_repeats
from bayes_aero.flight.reading.segments import GAP, cut, samples_of, segment_of
from bayes_aero.flight.record import FlightRecord
from bayes_aero.units import si_unit

__all__ = ["ChannelReport", "RecordReport", "inspect_record"]


@dataclass(frozen=True)
class ChannelReport:
    """A card's channel in a file: where it stands, its unit there and inside, its range in the file's unit."""

    name: str
    place: str
    unit: str
    si: str
    sign: int
    lowest: float
    highest: float
    moves: bool


@dataclass(frozen=True)
class RecordReport:
    """What one file is worth to one card. Usable if `problems` is empty; times in s."""

    path: str
    samples: int
    dt: float
    duration: float
    gaps: int
    uneven: int
    channels: tuple[ChannelReport, ...]
    missing: tuple[str, ...]  # channels that the card does not require
    unused: tuple[str, ...]  # columns that the card does not map
    problems: tuple[str, ...]
    record: FlightRecord | None
    proposals: tuple[Proposal, ...] = ()
    remarks: tuple[str, ...] = ()


def inspect_record(path: str | os.PathLike[str], card: Card, *, resample: float | None = None) -> RecordReport:
    """Read as `read_record` does, but report all that is wrong; only a file that cannot be read at all raises."""
    raw, segment = read_raw(path), segment_of(path)
    problems: list[str] = [f"two columns are called {name!r}; rename all but the right one" for name in raw.repeated]
    found, values = {channel: raw.find(channel) for channel in card.channels}, {}
    for channel, column in found.items():
        if column is not None:
            try:
                values[channel.name] = _converted(channel, column)
            except InputError as reason:
                problems.append(str(reason))
    looked, own, remarks = None, slice(None), raw.remarks
    if "time" in values:
        same = {name: x for name, x in values.items() if len(x) == len(values["time"])}
        looked = without_repeats(FlightRecord(Path(path).stem, values["time"], same, os.fspath(path), ""))
        remarks += looked.remarks
        try:
            own = samples_of(looked.time, segment)
            looked = cut(looked, segment)
            kept = without_bad_options(looked, card.channels, blanks=resample is not None)
            problems += failures(kept, even=resample is None, channels=card.channels)
        except InputError as reason:
            problems.append(str(reason))
    record, refused = _read(path, card, resample)
    problems += [refused] if refused and refused not in problems else []
    time = np.empty(0) if looked is None else looked.time
    step = np.diff(time)
    median = float(np.median(step)) if len(step) else float("nan")
    gap = step > GAP * median
    taken = {column.number for column in found.values() if column is not None}
    there = [(channel, column) for channel, column in found.items() if column is not None and channel.name in values]
    return RecordReport(
        path=os.fspath(path),
        samples=len(time),
        dt=median,
        duration=float(time[-1] - time[0]) if len(time) else 0.0,
        gaps=int(np.sum(gap)),
        uneven=int(np.sum((np.abs(step - median) > JITTER * median) & ~gap)),
        channels=tuple(_report(channel, column, own) for channel, column in there),
        missing=tuple(channel.name for channel, column in found.items() if column is None and not channel.required),
        unused=tuple(column.place for column in raw.columns if column.number not in taken),
        problems=tuple(problems),
        record=None if problems else record,
        proposals=proposals(looked, card) if looked is not None and segment.whole and np.isfinite(time).all() else (),
        remarks=remarks,
    )


def _read(path: str | os.PathLike[str], card: Card, resample: float | None) -> tuple[FlightRecord | None, str]:
    """The record, or why it cannot be had: what is said of a column that no channel of the card was found in, too."""
    try:
        return read_record(path, card.channels, resample=resample), ""
    except InputError as reason:
        return None, str(reason).removeprefix(f"{os.fspath(path)}: ")


def _converted(channel: Channel, column: RawColumn) -> np.ndarray:
    if column.values is None:
        raise InputError(f"channel {channel.name}: {column.place} holds something else than numbers; repair the file")
    return in_si(channel, Column(column.values, column.unit), column.heading)


def _report(channel: Channel, column: RawColumn, own: slice) -> ChannelReport:
    """`own`: the samples of the part that is looked at."""
    values = np.zeros(1) if column.values is None else column.values[own]
    sound = values[np.isfinite(values)]
    low, high = (float(sound.min()), float(sound.max())) if len(sound) else (float("nan"), float("nan"))
    standard = STANDARD_CHANNELS.get(channel.name)
    si = standard.unit if standard else si_unit(channel.unit)
    return ChannelReport(channel.name, column.place, channel.unit, si, channel.sign, low, high, low < high)
