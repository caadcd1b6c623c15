"""The card: one TOML file per aircraft with channels, constants, active effects, priors and sensor noise."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from bayes_aero.errors import InputError
from bayes_aero.flight.aircraft import NO_AIRCRAFT, Aircraft, Envelope
from bayes_aero.flight.card.lookup import Lookup, parse_tables
from bayes_aero.flight.card.tables import (
    ONE,
    FlyCard,
    LinearCard,
    parse_aircraft,
    parse_channel,
    parse_constants,
    parse_derived,
    parse_envelope,
    parse_fly,
    parse_linear,
    parse_quantity,
    parse_sums,
    refuse_no_body,
)
from bayes_aero.flight.card.toml_tables import (
    is_file,
    known_keys,
    number,
    numbers,
    read_table,
    refuse_unfilled,
    section,
)
from bayes_aero.flight.channel import STANDARD_CHANNELS, Axis, Channel
from bayes_aero.flight.reading.segments import segment_of
from bayes_aero.flight.record import TOLERANCES, Tolerance
from bayes_aero.parameter import Prior
from bayes_aero.units import si_unit

SECTIONS = (
    "title", "source", "aircraft", "channels", "sums", "constants", "derived", "tables", "sensors", "model", "linear",
    "parameters", "gp", "tolerances", "output_biases", "segments", "fly", "envelope",
)  # fmt: skip
PARAMETER_KEYS = ("start", "bounds", "prior")


@dataclass(frozen=True)
class ParameterChange:
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
    changes: Mapping[str, ParameterChange] = field(default_factory=dict)
    gp_inputs: tuple[str, ...] = ("alpha", "elevator", "q", "airspeed")
    constants: Mapping[str, float] = field(default_factory=dict)  # channels that a file may lack, SI
    derived: Mapping[str, str] = field(default_factory=dict)  # channels that a file may lack, and the rule of each
    tables: Mapping[str, Lookup] = field(default_factory=dict)  # channels that a file may lack, read off tables
    linear: LinearCard | None = None
    tolerances: Mapping[str, Tolerance] = field(default_factory=lambda: dict(TOLERANCES))
    output_biases: Mapping[str, Prior] = field(default_factory=dict)  # of each manoeuvre's own, in fits of trajectories
    segments: Mapping[str, tuple[str, ...]] = field(default_factory=dict)  # parts of files by name: "12.5:40"
    fly: FlyCard = field(default_factory=FlyCard)
    envelope: Envelope = field(default_factory=Envelope)  # of proposed flight tests
    path: str = ""  # of the file, as it was given; empty for a shipped card


def shipped_cards() -> dict[str, Path]:
    """Cards that come with the package, by name."""
    here = Path(__file__).resolve().parents[2]
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
    needed = ("channels",) if "linear" in table else ("aircraft", "channels", "model")
    for key in needed:
        if not isinstance(table.get(key), dict):
            raise InputError(f"card {where}: section [{key}] is missing; see models/attas.toml for one")
    if "linear" in table and "model" in table:
        raise InputError(f"card {where}: it has both [model] and [linear]; keep one of them")
    channels = tuple(parse_channel(key, value, where) for key, value in table["channels"].items())
    constants = parse_constants(section(table, "constants", where), channels, where)
    derived = parse_derived(section(table, "derived", where), channels, constants, where)
    tables = parse_tables(section(table, "tables", where), channels, {**constants, **derived}, where)
    sums = parse_sums(section(table, "sums", where), channels, constants, (*derived, *tables), where)
    for formed in (*derived, *tables):
        if formed in sums:
            raise InputError(f"card {where}: {formed} is in [sums] and in [derived] or [tables]; keep one of them")
    linear = None
    if "linear" in table:
        names = {channel.name for channel in channels} | {*constants, *sums, *derived, *tables}
        linear = parse_linear(table["linear"], names, where)
    model = {} if linear else table["model"]
    effects = () if linear else _effects(model, where)
    axes = _axes(model, where)
    aircraft = parse_aircraft(section(table, "aircraft", where), where) if "aircraft" in table else NO_AIRCRAFT
    if Axis.LATERAL in axes:
        refuse_no_body(aircraft, where)
    changes = {key: _change(key, value, where) for key, value in section(table, "parameters", where).items()}
    if linear:
        known_keys(changes, linear.parameters, where, "parameter")
    return Card(
        name=name,
        title=str(table.get("title", name)),
        source=str(table.get("source", "not stated")),
        sha256=sha256,
        aircraft=aircraft,
        channels=channels,
        sums=sums,
        sensors=_sensors(section(table, "sensors", where), where),
        tolerances=_tolerances(section(table, "tolerances", where), where),
        envelope=parse_envelope(section(table, "envelope", where), where),
        output_biases=_output_biases(section(table, "output_biases", where), where),
        segments=_segments(section(table, "segments", where), where),
        effects=effects,
        axes=axes,
        effect_files=_files(model.get("effect_files", []), where),
        fixed=numbers(model.get("fixed", {}), f"{where}: [model] fixed"),
        changes=changes,
        gp_inputs=_gp_inputs(section(table, "gp", where), where),
        constants=constants,
        derived=derived,
        tables=tables,
        linear=linear,
        fly=parse_fly(section(table, "fly", where), channels, where),
    )


def _effects(model: Mapping[str, Any], where: str) -> tuple[str, ...]:
    known_keys(model, ("effects", "effect_files", "fixed", "axes"), where, "key of [model]")
    effects = model.get("effects")
    if not (isinstance(effects, list) and effects and all(isinstance(e, str) for e in effects)):
        raise InputError(f"card {where}: [model] effects must be a list of effect names")
    if len(set(effects)) < len(effects):
        raise InputError(f"card {where}: [model] effects names an effect twice")
    return tuple(effects)


def _axes(model: Mapping[str, Any], where: str) -> tuple[Axis, ...]:
    """Axes that the card models, in the order of `Axis`."""
    given = model.get("axes", [Axis.LONGITUDINAL.value])
    known = [axis.value for axis in Axis]
    if not (isinstance(given, list) and given and all(x in known for x in given)):
        raise InputError(f"card {where}: [model] axes must be a list of {' and '.join(known)}")
    return tuple(axis for axis in Axis if axis in given)


def _files(given: Any, where: str) -> tuple[Path, ...]:
    """Paths as the card gives them, relative to its own folder."""
    if not (isinstance(given, list) and all(isinstance(name, str) for name in given)):
        raise InputError(f"card {where}: [model] effect_files must be a list of paths of Python files")
    for name in given:
        if not name.isprintable() or not name.strip():
            raise InputError(f"card {where}: [model] effect_files has {name!r}, which is no path of a Python file")
    try:
        return tuple((Path(where).parent / name).resolve() for name in given)
    except OSError as error:
        raise InputError(f"card {where}: [model] effect_files cannot be found ({error}); correct the path") from None


def _segments(table: Mapping[str, Any], where: str) -> dict[str, tuple[str, ...]]:
    """[segments]: the manoeuvres that a file of this name holds, each as "FROM:TO" in seconds of its time."""
    for name, parts in table.items():
        if not isinstance(parts, list) or not parts or not all(isinstance(part, str) for part in parts):
            raise InputError(f'card {where}: [segments] {name} must be a list of parts, e.g. ["12.5:40", "61:85"]')
        for part in parts:
            if segment_of(f"{name}@{part}").whole:
                raise InputError(
                    f"card {where}: [segments] {name} has {part!r}; write FROM:TO in seconds of the file's time, e.g. "
                    '"12.5:40", or "#2" for the second part between gaps'
                )
    return {name: tuple(parts) for name, parts in table.items()}


def _sensors(table: Mapping[str, Any], where: str) -> dict[str, float]:
    sensors = {key: parse_quantity(key, value, "sensors", where) for key, value in table.items()}
    for key, deviation in sensors.items():
        if not deviation >= 0.0:
            raise InputError(
                f"card {where}: [sensors] {key} is {table[key]!r}; a standard deviation cannot be negative"
            )
    return sensors


def _tolerances(table: Mapping[str, Any], where: str) -> dict[str, Tolerance]:
    """Bands of the card, `source` said once for all of them; without a section the program's own."""
    if not table:
        return dict(TOLERANCES)
    bands, source = _by_output(table, "tolerances", "half the width of a band is positive", where)
    return {key: Tolerance(value, source) for key, value in bands.items()}


