"""Recorded channels of several manoeuvres, end to end: what effects that act on the record itself work on."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from bayes_aero.errors import InputError
from bayes_aero.flight.aircraft import Aircraft
from bayes_aero.flight.card import Card
from bayes_aero.flight.record import FlightRecord
from bayes_aero.model.observations import marks, with_sums
from bayes_aero.physics.coefficients import REQUIRED, Signals, condition


class Flights(eqx.Module):
    """Channels (n,) in SI, with `dt`, `start`, `elapsed`, `first`, `last` beside them (see `effect.Stage`)."""

    channels: dict[str, Array]
    aircraft: Aircraft
    manoeuvre: Int[np.ndarray, " n"]
    time: Float[np.ndarray, " n"]
    lengths: tuple[int, ...] = eqx.field(static=True)
    names: tuple[str, ...] = eqx.field(static=True)

    @property
    def n(self) -> int:
        """Number of samples."""
        return sum(self.lengths)

    @property
    def recorded(self) -> tuple[str, ...]:
        """Names of the recorded channels and card sums, without what was added."""
        return tuple(name for name in self.channels if name not in ADDED)

    def conditioned(self, channels: Mapping[str, Array]) -> Signals:
        """Smoothed and differentiated signals, manoeuvre by manoeuvre."""
        begin, parts = 0, []
        for length in self.lengths:
            piece = {name: values[begin : begin + length] for name, values in channels.items()}
            parts.append(condition(piece, piece["dt"]))
            begin += length
        return {name: jnp.concatenate([part[name] for part in parts]) for name in parts[0]}


ADDED = ("dt", "start", "elapsed", "first", "last")


def join(records: Sequence[FlightRecord], card: Card) -> Flights:
    """Lay the records end to end; channels that are not in every record are left out."""
    if not records:
        raise InputError("there is no flight record to work on; name at least one file")
    for record in records:
        have = with_sums(record, card)
        for need in REQUIRED:
            if need not in have:
                raise InputError(f"record {record.name} has no channel {need}; map it on the card")
    parts, offset = [], 0
    for record in records:
        parts.append(with_sums(record, card) | marks(record.n, record.dt, offset))
        offset += record.n
    shared = set.intersection(*(set(part) for part in parts))
    return Flights(
        channels={name: jnp.concatenate([jnp.asarray(part[name]) for part in parts]) for name in sorted(shared)},
        aircraft=card.aircraft,
        manoeuvre=np.repeat(np.arange(len(records)), [record.n for record in records]),
        time=np.concatenate([np.asarray(record.time) for record in records]),
        lengths=tuple(record.n for record in records),
        names=tuple(record.name for record in records),
    )
