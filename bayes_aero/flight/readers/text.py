"""Text tables: columns of numbers with or without a header, cells between blanks, tabs, commas, semicolons or pipes."""

from __future__ import annotations

import csv
import math
import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from bayes_aero.errors import InputError
from bayes_aero.flight.channel import ALIASES, split_heading
from bayes_aero.flight.readers import FileColumn, Heading, OpenedFile, foreign
from bayes_aero.units import spellings

MOST_LINES, LONGEST_LINE = 5_000_000, 200_000
"""Far beyond any record; each line costs some hundred bytes of memory beside its own."""


def open_text(data: bytes) -> OpenedFile:
    """A text file of any layout that `laid_out` finds."""
    lines = _lines(data)
    return text_table(laid_out(lines, separator_of(lines)))


READS = dict.fromkeys((".asc", ".txt", ".dat", ".csv", ".tsv"), open_text)


def text_table(layout: Layout, remarks: Iterable[str] = ()) -> OpenedFile:
    """A laid-out table whose cells are still text."""
    said = [*remarks, *layout.remarks]
    return OpenedFile(layout.headings, lambda wanted: read_cells(layout, wanted, said), "column", said)


def read_cells(layout: Layout, wanted: Mapping[str, Heading], remarks: list[str]) -> dict[str, FileColumn]:
    """See `OpenedFile.read`. Blank cells come back as NaN, clock times and dates in seconds from the first sample."""
    indices = [heading.column - 1 for heading in wanted.values() if heading.column is not None]
    rows = [line for _, line in layout.body]
    if not indices:
        return {}
    if layout.separator == "," or not any("," in row for row in rows):  # plain numbers: NumPy's own parser
        try:
            values = np.loadtxt(
                rows, delimiter=layout.separator, usecols=indices, ndmin=2, comments=None, dtype=np.float64
            )
            return {name: FileColumn(values[:, k], h.unit) for k, (name, h) in enumerate(wanted.items())}
        except (ValueError, IndexError):
            pass  # blanks, clock times, other marks than a decimal point, or text: cell by cell
    split = [row.split(layout.separator) for row in rows]
    cells = {name: [row[i].strip() for row in split] for name, i in zip(wanted, indices, strict=True)}
    firsts = {name: next((cell for cell in column if not is_blank(cell)), "") for name, column in cells.items()}
    clocks = {name for name, first in firsts.items() if looks_like_clock(first)}
    marks = marks_of(cell for name, column in cells.items() if name not in clocks for cell in column)
    columns = {}
    for name, column in cells.items():
        clock, heading, values, sample, remark = name in clocks, wanted[name], np.full(len(column), np.nan), 0, ""
        filled = [k for k, cell in enumerate(column) if not is_blank(cell)]
        try:
            for sample in filled:
                if not clock:
                    values[sample] = number_of(column[sample], marks)
                elif not looks_like_clock(column[sample]):
                    raise ValueError
            if clock:
                values[filled] = seconds([column[k] for k in filled])
                remark = f"channel {name}: the clock time {firsts[name]} is t = 0"
        except InputError as reason:
            raise InputError(f"channel {name} holds {reason}") from reason
        except ValueError:
            raise InputError(
                f"channel {name} has the text {column[sample][:30]!r} where {'a clock time' if clock else 'a number'} "
                f"should be, in line {layout.body[sample][0]}, column {heading.column} (sample {sample}, counted from "
                "0); correct or delete that line"
            ) from None
        columns[name] = FileColumn(values, "s" if clock else heading.unit)
        grouped = next((cell for cell in column if marks.thousands and marks.thousands in cell), "")
        if grouped and not clock:
            remark = f"channel {name}: {marks.thousands!r} as in {grouped!r} is read as a thousands separator"
        remarks += [remark] if remark and remark not in remarks else []
    return columns


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


# --- Where a text table keeps its header, its units and its samples, and what stands between its cells.
# Loggers write a preamble above the header, one or two rows of names, a row of units, or none of these. The samples
# are what repeats: they are looked for first, in the lower part of the file, and the header is what stands above
# them.

