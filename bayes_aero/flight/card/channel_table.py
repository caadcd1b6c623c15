"""What a card says of channels: where they stand in a file, sums, constants, and what is formed from others."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from bayes_aero.errors import InputError
from bayes_aero.flight.card.table_checks import known_keys, like, numbers
from bayes_aero.flight.channel import STANDARD_CHANNELS, Channel
from bayes_aero.units import quantity_to_si

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
    if not isinstance(given, dict):
        raise InputError(f'card {where}: channel {key} must be a table, e.g. {{ column = 13, unit = "deg" }}')
    known_keys(given, ("column", "label", "unit", "required", "sign"), where, f"key of channel {key}")
    if "unit" not in given:
        raise InputError(f"card {where}: channel {key} has no unit; state the unit that the file is in")
    column = given.get("column")
    if column is not None and (isinstance(column, bool) or not isinstance(column, int) or column < 1):
        raise InputError(f"card {where}: channel {key} has column {column!r}; columns are counted from 1")
    if column is not None and column > MOST_COLUMNS:
        raise InputError(f"card {where}: channel {key} has column {column}; no file has more than {MOST_COLUMNS}")
    if column is None and "label" not in given:
        raise InputError(f"card {where}: channel {key} has neither column nor label; say where it stands in a file")
    label = given.get("label")
    sign = given.get("sign", 1)
    if isinstance(sign, bool) or sign not in (1, -1):
        raise InputError(f"card {where}: channel {key} has sign {sign!r}; write -1 if the file counts the other way")
    return Channel(
        name=key,
        unit=str(given["unit"]),
        label=None if label is None else str(label),
        column=column,
        required=bool(given.get("required", True)),
        sign=int(sign),
    )


def parse_sums(
    table: Mapping[str, Any],
    channels: tuple[Channel, ...],
    constants: Mapping[str, float],
    formed: Iterable[str],
    where: str,
) -> dict[str, dict[str, float]]:
    """[sums]: channels that are sums of others, each part with its factor; `formed` are [derived] and [tables]."""
    names = {channel.name for channel in channels} | set(constants) | set(formed)
    found = {}
    for key, given in table.items():
        if key in constants:
            raise InputError(f"card {where}: {key} is both in [sums] and in [constants]; keep one of them")
        if not (isinstance(given, list | dict) and given):
            raise InputError(f"card {where}: [sums] {key} must be a list of channel names, or a table with factors")
        if not all(isinstance(part, str) for part in given):
            raise InputError(f"card {where}: [sums] {key} must hold names of channels")
        counted = {part: float(given.count(part)) for part in given} if isinstance(given, list) else None
        parts = numbers(given, f"{where}: [sums] {key}") if counted is None else counted
        missing = [part for part in parts if part not in names]
        if missing:
            hint = like(missing[0], names)
            raise InputError(f"card {where}: [sums] {key} uses {missing[0]}, which [channels] does not map{hint}")
        found[key] = parts
    return found


def parse_quantity(key: str, value: Any, label: str, where: str) -> float:
    """A quantity in the SI unit of a channel that the program knows."""
    unit = STANDARD_CHANNELS[key].unit if key in STANDARD_CHANNELS else None
    if unit is None:
        raise InputError(f"card {where}: [{label}] {key} is not a channel of the program")
    return quantity_to_si(value, unit, f"card {where}: [{label}] {key}")


def parse_constants(table: Mapping[str, Any], channels: tuple[Channel, ...], where: str) -> dict[str, float]:
    """Values of channels that the file may lack; what every file must hold has no constant."""
    required = {channel.name for channel in channels if channel.required}
    constants = {key: parse_quantity(key, value, "constants", where) for key, value in table.items()}
    for key, value in constants.items():
        if key == "time":
            raise InputError(f"card {where}: [constants] time cannot be constant; map it under [channels]")
        if key in required:
            raise InputError(
                f"card {where}: {key} is a required channel and in [constants]; drop one, or set required = false"
            )
        if key in STANDARD_CHANNELS and not (
            STANDARD_CHANNELS[key].plausible[0] <= value <= STANDARD_CHANNELS[key].plausible[1]
        ):
            raise InputError(f"card {where}: [constants] {key} is {table[key]!r}, beyond any flight; check its unit")
    return constants


def parse_derived(
    table: Mapping[str, Any], channels: tuple[Channel, ...], constants: Mapping[str, Any], where: str
) -> dict[str, str]:
    """Channels that a file may lack, each by the rule that forms it from others."""
    known_keys(table, tuple(RULES), where, "key of [derived]")
    mapped = {channel.name for channel in channels}
    for key, value in table.items():
        if value not in RULES[key]:
            rules = " or ".join(repr(rule) for rule in RULES[key])
            raise InputError(f"card {where}: [derived] {key} is {str(value)[:60]!r}; write {rules}")
        if key in constants:
            raise InputError(f"card {where}: {key} is both in [derived] and in [constants]; keep one of them")
        missing = [name for name in RULES[key][value] if name not in mapped]
        if missing:
            hint = like(missing[0], mapped)
            raise InputError(f"card {where}: [derived] {key} needs {missing[0]}, which [channels] does not map{hint}")
    return dict(table)
