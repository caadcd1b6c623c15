"""Recorded channels of several manoeuvres, end to end, as JAX arrays, for effects that act on the record."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array

from bayes_aero.flight.card import Card
from bayes_aero.flight.record import FlightRecord
from bayes_aero.model import pytrees as pytrees
from bayes_aero.model.joined_records import Flights, joined, without_spikes
from bayes_aero.model.model import Model
from bayes_aero.physics.aircraft import REQUIRED, Aircraft


def response_scales(
    model: Model, values: Mapping[str, Any], channels: Mapping[str, Array], aircraft: Aircraft, names: Sequence[str]
) -> dict[str, Array]:
    """Derivative of each corrected channel of `names` with respect to the recorded channel."""

    def correct(name, series):
        return model.corrected(values, {**channels, name: series}, aircraft)[name]

    # One channel at a time: the influence of other channels (pitch rate on the vane's angle) does not count.
    own = {name: channels[name] for name in names if name in channels}
    return {name: jax.jvp(partial(correct, name), (x,), (jnp.ones_like(x),))[1] for name, x in own.items()}


def join(records: Sequence[FlightRecord], card: Card, required: Sequence[str] = REQUIRED) -> Flights:
    """`joined`, for compiled programs."""
    flights = joined(records, card, required)
    return replace(flights, channels={name: jnp.asarray(x) for name, x in flights.channels.items()})


def despiked(flights: Flights) -> tuple[Flights, dict[str, int]]:
    """The manoeuvres without spikes, and the number of replaced samples by channel; see `without_spikes`."""
    channels, count = without_spikes(flights.channels, flights.lengths)
    mended = {name: jnp.asarray(channels[name]) if name in count else x for name, x in flights.channels.items()}
    return replace(flights, channels=mended), count
