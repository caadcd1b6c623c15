"""Numbers with the units that people read, lists in words, and counts of what cannot be tested."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping

import numpy as np

from bayes_aero.units import number

SYMBOLS = {"airspeed": "V", "alpha": "α", "theta": "θ", "altitude": "h", "beta": "β", "phi": "φ", "psi": "ψ"}

FOR_PEOPLE = {
    "rad": ("deg", 180.0 / np.pi),
    "rad/s": ("deg/s", 180.0 / np.pi),
    "m/s^2": ("m/s²", 1.0),
    "rad/s^2": ("deg/s²", 180.0 / np.pi),
    "1/rad^2": ("1/rad²", 1.0),
    "kg/m^3": ("kg/m³", 1.0),
}

KINDS = {
    re.compile(r"channel (.+) was not recorded"): "because a channel was not recorded ({})",
    re.compile(r"channel (.+) does not move in this record"): "because a channel does not move ({})",
    re.compile(
        r"channel (.+) shows nothing but noise in this record"
    ): "because a channel shows nothing but noise ({})",
    re.compile(r"the model has no (.+)"): "because the model lacks a parameter ({})",
}
"""Reasons that name something, as the screening states them, and the words under which they are counted."""


def for_people(unit: str) -> tuple[str, float]:
    """The unit in which people read a quantity, and the factor to it from SI."""
    return FOR_PEOPLE.get(unit, (unit, 1.0))


def size_text(mean: float, sd: float, unit: str) -> str:
    """0.62 ± 0.11 deg: two digits of the standard error, units as people read them."""
    shown, factor = for_people(unit)
    return f"{plus_minus(factor * mean, factor * sd)}{'' if shown == '1' else f' {shown}'}"


def bracket(unit: str) -> str:
    """A unit as it stands behind a name on an axis."""
    return "[-]" if unit in ("1", "", "-") else f"[{unit}]"


def plain_unit(unit: str) -> str:
    """A parameter's unit as people read it."""
    return {"1": "-", "c/V": "chords"}.get(unit, unit).replace("^2", "²").replace("^3", "³")


def decimals(sd: float) -> int:
    """Decimal places that show two digits of a standard error."""
    return int(np.clip(1 - np.floor(np.log10(sd)), 0, 8))


def plus_minus(value: float, sd: float) -> str:
    """`value ± sd` with two digits of sd: -0.391 ± 0.016."""
    if not (np.isfinite(sd) and sd > 0.0):
        return number(value, 4)
    places = decimals(sd)
    return f"{value:z.{places}f} ± {sd:.{places}f}"


def nats_text(gain: float, sd: float, sign: str = "") -> str:
    """A gain in log density with its standard error: "−269 ± 35 nats", "0.4 ± 0.3 nats", "less than 0.1 nats"."""
    if max(abs(gain), sd) < 0.1:
        return "less than 0.1 nats"
    places = 0 if sd >= 9.5 else 1
    return f"{gain:{sign}z.{places}f} ± {sd:.{places}f} nats"


def concise(value: float, sd: float) -> str:
    """`value(sd)` with two digits of sd, counted in the last digits of the value: -0.391(16)."""
    if not (np.isfinite(sd) and sd > 0.0):
        return number(value, 4)
    places = decimals(sd)
    return f"{value:z.{places}f}({round(sd * 10.0**places)})"


def from_to(low: float, high: float, sd: float) -> str:
    """The ends of an interval with as many digits as its standard error allows."""
    if not np.isfinite([low, high]).all():
        return "–"
    places = decimals(sd) if sd > 0.0 else 4
    return f"{low:z.{places}f} to {high:z.{places}f}"


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


def not_testable_sentences(reasons: Mapping[str, str]) -> list[str]:
    """How many effects are not testable, by kind of reason; nothing where all are.

    Args:
        reasons: by effect, why it cannot be tested.
    """
    if not reasons:
        return []
    counts: dict[str, int] = {}
    named: dict[str, dict[str, None]] = {}
    for reason in reasons.values():
        kind, things = _kind(reason)
        counts[kind] = counts.get(kind, 0) + 1
        named.setdefault(kind, {}).update(dict.fromkeys(things))
    listed = [f"{n} {kind.format(several(sorted(named[kind])))}" for kind, n in counts.items()]
    are = "effects are" if len(reasons) > 1 else "effect is"
    return [f"{len(reasons)} {are} not testable on this record: {'; '.join(listed)}."]


def _kind(reason: str) -> tuple[str, list[str]]:
    """Under which words a reason is counted, and the channels or parameters that it names."""
    for pattern, words in KINDS.items():
        if found := pattern.fullmatch(reason):
            return words, found[1].split(", ")
    return f"because {reason}".replace("{", "{{").replace("}", "}}"), []
