"""Conversions at the border: everything inside the package is in SI and radians.

This is the only module that knows pint. The registry takes a third of a second to build and is made on first
use.
"""

from __future__ import annotations

import math
import re
import sys
from functools import cache, lru_cache
from typing import Any

import numpy as np

from bayes_aero.errors import InputError

__all__ = ["from_si", "quantity_to_si", "same_unit", "si_unit", "to_si"]

# Aviation writes "g" for standard gravity; to pint it is the gram. Blank spellings of "no unit" are common
# in files.
_ALIASES = {"": "1", "-": "1", "none": "1", "g": "standard_gravity", "gn": "standard_gravity"}

# Only products of named units with one-digit powers reach pint, whose parser would evaluate "9**9**9**9" for
# ever.
_SAFE = re.compile(r"(?:1(?![\w.])|[A-Za-z%°µμΩ][A-Za-z_µμ0-9]*|\*\*-?\d(?!\d)|[*/·() ])*")
_POWER = re.compile(r"(?<=[A-Za-z%°])(-?\d)(?![\w.])")
_LONGEST = 60

_NUMBER = re.compile(r"\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d{1,3})?)\s*(.*)", re.DOTALL)

_EXAMPLES = 'e.g. "deg", "deg/s", "m/s^2", "kt", "ft", "hPa", "g" (standard gravity), "%" or "1"'

# Units that count turns. pint holds them for plain numbers, so "%" would pass for an angle and Hz for rad/s.
_ANGLES = {"radian", "degree", "arcminute", "arcsecond", "turn", "revolution", "grade", "gon", "milliradian"}


@cache
def _registry() -> Any:
    apart = "dask" not in sys.modules
    if apart:
        sys.modules["dask"] = None  # type: ignore[assignment] # pint loads it, for arrays that nobody has here
    try:
        import pint
    finally:
        if apart:
            del sys.modules["dask"]
    return pint.UnitRegistry()


@lru_cache(maxsize=1024)
def _parse(unit: str, where: str) -> Any:
    """The pint unit that `unit` names."""
    text = _ALIASES.get(unit.strip().lower(), unit.strip()).replace("^", "**")
    candidates = (
        text,
        _POWER.sub(r"**\1", text),
    )  # "m/s2" and "m s-1" are not pint's spelling, but everybody's
    for candidate in candidates:
        if len(candidate) > _LONGEST or _SAFE.fullmatch(candidate) is None or re.search(r"\*\*-?\d\s*\*\*", candidate):
            continue
        try:
            return _registry().parse_units(candidate)
        except Exception:  # pint leaks AssertionError, TypeError, tokenizer errors ... for text that is no unit
            continue
    raise InputError(f"{where}: the unit {unit[:40]!r} is not known; write it as in pint, {_EXAMPLES}")


def _turns(unit: Any) -> float:
    """The power to which an angle enters a unit: 1 for deg/s, 0 for m, -1 for 1/rad."""
    powers = _registry().Quantity(1, unit).unit_items()
    rpm = ("revolutions_per_minute", "revolutions_per_second")
    return sum(power for name, power in powers if name in _ANGLES or name in rpm)


def _convert(values: Any, source: str, target: str, where: str) -> Any:
    have, want = _parse(source, where), _parse(target, where)
    if have == want:
        return values
    try:
        with np.errstate(all="ignore"):  # an overflow gives inf, which the record checks tell better
            return _registry().Quantity(values, have).to(want).magnitude
    except (
        Exception
    ) as reason:  # DimensionalityError, OffsetUnitCalculusError, ...: all say "these do not belong together"
        raise InputError(
            f"{where}: the unit {source!r} cannot be turned into {target!r}; correct the unit, {_EXAMPLES}"
        ) from reason


def _same_turns(source: str, target: str, where: str) -> None:
    if _turns(_parse(source, where)) != _turns(_parse(target, where)):
        raise InputError(
            f"{where}: the unit {source!r} does not fit {target!r}; an angle needs an angular unit, and "
            f"only an angle "
            f'does: "deg", "rad", "deg/s" or "rad/s" for angles and rates, "1" or "%" for ratios'
        )


def si_unit(unit: str, where: str = "unit") -> str:
    """The SI unit (angles: radian) that a quantity in `unit` is held in, e.g. "rad/s" for "deg/s"."""
    base = _registry().get_base_units(_parse(unit, where))[1]
    return f"{base:~}".replace(" ", "") or "1"


def to_si(values: Any, unit: str, channel_name: str, target: str | None = None) -> np.ndarray:
    """Values of a channel in SI.

    Args:
        values: numbers in `unit`, any shape.
        unit: the unit of `values`, e.g. "deg/s".
        channel_name: the channel, for the error message.
        target: the SI unit to arrive at; without it the base units of `unit`.
    """
    where = f"channel {channel_name}"
    if target is None:
        target = si_unit(unit, where)
    _same_turns(unit, target, where)
    return np.asarray(_convert(np.array(values, dtype=np.float64), unit, target, where), dtype=np.float64)


def from_si(values: Any, unit: str, channel_name: str, source: str | None = None) -> np.ndarray:
    """The inverse of `to_si`: SI values (in `source`, else the base units of `unit`) expressed in `unit`."""
    where = f"channel {channel_name}"
    source = si_unit(unit, where) if source is None else source
    _same_turns(unit, source, where)
    return np.asarray(_convert(np.array(values, dtype=np.float64), source, unit, where), dtype=np.float64)


def same_unit(one: str, other: str) -> bool | None:
    """Whether two spellings mean one unit; None where either is no unit at all (files say many things)."""
    try:
        first, second = _parse(one, "unit"), _parse(other, "unit")
    except InputError:
        return None
    if first.dimensionality != second.dimensionality or _turns(first) != _turns(second):
        return False
    quantity = _registry().Quantity
    # Two points, for scales with an offset such as degC.
    return all(math.isclose(quantity(x, first).to(second).magnitude, x, rel_tol=1e-9) for x in (1.0, 300.0))


def quantity_to_si(value: Any, expected: str, where: str) -> float:
    """A constant written with its unit, such as "17631 kg", as a number in `expected` (an SI unit).

    A bare number is accepted for a dimensionless constant only: a mass without unit is how a pound slips in.
    `where` says which constant it is, for the error message.
    """
    if isinstance(value, bool) or not isinstance(value, int | float | str):
        raise InputError(f'{where} is {str(value)[:60]!r}; write a number with its unit, e.g. "1.5 {expected}"')
    match = _NUMBER.fullmatch(str(value))
    if match is None or not math.isfinite(float(match[1])):
        raise InputError(f'{where} is {str(value)[:60]!r}; write a finite number with its unit, e.g. "1.5 {expected}"')
    number, unit = float(match[1]), match[2].strip()
    if not unit and expected not in ("", "1"):
        raise InputError(f'{where} is {str(value)!r}, without a unit; write e.g. "{value} {expected}"')
    return float(_convert(number, unit or "1", expected, where))
