"""Tables on the card: a channel that a file lacks, such as thrust, read off over channels that it has, such as N1."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from bayes_aero.errors import InputError
from bayes_aero.flight.card_tables import (
    ONE,
    FlyCard,
    LinearCard,
    all_mapped,
    is_file,
    known_keys,
    number,
    numbers,
    parse_aircraft,
    parse_channel,
    parse_constants,
    parse_derived,
    parse_envelope,
    parse_fly,
    parse_linear,
    parse_quantity,
    parse_sums,
    read_table,
    refuse,
    refuse_no_body,
    refuse_unfilled,
    section,
    strings,
)
from bayes_aero.flight.channel import STANDARD_CHANNELS, Channel
from bayes_aero.flight.record import TOLERANCES, Tolerance, segment_of
from bayes_aero.parameter import Prior
from bayes_aero.physics.aircraft import NO_AIRCRAFT, Aircraft, Axis, Envelope
from bayes_aero.units import from_si, instant, si_unit, to_si

MOST_AXES, MOST_VALUES = 3, 10_000
TABLE_KEYS = ("unit", "from", "values")
SLACK = 1e-9  # of the axis, for the rounding of a conversion
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
            slack = SLACK * (high - low)
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


def parse_tables(
    tables: Mapping[str, Any], channels: Mapping[str, Channel], formed: Mapping[str, Any], where: str
) -> dict[str, LookupTable]:
    """[tables.NAME]; `formed` are channels that the card states otherwise, by [constants] or [derived]."""
    lookups = {}
    for name, given in tables.items():
        here = f"card {where}: [tables.{name}]"
        refuse(not isinstance(given, dict), f"{here} must be a table with unit, from and values")
        known_keys(given, TABLE_KEYS, where, f"key of [tables.{name}]")
        for key in TABLE_KEYS:
            refuse(key not in given, f"{here} has no {key}; add it, {_EXAMPLE}")
        twice = name in formed or (name in channels and channels[name].required)
        refuse(twice, f"{here}: the card states {name} elsewhere, too; keep one of them")
        entered = isinstance(given["from"], dict) and 1 <= len(given["from"]) <= MOST_AXES
        refuse(not entered, f"{here} from must name one to {MOST_AXES} channels, {_EXAMPLE}")
        axes = tuple(_parse_axis(key, entry, channels, formed, where, here) for key, entry in given["from"].items())
        values, shape = _numbers(given["values"], f"{here} values"), tuple(len(axis.points) for axis in axes)
        wanted = " lists of ".join(str(n) for n in shape)
        per = "; ".join(f"{len(axis.points)} points of {axis.channel}" for axis in axes)
        refuse(values.shape != shape, f"{here} values must be {wanted} numbers ({per}), the first channel outermost")
        unit, standard = str(given["unit"]), STANDARD_CHANNELS.get(name)
        si = standard.unit if standard else si_unit(unit, here)
        lookups[name] = LookupTable(name, si, axes, _nested(to_si(values, unit, name, si)))
    return lookups


def _parse_axis(
    name: str, given: Any, channels: Mapping[str, Channel], formed: Mapping[str, Any], where: str, table: str
) -> TableAxis:
    here = f"{table} from {name}"
    refuse(not isinstance(given, dict), f"{here} must have unit and points, {_EXAMPLE}")
    known_keys(given, ("unit", "points"), where, f"key of from {name}")
    refuse("unit" not in given or "points" not in given, f"{here} must have unit and points, {_EXAMPLE}")
    all_mapped([name], {*channels, *formed}, f"{table.removeprefix('card ')} from has")
    unit = str(given["unit"])
    si = channels[name].si if name in channels else STANDARD_CHANNELS[name].unit
    points = to_si(_numbers(given["points"], f"{here}: points"), unit, name, si)
    increase = points.ndim == 1 and len(points) >= 2 and (np.diff(points) > 0.0).all()
    refuse(not increase, f"{here}: points must be two numbers or more, and increase")
    return TableAxis(name, unit, si, tuple(float(x) for x in points))


def _numbers(given: Any, what: str) -> np.ndarray:
    """A list, or lists of lists, of finite numbers."""
    try:
        values = np.array(given, dtype=object)
        if values.size > MOST_VALUES or any(isinstance(x, bool) or not isinstance(x, int | float) for x in values.flat):
            raise ValueError
        values = values.astype(np.float64)
    except (TypeError, ValueError, OverflowError):
        raise InputError(
            f"{what} must be a list of plain numbers (rows of one length), {MOST_VALUES} at most"
        ) from None
    refuse(not np.isfinite(values).all(), f"{what} must be finite numbers")
    return values


def _nested(values: np.ndarray) -> tuple[Any, ...]:
    return tuple(_nested(row) if row.ndim else float(row) for row in values)


# --- The card: one TOML file per aircraft with channels, constants, active effects, priors and sensor noise.

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
        raise InputError(
            f"there is no card {str(name_or_path)[:200]!r}: give a .toml file or one of {', '.join(cards) or 'none'}"
        )
    raw, table = read_table(path, "card")
    card = parse_card(table, path.stem, str(path), hashlib.sha256(raw).hexdigest())
    return card if str(name_or_path) in cards else replace(card, path=str(path))


def parse_card(table: Mapping[str, Any], name: str, where: str, sha256: str = "") -> Card:
    """Check a card's table and turn it into a `Card`; `where` is named in errors."""
    known_keys(table, SECTIONS, where, "section")
    refuse_unfilled(table, where)
    here, linear = f"card {where}:", None
    for key in ("channels",) if "linear" in table else ("aircraft", "channels", "model"):
        lacks = not isinstance(table.get(key), dict)
        refuse(lacks, f"{here} section [{key}] is missing; see models/attas.toml for one")
    both = "linear" in table and "model" in table
    refuse(both, f"{here} it has both [model] and [linear]; keep one of them")
    part = partial(section, table, where=where)
    formed = _channels(part, where)
    mapped = {channel.name: channel for channel in formed["channels"]}
    if "linear" in table:
        names = {*mapped, *(n for key in ("constants", "sums", "derived", "tables") for n in formed[key])}
        linear = parse_linear(table["linear"], names, where)
    model, effects = part("model"), ()
    if not linear:
        known_keys(model, ("effects", "effect_files", "fixed", "axes"), where, "key of [model]")
        effects = strings(model.get("effects"), f"{here} [model] effects must be a list of effect names")
    refuse(len(set(effects)) < len(effects), f"{here} [model] effects names an effect twice")
    given, possible = model.get("axes", [Axis.LONGITUDINAL.value]), [axis.value for axis in Axis]
    listed = isinstance(given, list) and given and all(x in possible for x in given)
    refuse(not listed, f"{here} [model] axes must be a list of {' and '.join(possible)}")
    aircraft = parse_aircraft(part("aircraft"), where) if "aircraft" in table else NO_AIRCRAFT
    if Axis.LATERAL.value in given:
        refuse_no_body(aircraft, where)
    changes = {key: _parameter(key, value, where) for key, value in part("parameters").items()}
    if linear:
        known_keys(changes, linear.parameters, where, "parameter")
    gp = part("gp")
    known_keys(gp, ("inputs",), where, "key of [gp]")
    bands, said = _of_outputs(part("tolerances"), "tolerances", "half the width of a band is positive", where)
    deviations, source = _of_outputs(part("output_biases"), "output_biases", "a standard deviation is positive", where)
    return Card(
        name=name,
        title=str(table.get("title", name)),
        source=str(table.get("source", "not stated")),
        sha256=sha256,
        aircraft=aircraft,
        sensors=_quantities(part("sensors"), "sensors", "a standard deviation cannot be negative", where),
        tolerances={key: Tolerance(x, said) for key, x in bands.items()} if part("tolerances") else dict(TOLERANCES),
        envelope=parse_envelope(part("envelope"), where),
        output_biases={key: Prior("normal", 0.0, sd, source, by_card=True) for key, sd in deviations.items()},
        segments=_segments(part("segments"), where),
        effects=effects,
        axes=tuple(axis for axis in Axis if axis in given),
        effect_files=_files(model.get("effect_files", []), where),
        fixed=numbers(model.get("fixed", {}), f"{where}: [model] fixed"),
        changes=changes,
        gp_inputs=strings(gp.get("inputs", [*GP_INPUTS]), f"{here} [gp] inputs must be a list of signal names"),
        linear=linear,
        fly=parse_fly(part("fly"), mapped, where),
        **formed,
    )