T = TypeVar("T")

CELL = "\x1f"  # between the cells of lines that were quoted: ASCII's own separator, which no text holds
SEPARATORS = (";", "\t", "|", CELL, ",", None)  # None: blanks; of two that fit alike the first is taken
LOOKED_AT = 40  # lines, spread over the lower part of the file
MOST_HEADER_ROWS = 4
UNIT_SHARE = 1.0 / 3.0  # of the cells of a row below the names that are known units: more, and it is a row of units
_SEP_LINE = re.compile(r'"?sep=.?"?[;,\t]*', re.IGNORECASE)
_COMMENT = "#%"

Lines = list[tuple[int, str]]  # lines of a file, each with its number, counted from 1


@dataclass(frozen=True)
class Layout:
    """A text table: headings of all columns, its samples, the separator of their cells (None: blanks), remarks."""

    headings: tuple[Heading, ...]
    body: Lines
    separator: str | None
    remarks: tuple[str, ...] = ()


def separator_of(lines: Lines) -> str | None:
    """The separator that cuts the file into the most regular table of numbers."""
    some = _lower_part([line for _, line in lines if line[0] not in _COMMENT] or [line for _, line in lines])
    best, most = None, 0.0
    for separator in SEPARATORS:
        rows = [split(line, separator) for line in some]
        width, count = Counter(len(row) for row in rows).most_common(1)[0]
        if width < 2 and separator is not None:
            continue
        cells = [cell for row in rows if len(row) == width for cell in row if not is_blank(cell)]
        values = sum(map(is_value, cells)) / max(len(cells), 1)
        score = count / len(rows) * values * (0.99 if separator is None else 1.0)
        if score > most + 1e-9:
            best, most = separator, score
    if most > 0.0:
        return best
    header = re.sub(r'"[^"]*"', "", lines[0][1])  # no numbers at all: by the first line alone
    return max((s for s in (";", "\t", "|", ",") if s in header), key=header.count, default=None)


def split(line: str, separator: str | None, number: int | None = None) -> list[str]:
    """The cells of a line without the blanks around them; `number` is the line's, for errors. Raises InputError: a
    quote is not closed."""
    if separator is None:
        return line.split()
    if '"' not in line:
        return [cell.strip() for cell in line.split(separator)]
    with foreign(f"text file, line {number}"):
        reader = csv.reader([line, ""], delimiter=separator, skipinitialspace=True)
        cells = [cell.strip() for cell in next(reader)]
        if reader.line_num > 1 and number is not None:  # it went on, to look for the end of a cell
            raise InputError(
                f"line {number} has a quote that is not closed; close it (no cell goes on in the next line), or write "
                "the record without quotes"
            )
    return cells


