"""Simple measures of a recorded signal: how it scatters, steps, repeats."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from bayes_aero.flight.card.card import Card
from bayes_aero.flight.health.finding import Findings, found
from bayes_aero.flight.record import FlightRecord

CONTROLS = frozenset(
    {"elevator", "elevator_left", "elevator_right", "elevon_left", "elevon_right", "canard", "stabilizer", "rudder"}
    | {"aileron", "aileron_left", "aileron_right", "flap", "spoiler_left", "spoiler_right", "dlc_left", "dlc_right"}
    | {"gear", "engine_speed", "throttle", "throttle_left", "throttle_right", "n1_left", "n1_right", "fuel_used"}
    | {"thrust_left", "thrust_right", "thrust"}
)
"""Channels that may rightly stand still, step, and rest at a stop."""

NOISY = 0.5  # of the variance: beyond it a function of the channel is one of its noise; our choice
STEPPED, SMALL = 0.4, 0.1  # share of steps that are smaller than a tenth of the large ones: Gaussian noise has 0.13


def channels_of(record: FlightRecord, card: Card) -> dict[str, np.ndarray]:
    """The record's channels and what the card states where nothing was recorded, each (n,) in SI."""
    stated = {name: np.full(record.n, value) for name, value in card.constants.items()}
    return {**stated, **record.channels}


def noise_of(*parts: np.ndarray) -> float:
    """Standard deviation of the noise of (n,) samples that is new at each, outliers left out; zero below 8 samples.
    Steps, spikes and passages of buffet do not count; a channel that mostly stands still has none. Source: third
    differences of white noise have 20 times its variance; 1.4826 times the median of their size is their standard
    deviation. Several `parts` follow each other with gaps."""
    if sum(map(len, parts)) < 8:
        return 0.0
    third = np.concatenate([np.diff(x, 3) for x in parts])
    return float(1.4826 * np.median(np.abs(third)) / np.sqrt(20.0))


def noise_alone(x: np.ndarray, *parts: np.ndarray) -> bool:
    """Whether more than half of what (n,) samples scatter about the mean of their manoeuvre is white noise. `parts` are
    the same samples, manoeuvre by manoeuvre; left out, they are one."""
    parts = parts or (x,)
    return bool(noise_of(*parts) ** 2 > NOISY * float(sum(len(p) * np.var(p) for p in parts)) / len(x))


def quantum_of(x: np.ndarray) -> float:
    """The step in which (n,) samples are recorded; zero if they are continuous. Channels computed from a quantised one
    (airspeed from a pressure) move a little between its steps: steps below a tenth of the large ones are not counted
    where they are many."""
    steps = np.abs(np.diff(x))
    if not np.any(steps > 0.0):
        return 0.0
    large = float(np.quantile(steps[steps > 0.0], 0.9))
    if np.mean(steps <= SMALL * large) < STEPPED:
        nonzero = steps[steps > 1e-9 * large]
        repeated = 1.0 - len(np.unique(x)) / len(x)
        return float(np.quantile(nonzero, 0.05)) if repeated > 0.5 else 0.0
    return float(np.median(steps[steps > SMALL * large]))


def level_step(x: np.ndarray) -> float:
    """The distance of neighbouring levels of (n,) samples that take few values; zero if they take many."""
    levels = np.unique(x)
    if len(levels) < 2 or len(levels) > len(x) / 4:
        return 0.0
    gaps = np.diff(levels)
    return float(np.median(gaps[gaps > 1e-6 * np.ptp(levels)]))


def quantum(x: np.ndarray) -> float:
    """The least distance of different values among (n,) samples, which is that of the last digit written; 0 if none."""
    gaps = np.diff(np.unique(x))
    gaps = gaps[gaps > 1e-9 * np.max(np.abs(x), initial=0.0)]
    return float(gaps.min()) if len(gaps) else 0.0


def runs_of(equal: np.ndarray) -> Iterator[tuple[int, int]]:
    """First and last index of each run of true values."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], equal.astype(np.int8), [0]])))
    for first, after in edges.reshape(-1, 2):
        yield int(first), int(after) - 1


def still_runs(x: np.ndarray) -> list[tuple[int, int]]:
    """First and last sample of each run of two or more equal values."""
    return [(first, last + 1) for first, last in runs_of(np.diff(x) == 0.0)]


# --- Records of different sampling rates in one job.

ALIKE = 0.01  # relative difference of rates that is none


def different_rates(records: Sequence[FlightRecord]) -> Findings:
    """A finding for the first record whose rate is not that of the others, with all rates."""
    rates = np.array([1.0 / record.dt for record in records])
    off = np.flatnonzero(np.abs(np.log(rates / rates[:1])) > ALIKE)
    if not len(off):
        return
    listed = ", ".join(f"{r.name} {rate:.4g} Hz" for r, rate in zip(records, rates, strict=True))
    sentence = (
        f"the records have different sampling rates ({listed}): filters span samples, so derivatives and noise differ "
        f"between them; identify brings them to the lowest rate by default, elsewhere resample "
        f"(--resample {1.0 / rates.min():.4g})"
    )
    yield found(records[int(off[0])], "time", "rates", sentence)
