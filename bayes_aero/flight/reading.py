"""From a file on disk to a checked flight record in SI.

The way of a file: its bytes are read once (and hashed), the format of its suffix finds the columns that the
card names, their values are converted to SI, and the record is checked. Whatever is wrong is reported in one
InputError that starts with the file's name.
"""

from __future__ import annotations

import hashlib
import math
import os
import time
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from difflib import get_close_matches
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool

from bayes_aero.errors import InputError
from bayes_aero.flight import binary, text
from bayes_aero.flight.card import Card
from bayes_aero.flight.channel import STANDARD_CHANNELS, Channel, StandardChannel, split_heading, unit_choices
from bayes_aero.flight.health.air import Proposal, proposals
from bayes_aero.flight.health.channel import held_period
from bayes_aero.flight.record import GAP, SHORTEST, FlightRecord, parts_of, samples_of, segment_of
from bayes_aero.flight.text import FileColumn, Heading, OpenedFile, candidates, located
from bayes_aero.units import canonical, from_si, instant, number, same_kind, same_unit, to_si

READERS: dict[str, Callable[[bytes], OpenedFile]] = dict(
    sorted((dict.fromkeys((".asc", ".txt", ".dat", ".csv", ".tsv"), text.open_text) | binary.READS).items())
)
"""What opens a file, by its suffix."""

Paths = Sequence[str | os.PathLike[str]]
Channels = Sequence[Channel]
Parts = Mapping[str, Sequence[str]] | None  # of files by their name, as a card states them
MAX_BYTES = 1 << 30  # largest file that is taken for one manoeuvre: 1 GiB


@contextmanager
def _named(path: str | os.PathLike[str]) -> Iterator[None]:
    try:
        yield
    except InputError as reason:
        raise InputError(f"{os.fspath(path)}: {reason}") from reason


def read_record(path: str | os.PathLike[str], channels: Channels, *, resample: float | None = None) -> FlightRecord:
    """Read, convert and check one manoeuvre; without `resample` uneven sampling and missing samples are refused."""
    with _named(path):
        filed = _as_filed(path, channels)
        filed = filed.part(samples_of(filed.time, segment_of(path)))
        record = without_bad_options(filed, channels, blanks=resample is not None)
        check_record(record, even=resample is None, channels=channels)
        if resample is not None:
            record = without_bad_options(resample_record(record, resample), channels)
            check_record(record, channels=channels)
        return record


def _as_filed(path: str | os.PathLike[str], channels: Channels) -> FlightRecord:
    """The whole file in SI, unchecked, without samples that were written twice."""
    segment = segment_of(path)
    opens, often = format_of(segment.file), Counter(channel.name for channel in channels)
    for name in (name for name, count in often.items() if count > 1):
        raise InputError(f"channel {name} is mapped twice on the card; keep one of the two")
    if "time" not in often:
        raise InputError('channel time is not mapped on the card; add it to [channels] with unit = "s"')
    data = bytes_of(segment.file)
    opened = opens(data)
    places = located(channels, opened)
    columns = opened.read(places)
    if "time" not in columns:
        raise InputError("channel time is missing, and a record needs it; set required = true and correct its place")
    si = {c.name: in_si(c, columns[c.name], places[c.name]) for c in channels if c.name in columns}
    source, digest = os.fspath(path), hashlib.sha256(data).hexdigest()
    file = source.removesuffix(f"@{segment.words}") if segment.words else source
    read = {"path": file, "part": segment.words, "resample": None, "windows": [], "split": False}
    remarks = tuple(opened.remarks)
    return without_repeats(FlightRecord(segment.label, si["time"], si, source, digest, remarks=remarks, read=read))


def read_again(read: Mapping[str, Any], file: Path, channels: Channels) -> FlightRecord:
    """The record that was `read` before (see `FlightRecord.read`), from the whole `file`, where it is now."""
    part = f"@{read['part']}" if read["part"] else ""
    record = read_record(f"{file}{part}", channels, resample=read["resample"])
    for begin, end in read["windows"]:
        record = record.window(begin, end)
    return replace(record, read={**record.read, "split": read["split"]})


