"""A flight record: one manoeuvre, named channels of equal length, in SI."""

from __future__ import annotations

import hashlib
import io
import math
import os
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from difflib import get_close_matches
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from bayes_aero.atomic_write import write_whole
from bayes_aero.errors import InputError
from bayes_aero.flight.channel import STANDARD_CHANNELS, Channel
from bayes_aero.physics.aircraft import GRAVITY
from bayes_aero.units import instant


def _frozen(values: Any, label: str, n: int | None = None) -> np.ndarray:
    """A private, read-only float64 vector; `n` is the length it must have."""
    try:
        array = np.array(values, dtype=np.float64)
    except (TypeError, ValueError) as reason:
        raise InputError(f"{label} is not numeric ({reason}); give a vector of numbers") from reason
    if array.ndim != 1:
        raise InputError(f"{label} has shape {array.shape}; give a vector, one value a sample")
    if n is not None and array.size != n:
        raise InputError(f"{label} has {array.size} samples where time has {n}; all channels need the same length")
    array.flags.writeable = False
    return array


@dataclass(frozen=True, eq=False)
class FlightRecord:
    """One manoeuvre. Immutable: the arrays are read-only copies.

    Attributes:
        name: short name, the stem of the file.
        time: (n,) time in s, as in the file.
        channels: channel name -> (n,) values in SI and radians; time is not among them.
        source: where the record came from, for provenance.
        sha256: SHA-256 of the file's bytes; of the arrays' bytes for a record made in memory.
        dropped: channel -> reason why it was omitted when the file was read.
        remarks: how the file was read if there are several ways, one sentence each.
        read: how the file is read to this record: its path, `part` (as behind FILE@), `resample` (s), `windows` cut out
            after that (s), and whether gaps `split` it. Empty for a record made in memory.
    """

    name: str
    time: np.ndarray
    channels: Mapping[str, np.ndarray]
    source: str
    sha256: str
    dropped: Mapping[str, str] = field(default_factory=dict)
    remarks: tuple[str, ...] = ()
    read: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        time = _frozen(self.time, f"record {self.name}: channel time")
        frozen = {
            key: _frozen(values, f"record {self.name}: channel {key}", time.size)
            for key, values in self.channels.items()
            if key != "time"
        }
        object.__setattr__(self, "time", time)
        object.__setattr__(self, "channels", MappingProxyType(frozen))

    @classmethod
    def from_arrays(
        cls, name: str, time: Any, channels: Mapping[str, Any], source: str = "arrays in memory"
    ) -> FlightRecord:
        """A record of arrays.

        Args:
            name: short name.
            time: (n,) in s.
            channels: channel name -> (n,) values in SI and radians; not checked for plausibility
                (`reading.check_record` does this).
            source: origin of the record.

        Raises:
            InputError: an array is not numeric or has another length.
        """
        record = cls(name, time, channels, source, "")
        return replace(record, sha256=record.content)

    @cached_property
    def content(self) -> str:
        """SHA-256 of the samples: the same for the same channels, whatever file they come from."""
        digest = hashlib.sha256(self.time.tobytes())
        for key in sorted(self.channels):
            digest.update(key.encode() + b"\0" + self.channels[key].tobytes())
        return digest.hexdigest()

    @property
    def n(self) -> int:
        """Number of samples."""
        return int(self.time.size)

    def __len__(self) -> int:
        return self.n

    @cached_property
    def dt(self) -> float:
        """Sampling interval in s: the mean step (checks ensure that all steps agree)."""
        if self.n < 2:
            raise InputError(f"record {self.name} has {self.n} samples; two are needed for a sampling interval")
        return float((self.time[-1] - self.time[0]) / (self.n - 1))

    @property
    def names(self) -> tuple[str, ...]:
        """All channels, time first."""
        return ("time", *self.channels)

    def has(self, name: str) -> bool:
        """Whether the channel is in the record."""
        return name == "time" or name in self.channels

    def __getitem__(self, channel: str) -> np.ndarray:
        if channel == "time":
            return self.time
        if channel in self.channels:
            return self.channels[channel]
        close = get_close_matches(channel, self.channels, n=1)
        hint = f" (did you mean {close[0]}?)" if close else ""
        mapped = ", ".join(self.names)
        raise InputError(f"record {self.name} has no channel {channel}{hint}; the card maps {mapped}; add it there")

    def window(self, t0: float, t1: float) -> FlightRecord:
        """The samples with t0 <= time <= t1 (s), as a new record with the same source.

        Raises:
            InputError: there is no sample in this interval.
        """
        slack = 1e-6 * self.dt  # 0.04 * 25 is not 1 in binary
        keep = (self.time >= t0 - slack) & (self.time <= t1 + slack)
        if not keep.any():
            runs = f"it runs from {instant(self.time[0])} to {instant(self.time[-1])} s"
            raise InputError(f"record {self.name} has no sample between {instant(t0)} and {instant(t1)} s; {runs}")
        read = {**self.read, "windows": [*self.read["windows"], [float(t0), float(t1)]]} if self.read else {}
        name, source = f"{self.name}_{instant(t0)}-{instant(t1)}s", f"{self.source}, {instant(t0)} s to {instant(t1)} s"
        return replace(self.part(keep), name=name, source=source, read=read)

    def part(self, inside: Any) -> FlightRecord:
        """These samples, all else as it is."""
        return replace(self, time=self.time[inside], channels={name: x[inside] for name, x in self.channels.items()})

    def __reduce__(self) -> tuple[Any, ...]:
        # A mapping proxy cannot be pickled, and records are sent to worker processes.
        state = self.source, self.sha256, dict(self.dropped), self.remarks, dict(self.read)
        return FlightRecord, (self.name, self.time, dict(self.channels), *state)


