"""Recorded channels of several manoeuvres, end to end, as NumPy arrays, for checks without JAX."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float, Int, Shaped

from bayes_aero.effect import MARKS
from bayes_aero.errors import InputError
from bayes_aero.flight.aircraft import Aircraft
from bayes_aero.flight.card.card import Card
from bayes_aero.flight.health.standard import GAMMA, GAS, standard_air
from bayes_aero.flight.record import FlightRecord
from bayes_aero.model.derived_channels import with_sums
from bayes_aero.model.spikes import without_spikes
from bayes_aero.physics.coefficient_names import REQUIRED


@runtime_checkable
class Recorded(Protocol):
    """Channels (n,) of manoeuvres laid end to end, of either library: `Joined`, or `Flights`."""

    @property
    def channels(self) -> dict[str, Any]: ...

    @property
    def aircraft(self) -> Aircraft: ...

    @property
    def manoeuvre(self) -> np.ndarray: ...

    @property
    def time(self) -> np.ndarray: ...

    @property
    def lengths(self) -> tuple[int, ...]: ...

    @property
    def names(self) -> tuple[str, ...]: ...

    @property
    def n(self) -> int: ...

    @property
    def recorded(self) -> tuple[str, ...]: ...


@dataclass(frozen=True)
class Joined:
    """Channels (n,) in SI, with `dt`, `start`, `elapsed`, `first`, `last` beside them (see `effect.Stage`).

    `held`: states that a simulation takes from the record, by the card.
    """

    channels: dict[str, Shaped[np.ndarray, " n"]]
    aircraft: Aircraft
    manoeuvre: Int[np.ndarray, " n"]
    time: Float[np.ndarray, " n"]
    lengths: tuple[int, ...]
    names: tuple[str, ...]
    held: tuple[str, ...] = ()

    @property
    def n(self) -> int:
        """Number of samples."""
        return sum(self.lengths)

    @property
    def recorded(self) -> tuple[str, ...]:
        """Names of the recorded channels and card sums, without what was added."""
        return tuple(name for name in self.channels if name not in MARKS)


def joined(records: Sequence[FlightRecord], card: Card, required: Sequence[str] = REQUIRED) -> Joined:
    """Join the records end to end; channels that are not in every record are left out.

    Raises:
        InputError: there is no record, two have one name, or a `required` channel is missing.
    """
    if not records:
        raise InputError("there is no flight record to work on; name at least one file")
    named_apart(records)
    parts, offset = [], 0
    for record in records:
        have = with_sums(record, card)
        for need in required:
            if need not in have:
                raise InputError(f"record {record.name} has no channel {need}; map it on the card")
        parts.append(have | marks_of(record, offset))
        offset += record.n
    shared = set.intersection(*(set(part) for part in parts))
    return Joined(
        channels={name: np.concatenate([part[name] for part in parts]) for name in sorted(shared)},
        aircraft=card.aircraft,
        manoeuvre=np.repeat(np.arange(len(records)), [record.n for record in records]),
        time=np.concatenate([np.asarray(record.time) for record in records]),
        lengths=tuple(record.n for record in records),
        names=tuple(record.name for record in records),
        held=card.fly.held,
    )


def named_apart(records: Sequence[FlightRecord]) -> list[str]:
    """The records' names; raises `InputError` where two are the same."""
    names = [record.name for record in records]
    if len(set(names)) < len(names):
        raise InputError(f"two records are called {max(names, key=names.count)}; each manoeuvre needs its own name")
    return names


MACH_VARIES, MACH_OFF = 0.005, 0.02  # of airspeed over Mach number: slow to fast flight; from the speed of sound


def marks_of(record: FlightRecord, first: int) -> dict[str, Shaped[np.ndarray, " n"]]:
    """Marks for effects of stage CHANNEL of a recorded manoeuvre, the first sample at index `first`."""
    marks = plain_marks(record.n, record.dt, first)
    return marks | {"mach_follows": marks["mach_follows"] * (0.0 if own_mach(record) else 1.0)}


def own_mach(record: FlightRecord) -> bool:
    """Whether the Mach number was not computed from the recorded airspeed, so that an error of this is not in it.

    Then airspeed over Mach number is no speed of sound: it varies with the airspeed, or is not that of the temperature.
    """
    if not all(record.has(name) for name in ("mach", "airspeed")):
        return False
    V, M = record["airspeed"], record["mach"]
    measured = record.has("static_temperature") and bool(np.all(record["static_temperature"] > 0.0))
    sound = np.ones(record.n)
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


def plain_marks(n: int, dt: float, first: int) -> dict[str, Shaped[np.ndarray, " n"]]:
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


def repaired(flights: Joined) -> tuple[Joined, dict[str, int]]:
    """The manoeuvres without spikes, and the number of replaced samples by channel; see `without_spikes`."""
    channels, count = without_spikes(flights.channels, flights.lengths)
    return replace(flights, channels=channels), count


MIN_WINDOW_SHARE = 0.5  # of a window: a shorter remainder at the end of a manoeuvre joins the window before it


def cuts_of(samples: int, dt: float, window: float | None) -> list[int]:
    """First samples of windows of about `window` s (None: one window) of a manoeuvre of so many samples."""
    length = samples if window is None else max(2, round(window / dt))
    cuts = list(range(0, samples, length))
    if len(cuts) > 1 and samples - cuts[-1] < MIN_WINDOW_SHARE * length:
        cuts.pop()
    return cuts