def read_records(
    paths: Paths, channels: Channels, *, resample: float | None = None, segments: Parts = None, split: bool = False
) -> list[FlightRecord]:
    """Every manoeuvre of every file, also of those that a gap `split`s; the first bad one is reported."""
    parts = manoeuvres(paths, channels, segments=segments, split=split)
    records = [read_record(path, channels, resample=resample) for path in parts]
    return [replace(record, read={**record.read, "split": split}) for record in records]


def manoeuvres(paths: Paths, channels: Channels, *, segments: Parts = None, split: bool = False) -> list[Path]:
    """The manoeuvres that files stand for: what a card has stated of a file of that name (`segments`), else its parts
    between gaps, if it is to `split` them. A path with a part stands for that alone."""
    clock = [replace(channel, required=True) if channel.name == "time" else channel for channel in channels]
    files: list[Path] = []
    for path in [os.fspath(path) for path in paths]:
        segment, named = segment_of(path), ()
        if segment.whole:
            named = (segments or {}).get(segment.file.name, ())
        if split:
            with _named(path):
                time = _as_filed(segment.file, clock).time
            if not named and segment.whole and len(parts := parts_of(time)) > 1:
                forward = bool((np.diff(time) > 0.0).all())
                long = [(k, a, b) for k, (a, b) in enumerate(parts, 1) if b - a >= SHORTEST]
                names = (f"{time[a]:.15g}:{time[b - 1]:.15g}" if forward else f"#{k}" for k, a, b in long)
                files += [Path(f"{path}@{name}") for name in names]
                continue
        files += [Path(f"{path}@{part}") for part in named] or [Path(path)]
    return files


def present(path: Path) -> None:
    """Refuse a name of which there is no file; nothing need be loaded to see that."""
    file = segment_of(path).file
    try:
        there = file.exists()
    except (OSError, ValueError):  # a name that cannot be one: reading says so
        return
    if not there:
        raise InputError(f"{path}: {_no_such_file(file)}")


def format_of(path: Path) -> Callable[[bytes], OpenedFile]:
    """What opens a file, told by its suffix."""
    if (suffix := path.suffix.lower()) not in READERS:
        given = f"the suffix {path.suffix!r}" if path.suffix else "a file without suffix"
        raise InputError(f"{given} is not known; flight records end in {', '.join(READERS)}: convert the file")
    return READERS[suffix]


def bytes_of(path: Path) -> bytes:
    """The whole file: hashed as read, and no parser can be led to read beyond its end."""
    try:
        if not path.is_file():
            odd = "it is a pipe or a device; write the data to a regular file first"
            odd = "it is a directory; name a file in it" if path.is_dir() else odd
            raise InputError(odd if path.exists() else _no_such_file(path))
        if (size := path.stat().st_size) > MAX_BYTES:
            raise InputError(f"it has {size} bytes, more than {MAX_BYTES}; cut it to the manoeuvre")
        data = path.read_bytes()
    except InputError:
        raise
    except (OSError, ValueError) as reason:
        raise InputError(f"it cannot be read ({reason}); check its name and permissions") from reason
    if not data:
        raise InputError("the file is empty; copy or write it again")
    return data


def _no_such_file(path: Path) -> str:
    if not path.parent.is_dir():
        return f"no such file: its folder {str(path.parent)!r} does not exist; correct the path"
    close = get_close_matches(path.name, [entry.name for entry in path.parent.iterdir()][:10_000], n=3)
    return "no such file; " + (f"did you mean {' or '.join(close)}?" if close else "correct the path")


def in_si(channel: Channel, column: FileColumn, heading: Heading) -> np.ndarray:
    """A channel's values in SI, (n,), with the card's sign. Raises InputError: the file states another unit than the
    card: in a row of units, an attribute, or its name ("rho (slug/ft3)"). What a name seems to say counts only where
    the channel can have that unit: the "g" of "q_g" may be a gyro."""
    unit, standard = column.unit, STANDARD_CHANNELS.get(channel.name)
    for named in (split_heading(name, channel.unit)[1] for name in heading.names) if unit is None else ():
        unit = named if unit is None and named is not None and same_kind(named, channel.unit) else unit
    if unit is not None and same_unit(unit, channel.unit) is False:
        raise InputError(
            f"channel {channel.name} is in {unit!r} according to the file but in {channel.unit!r} according to the "
            f'card; correct the card: unit = "{canonical(unit, standard.unit if standard else None) or unit}"'
        )
    return channel.sign * to_si(column.values, channel.unit, channel.name, channel.si)


