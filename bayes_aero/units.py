"""Conversions at the border: everything inside the package is in SI and radians.

This is the only module that knows pint. The registry takes a third of a second to build and is made on first
use. How units are spelled is one table below, which cards, files and headings share.
"""

from __future__ import annotations

import math
import re
import sys
from contextlib import suppress
from functools import cache, lru_cache
from itertools import product
from typing import Any

import numpy as np

from bayes_aero.errors import InputError

# Only products of named units with one-digit powers reach pint, which would evaluate "9**9**9**9" for ever.
_SAFE = re.compile(r"(?:1(?![\w.])|[A-Za-z%°µμΩ][A-Za-z_µμ0-9]*|\*\*-?\d(?!\d)|[*/·() ])*")
_POWER = re.compile(r"(?<=[A-Za-z%°])(-?\d)(?![\w.])")
_LONGEST = 60

_NUMBER = re.compile(r"\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d{1,3})?)\s*(.*)", re.DOTALL)

_EXAMPLES = 'e.g. "deg", "deg/s", "m/s^2", "kt", "ft", "hPa", "g" (standard gravity), "%" or "1"'

STANDARD_GRAVITY = 9.80665  # m/s^2, CGPM 1901: what makes a weight of a mass

_SAYS_NOTHING = frozenset(("-", "--", "none", "nd", "n/d"))  # in a file, of a quantity that has a unit

# Units that count turns. pint holds them for plain numbers, so "%" would pass for an angle and Hz for rad/s.
_ANGLES = {"radian", "degree", "arcminute", "arcsecond", "turn", "revolution", "grade", "gon", "milliradian"}
_ANGLES |= {"revolutions_per_minute", "revolutions_per_second"}


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
    plain = unit.strip()
    if not plain:
        return (("1", _registry().Unit("dimensionless")),)
    if not (texts := spellings(unit)):  # of some, capitals leave open which of two is meant: "MS" is no siemens, either
        texts = () if plain not in EXACT and plain.lower() in _CASE_TELLS else (plain,)
    return tuple((text, meaning) for text in texts if (meaning := _pint(text)) is not None)


def _pint(unit: str) -> Any:
    """The pint unit of a text, None if it is none; "g" alone is standard gravity, which to pint is the gram."""
    text = "standard_gravity" if unit == "g" else unit.replace("^", "**")
    # "m/s2" and "m s-1" are not pint's spelling, but everybody's
    for candidate in (text, _POWER.sub(r"**\1", text)):
        odd = len(candidate) > _LONGEST or re.search(r"\*\*-?\d\s*\*\*", candidate)
        # pint leaks AssertionError, TypeError, tokenizer errors ... for text that is no unit
        with suppress(Exception):
            if not odd and _SAFE.fullmatch(candidate):
                return _registry().parse_units(candidate)
    return None


def _pair(left: str, right: str, where: str) -> tuple[Any, Any]:
    """Two units as they are meant beside each other: "lb" is a mass beside "kg" and a force beside "N"."""
    for unit in (left, right):
        if not _meanings(unit):
            raise InputError(f"{where}: the unit {unit[:40]!r} is not known; write it as in pint, {_EXAMPLES}")
    pairs = [(a, b) for _, a in _meanings(left) for _, b in _meanings(right)]
    return next((pair for pair in pairs if pair[0].dimensionality == pair[1].dimensionality), pairs[0])


def canonical(text: str, si: str | None = None) -> str | None:
    """A unit as cards spell it ("FT/SEC": "ft/s"), of the kind of `si` if it has two meanings; None if it is none."""
    meanings = _meanings(text) if text.strip() else ()
    if si is not None and len(meanings) > 1:
        wanted = _pair(si, si, "unit")[0].dimensionality
        meanings = [pair for pair in meanings if pair[1].dimensionality == wanted] or meanings
    return meanings[0][0] if meanings else None


def _turns(unit: Any) -> float:
    """The power to which an angle enters a unit: 1 for deg/s, 0 for m, -1 for 1/rad."""
    return sum(power for name, power in _registry().Quantity(1, unit).unit_items() if name in _ANGLES)


