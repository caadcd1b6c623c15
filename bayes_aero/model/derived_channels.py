"""Channels of a record with the additions of its card: constants, derived channels, tables, sums."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from bayes_aero.flight.card import Card
from bayes_aero.flight.card_tables import ATMOSPHERE, RULES
from bayes_aero.flight.record import FlightRecord
from bayes_aero.physics.aircraft import GAMMA, GAS, air


def with_sums(record: FlightRecord, card: Card) -> dict[str, Float[np.ndarray, " n"]]:
    """The record's channels with what the card states, where nothing was recorded, and its sums (total thrust)."""
    channels = {name: np.full(record.n, value) for name, value in card.constants.items()}
    for name, rule in card.derived.items():
        if not all(record.has(need) for need in RULES[name][rule]):
            continue
        if rule == ATMOSPHERE:
            density, sound = air(record["altitude"])
            channels[name] = density if name == "density" else record["airspeed"] / sound
        elif rule == "dynamic pressure":
            channels[name] = 2.0 * record["dynamic_pressure"] / record["airspeed"] ** 2
        elif rule == "gas law":
            channels[name] = record["static_pressure"] / (GAS * record["static_temperature"])
        else:
            channels[name] = record["airspeed"] / np.sqrt(GAMMA * GAS * record["static_temperature"])
    channels |= record.channels
    for name, table in card.tables.items():
        looked_up = None if record.has(name) else table.of(channels, record.name, record.time)
        if looked_up is not None:
            channels[name] = looked_up
    for name, parts in card.sums.items():
        weighed = (factor * (channels[part] if part in channels else record[part]) for part, factor in parts.items())
        channels[name] = sum(weighed, start=np.zeros(record.n))
    return channels
