"""A channel that is cut off at the end of its range."""

from __future__ import annotations

import numpy as np

from bayes_aero.flight.card.card import Card
from bayes_aero.flight.health.finding import HealthFinding, found, shown, span
from bayes_aero.flight.health.signals import level_step, noise_of, quantum, quantum_of, runs_of
from bayes_aero.flight.record import FlightRecord

SENSED = ("ax", "ay", "az", "p", "q", "r", "phi", "theta", "alpha", "beta", "airspeed")
FEWEST = 6  # samples at the limit
LONGEST = 3  # samples in a row of which a noisy channel has none at its very extreme
NOISELESS = 1e-6  # noise over range that no sensor has
NEAR = 4  # samples beside the run, at least, from which the slope is read
SCATTERS = 0.03  # share of equal neighbours elsewhere up to which equal samples at an extreme are no chance
SURE = 3.0  # steps of recording that such a signal scatters by
MORE = 5.0  # recording steps, or deviations of the noise, that the signal would have gone beyond
MOST = 0.5  # share of the record at the limit at most: a channel that stands there is no cut-off peak


def saturated(record: FlightRecord, card: Card) -> list[HealthFinding]:
    """A finding for each measured channel with a flat top or bottom that the signal runs into."""
    said = []
    for name in SENSED:
        x = record.channels.get(name)
        if x is None or np.ptp(x) == 0.0:
            continue
        for extreme, end in ((float(x.max()), "upper"), (float(x.min()), "lower")):
            run = _flat(x, extreme)
            if run is None:
                continue
            first, last = run
            count = int(np.sum(x == extreme))
            sentence = (
                f"{name} is cut off at {shown(card, name, extreme)}, the {end} end of its range: {count} samples "
                f"stand there, the longest stretch {span(record, first, last)}; the sensor or its converter is "
                "saturated, so cut these parts out or use a sensor of larger range"
            )
            said.append(found(record, name, "saturated", sentence, at=(first, last)))
    return said


def _flat(x: np.ndarray, extreme: float) -> tuple[int, int] | None:
    """The longest run at the extreme, where the signal would have gone well beyond it."""
    at = x == extreme
    runs = [(a, b) for a, b in runs_of(at) if a > 0 and b < len(x) - 1]
    if not FEWEST <= int(at.sum()) <= MOST * len(x) or not runs:
        return None
    first, last = max(runs, key=lambda run: run[1] - run[0])
    if last - first + 1 < LONGEST:
        return None
    if int(at.sum()) <= 1.2 * (last - first + 1) and _jumps_away(x, first, last):  # frozen there by chance
        return None
    if noise_of(x) < NOISELESS * np.ptp(x):  # a simulation without noise has exact rests
        return None
    others = np.diff(x)[~(at[1:] & at[:-1])]
    if np.mean(others == 0.0) < SCATTERS and noise_of(x) > SURE * quantum(x):
        return first, last  # a signal that moves by many of its steps from sample to sample rests nowhere by chance
    step = max(level_step(x), quantum_of(x), quantum(x), noise_of(x))
    return (first, last) if _beyond(x, first, last) > MORE * step else None


def _jumps_away(x: np.ndarray, first: int, last: int) -> bool:
    """Whether the signal leaves its only run at the extreme by a step that it does not make on the way in."""
    usual = max(float(np.quantile(np.abs(np.diff(x)), 0.9)), abs(x[first] - x[first - 1]))
    return bool(abs(x[last + 1] - x[last]) > 2.0 * usual)


def _beyond(x: np.ndarray, first: int, last: int) -> float:
    """How far the signal would have gone on beyond the run: half its length at the slope on both sides.

    A slope read over less than half the run would be that of one step of a rounded peak, which stays below four steps.
    """
    length = last - first + 1
    beside = min(length, max(NEAR, length // 2))
    before, after = max(first - beside, 0), min(last + beside, len(x) - 1)
    into = abs(x[first] - x[before]) / max(first - before, 1)
    out = abs(x[after] - x[last]) / max(after - last, 1)
    return 0.5 * length * min(into, out)