# --- Everything that a file holds, before any card says what it means.

MOST_COLUMNS = 20_000  # columns beyond this are not looked at
PATIENCE = 20.0  # seconds


@dataclass(frozen=True)
class RawColumn:
    """One column: its name (None in files without a header), place counted from 1, (n,) values, unit if the file says.
    Values are None where they are no numbers."""

    label: str | None
    number: int
    values: np.ndarray | None
    unit: str | None = None
    heading: Heading = field(default_factory=Heading)

    @property
    def place(self) -> str:
        return f"column {self.number}" if self.label is None else repr(self.label)


@dataclass(frozen=True)
class RawFile:
    """A file's columns in its order; names that occur twice are left out and listed."""

    columns: tuple[RawColumn, ...]
    repeated: tuple[str, ...] = ()
    remarks: tuple[str, ...] = ()

    def find(self, channel: Channel) -> RawColumn | None:
        there = candidates(channel, [column.heading for column in self.columns])[:1]
        return next((column for column in self.columns if column.heading in there), None)


def read_raw(path: str | os.PathLike[str]) -> RawFile:
    """Every column of a file, numeric or not; raises `InputError` with the file's name."""
    with _named(path):
        file = segment_of(path).file
        opened = format_of(file)(bytes_of(file))
        headings = dict(enumerate(opened.headings[:MOST_COLUMNS], 1))
        often = Counter(name for h in headings.values() for name in h.names)
        repeated = {name for name, count in often.items() if count > 1}
        places = {
            str(k): heading
            for k, heading in headings.items()
            if not {*heading.names} & repeated and (heading.names or heading.column is not None)
        }
        # All columns at once; where one is no numbers, each half on its own, so that only it is lost.
        numbers, left, began = dict[str, FileColumn](), deque([list(places.items())]), time.monotonic()
        failure = InputError("it holds no column of numbers; is it the right file?")
        while left and time.monotonic() - began < PATIENCE:
            some = left.popleft()
            try:
                numbers |= opened.read(dict(some))
            except InputError as reason:
                failure, half = reason, len(some) // 2
                left.extend([some[:half], some[half:]] if half else [])
        if not numbers:
            raise failure from None
    columns = []
    for place, heading in places.items():
        values, unit = numbers.get(place, (None, None))
        if values is not None and not heading.names and not np.isfinite(values).any():
            continue  # what follows a separator too many
        at = heading.column if heading.column is not None else int(place)
        label = heading.names[0] if heading.names and not heading.formed else None
        columns.append(RawColumn(label, at, values, unit, heading))
    return RawFile(tuple(columns), tuple(sorted(repeated)), tuple(opened.remarks))


# --- Samples that a recorder wrote twice; records brought to one sampling rate.


def repeats(time: np.ndarray, channels: Iterable[np.ndarray]) -> Bool[np.ndarray, " n"]:
    """True where a sample is the one before it once more, in time and in every channel; all are (n,)."""
    again = np.r_[False, np.diff(time) == 0.0]
    for x in channels if again.any() else ():
        again[1:] &= (x[1:] == x[:-1]) | (np.isnan(x[1:]) & np.isnan(x[:-1]))
    return again


def without_repeats(record: FlightRecord) -> FlightRecord:
    """The record without such samples, and a remark. Samples of one time that differ stay."""
    again = repeats(record.time, record.channels.values())
    if not again.any():
        return record
    count = int(again.sum())
    what = "1 sample repeats" if count == 1 else f"{count} samples repeat"
    remark = f"{what} the one before in time and in every channel of the card: left out"
    return replace(record.part(~again), remarks=(*record.remarks, remark))


RATE = 25.0  # samples a second; that of the records for which the smoothing filters were published
SPARE = 1.25  # times that, up to which a record is taken as it is
SAME = 0.01  # relative difference of intervals that count as one


