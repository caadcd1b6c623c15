"""Recorded channels of several manoeuvres, end to end: what effects that act on the record itself work on."""

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
from scipy.ndimage import median_filter, rank_filter, uniform_filter1d

from bayes_aero.errors import InputError
from bayes_aero.flight.aircraft import Aircraft
from bayes_aero.flight.card import Card
from bayes_aero.flight.record import FlightRecord
from bayes_aero.model.formed import with_sums
from bayes_aero.model.model import Model
from bayes_aero.model.observations import MARKS, named_apart, plain_marks
from bayes_aero.physics.coefficients import REQUIRED, unsmoothed_joined
from bayes_aero.physics.filters import smooth_joined


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

    @property
    def nameless(self) -> Flights:
        """The same without names, on which no number depends: compiled programs then serve records of any name."""
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
    """Derivative of each corrected channel of `names` with respect to its recorded self: what its unit has become."""

    def correct(name, series):
        return model.corrected(values, {**channels, name: series}, aircraft)[name]

    # One channel at a time: what another channel adds to it (the vane's angle its pitch rate) is not its unit.
    own = {name: channels[name] for name in names if name in channels}
    return {name: jax.jvp(partial(correct, name), (x,), (jnp.ones_like(x),))[1] for name, x in own.items()}


ADDED = MARKS


def join(records: Sequence[FlightRecord], card: Card, required: Sequence[str] = REQUIRED) -> Flights:
    """Lay the records end to end; channels that are not in every record are left out, `required` ones missed."""
    if not records:
        raise InputError("there is no flight record to work on; name at least one file")
    named_apart(records)
    for record in records:
        have = with_sums(record, card)
        for need in required:
            if need not in have:
                raise InputError(f"record {record.name} has no channel {need}; map it on the card")
    parts, offset = [], 0
    for record in records:
        parts.append(with_sums(record, card) | plain_marks(record.n, record.dt, offset))
        offset += record.n
    shared = set.intersection(*(set(part) for part in parts))
    return Flights(
        channels={name: jnp.asarray(np.concatenate([part[name] for part in parts])) for name in sorted(shared)},
        aircraft=card.aircraft,
        manoeuvre=np.repeat(np.arange(len(records)), [record.n for record in records]),
        time=np.concatenate([np.asarray(record.time) for record in records]),
        lengths=tuple(record.n for record in records),
        names=tuple(record.name for record in records),
    )


SPIKED = ("ax", "ay", "az", "p", "q", "r", "alpha", "beta", "airspeed", "theta", "phi", "altitude")
SPIKE = 7.0  # local deviations from the median of five neighbours
BESIDE, SLOW = 7, 2  # the third smallest of seven steps is how fast the channel moves: two spikes make four of them
BEYOND = 2.5  # times that, which a spike must be away
END = 5  # samples next to either end that are left as they are
NEAR = 51  # samples over which the local deviation is measured


STEPPED, SMALL = 0.4, 0.1  # a channel moves in steps if so many of them are below a tenth of the large ones


def _step_size(steps: Float[np.ndarray, " n"]) -> float:
    """The size of the steps in which a channel is recorded; the least that noise makes where it has none.

    A channel computed from a quantised one (airspeed from a pressure, in air of changing density) moves a little
    between its steps, too: these small ones say nothing of the step, and a jump over a few steps is no spike.
    """
    moving = steps[steps > 0.0]
    if not len(moving):
        return 0.0
    large = np.quantile(moving, 0.9)
    if np.mean(steps <= SMALL * large) < STEPPED:
        return float(np.quantile(moving, 0.05))
    return float(np.median(steps[steps > SMALL * large]))


def despiked(flights: Flights) -> tuple[Flights, dict[str, int]]:
    """Replace isolated spikes by the median of their neighbours; the count of replaced samples by channel.

    A sample is a spike if it lies `SPIKE` local deviations from the median of five, and stands out of how fast the
    channel moves there. Steps, buffet and the sharp peaks of a doublet are kept: a median follows the first, the local
    deviation grows with the second, and the third are no further from the median than the channel goes in a sample.
    Nor are some steps of a quantised channel a spike, nor the `END` samples next to either end, which smoothing leaves
    rough and which have neighbours on one side. Source: Hampel's identifier.
    """
    channels, count = dict(flights.channels), {}
    for name in SPIKED:
        if name not in channels:
            continue
        x = np.array(channels[name])
        begin = 0
        for length in flights.lengths:
            part = x[begin : begin + length]
            part[:], spikes = _without_spikes(part)
            if spikes:
                count[name] = count.get(name, 0) + spikes
            begin += length
        channels[name] = jnp.asarray(x)
    return eqx.tree_at(lambda f: f.channels, flights, channels), count


def despiked_records(records: Sequence[FlightRecord]) -> tuple[list[FlightRecord], dict[str, int]]:
    """The records as `despiked` repairs them, and its count."""
    repaired, count = [], {}
    for record in records:
        channels = dict(record.channels)
        for name in SPIKED:
            if name in channels:
                channels[name], spikes = _without_spikes(channels[name])
                if spikes:
                    count[name] = count.get(name, 0) + spikes
        repaired.append(replace(record, channels=channels))
    return repaired, count


def _without_spikes(part: Float[np.ndarray, " n"]) -> tuple[Float[np.ndarray, " n"], int]:
    middle = median_filter(part, 5, mode="nearest")
    away = np.abs(part - middle)
    # The mean, not the median, of |away|: on a quantised channel the median is zero nearly everywhere.
    local = 1.25 * uniform_filter1d(away, NEAR, mode="nearest")
    steps = np.abs(np.diff(part))
    floor = 1.25 * np.mean(away) + _step_size(steps) + np.abs(part).max() * 1e-9
    pace = rank_filter(np.append(steps, 0.0), SLOW, BESIDE, mode="nearest")
    spikes = (away > SPIKE * np.maximum(local, floor)) & (away > BEYOND * pace)
    spikes[:END] = spikes[len(spikes) - END :] = False
    return np.where(spikes, middle, part), int(spikes.sum())
