"""Text files: header-less columns (.asc .txt .dat, the ATTAS layout) and CSV."""

from __future__ import annotations

import csv
import re
from collections.abc import Sequence

import numpy as np

from bayes_aero.errors import InputError
from bayes_aero.flight.channel import Channel
from bayes_aero.flight.columns import Column, foreign, located

__all__ = ["csv_headings", "read_columns", "read_csv", "width_of"]

MOST_LINES, LONGEST_LINE = 5_000_000, 200_000
"""Far beyond any record; each line costs some hundred bytes of memory beside its own."""

CELL = "\x1f"
"""Between the cells of lines that were quoted: ASCII's own separator, which no text holds."""

THOUSANDS = re.compile(r"[+-]?[1-9]\d{0,2}(,\d{3})+")

Lines = list[tuple[int, str]]
"""Lines that carry data, each with its number in the file, counted from 1."""


def read_columns(data: bytes, channels: Sequence[Channel]) -> dict[str, Column]:
    """Whitespace-separated columns without a header; channels by their 1-based column."""
    lines = _lines(data, comments="#%")
    width = len(lines[0][1].split())
    _refuse_ragged(lines, [len(line.split()) for _, line in lines], width)
    wanted = []
    for channel in channels:
        if channel.column is not None and 1 <= channel.column <= width:
            wanted.append(channel)
        elif channel.required and channel.column is None:
            raise InputError(
                f"channel {channel.name} has no column number on the card, and the file has no header; "
                f"add column = N, or write the file as .csv with a header"
            )
        elif channel.required:
            raise InputError(
                f"channel {channel.name} is column {channel.column} on the card, but the file has {width} "
                f"columns; "
                f"correct the column, or set required = false"
            )
    indices = [channel.column - 1 for channel in wanted if channel.column is not None]
    values = _numbers(lines, indices, wanted, separator=None)
    return {channel.name: Column(values[:, k]) for k, channel in enumerate(wanted)}


def read_csv(data: bytes, channels: Sequence[Channel]) -> dict[str, Column]:
    """CSV with a header line, an optional line of units below it, and "," ";" or tab between the cells.

    Cells may be quoted, and then hold the separator. With ";" a decimal comma is understood, as spreadsheets write it
    in much of Europe; with the others within quotes, see `_has_decimal_commas`.
    """
    lines = _lines(data, comments="#")
    number, header = lines[0]
    separator = _separator(header)
    headings = _cells(header, separator, number)
    wanted = located(channels, headings, "column")
    indices = [headings.index(channel.heading) for channel in wanted]
    body, units = lines[1:], {}
    if body:
        cells = _cells(body[0][1], separator, body[0][0])
        picked = [cells[i] if i < len(cells) else "" for i in indices]
        # A unit line has no number in any wanted column; "1" is a unit too, but never the only one: time has
        # "s".
        if picked and not any(_is_number(cell) for cell in picked if cell != "1"):
            units = {channel.name: cell.strip("[]() ") for channel, cell in zip(wanted, picked, strict=True)}
            body = body[1:]
    if not body:
        raise InputError(f"it has a header (line {number}) but no samples below it; write the record again")
    decimal_commas = separator == ";"
    if any('"' in line for _, line in body):
        body, separator = [(at, CELL.join(_cells(line, separator, at))) for at, line in body], CELL
        decimal_commas = decimal_commas or _has_decimal_commas(body, indices)
    width = len(headings)
    if all(line.endswith(separator) for _, line in body) and body[0][1].count(separator) == width:
        body = [(at, line[:-1]) for at, line in body]  # one separator too many at every end is a habit of loggers
    _refuse_ragged(body, [line.count(separator) + 1 for _, line in body], width)
    if decimal_commas:
        body = [(at, line.replace(",", ".")) for at, line in body]
    values = _numbers(body, indices, wanted, separator)
    return {channel.name: Column(values[:, k], units.get(channel.name)) for k, channel in enumerate(wanted)}


def csv_headings(data: bytes) -> list[str]:
    """The header's cells."""
    number, header = _lines(data, comments="#")[0]
    return _cells(header, _separator(header), number)


def width_of(data: bytes) -> int:
    """Number of columns in a file without a header."""
    return len(_lines(data, comments="#%")[0][1].split())