def common_interval(records: Sequence[FlightRecord]) -> float:
    """Sampling interval, s, that suits all records: the longest of theirs, or that of `RATE` where they are faster."""
    longest = max(record.dt for record in records)
    return 1.0 / RATE if longest * RATE * SPARE < 1.0 else longest


def at_common_rate(records: Sequence[FlightRecord]) -> list[FlightRecord]:
    """The records at `common_interval`, filtered against aliasing; those that have it, unchanged."""
    dt = common_interval(records)
    return [resample_record(record, dt) if abs(record.dt - dt) > SAME * dt else record for record in records]


def rate_notes(records: Sequence[FlightRecord]) -> tuple[str, ...]:
    """A sentence where `at_common_rate` brings records to another rate; none where it does not."""
    dt = common_interval(records) if records else 1.0
    odd = [f"{record.name} ({1.0 / record.dt:.4g} Hz)" for record in records if abs(record.dt - dt) > SAME * dt]
    note = f"Brought to the common rate of {1.0 / dt:.4g} Hz, filtered against aliasing: {', '.join(odd)}."
    return (note,) if odd else ()


# --- A look at a record through a card: what was taken from where, and everything that is wrong with it at once.


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
    problems = [f"two columns are called {name!r}; rename all but the right one" for name in raw.repeated]
    columns = {channel: column for channel in card.channels if (column := raw.find(channel)) is not None}
    values: dict[str, np.ndarray] = {}
    for channel, column in columns.items():
        try:
            if column.values is None:
                place = f"channel {channel.name}: {column.place}"
                raise InputError(f"{place} holds something else than numbers; repair the file")
            values[channel.name] = in_si(channel, FileColumn(column.values, column.unit), column.heading)
        except InputError as reason:
            problems.append(str(reason))
    whole, record, inside, remarks = None, None, np.s_[:], raw.remarks
    if "time" in values:
        same = {name: x for name, x in values.items() if len(x) == len(values["time"])}
        whole = without_repeats(FlightRecord(Path(path).stem, values["time"], same, os.fspath(path), ""))
        remarks += whole.remarks
        try:
            inside = samples_of(whole.time, segment)
            whole = whole.part(inside)
            kept = without_bad_options(whole, card.channels, blanks=resample is not None)
            problems += failures(kept, even=resample is None, channels=card.channels)
        except InputError as reason:
            problems.append(str(reason))
    try:
        record = read_record(path, card.channels, resample=resample)
    except InputError as reason:  # what is said of a column that no channel of the card was found in, too
        refused = str(reason).removeprefix(f"{os.fspath(path)}: ")
        problems += [refused] if refused not in problems else []
    time = np.empty(0) if whole is None else whole.time
    step, reports = np.diff(time), []
    median = float(np.median(step)) if len(step) else float("nan")
    gap = step > GAP * median
    for channel, column in columns.items():
        if channel.name in values and column.values is not None:
            sound = column.values[inside][np.isfinite(column.values[inside])]
            low, high = (float(sound.min()), float(sound.max())) if len(sound) else (float("nan"), float("nan"))
            where = channel.name, column.place, channel.unit, channel.si, channel.sign
            reports.append(ChannelReport(*where, low, high, low < high))
    parts = segment.whole and np.isfinite(time).all()
    return RecordReport(
        path=os.fspath(path),
        samples=len(time),
        dt=median,
        duration=float(time[-1] - time[0]) if len(time) else 0.0,
        gaps=int(np.sum(gap)),
        uneven=int(np.sum((np.abs(step - median) > JITTER * median) & ~gap)),
        channels=tuple(reports),
        missing=tuple(c.name for c in card.channels if c not in columns and not c.required),
        unused=tuple(c.place for c in raw.columns if c.number not in {used.number for used in columns.values()}),
        problems=tuple(problems),
        record=None if problems else record,
        proposals=proposals(whole, card) if whole is not None and parts else (),
        remarks=remarks,
    )


# --- What a record must satisfy before anything is computed from it; each failure is reported with its remedy.

MIN_SAMPLES = 50  # the derivative filter alone spans 17 samples and changes its form over the 9 next to either end
JITTER = 0.01  # largest departure of a step from the median step, relative, that still passes for even sampling
RATES = (1e-4, 2.0)  # bounds of the sampling interval, s, outside which the unit of time must be wrong
Mapped = Mapping[str, Channel]  # the card's channels by name