def laid_out(lines: Lines, separator: str | None) -> Layout:
    """Find header, units and samples. Raises InputError: no samples, or lines of different length among them."""
    lines = [(at, line) for at, line in lines if not _SEP_LINE.fullmatch(line)]
    while lines and not lines[-1][1].strip(" \t,;|\x1f"):
        lines = lines[:-1]  # rows of separators at the end
    if not lines:
        raise InputError("it holds no data, only blank lines or separators; write the record again")
    rows = _lower_part([split(line, separator) for _, line in lines if line[0] not in _COMMENT])
    width = Counter(map(len, rows)).most_common(1)[0][0] if rows else 0
    valued = [k for k in range(width) if value_share([row[k] for row in rows if len(row) == width]) > 0.5]

    def is_sample(line: str) -> bool:  # as many cells as the samples, and values where they have values
        cells = split(line, separator) if line and line[0] not in _COMMENT else []
        return len(cells) == width and value_share([cells[k] for k in valued]) >= 0.5

    first = next((i for i, (_, line) in enumerate(lines) if is_sample(line)), None)
    if first is None:  # a header alone, or a table of text: the first line names the columns
        number, line = lines[0]
        if len(lines) == 1:
            raise InputError(f"it has a header (line {number}) but no samples below it; write the record again")
        header = split(line, separator, number)
        _refuse_ragged(lines[1:], separator, len(header))
        headings = tuple(Heading((name,) if name else (), k, None) for k, name in enumerate(header, 1))
        return Layout(headings, lines[1:], separator)
    for number, line in reversed(lines[:first]):  # what stands just above the first whole sample may be a damaged one
        if line[0] in _COMMENT:
            continue
        cells = split(line, separator)
        filled = [cell for cell in cells if not is_blank(cell)]
        if len(filled) >= max(0.5 * width, 2) and value_share(filled) > 0.5:
            raise InputError(_ragged(number, 0, len(cells), width))
        break
    rows, begin = _header(lines, first, separator, width)
    body = [(at, line) for at, line in lines[first:] if line[0] not in _COMMENT]
    if separator is not None and any('"' in line for _, line in body):
        body, separator = [(at, CELL.join(split(line, separator, at))) for at, line in body], CELL
    _refuse_ragged(body, separator, width)
    names, units = _names_and_units(rows, width)
    headings = tuple(Heading(tuple(dict.fromkeys(n for n in names[k] if n)), k + 1, units[k]) for k in range(width))
    remark = f"line {lines[begin][0]} is taken for the first of the table; what stands above it is skipped"
    return Layout(headings, body, separator, (remark,) if any(x[0] not in _COMMENT for _, x in lines[:begin]) else ())