def _convert(values: Any, source: str, target: str, where: str) -> Any:
    have, want = _pair(source, target, where)
    try:
        with np.errstate(all="ignore"):  # an overflow gives inf, which the record checks tell better
            return values if have == want else _registry().Quantity(values, have).to(want).magnitude
    except Exception as reason:  # DimensionalityError, OffsetUnitCalculusError, ...: these do not belong together
        raise InputError(f"{where}: the unit {source!r} cannot be turned into {target!r}; correct the unit") from reason


def si_unit(unit: str, where: str = "unit") -> str:
    """The SI unit (angles: radian) that a quantity in `unit` is held in, e.g. "rad/s" for "deg/s"."""
    return f"{_registry().get_base_units(_pair(unit, unit, where)[0])[1]:~}".replace(" ", "") or "1"


def to_si(values: Any, unit: str, channel_name: str, target: str | None = None) -> np.ndarray:
    """Values of a channel, any shape, in SI: in `target`, else in the base units of `unit`."""
    where = f"channel {channel_name}"
    return _between(values, unit, si_unit(unit, where) if target is None else target, unit, where)


def from_si(values: Any, unit: str, channel_name: str, source: str | None = None) -> np.ndarray:
    """The inverse of `to_si`: SI values (in `source`, else the base units of `unit`) expressed in `unit`."""
    where = f"channel {channel_name}"
    return _between(values, si_unit(unit, where) if source is None else source, unit, unit, where)


def _between(values: Any, source: str, target: str, given: str, where: str) -> np.ndarray:
    """Values in another unit; an angle stays one. `given`: which of the two units is not SI."""
    have, want = _pair(source, target, where)
    if _turns(have) != _turns(want):
        wanted = target if given == source else source
        needs = 'an angle, and nothing else, needs an angular unit: "deg", "rad", "deg/s", "rad/s"'
        raise InputError(f"{where}: the unit {given!r} does not fit {wanted!r}; {needs}")
    return np.asarray(_convert(np.array(values, dtype=np.float64), source, target, where), dtype=np.float64)


def same_unit(left: str, right: str) -> bool | None:
    """Whether two spellings mean one unit; None where either is none, or a dash beside one that is."""
    if not _meanings(left) or not _meanings(right):
        return None
    if not same_kind(left, right):
        return None if {left.strip().lower(), right.strip().lower()} & _SAYS_NOTHING else False
    # Two points, for scales with an offset such as degC.
    return all(math.isclose(_convert(x, left, right, "unit"), x, rel_tol=1e-9) for x in (1.0, 300.0))


def same_kind(left: str, right: str) -> bool:
    """Whether a quantity can be given in either unit; False where one is no unit at all."""
    if not _meanings(left) or not _meanings(right):
        return False
    first, second = _pair(left, right, "unit")
    return first.dimensionality == second.dimensionality and _turns(first) == _turns(second)


def quantity_to_si(value: Any, expected: str, where: str) -> float:
    """A constant with its unit, "17631 kg", in `expected`, SI. A bare number only without dimension: a mass without
    unit is how a pound slips in."""
    plain = isinstance(value, int | float | str) and not isinstance(value, bool)
    match = _NUMBER.fullmatch(str(value)) if plain else None
    if match is None or not math.isfinite(float(match[1])):
        raise InputError(f'{where} is {str(value)[:60]!r}; write a finite number with its unit, e.g. "1.5 {expected}"')
    number, unit = float(match[1]), match[2].strip()
    if not unit and number == 0.0 and expected != "K":
        return 0.0
    if not unit and expected not in ("", "1"):
        raise InputError(f'{where} is {str(value)!r}, without a unit; write e.g. "{value} {expected}"')
    if expected == "kg" and same_kind(unit, "N") and not same_kind(unit, "kg"):  # a pound is either
        mass = float(_convert(number, unit, "N", where)) / STANDARD_GRAVITY
        mend = f'write the mass, weight over g = 9.80665 m/s^2: "{mass:.6g} kg"'
        raise InputError(f"{where} is {str(value)!r}, a weight; {mend}")
    return float(_convert(number, unit or "1", expected, where))


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


