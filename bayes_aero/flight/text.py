"""What all file formats share - columns, their values, those that a card names - and text tables, a format itself."""

from __future__ import annotations

import csv
import math
import re
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from difflib import get_close_matches
from typing import Any, NamedTuple

import numpy as np

from bayes_aero.errors import InputError
from bayes_aero.flight.channel import ALIASES, Channel, split_heading
from bayes_aero.units import spellings

MAX_VALUES = 20_000_000  # most samples that one channel may have; held against the file's header before memory is taken
MOST_VALUES_IN_ALL = 100_000_000  # of all channels together: 0.8 GB; a compressed file of some kB can claim any number
MOST_HEADINGS = 20_000  # most columns: an autopilot's log has thousands; searching among millions would take hours


class FileColumn(NamedTuple):
    """One channel as in the file: (n,) values in the file's unit, NaN where it has none, and the unit it states."""

    values: np.ndarray
    unit: str | None = None


@dataclass(frozen=True)
class Heading:
    """One column of a file before its values are read."""

    names: tuple[str, ...] = ()  # as in the file; none without a header, several with more than one row of names
    column: int | None = None  # its number on a card, counted from 1; None where it goes by its name alone
    unit: str | None = None  # that the file states beside the name
    formed: bool = False  # the name was formed by the reader, "data(:,3)": a card's number counts beside any label


@dataclass(frozen=True)
class OpenedFile:
    """A file whose columns are known, of one length, and whose values are still to be read. `read` gives those of some
    headings, each under the name of the channel that it was taken for; NaN at samples that a column of several rates
    lacks. `kind`: what a column is called there. `remarks`: how the file was understood; reading may add to them."""

    headings: Sequence[Heading]
    read: Callable[[Mapping[str, Heading]], dict[str, FileColumn]]
    kind: str = "variable"
    remarks: list[str] = field(default_factory=list)


def candidates(channel: Channel, headings: Sequence[Heading]) -> list[Heading]:
    """The headings of a channel's name; else its number, unless the card has a label that names none."""
    numbered = (h for h in headings if h.column == channel.column is not None)
    usable = [h for h in numbered if channel.label is None or not h.names or h.formed]
    return [h for h in headings if channel.heading in h.names] or usable[-1:]


def located(channels: Sequence[Channel], opened: OpenedFile) -> dict[str, Heading]:
    """The heading of each channel, see `candidates`. A required one must be there, and none may be twice."""
    headings, kind, places = opened.headings, opened.kind, {}
    if len(headings) > MOST_HEADINGS:
        raise InputError(f"it has {len(headings)} {kind}s, more than {MOST_HEADINGS}; is it a flight record?")
    for channel in channels:
        there = candidates(channel, headings)
        if len(there) > 1:
            twice = f"{len(there)} {kind}s are called {channel.heading!r}; rename all but one"
            raise InputError(f"channel {channel.name}: {twice}")
        if not there and channel.required:
            raise InputError(f"channel {channel.name}{_absent(channel, headings, kind)}")
        places |= {channel.name: there[0]} if there else {}
    return places


def _absent(channel: Channel, headings: Sequence[Heading], kind: str) -> str:
    names = list(dict.fromkeys(name for heading in headings for name in heading.names))
    if not names and channel.column is None:
        return " has no column number on the card, and the file has no header; add column = N, or write a header line"
    if not names:
        count = sum(heading.column is not None for heading in headings)
        return f" is column {channel.column} on the card, but the file has {count} columns; correct the column"
    folded = {name.casefold(): name for name in names}
    close = [repr(folded[name]) for name in get_close_matches(channel.heading.casefold(), folded, n=3, cutoff=0.5)]
    hint = f"did you mean {' or '.join(close)}?"
    if not close:
        listed = [repr(name[:40]) for name in names[:15]] + ["..."] * (len(names) > 15)
        hint = f"the file has {', '.join(listed)};"
    return f": no {kind} is called {channel.heading!r}; {hint} correct its label on the card, or set required = false"


