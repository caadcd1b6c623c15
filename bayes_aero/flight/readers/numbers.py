"""Cells of text to numbers: decimal commas, thousands separators, Fortran's exponents, blanks."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from bayes_aero.errors import InputError

__all__ = ["Marks", "is_blank", "is_value", "marks_of", "number_of"]

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


def marks_of(cells: Iterable[str]) -> Marks:
    """Tell decimal commas from commas between thousands, over all cells that are wanted of a file.

    "0,040" and "1,5" can only be decimals; "4,562" beside "0.9" can only be thousands.

    Raises:
        InputError: where the file contradicts itself, or leaves open which of the two it means.
    """
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
    """The number in a cell, NaN for a blank.

    Raises:
        ValueError: the cell holds something else.
    """
    if is_blank(cell):
        return math.nan
    if "_" in cell:
        raise ValueError(cell)
    plain = cell.replace(marks.thousands, "") if marks.thousands else cell
    plain = _GROUPS.sub("", plain)
    if marks.decimal == ",":
        plain = plain.replace(",", ".")
    return float(_FORTRAN.sub("e", plain))


def thousands(cells: Sequence[str], marks: Marks) -> str:
    """The first cell with a thousands separator; empty if there is none."""
    if not marks.thousands:
        return ""
    return next((cell for cell in cells if marks.thousands in cell), "")
