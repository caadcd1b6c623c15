"""Channels: what a card says about a column of a file, and what the program knows of it by name."""

from __future__ import annotations

import re
import tomllib
from dataclasses import dataclass
from importlib.resources import files
from typing import Any, NamedTuple

import numpy as np

from bayes_aero.units import canonical, from_si, si_unit, spellings


@dataclass(frozen=True)
class Channel:
    """Where a channel stands in a file, in which unit, and which way it counts there."""

    name: str  # inside the program, "alpha"; in SI there
    unit: str  # in the file, "deg"
    label: str | None = None  # in files with headers (.csv .mat .parquet .nc); without one, `name` is looked for
    column: int | None = None  # counted from 1, in files without a header (.asc)
    required: bool = True  # else a file may lack it, and the record then does
    sign: int = 1  # -1 where the file counts the other way: a load factor upward for az, an elevator trailing edge up

    @property
    def heading(self) -> str:
        """The name to look for in a file with headers."""
        return self.name if self.label is None else self.label

    @property
    def si(self) -> str:
        """The unit that it is held in: the program's, or the SI unit of the file's."""
        standard = STANDARD_CHANNELS.get(self.name)
        return standard.unit if standard else si_unit(self.unit, f"channel {self.name}")

    def filed(self, values: Any) -> np.ndarray:
        """SI values in the unit and with the sign of the file."""
        return np.asarray(self.sign * from_si(values, self.unit, self.name, self.si))


class StandardChannel(NamedTuple):
    """A channel that the program knows; `plausible` is what no sound record leaves: it catches wrong units."""

    name: str
    unit: str  # SI
    description: str
    plausible: tuple[float, float]


_TABLE: dict[str, dict[str, Any]] = tomllib.loads(
    files("bayes_aero.flight").joinpath("channels.toml").read_text("utf-8")
)
STANDARD_CHANNELS = {
    name: StandardChannel(name, row["unit"], row["description"], tuple(row["plausible"]))
    for name, row in _TABLE.items()
}

UNITS: dict[str, tuple[str, ...]] = {
    "rad": ("deg", "rad"), "rad/s": ("deg/s", "rad/s"), "rad/s^2": ("deg/s^2", "rad/s^2"), "m": ("ft", "m"),
    "m/s": ("kt", "km/h", "ft/s", "mph", "m/s"), "m/s^2": ("g", "ft/s^2", "m/s^2"), "K": ("degC", "K", "degF"),
    "Pa": ("hPa", "Pa", "kPa", "inHg", "psi", "lbf/ft^2"), "1": ("%", "1"), "N": ("lbf", "N", "kN"),
    "kg/m^3": ("g/m^3", "slug/ft^3", "kg/m^3", "lb/ft^3"), "kg": ("lb", "kg", "slug"), "m^2": ("ft^2", "m^2"),
    "s": ("s", "ms", "us", "ns", "min"),
}  # fmt: skip
"""Units that files have a quantity in, by its SI unit."""


def unit_choices(name: str) -> tuple[str, ...]:
    return UNITS.get(STANDARD_CHANNELS[name].unit, ()) if name in STANDARD_CHANNELS else ()


# --- What people call channels and units in the headers of their files.

_NAMES = {name: row["names"].split() for name, row in _TABLE.items() if "names" in row}


# Names of the left and right half of what has two: "aileronr" and "raileron" are not the aileron. Only of whole words:
# "del" and "rde" are too short to say.
_SIDED = {
    alias: f"{whole}_{side}"
    for whole in (name.removesuffix("_left") for name in STANDARD_CHANNELS if name.endswith("_left"))
    for word in (whole, *_NAMES.get(whole, ()))
    if len(word) > 3
    for side in ("left", "right")
    for mark in (side, side[0], f"{side[0]}h")
    for alias in (word + mark, mark + word)
}
ALIASES: dict[str, str] = (
    _SIDED
    | {alias: name for name, aliases in _NAMES.items() for alias in aliases}
    | {name.replace("_", ""): name for name in STANDARD_CHANNELS}
)
"""Channel by what a heading is called in lower case, without blanks, underscores and units."""

_NO_UNIT_OF_A_NAME = frozenset(
    "1 - -- none nd ratio fraction frac mach min mins minute h hr hour rpm bar n1 n2 n3".split()  # noqa: SIM905
)
"""Words that end names for other reasons: "thrust_1", "alpha_min", "engine_N2"."""