def refuse_huge(name: str, heading: str, size: float, channels: int) -> None:
    """Hold what a header claims for one of so many `channels` against what a record can have."""
    if size > MAX_VALUES or size * channels > MOST_VALUES_IN_ALL:
        claims = f"claims {size:.0f} samples, more than {MAX_VALUES}, or {MOST_VALUES_IN_ALL} in all"
        raise InputError(f"channel {name} ({heading!r}) {claims}; is the file damaged? Otherwise cut the record")


def vector(values: np.ndarray, name: str) -> np.ndarray:
    """A numeric array as a float64 vector; row and column vectors are flattened."""
    if values.dtype.kind not in "fiub":
        raise InputError(f"channel {name} holds {values.dtype} where numbers should be; store it as plain numbers")
    if values.size > MAX_VALUES:
        raise InputError(f"channel {name} claims {values.size} samples, more than {MAX_VALUES}; cut the record")
    if values.ndim != 1 and values.size != max(values.shape, default=1):
        raise InputError(f"channel {name} has shape {values.shape} where one value a sample should be; split it up")
    return values.astype(np.float64).reshape(-1)


@contextmanager
def foreign(kind: str) -> Iterator[None]:
    """Turn whatever a foreign parser throws at a damaged file, KeyError to zlib.error, into one sentence."""
    try:
        yield
    except InputError:
        raise
    except MemoryError as reason:
        raise InputError(f"it claims more data than memory holds; is it damaged? Write the {kind} again") from reason
    except Exception as reason:
        why = " ".join(str(reason).split())[:120] or type(reason).__name__
        raise InputError(f"it is not a readable {kind} ({why}); is it damaged or misnamed? Write it again") from reason


# --- Text tables: cells between blanks, tabs, commas, semicolons or pipes.

MOST_LINES, LONGEST_LINE = 5_000_000, 200_000
"""Far beyond any record; each line costs some hundred bytes of memory beside its own."""
CELL = "\x1f"  # between the cells of lines that were quoted: ASCII's own separator, which no text holds
SEPARATORS = (";", "\t", "|", CELL, ",", None)  # None: blanks; of two that fit alike the first is taken
LOOKED_AT = 40  # lines, spread over the lower part of the file
MOST_HEADER_ROWS = 4
_SEP_LINE = re.compile(r'"?sep=.?"?[;,\t]*', re.IGNORECASE)
_COMMENT = "#%"
NO_DATA = "it holds no data, only blank lines, comments or separators; write the record again"

Lines = list[tuple[int, str]]  # lines of a file, each with its number, counted from 1


def read_cells(
    body: Lines, separator: str | None, wanted: Mapping[str, Heading], remarks: list[str]
) -> dict[str, FileColumn]:
    """See `OpenedFile.read`. Blank cells come back as NaN, clock times and dates in seconds from the first sample."""
    indices = [heading.column - 1 for heading in wanted.values() if heading.column is not None]
    rows = [line for _, line in body]
    if not indices:
        return {}
    if separator == "," or not any("," in row for row in rows):  # plain numbers: NumPy's own parser
        try:
            values = np.loadtxt(rows, delimiter=separator, usecols=indices, ndmin=2, comments=None)
            return {name: FileColumn(values[:, k], h.unit) for k, (name, h) in enumerate(wanted.items())}
        except (ValueError, IndexError):
            pass  # blanks, clock times, other marks than a decimal point, or text: cell by cell
    split = [row.split(separator) for row in rows]
    cells = {name: [row[i].strip() for row in split] for name, i in zip(wanted, indices, strict=True)}
    firsts = {name: next((cell for cell in column if not is_blank(cell)), "") for name, column in cells.items()}
    clocks = {name for name, first in firsts.items() if looks_like_clock(first)}
    marks, columns = marks_of(cell for name, x in cells.items() if name not in clocks for cell in x), {}
    for name, column in cells.items():
        clock, heading, values, sample, remark = name in clocks, wanted[name], np.full(len(column), np.nan), 0, ""
        filled = [k for k, cell in enumerate(column) if not is_blank(cell)]
        try:
            for sample in filled:
                if clock and not looks_like_clock(column[sample]):
                    raise ValueError
                values[sample] = 0.0 if clock else number_of(column[sample], marks)
            if clock:
                values[filled] = seconds([column[k] for k in filled])
                remark = f"channel {name}: the clock time {firsts[name]} is t = 0"
        except InputError as reason:
            raise InputError(f"channel {name} holds {reason}") from reason
        except ValueError:
            raise InputError(
                f"channel {name} has the text {column[sample][:30]!r} where {'a clock time' if clock else 'a number'} "
                f"should be, in line {body[sample][0]}, column {heading.column} (sample {sample}, counted from "
                "0); correct or delete that line"
            ) from None
        columns[name] = FileColumn(values, "s" if clock else heading.unit)
        grouped = next((cell for cell in column if marks.thousands and marks.thousands in cell), "")
        if grouped and not clock:
            remark = f"channel {name}: {marks.thousands!r} as in {grouped!r} is read as a thousands separator"
        remarks += [remark] if remark and remark not in remarks else []
    return columns


