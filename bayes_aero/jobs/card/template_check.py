"""A starter card is read back by the card's own parser before it is written: what cannot be parsed is never a file."""

from __future__ import annotations

from typing import Any

from bayes_aero.errors import DefectError, InputError
from bayes_aero.flight.aircraft import AIRCRAFT_KEYS
from bayes_aero.flight.card.card import parse_card
from bayes_aero.flight.card.table_checks import UNFILLED
from bayes_aero.flight.card.toml_tables import parse_table
from bayes_aero.flight.channel import STANDARD_CHANNELS


def read_back(text: str, record: str) -> None:
    """Parse a starter card with something plausible in place of every TODO.

    Args:
        text: the card.
        record: the file it was made from, named in the error.

    Raises:
        DefectError: it is no card, TODO entries aside.
    """
    try:
        parse_card(_filled(parse_table(text.encode(), "of a starter")), "starter", "of a starter")
    except InputError as reason:
        raise DefectError(
            f"the starter card of {record} was not written, for the program could not read it back ({reason})",
            "write the card by hand (docs/reference/card.md explains every key)",
        ) from reason


def _filled(table: dict[str, Any]) -> dict[str, Any]:
    """The table with a value of the right unit for every TODO; a product of inertia is zero, as of some body."""
    table = {**table, "aircraft": {**table["aircraft"], "Ixz": "0 kg m^2"}}
    units = {
        "aircraft": AIRCRAFT_KEYS,
        "constants": {name: channel.unit for name, channel in STANDARD_CHANNELS.items()},
    }
    return {
        section: {key: _value(value, units.get(section, {}).get(key, "1")) for key, value in entries.items()}
        if isinstance(entries, dict)
        else entries
        for section, entries in table.items()
    }


def _value(given: Any, unit: str) -> Any:
    if isinstance(given, dict):
        return {key: (1 if key == "column" else "1") if x == UNFILLED else x for key, x in given.items()}
    if given != UNFILLED:
        return given
    return 1.0 if unit == "1" else f"1 {unit}"
