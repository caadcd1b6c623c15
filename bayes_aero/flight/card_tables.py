"""TOML files that people write, cards and studies: read with bounds on what a hostile one can ask for."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from difflib import get_close_matches
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from bayes_aero.errors import InputError
from bayes_aero.flight.channel import STANDARD_CHANNELS, Channel
from bayes_aero.physics.aircraft import (
    AIRCRAFT_KEYS,
    AIRCRAFT_UNITS,
    DEFAULT_RANGES,
    OPTIONAL,
    UNITS,
    Aircraft,
    Envelope,
)
from bayes_aero.units import quantity_to_si

MOST_BYTES = 1 << 18  # a card has some 5 kB, a study that lists 3000 records 200
MOST_DEPTH, MOST_NAME, LARGEST = 12, 200, 2**63
# tomllib's time grows with the square of the parts of a dotted key. A part is matched from its beginning only.
_DOTTED = re.compile(r"""(?:(?<![\w-])[\w-]+|"[^"\n]{0,200}"|'[^'\n]{0,200}')[ \t]*\.[ \t]*""")
MOST_DOTS = 12


def read_table(path: Path, what: str) -> tuple[bytes, dict[str, Any]]:
    """The file's bytes and its table; `what` ("card", "study") begins the sentence where it cannot be had."""
    where = f"{what} {path}"
    try:
        if not path.is_file():
            raise InputError(f"{where}: it is no file; check the path")
        with path.open("rb") as handle:
            raw = handle.read(MOST_BYTES + 1)
    except (OSError, ValueError) as error:
        if isinstance(error, InputError):
            raise
        reason = getattr(error, "strerror", None) or error
        raise InputError(f"{where}: cannot be read ({reason}); check the path and its permissions") from None
    return raw, parse_table(raw, where, what)


def parse_table(raw: bytes, where: str, what: str = "card") -> dict[str, Any]:
    """The table that a file's bytes are; `where` begins the sentence if they are none."""
    if len(raw) > MOST_BYTES:
        raise InputError(f"{where}: it has more than {MOST_BYTES} bytes; is it a {what} at all?")
    try:
        text = raw.decode("utf-8")
        for number, line in enumerate(text.split("\n"), 1):
            run, end = 0, -1
            for part in _DOTTED.finditer(line) if line.count(".") > MOST_DOTS else ():
                run = run + 1 if part.start() == end else 1
                end = part.end()
                if run > MOST_DOTS:
                    raise ValueError(f"a name of more than {MOST_DOTS} parts, line {number}")
        table = tomllib.loads(text)
    except RecursionError:
        raise InputError(f"{where}: not valid TOML (nested too deeply); mend it") from None
    except ValueError as error:  # TOMLDecodeError, UnicodeDecodeError, and Python's bound on the digits of a number
        raise InputError(f"{where}: not valid TOML ({error}); mend that line") from None
    # Numbers, names and nesting that no card needs, and that would trip whatever looks at them later.
    left: list[tuple[Any, int]] = [(table, 0)]
    while left:
        value, depth = left.pop()
        if depth > MOST_DEPTH:
            raise InputError(f"{where}: it is nested deeper than {MOST_DEPTH}; mend it")
        if isinstance(value, dict):
            for key in value:
                if len(key) > MOST_NAME or not key.isprintable():
                    raise InputError(f"{where}: {key[:40]!r} is no name for an entry; mend it")
            left += [(inner, depth + 1) for inner in value.values()]
        elif isinstance(value, list):
            left += [(inner, depth + 1) for inner in value]
        elif isinstance(value, int) and not -LARGEST <= value < LARGEST:
            raise InputError(f"{where}: a whole number has more than 18 digits; correct it")
    return table


def is_file(path: Path) -> bool:
    """Whether it is a file; a name that no file can have (too long, with NUL) is none."""
    try:
        return path.is_file()
    except (OSError, ValueError):
        return False