# --- How far a simulation may be from flight: bands by output, each with its source. A card may replace them.

KNOT = 0.514444
_STALL = "14 CFR Part 60 Appendix A, Table A2A, 2.c.8"
_SHORT = "14 CFR Part 60 Appendix A, Table A2A, 2.c.10"
_LATERAL = "14 CFR Part 60 Appendix A, Table A2A, 2.d"
_READ = "read in the edition of 2014, volume 2, page 57"
_UNCHECKED = "not checked against the text"


@dataclass(frozen=True)
class Tolerance:
    """Half the width of a band in SI, and where it comes from."""

    value: float
    source: str


TOLERANCES = {
    "airspeed": Tolerance(3.0 * KNOT, f"{_STALL}, +-3 kt; read in the 2014 edition's 2.c.8 of Appendix B"),
    "alpha": Tolerance(math.radians(2.0), f"{_STALL}, +-2 deg; {_UNCHECKED}"),
    "theta": Tolerance(math.radians(2.0), f"{_STALL}, +-2 deg; {_UNCHECKED}"),
    "q": Tolerance(math.radians(2.0), f"{_SHORT}, +-2 deg/s; {_READ}"),
    "az": Tolerance(0.1 * GRAVITY, f"{_SHORT}, +-0.10 g; {_READ}"),
    "p": Tolerance(math.radians(2.0), f"{_LATERAL}.2 (roll response), +-2 deg/s; {_READ}"),
    "r": Tolerance(math.radians(2.0), f"{_LATERAL}.6 (rudder response), +-2 deg/s; {_READ[:-2]}58"),
    "phi": Tolerance(math.radians(2.0), f"{_LATERAL}.4 (spiral stability), +-2 deg; {_READ[:-2]}58"),
    "beta": Tolerance(math.radians(1.0), f"{_LATERAL}.8 (steady sideslip), +-1 deg; {_READ[:-2]}59"),
}
"""Of the objective tests of a flight simulator's qualification; used as bands on the whole time history."""