# --- Spellings of units: what files, headings and cards write, as the one spelling that cards are given.
# Capitals do not matter, except where they tell two units apart: "mPa" and "MPa", "ms" and "Ms", "kN" and "kn".

_WORDS: dict[str, str] = {
    "s": "s sec secs second seconds", "min": "min mins minute minutes", "h": "h hr hrs hour hours",
    "ms": "msec msecs millisec millisecs millisecond milliseconds",
    "us": "us usec usecs microsec microsecond microseconds", "ns": "ns nsec nanosecond nanoseconds",
    "deg": "deg degs degree degrees °", "rad": "rad rads radian radians",
    "rpm": "rpm rpms rev/min revs/min r/min 1/min u/min", "m": "m meter meters metre metres",
    "km": "km kilometer kilometers kilometre kilometres", "cm": "cm centimeter centimeters centimetre centimetres",
    "mm": "millimeter millimeters millimetre millimetres", "ft": "ft feet foot", "in": "in inch inches",
    "nmi": "nmi nauticalmile nauticalmiles", "m/s": "mps", "m/s^2": "mps2 mpss", "km/h": "kmh kph kmph",
    "kt": "kt kts knot knots ktas kcas kias keas", "mph": "mph", "ft/s": "fps f/s f/sec",
    "ft/s^2": "fps2 fpss f/s2 f/s^2", "ft/min": "fpm f/min", "deg/s": "dps degps degpersec degsec",
    "deg/s^2": "dps2 dpss degps2", "rad/s": "radps radpersec radsec", "rad/s^2": "radps2",
    "g": "g gs g's gee gees gn g0", "kg": "kg kgs kilogram kilograms", "lb": "lbm lbsm", "slug": "slug slugs",
    "N": "n newton newtons", "kN": "kilonewton kilonewtons", "daN": "dan decanewton", "kgf": "kgf kp",
    "lbf": "lbf lbsf poundforce", "kip": "klbf kip kips", "Pa": "pa pascal pascals",
    "hPa": "hpa mbar mbars mb mbs millibar millibars hectopascal hectopascals", "kPa": "kpa kilopascal kilopascals",
    "bar": "bar bars", "psi": "psi psia psid", "lbf/ft^2": "psf psfa psfd",
    "inHg": "inhg inchhg incheshg inchesofmercury", "mmHg": "mmhg",
    "K": "k kelvin kelvins degk degkelvin degreeskelvin °k",
    "degC": "c degc celsius centigrade degcelsius degreec degreesc degreecelsius degreescelsius °c oc",
    "degF": "f degf fahrenheit degfahrenheit degreef degreesf degreesfahrenheit °f",
    "degR": "degr rankine degreesrankine", "ft^2": "sqft ftsq", "ft^3": "cuft", "slug ft^2": "slugft2",
    "slug/ft^3": "slugft3", "kg m^2": "kgm2", "kg/m^3": "kgm3", "Hz": "hz", "%": "% pct percent prct pc %rpm %n1 %n2",
    "1": "1 - -- none nd n/d nondim dimensionless unitless ratio fraction frac mach",
}  # fmt: skip
FOLDED: dict[str, tuple[str, ...]] = {word: (unit,) for unit, text in _WORDS.items() for word in text.split()}
FOLDED |= dict.fromkeys(("lb", "lbs", "pound", "pounds"), ("lb", "lbf"))  # mass or force: the quantity decides
FOLDED["kn"] = ("kN", "kt")
EXACT: dict[str, tuple[str, ...]] = {
    "ms": ("ms",), "Ms": ("Ms",), "mm": ("mm",), "mN": ("mN",), "MN": ("MN",), "mPa": ("mPa",), "MPa": ("MPa",),
    "kN": ("kN",), "kn": ("kt", "kN"), "mg": ("mg", "mg0"), "mrad": ("mrad",), "mV": ("mV",), "V": ("V",),
}  # fmt: skip
_CASE_TELLS = frozenset(word.lower() for word in EXACT) - {"kn", "v", "mrad"}
"""Written otherwise than above these are not known: "MS" and "MPA" may be a million times another unit."""

