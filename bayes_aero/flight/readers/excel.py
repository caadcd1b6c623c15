"""Excel workbooks (.xlsx), read by openpyxl: the first sheet that holds a table, laid out as a text table is."""

from __future__ import annotations

import io
import re
import warnings
import zipfile
from datetime import date, datetime, time, timedelta
from typing import Any

from bayes_aero.errors import InputError
from bayes_aero.flight.readers.base import MOST_HEADINGS, OpenedFile, foreign, is_value, value_share
from bayes_aero.flight.readers.isolated.process import require
from bayes_aero.flight.readers.text import CELL, MOST_HEADER_ROWS, laid_out, text_table
from bayes_aero.units import same_unit

MOST_UNPACKED = 1 << 29  # most bytes of XML in the archive, 0.5 GiB; a file of some kB can claim any number
MOST_ROWS, MOST_CELLS = 1 << 20, 10_000_000
"""Excel's own number of rows; and most cells of a sheet, of which each takes some microseconds."""

A_TABLE = 50  # rows of numbers that make a table; a sheet with fewer is read only where no sheet has so many
_OLD = b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1"
_UNFIT = re.compile(rf'[{CELL}"\r\n\t]+')  # what parts cells and lines in a text table
_THOUSANDS = re.compile(r"-?\d{1,3}\.\d{3}")  # a number whose point could stand between thousands in a text table

Rows = list[tuple[int, list[str]]]
"""Rows that are not blank, each with its number in the sheet, counted from 1, without the blank cells at its end."""


def open_excel(data: bytes) -> OpenedFile:
    """The table of a workbook."""
    rows, remarks = rows_of(data)
    if not rows:
        raise InputError("it holds no data, only blank sheets; write the record again")
    numeric = [value_share(row) > 0.5 for _, row in rows]
    begin = _header_begins(rows, next((k for k, it in enumerate(numeric) if it and all(numeric[k : k + 3])), 0))
    if begin > 0:
        remarks += [f"row {rows[begin][0]} is taken for the first of the table; what stands above it is skipped"]
    width = max(len(row) for _, row in rows[begin:])
    lines = [(number, CELL.join(row + [""] * (width - len(row)))) for number, row in rows[begin:]]
    return text_table(laid_out(lines, CELL), remarks)


READS = {".xlsx": open_excel}


def rows_of(data: bytes) -> tuple[Rows, list[str]]:
    """The first sheet with a table, and which one it is where there are several. Numbers come as Python writes them,
    dates and times of day in ISO 8601, durations in seconds. Raises InputError: no workbook, or one that claims more
    than a record can hold."""
    require(".xlsx", "openpyxl", "defusedxml")  # openpyxl takes defusedxml, against XML bombs, only where it is there
    if data.startswith(_OLD):
        raise InputError("it is a workbook of Excel 97 to 2003, or one with a password; save it as .xlsx without one")
    with foreign("Excel workbook"):
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            claimed = sum(entry.file_size for entry in archive.infolist())
        if claimed > MOST_UNPACKED:
            raise InputError(f"it unpacks to {claimed} bytes, more than {MOST_UNPACKED}; save the table as .csv")
        sheets = _sheets(data)
    lengths = [sum(len(row) > 1 and value_share(row) > 0.5 for _, row in rows) for _, rows in sheets]
    tables = [k for k, length in enumerate(lengths) if length >= A_TABLE] or [
        k for k, length in enumerate(lengths) if length and length == max(lengths)
    ]
    if not tables:
        return (sheets[0][1] if sheets else []), []
    name, rows = sheets[tables[0]]
    if len(tables) == 1:
        return rows, [f"the table is that of sheet {name[:40]!r}"] if len(sheets) > 1 else []
    return rows, [
        f"sheet {name[:40]!r} is read, the first of {len(tables)} with a table; for another one, save it as a workbook "
        "of its own"
    ]


def _sheets(data: bytes) -> list[tuple[str, Rows]]:
    """Name and rows of each sheet that is not blank."""
    from openpyxl import load_workbook

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of styles and extensions that it leaves out
        book = load_workbook(io.BytesIO(data), read_only=True, data_only=True, keep_links=False)
        try:
            sheets = [(str(sheet.title), _rows(sheet)) for sheet in book.worksheets]
        finally:
            book.close()
    return [(title, rows) for title, rows in sheets if rows]


def _rows(sheet: Any) -> Rows:
    rows, cells, title = [], 0, repr(sheet.title[:40])
    sheet.reset_dimensions()  # programs write wrong ones
    for number, values in enumerate(sheet.iter_rows(values_only=True), 1):
        cells += len(values)
        if number > MOST_ROWS or cells > MOST_CELLS:
            raise InputError(f"sheet {title} has more than {MOST_ROWS} rows or {MOST_CELLS} cells; cut it")
        row = [_text(value) for value in values]
        while row and not row[-1]:
            row.pop()
        if len(row) > MOST_HEADINGS:
            raise InputError(f"sheet {title} has more than {MOST_HEADINGS} columns; is it a flight record?")
        if row:
            rows.append((number, row))
    return rows


def _text(value: Any) -> str:
    """What a cell holds, as a text table would have it."""
    if value is None:
        return ""
    if isinstance(value, bool):
        return str(int(value))
    if isinstance(value, datetime | date | time):
        return value.isoformat()
    if isinstance(value, timedelta):
        return repr(value.total_seconds())
    if isinstance(value, float):
        return repr(value) + "0" * (_THOUSANDS.fullmatch(repr(value)) is not None)
    return _UNFIT.sub(" ", str(value)).strip()


def _header_begins(rows: Rows, first: int) -> int:
    """Index of the first row of names or units above the first sample; higher up stand notes, of a few cells."""
    width, begin, named = len(rows[first][1]), first, False
    for k in range(first - 1, max(first - 1 - MOST_HEADER_ROWS, -1), -1):
        number, row = rows[k]
        told = sum(map(bool, row))
        units = all(same_unit(said, said) for cell in row if (said := cell.strip("[]() ")))
        parted = k < first - 1 and rows[k + 1][0] - number > 1  # a blank row
        few = 2 * told <= width and (named or told < 2)
        if parted or (not units and (few or (named and any(map(is_value, row))))):
            break
        begin, named = k, named or not units
    return begin
