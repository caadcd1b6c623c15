"""Conversions at the border: everything inside the package is in SI and radians.

This is the only module that knows pint. The registry takes a third of a second to build and is made on first
use. How units are spelled is `unit_words`' alone: cards, files and headings share its table.
"""

from __future__ import annotations

import math
import re
import sys
from functools import cache, lru_cache
from typing import Any

import numpy as np

from bayes_aero.errors import InputError
from bayes_aero.unit_words import spellings, unclear

__all__ = ["canonical", "from_si", "instant", "quantity_to_si", "same_kind", "same_unit", "si_unit", "to_si"]

# Only products of named units with one-digit powers reach pint, whose parser would evaluate "9**9**9**9" for
# ever.
_SAFE = re.compile(r"(?:1(?![\w.])|[A-Za-z%°µμΩ][A-Za-z_µμ0-9]*|\*\*-?\d(?!\d)|[*/·() ])*")
_POWER = re.compile(r"(?<=[A-Za-z%°])(-?\d)(?![\w.])")
_LONGEST = 60

_NUMBER = re.compile(r"\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d{1,3})?)\s*(.*)", re.DOTALL)

_EXAMPLES = 'e.g. "deg", "deg/s", "m/s^2", "kt", "ft", "hPa", "g" (standard gravity), "%" or "1"'

STANDARD_GRAVITY = 9.80665  # m/s^2, CGPM 1901: what makes a weight of a mass

_SAYS_NOTHING = frozenset(("-", "--", "none", "nd", "n/d"))  # in a file, of a quantity that has a unit

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


@lru_cache(maxsize=2048)
def _meanings(unit: str) -> tuple[tuple[str, Any], ...]:
    """What a unit may mean, each as cards spell it and as pint's unit; the likeliest first."""
    if not unit.strip():
        return (("1", _registry().Unit("dimensionless")),)
    known = spellings(unit)
    if known:
        return tuple((text, _pint(text)) for text in known)
    if unclear(unit):
        return ()
    try:
        return ((unit.strip(), _pint(unit)),)
    except InputError:
        return ()


def _pint(unit: str) -> Any:
    """The pint unit of a text; "g" alone is standard gravity, which to pint is the gram."""
    text = "standard_gravity" if unit == "g" else unit.strip().replace("^", "**")
    # "m/s2" and "m s-1" are not pint's spelling, but everybody's
    for candidate in (text, _POWER.sub(r"**\1", text)):
        if len(candidate) > _LONGEST or _SAFE.fullmatch(candidate) is None or re.search(r"\*\*-?\d\s*\*\*", candidate):
            continue
        try:
            return _registry().parse_units(candidate)
        except Exception:  # pint leaks AssertionError, TypeError, tokenizer errors ... for text that is no unit
            continue
    raise InputError(unit)


def _known(unit: str, where: str) -> tuple[Any, ...]:
    """The pint units that `unit` may name."""
    found = _meanings(unit)
    if not found:
        raise InputError(f"{where}: the unit {unit[:40]!r} is not known; write it as in pint, {_EXAMPLES}")
    return tuple(meant for _, meant in found)


def _pair(one: str, other: str, where: str) -> tuple[Any, Any]:
    """Two units as they are meant beside each other: "lb" is a mass beside "kg" and a force beside "N"."""
    first, second = _known(one, where), _known(other, where)
    fitting = ((a, b) for a in first for b in second if a.dimensionality == b.dimensionality)
    return next(fitting, (first[0], second[0]))


def canonical(text: str, si: str | None = None) -> str | None:
    """A unit as cards spell it, whatever a file calls it: "FT/SEC" is "ft/s", "slugs/ft3" is "slug/ft^3".

    Args:
        text: the unit in a file's unit row, heading or attribute.
        si: SI unit of the quantity, which decides where a word has two meanings ("lbs" of a thrust is "lbf").

    Returns:
        The spelling; None where the text is no unit.
    """
    found = _meanings(text) if text.strip() else ()
    if si is not None and len(found) > 1:
        wanted = _known(si, "unit")[0].dimensionality
        found = [pair for pair in found if pair[1].dimensionality == wanted] or found
    return found[0][0] if found else None


