"""Recorded channels of several manoeuvres, end to end, as JAX arrays, for effects that act on the record."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from bayes_aero.effect import MARKS
from bayes_aero.flight.aircraft import Aircraft
from bayes_aero.flight.card.card import Card
from bayes_aero.flight.record import FlightRecord
from bayes_aero.model import pytrees as pytrees
from bayes_aero.model.joined_records import Joined, joined, without_spikes
from bayes_aero.model.model import Model
from bayes_aero.physics.coefficient_names import REQUIRED
from bayes_aero.physics.coefficients import unsmoothed_joined
from bayes_aero.physics.filters import smooth_joined


class Flights(eqx.Module):
    """Channels (n,) in SI, with `dt`, `start`, `elapsed`, `first`, `last` beside them (see `effect.Stage`)."""

    channels: dict[str, Array]
    aircraft: Aircraft
    manoeuvre: Int[np.ndarray, " n"]
    time: Float[np.ndarray, " n"]
    lengths: tuple[int, ...] = eqx.field(static=True)
    names: tuple[str, ...] = eqx.field(static=True)
    held: tuple[str, ...] = eqx.field(static=True, default=())  # states that a simulation takes from the record

    @classmethod
    def of(cls, flights: Joined) -> Flights:
        """The same as JAX arrays."""
        channels = {name: jnp.asarray(x) for name, x in flights.channels.items()}
        own = flights.aircraft, flights.manoeuvre, flights.time, flights.lengths, flights.names, flights.held
        return cls(channels, *own)

    @property
    def n(self) -> int:
        """Number of samples."""
        return sum(self.lengths)

    @property
    def recorded(self) -> tuple[str, ...]:
        """Names of the recorded channels and card sums, without what was added."""
        return tuple(name for name in self.channels if name not in ADDED)

    @property
    def nameless(self) -> Flights:
        """The same without names, so that records of any name share compiled programs."""
        return replace(self, names=())

    def with_slopes(self, channels: Mapping[str, Array]) -> dict[str, Array]:
        """Channels (corrected ones, too) and their derivatives, manoeuvre by manoeuvre."""
        dt, first, last = (self.channels[name] for name in ("dt", "first", "last"))
        return unsmoothed_joined(channels, self.aircraft.accelerometer, dt, first, last, self.channels)

    def smoothed(self, rows: Float[Array, "n c"]) -> Float[Array, "n c"]:
        """Columns smoothed manoeuvre by manoeuvre."""
        ends = self.channels["first"], self.channels["last"]
        return jax.vmap(lambda x: smooth_joined(x, *ends), in_axes=1, out_axes=1)(rows)


def response_scales(
    model: Model, values: Mapping[str, Any], channels: Mapping[str, Array], aircraft: Aircraft, names: Sequence[str]
) -> dict[str, Array]:
    """Derivative of each corrected channel of `names` with respect to the recorded channel."""

    def correct(name, series):
        return model.corrected(values, {**channels, name: series}, aircraft)[name]

    # One channel at a time: the influence of other channels (pitch rate on the vane's angle) does not count.
    own = {name: channels[name] for name in names if name in channels}
    return {name: jax.jvp(partial(correct, name), (x,), (jnp.ones_like(x),))[1] for name, x in own.items()}


ADDED = MARKS


def join(records: Sequence[FlightRecord], card: Card, required: Sequence[str] = REQUIRED) -> Flights:
    """`joined`, for compiled programs."""
    return Flights.of(joined(records, card, required))


def despiked(flights: Flights) -> tuple[Flights, dict[str, int]]:
    """The manoeuvres without spikes, and the number of replaced samples by channel; see `without_spikes`."""
    channels, count = without_spikes(flights.channels, flights.lengths)
    mended = {name: jnp.asarray(channels[name]) if name in count else x for name, x in flights.channels.items()}
    return replace(flights, channels=mended), count
