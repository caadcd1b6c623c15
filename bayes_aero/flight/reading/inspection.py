"""A look at a record through a card: what was taken from where, and everything that is wrong with it at once."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.ndimage import binary_closing, binary_dilation, uniform_filter1d

from bayes_aero.errors import InputError
from bayes_aero.flight.card.card import Card
from bayes_aero.flight.health.air import grounded
from bayes_aero.flight.health.signals import runs_of
from bayes_aero.flight.readers.base import FileColumn
from bayes_aero.flight.reading.checks import JITTER, failures, without_bad_options
from bayes_aero.flight.reading.read_record import in_si, read_raw, read_record, without_repeats
from bayes_aero.flight.reading.segments import GAP, SHORTEST, cut, parts_of, samples_of, segment_of
from bayes_aero.flight.record import FlightRecord
from bayes_aero.units import instant


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
        if column is not None and column.values is None:
            problems.append(
                f"channel {channel.name}: {column.place} holds something else than numbers; repair the file"
            )
        elif column is not None and column.values is not None:
            try:
                values[channel.name] = in_si(channel, FileColumn(column.values, column.unit), column.heading)
            except InputError as reason:
                problems.append(str(reason))
    looked, record, own, remarks = None, None, slice(None), raw.remarks
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
    try:
        record = read_record(path, card.channels, resample=resample)
    except InputError as reason:  # what is said of a column that no channel of the card was found in, too
        refused = str(reason).removeprefix(f"{os.fspath(path)}: ")
        problems += [refused] if refused not in problems else []
    time = np.empty(0) if looked is None else looked.time
    step = np.diff(time)
    median = float(np.median(step)) if len(step) else float("nan")
    gap = step > GAP * median
    taken = {column.number for column in found.values() if column is not None}
    reports = []
    for channel, column in found.items():
        if column is None or column.values is None or channel.name not in values:
            continue
        sound = column.values[own][np.isfinite(column.values[own])]
        low, high = (float(sound.min()), float(sound.max())) if len(sound) else (float("nan"), float("nan"))
        where = channel.name, column.place, channel.unit, channel.si, channel.sign
        reports.append(ChannelReport(*where, low, high, low < high))
    return RecordReport(
        path=os.fspath(path),
        samples=len(time),
        dt=median,
        duration=float(time[-1] - time[0]) if len(time) else 0.0,
        gaps=int(np.sum(gap)),
        uneven=int(np.sum((np.abs(step - median) > JITTER * median) & ~gap)),
        channels=tuple(reports),
        missing=tuple(channel.name for channel, column in found.items() if column is None and not channel.required),
        unused=tuple(column.place for column in raw.columns if column.number not in taken),
        problems=tuple(problems),
        record=None if problems else record,
        proposals=proposals(looked, card) if looked is not None and segment.whole and np.isfinite(time).all() else (),
        remarks=remarks,
    )


# --- The parts of a file that are worth a record of their own: those in flight, and the manoeuvres in them.


WINDOW = 2.0  # s over which a control or a rate must move
PAUSE = 4.0  # s of rest that divide two manoeuvres
LEAD = 2.0  # s kept before and after
BRIEFEST = 3.0  # s of movement that make a manoeuvre
ABOVE = 4.0  # times the quiet tenth of the record
MOST = 0.8  # of a part; a manoeuvre that fills more of it is the part
MOVES = {
    "p": np.deg2rad(1.0), "q": np.deg2rad(0.5), "r": np.deg2rad(0.5),
    "elevator": np.deg2rad(0.3), "aileron_left": np.deg2rad(0.5), "aileron_right": np.deg2rad(0.5),
    "aileron": np.deg2rad(0.5), "rudder": np.deg2rad(0.5),
}  # fmt: skip
"""Standard deviation over `WINDOW`, rad/s or rad, below which nothing was flown whatever the record's noise."""


@dataclass(frozen=True)
class Proposal:
    """A part of a file as it is written behind "@", what it is, and its first and last time in s."""

    part: str
    what: str
    begin: float
    end: float


def proposals(record: FlightRecord, card: Card) -> tuple[Proposal, ...]:
    """Parts to analyse in place of a whole file; none where the file is one flight that is one manoeuvre. The record is
    the whole file, in SI, unchecked: time may have gaps or start over. The card tells flight from ground."""
    parts = [(a, b) for a, b in parts_of(record.time) if b - a >= SHORTEST]
    forward = bool((np.diff(record.time) > 0.0).all())
    flown: list[tuple[int, int]] = []
    for a, b in parts:
        part = _window(record, a, b)
        if part.has("airspeed") and not np.isfinite(part["airspeed"]).all():
            flown.append((a, b))
            continue
        edges = [0, *(i for first, last in grounded(part, card) for i in (first, last + 1)), part.n]
        pairs = zip(edges[::2], edges[1::2], strict=True)
        flown += [(a + first, a + after) for first, after in pairs if after - first >= SHORTEST]
    found = []
    if flown != [(0, record.n)]:
        found += [_proposal(record, a, b, "in flight", forward) for a, b in flown]
    if forward:
        for a, b in flown:
            moved = _manoeuvres(_window(record, a, b), a)
            if len(moved) > 1 or (moved and moved[0][1] - moved[0][0] < MOST * (b - a)):
                found += [_proposal(record, i, j, "manoeuvre", forward) for i, j in moved]
    return tuple(found)


def _window(record: FlightRecord, a: int, b: int) -> FlightRecord:
    return FlightRecord(record.name, record.time[a:b], {n: x[a:b] for n, x in record.channels.items()}, "", "")


def _manoeuvres(part: FlightRecord, offset: int) -> list[tuple[int, int]]:
    """Where controls or rates move, with some seconds before and after."""
    size = max(round(WINDOW / part.dt), 3)
    moving = np.zeros(part.n, bool)
    for name, least in MOVES.items():
        if not part.has(name) or not np.isfinite(part[name]).all():
            continue
        mean = uniform_filter1d(part[name], size)
        spread = np.sqrt(np.maximum(uniform_filter1d((part[name] - mean) ** 2, size), 0.0))
        moving |= spread > max(least, ABOVE * float(np.quantile(spread, 0.1)))
    pause, lead = max(round(PAUSE / part.dt), 1), max(round(LEAD / part.dt), 1)
    moving = binary_closing(np.pad(moving, pause), np.ones(pause))[pause:-pause]
    runs = [(a, b) for a, b in runs_of(moving) if (b - a) * part.dt >= BRIEFEST]
    kept = np.zeros(part.n, bool)
    for a, b in runs:
        kept[a : b + 1] = True
    kept = binary_dilation(kept, np.ones(2 * lead + 1))
    return [(offset + a, offset + b + 1) for a, b in runs_of(kept) if b + 1 - a >= SHORTEST]


def _proposal(record: FlightRecord, a: int, b: int, what: str, forward: bool) -> Proposal:
    begin, end = float(record.time[a]), float(record.time[b - 1])
    number = next((k for k, part in enumerate(parts_of(record.time), 1) if part == (a, b)), None)
    spec = f"{instant(begin)}:{instant(end)}" if forward or number is None else f"#{number}"
    return Proposal(spec, what, begin, end)
