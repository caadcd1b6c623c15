"""The card: one TOML file per aircraft with channels, constants, active effects, priors and sensor noise.

What reads a section says what is wrong in it, e.g. "[aircraft] has no mass"; `parse_card` puts the card's name before.
"""

from __future__ import annotations

import hashlib
import re
import tomllib
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from difflib import get_close_matches
from itertools import combinations
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from bayes_aero.errors import InputError
from bayes_aero.flight.channel import STANDARD_CHANNELS, Channel
from bayes_aero.flight.record import TOLERANCES, Tolerance, is_file, segment_of
from bayes_aero.parameter import Prior
from bayes_aero.physics.aircraft import (
    AIRCRAFT_KEYS,
    AIRCRAFT_UNITS,
    DEFAULT_RANGES,
    NO_AIRCRAFT,
    OPTIONAL,
    UNITS,
    Aircraft,
    Axis,
    Envelope,
)
from bayes_aero.units import from_si, instant, quantity_to_si, si_unit, to_si

# --- TOML files that people write, cards and studies: read with bounds on what a hostile one can ask for.

MOST_BYTES = 1 << 18  # a card has some 5 kB, a study that lists 3000 records 200
MOST_DEPTH, MOST_NAME, LARGEST = 12, 200, 2**63
MOST_DOTS = 12
# tomllib's time grows with the square of the parts of a dotted key. A part is matched from its beginning only.
_PART = r"""(?:(?<![\w-])[\w-]+|"[^"\n]{0,200}"|'[^'\n]{0,200}')[ \t]*\.[ \t]*"""
_DOTTED = re.compile(f"(?:{_PART}){{{MOST_DOTS + 1}}}")


def read_table(path: Path, what: str) -> tuple[bytes, dict[str, Any]]:
    """The file's bytes and its table; `what` ("card", "study") begins the sentence where it cannot be had."""
    where = f"{what} {path}"
    if not is_file(path):
        raise InputError(f"{where}: it is no file; check the path")
    try:
        with path.open("rb") as handle:
            raw = handle.read(MOST_BYTES + 1)
    except OSError as error:
        reason = error.strerror or error
        raise InputError(f"{where}: cannot be read ({reason}); check the path and its permissions") from None
    return raw, parse_table(raw, where, what)


def parse_table(raw: bytes, where: str, what: str = "card") -> dict[str, Any]:
    """The table that a file's bytes are; `where` begins the sentence if they are none."""
    if len(raw) > MOST_BYTES:
        raise InputError(f"{where}: it has more than {MOST_BYTES} bytes; is it a {what} at all?")
    try:
        text = raw.decode("utf-8")
        for number, line in enumerate(text.split("\n"), 1):
            if line.count(".") > MOST_DOTS and _DOTTED.search(line):
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
        for key in value if isinstance(value, dict) else ():
            if len(key) > MOST_NAME or not key.isprintable():
                raise InputError(f"{where}: {key[:40]!r} is no name for an entry; mend it")
        if isinstance(value, dict | list) and depth > MOST_DEPTH:
            raise InputError(f"{where}: it is nested deeper than {MOST_DEPTH}; mend it")
        if isinstance(value, int) and not -LARGEST <= value < LARGEST:
            raise InputError(f"{where}: a whole number has more than 18 digits; correct it")
        inner = value.values() if isinstance(value, dict) else value if isinstance(value, list) else ()
        left += [(part, depth + 1) for part in inner]
    return table


# --- Checks that every section of a card needs.

UNFILLED = "TODO"  # stands on a starter card where the user has something to fill in


def _refuse(wrong: object, sentence: str) -> None:
    if wrong:
        raise InputError(sentence)


def _section(table: Mapping[str, Any], key: str) -> Mapping[str, Any]:
    value = table.get(key, {})
    _refuse(not isinstance(value, dict), f"{key} must be a section, [{key}]")
    return value


def known_keys(table: Mapping[str, Any], keys: Collection[str], what: str, where: str = "") -> None:
    """Refuse a key that is not among `keys`; `what` says what kind of key it is, `where` begins the sentence."""
    for key in table:
        if key not in keys:
            close = get_close_matches(key, keys, n=1)
            hint = f"did you mean {close[0]!r}?" if close else f"known are {', '.join(keys)}"
            raise InputError(f"{where}unknown {what} {key[:60]!r}; {hint}")