def check_record(record: FlightRecord, *, even: bool = True, channels: Channels = ()) -> None:
    """Raise InputError, with channel, sample and remedy, for the first fault; `even=False`: it is to be resampled."""
    for reason in failures(record, even=even, channels=channels):
        raise InputError(reason)


def check_arrays(record: FlightRecord, channels: Channels) -> None:
    """Raise InputError if a record made in memory is too short, lacks numbers, or its time does not increase."""
    used = {c.name: record[c.name] for c in channels if c.required and c.name in record.channels}
    for reason in _unusable(replace(record, channels=used), True):
        raise InputError(f"record {record.name}: {reason}")


def failures(record: FlightRecord, *, even: bool = True, channels: Channels = ()) -> Iterator[str]:
    """Everything that is wrong with a record, one sentence each; `check_record` raises the first."""
    card = {channel.name: channel for channel in channels}
    yield from _unusable(record, even)
    if record.n < MIN_SAMPLES or not np.isfinite(record.time).all():
        return
    for name in (name for name in record.names if name in STANDARD_CHANNELS):
        if why := implausible(record, STANDARD_CHANNELS[name], card.get(name)):
            yield why
            break
    if (np.diff(record.time) > 0.0).all():  # what follows needs it
        yield from _of_sampling(record, card.get("time"), even)
        yield from _of_values(record, card)


def _unusable(record: FlightRecord, even: bool) -> Iterator[str]:
    """Too few samples; samples that are no numbers; time that does not increase. Missing samples that are about to be
    interpolated pass; those of time do not, nor infinities."""
    if record.n < MIN_SAMPLES:
        yield f"the record has {record.n} samples; at least {MIN_SAMPLES} are needed: use a longer record"
        return
    for name in record.names:
        bad, missing = ~np.isfinite(record[name]), np.isnan(record[name])
        bridged = not even and name != "time" and not np.isinf(record[name]).any() and not missing.all()
        if not bad.any() or bridged:
            continue
        first = int(np.argmax(bad))
        what = "empty or not a number (NaN)" if missing[first] else "infinite"
        where = f"sample {first} (counted from 0)" if name == "time" else at(record, first)
        more = (
            f", ask for resampling if they are few or the file is of several rates (--resample "
            f"{_sampling_step(record):.4g}), or take the channel off the card if it is not needed"
        )
        yield (
            f"channel {name} is {what} at {where}, {int(bad.sum())} of {record.n} samples in all; repair or cut out "
            f"these samples{'' if name == 'time' else more}"
        )
        break
    back = np.diff(record.time) <= 0.0
    if back.any():
        i = int(np.argmax(back)) + 1
        what = "repeats" if record.time[i] == record.time[i - 1] else "runs backwards from"
        yield (
            f"channel time {what} {instant(record.time[i - 1])} s at {at(record, i)}, {int(back.sum())} times in all; "
            "time must increase: sort the samples, drop the repeated ones, write rounded stamps with more digits, or "
            "divide the record where time starts over (--split)"
        )


def _sampling_step(record: FlightRecord) -> float:
    """Median step of the channel that has most samples, s: time alone holds the stamps of all rates of a file."""
    there = [np.isfinite(values) for values in record.channels.values()]
    fullest = max(there, key=np.count_nonzero, default=np.ones(record.n, bool))
    return float(np.median(np.diff(record.time[fullest]))) if np.count_nonzero(fullest) > 1 else float("nan")