# --- Parts of a file: `FILE@FROM:TO` in seconds of the file's time, `FILE@#2` for the second part between gaps.

GAP = 1.5  # a step longer than this many median steps is a gap: at least one sample is lost
SHORTEST = 50  # samples of a part that is worth a record
_NUMBER = r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d{1,3})?"
_SPAN = re.compile(rf"(?P<file>.+)@(?:(?P<begin>{_NUMBER})?:(?P<end>{_NUMBER})?|#(?P<part>\d{{1,6}}))")


@dataclass(frozen=True)
class Segment:
    """A file, and the part of it that is meant: between times, s, or a number between gaps, counted from 1."""

    file: Path  # without the part
    begin: float = -np.inf
    end: float = np.inf
    part: int = 0
    words: str = ""  # the part as it was written behind "@"; empty for the whole file

    @property
    def whole(self) -> bool:
        return not self.words or self.words == ":"

    @property
    def label(self) -> str:
        begin, end = (instant(limit) if np.isfinite(limit) else "" for limit in (self.begin, self.end))
        part = f"_part{self.part}" if self.part else f"_{begin}-{end}"
        return self.file.stem + ("" if self.whole else part)


def is_file(path: Path) -> bool:
    """Whether it is a file; a name that no file can have (too long, with NUL) is none."""
    try:
        return path.is_file()
    except (OSError, ValueError):
        return False


def segment_of(path: str | os.PathLike[str]) -> Segment:
    """What a path means; a file whose whole name looks like a segment is that file."""
    text = os.fspath(path)
    match = _SPAN.fullmatch(text)
    if match is None or is_file(Path(text)):
        return Segment(Path(text))
    begin, end = float(match["begin"] or -np.inf), float(match["end"] or np.inf)
    if not begin < end:
        raise InputError(f"{text}: the part {match['begin']}:{match['end']} holds nothing; write FROM before TO")
    return Segment(Path(match["file"]), begin, end, int(match["part"] or 0), text[len(match["file"]) + 1 :])


def samples_of(time: np.ndarray, segment: Segment) -> slice:
    """Which samples of a file with (n,) time in s a part has. Raises InputError: the file has no sample there."""
    if segment.whole:
        return slice(None)
    parts = parts_of(time)
    if segment.words.startswith("#"):
        if not 1 <= segment.part <= len(parts):
            raise InputError(f"there is no part {segment.part}: gaps in time divide it into {len(parts)}")
        return slice(*parts[segment.part - 1])
    if (np.diff(time) <= 0.0).any():
        raise InputError("its time starts over or repeats; name parts by number (FILE@#1, FILE@#2, or --split)")
    slack = 1e-6 * float(np.median(np.diff(time))) if len(time) > 1 else 0.0  # times that were typed are rounded
    inside = np.flatnonzero((time >= segment.begin - slack) & (time <= segment.end + slack))
    if not len(inside):
        runs = f"its time goes from {instant(time[0])} to {instant(time[-1])} s"
        raise InputError(f"no sample lies in the part {segment.words} (s): {runs}; correct the part")
    return slice(int(inside[0]), int(inside[-1]) + 1)


def parts_of(time: np.ndarray) -> list[tuple[int, int]]:
    """First sample and the one after the last of each part between gaps, or where time starts over; (n,) time in s."""
    step = np.diff(time)
    if not len(step):
        return [(0, len(time))]
    forward = step[step > 0.0]
    median = float(np.median(forward)) if len(forward) else 0.0
    repeated = np.mean(step == 0.0) > 0.1  # rounded stamps: no seam between them
    seams = (step > GAP * median) | ((step < 0.0) if repeated else (step <= 0.0))
    if repeated or np.mean(seams) > 0.05:  # stamps that are rounded or uneven throughout are no gaps
        seams = (step > 5.0 * max(median, float(np.mean(step[step >= 0.0])))) | (step < 0.0)
    return list(pairwise([0, *(np.flatnonzero(seams) + 1).tolist(), len(time)]))