def _entry(given: Any, keys: Sequence[str], needs: int, here: str, example: str = "") -> Mapping[str, Any]:
    """A table of these keys, of which it must have the first so many."""
    _refuse(not isinstance(given, dict), f"{here} must be a table with {', '.join(keys)}{example}")
    known_keys(given, keys, f"key of {here}")
    for key in keys[:needs]:
        _refuse(key not in given, f"{here} has no {key}{example or '; add it'}")
    return given


def _all_mapped(names: Iterable[str], channels: Collection[str], what: str) -> None:
    """Refuse names that are no channels of the card, with a hint at the nearest; `what` begins the sentence."""
    for name in names:
        if name not in channels:
            close = get_close_matches(name, list(channels), n=1)
            hint = f"; is {close[0]!r} there meant?" if close else ""
            raise InputError(f"{what} {name}, which [channels] does not map{hint}")


def _refuse_unfilled(table: Mapping[str, Any]) -> None:
    """Name every entry of a starter card that is still to be filled in."""
    left = []
    for name, entries in table.items():
        for key, value in entries.items() if isinstance(entries, dict) else ():
            for part, given in value.items() if isinstance(value, dict) else [("", value)]:
                if any(str(x).startswith(UNFILLED) for x in (given if isinstance(given, list) else [given])):
                    left.append(f"[{name}] {key} {part}".strip())
    listed = ", ".join(f"{entry} is still {UNFILLED}" for entry in left)
    _refuse(left, f"{listed}; fill in what is missing, as the comment beside it says")


def _strings(value: Any, sentence: str, *, empty: bool = False) -> tuple[str, ...]:
    """A list of names, not `empty` unless it may be; else `sentence` is raised."""
    listed = isinstance(value, list) and (value or empty) and all(isinstance(name, str) for name in value)
    _refuse(not listed, sentence)
    return tuple(value)


def _number(value: Any, where: str) -> float:
    plain = isinstance(value, int | float) and not isinstance(value, bool)
    _refuse(not plain, f"{where}: {str(value)[:60]!r} is not a number")
    return float(value)


def _numbers(table: Any, where: str) -> dict[str, float]:
    _refuse(not isinstance(table, dict), f"{where} must be a table of numbers")
    return {key: _number(value, f"{where} {key}") for key, value in table.items()}


# --- The section [aircraft].

POSITIONS = ("reference_point", "accelerometer", "engine")
SIGNED = ("Ixz", "Ixy", "Iyz", "engine_inclination", "engine_arm", *POSITIONS)


def parse_aircraft(table: Mapping[str, Any]) -> Aircraft:
    """Constants in SI; the aspect ratio is span squared over wing area where it is not stated."""
    known_keys(table, AIRCRAFT_KEYS, "key of [aircraft]")
    spans = f"span ({table.get('span')}) and half_span ({table.get('half_span')})"
    _refuse("span" in table and "half_span" in table, f"[aircraft] has {spans}; keep one of them")
    values: dict[str, Any] = {}
    for key, unit in AIRCRAFT_KEYS.items():
        given, label = table.get(key), f"[aircraft] {key}"
        if given is None:
            other = f', or span = "... {unit}"' if key == "half_span" else ""
            needed = key not in OPTIONAL and key != "span" and (key != "half_span" or "span" not in table)
            _refuse(needed, f'[aircraft] has no {key}; add it with its unit, e.g. {key} = "... {unit}"{other}')
        elif key in POSITIONS:
            vector = isinstance(given, list) and len(given) == 3
            _refuse(not vector, f"{label} must be three lengths, [x, y, z]")
            values[key] = tuple(quantity_to_si(part, unit, label) for part in given)
        else:
            values[key] = quantity_to_si(given, unit, label)
            wrong = key not in SIGNED and not values[key] > 0.0
            _refuse(wrong, f"{label} is {values[key]} {unit}; it must be positive")
    if "span" in values:
        values["half_span"] = 0.5 * values.pop("span")
    values.setdefault("aspect_ratio", (2.0 * values["half_span"]) ** 2 / values["wing_area"])
    return Aircraft(**{key: values[key] for key in AIRCRAFT_UNITS if key in values})