# --- Checks that every section of a card needs; each failure is one sentence that names the card.


def refuse(wrong: object, sentence: str) -> None:
    """Raise the sentence if something is wrong."""
    if wrong:
        raise InputError(sentence)


def section(table: Mapping[str, Any], key: str, where: str) -> Mapping[str, Any]:
    """A section of the card, empty where it is absent."""
    value = table.get(key, {})
    refuse(not isinstance(value, dict), f"card {where}: {key} must be a section, [{key}]")
    return value


def known_keys(table: Mapping[str, Any], known: Sequence[str], where: str, what: str) -> None:
    """Refuse a key that is not `known`; `what` says what kind of key it is."""
    for key in table:
        if key not in known:
            close = get_close_matches(key, known, n=1)
            hint = f"did you mean {close[0]!r}?" if close else f"known are {', '.join(known)}"
            raise InputError(f"card {where}: unknown {what} {key[:60]!r}; {hint}")


def all_mapped(names: Iterable[str], known: Collection[str], what: str) -> None:
    """Refuse names that are no channels of the card, with a hint at the nearest; `what` begins the sentence."""
    for name in names:
        if name not in known:
            close = get_close_matches(name, list(known), n=1)
            hint = f"; is {close[0]!r} there meant?" if close else ""
            raise InputError(f"card {what} {name}, which [channels] does not map{hint}")


UNFILLED = "TODO"  # stands on a starter card where the user has something to fill in


def refuse_unfilled(table: Mapping[str, Any], where: str) -> None:
    """Name every entry of a starter card that is still to be filled in."""
    left = []
    for name, entries in table.items():
        for key, value in entries.items() if isinstance(entries, dict) else ():
            for part, given in value.items() if isinstance(value, dict) else [("", value)]:
                if UNFILLED in (str(x)[: len(UNFILLED)] for x in (given if isinstance(given, list) else [given])):
                    left.append(f"[{name}] {key} {part}".strip())
    if left:
        first, *others = left
        also = f", and so {'are' if len(others) > 1 else 'is'} {', '.join(others)}" if others else ""
        raise InputError(
            f"card {where}: {first} is still {UNFILLED}{also}; fill in what is missing, the comment beside it says "
            "what it is"
        )


def strings(value: Any, sentence: str, *, empty: bool = False) -> tuple[str, ...]:
    """A list of names, not `empty` unless it may be; else `sentence` is raised."""
    listed = isinstance(value, list) and (value or empty) and all(isinstance(name, str) for name in value)
    refuse(not listed, sentence)
    return tuple(value)


def number(value: Any, where: str) -> float:
    """A plain number."""
    plain = isinstance(value, int | float) and not isinstance(value, bool)
    refuse(not plain, f"card {where}: {str(value)[:60]!r} is not a number")
    return float(value)


def numbers(table: Any, where: str) -> dict[str, float]:
    """A table of plain numbers."""
    refuse(not isinstance(table, dict), f"card {where} must be a table of numbers")
    return {key: number(value, f"{where} {key}") for key, value in table.items()}


# --- The section [aircraft].

ROUNDED = 0.02  # moments of inertia are given to two or three digits
POSITIONS = ("reference_point", "accelerometer", "engine")
SIGNED = ("Ixz", "Ixy", "Iyz", "engine_inclination", "engine_arm", *POSITIONS)


