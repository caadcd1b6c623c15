"""Everything that a file holds, before any card says what it means."""

from __future__ import annotations

import os
import time
from collections import Counter, deque
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from bayes_aero.errors import InputError
from bayes_aero.flight.channel import Channel
from bayes_aero.flight.readers.base import Column, Heading, Lookup, Opened
from bayes_aero.flight.reading.read_record import bytes_of, format_of
from bayes_aero.flight.reading.segments import segment_of

__all__ = ["RawColumn", "RawFile", "read_raw"]

MOST = 20_000
"""Columns beyond this are not looked at."""

PATIENCE = 20.0  # seconds


@dataclass(frozen=True)
class RawColumn:
    """One column: its name (None in files without a header), place counted from 1, (n,) values, unit if the file says.

    Values are None where they are no numbers.
    """

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
        there = Lookup([column.heading for column in self.columns]).candidates(channel)
        return next((column for column in self.columns if column.heading in there[:1]), None)


def read_raw(path: str | os.PathLike[str]) -> RawFile:
    """Every column of a file, numeric or not; raises `InputError` with the file's name."""
    try:
        file = segment_of(path).file
        opened = format_of(file)(bytes_of(file))
        headings = dict(enumerate(opened.headings[:MOST], 1))
        often = Counter(name for h in headings.values() for name in h.names)
        repeated = tuple(sorted(name for name, count in often.items() if count > 1))
        places = {
            str(number): heading
            for number, heading in headings.items()
            if not set(heading.names) & set(repeated) and (heading.names or heading.column is not None)
        }
        found = _read(opened, places)
    except InputError as reason:
        raise InputError(f"{os.fspath(path)}: {reason}") from reason
    columns = []
    for number, heading in places.items():
        column = found.get(number)
        if column is not None and not heading.names and not np.isfinite(column.values).any():
            continue  # what follows a separator too many
        at = heading.column if heading.column is not None else int(number)
        values, unit = (column.values, column.unit) if column else (None, None)
        columns.append(
            RawColumn(heading.names[0] if heading.names and not heading.formed else None, at, values, unit, heading)
        )
    return RawFile(tuple(columns), repeated, tuple(opened.remarks))


def _read(opened: Opened, places: Mapping[str, Heading]) -> dict[str, Column]:
    """All columns at once; where one is no numbers, each half on its own, so that only it is lost.

    When `PATIENCE` is over, whatever has not been read is taken for no numbers.
    """
    found: dict[str, Column] = {}
    failure = InputError("it holds no column of numbers; is it the right file?")
    left = deque([list(places.items())])
    began = time.monotonic()
    while left and time.monotonic() - began < PATIENCE:
        some = left.popleft()
        try:
            found |= opened.read(dict(some))
        except InputError as reason:
            failure, half = reason, len(some) // 2
            left.extend([some[:half], some[half:]] if half else [])
    if not found:
        raise failure from None
    return found