def _output_biases(table: Mapping[str, Any], where: str) -> dict[str, Prior]:
    """Normal priors about zero: the card says their standard deviations."""
    deviations, source = _by_output(table, "output_biases", "a standard deviation is positive", where)
    return {key: Prior("normal", 0.0, value, source, by_card=True) for key, value in deviations.items()}


def _by_output(table: Mapping[str, Any], name: str, rule: str, where: str) -> tuple[dict[str, float], str]:
    """Positive quantities of outputs, SI, and the `source` that is said once for all of them."""
    found = {key: parse_quantity(key, value, name, where) for key, value in table.items() if key != "source"}
    for key, value in found.items():
        if not value > 0.0:
            raise InputError(f"card {where}: [{name}] {key} is {table[key]!r}; {rule}")
    return found, str(table.get("source", "the card, no source stated"))


def _change(key: str, given: Any, where: str) -> ParameterChange:
    if not isinstance(given, dict):
        raise InputError(f"card {where}: [parameters.{key}] must be a table")
    known_keys(given, PARAMETER_KEYS, where, f"key of [parameters.{key}]")
    bounds = given.get("bounds")
    if bounds is not None and not (isinstance(bounds, list) and len(bounds) == 2):
        raise InputError(f"card {where}: [parameters.{key}] bounds must be [lower, upper]")
    label = f"{where}: [parameters.{key}]"
    return ParameterChange(
        start=None if "start" not in given else number(given["start"], label),
        bounds=None if bounds is None else (number(bounds[0], label), number(bounds[1], label)),
        prior=None if "prior" not in given else _prior(given["prior"], label),
    )


