"""Channels of a record with the additions of its card: constants, derived channels, tables, sums."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from jaxtyping import Float

from bayes_aero.flight.atmosphere import GAMMA, GAS, air
from bayes_aero.flight.card.card import Card
from bayes_aero.flight.card.tables import ATMOSPHERE, RULES
from bayes_aero.flight.record import FlightRecord


def with_sums(record: FlightRecord, card: Card) -> dict[str, Float[np.ndarray, " n"]]:
    """The record's channels with what the card states, where nothing was recorded, and its sums (total thrust)."""
    channels = {name: np.full(record.n, value) for name, value in card.constants.items()}
    channels |= _derived(record, card.derived)
    channels |= record.channels
    for name, table in card.tables.items():
        looked_up = None if record.has(name) else table.of(channels, record.name, record.time)
        if looked_up is not None:
            channels[name] = looked_up
    for name, parts in card.sums.items():
        weighed = (factor * (channels[part] if part in channels else record[part]) for part, factor in parts.items())
        channels[name] = sum(weighed, start=np.zeros(record.n))
    return channels


def _derived(record: FlightRecord, wanted: Mapping[str, str]) -> dict[str, Float[np.ndarray, " n"]]:
    """Density and Mach number by the card's rules, where the record has what they need."""
    found = {}
    for name, rule in wanted.items():
        needs = RULES[name][rule]
        if not all(record.has(need) for need in needs):
            continue
        if rule == ATMOSPHERE:
            found[name] = _in_atmosphere(name, record)
        elif rule == "dynamic pressure":
            found[name] = 2.0 * record["dynamic_pressure"] / record["airspeed"] ** 2
        elif rule == "gas law":
            found[name] = record["static_pressure"] / (GAS * record["static_temperature"])
        else:
            found[name] = record["airspeed"] / np.sqrt(GAMMA * GAS * record["static_temperature"])
    return found


def _in_atmosphere(name: str, record: FlightRecord) -> Float[np.ndarray, " n"]:
    """Density or Mach number in a standard atmosphere at the recorded altitude."""
    density, sound = air(record["altitude"])
    return density if name == "density" else record["airspeed"] / sound
