"""The SI unit of whatever a card names."""

from __future__ import annotations

from bayes_aero.flight.card.card import Card
from bayes_aero.flight.card.linear_table import ONE
from bayes_aero.flight.channel import STANDARD_CHANNELS
from bayes_aero.units import si_unit


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