def _prior(given: Any, label: str) -> Prior:
    if not isinstance(given, dict):
        raise InputError(f"card {label} prior must be a table with family, location, scale and source")
    known_keys(given, ("family", "location", "scale", "source"), label, "key of prior")
    for key in ("family", "location", "scale"):
        if key not in given:
            raise InputError(f"card {label} prior has no {key}")
    location, scale = number(given["location"], label), number(given["scale"], label)
    try:
        return Prior(str(given["family"]), location, scale, str(given.get("source", "our choice")), by_card=True)
    except InputError as error:
        raise InputError(f"card {label}: {error}") from None


def _gp_inputs(table: Mapping[str, Any], where: str) -> tuple[str, ...]:
    known_keys(table, ("inputs",), where, "key of [gp]")
    inputs = table.get("inputs", ["alpha", "elevator", "q", "airspeed"])
    if not (isinstance(inputs, list) and inputs and all(isinstance(name, str) for name in inputs)):
        raise InputError(f"card {where}: [gp] inputs must be a list of signal names")
    return tuple(inputs)


# --- The SI unit of whatever a card names.


def channel_units(card: Card) -> dict[str, str]:
    """SI unit of every channel of the card, and of its sums, which are in the unit of their first part."""
    known = {
        name: STANDARD_CHANNELS[name].unit for name in (*card.constants, *card.derived) if name in STANDARD_CHANNELS
    }
    for channel in card.channels:
        standard = STANDARD_CHANNELS.get(channel.name)
        known[channel.name] = standard.unit if standard else si_unit(channel.unit, f"channel {channel.name}")
    known = {name: table.si for name, table in card.tables.items()} | known
    return {ONE: "1", "thrust": "N"} | {name: known[next(iter(parts))] for name, parts in card.sums.items()} | known