def refuse_no_body(aircraft: Aircraft) -> None:
    """Refuse moments of inertia that no mass distribution has: each principal one is at most the sum of the others,
    which are given to two or three digits. Source: Goldstein, *Classical Mechanics*, 2nd ed. 1980, ch. 5."""
    given = {name: float(getattr(aircraft, name)) for name in ("Ix", "Iy", "Iz", "Ixy", "Ixz", "Iyz")}
    Ix, Iy, Iz, Ixy, Ixz, Iyz = given.values()
    principal = np.linalg.eigvalsh([[Ix, -Ixy, -Ixz], [-Ixy, Iy, -Iyz], [-Ixz, -Iyz, Iz]])
    stated = ", ".join(f"{name} {value:g}" for name, value in given.items() if value)
    _refuse(
        not (principal[0] > 0.0 and principal[2] <= 1.02 * (principal[0] + principal[1])),
        f"[aircraft] no body has these moments of inertia ({stated} kg m^2): the principal ones are "
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


def _parse_channel(key: str, given: Any) -> Channel:
    here = f"channel {key}"
    keys = ("unit", "column", "label", "required", "sign")
    given = _entry(given, keys, 1, here, ', e.g. { column = 13, unit = "deg" }, the unit that the file is in')
    column, label, sign = given.get("column"), given.get("label"), given.get("sign", 1)
    whole = isinstance(column, int) and not isinstance(column, bool) and 1 <= column <= MOST_COLUMNS
    counted = f"columns are counted from 1, and no file has more than {MOST_COLUMNS}"
    _refuse(column is not None and not whole, f"{here} has column {column!r}; {counted}")
    nowhere = column is None and "label" not in given
    _refuse(nowhere, f"{here} has neither column nor label; say where it stands in a file")
    odd = isinstance(sign, bool) or sign not in (1, -1)
    _refuse(odd, f"{here} has sign {sign!r}; write -1 if the file counts the other way")
    label = None if label is None else str(label)
    return Channel(key, str(given["unit"]), label, column, bool(given.get("required", True)), int(sign))


def _parse_channels(table: Mapping[str, Any]) -> dict[str, Any]:
    """The sections that say where channels come from, by their fields of `Card`; no channel may be in two of them."""
    mapped = {key: _parse_channel(key, value) for key, value in _section(table, "channels").items()}
    given = _section(table, "constants")
    constants = _quantities(given, "constants")
    for key, value in constants.items():
        _refuse(key == "time", "[constants] time cannot be constant; map it under [channels]")
        twice = key in mapped and mapped[key].required
        _refuse(twice, f"{key} is a required channel and in [constants]; drop one, or set required = false")
        low, high = STANDARD_CHANNELS[key].plausible
        _refuse(not low <= value <= high, f"[constants] {key} is {given[key]!r}, beyond any flight; check its unit")
    derived = dict(_section(table, "derived"))
    known_keys(derived, RULES, "key of [derived]")
    for key, value in derived.items():
        rules = " or ".join(repr(rule) for rule in RULES[key])
        _refuse(value not in [*RULES[key]], f"[derived] {key} is {str(value)[:60]!r}; write {rules}")
        _all_mapped(RULES[key][value], mapped, f"[derived] {key} needs")
    looked_up, formed = _section(table, "tables"), {**constants, **derived}
    tables = {name: _parse_lookup(name, entry, mapped, formed) for name, entry in looked_up.items()}
    names, sums = {*mapped, *constants, *derived, *tables}, dict[str, dict[str, float]]()
    for key, given in _section(table, "sums").items():  # each part with its factor
        here, some = f"[sums] {key}", isinstance(given, list | dict) and given
        _refuse(not some, f"{here} must be a list of channel names, or a table with factors")
        _refuse(not all(isinstance(part, str) for part in given), f"{here} must hold names of channels")
        sums[key] = _numbers({part: given.count(part) for part in given} if isinstance(given, list) else given, here)
        _all_mapped(sums[key], names, f"{here} uses")
    sections = {"sums": sums, "constants": constants, "derived": derived, "tables": tables}
    for (section, entries), (other, others) in combinations(sections.items(), 2):
        for key in set(entries) & set(others):
            raise InputError(f"{key} is both in [{section}] and in [{other}]; keep one of them")
    return {"channels": tuple(mapped.values()), **sections}


# --- Tables on the card: a channel that a file lacks, such as thrust, read off over channels that it has, such as N1.

MOST_AXES, MOST_VALUES = 3, 10_000
_EXAMPLE = 'e.g. from = { n1_left = { unit = "%", points = [30, 60, 100] } }'


@dataclass(frozen=True)
class TableAxis:
    """A channel that a table is entered with: its unit on the card, its points in SI, increasing."""

    channel: str
    unit: str
    si: str
    points: tuple[float, ...]

    def shown(self, *values: float) -> str:
        """Values in the unit of the card: "30 to 100 %"."""
        filed = (float(from_si(value, self.unit, self.channel, self.si)) for value in values)
        return f"{' to '.join(f'{x:.6g}' for x in filed)} {self.unit}".removesuffix(" 1")

    @property
    def range(self) -> str:
        """From where to where the table goes."""
        return self.shown(self.points[0], self.points[-1])


@dataclass(frozen=True)
class LookupTable:
    """A table: `values` in `si`, one dimension for each axis; linear between the points, refused beyond them."""

    channel: str
    si: str
    axes: tuple[TableAxis, ...]
    values: tuple[Any, ...]

    @property
    def said(self) -> str:
        """What it is entered with and how far it goes."""
        return ", ".join(f"{axis.channel} ({axis.range})" for axis in self.axes)

    def of(self, channels: Mapping[str, np.ndarray], record: str, time: np.ndarray) -> Float[np.ndarray, " n"] | None:
        """The channel, (n,) in SI; None where the record lacks what the table is entered with."""
        if any(axis.channel not in channels for axis in self.axes):
            return None
        entries = []
        for axis in self.axes:
            x, low, high = channels[axis.channel], axis.points[0], axis.points[-1]
            slack = 1e-9 * (high - low)  # for the rounding of a conversion
            outside = ~((x >= low - slack) & (x <= high + slack))
            if outside.any():
                i = int(np.argmax(outside))
                raise InputError(
                    f"record {record}: {axis.channel} is {axis.shown(x[i])} at sample {i} (counted from 0; t = "
                    f"{instant(time[i])} s), outside the card's table of {self.channel}, which goes from {axis.range}, "
                    f"{int(outside.sum())} of {len(x)} samples in all; extend [tables.{self.channel}], or cut the "
                    "record"
                )
            entries.append(np.clip(x, low, high))
        from scipy.interpolate import RegularGridInterpolator  # half a second, which most cards do not need

        table = RegularGridInterpolator([axis.points for axis in self.axes], np.array(self.values), method="linear")
        return table(np.stack(entries, axis=-1))


def _parse_lookup(name: str, given: Any, channels: Mapping[str, Channel], formed: Mapping[str, Any]) -> LookupTable:
    """[tables.NAME]; `formed` are channels that the card states otherwise, by [constants] or [derived]."""
    here = f"[tables.{name}]"
    given = _entry(given, ("unit", "from", "values"), 3, here, f", {_EXAMPLE}")
    twice = name in formed or (name in channels and channels[name].required)
    _refuse(twice, f"{here}: the card states {name} elsewhere, too; keep one of them")
    entered = isinstance(given["from"], dict) and 1 <= len(given["from"]) <= MOST_AXES
    _refuse(not entered, f"{here} from must name one to {MOST_AXES} channels, {_EXAMPLE}")
    axes = []
    for key, given_axis in given["from"].items():
        label = f"{here} from {key}"
        entry = _entry(given_axis, ("unit", "points"), 2, label, f", {_EXAMPLE}")
        _all_mapped([key], {*channels, *formed}, f"{here} from has")
        si = channels[key].si if key in channels else STANDARD_CHANNELS[key].unit
        points = to_si(_grid(entry["points"], f"{label}: points"), str(entry["unit"]), key, si)
        increase = points.ndim == 1 and len(points) >= 2 and (np.diff(points) > 0.0).all()
        _refuse(not increase, f"{label}: points must be two numbers or more, and increase")
        axes.append(TableAxis(key, str(entry["unit"]), si, tuple(points.tolist())))
    values, shape = _grid(given["values"], f"{here} values"), tuple(len(axis.points) for axis in axes)
    per = "; ".join(f"{len(axis.points)} points of {axis.channel}" for axis in axes)
    wanted = f"{' lists of '.join(map(str, shape))} numbers ({per}), the first channel outermost"
    _refuse(values.shape != shape, f"{here} values must be {wanted}")
    unit, standard = str(given["unit"]), STANDARD_CHANNELS.get(name)
    si = standard.unit if standard else si_unit(unit, here)

    def nested(values: np.ndarray) -> Any:
        return tuple(map(nested, values)) if values.ndim else float(values)

    return LookupTable(name, si, tuple(axes), nested(to_si(values, unit, name, si)))


def _grid(given: Any, what: str) -> np.ndarray:
    try:
        values = np.array(given, dtype=object)
        if values.size > MOST_VALUES or any(isinstance(x, bool) or not isinstance(x, int | float) for x in values.flat):
            raise ValueError
        values = values.astype(np.float64)
    except (TypeError, ValueError, OverflowError):
        raise InputError(f"{what} must be a list of plain numbers, {MOST_VALUES} at most") from None
    _refuse(not np.isfinite(values).all(), f"{what} must be finite numbers")
    return values


# --- The sections [envelope] and [fly]: what a fit to trajectories compares, and where its manoeuvres begin.


def parse_envelope(table: Mapping[str, Any]) -> Envelope:
    """[envelope] of a card: [least, greatest] of each quantity, with units; of `altitude_loss` the greatest alone."""
    known_keys(table, (*UNITS, "programmed_inputs"), "quantity of [envelope]")
    ranges, programmed = dict(DEFAULT_RANGES), table.get("programmed_inputs", False)
    _refuse(not isinstance(programmed, bool), f"[envelope] programmed_inputs is {programmed!r}; write true or false")
    stated = {key: given for key, given in table.items() if key in UNITS}
    for key, given in stated.items():
        label = f"[envelope] {key}"
        if key == "altitude_loss":
            ranges[key] = (-np.inf, quantity_to_si(given, UNITS[key], label))
            continue
        pair = isinstance(given, list) and len(given) == 2
        _refuse(not pair, f'{label} is {given!r}; write the least and the greatest value, e.g. ["-5 deg", "15 deg"]')
        lower, upper = (quantity_to_si(limit, UNITS[key], label) for limit in given)
        _refuse(not lower < upper, f"{label} is {given!r}; the first value must be less than the second")
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


def _parse_fly(table: Mapping[str, Any], channels: Mapping[str, Channel]) -> FlyCard:
    """Check [fly]; that its names are outputs and states is checked when a record is flown."""
    known_keys(table, ("outputs", "initial_state", "held"), "key of [fly]")
    outputs, held, given = table.get("outputs"), table.get("held", []), table.get("initial_state", {})
    if outputs is not None:
        listed = _strings(outputs, '[fly] outputs must be a list of channels, e.g. ["alpha", "q"]')
        outputs = tuple(dict.fromkeys(listed))
    states = isinstance(held, list) and all(x in HOLDABLE for x in held)
    _refuse(not states, f"[fly] held must be a list of states, of {', '.join(HOLDABLE)}")
    example = '{ alpha = "2 deg", q = "0 deg/s" }'
    _refuse(not isinstance(given, dict), f"[fly] initial_state must be a table, e.g. {example}")
    _all_mapped(given, channels, "[fly] initial_state has")
    initial = {key: quantity_to_si(x, channels[key].si, f"[fly] initial_state {key}") for key, x in given.items()}
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


def _parse_linear(table: Mapping[str, Any], channels: Collection[str]) -> LinearCard:
    """Check [linear]; `channels` are those that the card maps, sums or holds constant."""
    known_keys(table, ("states", "rates", "outputs", "fixed", "delays", "by_manoeuvre"), "key of [linear]")
    states = _strings(table.get("states"), '[linear] states must be a list of channels, e.g. ["alpha", "q"]')
    _refuse(len(set(states)) < len(states), "[linear] states names a state twice")
    _all_mapped(states, channels, "[linear] states uses")
    rates, outputs, delays = (_section(table, key) for key in ("rates", "outputs", "delays"))
    known_keys(rates, states, "state of [linear.rates]")
    for name in states:
        _refuse(name not in rates, f"[linear.rates.{name}] is missing; every state needs its rate")
    _all_mapped(outputs, channels, "[linear.outputs] uses")
    example = '[linear] by_manoeuvre must be a list of constants, e.g. ["L0", "N0"]'
    card = LinearCard(
        states=states,
        rates=tuple(_row(rates[name], channels, f"[linear.rates.{name}]") for name in states),
        outputs=tuple(outputs),
        readings=tuple(_row(row, channels, f"[linear.outputs.{name}]") for name, row in outputs.items()),
        fixed=tuple(_numbers(table.get("fixed", {}), "[linear] fixed").items()),
        delays=tuple(delays.items()),
        by_manoeuvre=tuple(dict.fromkeys(_strings(table.get("by_manoeuvre", []), example, empty=True))),
    )
    multiplied: dict[str, set[str]] = {}  # by each parameter of a row
    for term in (term for _, row in card.rows for term in row):
        multiplied.setdefault(term.parameter, set()).add(term.channel)
    for name, row in zip(card.outputs, card.readings, strict=True):
        beyond = name in states and any(term.channel != ONE for term in row)
        _refuse(beyond, f'[linear.outputs.{name}] is a state, an output already; it may only have a bias, by = "1"')
    known_keys(delays, (*card.states, *card.outputs), "output of [linear.delays]")
    for output, parameter in delays.items():
        unused = isinstance(parameter, str) and parameter not in multiplied
        _refuse(not unused, f"[linear.delays] {output} must be the name of a parameter of no row")
    for name in card.by_manoeuvre:
        constant = multiplied.get(name) == {ONE}
        _refuse(not constant, f'[linear] by_manoeuvre has {name}, which is no constant: no parameter of "1" alone')
        _refuse(name in dict(card.fixed), f"[linear] {name} is fixed and differs between manoeuvres; drop one")
    for name, _ in card.fixed:
        lost = name not in card.parameters
        _refuse(lost, f"[linear.fixed] {name} is a parameter of no row; drop it or correct its name")
    return card


def _row(table: Any, channels: Collection[str], here: str) -> tuple[LinearTerm, ...]:
    some = isinstance(table, dict) and table
    _refuse(not some, f'{here} must be a table of parameters and what they multiply, e.g. Zalpha = "alpha"')
    terms = []
    for parameter, given in table.items():
        multiplied, label = {given: 1.0} if isinstance(given, str) else given, f"{here} {parameter}"
        some = isinstance(multiplied, dict) and multiplied
        _refuse(not some, f'{label} is {given!r}; write the channel it multiplies, e.g. "alpha", or "1" for a constant')
        terms += [LinearTerm(parameter, channel, factor) for channel, factor in _numbers(multiplied, label).items()]
    _all_mapped([term.channel for term in terms if term.channel != ONE], channels, f"{here} uses")
    return tuple(terms)


# --- The card.

SECTIONS = (
    "title", "source", "aircraft", "channels", "sums", "constants", "derived", "tables", "sensors", "model", "linear",
    "parameters", "gp", "tolerances", "output_biases", "segments", "fly", "envelope",
)  # fmt: skip
PARAMETER_KEYS = ("start", "bounds", "prior")
GP_INPUTS = ("alpha", "elevator", "q", "airspeed")


@dataclass(frozen=True)
class CardParameter:
    """What a card says of a parameter; None leaves the effect's own value."""

    start: float | None = None
    bounds: tuple[float, float] | None = None
    prior: Prior | None = None


@dataclass(frozen=True)
class Card:
    """One aircraft and its model, as read from a card; SI and radians.

    The model is either a list of `effects` or a `linear` system; the latter has no effects and needs no aircraft.
    """

    name: str
    title: str
    source: str
    sha256: str
    aircraft: Aircraft
    channels: tuple[Channel, ...]
    sums: Mapping[str, Mapping[str, float]]  # parts and their factors
    sensors: Mapping[str, float]
    effects: tuple[str, ...]
    effect_files: tuple[Path, ...]  # Python files with effects of the user's own
    fixed: Mapping[str, float]
    axes: tuple[Axis, ...] = (Axis.LONGITUDINAL,)
    changes: Mapping[str, CardParameter] = field(default_factory=dict)
    gp_inputs: tuple[str, ...] = GP_INPUTS
    constants: Mapping[str, float] = field(default_factory=dict)  # channels that a file may lack, SI
    derived: Mapping[str, str] = field(default_factory=dict)  # channels that a file may lack, and the rule of each
    tables: Mapping[str, LookupTable] = field(default_factory=dict)  # channels that a file may lack, read off tables
    linear: LinearCard | None = None
    tolerances: Mapping[str, Tolerance] = field(default_factory=lambda: dict(TOLERANCES))
    output_biases: Mapping[str, Prior] = field(default_factory=dict)  # of each manoeuvre's own, in fits of trajectories
    segments: Mapping[str, tuple[str, ...]] = field(default_factory=dict)  # parts of files by name: "12.5:40"
    fly: FlyCard = field(default_factory=FlyCard)
    envelope: Envelope = field(default_factory=Envelope)  # of proposed flight tests
    path: str = ""  # of the file, as it was given; empty for a shipped card


def shipped_cards() -> dict[str, Path]:
    """Cards that come with the package, by name."""
    here = Path(__file__).resolve().parents[1]
    for folder in (here / "models", here.parent / "models"):  # the wheel's place, then the source tree's
        if folder.is_dir():
            return {path.stem: path for path in sorted(folder.glob("*.toml"))}
    return {}


def read_card(name_or_path: str | Path) -> Card:
    """Read a card.

    Args:
        name_or_path: the name of a shipped card (`attas`), or the path of a .toml file. The name of a shipped card
            always means that card; a file of this name is `./attas`.

    Returns:
        The card, with quantities in SI and radians.

    Raises:
        InputError: there is no such card, or an entry is wrong.
    """
    cards = shipped_cards()
    path = cards.get(str(name_or_path), Path(name_or_path))
    if not is_file(path):
        raise InputError(f"no card {str(name_or_path)[:200]!r}: give a .toml file or one of {', '.join(cards)}")
    raw, table = read_table(path, "card")
    card = parse_card(table, path.stem, str(path), hashlib.sha256(raw).hexdigest())
    return card if str(name_or_path) in cards else replace(card, path=str(path))


def parse_card(table: Mapping[str, Any], name: str, where: str, sha256: str = "") -> Card:
    """Check a card's table and turn it into a `Card`; `where` is named in errors."""
    try:
        known_keys(table, SECTIONS, "section")
        _refuse_unfilled(table)
        for key in ("channels",) if "linear" in table else ("aircraft", "channels", "model"):
            lacks = not isinstance(table.get(key), dict)
            _refuse(lacks, f"section [{key}] is missing; see models/attas.toml for one")
        _refuse("linear" in table and "model" in table, "it has both [model] and [linear]; keep one of them")
        formed = _parse_channels(table)
        mapped = {channel.name: channel for channel in formed["channels"]}
        names = {*mapped, *(name for key, entries in formed.items() if key != "channels" for name in entries)}
        tolerances, biases = _section(table, "tolerances"), _section(table, "output_biases")
        bands, deviations = _of_outputs(tolerances, "tolerances"), _of_outputs(biases, "output_biases")
        stated, of_biases = (str(x.get("source", "the card, no source stated")) for x in (tolerances, biases))
        return Card(
            name=name,
            title=str(table.get("title", name)),
            source=str(table.get("source", "not stated")),
            sha256=sha256,
            sensors=_quantities(_section(table, "sensors"), "sensors"),
            tolerances={key: Tolerance(x, stated) for key, x in bands.items()} if tolerances else dict(TOLERANCES),
            envelope=parse_envelope(_section(table, "envelope")),
            output_biases={key: Prior("normal", 0.0, sd, of_biases, by_card=True) for key, sd in deviations.items()},
            segments={name: _parts(name, parts) for name, parts in _section(table, "segments").items()},
            fly=_parse_fly(_section(table, "fly"), mapped),
            **_parse_model(table, Path(where).parent, names),
            **formed,
        )
    except InputError as reason:
        raise InputError(f"card {where}: {reason}") from reason


def _parse_model(table: Mapping[str, Any], folder: Path, channels: Collection[str]) -> dict[str, Any]:
    """The sections that say what the model is, by their fields of `Card`; files are relative to the card's folder."""
    linear = _parse_linear(_section(table, "linear"), channels) if "linear" in table else None
    model, gp, files = _section(table, "model"), _section(table, "gp"), "[model] effect_files"
    effects = ()
    if not linear:
        known_keys(model, ("effects", "effect_files", "fixed", "axes"), "key of [model]")
        effects = _strings(model.get("effects"), "[model] effects must be a list of effect names")
    _refuse(len(set(effects)) < len(effects), "[model] effects names an effect twice")
    axes, possible = model.get("axes", [Axis.LONGITUDINAL.value]), [axis.value for axis in Axis]
    listed = isinstance(axes, list) and axes and all(x in possible for x in axes)
    _refuse(not listed, f"[model] axes must be a list of {' and '.join(possible)}")
    aircraft = parse_aircraft(_section(table, "aircraft")) if "aircraft" in table else NO_AIRCRAFT
    if Axis.LATERAL.value in axes:
        refuse_no_body(aircraft)
    changes = {key: _parse_parameter(key, value) for key, value in _section(table, "parameters").items()}
    if linear:
        known_keys(changes, linear.parameters, "parameter")
    known_keys(gp, ("inputs",), "key of [gp]")
    named = _strings(model.get("effect_files", []), f"{files} must be a list of paths of Python files", empty=True)
    for path in named:
        _refuse(not path.isprintable() or not path.strip(), f"{files} has {path!r}, which is no path of a Python file")
    try:
        effect_files = tuple((folder / path).resolve() for path in named)
    except OSError as error:
        raise InputError(f"{files} cannot be found ({error}); correct the path") from None
    return {
        "effects": effects, "effect_files": effect_files, "fixed": _numbers(model.get("fixed", {}), "[model] fixed"),
        "axes": tuple(axis for axis in Axis if axis in axes), "aircraft": aircraft, "linear": linear,
        "changes": changes,
        "gp_inputs": _strings(gp.get("inputs", [*GP_INPUTS]), "[gp] inputs must be a list of signal names"),
    }  # fmt: skip


def _parts(name: str, parts: Any) -> tuple[str, ...]:
    """The manoeuvres that a file of this name holds, each as "FROM:TO" in seconds of its time."""
    here = f"[segments] {name}"
    for part in _strings(parts, f'{here} must be a list of parts, e.g. ["12.5:40", "61:85"]'):
        example = 'FROM:TO in seconds of the file\'s time, e.g. "12.5:40", or "#2" for the second part between gaps'
        _refuse(segment_of(f"{name}@{part}").whole, f"{here} has {part!r}; write {example}")
    return tuple(parts)


def _quantities(table: Mapping[str, Any], name: str) -> dict[str, float]:
    """Quantities of channels that the program knows, SI; of sensors, none is negative."""
    quantities = {}
    for key, value in table.items():
        _refuse(key not in STANDARD_CHANNELS, f"[{name}] {key} is not a channel of the program")
        quantities[key] = quantity_to_si(value, STANDARD_CHANNELS[key].unit, f"[{name}] {key}")
        negative = name == "sensors" and not quantities[key] >= 0.0
        _refuse(negative, f"[{name}] {key} is {value!r}; a standard deviation cannot be negative")
    return quantities


def _of_outputs(table: Mapping[str, Any], name: str) -> dict[str, float]:
    """Positive quantities of outputs; the `source` is said once for all of them."""
    by_output = _quantities({key: value for key, value in table.items() if key != "source"}, name)
    for key, value in by_output.items():
        _refuse(not value > 0.0, f"[{name}] {key} is {table[key]!r}; it must be positive")
    return by_output


def _parse_parameter(key: str, given: Any) -> CardParameter:
    label = f"[parameters.{key}]"
    given = _entry(given, PARAMETER_KEYS, 0, label)
    bounds, start, prior = given.get("bounds"), given.get("start"), given.get("prior")
    pair = isinstance(bounds, list) and len(bounds) == 2
    _refuse(bounds is not None and not pair, f"{label} bounds must be [lower, upper]")
    if prior is not None:
        prior = _entry(prior, ("family", "location", "scale", "source"), 3, f"{label} prior")
        location, scale = _number(prior["location"], label), _number(prior["scale"], label)
        try:
            source = str(prior.get("source", "our choice"))
            prior = Prior(str(prior["family"]), location, scale, source, by_card=True)
        except InputError as error:
            raise InputError(f"{label}: {error}") from None
    return CardParameter(
        None if start is None else _number(start, label),
        None if bounds is None else (_number(bounds[0], label), _number(bounds[1], label)), prior,
    )  # fmt: skip


def channel_units(card: Card) -> dict[str, str]:
    """SI unit of every channel of the card, and of its sums, which are in the unit of their first part."""
    formed = (name for name in (*card.constants, *card.derived) if name in STANDARD_CHANNELS)
    units = {name: STANDARD_CHANNELS[name].unit for name in formed}
    units = {name: table.si for name, table in card.tables.items()} | units | {c.name: c.si for c in card.channels}
    return {ONE: "1", "thrust": "N"} | {name: units[next(iter(parts))] for name, parts in card.sums.items()} | units