def parse_aircraft(table: Mapping[str, Any], where: str) -> Aircraft:
    """Constants in SI; the aspect ratio is span squared over wing area where it is not stated."""
    here = f"card {where}: [aircraft]"
    known_keys(table, tuple(AIRCRAFT_KEYS), where, "key of [aircraft]")
    spans = f"span ({table.get('span')}) and half_span ({table.get('half_span')})"
    refuse("span" in table and "half_span" in table, f"{here} has {spans}; keep one of them")
    values: dict[str, Any] = {}
    for key, unit in AIRCRAFT_KEYS.items():
        given, label = table.get(key), f"{here} {key}"
        if given is None:
            other = f', or span = "... {unit}"' if key == "half_span" else ""
            needed = key not in OPTIONAL and key != "span" and (key != "half_span" or "span" not in table)
            refuse(needed, f'{here} has no {key}; add it with its unit, e.g. {key} = "... {unit}"{other}')
        elif key in POSITIONS:
            vector = isinstance(given, list) and len(given) == 3
            refuse(not vector, f"{label} must be three lengths, [x, y, z]")
            values[key] = tuple(quantity_to_si(part, unit, label) for part in given)
        else:
            values[key] = quantity_to_si(given, unit, label)
            wrong = key not in SIGNED and not values[key] > 0.0
            refuse(wrong, f"{label} is {values[key]} {unit}; it must be positive")
    if "span" in values:
        values["half_span"] = 0.5 * values.pop("span")
    values.setdefault("aspect_ratio", (2.0 * values["half_span"]) ** 2 / values["wing_area"])
    return Aircraft(**{key: values[key] for key in AIRCRAFT_UNITS if key in values})


def refuse_no_body(aircraft: Aircraft, where: str) -> None:
    """Refuse moments of inertia that no mass distribution has: each principal one is at most the sum of the others.
    Source: Goldstein, *Classical Mechanics*, 2nd ed. 1980, ch. 5."""
    given = {name: float(getattr(aircraft, name)) for name in ("Ix", "Iy", "Iz", "Ixy", "Ixz", "Iyz")}
    Ix, Iy, Iz, Ixy, Ixz, Iyz = given.values()
    principal = np.linalg.eigvalsh([[Ix, -Ixy, -Ixz], [-Ixy, Iy, -Iyz], [-Ixz, -Iyz, Iz]])
    stated = ", ".join(f"{name} {value:g}" for name, value in given.items() if value)
    refuse(
        not (principal[0] > 0.0 and principal[2] <= (1.0 + ROUNDED) * (principal[0] + principal[1])),
        f"card {where}: [aircraft] no body has these moments of inertia ({stated} kg m^2): the principal ones are "
        f"{', '.join(f'{x:.4g}' for x in principal)}, all must be positive and the largest at most the sum of the "
        "other two; correct them",
    )


# --- What a card says of channels: where they stand in a file, constants, sums, and what is formed from others.

MOST_COLUMNS = 2000
ATMOSPHERE = "standard atmosphere"
RULES: dict[str, dict[str, tuple[str, ...]]] = {
    "density": {
        "gas law": ("static_pressure", "static_temperature"),
        "dynamic pressure": ("dynamic_pressure", "airspeed"),
        ATMOSPHERE: ("altitude",),
    },
    "mach": {"static temperature": ("static_temperature", "airspeed"), ATMOSPHERE: ("altitude", "airspeed")},
}
"""Ways to form a channel, the nearest to the air of the day first, and the channels that each needs."""


def parse_channel(key: str, given: Any, where: str) -> Channel:
    """One entry of [channels]."""
    here = f"card {where}: channel {key}"
    refuse(not isinstance(given, dict), f'{here} must be a table, e.g. {{ column = 13, unit = "deg" }}')
    known_keys(given, ("column", "label", "unit", "required", "sign"), where, f"key of channel {key}")
    refuse("unit" not in given, f"{here} has no unit; state the unit that the file is in")
    column, label, sign = given.get("column"), given.get("label"), given.get("sign", 1)
    whole = isinstance(column, int) and not isinstance(column, bool) and column >= 1
    refuse(column is not None and not whole, f"{here} has column {column!r}; columns are counted from 1")
    refuse((column or 0) > MOST_COLUMNS, f"{here} has column {column}; no file has more than {MOST_COLUMNS}")
    nowhere = column is None and "label" not in given
    refuse(nowhere, f"{here} has neither column nor label; say where it stands in a file")
    odd = isinstance(sign, bool) or sign not in (1, -1)
    refuse(odd, f"{here} has sign {sign!r}; write -1 if the file counts the other way")
    label, required = None if label is None else str(label), bool(given.get("required", True))
    return Channel(key, str(given["unit"]), label, column, required, int(sign))


