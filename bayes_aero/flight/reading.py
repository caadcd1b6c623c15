"""From a file on disk to a checked flight record in SI.

The way of a file: its bytes are read once (and hashed), the format of its suffix finds the columns that the
card names, their values are converted to SI, and the record is checked. Whatever is wrong is reported in one
InputError that starts with the file's name.
"""

from __future__ import annotations

import hashlib
import os
import time
from collections import Counter, deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from difflib import get_close_matches
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool
from scipy.ndimage import binary_closing, binary_dilation, uniform_filter1d

from bayes_aero.errors import InputError
from bayes_aero.flight.card import Card
from bayes_aero.flight.channel import STANDARD_CHANNELS, Channel, split_heading
from bayes_aero.flight.checks import JITTER, check_record, failures, resample_record, without_bad_options
from bayes_aero.flight.health import runs_of
from bayes_aero.flight.health.air import grounded
from bayes_aero.flight.readers import FileColumn, Heading, HeadingIndex, OpenedFile, binary, located, text
from bayes_aero.flight.record import GAP, SHORTEST, FlightRecord, cut, expanded, parts_of, samples_of, segment_of
from bayes_aero.units import canonical, instant, same_kind, same_unit, to_si

READERS: Mapping[str, Callable[[bytes], OpenedFile]] = dict(sorted((text.READS | binary.READS).items()))
"""What opens a file, by its suffix."""

MAX_BYTES = 1 << 30  # largest file that is taken for one manoeuvre: 1 GiB


def read_record(
    path: str | os.PathLike[str], channels: Sequence[Channel], *, resample: float | None = None
) -> FlightRecord:
    """Read, convert and check one manoeuvre; without `resample` uneven sampling and missing samples are refused."""
    name = os.fspath(path)
    try:
        segment = segment_of(path)
        record = without_bad_options(cut(_as_filed(path, channels), segment), channels, blanks=resample is not None)
        check_record(record, even=resample is None, channels=channels)
        if resample is not None:
            record = without_bad_options(resample_record(record, resample), channels)
            check_record(record, channels=channels)
    except InputError as reason:
        raise InputError(f"{name}: {reason}") from reason
    return record


def _as_filed(path: str | os.PathLike[str], channels: Sequence[Channel]) -> FlightRecord:
    """The whole file in SI, unchecked, without samples that were written twice."""
    segment = segment_of(path)
    opens = format_of(segment.file)
    names = [channel.name for channel in channels]
    for name in names:
        if names.count(name) > 1:
            raise InputError(f"channel {name} is mapped twice on the card; keep one of the two")
    if "time" not in names:
        raise InputError('channel time is not mapped on the card; add it to [channels] with unit = "s"')
    data = bytes_of(segment.file)
    opened = opens(data)
    places = located(channels, opened)
    columns = opened.read(places)
    if "time" not in columns:
        raise InputError("channel time is missing, and a record needs it; set required = true and correct its place")
    si = {c.name: in_si(c, columns[c.name], places[c.name]) for c in channels if c.name in columns}
    record = FlightRecord(
        name=segment.label,
        time=si["time"],
        channels=si,
        source=os.fspath(path),
        sha256=hashlib.sha256(data).hexdigest(),
        remarks=tuple(opened.remarks),
        read={
            "path": os.fspath(path).removesuffix(f"@{segment.words}") if segment.words else os.fspath(path),
            "part": segment.words,
            "resample": None,
            "windows": [],
            "split": False,
        },
    )
    return without_repeats(record)


def read_again(read: Mapping[str, Any], file: Path, channels: Sequence[Channel]) -> FlightRecord:
    """The record that was `read` before (see `FlightRecord.read`), from the whole `file`, where it is now."""
    part = f"@{read['part']}" if read["part"] else ""
    record = read_record(f"{file}{part}", channels, resample=read["resample"])
    for begin, end in read["windows"]:
        record = record.window(begin, end)
    return replace(record, read={**record.read, "split": read["split"]})


