"""A look at a record through a card: what was taken from where, and everything that is wrong with it at once."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bayes_aero.errors import InputError
from bayes_aero.flight.card import Card
from bayes_aero.flight.channel import STANDARD_CHANNELS, Channel
from bayes_aero.flight.checks import JITTER, failures
from bayes_aero.flight.plausible import without_bad_options
from bayes_aero.flight.proposals import Proposal, proposals
from bayes_aero.flight.raw import RawColumn, read_raw
from bayes_aero.flight.readers.base import Column
from bayes_aero.flight.reading import in_si, read_record
from bayes_aero.flight.record import FlightRecord
from bayes_aero.flight.segments import GAP, cut, segment_of
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
    channels = card.channels
    raw = read_raw(path)
    problems: list[str] = [f"two columns are called {name!r}; rename all but the right one" for name in raw.repeated]
    reports, values, missing = [], {}, []
    taken: set[int] = set()
    for channel in channels:
        column = raw.find(channel)
        if column is None:
            if not channel.required:
                missing.append(channel.name)
            continue
        taken.add(column.number)
        try:
            si = _converted(channel, column)
        except InputError as reason:
            problems.append(str(reason))
            continue
        values[channel.name] = si
        reports.append(_report(channel, column))
    record, parts = None, ()
    time = values.get("time", np.empty(0))
    if "time" in values:
        same = {name: x for name, x in values.items() if len(x) == len(time)}
        try:
            segment = segment_of(path)
            looked = cut(FlightRecord(Path(path).stem, time, same, os.fspath(path), ""), segment)
            if segment.whole and np.isfinite(time).all():
                parts = proposals(looked, card)
            looked = without_bad_options(looked, channels, blanks=resample is not None)
            problems += failures(looked, even=resample is None, channels=channels)
            time = looked.time
        except InputError as reason:
            problems.append(str(reason))
    try:
        record = read_record(path, channels, resample=resample)
    except InputError as reason:  # what it says of a column that no channel of the card was found in
        said = str(reason).removeprefix(f"{os.fspath(path)}: ")
        if said not in problems:
            problems.append(said)
    step = np.diff(time)
    median = float(np.median(step)) if len(step) else float("nan")
    return RecordReport(
        path=os.fspath(path),
        samples=len(time),
        dt=median,
        duration=float(time[-1] - time[0]) if len(time) else 0.0,
        gaps=int(np.sum(step > GAP * median)),
        uneven=int(np.sum(np.abs(step - median) > JITTER * median)),
        channels=tuple(reports),
        missing=tuple(missing),
        unused=tuple(column.place for column in raw.columns if column.number not in taken),
        problems=tuple(problems),
        record=None if problems else record,
        proposals=parts,
        remarks=raw.remarks,
    )


def _converted(channel: Channel, column: RawColumn) -> np.ndarray:
    if column.values is None:
        raise InputError(f"channel {channel.name}: {column.place} holds something else than numbers; repair the file")
    return in_si(channel, Column(column.values, column.unit), column.heading)


def _report(channel: Channel, column: RawColumn) -> ChannelReport:
    values = np.zeros(1) if column.values is None else column.values
    sound = values[np.isfinite(values)]
    low, high = (float(sound.min()), float(sound.max())) if len(sound) else (float("nan"), float("nan"))
    standard = STANDARD_CHANNELS.get(channel.name)
    si = standard.unit if standard else si_unit(channel.unit)
    return ChannelReport(channel.name, column.place, channel.unit, si, channel.sign, low, high, low < high)