_IN_NAME = {"ktas": "kt", "kcas": "kt", "kias": "kt", "nx": "g", "ny": "g", "nz": "g", "nzcg": "g", "loadfactor": "g"}
_IN_NAME |= dict.fromkeys(("rpm", "enginerpm", "proprpm"), "rpm")
_BRACKETS = re.compile(r"^(.*?)\s*[\[({<]([^\])}>]*)[\])}>]\s*$")
_BEHIND_COMMA = re.compile(r"([^,]*),_*([^,]+?)_*")  # "alpha,__deg"
_PARTS = re.compile(r"[\s_.:/#-]+")
_BESIDE = frozenset(
    "gyro vane sensor meas measured recorded raw filt filtered up down imu ahrs ins irs adc fdr eng probe boom".split()  # noqa: SIM905
)
"""Words that say where a channel comes from or which way it counts, not what it is: "Q gyro", "NZ up"."""
_SIDES = dict.fromkeys("l left lh lft port 1".split(), "left")  # noqa: SIM905
_SIDES |= dict.fromkeys("r right rh rgt stbd starboard 2".split(), "right")  # noqa: SIM905
_NUMBERED = re.compile(r"\b(eng|engine|motor|no|nr)([12])\b")
_AROUND = frozenset("eng engine motor no nr net total".split())  # noqa: SIM905
_SYMBOLS = frozenset(
    "nx ny nz ax ay az tas ktas ias kias cas kcas vtas aoa aos alpha beta theta phi psi mach rho".split()  # noqa: SIM905
)
_WANTED = frozenset("cmd command commanded target desired demand demanded ref reference selected sel set".split())  # noqa: SIM905


def _parted(heading: str) -> tuple[str, str]:
    """The name of a heading, and what stands in brackets behind it, with them."""
    bracketed = _BRACKETS.match(heading.strip())
    name = bracketed[1] if bracketed else heading.strip()
    return name, heading.strip()[len(name) :]


def plain_heading(heading: str) -> str:
    """The heading without such words, unless nothing would be left: "Q [deg/s]" of "Q gyro [deg/s]"."""
    name, unit = _parted(heading)
    kept = [word for word in _PARTS.split(name) if word and word.lower() not in _BESIDE]
    named = kept and any(not spellings(k) or k.lower() in ALIASES for k in kept)
    return "_".join(kept) + unit if named else heading


def side_of(heading: str) -> tuple[str, str] | None:
    """The heading without the word for one of two sides or engines, and "left" or "right": "net_thrust_1"."""
    name, unit = _parted(heading)
    words = _PARTS.split(_NUMBERED.sub(r"\1 \2", " ".join(filter(None, _PARTS.split(name.lower())))))
    sides = [_SIDES[word] for word in words if word in _SIDES]
    rest = [word for word in words if word not in _SIDES and word not in _AROUND]
    return ("_".join(rest) + unit, sides[0]) if len(sides) == 1 and rest else None


def split_heading(heading: str, si: str | None = None) -> tuple[str, str | None]:
    """Name and unit of a heading: "AoA [deg]", "alt_ft", "KTAS"; `si` of the channel decides what "TAS [KN]" means."""
    bracketed = _BRACKETS.match(heading.strip()) or _BEHIND_COMMA.fullmatch(heading.strip())
    if bracketed and "," in bracketed[0][len(bracketed[1]) :] and _spelled(bracketed[2], si) is None:
        bracketed = None  # "Gload,norml" is a name of two words
    name, unit = (bracketed[1], _spelled(bracketed[2], si)) if bracketed else (heading.strip(), None)
    parts = [part for part in _PARTS.split(name.lower()) if part]
    if unit is None and not bracketed:
        for count in (2, 1):  # "rate_deg_s" before "accel_g"
            if len(parts) <= count or parts[-1] in _NO_UNIT_OF_A_NAME:
                continue
            last = parts[-count:]
            spelling = _spelled("/".join(last), si)  # "deg", "s2" is deg/s^2, "in", "hg" is inHg
            if spelling is None and count == 2 and last[1] in ("hg", "c", "f", "k"):
                spelling = _spelled(" ".join(last), si)
            if spelling is not None:
                parts, unit = parts[:-count], spelling
                break
    key = re.sub(r"[^a-z0-9]", "", "".join(parts))
    return key, unit or _IN_NAME.get(key)


def _spelled(text: str, si: str | None) -> str | None:
    """Only what the table of spellings knows: to pint, "(cal)" would be a calorie."""
    return canonical(text, si) if spellings(text) else None


def is_command(heading: str) -> bool:
    """Whether a heading names a command or a reference, not a measured position: "elevator_cmd"."""
    return bool(_WANTED & {word.lower() for word in _PARTS.split(heading)})


def symbol_of(heading: str) -> str | None:
    """The symbol that a heading ends with, "nx" of "Long. Load Factor nx [g]"; none of a value that was only wanted."""
    words = [word for word in _PARTS.split(_parted(heading)[0].lower()) if word]
    while len(words) > 1 and spellings(words[-1]) and words[-1] not in _SYMBOLS:
        words.pop()
    return words[-1] if words and words[-1] in _SYMBOLS and not is_command(heading) else None
