"""Numbers with the units that people read, and lists in words."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np

SYMBOLS = {"airspeed": "V", "alpha": "α", "theta": "θ", "altitude": "h"}

FOR_PEOPLE = {
    "rad": ("deg", 180.0 / np.pi),
    "rad/s": ("deg/s", 180.0 / np.pi),
    "m/s^2": ("m/s²", 1.0),
    "rad/s^2": ("deg/s²", 180.0 / np.pi),
    "1/rad^2": ("1/rad²", 1.0),
    "kg/m^3": ("kg/m³", 1.0),
}


def for_people(unit: str) -> tuple[str, float]:
    """The unit in which people read a quantity, and the factor to it from SI."""
    return FOR_PEOPLE.get(unit, (unit, 1.0))


def size_text(mean: float, sd: float, unit: str) -> str:
    """0.62 ± 0.11 deg: two digits of the standard error, units as people read them."""
    shown, factor = for_people(unit)
    shown = "" if shown == "1" else f" {shown}"
    if not np.isfinite(sd) or sd <= 0.0:
        return f"{factor * mean:.3g}{shown}"
    places = max(0, 1 - int(np.floor(np.log10(factor * sd))))
    return f"{factor * mean:.{places}f} ± {factor * sd:.{places}f}{shown}"


def bracket(unit: str) -> str:
    """A unit as it stands behind a name on an axis."""
    return "[-]" if unit in ("1", "", "-") else f"[{unit}]"


def several(items: Iterable[str]) -> str:
    """Items as they are read out: a, b and c."""
    given = list(items)
    return " and ".join([", ".join(given[:-1]), given[-1]]) if len(given) > 1 else "".join(given)


def axis_label(output: str, unit: str) -> str:
    """An output with the unit in which people read it, from its SI unit."""
    return f"{SYMBOLS.get(output, output)} {bracket(for_people(unit)[0])}"


def short(x: float) -> str:
    """Two digits, without an exponent where people read metres and degrees; a dash where there is no number."""
    if not math.isfinite(x):
        return "–"
    return f"{x:.0f}" if 9.95 <= x < 1e6 else f"{x:#.2g}" if x > 0.0 else "0"
