"""From a file on disk to a checked flight record in SI.

The way of a file: its bytes are read once (and hashed), a reader for its suffix finds the columns that the
card names, their values are converted to SI, and the record is checked. Whatever is wrong is told in one
InputError that starts with the file's name.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Mapping, Sequence
from difflib import get_close_matches
from pathlib import Path

import numpy as np

from bayes_aero.errors import InputError
from bayes_aero.flight.binary import read_mat, read_netcdf, read_parquet
from bayes_aero.flight.channel import STANDARD_CHANNELS, Channel
from bayes_aero.flight.checks import check_record
from bayes_aero.flight.columns import Column
from bayes_aero.flight.plausible import without_bad_options
from bayes_aero.flight.record import FlightRecord
from bayes_aero.flight.resample import resample_record
from bayes_aero.flight.text import read_columns, read_csv
from bayes_aero.flight.writers import write_record
from bayes_aero.units import same_unit, to_si

__all__ = ["READERS", "present", "read_record", "read_records", "write_record"]

Reader = Callable[[bytes, Sequence[Channel]], dict[str, Column]]

READERS: Mapping[str, Reader] = {
    ".asc": read_columns,
    ".txt": read_columns,
    ".dat": read_columns,
    ".csv": read_csv,
    ".mat": read_mat,
    ".parquet": read_parquet,
    ".nc": read_netcdf,
}

MAX_BYTES = 1 << 30
"""Largest file that is taken for one manoeuvre: 1 GiB."""


def read_record(
    path: str | os.PathLike[str], channels: Sequence[Channel], *, resample: float | None = None
) -> FlightRecord:
    """Read, convert and check one manoeuvre.

    Args:
        path: the file; its suffix tells the format (see READERS).
        channels: what the card maps; "time" must be among them.
        resample: interval in s of an even grid to interpolate onto; without it uneven sampling is refused.
    """
    name = os.fspath(path)
    try:
        reader = reader_for(Path(path))
        _refuse_odd_cards(channels)
        data = bytes_of(Path(path))
        found = reader(data, channels)
        record = FlightRecord(
            name=Path(path).stem,
            time=_in_si(found, "time", channels),
            channels={c.name: _in_si(found, c.name, channels) for c in channels if c.name in found},
            source=name,
            sha256=hashlib.sha256(data).hexdigest(),
        )
        record = without_bad_options(record, channels)
        check_record(record, even=resample is None, channels=channels)
        if resample is not None:
            record = resample_record(record, resample)
            check_record(record, channels=channels)
    except InputError as reason:
        raise InputError(f"{name}: {reason}") from reason
    return record


def read_records(
    paths: Sequence[str | os.PathLike[str]], channels: Sequence[Channel], *, resample: float | None = None
) -> list[FlightRecord]:
    """Every file, one manoeuvre each; the first bad one is reported."""
    return [read_record(path, channels, resample=resample) for path in paths]


def present(path: Path) -> None:
    """Refuse a name of which there is no file; nothing need be loaded to see that."""
    try:
        there = path.exists()
    except (OSError, ValueError):  # a name that cannot be one: reading says so
        return
    if not there:
        raise InputError(f"{path}: {_no_such_file(path)}")


def reader_for(path: Path) -> Reader:
    """The reader of a file, told by its suffix."""
    reader = READERS.get(path.suffix.lower())
    if reader is None:
        given = f"the suffix {path.suffix!r}" if path.suffix else "a file without suffix"
        raise InputError(
            f"{given} is not known; flight records end in {', '.join(READERS)}: rename or convert the file"
        )
    return reader


def _refuse_odd_cards(channels: Sequence[Channel]) -> None:
    names = [channel.name for channel in channels]
    for name in names:
        if names.count(name) > 1:
            raise InputError(f"channel {name} is mapped twice on the card; keep one of the two")
    if "time" not in names:
        raise InputError('channel time is not mapped on the card; add it to [channels] with unit = "s"')


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


def _in_si(found: Mapping[str, Column], name: str, channels: Sequence[Channel]) -> np.ndarray:
    channel = next(channel for channel in channels if channel.name == name)
    if name not in found:
        raise InputError("channel time is missing, and a record needs it; set required = true and correct its place")
    column = found[name]
    if column.unit is not None and same_unit(column.unit, channel.unit) is False:
        raise InputError(
            f"channel {name} is in {column.unit!r} according to the file but in {channel.unit!r} according "
            f"to the card; "
            f'correct the card: unit = "{column.unit}"'
        )
    standard = STANDARD_CHANNELS.get(name)
    return channel.sign * to_si(column.values, channel.unit, name, standard.unit if standard else None)