def parse_quantity(key: str, value: Any, label: str, where: str) -> float:
    """A quantity in the SI unit of a channel that the program knows."""
    refuse(key not in STANDARD_CHANNELS, f"card {where}: [{label}] {key} is not a channel of the program")
    return quantity_to_si(value, STANDARD_CHANNELS[key].unit, f"card {where}: [{label}] {key}")


def parse_constants(table: Mapping[str, Any], channels: Mapping[str, Channel], where: str) -> dict[str, float]:
    """Values of channels that the file may lack; what every file must hold has no constant."""
    constants = {key: parse_quantity(key, value, "constants", where) for key, value in table.items()}
    refuse("time" in constants, f"card {where}: [constants] time cannot be constant; map it under [channels]")
    for key, value in constants.items():
        twice = key in channels and channels[key].required
        refuse(
            twice, f"card {where}: {key} is a required channel and in [constants]; drop one, or set required = false"
        )
        low, high = STANDARD_CHANNELS[key].plausible
        odd = f"card {where}: [constants] {key} is {table[key]!r}, beyond any flight; check its unit"
        refuse(not low <= value <= high, odd)
    return constants


def parse_derived(table: Mapping[str, Any], channels: Mapping[str, Channel], where: str) -> dict[str, str]:
    """Channels that a file may lack, each by the rule that forms it from others."""
    known_keys(table, tuple(RULES), where, "key of [derived]")
    for key, value in table.items():
        here, rules = f"{where}: [derived] {key}", " or ".join(repr(rule) for rule in RULES[key])
        refuse(value not in [*RULES[key]], f"card {here} is {str(value)[:60]!r}; write {rules}")
        all_mapped(RULES[key][value], channels, f"{here} needs")
    return dict(table)


def parse_sums(table: Mapping[str, Any], names: Collection[str], where: str) -> dict[str, dict[str, float]]:
    """[sums]: channels that are sums of others, each part with its factor; `names` are all that the card states."""
    sums = {}
    for key, given in table.items():
        here = f"{where}: [sums] {key}"
        some = isinstance(given, list | dict) and given
        refuse(not some, f"card {here} must be a list of channel names, or a table with factors")
        refuse(not all(isinstance(part, str) for part in given), f"card {here} must hold names of channels")
        counted = {part: given.count(part) for part in given} if isinstance(given, list) else given
        sums[key] = numbers(counted, here)
        all_mapped(sums[key], names, f"{here} uses")
    return sums


# --- The sections [envelope] and [fly]: what a fit to trajectories compares, and where its manoeuvres begin.


def parse_envelope(table: Mapping[str, Any], where: str) -> Envelope:
    """[envelope] of a card: [least, greatest] of each quantity, with units; of `altitude_loss` the greatest alone."""
    known_keys(table, (*UNITS, "programmed_inputs"), where, "quantity of [envelope]")
    ranges, programmed = dict(DEFAULT_RANGES), table.get("programmed_inputs", False)
    here = f"card {where}: [envelope]"
    refuse(not isinstance(programmed, bool), f"{here} programmed_inputs is {programmed!r}; write true or false")
    stated = {key: given for key, given in table.items() if key in UNITS}
    for key, given in stated.items():
        label = f"{here} {key}"
        if key == "altitude_loss":
            ranges[key] = (-np.inf, quantity_to_si(given, UNITS[key], label))
            continue
        pair = isinstance(given, list) and len(given) == 2
        refuse(not pair, f'{label} is {given!r}; write the least and the greatest value, e.g. ["-5 deg", "15 deg"]')
        lower, upper = (quantity_to_si(limit, UNITS[key], label) for limit in given)
        refuse(not lower < upper, f"{label} is {given!r}; the first value must be less than the second")
        ranges[key] = (lower, upper)
    return Envelope(ranges, tuple(stated), programmed)