def open_text(data: bytes) -> OpenedFile:
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
    size, number = max((len(row), k) for k, row in enumerate(rows, 1))
    if size > LONGEST_LINE:
        raise InputError(f"line {number} has {size} characters, more than {LONGEST_LINE}; is it a table at all?")
    lines = [(number, row.strip(" ")) for number, row in enumerate(rows, 1) if row and not row.isspace()]
    if all(line[0] in _COMMENT for _, line in lines):
        raise InputError(NO_DATA)
    return laid_out(lines, separator_of(lines))


# --- Where a text table keeps its header, its units and its samples, and what stands between its cells.
# Loggers write a preamble above the header, one or two rows of names, a row of units, or none of these. The samples
# are what repeats: they are looked for first, in the lower part of the file; the header is what stands above them.


def separator_of(lines: Lines) -> str | None:
    """The separator that cuts the file into the most regular table of numbers."""
    some = _lower_part([line for _, line in lines if line[0] not in _COMMENT] or [line for _, line in lines])
    best, most = None, 0.0
    for separator in SEPARATORS:
        rows = [split(line, separator) for line in some]
        width, count = Counter(len(row) for row in rows).most_common(1)[0]
        if width < 2 and separator is not None:
            continue
        values = value_share([cell for row in rows if len(row) == width for cell in row])
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
            raise InputError(f"line {number} has a quote that is not closed; close it (no cell goes on below)")
    return cells


def laid_out(lines: Lines, separator: str | None, remarks: Sequence[str] = ()) -> OpenedFile:
    """Find header, units and samples of lines whose cells are so separated (None: by blanks). Raises InputError: no
    samples, or lines of different length among them."""
    lines = [(at, line) for at, line in lines if not _SEP_LINE.fullmatch(line)]
    while lines and not lines[-1][1].strip(" \t,;|\x1f"):
        lines = lines[:-1]  # rows of separators at the end
    if not lines:
        raise InputError(NO_DATA)
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
        headings = tuple(Heading((name,) if name else (), k) for k, name in enumerate(header, 1))
        return _table(headings, lines[1:], separator, remarks)
    rows, begin = _header(lines, first, separator, width)
    body = [(at, line) for at, line in lines[first:] if line[0] not in _COMMENT]
    if separator is not None and any('"' in line for _, line in body):
        body, separator = [(at, CELL.join(split(line, separator, at))) for at, line in body], CELL
    _refuse_ragged(body, separator, width)
    names, units = list[list[str]](), [""] * width
    for place, row in enumerate(rows):  # a row below the names of which a third are known units, and most no names
        filled = [cell.strip("[]() ") for cell in row if cell.strip("[]() ")]
        spelled, aliases = sum(map(bool, map(spellings, filled))), sum(split_heading(c)[0] in ALIASES for c in filled)
        if place and filled and spelled >= max(len(filled) / 3.0, aliases):
            units = [cell.strip("[]() ") for cell in row]
        else:
            names.append(row)
    headings = tuple(
        Heading(tuple(dict.fromkeys(row[k] for row in names if row[k])), k + 1, units[k] or None) for k in range(width)
    )
    if any(line[0] not in _COMMENT for _, line in lines[:begin]):
        skipped = f"line {lines[begin][0]} is taken for the first of the table; what stands above it is skipped"
        remarks = [*remarks, skipped]
    return _table(headings, body, separator, remarks)


