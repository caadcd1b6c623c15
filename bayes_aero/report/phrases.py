"""Numbers with the units that people read, lists in words, and the tables of sentences and messages (`words.toml`)."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Collection, Iterable, Mapping, Sequence
from importlib.resources import files
from string import Formatter
from typing import Any

import numpy as np

from bayes_aero.effect import Untestable
from bayes_aero.flight.channel import STANDARD_CHANNELS
from bayes_aero.units import number

WORDS: dict[str, Any] = tomllib.loads(files("bayes_aero.report").joinpath("words.toml").read_text("utf-8"))
"""What reports say: captions, terms, notes, and the `sentences` and `messages` that values are put into."""

SYMBOLS = {
    "alpha": "α", "theta": "θ", "beta": "β", "phi": "φ", "psi": "ψ", "elevator": "δe", "aileron": "δa", "rudder": "δr",
    "airspeed": "V", "altitude": "h", "mach": "Mach", "thrust": "T", "alpha_dot": "α̇", "X": "separation point X",
    "elapsed": "time from start of record",
}  # fmt: skip
UNITS = {name: channel.unit for name, channel in STANDARD_CHANNELS.items()}
UNITS |= {"X": "1", "elapsed": "s", "alpha_dot": "rad/s"}  # what else is on an axis

DEGREES = 180.0 / np.pi
FOR_PEOPLE = {
    "rad": ("deg", DEGREES), "rad/s": ("deg/s", DEGREES), "rad/s^2": ("deg/s²", DEGREES), "m/s^2": ("m/s²", 1.0),
    "1/rad^2": ("1/rad²", 1.0), "kg/m^3": ("kg/m³", 1.0),
}  # fmt: skip


class _Filled(Formatter):
    """Reads lists out, follows their length, and writes values with standard errors; see `sentence`."""

    def format_field(self, value: Any, format_spec: str) -> str:
        if format_spec.startswith("±"):
            return size_text(value[0], value[1], format_spec[1:] or "1")
        listed = isinstance(value, Collection) and not isinstance(value, str)
        if "|" in format_spec:
            return format_spec.split("|")[int((len(value) if listed else value) != 1)]
        return several(value) if listed else super().format_field(value, format_spec)


def filled(text: str, /, **values: Any) -> str:
    """A text with its values.

    `{x}` reads a list out; `{x:is|are}` is the first where `x` is, or has, one; `{x:±rad}` writes a value and its
    standard error (SI) in the unit that people read.
    """
    return _Filled().vformat(text, (), values)


class Message(str):
    """What is read of a message of `words.toml`: its claim in one sentence, the text on it, and what to do."""

    key: str
    severity: str  # finding: an answer; doubt: a result is less sure than it looks; error: a result is of no use
    claim: str
    do: str


def sentence(key: str, /, **values: Any) -> str:
    """The sentence or the `Message` `key` of `words.toml` with its values."""
    if key in WORDS["sentences"]:
        return filled(WORDS["sentences"][key], **values)
    entry = WORDS["messages"][key]
    claim, text, do = (filled(entry.get(part, ""), **values).strip() for part in ("claim", "text", "do"))
    message = Message(" ".join(part for part in (claim, text, do) if part))
    message.key, message.severity, message.claim, message.do = key, entry["severity"], claim or text, do
    return message


def is_doubtful(text: str) -> bool:
    """Whether a sentence is a message of the table and more than an answer."""
    return isinstance(text, Message) and text.severity != "finding"


def for_people(unit: str) -> tuple[str, float]:
    """The unit in which people read a quantity, and the factor to it from SI."""
    return FOR_PEOPLE.get(unit, (unit, 1.0))


def size_text(mean: float, sd: float, unit: str) -> str:
    """0.62 ± 0.11 deg: two digits of the standard error, units as people read them."""
    shown, factor = for_people(unit)
    return f"{plus_minus(factor * mean, factor * sd)}{unit_behind(shown)}"


def unit_behind(unit: str) -> str:
    """A unit as it stands behind a number: nothing for a pure number."""
    return "" if unit == "1" else f" {unit}"


def bracket(unit: str) -> str:
    """A unit as it stands behind a name on an axis."""
    return "[-]" if unit in ("1", "", "-") else f"[{unit}]"


def symbol(output: str) -> str:
    return SYMBOLS.get(output, output)


def amounts(unit: str, *values: float) -> tuple[str, ...]:
    """Two digits of each value (SI), then the unit in which people read it, with a space before it."""
    shown, factor = for_people(unit)
    return *(short(factor * x) for x in values), unit_behind(shown)


def plain_unit(unit: str) -> str:
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


def from_to(low: float, high: float, sd: float) -> str:
    """The ends of an interval with as many digits as its standard error allows."""
    if not np.isfinite([low, high]).all():
        return "–"
    places = decimals(sd) if sd > 0.0 else 4
    return f"{low:z.{places}f} to {high:z.{places}f}"


def several(items: Iterable[str], most: int | None = None) -> str:
    """Items as they are read out, a, b and c; if there are more than `most`, how many more."""
    given = list(items)
    shown = given[:most]
    more = f" and {len(given) - len(shown)} more" if len(given) > len(shown) else ""
    return (" and ".join([", ".join(shown[:-1]), shown[-1]]) if len(shown) > 1 else "".join(shown)) + more


def unparted(status: str, following: Sequence[str]) -> str:
    """The status of a fit, and that feedback and aircraft cannot be parted where a surface only follows the outputs."""
    return f"{status}, but feedback and aircraft cannot be parted ({several(following)})" if following else status


def axis_label(output: str, unit: str) -> str:
    """An output with the unit in which people read it, from its SI unit."""
    return f"{symbol(output)} {bracket(for_people(unit)[0])}"


def channel_axis(channel: str, si: str = "") -> tuple[str, str, float]:
    """A channel's symbol, the unit in which people read it, and the factor to that from SI."""
    return symbol(channel).replace("_", " "), *for_people(si or UNITS.get(channel, "N"))


def short(x: float) -> str:
    """Two digits, without an exponent where people read metres and degrees; a dash where there is no number."""
    if not math.isfinite(x):
        return "–"
    return f"{x:.0f}" if 9.95 <= x < 1e6 else f"{x:#.2g}" if x > 0.0 else "0"


def not_testable_sentences(reasons: Mapping[str, str]) -> list[str]:
    """How many effects are not testable, by kind of reason (`reasons` by effect); nothing where all are."""
    kinds: dict[str, tuple[int, set[str]]] = {}  # count, and the channels or parameters that are named
    for reason in reasons.values():
        text, names = (reason.text, reason.names) if isinstance(reason, Untestable) else (reason, ())
        count, named = kinds.get(text, (0, set()))
        kinds[text] = count + 1, named | set(names)
    listed = [f"{n} because {k.format(several(sorted(names))) if names else k}" for k, (n, names) in kinds.items()]
    return [sentence("not_testable", n=len(reasons), listed="; ".join(listed))] if reasons else []
