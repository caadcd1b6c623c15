"""A starter card for a new aircraft: what a record's columns seem to be, and what only its user can know."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from bayes_aero.errors import InputError
from bayes_aero.flight.aliases import split_heading
from bayes_aero.flight.axes import Axis
from bayes_aero.flight.card.channel_table import ATMOSPHERE, RULES
from bayes_aero.flight.channel import STANDARD_CHANNELS
from bayes_aero.flight.health.signals import noise_of, quantum
from bayes_aero.flight.reading.checks import MIN_SAMPLES
from bayes_aero.flight.reading.raw import RawColumn, read_raw
from bayes_aero.flight.reading.repeats import repeats
from bayes_aero.flight.reading.segments import parts_of
from bayes_aero.jobs.card.column_inference import guessed
from bayes_aero.jobs.card.column_statistics import Guess
from bayes_aero.jobs.card.template_aircraft import aircraft_block
from bayes_aero.jobs.card.template_check import read_back
from bayes_aero.jobs.card.template_model import comment, has_lateral, model_block
from bayes_aero.physics.coefficient_names import FORMED_FROM, REQUIRED
from bayes_aero.units import canonical, from_si

NEEDED = ("time", *REQUIRED, "elevator")
ENGINE = ("n1_left", "n1_right", "engine_speed", "throttle", "throttle_left", "throttle_right")
ACCELERATIONS = ("ax", "az")
LATERAL = ("p", "r")
HELD = (*LATERAL, "density", "thrust")  # may be stated as constants
LEVEL = {"phi": "deg", "beta": "deg", "ay": "m/s^2"}  # the flight path's, zero where wings stay level; in this unit
STILL = np.deg2rad(0.5)  # rad/s of roll and yaw rate, in the mean square
SPOOL = re.compile(r"(?<![A-Za-z0-9])N[123](?![0-9])", re.IGNORECASE)  # a heading's word for the speed of a spool
KINEMATIC = ("theta", "phi", "beta", "ay", "altitude")


@dataclass(frozen=True)
class Starter:
    """A starter card: its text, what is still to be filled in (key and what it is), and what it was made from."""

    text: str
    todo: list[tuple[str, str]]
    found: dict[str, Guess]
    unknown: list[RawColumn]

    @property
    def parts(self) -> int:
        """Parts of the file between gaps in time."""
        time = self.found["time"].si if "time" in self.found and not self.doubt("time") else np.zeros(1)
        again = repeats(time, (guess.values for guess in self.found.values() if len(guess.values) == len(time)))
        return sum(end - begin >= MIN_SAMPLES for begin, end in parts_of(time[~again]))

    @property
    def blind(self) -> tuple[str, ...]:
        """Accelerations that were not found: coefficients cannot be formed without them."""
        return tuple(n for n in ACCELERATIONS if n not in self.found or self.doubt(n))

    @property
    def told(self) -> dict[str, Any]:
        """What was guessed, as plain data."""
        channels = {
            name: {
                "place": g.column.place,
                "unit": g.unit,
                "sign": g.sign,
                "evidence": g.evidence,
                "doubt": doubt or None,
            }
            for name, g in self.found.items()
            for doubt in (self.doubt(name),)
        }
        unknown = [column.place for column in self.unknown]
        return {"channels": channels, "unknown": unknown, "todo": dict(self.todo), "not_found": list(self.blind)}

    def doubt(self, name: str) -> str:
        """Why a guess was not taken; empty where it was."""
        return _implausible(name, self.found[name])


def starter_card(path: Path) -> Starter:
    """Guess from a record's columns.

    Raises:
        InputError: the record cannot be read, or is too short to guess from.
        DefectError: the card would not be one.
    """
    raw = read_raw(path)
    longest = max((len(c.values) for c in raw.columns if c.values is not None), default=0)
    if longest < MIN_SAMPLES:
        raise InputError(f"{path}: it has {longest} samples; at least {MIN_SAMPLES} are needed to guess from")
    found, unknown = guessed(raw.columns)
    lines = [
        f"# Starter card, written from {path.name}. Read every line: what says 'guess' may be wrong.",
        "# Fill in what says TODO, then: bayes-aero check RECORD --model THIS_FILE",
        "",
        f"title = {_text('the aircraft of ' + path.stem)}",
        'source = "starter card; state where the constants come from"',
        "",
        *aircraft_block(),
        "",
        *_channels(found, unknown, raw.columns),
        "",
        *_sums(found),
        *_constants(found),
        *_sensors(found),
        *model_block(found, "mach" in found or "mach" in _derivable(found)),
    ]
    open_lines = [line for line in lines if '"TODO' in line and not line.startswith("#")]
    todo = [(line.split(" =")[0].strip(), line.partition(" # ")[2]) for line in open_lines]
    text = "\n".join(lines) + "\n"
    read_back(text, path.name)
    return Starter(text, todo, found, unknown)


def _text(words: str) -> str:
    """A TOML string on one line."""
    return json.dumps(words, ensure_ascii=False).replace("\x7f", "\\u007f")


def _channels(found: Mapping[str, Guess], unknown: Sequence[RawColumn], columns: Sequence[RawColumn]) -> Iterator[str]:
    yield "# The file's columns. sign = -1: the file counts the other way (nz up, elevator trailing edge up)."
    yield "[channels]"
    headless = all(column.label is None for column in columns)
    place = "column" if headless else "label"
    for name in NEEDED:
        if name not in found and name not in HELD and name not in _summed(found):
            yield from _absent(name, place)
    for name, guess in found.items():
        optional = "" if name in NEEDED or name in KINEMATIC else ", required = false"
        sign = ", sign = -1" if guess.sign < 0 else ""
        entry = f"{name} = {{ {_place(guess.column)}, unit = {_text(guess.unit or 'TODO')}{sign}{optional} }}"
        doubt = _implausible(name, guess)
        if doubt:
            yield comment(f"NOT TAKEN, {doubt}; {guess.evidence}:")
            yield f"# {entry}"
            if name in NEEDED:
                yield from _absent(name, place, "what the file has was not taken")
            continue
        yield f"{entry} {comment(f'guess: {guess.evidence}; {_range(guess.values)}')}"
    if unknown:
        rest = [n for n in STANDARD_CHANNELS if n not in found]
        yield "# Columns that nothing was guessed for. Names that are still free:"
        for begin in range(0, len(rest), 10):
            yield f"# {', '.join(rest[begin : begin + 10])}"
    for column in unknown:
        if column.values is None:
            yield comment(f"{column.place}: no numbers")
            continue
        said = column.unit or (split_heading(column.label)[1] if column.label else None) or _of_spool(column)
        unit = _text(canonical(said) or said)
        yield f"# NAME = {{ {_place(column)}, unit = {unit}, required = false }} # {_range(column.values)}"
    if headless:
        yield "# The file has no header, so nothing can be guessed: say which column is what."


def _of_spool(column: RawColumn) -> str:
    """Unit of an engine speed, N1 or N2, by its size; "?" of anything else."""
    if column.label is None or column.values is None or not SPOOL.search(column.label):
        return "?"
    size = float(np.nanmax(np.abs(column.values), initial=0.0))
    return "rpm" if size > 200.0 else "%" if size > 2.0 else "1"


def _place(column: RawColumn) -> str:
    return f"column = {column.number}" if column.label is None else f"label = {_text(column.label)}"


def _range(values: np.ndarray) -> str:
    sound = values[np.isfinite(values)]
    return f"{sound.min():.5g} to {sound.max():.5g}" if len(sound) else "no finite number"


def _absent(name: str, place: str, why: str = "was not found in the file") -> Iterator[str]:
    standard = STANDARD_CHANNELS.get(name)
    what, unit = (standard.description, standard.unit) if standard else ("total net thrust", "N")
    if name in ACCELERATIONS:
        yield comment(f"{name} was not found: {what}. Without it diagnose works from trajectories alone, identify not:")
        yield f'# {name} = {{ {place} = "...", unit = "{unit}" }}'
        return
    yield f'{name} = {{ {place} = "TODO", unit = "{unit}" }} {comment(f"{what}; {why}")}'


def _implausible(name: str, guess: Guess) -> str:
    if name not in STANDARD_CHANNELS:
        return ""
    low, high = STANDARD_CHANNELS[name].plausible
    x = guess.si
    if x.min() >= low and x.max() <= high:
        return ""
    return f"{x.min():.4g} to {x.max():.4g} {STANDARD_CHANNELS[name].unit} is beyond any flight"


def _taken(found: Mapping[str, Guess]) -> set[str]:
    """Channels whose guess stands on the card."""
    return {name for name, guess in found.items() if not _implausible(name, guess)}


def _sums(found: Mapping[str, Guess]) -> Iterator[str]:
    lines = []
    if _both(found, "thrust"):
        lines.append('thrust = ["thrust_left", "thrust_right"]')
    if _both(found, "elevator"):
        lines.append("elevator = { elevator_left = 0.5, elevator_right = 0.5 } # the mean of both")
    elif _both(found, "elevon"):
        lines.append("elevator = { elevon_left = 0.5, elevon_right = 0.5 } # guess: the mean of the elevons")
    if _both(found, "aileron"):
        lines.append("aileron = { aileron_right = 0.5, aileron_left = -0.5 } # guess: down is positive on either side")
    if lines:
        yield from ("[sums]", *lines, "")


def _both(found: Mapping[str, Guess], name: str) -> bool:
    """Whether the left and the right one were found and not what they make together."""
    return name not in found and {f"{name}_left", f"{name}_right"} <= _taken(found)


def _summed(found: Mapping[str, Guess]) -> set[str]:
    """Needed channels that `_sums` makes."""
    return {"elevator"} if "elevator" not in found and (_both(found, "elevator") or _both(found, "elevon")) else set()


def _derivable(found: Mapping[str, Guess]) -> dict[str, str]:
    """Channels that are not in the file and can be formed from it, each by the best rule."""
    have = _taken(found)
    best = {
        name: next((rule for rule, needs in rules.items() if set(needs) <= have), None) for name, rules in RULES.items()
    }
    return {name: rule for name, rule in best.items() if rule is not None and name not in have}


def _constants(found: Mapping[str, Guess]) -> Iterator[str]:
    """Channels that the file lacks, formed from others, or held for the whole record."""
    derived = _derivable(found)
    absent = [name for name in RULES if name not in found and name not in derived]
    if not derived and absent:
        yield "# Where the altitude is recorded these can be formed from it (standard atmosphere):"
        yield "# [derived]"
        yield from (f'# {name} = "{ATMOSPHERE}"' for name in absent)
        yield ""
    if derived:
        yield "# Formed from other channels. The day's air is unlike a standard one by some per cent."
        yield "[derived]"
        for name, rule in derived.items():
            yield f'{name} = "{rule}" # guess; {"what the file has was not taken" if name in found else "not found"}'
        yield ""
    lines = []
    engine = next((name for name in ENGINE if name in found), None)
    if engine and not any(name.startswith("thrust") for name in found):
        yield f"# Thrust may be read off a table over {engine} instead; see [tables.NAME] in the reference of the card."
    if "density" not in found and "density" not in derived:
        lines.append('density = "TODO" # of the air, e.g. "0.9 kg/m^3"; neither it nor an altitude was found')
    if "thrust" not in found and not _taken(found) >= {"thrust_left", "thrust_right"}:
        lines.append(f'thrust = "TODO" # total net thrust, e.g. "2500 N"; {_thrust_of(found)}. Drag is as good as this')
    lines += [
        f'{name} = "0 rad/s" # guess: found under no heading, taken as zero' for name in LATERAL if name not in found
    ]
    lines += _still(found)
    if lines:
        yield from ("# Held constant over the record, for want of a channel.", "[constants]", *lines, "")


def _thrust_of(found: Mapping[str, Guess]) -> str:
    """What the file has of the thrust."""
    sides = [name for name in ("thrust_left", "thrust_right") if name in found]
    if not sides:
        return "was not found in the file"
    return f"only {sides[0]} was" if len(sides) == 1 else "both sides were found, but not taken"


def _still(found: Mapping[str, Guess]) -> Iterator[str]:
    """What the flight path needs beside the recorded channels, where these say that it stood still."""
    absent = [name for name in LEVEL if name not in found]
    if not absent or "theta" not in found or "altitude" not in found:
        return
    if all(np.nanstd(found[name].si) < STILL for name in LATERAL if name in found):
        yield from (
            f'{name} = "0 {LEVEL[name]}" # guess: found under no heading; it did not roll or yaw' for name in absent
        )
    else:
        yield f"# {', '.join(absent)}: found under no heading, and it rolled or yawed. Sensors go unchecked."


def _sensors(found: Mapping[str, Guess]) -> Iterator[str]:
    yield "# Standard deviations of the sensors' white noise; data sheets know better."
    yield "[sensors]"
    asked = FORMED_FROM[Axis.LATERAL] if has_lateral(found) else REQUIRED
    wanted = {n: g for n, g in found.items() if n in asked and not _implausible(n, g)}
    if "time" in found:
        for name, guess in wanted.items():
            deviation = noise_of(guess.si)
            if deviation > 0.5 * quantum(guess.si) and guess.unit is not None:  # less is rounding of a computed signal
                unit = guess.unit
                source = STANDARD_CHANNELS[name].unit if name in STANDARD_CHANNELS else "N"
                size = abs(float(from_si(deviation, unit, name, source)))
                yield f'{name} = "{size:.2g} {unit}" # guess: what is white in this record'
    yield ""
