"""Spellings of units: what files, headings and cards write, as the one spelling that cards are given.

Capitals do not matter, except where they tell two units apart: "mPa" and "MPa", "ms" and "Ms", "kN" and "kn".
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from functools import lru_cache
from itertools import product

__all__ = ["spellings", "unclear", "words"]

_WORDS: dict[str, str] = {
    "s": "s sec secs second seconds",
    "min": "min mins minute minutes",
    "h": "h hr hrs hour hours",
    "ms": "msec msecs millisec millisecs millisecond milliseconds",
    "us": "us usec usecs microsec microsecond microseconds",
    "ns": "ns nsec nanosecond nanoseconds",
    "deg": "deg degs degree degrees °",
    "rad": "rad rads radian radians",
    "rpm": "rpm rpms rev/min revs/min r/min 1/min u/min",
    "m": "m meter meters metre metres",
    "km": "km kilometer kilometers kilometre kilometres",
    "cm": "cm centimeter centimeters centimetre centimetres",
    "mm": "millimeter millimeters millimetre millimetres",
    "ft": "ft feet foot",
    "in": "in inch inches",
    "nmi": "nmi nauticalmile nauticalmiles",
    "m/s": "mps",
    "m/s^2": "mps2 mpss",
    "km/h": "kmh kph kmph",
    "kt": "kt kts knot knots ktas kcas kias keas",
    "mph": "mph",
    "ft/s": "fps f/s f/sec",
    "ft/s^2": "fps2 fpss f/s2 f/s^2",
    "ft/min": "fpm f/min",
    "deg/s": "dps degps degpersec degsec",
    "deg/s^2": "dps2 dpss degps2",
    "rad/s": "radps radpersec radsec",
    "rad/s^2": "radps2",
    "g": "g gs g's gee gees gn g0",
    "kg": "kg kgs kilogram kilograms",
    "lb": "lbm lbsm",
    "slug": "slug slugs",
    "N": "n newton newtons",
    "kN": "kilonewton kilonewtons",
    "daN": "dan decanewton",
    "kgf": "kgf kp",
    "lbf": "lbf lbsf poundforce",
    "kip": "klbf kip kips",
    "Pa": "pa pascal pascals",
    "hPa": "hpa mbar mbars mb mbs millibar millibars hectopascal hectopascals",
    "kPa": "kpa kilopascal kilopascals",
    "bar": "bar bars",
    "psi": "psi psia psid",
    "lbf/ft^2": "psf psfa psfd",
    "inHg": "inhg inchhg incheshg inchesofmercury",
    "mmHg": "mmhg",
    "K": "k kelvin kelvins degk degkelvin degreeskelvin °k",
    "degC": "c degc celsius centigrade degcelsius degreec degreesc degreecelsius degreescelsius °c oc",
    "degF": "f degf fahrenheit degfahrenheit degreef degreesf degreesfahrenheit °f",
    "degR": "degr rankine degreesrankine",
    "ft^2": "sqft ftsq",
    "ft^3": "cuft",
    "slug ft^2": "slugft2",
    "slug/ft^3": "slugft3",
    "kg m^2": "kgm2",
    "kg/m^3": "kgm3",
    "Hz": "hz",
    "%": "% pct percent prct pc %rpm %n1 %n2",
    "1": "1 - -- none nd n/d nondim dimensionless unitless ratio fraction frac mach",
}
_FOLDED: dict[str, tuple[str, ...]] = {word: (unit,) for unit, text in _WORDS.items() for word in text.split()}
_FOLDED |= dict.fromkeys(("lb", "lbs", "pound", "pounds"), ("lb", "lbf"))  # mass or force: the quantity decides
_FOLDED["kn"] = ("kN", "kt")
_EXACT: dict[str, tuple[str, ...]] = {
    "ms": ("ms",), "Ms": ("Ms",), "mm": ("mm",), "mN": ("mN",), "MN": ("MN",), "mPa": ("mPa",), "MPa": ("MPa",),
    "kN": ("kN",), "kn": ("kt", "kN"), "mg": ("mg", "mg0"), "mrad": ("mrad",), "mV": ("mV",), "V": ("V",),
}  # fmt: skip
_CASE_TELLS = frozenset(word.lower() for word in _EXACT) - {"kn", "v", "mrad"}
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
_LONGEST = 60


@lru_cache(maxsize=2048)
def spellings(text: str) -> tuple[str, ...]:
    """What a unit may mean, as cards spell it, the likeliest first; empty where the table does not know it.

    More than one where a word stands for two kinds of quantity: "lbs" is ("lb", "lbf").
    """
    plain = text.strip().strip("[](){}<> ").translate(_PLAIN).strip()
    if not plain or len(plain) > _LONGEST:
        return ()
    plain = _RAISED.sub(lambda found: found[2] + ("^2" if found[1][0] in "sS" else "^3"), plain)
    plain = _UNDER.sub(r"/\1", plain)
    together = re.sub(r"[\s_.^]+", "", plain).lower()
    if together in _RUN_TOGETHER:
        return (_RUN_TOGETHER[together],)
    one = _word(together if together.startswith("%") else plain)  # "% N1" is no product
    if one:
        return one
    first, _, last = plain.replace("(", " ").rpartition(" ")
    if first and last.lower() in _ASIDE:
        return spellings(first)
    several = _product(plain)
    if several and not _TEMPERATURES & set(several[0].split()):
        return several
    return () if together in _CASE_TELLS else _FOLDED.get(together, several)


def unclear(text: str) -> bool:
    """Whether the capitals leave open which of two units is meant: "MS" is no siemens, either."""
    return text.strip() not in _EXACT and text.strip().lower() in _CASE_TELLS


def words() -> Iterator[tuple[str, tuple[str, ...]]]:
    """Every spelling of one word that the table holds, and what it may mean."""
    yield from _FOLDED.items()
    yield from _EXACT.items()


def _word(word: str) -> tuple[str, ...]:
    if word in _EXACT:
        return _EXACT[word]
    folded = word.lower()
    return () if folded in _CASE_TELLS else _FOLDED.get(folded, ())


def _product(text: str) -> tuple[str, ...]:
    """Products and quotients of known words, "slug-ft2", "DEG/SEC**2", "m s-2"; empty for anything else."""
    left = _PER.sub("/", text)
    left = left[1:] if left.startswith("1/") else left
    factors: list[tuple[tuple[str, ...], int]] = []
    while left.strip():
        found = _FACTOR.match(left)
        if found is None:
            return ()
        meant = _word(found[2])
        if not meant or meant == ("1",):
            return ()
        power = int(re.sub(r"[\^*()]", "", found[3])) if found[3] else 1
        factors.append((meant, -power if found[1] == "/" else power))
        left = left[found.end() :]
    together = (_composed(tuple(zip(chosen, (p for _, p in factors), strict=True))) for chosen in _choices(factors))
    return tuple(dict.fromkeys(together))


def _choices(factors: list[tuple[tuple[str, ...], int]]) -> Iterator[tuple[str, ...]]:
    return product(*(meant for meant, _ in factors))


def _composed(factors: tuple[tuple[str, int], ...]) -> str:
    """One spelling of a product, each word once: "m/s^2" of m, 1/s and 1/s."""
    powers: dict[str, int] = {}
    for unit, power in factors:
        for name, own in _parts(unit):
            powers[name] = powers.get(name, 0) + own * power
    above = " ".join(f"{n}^{p}" if p > 1 else n for n, p in powers.items() if p > 0)
    below = "".join(f"/{n}^{-p}" if p < -1 else f"/{n}" for n, p in powers.items() if p < 0)
    return (above or "1") + below


def _parts(unit: str) -> Iterator[tuple[str, int]]:
    """The words of a unit of the table and their powers."""
    above, *below = unit.split("/")
    for sign, some in ((1, above.split()), (-1, below)):
        for part in some:
            name, _, power = part.partition("^")
            yield name, sign * int(power or 1)