def _table(headings: Sequence[Heading], body: Lines, separator: str | None, remarks: Sequence[str]) -> OpenedFile:
    notes = [*remarks]
    return OpenedFile(headings, lambda wanted: read_cells(body, separator, wanted, notes), "column", notes)


def _lower_part(rows: Sequence[Any]) -> list[Any]:
    """Some of them, spread from a third of the way to the end, and the last."""
    n = len(rows)
    picked = np.unique(np.linspace(min(n // 3, n - 1), n - 1, LOOKED_AT).astype(int)) if n else ()
    return [rows[i] for i in picked]


def _header(lines: Lines, first: int, separator: str | None, width: int) -> tuple[list[list[str]], int]:
    """The rows of names and units above the first sample, from top to bottom, and the index of the first of them."""
    begin, rows = first, []
    above = [(i, *lines[i]) for i in range(first - 1, -1, -1)]
    text = [row for row in above if row[2][0] not in _COMMENT]
    if text:  # what stands just above the first whole sample may be a damaged one
        _, number, line = text[0]
        cells = split(line, separator)
        filled = [cell for cell in cells if not is_blank(cell)]
        if len(filled) >= max(0.5 * width, 2) and value_share(filled) > 0.5:
            raise InputError(_ragged(number, 0, len(cells), width))
    for i, number, line in above[:MOST_HEADER_ROWS]:
        if line[0] not in _COMMENT:
            cells = _header_cells(line, separator, width, number)
            if cells is None or (rows and any(map(is_value, cells))):  # names and units hold no numbers
                break
            begin, rows = i, [cells, *rows]
    if rows:
        return rows, begin
    for i, number, line in above:  # NumPy and MATLAB users write the names as a comment
        if line[0] not in _COMMENT:
            break
        if (cells := _header_cells(line.lstrip("#% \t"), separator, width, number)) is not None:
            return [cells], i
    # A row of names that does not name every column would shift them all: it is no preamble.
    for _, number, line in above if separator is not None else ():
        cells = [cell for cell in split(line, separator, number) if cell]
        enough = line.count(str(separator)) + 1 >= max(width // 2, 3) <= len(cells)
        if enough and not any(map(is_value, cells)):
            names = f"the header in line {number} names {len(cells)} columns, and the samples below it"
            raise InputError(f"{names} have {width}; complete the header")
    return [], first


def _header_cells(line: str, separator: str | None, width: int, number: int) -> list[str] | None:
    """One name a column; None where the line is no header of so many columns."""
    cells = split(line, separator, number)
    if separator is None and len(cells) != width:
        cells = re.split(r"\s{2,}|\t", line.strip())  # names of several words stand two blanks apart
        cells = [re.sub(r'^"(.*)"$', r"\1", cell).replace('""', '"') for cell in cells]
    if len(cells) == width - 1 and separator is not None:
        cells = [*cells, ""]  # one separator too many at the end of every sample is a habit of loggers
    filled = [cell for cell in cells if cell]
    return cells if len(cells) == width and filled and sum(map(is_value, filled)) <= 0.5 * len(filled) else None


def _refuse_ragged(body: Lines, separator: str | None, width: int) -> None:
    for sample, (number, line) in enumerate(body):
        count = len(line.split()) if separator is None else line.count(separator) + 1
        if count != width:
            raise InputError(_ragged(number, sample, count, width))


def _ragged(number: int, sample: int, count: int, width: int) -> str:
    where = f"line {number} (sample {sample}, counted from 0)"
    return f"{where} has {count} columns where {width} are expected; complete or delete that line"


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


class Marks(NamedTuple):
    """What a file writes before decimals, and between thousands (empty: nothing)."""

    decimal: str = "."
    thousands: str = ""


def is_blank(cell: str) -> bool:
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
    comma = point = either_comma = either_point = ""  # a cell with a decimal comma, point, or what may be either
    grouped = False
    for cell in cells:
        commas, points = cell.count(","), cell.count(".")
        if commas and points:
            comma, point, grouped = (comma, cell, True) if _COMMAS.fullmatch(cell) else (cell, point, True)
        elif commas and not _COMMAS.fullmatch(cell):
            comma = cell
        elif commas == 1:
            either_comma = cell
        elif commas:
            point, grouped = cell, True  # two commas can only stand between thousands
        elif points and not _POINTS.fullmatch(cell):
            point = cell
        elif points == 1:
            either_point = cell
        elif points:
            comma, grouped = cell, True
        if comma and point:
            marks = f"{comma[:30]!r} with a decimal comma and {point[:30]!r} with a decimal point"
            raise InputError(f"it has {marks}; write all numbers with a decimal point")
    if either_comma and not comma and not point:
        what = f"the comma in {either_comma[:30]!r} may be a decimal comma or stand before thousands"
        raise InputError(f"{what}; write numbers with a decimal point, without thousands separators")
    if comma:
        return Marks(",", "." if grouped or either_point else "")
    return Marks(".", "," if grouped or either_comma else "")


def number_of(cell: str, marks: Marks) -> float:
    """The number in a cell, NaN for a blank. Raises ValueError: the cell holds something else."""
    if is_blank(cell):
        return math.nan
    if "_" in cell:
        raise ValueError(cell)
    plain = _GROUPS.sub("", cell.replace(marks.thousands, "") if marks.thousands else cell)
    return float(_FORTRAN.sub("e", plain.replace(",", ".") if marks.decimal == "," else plain))


# --- Clock times and dates to seconds since the first sample.

DAY = 86400.0
_TIME = re.compile(r"(?:\d{1,3}:)?\d{1,2}:\d{1,2}(?::\d{1,2})?(?:[.,]\d*)?")
_DATED = re.compile(r"\d{1,4}[-/.]\d{1,2}[-/.]\d{1,4}(?!\d).*|\d{1,2}:\d{1,2}.*")
_WEIGHTS = {2: (60.0, 1.0), 3: (3600.0, 60.0, 1.0), 4: (DAY, 3600.0, 60.0, 1.0)}


def looks_like_clock(cell: str) -> bool:
    """Whether a cell is a clock time (10:23:45.12, 127:10:23:45, 23:45.1) or a date with one."""
    return bool(_TIME.fullmatch(cell) or _DATED.fullmatch(cell))


def seconds(cells: Sequence[str]) -> np.ndarray:
    """(n,) seconds since the first cell; a clock that passes midnight goes on. Raises InputError: a cell is no time."""
    if all(_TIME.fullmatch(cell) for cell in cells):
        # h:m:s, m:s, or day:h:m:s as range clocks (IRIG) write it
        parts = [cell.replace(",", ".").split(":") for cell in cells]
        if len({len(part) for part in parts}) > 1:
            raise InputError("clock times of different forms stand in one column; write time in seconds")
        values = np.array(parts, dtype=np.float64) @ np.array(_WEIGHTS[len(parts[0])])
        period = {2: 3600.0, 3: DAY, 4: np.inf}[len(parts[0])]
        turns = np.diff(values, prepend=values[0]) < -0.5 * period
        return values - values[0] + np.cumsum(np.where(turns, period, 0.0))
    import pandas as pd

    texts = pd.Series(list(cells))
    try:
        stamps = pd.to_datetime(texts, format="ISO8601", utc=True)
    except (ValueError, OverflowError):
        try:  # the order of day and month is the one in which the record is shorter
            orders = [pd.to_datetime(texts, format="mixed", utc=True, dayfirst=first) for first in (False, True)]
        except (ValueError, OverflowError, TypeError) as reason:
            raise InputError("clock times or dates that cannot be read; write time in seconds") from reason
        stamps = min(orders, key=lambda order: abs(order.iloc[-1] - order.iloc[0]))
    nanoseconds = stamps.to_numpy(dtype="datetime64[ns]").astype(np.int64)
    return (nanoseconds - nanoseconds[0]) * 1e-9