def read_records(
    paths: Sequence[str | os.PathLike[str]],
    channels: Sequence[Channel],
    *,
    resample: float | None = None,
    segments: Mapping[str, Sequence[str]] | None = None,
    split: bool = False,
) -> list[FlightRecord]:
    """Every manoeuvre of every file, also of those that a gap `split`s; the first bad one is reported."""
    parts = manoeuvres(paths, channels, segments=segments, split=split)
    records = [read_record(path, channels, resample=resample) for path in parts]
    return [replace(record, read={**record.read, "split": split}) for record in records]


def manoeuvres(
    paths: Sequence[str | os.PathLike[str]],
    channels: Sequence[Channel],
    *,
    segments: Mapping[str, Sequence[str]] | None = None,
    split: bool = False,
) -> list[Path]:
    """The paths of single manoeuvres that `paths` stand for, see `read_records`."""
    clock = [replace(channel, required=True) if channel.name == "time" else channel for channel in channels]
    times: dict[str, np.ndarray] = {}
    for path in paths if split else ():
        try:
            times[os.fspath(path)] = _as_filed(segment_of(path).file, clock).time
        except InputError as reason:
            raise InputError(f"{os.fspath(path)}: {reason}") from reason
    return expanded(paths, segments or {}, times if split else None)


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
    given = f"the suffix {path.suffix!r}" if path.suffix else "a file without suffix"
    if (suffix := path.suffix.lower()) not in READERS:
        raise InputError(
            f"{given} is not known; flight records end in {', '.join(READERS)}: rename or convert the file"
        )
    return READERS[suffix]


def bytes_of(path: Path) -> bytes:
    """The whole file: hashed as read, and no parser can be led to read beyond its end."""
    try:
        if path.is_dir():
            raise InputError("it is a directory; name a file in it")
        if not path.exists():
            raise InputError(_no_such_file(path))
        if not path.is_file():
            raise InputError("it is a pipe or a device; write the data to a regular file first")
        size = path.stat().st_size
        if size > MAX_BYTES:
            raise InputError(f"it has {size} bytes, more than {MAX_BYTES}; cut it to the manoeuvre")
        data = path.read_bytes()
    except (OSError, ValueError) as reason:
        if isinstance(reason, InputError):
            raise
        raise InputError(f"it cannot be read ({reason}); check its name and permissions") from reason
    if not data:
        raise InputError("the file is empty; copy or write it again")
    return data


def _no_such_file(path: Path) -> str:
    if not path.parent.is_dir():
        return f"no such file: its folder {str(path.parent)!r} does not exist; correct the path"
    neighbours = [entry.name for entry in path.parent.iterdir()][:10_000]
    close = get_close_matches(path.name, neighbours, n=3)
    return "no such file; " + (f"did you mean {' or '.join(close)}?" if close else "correct the path")


def in_si(channel: Channel, column: FileColumn, heading: Heading) -> np.ndarray:
    """A channel's values in SI, (n,), with the card's sign. Raises InputError: the file states another unit than the
    card."""
    unit = unit_in_file(channel, column, heading)
    standard = STANDARD_CHANNELS.get(channel.name)
    if unit is not None and same_unit(unit, channel.unit) is False:
        raise InputError(
            f"channel {channel.name} is in {unit!r} according to the file but in {channel.unit!r} according to the "
            f'card; correct the card: unit = "{canonical(unit, standard.unit if standard else None) or unit}"'
        )
    return channel.sign * to_si(column.values, channel.unit, channel.name, channel.si)


def unit_in_file(channel: Channel, column: FileColumn, heading: Heading) -> str | None:
    """The unit that a file states for a channel: in a row of units, an attribute, or its name ("rho (slug/ft3)"). What
    a name seems to say counts only where the channel can have that unit: the "g" of "q_g" may be a gyro."""
    if column.unit is not None:
        return column.unit
    for name in heading.names:
        unit = split_heading(name, channel.unit)[1]
        if unit is not None and same_kind(unit, channel.unit):
            return unit
    return None


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
        """How a person finds it in the file."""
        return f"column {self.number}" if self.label is None else repr(self.label)