def _lower_part(rows: Sequence[T]) -> list[T]:
    """Some of them, spread from a third of the way to the end, and the last."""
    n = len(rows)
    picked = np.unique(np.linspace(min(n // 3, n - 1), n - 1, LOOKED_AT).astype(int)) if n else ()
    return [rows[i] for i in picked]


def _header(lines: Lines, first: int, separator: str | None, width: int) -> tuple[list[list[str]], int]:
    """The rows of names and units above the first sample, from top to bottom, and the index of the first of them."""
    begin, rows = first, []
    for i in range(first - 1, max(first - 1 - MOST_HEADER_ROWS, -1), -1):
        number, line = lines[i]
        if line[0] in _COMMENT:
            continue
        cells = _header_cells(line, separator, width, number)
        if cells is None:
            break
        begin, rows = i, [cells, *rows]
    if rows:
        return rows, begin
    for i in range(first - 1, -1, -1):  # NumPy and MATLAB users write the names as a comment
        number, line = lines[i]
        if line[0] not in _COMMENT:
            break
        cells = _header_cells(line.lstrip("#% \t"), separator, width, number)
        if cells is not None:
            return [cells], i
    # A row of names that does not name every column would shift them all: it is no preamble.
    for number, line in reversed(lines[:first]) if separator is not None else ():
        cells = [cell for cell in split(line, separator, number) if cell]
        enough = line.count(str(separator)) + 1 >= max(width // 2, 3) <= len(cells)
        if enough and not any(map(is_value, cells)):
            raise InputError(
                f"the header in line {number} names {len(cells)} columns, and the samples below it have {width}; "
                "complete the header"
            )
    return [], first


def _header_cells(line: str, separator: str | None, width: int, number: int) -> list[str] | None:
    """One name a column; None where the line is no header of so many columns."""
    cells = split(line, separator, number)
    if separator is None and len(cells) != width:
        cells = re.split(r"\s{2,}|\t", line.strip())  # names of several words stand two blanks apart
    if len(cells) == width - 1 and separator is not None:
        cells = [*cells, ""]  # one separator too many at the end of every sample is a habit of loggers
    filled = [cell for cell in cells if cell]
    if len(cells) != width or not filled or sum(map(is_value, filled)) > 0.5 * len(filled):
        return None
    return cells


def _refuse_ragged(body: Lines, separator: str | None, width: int) -> None:
    for sample, (number, line) in enumerate(body):
        count = len(line.split()) if separator is None else line.count(separator) + 1
        if count != width:
            raise InputError(_ragged(number, sample, count, width))


def _ragged(number: int, sample: int, found: int, width: int) -> str:
    return (
        f"line {number} (sample {sample}, counted from 0) has {found} columns where {width} are expected, as in the "
        "other lines; complete or delete that line"
    )


def _names_and_units(header: Sequence[Sequence[str]], width: int) -> tuple[list[list[str]], list[str | None]]:
    """Names by column, as many as there are rows of names, and units."""
    names: list[list[str]] = [[] for _ in range(width)]
    units: list[str | None] = [None] * width
    for place, row in enumerate(header):
        filled = [cell.strip("[]() ") for cell in row if cell.strip("[]() ")]
        known = sum(map(bool, map(spellings, filled)))
        if (
            place > 0
            and filled
            and known >= max(UNIT_SHARE * len(filled), sum(split_heading(cell)[0] in ALIASES for cell in filled))
        ):
            units = [cell.strip("[]() ") or None for cell in row]
        else:
            for k, cell in enumerate(row):
                names[k].append(cell)
    return names, units


# --- Cells of text to numbers: decimal commas, thousands separators, Fortran's exponents, blanks.

BLANKS = frozenset(("", "nan", "-nan", "na", "n/a", "#n/a", "null", "none", "-", "--", "---", "nd", "invalid"))
"""What recorders and their tools write where there is no value, in lower case; also a cell of asterisks (Fortran)."""

_EXPONENT = r"(?:[eEdD][+-]?\d{1,3})?"
_VALUE = re.compile(rf"[+-]?(?:\d+[.,]?\d*|[.,]\d+|\d{{1,3}}(?:[,.'\u00a0\u202f]\d{{3}})+(?:[.,]\d+)?){_EXPONENT}")
_CLOCK = re.compile(r"\d{1,4}(?:[-/.:]\d{1,3}){1,3}(?:[T ]?\s*\d.*)?(?:\.\d*)?\s*(?:[AaPp][Mm]|Z|[+-]\d\d:?\d\d)?")
_COMMAS = re.compile(r"[+-]?[1-9]\d{0,2}(?:,\d{3})+(\.\d*)?")
_POINTS = re.compile(r"[+-]?[1-9]\d{0,2}(?:\.\d{3})+(,\d*)?")
_GROUPS = re.compile(r"(?<=\d)['\u00a0\u202f](?=\d{3})")
_FORTRAN = re.compile(r"(?<=[\d.,])[dD](?=[+-]?\d)")


@dataclass(frozen=True)
class Marks:
    """What a file writes before decimals, and between thousands (empty: nothing)."""

    decimal: str = "."
    thousands: str = ""


def is_blank(cell: str) -> bool:
    """Whether a cell says that there is no value."""
    return cell.casefold() in BLANKS or (cell != "" and not cell.strip("*"))


def is_value(cell: str) -> bool:
    """Whether a cell holds a number, a clock time or a date; a blank is none of these."""
    return _VALUE.fullmatch(cell) is not None or (_CLOCK.fullmatch(cell) is not None and cell.count(".") < 3)


def value_share(cells: Sequence[str]) -> float:
    """Values among the cells that are not blank; zero where all are."""
    filled = [cell for cell in cells if not is_blank(cell)]
    return sum(map(is_value, filled)) / len(filled) if filled else 0.0


def marks_of(cells: Iterable[str]) -> Marks:
    """Tell decimal commas from commas between thousands, over all cells that are wanted of a file. "0,040" and "1,5"
    can only be decimals; "4,562" beside "0.9" can only be thousands. Raises InputError: where the file contradicts
    itself, or leaves open which of the two it means."""
    decimal_comma = decimal_point = either_comma = either_point = ""
    grouped = False
    for cell in cells:
        comma, point = "," in cell, "." in cell
        if not (comma or point):
            continue
        commas, points = _COMMAS.fullmatch(cell), _POINTS.fullmatch(cell)
        if comma and point:
            decimal_point, decimal_comma = (cell, decimal_comma) if commas else (decimal_point, cell)
            grouped = True
        elif comma and commas and cell.count(",") == 1:
            either_comma = cell
        elif comma and commas:
            decimal_point, grouped = cell, True  # two commas can only stand between thousands
        elif comma:
            decimal_comma = cell
        elif points and cell.count(".") > 1:
            decimal_comma, grouped = cell, True
        elif points:
            either_point = either_point or cell
        else:
            decimal_point = cell
        if decimal_comma and decimal_point:
            raise InputError(
                f"it has {decimal_comma[:30]!r} with a decimal comma and {decimal_point[:30]!r} with a decimal point; "
                "write all numbers with a decimal point and without thousands separators"
            )
    if decimal_comma:
        return Marks(",", "." if grouped or either_point else "")
    if not either_comma:
        return Marks(".", "," if grouped else "")
    if decimal_point:
        return Marks(".", ",")
    raise InputError(
        f"the comma in {either_comma[:30]!r} may be a decimal comma or stand before thousands, and nothing in the file "
        "tells which; write numbers with a decimal point and without thousands separators"
    )


def number_of(cell: str, marks: Marks) -> float:
    """The number in a cell, NaN for a blank. Raises ValueError: the cell holds something else."""
    if is_blank(cell):
        return math.nan
    if "_" in cell:
        raise ValueError(cell)
    plain = cell.replace(marks.thousands, "") if marks.thousands else cell
    plain = _GROUPS.sub("", plain)
    if marks.decimal == ",":
        plain = plain.replace(",", ".")
    return float(_FORTRAN.sub("e", plain))


# --- Clock times and dates to seconds since the first sample.

DAY = 86400.0
_TIME = re.compile(r"(?:\d{1,3}:)?\d{1,2}:\d{1,2}(?::\d{1,2})?(?:[.,]\d*)?")
_DATED = re.compile(r"\d{1,4}[-/.]\d{1,2}[-/.]\d{1,4}(?!\d).*")
_OF_DAY = re.compile(r"\d{1,2}:\d{1,2}.*")
_WEIGHTS = {2: (60.0, 1.0), 3: (3600.0, 60.0, 1.0), 4: (DAY, 3600.0, 60.0, 1.0)}


def looks_like_clock(cell: str) -> bool:
    """Whether a cell is a clock time (10:23:45.12, 127:10:23:45, 23:45.1) or a date with one."""
    return any(pattern.fullmatch(cell) for pattern in (_TIME, _DATED, _OF_DAY))


def seconds(cells: Sequence[str]) -> np.ndarray:
    """(n,) seconds since the first cell; a clock that passes midnight goes on. Raises InputError: a cell is no time."""
    if not all(_TIME.fullmatch(cell) for cell in cells):
        return _dates(cells)
    # h:m:s, m:s, or day:h:m:s as range clocks (IRIG) write it
    parts = [cell.replace(",", ".").split(":") for cell in cells]
    if len({len(part) for part in parts}) > 1:
        raise InputError("clock times of different forms stand in one column; write time in seconds")
    values = np.array(parts, dtype=np.float64) @ np.array(_WEIGHTS[len(parts[0])])
    if len(parts[0]) == 4:
        return values - values[0]
    period = 3600.0 if len(parts[0]) == 2 else DAY
    turns = np.cumsum(np.r_[0.0, np.diff(values)] < -0.5 * period)
    return values + period * turns - values[0]


def _dates(cells: Sequence[str]) -> np.ndarray:
    import pandas as pd

    try:
        stamps = pd.to_datetime(pd.Series(list(cells)), format="ISO8601", utc=True)
    except (ValueError, OverflowError):
        try:  # the order of day and month is the one in which the record is shorter
            texts = pd.Series(list(cells))
            orders = [pd.to_datetime(texts, format="mixed", utc=True, dayfirst=first) for first in (False, True)]
        except (ValueError, OverflowError, TypeError) as reason:
            raise InputError("clock times or dates that cannot be read; write time in seconds") from reason
        stamps = min(orders, key=lambda order: abs(order.iloc[-1] - order.iloc[0]))
    nanoseconds = stamps.to_numpy(dtype="datetime64[ns]").astype(np.int64)
    return (nanoseconds - nanoseconds[0]) * 1e-9