def _of_sampling(record: FlightRecord, channel: Channel | None, even: bool) -> Iterator[str]:
    """A rate that no flight is recorded at; gaps and uneven steps, unless it is about to be resampled."""
    fullest, stated = _sampling_step(record), "s" if channel is None else channel.unit
    if not RATES[0] <= fullest <= RATES[1]:  # the unit in which steps would be those of a flight
        hint = f"no unit of time explains that ({stated} on the card): correct its column on the card"
        scale = next((size for unit, size in TIMES.items() if same_unit(unit, stated)), 1.0)
        fit = [unit for unit, size in TIMES.items() if RECORDED[0] <= fullest / scale * size <= RECORDED[1]]
        for unit in [unit for unit in fit if not same_unit(unit, stated)][:1]:
            hint = f'looks like {unit}, where the card says {stated}: set unit = "{unit}" for time on the card'
        bounds = f"outside {RATES[0]:g} to {RATES[1]:g} s"
        yield f"channel time has a median step of {fullest:.6g} s from {at(record, 0)}, {bounds}; {hint}"
    step = np.diff(record.time)
    median = float(np.median(step))
    gaps, off = step > GAP * median, np.abs(step - median) > JITTER * median
    if even and gaps.any() and len(parts_of(record.time)) > 1:  # else stamps are rounded throughout
        i = int(np.argmax(gaps))
        yield (
            f"channel time has a gap of {step[i]:.6g} s after {at(record, i)}, where {median:.6g} s is usual; divide "
            "the record there (--split, or FILE@FROM:TO), or ask for resampling if the gap is short"
        )
    elif even and off.any():
        i = int(np.argmax(off))
        yield (
            f"channel time is sampled unevenly: the step after {at(record, i)} is {step[i]:.6g} s, not {median:.6g}"
            f" s; write time with more digits, or ask for resampling (--resample {float(np.mean(step)):.4g})"
        )


def _of_values(record: FlightRecord, card: Mapped) -> Iterator[str]:
    """Speeds and densities not above zero, accelerations in multiples of gravity, an angle of attack that rests."""
    for name in ("airspeed", "density"):
        bad = record[name] <= 0.0 if record.has(name) else np.zeros(1, bool)
        if bad.any():
            i = int(np.argmax(bad))
            unit, count = STANDARD_CHANNELS[name].unit, int(bad.sum())
            yield (
                f"channel {name} is {record[name][i]:.6g} {unit} at {at(record, i)}, {count} samples not above zero: "
                "cut the record to the part in flight, or repair the channel"
            )
            break
    if all(map(record.has, ("ax", "ay", "az"))) and not ("az" in card and same_unit(card["az"].unit, "g")):
        load = float(np.median(np.sqrt(record["ax"] ** 2 + record["ay"] ** 2 + record["az"] ** 2)))
        if 0.7 < load < 1.4:  # near 9.8 in m/s2; only a record flown at a tenth of gravity throughout is so
            i = int(np.argmax(np.abs(record["az"])))
            yield (
                f"channels ax, ay, az have a median magnitude of {number(load)} m/s^2 (az is {number(record['az'][i])} "
                f'at {at(record, i)}); looks like multiples of gravity: set unit = "g" for them on the card'
            )
    if record.has("alpha") and float(np.ptp(record["alpha"])) < 1e-6:
        yield (
            f"channel alpha stays at {record['alpha'][0]:.6g} rad from {at(record, 0)} to {at(record, record.n - 1)}; "
            "nothing can be identified from a constant angle of attack: check the sensor and the card's column or label"
        )


# --- Values that no sound record has, and the units that would explain them; the card's own is never advised.

TIMES = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0, "d": 86400.0}
RECORDED = (0.002, 0.5)  # s between samples of a flight that is worth a look
NEARLY_ALL = 0.99


def implausible(record: FlightRecord, standard: StandardChannel, channel: Channel | None) -> str | None:
    """What is wrong with values outside the channel's bounds, in one sentence; None if none is outside."""
    x, (lo, hi) = record[standard.name], standard.plausible
    outside = (x < lo) | (x > hi)
    if not outside.any():
        return None
    channel = channel or Channel(standard.name, standard.unit)
    count, i = int(outside.sum()), int(np.argmax(outside))
    if lo == 0.0 and (x < lo).any():  # airspeed and density not above zero: another check reports these
        return None
    in_file = f" ({float(channel.filed(x[i])):.6g} {channel.unit} in the file)"
    as_filed = in_file if channel.unit != standard.unit else ""
    return (
        f"channel {standard.name} is {x[i]:.6g} {standard.unit}{as_filed} at {at(record, i)}, outside {lo:g} to {hi:g} "
        f"{standard.unit}, {count} of {record.n} samples in all; {_unit_hint(x, standard, channel.unit)}"
    )