_RUN_TOGETHER = {"ms-1": "m/s", "ms-2": "m/s^2", "degs-1": "deg/s", "degs-2": "deg/s^2", "rads-1": "rad/s"}
_PLAIN = str.maketrans(
    {"²": "2", "³": "3", "⁻": "-", "¹": "1", "−": "-", "–": "-", "µ": "u", "μ": "u", "º": "°", "˚": "°"}
    | dict.fromkeys("·⋅×∙", "*")
)
_ASIDE = frozenset("ted teu ter tel up down left right msl agl tas cas ias true mag abs std total".split())  # noqa: SIM905
"""Words behind a unit that say what is measured, not in what: "deg TED", "ft MSL"."""
_TEMPERATURES = frozenset(("K", "degC", "degF", "degR"))  # "deg C" is no product
_RAISED = re.compile(r"\b(sq|square|cu|cubic)\b\.?\s*([A-Za-z]+)", re.IGNORECASE)
_UNDER = re.compile(r"_(s|sec|min|hr?)(?=\^?\d?$)", re.IGNORECASE)  # "deg_s" is a quotient
_PER = re.compile(r"\s*\bper\b\s*", re.IGNORECASE)
_FACTOR = re.compile(r"\s*(/|\*(?!\*)|-(?=[A-Za-z°%])|\.|)\s*([A-Za-z%°']+)((?:\^|\*\*)?\(?[+-]?[1-9]\)?)?")


@lru_cache(maxsize=2048)
def spellings(text: str) -> tuple[str, ...]:
    """What a unit may mean, as cards spell it, the likeliest first ("lbs": "lb", "lbf"); empty where unknown."""
    plain = text.strip().strip("[](){}<> ").translate(_PLAIN).strip()
    if not plain or len(plain) > _LONGEST:
        return ()
    plain = _RAISED.sub(lambda match: match[2] + ("^2" if match[1][0] in "sS" else "^3"), plain)
    plain = _UNDER.sub(r"/\1", plain)
    together = re.sub(r"[\s_.^]+", "", plain).lower()
    if together in _RUN_TOGETHER:
        return (_RUN_TOGETHER[together],)
    if word := _word(together if together.startswith("%") else plain):  # "% N1" is no product
        return word
    first, _, last = plain.replace("(", " ").rpartition(" ")
    if first and last.lower() in _ASIDE:
        return spellings(first)
    several = _product(plain)
    if several and not _TEMPERATURES & set(several[0].split()):
        return several
    return () if together in _CASE_TELLS else FOLDED.get(together, several)


def _word(word: str) -> tuple[str, ...]:
    folded = word.lower()
    return EXACT[word] if word in EXACT else () if folded in _CASE_TELLS else FOLDED.get(folded, ())


def _product(text: str) -> tuple[str, ...]:
    """What products and quotients of known words may mean, as "slug-ft2", "DEG/SEC**2"; empty for anything else."""
    left = _PER.sub("/", text)
    left = left[1:] if left.startswith("1/") else left
    factors: list[list[tuple[str, int]]] = []  # meanings of each, with their power
    while left.strip():
        match = _FACTOR.match(left)
        meant = _word(match[2]) if match else ()
        if match is None or not meant or meant == ("1",):
            return ()
        power = int(re.sub(r"[\^*()]", "", match[3])) if match[3] else 1
        factors.append([(unit, -power if match[1] == "/" else power) for unit in meant])
        left = left[match.end() :]
    composed = []
    for units in product(*factors) if factors else ():  # each word once: "m/s^2" of m, 1/s and 1/s
        powers: dict[str, int] = {}
        for unit, power in units:
            above, *below = unit.split("/")
            for sign, part in [*((1, part) for part in above.split()), *((-1, part) for part in below)]:
                name, _, exponent = part.partition("^")
                powers[name] = powers.get(name, 0) + sign * int(exponent or 1) * power
        above = " ".join(f"{n}^{p}" if p > 1 else n for n, p in powers.items() if p > 0)
        below = "".join(f"/{n}^{-p}" if p < -1 else f"/{n}" for n, p in powers.items() if p < 0)
        composed.append((above or "1") + below)
    return tuple(dict.fromkeys(composed))