def _lines(data: bytes, comments: str) -> Lines:
    """Decode; drop comments and blank lines."""
    if b"\0" in data:
        raise InputError("it is not a text file (it holds NUL bytes); is it misnamed, or UTF-16? Save it as UTF-8 text")
    count = data.count(b"\n") + data.count(b"\r")
    if count > MOST_LINES:
        raise InputError(f"it has {count} lines, more than {MOST_LINES}; cut it to the manoeuvre")
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = data.decode("latin-1")  # older loggers: only the degree sign in a unit line is at stake
    rows = text.replace("\r\n", "\n").replace("\r", "\n").split("\n")
    longest = max(rows, key=len)
    if len(longest) > LONGEST_LINE:
        number = rows.index(longest) + 1
        raise InputError(
            f"line {number} has {len(longest)} characters, more than {LONGEST_LINE}; is it a table at all?"
        )
    # Only whole lines are comments: "#" occurs inside names, as in "N1 engine #2".
    lines = [
        (number, row.strip(" "))
        for number, row in enumerate(rows, 1)
        if row and not row.isspace() and row.lstrip()[0] not in comments
    ]
    if not lines:
        raise InputError("it holds no data, only blank lines or comments; write the record again")
    return lines


def _separator(header: str) -> str:
    """What stands between the cells of a header; what is quoted does not count."""
    return max(";\t,", key=re.sub(r'"[^"]*"', "", header).count)


def _cells(line: str, separator: str, number: int) -> list[str]:
    with foreign(f"CSV file, line {number}"):
        reader = csv.reader([line, ""], delimiter=separator, skipinitialspace=True)
        cells = [cell.strip() for cell in next(reader)]
        if reader.line_num > 1:  # it went on, to look for the end of a cell
            raise InputError(
                f"line {number} has a quote that is not closed; close it (no cell goes on in the next line), or write "
                "the record without quotes"
            )
    return cells


def _has_decimal_commas(lines: Lines, indices: Sequence[int]) -> bool:
    """Whether the commas within wanted cells are decimal ones, which a quoted "12,345" alone does not say.

    They are where no cell has a point, and some comma cannot stand before thousands, as in "0,040" or "1,5".
    """
    decimal = False
    for _, line in lines:
        cells = line.split(CELL)
        for cell in (cells[i] for i in indices if i < len(cells)):
            if "." in cell:
                return False
            decimal = decimal or ("," in cell and THOUSANDS.fullmatch(cell) is None)
    return decimal


def _is_number(cell: str) -> bool:
    try:
        float(cell.replace(",", "."))
    except ValueError:
        return cell == ""  # an empty cell is a missing number, not a unit
    return True


def _refuse_ragged(lines: Lines, widths: list[int], width: int) -> None:
    for sample, ((number, _), found) in enumerate(zip(lines, widths, strict=True)):
        if found != width:
            raise InputError(
                f"line {number} (sample {sample}, counted from 0) has {found} columns where {width} are "
                f"expected, as in the first line; complete or delete that line"
            )


def _numbers(lines: Lines, indices: list[int], channels: Sequence[Channel], separator: str | None) -> np.ndarray:
    """The (n, len(indices)) numbers in the given columns."""
    if not indices:
        return np.empty((len(lines), 0))
    rows = [line for _, line in lines]
    try:
        return np.loadtxt(rows, delimiter=separator, usecols=indices, ndmin=2, comments=None, dtype=np.float64)
    except (ValueError, IndexError) as reason:
        raise InputError(_not_a_number(lines, indices, channels, separator)) from reason


def _not_a_number(lines: Lines, indices: list[int], channels: Sequence[Channel], separator: str | None) -> str:
    """Find the cell that stopped the parser."""
    for sample, (number, line) in enumerate(lines):
        cells = line.split(separator)
        for index, channel in zip(indices, channels, strict=True):
            cell = cells[index].strip()
            try:
                float(cell)
                sound = "_" not in cell
            except ValueError:
                sound = False
            if not sound:
                what = f"the text {cell[:30]!r}" if cell else "an empty cell"
                header = " Files of this kind have no header; write it as .csv to keep one." if sample == 0 else ""
                return (
                    f"channel {channel.name} has {what} where a number should be, in line {number}, column "
                    f"{index + 1} "
                    f"(sample {sample}, counted from 0); correct or delete that line."
                    + (header if separator is None else "")
                )
    return "its numbers cannot be read; write the file again"