def _channels(part: Callable[[str], Mapping[str, Any]], where: str) -> dict[str, Any]:
    """The sections that say where channels come from, by their fields of `Card`; no channel may be in two of them."""
    mapped = {key: parse_channel(key, value, where) for key, value in part("channels").items()}
    constants = parse_constants(part("constants"), mapped, where)
    derived = parse_derived(part("derived"), mapped, where)
    tables = parse_tables(part("tables"), mapped, {**constants, **derived}, where)
    sums = parse_sums(part("sums"), {*mapped, *constants, *derived, *tables}, where)
    sections = {"sums": sums, "constants": constants, "derived": derived, "tables": tables}
    for (one, names), (other, others) in combinations(sections.items(), 2):
        for key in set(names) & set(others):
            raise InputError(f"card {where}: {key} is both in [{one}] and in [{other}]; keep one of them")
    return {"channels": tuple(mapped.values()), **sections}


def _files(given: Any, where: str) -> tuple[Path, ...]:
    """Paths as the card gives them, relative to its own folder."""
    here = f"card {where}: [model] effect_files"
    names = strings(given, f"{here} must be a list of paths of Python files", empty=True)
    for name in names:
        refuse(not name.isprintable() or not name.strip(), f"{here} has {name!r}, which is no path of a Python file")
    try:
        return tuple((Path(where).parent / name).resolve() for name in names)
    except OSError as error:
        raise InputError(f"{here} cannot be found ({error}); correct the path") from None