def at(record: FlightRecord, index: int | np.integer) -> str:
    return f"sample {int(index)} (counted from 0; t = {instant(record.time[index])} s)"


def _unit_hint(x: np.ndarray, standard: StandardChannel, stated: str) -> str:
    """Units that would make nearly all values plausible, less the one `stated` on the card."""
    filed, (lo, hi) = from_si(x, stated, standard.name, standard.unit), standard.plausible

    def fits(values: np.ndarray) -> bool:
        return bool(np.mean((values >= lo) & (values <= hi)) >= NEARLY_ALL)

    others = (unit for unit in unit_choices(standard.name) if same_unit(unit, stated) is False)
    units = [unit for unit in others if fits(to_si(filed, unit, standard.name, standard.unit))][:2]
    if fits(x) or not units:
        return "no other unit explains that (a fill value?): cut out these samples, or correct its column on the card"
    entries = " or ".join(f'unit = "{unit}"' for unit in units)
    return f"looks like {' or '.join(units)}: set {entries} for it on the card"


def without_bad_options(record: FlightRecord, channels: Channels, *, blanks: bool = False) -> FlightRecord:
    """The record without optional channels that are not finite (`blanks` pass) or not plausible; it remembers why."""
    dropped = {}
    for channel in channels:
        if channel.required or channel.name not in record.channels:
            continue
        bad, standard = ~np.isfinite(record[channel.name]), STANDARD_CHANNELS.get(channel.name)
        if bad.any() and not (blanks and bad.mean() < 1.0):
            first = at(record, int(np.argmax(bad)))
            count = f"{int(bad.sum())} of {record.n} samples"
            dropped[channel.name] = f"channel {channel.name} is not a number at {count}, the first at {first}"
        elif standard is not None and (why := implausible(record, standard, channel)) is not None:
            dropped[channel.name] = why
        elif standard is not None and standard.plausible[0] == 0.0 and (record[channel.name] < 0.0).any():
            below = record[channel.name] < 0.0
            first, count = at(record, int(np.argmax(below))), f"{int(below.sum())} of {record.n} samples"
            dropped[channel.name] = f"channel {channel.name} is below zero at {count}, the first at {first}"
    kept = {name: x for name, x in record.channels.items() if name not in dropped}
    return replace(record, channels=kept, dropped={**record.dropped, **dropped}) if dropped else record


# --- Interpolation of a record of uneven or of several rates onto an even grid, done only when asked for.

MAX_GAP = 5.0  # longest step, in median steps, that is bridged; beyond it interpolation would invent flight data
MAX_SAMPLES = 5_000_000
SHOWN = 4  # parts in a sentence
_WRAPPED = ("phi", "psi", "longitude")  # angles that jump by a full turn in files
_STEPWISE = ("gear",)