@dataclass(frozen=True)
class RawFile:
    """A file's columns in its order; names that occur twice are left out and listed."""

    columns: tuple[RawColumn, ...]
    repeated: tuple[str, ...] = ()
    remarks: tuple[str, ...] = ()

    def find(self, channel: Channel) -> RawColumn | None:
        """The column that a card's channel names."""
        there = HeadingIndex([column.heading for column in self.columns]).candidates(channel)
        return next((column for column in self.columns if column.heading in there[:1]), None)


def read_raw(path: str | os.PathLike[str]) -> RawFile:
    """Every column of a file, numeric or not; raises `InputError` with the file's name."""
    try:
        file = segment_of(path).file
        opened = format_of(file)(bytes_of(file))
        headings = dict(enumerate(opened.headings[:MOST_COLUMNS], 1))
        often = Counter(name for h in headings.values() for name in h.names)
        repeated = tuple(sorted(name for name, count in often.items() if count > 1))
        places = {
            str(number): heading
            for number, heading in headings.items()
            if not set(heading.names) & set(repeated) and (heading.names or heading.column is not None)
        }
        numbers = _numeric(opened, places)
    except InputError as reason:
        raise InputError(f"{os.fspath(path)}: {reason}") from reason
    columns = []
    for number, heading in places.items():
        column = numbers.get(number, FileColumn(np.empty(0)))
        if number in numbers and not heading.names and not np.isfinite(column.values).any():
            continue  # what follows a separator too many
        at = heading.column if heading.column is not None else int(number)
        label = heading.names[0] if heading.names and not heading.formed else None
        columns.append(RawColumn(label, at, column.values if number in numbers else None, column.unit, heading))
    return RawFile(tuple(columns), repeated, tuple(opened.remarks))


def _numeric(opened: OpenedFile, places: Mapping[str, Heading]) -> dict[str, FileColumn]:
    """All columns at once; where one is no numbers, each half on its own, so that only it is lost, for `PATIENCE` s."""
    numbers: dict[str, FileColumn] = {}
    failure = InputError("it holds no column of numbers; is it the right file?")
    left = deque([list(places.items())])
    began = time.monotonic()
    while left and time.monotonic() - began < PATIENCE:
        some = left.popleft()
        try:
            numbers |= opened.read(dict(some))
        except InputError as reason:
            failure, half = reason, len(some) // 2
            left.extend([some[:half], some[half:]] if half else [])
    if not numbers:
        raise failure from None
    return numbers


# --- Samples that a recorder wrote twice.


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
    remark = (
        f"{what} the one before in time and in every channel of the card, and {'is' if count == 1 else 'are'} left out"
    )
    return replace(record.part(~again), remarks=(*record.remarks, remark))


# --- Records brought to one sampling rate, at which filters that span samples span the seconds they were made for.

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
    """A sentence where records were brought to another rate; none where they were not."""
    if not records:
        return ()
    dt = common_interval(records)
    odd = [f"{record.name} ({1.0 / record.dt:.4g} Hz)" for record in records if abs(record.dt - dt) > SAME * dt]
    said = f"Brought to the common rate of {1.0 / dt:.4g} Hz, filtered against aliasing: {', '.join(odd)}."
    return (said,) if odd else ()


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
    looked, record, inside, remarks = None, None, slice(None), raw.remarks
    if "time" in values:
        same = {name: x for name, x in values.items() if len(x) == len(values["time"])}
        looked = without_repeats(FlightRecord(Path(path).stem, values["time"], same, os.fspath(path), ""))
        remarks += looked.remarks
        try:
            inside = samples_of(looked.time, segment)
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
        sound = column.values[inside][np.isfinite(column.values[inside])]
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
MOST_OF_A_PART = 0.8  # of a part; a manoeuvre that fills more of it is the part
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
        part = record.part(slice(a, b))
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
            moved = _manoeuvres(record.part(slice(a, b)), a)
            if len(moved) > 1 or (moved and moved[0][1] - moved[0][0] < MOST_OF_A_PART * (b - a)):
                found += [_proposal(record, i, j, "manoeuvre", forward) for i, j in moved]
    return tuple(found)


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