# --- Write flight records to files that `reading.read_record` reads.

Columns = list[tuple[Channel, np.ndarray]]  # channels to write, each with its (n,) values in the file's unit


def write_record(record: FlightRecord, path: str | os.PathLike[str], channels: Sequence[Channel]) -> None:
    """Write a record in a format that `read` reads. The file is written whole or not at all.

    Args:
        record: channels of shape (n,) in SI and radians.
        path: the file; its suffix selects the format (`WRITERS`).
        channels: those of a card; they are written in the card's units and signs.

    Raises:
        InputError: the suffix is unknown, a required channel is missing, or the file cannot be written.
    """
    target = Path(path)
    writer = WRITERS.get(target.suffix.lower())
    if writer is None:
        raise InputError(f"{target}: records are written as {', '.join(WRITERS)}; choose one of these suffixes")
    written = [channel for channel in channels if record.has(channel.name) or channel.required]
    columns, buffer = [(channel, channel.filed(record[channel.name])) for channel in written], io.BytesIO()
    try:
        writer(columns, buffer)
        write_whole(buffer.getvalue(), target)
    except InputError as reason:
        raise InputError(f"{target}: {reason}") from reason
    except OSError as reason:
        raise InputError(f"{target}: it cannot be written ({reason.strerror}); check its permissions") from reason


def _asc(columns: Columns, file: io.BytesIO) -> None:
    """Columns where the card puts them; zeros in the columns that it does not map."""
    table = np.zeros((columns[0][1].size, max(channel.column or 0 for channel, _ in columns)))
    for channel, values in columns:
        if channel.column is None:
            raise InputError(f"channel {channel.name} has no column number; add column = N to the card, or write .csv")
        table[:, channel.column - 1] = values
    np.savetxt(file, table, fmt="%.17g")  # 17 digits bring back every double exactly


def _csv(columns: Columns, file: io.BytesIO) -> None:
    import csv

    header = io.StringIO()
    csv.writer(header, lineterminator="\n").writerow([channel.heading for channel, _ in columns])
    file.write(header.getvalue().encode())
    np.savetxt(file, np.column_stack([values for _, values in columns]), fmt="%.17g", delimiter=",")


def _mat(columns: Columns, file: io.BytesIO) -> None:
    from scipy.io import savemat

    for channel, _ in columns:
        if re.fullmatch(r"[A-Za-z]\w{0,62}", channel.heading, re.ASCII) is None:
            why = "is no MATLAB name; give it a label of letters, digits and underscores"
            raise InputError(f"channel {channel.name}: {channel.heading!r} {why}")
    savemat(file, {channel.heading: values[:, None] for channel, values in columns}, do_compression=True)


def _parquet(columns: Columns, file: io.BytesIO) -> None:
    import pyarrow as pa
    import pyarrow.parquet as pq

    fields = [pa.field(channel.heading, pa.float64(), metadata={"units": channel.unit}) for channel, _ in columns]
    pq.write_table(pa.table([values for _, values in columns], schema=pa.schema(fields)), file)


def _netcdf(columns: Columns, file: io.BytesIO) -> None:
    import xarray as xr

    variables = {}
    for channel, values in columns:
        standard = STANDARD_CHANNELS.get(channel.name)
        about = {"units": channel.unit} | ({"long_name": standard.description} if standard else {})
        variables[channel.heading] = ("sample", values, about)
    file.write(xr.Dataset(variables).to_netcdf(engine="h5netcdf"))


WRITERS: dict[str, Callable[[Columns, io.BytesIO], None]] = {
    **dict.fromkeys((".asc", ".txt", ".dat"), _asc), ".csv": _csv, ".mat": _mat, ".parquet": _parquet, ".nc": _netcdf,
}  # fmt: skip