def _turns(unit: Any) -> float:
    """The power to which an angle enters a unit: 1 for deg/s, 0 for m, -1 for 1/rad."""
    powers = _registry().Quantity(1, unit).unit_items()
    rpm = ("revolutions_per_minute", "revolutions_per_second")
    return sum(power for name, power in powers if name in _ANGLES or name in rpm)


def _convert(values: Any, source: str, target: str, where: str) -> Any:
    have, want = _pair(source, target, where)
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
    have, want = _pair(source, target, where)
    if _turns(have) != _turns(want):
        raise InputError(
            f"{where}: the unit {source!r} does not fit {target!r}; an angle needs an angular unit, and "
            f"only an angle "
            f'does: "deg", "rad", "deg/s" or "rad/s" for angles and rates, "1" or "%" for ratios'
        )


def si_unit(unit: str, where: str = "unit") -> str:
    """The SI unit (angles: radian) that a quantity in `unit` is held in, e.g. "rad/s" for "deg/s"."""
    base = _registry().get_base_units(_known(unit, where)[0])[1]
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
    """Whether two spellings mean one unit; None where either is no unit at all (files say many things).

    A dash says nothing of a quantity that has a unit.
    """
    try:
        first, second = _pair(one, other, "unit")
    except InputError:
        return None
    if first.dimensionality != second.dimensionality or _turns(first) != _turns(second):
        return None if {one.strip().lower(), other.strip().lower()} & _SAYS_NOTHING else False
    quantity = _registry().Quantity
    # Two points, for scales with an offset such as degC.
    return all(math.isclose(quantity(x, first).to(second).magnitude, x, rel_tol=1e-9) for x in (1.0, 300.0))


def same_kind(one: str, other: str) -> bool:
    """Whether a quantity can be given in either unit; False where one is no unit at all."""
    try:
        first, second = _pair(one, other, "unit")
    except InputError:
        return False
    return first.dimensionality == second.dimensionality and _turns(first) == _turns(second)


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
    if not unit and number == 0.0 and expected != "K":
        return 0.0
    if not unit and expected not in ("", "1"):
        raise InputError(f'{where} is {str(value)!r}, without a unit; write e.g. "{value} {expected}"')
    if expected == "kg" and same_kind(unit, "N") and not same_kind(unit, "kg"):  # a pound is either
        raise InputError(f"{where} is {str(value)!r}, a weight; {_mass_of(number, unit, where)}")
    return float(_convert(number, unit or "1", expected, where))


def _mass_of(weight: float, unit: str, where: str) -> str:
    """How to write the mass that has a weight, in kg and, for weights in pounds, in slug too."""
    mass = float(_convert(weight, unit, "N", where)) / STANDARD_GRAVITY
    pounds = not same_unit(unit, "N") and not same_unit(unit, "kN")
    slugs = f' or "{_convert(mass, "kg", "slug", where):.6g} slug"' if pounds else ""
    return f'write the mass, weight over g = 9.80665 m/s^2: "{mass:.6g} kg"{slugs}'


def instant(time: float) -> str:
    """A time in s, to a millisecond and however late the clock is: 36002.12, not 3.6e+04."""
    return f"{time:.3f}".rstrip("0").rstrip(".")


def number(value: float, digits: int = 3) -> str:
    """Significant digits without an exponent where people read numbers; a dash where there is none."""
    if not np.isfinite(value):
        return "–"
    rounded = f"{value:z.{digits - 1}e}"  # its exponent is that of what is shown: 999.7 has that of 1000
    exponent = int(rounded.partition("e")[2])
    if not -4 <= exponent < 6:
        return rounded
    return f"{value:z.{digits}g}" if exponent < digits else f"{value:z.0f}"