HOLDABLE = ("airspeed", "alpha", "beta", "p", "q", "r", "phi", "theta", "psi", "altitude")
"""States that a simulation may take from the record."""


@dataclass(frozen=True)
class FlyCard:
    """Outputs to compare (None: all), the fixed initial state, SI, and states that are `held` to the record."""

    outputs: tuple[str, ...] | None = None
    initial_state: Mapping[str, float] = field(default_factory=dict)
    held: tuple[str, ...] = ()


def parse_fly(table: Mapping[str, Any], channels: Mapping[str, Channel], where: str) -> FlyCard:
    """Check [fly]; that its names are outputs and states is checked when a record is flown."""
    here = f"card {where}: [fly]"
    known_keys(table, ("outputs", "initial_state", "held"), where, "key of [fly]")
    outputs, held, given = table.get("outputs"), table.get("held", []), table.get("initial_state", {})
    if outputs is not None:
        outputs = tuple(
            dict.fromkeys(strings(outputs, f'{here} outputs must be a list of channels, e.g. ["alpha", "q"]'))
        )
    states = isinstance(held, list) and all(x in HOLDABLE for x in held)
    refuse(not states, f"{here} held must be a list of states, of {', '.join(HOLDABLE)}")
    example = '{ alpha = "2 deg", q = "0 deg/s" }'
    refuse(not isinstance(given, dict), f"{here} initial_state must be a table, e.g. {example}")
    all_mapped(given, channels, f"{where}: [fly] initial_state has")
    initial = {key: quantity_to_si(x, channels[key].si, f"{here} initial_state {key}") for key, x in given.items()}
    return FlyCard(outputs, initial, tuple(dict.fromkeys(held)))


# --- The section [linear] of a card: a state-space model in dimensional derivatives.
# Every row is a table {parameter = what it multiplies}: a channel, "1" for the constant, or a table of channels with
# numbers, `Lda = { aileron_left = 0.5, aileron_right = -0.5 }`. Nothing is parsed but names and numbers.

ONE = "1"  # stands for the constant among the channels


class LinearTerm(NamedTuple):
    """parameter x factor x channel, in SI and radians."""

    parameter: str
    channel: str
    factor: float = 1.0