def resample_record(record: FlightRecord, dt: float) -> FlightRecord:
    """The record on an even grid: cubic splines, low-pass filtered where `dt` is coarser; no gap is bridged."""
    if not (math.isfinite(dt) and dt > 0.0):
        raise InputError(f"record {record.name}: cannot resample to an interval of {dt!r} s; give a positive number")
    knots = {name: _sampled_at(name, values) for name, values in record.channels.items()}
    steps = [_bridged(record.name, n, record.time[index]) for n, index in knots.items() if len(index) < record.n]
    if len(steps) < len(knots) or not knots:  # time belongs to the channels that have all samples
        steps.append(_bridged(record.name, "time", record.time))
    median = min(steps)
    begin = float(max((record.time[index[0]] for index in knots.values()), default=record.time[0]))
    ends = [record.time[index[-1]] for name, index in knots.items() if np.isnan(record[name]).any()]
    end = float(min([*ends, record.time[-1]]))
    # A coarse grid is reached through a fine one about as dense as the record: interpolate, filter, thin out.
    factor = max(1, math.ceil(dt / median - 1e-6)) if dt > 1.001 * median else 1
    fine, duration = dt / factor, end - begin
    if duration / fine > MAX_SAMPLES:
        raise InputError(
            f"record {record.name}: resampling {duration:.6g} s to {dt:g} s makes more than {MAX_SAMPLES} samples; "
            f"give a longer interval (the median step is {median:.6g} s)"
        )
    elapsed = np.arange(math.floor(duration / fine * (1.0 + 1e-12) + 1e-9) + 1) * fine
    time = np.minimum(begin + elapsed, end)
    groups: dict[tuple[str, str], list[str]] = {}
    for name, index in knots.items():
        if len(index) < record.n:
            how = "missing samples" if np.isnan(record[name]).any() else "held samples"
            rate = f"{1.0 / float(np.median(np.diff(record.time[index]))):.4g}"
            groups.setdefault((how, rate), []).append(name)
    remarks = [
        f"resampled: {how} of {', '.join(names)} ({rate} Hz in a file of {1.0 / median:.4g} Hz) are replaced by a "
        f"cubic spline through the channel's own samples, at {1.0 / dt:.4g} Hz"
        for (how, rate), names in groups.items()
    ] or [f"resampled by cubic splines from {1.0 / median:.4g} Hz to {1.0 / dt:.4g} Hz"]
    return replace(
        record, time=begin + elapsed[::factor],
        channels={key: _onto(record, key, knots[key], time, factor) for key in record.channels},
        source=f"{record.source}, resampled to {dt:g} s", remarks=(*record.remarks, *remarks),
        read={**record.read, "resample": dt} if record.read else {},
    )  # fmt: skip


def _bridged(record: str, name: str, time: np.ndarray) -> float:
    """The median step, s; refused where a step is too long to interpolate across."""
    step = np.diff(time)
    if len(step) < 3:
        raise InputError(f"record {record}: channel {name} has {len(time)} samples, too few to interpolate between")
    median = float(np.median(step))
    long = np.flatnonzero(step > MAX_GAP * median)
    if len(long):
        i, mend = int(long[0]), "cut the record there into two (--split, or FILE@FROM:TO)"
        if name != "time":
            begin, end = ["", *map(instant, time[long + 1])], [*map(instant, time[long]), ""]
            parts = [f"FILE@{a}:{b}" for a, b in zip(begin, end, strict=True)]
            mend = f"give {' '.join(parts[:SHOWN])}{' ...' if len(parts) > SHOWN else ''} instead of the file"
        raise InputError(
            f"record {record}: channel {name} has a gap of {step[i]:.6g} s after t = {instant(time[i])} s, longer than "
            f"the {MAX_GAP:g} median steps ({MAX_GAP * median:.4g} s) that resampling bridges; {mend}"
        )
    return median


def _sampled_at(name: str, values: np.ndarray) -> np.ndarray:
    """Where a channel was truly sampled: not where it is missing, nor where a slower sensor's value is only held."""
    there = np.flatnonzero(np.isfinite(values))
    period = 0.0 if name in _STEPWISE or len(there) < len(values) else held_period(values)
    if not period:
        return there
    changes = np.flatnonzero(np.diff(values)) + 1
    lengths = np.diff(np.r_[changes, len(values)])
    pieces = np.maximum(np.round(lengths / period), 1).astype(int)  # a true value may repeat
    parts = zip(changes, lengths, pieces, strict=True)
    return np.concatenate([begin + np.round(np.arange(k) * n / k).astype(int) for begin, n, k in parts])


def _onto(record: FlightRecord, name: str, index: np.ndarray, time: np.ndarray, factor: int) -> np.ndarray:
    values, sampled = record.channels[name][index], record.time[index]
    if name in _STEPWISE:
        return values[np.maximum(np.searchsorted(sampled, time, side="right") - 1, 0)][::factor]
    from scipy.interpolate import CubicSpline
    from scipy.signal import resample_poly

    if name in _WRAPPED:  # interpolating across the jump would sweep through the whole circle
        values = np.unwrap(values)
    with np.errstate(all="ignore"):  # numbers near the largest double overflow; the check afterwards tells it
        # A held value stands until the end: no spline is followed beyond the last sample.
        values = CubicSpline(sampled, values)(np.minimum(time, sampled[-1]))
        # "line": the filter sees the record go on along its trend, not fall to zero, at both ends.
        return values if factor == 1 else resample_poly(values, 1, factor, padtype="line")