def _segments(table: Mapping[str, Any], where: str) -> dict[str, tuple[str, ...]]:
    """[segments]: the manoeuvres that a file of this name holds, each as "FROM:TO" in seconds of its time."""
    for name, parts in table.items():
        here = f"card {where}: [segments] {name}"
        for part in strings(parts, f'{here} must be a list of parts, e.g. ["12.5:40", "61:85"]'):
            refuse(
                segment_of(f"{name}@{part}").whole,
                f"{here} has {part!r}; write FROM:TO in seconds of the file's time, e.g. "
                '"12.5:40", or "#2" for the second part between gaps',
            )
    return {name: tuple(parts) for name, parts in table.items()}


def _quantities(table: Mapping[str, Any], name: str, rule: str, where: str) -> dict[str, float]:
    """Quantities of channels, SI, none negative, and none zero where the `rule` is of what is positive."""
    quantities = {key: parse_quantity(key, value, name, where) for key, value in table.items()}
    for key, value in quantities.items():
        sound = value > 0.0 or (value == 0.0 and not rule.endswith("positive"))
        refuse(not sound, f"card {where}: [{name}] {key} is {table[key]!r}; {rule}")
    return quantities


def _of_outputs(table: Mapping[str, Any], name: str, rule: str, where: str) -> tuple[dict[str, float], str]:
    """Positive quantities of outputs, and the `source` that is said once for all of them."""
    by_output = _quantities({key: value for key, value in table.items() if key != "source"}, name, rule, where)
    return by_output, str(table.get("source", "the card, no source stated"))


def _parameter(key: str, given: Any, where: str) -> CardParameter:
    label = f"{where}: [parameters.{key}]"
    refuse(not isinstance(given, dict), f"card {label} must be a table")
    known_keys(given, PARAMETER_KEYS, where, f"key of [parameters.{key}]")
    bounds = given.get("bounds")
    pair = isinstance(bounds, list) and len(bounds) == 2
    refuse(bounds is not None and not pair, f"card {label} bounds must be [lower, upper]")
    return CardParameter(
        start=None if "start" not in given else number(given["start"], label),
        bounds=None if bounds is None else (number(bounds[0], label), number(bounds[1], label)),
        prior=None if "prior" not in given else _prior(given["prior"], label),
    )


def _prior(given: Any, label: str) -> Prior:
    refuse(not isinstance(given, dict), f"card {label} prior must be a table with family, location, scale and source")
    known_keys(given, ("family", "location", "scale", "source"), label, "key of prior")
    for key in ("family", "location", "scale"):
        refuse(key not in given, f"card {label} prior has no {key}")
    location, scale = number(given["location"], label), number(given["scale"], label)
    try:
        return Prior(str(given["family"]), location, scale, str(given.get("source", "our choice")), by_card=True)
    except InputError as error:
        raise InputError(f"card {label}: {error}") from None


# --- The SI unit of whatever a card names.


def channel_units(card: Card) -> dict[str, str]:
    """SI unit of every channel of the card, and of its sums, which are in the unit of their first part."""
    units = {
        name: STANDARD_CHANNELS[name].unit for name in (*card.constants, *card.derived) if name in STANDARD_CHANNELS
    }
    units |= {channel.name: channel.si for channel in card.channels}
    units = {name: table.si for name, table in card.tables.items()} | units
    return {ONE: "1", "thrust": "N"} | {name: units[next(iter(parts))] for name, parts in card.sums.items()} | units