@dataclass(frozen=True)
class LinearCard:
    """Rows of a linear system: the rate of each state, and outputs; that of a state is what the record shows beyond it.
    `delays`: the parameter, s, by which an output is recorded late. `by_manoeuvre`: constants that differ between
    manoeuvres."""

    states: tuple[str, ...]
    rates: tuple[tuple[LinearTerm, ...], ...]
    outputs: tuple[str, ...] = ()
    readings: tuple[tuple[LinearTerm, ...], ...] = ()
    fixed: tuple[tuple[str, float], ...] = ()
    delays: tuple[tuple[str, str], ...] = ()
    by_manoeuvre: tuple[str, ...] = ()

    @property
    def rows(self) -> tuple[tuple[str, tuple[LinearTerm, ...]], ...]:
        """Name and terms of every row, rates first."""
        return (*zip(self.states, self.rates, strict=True), *zip(self.outputs, self.readings, strict=True))

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of all parameters, in the order in which the card first writes them."""
        of_rows = (term.parameter for _, row in self.rows for term in row)
        return tuple(dict.fromkeys([*of_rows, *(parameter for _, parameter in self.delays)]))

    @property
    def inputs(self) -> tuple[str, ...]:
        """Channels that it needs beside its states."""
        channels = dict.fromkeys(term.channel for _, row in self.rows for term in row)
        return tuple(name for name in channels if name != ONE and name not in self.states)


def parse_linear(table: Any, channels: Collection[str], where: str) -> LinearCard:
    """Check [linear]; `channels` are those that the card maps, sums or holds constant."""
    here = f"card {where}: [linear"
    refuse(not isinstance(table, dict), f"card {where}: linear must be a section, [linear]")
    known_keys(table, ("states", "rates", "outputs", "fixed", "delays", "by_manoeuvre"), where, "key of [linear]")
    states = strings(table.get("states"), f'{here}] states must be a list of channels, e.g. ["alpha", "q"]')
    refuse(len(set(states)) < len(states), f"{here}] states names a state twice")
    all_mapped(states, channels, f"{where}: [linear] states uses")
    rates, outputs, delays = (section(table, key, where) for key in ("rates", "outputs", "delays"))
    known_keys(rates, states, where, "state of [linear.rates]")
    for name in states:
        refuse(name not in rates, f"{here}.rates.{name}] is missing; every state needs its rate")
    all_mapped(outputs, channels, f"{where}: [linear.outputs] uses")
    card = LinearCard(
        states=states,
        rates=tuple(_row(rates[name], channels, f"{where}: [linear.rates.{name}]") for name in states),
        outputs=tuple(outputs),
        readings=tuple(_row(row, channels, f"{where}: [linear.outputs.{name}]") for name, row in outputs.items()),
        fixed=tuple(numbers(table.get("fixed", {}), f"{where}: [linear] fixed").items()),
        delays=tuple(delays.items()),
        by_manoeuvre=strings(
            table.get("by_manoeuvre", []),
            f'{here}] by_manoeuvre must be a list of constants, e.g. ["L0", "N0"]',
            empty=True,
        ),
    )
    multiplied: dict[str, set[str]] = {}  # by each parameter of a row
    for _, row in card.rows:
        for term in row:
            multiplied.setdefault(term.parameter, set()).add(term.channel)
    for name, row in zip(card.outputs, card.readings, strict=True):
        refuse(
            name in states and any(term.channel != ONE for term in row),
            f'{here}.outputs.{name}] is a state, which is an output already; it may only have a bias, by = "1"',
        )
    known_keys(delays, (*card.states, *card.outputs), where, "output of [linear.delays]")
    for output, parameter in delays.items():
        own = isinstance(parameter, str) and parameter not in multiplied
        refuse(not own, f"{here}.delays] {output} must be the name of a parameter of no row")
    for name in card.by_manoeuvre:
        refuse(
            multiplied.get(name) != {ONE},
            f'{here}] by_manoeuvre has {name}, which is no constant; only parameters of "1" can differ between '
            "manoeuvres",
        )
        refuse(name in dict(card.fixed), f"{here}] {name} is fixed and differs between manoeuvres; drop one of the two")
    for name, _ in card.fixed:
        lost = name not in card.parameters
        refuse(lost, f"{here}.fixed] {name} is a parameter of no row; drop it or correct its name")
    return replace(card, by_manoeuvre=tuple(dict.fromkeys(card.by_manoeuvre)))


def _row(table: Any, channels: Collection[str], where: str) -> tuple[LinearTerm, ...]:
    some = isinstance(table, dict) and table
    refuse(not some, f'card {where} must be a table of parameters and what they multiply, e.g. Zalpha = "alpha"')
    terms = []
    for parameter, given in table.items():
        here, multiplied = f"{where} {parameter}", {given: 1.0} if isinstance(given, str) else given
        some = isinstance(multiplied, dict) and multiplied
        refuse(
            not some, f'card {here} is {given!r}; write the channel it multiplies, e.g. "alpha", or "1" for a constant'
        )
        terms += [LinearTerm(parameter, channel, factor) for channel, factor in numbers(multiplied, here).items()]
    all_mapped([term.channel for term in terms if term.channel != ONE], channels, f"{where} uses")
    return tuple(terms)
