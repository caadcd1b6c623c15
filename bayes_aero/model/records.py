"""Recorded channels of several manoeuvres, end to end, in modules that do not import JAX, for quick checks."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int, Shaped
from scipy.ndimage import median_filter, rank_filter, uniform_filter1d

from bayes_aero.arrays import AnyArray, namespace
from bayes_aero.effect import MARKS
from bayes_aero.effects import CATALOGUE
from bayes_aero.errors import InputError
from bayes_aero.flight.card import ATMOSPHERE, RULES, Card
from bayes_aero.flight.health import noise_of
from bayes_aero.flight.record import FlightRecord
from bayes_aero.model.model import own_effects
from bayes_aero.physics.aircraft import (
    COEFFICIENTS,
    FORMED_FROM,
    GAMMA,
    GAS,
    REQUIRED,
    Aircraft,
    Axis,
    air,
    standard_air,
)


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


class Forming(StrEnum):
    """How coefficients are formed from the record."""

    MATCHED = "matched"  # all signals at a common rate and filtered alike, also the inputs of the model
    PUBLISHED = "published"  # as the published ATTAS coefficients: accelerations filtered, controls and rates not


OFF_PAGE = 24  # samples


def shared_length(n: int) -> int:
    """The least of eight lengths an octave that holds `n` samples: flights of like length share compiled programs."""
    # A multiple of a page (512 numbers) would let rows of one sample share places of the cache, which takes twice as
    # long.
    return n + -n % (1 << max(n.bit_length() - 4, 0)) + OFF_PAGE


@dataclass(frozen=True, eq=False)
class Flights:
    """Channels (n,) in SI, with `dt`, `start`, `elapsed`, `first`, `last` beside them (see `effect.Stage`)."""

    # `held`: states that a simulation takes from the record, by the card.
    channels: dict[str, Any]
    aircraft: Aircraft
    manoeuvre: Int[np.ndarray, " n"]
    time: Float[np.ndarray, " n"]
    lengths: tuple[int, ...]
    names: tuple[str, ...]
    held: tuple[str, ...] = ()

    @property
    def n(self) -> int:
        return sum(self.lengths)

    @property
    def recorded(self) -> tuple[str, ...]:
        return tuple(name for name in self.channels if name not in MARKS)

    @cached_property
    def noise(self) -> dict[str, float]:
        """Standard deviation of the white noise of each recorded channel."""
        ends = np.cumsum(self.lengths)[:-1]
        return {name: noise_of(*np.split(np.asarray(self.channels[name]), ends)) for name in self.recorded}

    @property
    def nameless(self) -> Flights:
        """The same without names, so that records of any name share compiled programs."""
        return replace(self, names=())

    def regression(self) -> Any:
        """That of alpha-dot on the recorded channels; see `alpha_rate`."""
        from bayes_aero.physics.coefficients import lift_regression  # here, because it imports JAX

        dt, first, last = (self.channels[name] for name in ("dt", "first", "last"))
        return lift_regression(self.channels, self.aircraft.accelerometer, dt, first, last)

    def with_slopes(self, channels: Mapping[str, AnyArray], regression: Any = None) -> dict[str, Any]:
        """Channels (corrected ones, too) and their derivatives, manoeuvre by manoeuvre."""
        from bayes_aero.physics.coefficients import unsmoothed_joined

        dt, first, last = (self.channels[name] for name in ("dt", "first", "last"))
        regression = regression or self.regression()
        return unsmoothed_joined(channels, self.aircraft.accelerometer, dt, first, last, regression)

    @cached_property
    def longer(self) -> Flights:
        """As one of `shared_length` that stands still after its end, nameless."""
        n, whole = self.n, shared_length(self.n)
        at = np.minimum(np.arange(whole), n - 1)
        channels = {name: np.asarray(x)[at] for name, x in self.channels.items()}
        channels["start"][n:] = np.arange(n, whole) == n
        channels["first"][n:], channels["last"][n:] = n, whole - 1
        return Flights(channels, self.aircraft, self.manoeuvre[at], self.time[at], (whole,), (), self.held)

    @cached_property
    def padded(self) -> tuple[Flights, Any]:
        """`longer`, with the `regression` of what was recorded (NumPy's)."""
        regression = self.regression()
        before = np.append(regression.before, np.zeros(self.longer.n - self.n))
        return self.longer, regression._replace(before=before)


def join(
    records: Sequence[FlightRecord],
    card: Card,
    required: Sequence[str] = REQUIRED,
    remedy: Callable[[str], str] = "{}; map it on the card".format,
) -> Flights:
    """The records end to end, without channels that some record lacks; `InputError` where one is `required`, which
    ends in its name with a `remedy`."""
    if not records:
        raise InputError("there is no flight record to work on; name at least one file")
    names = [record.name for record in records]
    if len(set(names)) < len(names):
        raise InputError(f"two records are called {max(names, key=names.count)}; each manoeuvre needs its own name")
    parts, offset = [], 0
    for record in records:
        have = with_sums(record, card)
        for need in required:
            if need not in have:
                raise InputError(f"record {record.name} has no channel {remedy(need)}")
        parts.append(have | marks_of(record, offset))
        offset += record.n
    shared = set.intersection(*(set(part) for part in parts))
    return Flights(
        channels={name: np.concatenate([part[name] for part in parts]) for name in sorted(shared)},
        aircraft=card.aircraft,
        manoeuvre=np.repeat(np.arange(len(records)), [record.n for record in records]),
        time=np.concatenate([np.asarray(record.time) for record in records]),
        lengths=tuple(record.n for record in records),
        names=tuple(names),
        held=card.fly.held,
    )


MACH_VARIES, MACH_OFF = 0.005, 0.02  # of airspeed over Mach number: slow to fast flight; from the speed of sound


def marks_of(record: FlightRecord, first: int) -> dict[str, Shaped[np.ndarray, " n"]]:
    """Marks for effects of stage CHANNEL of a recorded manoeuvre, the first sample at index `first`."""
    follows = np.full(record.n, 0.0 if own_mach(record) else 1.0)
    return plain_marks(record.n, record.dt, first) | {"mach_follows": follows}


def own_mach(record: FlightRecord) -> bool:
    """Whether the Mach number was not computed from the recorded airspeed, so that an error of this is not in it."""
    if not all(record.has(name) for name in ("mach", "airspeed")):
        return False
    # Then V / M is no speed of sound: it varies with the airspeed, or is not that of the temperature.
    V, M, sound = record["airspeed"], record["mach"], np.ones(record.n)
    measured = record.has("static_temperature") and bool(np.all(record["static_temperature"] > 0.0))
    if measured:
        sound = np.sqrt(GAMMA * GAS * record["static_temperature"])
    elif record.has("altitude"):
        sound = standard_air(record["altitude"])[1]
    moving = (M > 0.05) & np.isfinite(V / sound)
    if moving.mean() < 0.5:
        return False
    ratio, slow = np.log(V[moving] / (M * sound)[moving]), V[moving] < np.median(V[moving])
    varies = abs(float(np.median(ratio[slow]) - np.median(ratio[~slow]))) if 0 < slow.sum() < len(slow) else 0.0
    return varies > MACH_VARIES or (measured and abs(float(np.median(ratio))) > MACH_OFF)


def plain_marks(n: int, dt: float, first: int = 0) -> dict[str, Shaped[np.ndarray, " n"]]:
    """Marks of one manoeuvre of `n` samples without a record: its Mach number follows the airspeed."""
    index = np.arange(n)
    return {
        "dt": np.full(n, dt),
        "start": index == 0,
        "elapsed": index * dt,
        "first": np.full(n, first),
        "last": np.full(n, first + n - 1),
        "mach_follows": np.ones(n),
    }


def despiked(flights: Flights) -> tuple[Flights, dict[str, int]]:
    """The manoeuvres without spikes, and the number of replaced samples by channel; see `without_spikes`."""
    mended, count = without_spikes(flights.channels, flights.lengths)
    mended = {name: namespace(flights.channels[name]).asarray(x) for name, x in mended.items()}
    return replace(flights, channels=flights.channels | mended), count


MIN_WINDOW_SHARE = 0.5  # of a window: a shorter remainder at the end of a manoeuvre joins the window before it


def cuts_of(samples: int, dt: float, window: float | None) -> list[int]:
    """First samples of windows of about `window` s (None: one window) of a manoeuvre of so many samples."""
    length = samples if window is None else max(2, round(window / dt))
    cuts = list(range(0, samples, length))
    if len(cuts) > 1 and samples - cuts[-1] < MIN_WINDOW_SHARE * length:
        cuts.pop()
    return cuts


# --- Repair of single wild samples (spikes) in recorded channels.

SPIKED = ("ax", "ay", "az", "p", "q", "r", "alpha", "beta", "airspeed", "theta", "phi", "altitude")
SPIKE_FACTOR = 7.0  # local standard deviations from the median of five neighbours
STEP_WINDOW, STEP_RANK = 7, 2  # the typical step is the third smallest of seven; two spikes make four large ones
STEP_FACTOR = 2.5  # typical steps from the median, at least
END_SAMPLES = 5  # samples at either end that are not repaired
LOCAL_WINDOW = 51  # samples of the local standard deviation
STEPPED_SHARE = 0.4  # share of small steps from which a channel is quantised
SMALL_STEP = 0.1  # of the large steps


def without_spikes(
    channels: Mapping[str, AnyArray], lengths: Sequence[int]
) -> tuple[dict[str, Shaped[np.ndarray, " n"]], dict[str, int]]:
    """Channels with isolated spikes, replaced by the median of their neighbours; the count of replaced samples."""
    # A sample is a spike if it differs from the median of five by more than `SPIKE_FACTOR` local standard deviations
    # and by more than `STEP_FACTOR` typical steps of the channel. Steps, buffet and the sharp peaks of a doublet are
    # kept: the median follows a step, the local deviation grows with buffet, and a peak differs from the median by no
    # more than the channel changes in a sample. A few steps of a quantised channel are no spike. The `END_SAMPLES` at
    # either end are not repaired, because smoothing does not reach them and their neighbours are on one side. Source:
    # Hampel's identifier.
    mended, count = {}, {}
    for name in (name for name in SPIKED if name in channels):
        parts = np.split(np.asarray(channels[name]), np.cumsum(lengths)[:-1])
        medians = [median_filter(part, 5, mode="nearest") for part in parts]
        spikes = list(map(_spikes, parts, medians))
        if any(at.any() for at in spikes):
            mended[name] = np.concatenate(list(map(np.where, spikes, medians, parts)))
            count[name] = int(sum(at.sum() for at in spikes))
    return mended, count


def _spikes(part: Float[np.ndarray, " n"], median: Float[np.ndarray, " n"]) -> Bool[np.ndarray, " n"]:
    deviation, steps = np.abs(part - median), np.abs(np.diff(part))
    # The mean, not the median, of |away|: on a quantised channel the median is zero nearly everywhere.
    local = 1.25 * uniform_filter1d(deviation, LOCAL_WINDOW, mode="nearest")
    # The quantisation step; a small step of the noise where the channel is not quantised. A channel computed from a
    # quantised one (airspeed from a pressure, in air of changing density) also has small steps between the large ones;
    # they are ignored. A jump over a few steps is no spike.
    moving, quantum = steps[steps > 0.0], 0.0
    if len(moving):
        large = np.quantile(moving, 0.9)
        quantised = np.mean(steps <= SMALL_STEP * large) >= STEPPED_SHARE
        quantum = np.median(steps[steps > SMALL_STEP * large]) if quantised else np.quantile(moving, 0.05)
    floor = 1.25 * np.mean(deviation) + float(quantum) + np.abs(part).max() * 1e-9
    typical_step = rank_filter(np.append(steps, 0.0), STEP_RANK, STEP_WINDOW, mode="nearest")
    spikes = (deviation > SPIKE_FACTOR * np.maximum(local, floor)) & (deviation > STEP_FACTOR * typical_step)
    spikes[:END_SAMPLES] = spikes[len(spikes) - END_SAMPLES :] = False
    return spikes


def despiked_records(records: Sequence[FlightRecord]) -> tuple[list[FlightRecord], dict[str, int]]:
    """The records without spikes, and the number of replaced samples by channel; see `without_spikes`."""
    repaired, count = [], {}
    for record in records:
        mended, spikes = without_spikes(record.channels, (record.n,))
        count |= {name: count.get(name, 0) + replaced for name, replaced in spikes.items()}
        repaired.append(replace(record, channels={**record.channels, **mended}))
    return repaired, count


# --- Removal of an axis from a card where records lack its channels.

FORMED = ("alpha_dot",)  # from recorded channels, in any record


def on_recorded_axes(
    card: Card,
    records: Sequence[FlightRecord],
    needed: Mapping[Axis, Sequence[str]] = FORMED_FROM,
    made: Collection[str] = FORMED,
) -> tuple[Card, tuple[str, ...]]:
    """The card without an axis whose channels some record lacks, and a sentence on each that is left out."""
    # A card of one axis, or one whose axes all lack channels, is unchanged: they are reported later. `needed`: channels
    # of each axis beside those of its effects; `made`: channels that effects read and that are computed from others.
    if len(card.axes) < 2 or not records:
        return card, ()
    catalogue = {**CATALOGUE, **own_effects(card.effect_files)}
    every = [catalogue[name] for name in card.effects if name in catalogue]
    present = [(record.name, with_sums(record, card)) for record in records]
    lacking: dict[Axis, tuple[str, list[str]]] = {}  # the first record that lacks channels of an axis, and these
    for axis in card.axes:
        channels = (channel for effect in every if effect.axes == (axis,) for channel in effect.channels)
        required = dict.fromkeys((*needed[axis], *channels))
        for name, have in present:
            if lacks := [need for need in required if need not in have and need not in made]:
                lacking.setdefault(axis, (name, lacks))
    kept = tuple(axis for axis in card.axes if axis not in lacking)
    if not kept or kept == card.axes:
        return card, ()
    unknown = {name for _, lacks in lacking.values() for name in lacks}
    gone = {e.name for e in every if not e.acts_on(kept) or not unknown.isdisjoint(e.channels)}
    theirs = {p.name for name in gone for p in catalogue[name].parameters}
    fewer = replace(
        card,
        axes=kept,
        effects=tuple(name for name in card.effects if name not in gone),
        fixed={name: x for name, x in card.fixed.items() if name not in theirs},
        changes={name: x for name, x in card.changes.items() if name not in theirs},
    )
    return fewer, tuple(
        f"The {axis.value} axis ({', '.join(COEFFICIENTS[axis])}) is left out: record {record} has no channel "
        f"{', '.join(lacks)}; map {'it' if len(lacks) == 1 else 'them'} on the card to include it."
        for axis, (record, lacks) in lacking.items()
    )
