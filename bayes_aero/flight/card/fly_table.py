"""The section [fly] of a card: what a fit to trajectories compares, and where its manoeuvres begin."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from bayes_aero.errors import InputError
from bayes_aero.flight.card.table_checks import known_keys
from bayes_aero.flight.channel import STANDARD_CHANNELS, Channel
from bayes_aero.units import quantity_to_si, si_unit

HOLDABLE = ("airspeed", "alpha", "beta", "p", "q", "r", "phi", "theta", "psi", "altitude")
"""States that a simulation may take from the record."""


@dataclass(frozen=True)
class FlyCard:
    """Outputs to compare (None: all), the initial state of `fly --initial-state fixed`, SI, and states that are `held`
    to the record."""

    outputs: tuple[str, ...] | None = None
    initial_state: Mapping[str, float] = field(default_factory=dict)
    held: tuple[str, ...] = ()


def parse_fly(table: Mapping[str, Any], channels: Sequence[Channel], where: str) -> FlyCard:
    """Check [fly]; that its names are outputs and states is checked when a record is flown."""
    known_keys(table, ("outputs", "initial_state", "held"), where, "key of [fly]")
    outputs = table.get("outputs")
    if outputs is not None and not (isinstance(outputs, list) and outputs and all(isinstance(x, str) for x in outputs)):
        raise InputError(f'card {where}: [fly] outputs must be a list of channels, e.g. ["alpha", "q"]')
    held = table.get("held", [])
    if not (isinstance(held, list) and all(x in HOLDABLE for x in held)):
        raise InputError(f"card {where}: [fly] held must be a list of states, of {', '.join(HOLDABLE)}")
    given = table.get("initial_state", {})
    if not isinstance(given, dict):
        raise InputError(
            f'card {where}: [fly] initial_state must be a table, e.g. {{ alpha = "2 deg", q = "0 deg/s" }}'
        )
    mapped = {channel.name: channel for channel in channels}
    initial = {}
    for name, value in given.items():
        if name not in mapped:
            raise InputError(f"card {where}: [fly] initial_state has {name}, which [channels] does not map")
        standard = STANDARD_CHANNELS.get(name)
        unit = standard.unit if standard else si_unit(mapped[name].unit, f"channel {name}")
        initial[name] = quantity_to_si(value, unit, f"card {where}: [fly] initial_state {name}")
    return FlyCard(None if outputs is None else tuple(dict.fromkeys(outputs)), initial, tuple(dict.fromkeys(held)))
