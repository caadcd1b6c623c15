"""Text tables: columns of numbers with or without a header, cells between blanks, tabs, commas, semicolons or pipes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from bayes_aero.errors import InputError
from bayes_aero.flight.readers.base import Column, Heading
from bayes_aero.flight.readers.clock import looks_like_clock, seconds
from bayes_aero.flight.readers.layout import Layout, Lines, laid_out, separator_of
from bayes_aero.flight.readers.numbers import Marks, is_blank, marks_of, number_of, thousands

__all__ = ["TextTable", "open_text"]

MOST_LINES, LONGEST_LINE = 5_000_000, 200_000
"""Far beyond any record; each line costs some hundred bytes of memory beside its own."""


def open_text(data: bytes) -> TextTable:
    """A text file of any layout that `layout` finds."""
    lines = _lines(data)
    return TextTable(laid_out(lines, separator_of(lines)))


READS = dict.fromkeys((".asc", ".txt", ".dat", ".csv", ".tsv"), open_text)


@dataclass
class TextTable:
    """A laid-out table whose cells are still text."""

    layout: Layout
    kind: str = "column"
    remarks: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.remarks.extend(self.layout.remarks)

    @property
    def headings(self) -> Sequence[Heading]:
        """One a column."""
        return self.layout.headings

    def read(self, wanted: Mapping[str, Heading]) -> dict[str, Column]:
        """See `Opened.read`. Blank cells come back as NaN, clock times and dates in seconds from the first sample."""
        indices = [heading.column - 1 for heading in wanted.values() if heading.column is not None]
        rows = [line for _, line in self.layout.body]
        separator = self.layout.separator
        if not indices:
            return {}
        if separator == "," or not any("," in row for row in rows):  # plain numbers: NumPy's own parser
            try:
                values = np.loadtxt(
                    rows, delimiter=separator, usecols=indices, ndmin=2, comments=None, dtype=np.float64
                )
                return {name: Column(values[:, k], h.unit) for k, (name, h) in enumerate(wanted.items())}
            except (ValueError, IndexError):
                pass  # blanks, clock times, other marks than a decimal point, or text: cell by cell
        split = [row.split(separator) for row in rows]
        cells = {name: [row[i].strip() for row in split] for name, i in zip(wanted, indices, strict=True)}
        return self._converted(cells, wanted)

    def _converted(self, cells: Mapping[str, list[str]], wanted: Mapping[str, Heading]) -> dict[str, Column]:
        clocks = {name for name, column in cells.items() if looks_like_clock(_first(column))}
        plain = {name: column for name, column in cells.items() if name not in clocks}
        marks = marks_of(cell for column in plain.values() for cell in column)
        columns = {}
        for name, column in cells.items():
            heading = wanted[name]
            if name in clocks:
                columns[name] = Column(self._seconds(name, column, heading), "s")
                continue
            columns[name] = Column(_numbers(self.layout.body, name, column, heading, marks), heading.unit)
            grouped = thousands(column, marks)
            if grouped:
                self._remark(f"channel {name}: {marks.thousands!r} as in {grouped!r} is read as a thousands separator")
        return columns

    def _seconds(self, name: str, column: Sequence[str], heading: Heading) -> np.ndarray:
        told = [k for k, cell in enumerate(column) if not is_blank(cell)]
        for k in told:
            if not looks_like_clock(column[k]):
                raise InputError(_no_number(self.layout.body, name, column[k], k, heading, "a clock time"))
        values = np.full(len(column), np.nan)
        try:
            values[told] = seconds([column[k] for k in told])
        except InputError as reason:
            raise InputError(f"channel {name} holds {reason}") from reason
        self._remark(f"channel {name}: the clock time {column[told[0]]} is t = 0")
        return values

    def _remark(self, sentence: str) -> None:
        if sentence not in self.remarks:
            self.remarks.append(sentence)


def _lines(data: bytes) -> Lines:
    """Decode; drop blank lines."""
    if data[:2] in (b"\xff\xfe", b"\xfe\xff"):
        text = data.decode("utf-16", errors="replace")
    elif b"\0" in data:
        raise InputError("it is not a text file (it holds NUL bytes); is it misnamed, or UTF-16? Save it as UTF-8 text")
    else:
        try:
            text = data.decode("utf-8-sig")
        except UnicodeDecodeError:
            text = data.decode("latin-1")  # older loggers: only the degree sign in a unit line is at stake
    count = text.count("\n") + text.count("\r")
    if count > MOST_LINES:
        raise InputError(f"it has {count} lines, more than {MOST_LINES}; cut it to the manoeuvre")
    rows = text.replace("\r\n", "\n").replace("\r", "\n").split("\n")
    longest = max(rows, key=len)
    if len(longest) > LONGEST_LINE:
        number = rows.index(longest) + 1
        raise InputError(
            f"line {number} has {len(longest)} characters, more than {LONGEST_LINE}; is it a table at all?"
        )
    lines = [(number, row.strip(" ")) for number, row in enumerate(rows, 1) if row and not row.isspace()]
    if not any(line[0] not in "#%" for _, line in lines):
        raise InputError("it holds no data, only blank lines or comments; write the record again")
    return lines


def _first(column: Sequence[str]) -> str:
    return next((cell for cell in column if not is_blank(cell)), "")


def _numbers(body: Lines, name: str, column: Sequence[str], heading: Heading, marks: Marks) -> np.ndarray:
    values = np.empty(len(column))
    for sample, cell in enumerate(column):
        try:
            values[sample] = number_of(cell, marks)
        except ValueError:
            raise InputError(_no_number(body, name, cell, sample, heading, "a number")) from None
    return values


def _no_number(body: Lines, name: str, cell: str, sample: int, heading: Heading, what: str) -> str:
    return (
        f"channel {name} has the text {cell[:30]!r} where {what} should be, in line {body[sample][0]}, column "
        f"{heading.column} (sample {sample}, counted from 0); correct or delete that line"
    )
