"""A slow signal that was held or linearly interpolated onto a faster time base."""

from __future__ import annotations

import numpy as np

from bayes_aero.flight.card.card import Card
from bayes_aero.flight.health.finding import HealthFinding, found
from bayes_aero.flight.health.signals import quantum, runs_of, still_runs
from bayes_aero.flight.record import FlightRecord

FEWEST = 20  # changes of a channel that a pattern needs
ALIKE = 0.9  # share of the changes that follow the pattern
SLOWEST = 100  # samples between changes at most
COMBED = 40  # the same of bends, of which the largest fiftieth is clipped
CORNERS = 10  # between straight lines that a pattern needs
SPARSE = 6.0  # samples between corners from which their order is no chance of rounding; fewer are found by their class
ROUGH, ENDS, STRAY = 4, 15, 0.02  # samples of a line, ends of lines that bend, share of bends that are between ends
STRAIGHT = 1e-3  # of the bend at a corner that a straight line may have
ROUNDED = 2.5  # steps of rounding: second differences of a straight line reach two, as each value is off by a half
FAST = frozenset(
    "ax ay az p q r phi theta alpha beta elevator stabilizer rudder aileron aileron_left aileron_right".split()  # noqa: SIM905
)
"""Channels that move within tenths of a second."""


def held(record: FlightRecord, card: Card) -> list[HealthFinding]:  # noqa: ARG001 - the checks have one signature
    """A finding for each channel, or all that share a rate, whose true sampling rate is lower than the record's."""
    slow: dict[tuple[str, float], list[str]] = {}
    for name, x in record.channels.items():
        for how, period in (("held", held_period(x)), ("linearly interpolated", interpolated_period(x))):
            if period:
                slow.setdefault((how, round(period, 1)), []).append(name)
                break
    said = []
    for (how, period), names in slow.items():
        rate, delay = 1.0 / (period * record.dt), 0.5 * (period - 1.0) * record.dt
        fast = [n for n in names if n in FAST]
        late = f", on average {delay:.2g} s late" if how == "held" else ""
        mend = (
            f"resample the record to that rate (--resample {period * record.dt:.4g}), or record them faster"
            if fast
            else "harmless for a slow signal; do not read its noise as the sensor's"
        )
        them = f"{', '.join(names)} {'is' if len(names) == 1 else 'are'}"
        sentence = (
            f"{them} {how} over {period:.3g} samples: the true rate is {rate:.3g} Hz in a record of "
            f"{1.0 / record.dt:.4g} Hz{late}; {mend}"
        )
        channel = fast[0] if fast else names[0]
        said.append(found(record, channel, "held", sentence, at=(0, record.n - 1), grave=bool(fast)))
    return said


def held_period(x: np.ndarray) -> float:
    """Samples for which (n,) values are held, on average; zero if they are not."""
    changes = np.flatnonzero(np.diff(x))
    if len(changes) < FEWEST:
        return 0.0
    lengths = np.diff(changes)
    middle = float(np.median(lengths))
    if not 2.0 <= middle <= SLOWEST:
        return 0.0
    # Values may repeat from one true sample to the next, and a ratio of rates that is no integer gives two lengths.
    order = np.maximum(np.round(lengths / middle), 1.0)
    like = np.abs(lengths - order * middle) <= (0.0 if middle < 3.0 else 1.0) * order
    if np.mean(like) < ALIKE or np.mean(order == 1.0) < 0.5 or np.mean(lengths == 1) > 1.0 - ALIKE:
        return 0.0
    usual = lengths[like & (order == 1.0)]
    return float(np.mean(usual))


def interpolated_period(x: np.ndarray) -> float:
    """Samples between the corners of a signal that is made of straight lines; zero if it is not."""
    bends = np.abs(np.diff(x, 2))
    if len(bends) < 4 * FEWEST or not bends.any():
        return 0.0
    large, rounding = float(np.sort(bends)[-CORNERS]), ROUNDED * quantum(x)
    period = 0.0
    if large > rounding and len(still_runs(x)) <= 0.1 * len(x):  # else it bends by the last digit alone
        period = _between_corners(bends > max(STRAIGHT * large, rounding)) if large > 2.0 * rounding else 0.0
        period = period or float(_comb(bends**2))
    return period or float(_between_knots(x, rounding))


def _between_corners(bent: np.ndarray) -> float:
    """Samples between corners that follow each other evenly; zero where they do not."""
    corners = [first for first, _ in runs_of(bent)]
    if len(corners) <= CORNERS or bent.sum() > 2.1 * len(corners):  # two samples, where a corner falls between them
        return 0.0
    lengths = np.diff(corners)
    middle = float(np.median(lengths))
    order = np.maximum(np.round(lengths / middle), 1.0)  # a corner may be too flat to be seen
    like = np.abs(lengths - order * middle) <= order
    if middle < SPARSE or like.mean() < ALIKE or np.mean(order == 1.0) < 0.5:
        return 0.0
    return float(lengths.sum() / order.sum())


def _between_knots(x: np.ndarray, rounding: float) -> int:
    """The largest period of straight lines in (n,) values that are rounded coarsely; zero where there is none.

    Second differences over a quarter of a line reach `rounding` only near its ends. By chance they all fall into that
    half of the samples once in 2 to the power of `ENDS`.
    """
    best = 0
    for period in range(ROUGH, min(SLOWEST, len(x) // FEWEST) + 1):
        quarter = period // 4
        bends = np.abs(x[2 * quarter :] - 2.0 * x[quarter:-quarter] + x[: -2 * quarter])
        lines = len(bends) // period
        bent = bends[: lines * period].reshape(lines, period) > rounding
        near = sum(np.roll(bent.sum(axis=0), shift) for shift in range(-quarter, quarter + 1))
        corner = int(np.argmax(near))
        away = np.abs((np.arange(period) - corner + period // 2) % period - period // 2) > quarter
        knots = x[(corner + quarter) % period :: period]
        if (
            bent[:, ~away].any(axis=1).sum() >= ENDS
            and bent[:, away].sum() <= STRAY * bent.sum()
            and np.mean(np.abs(np.diff(knots)) > rounding) > 0.5
        ):
            best = period
    return best


def _comb(energy: np.ndarray) -> int:
    """The largest period whose one class of samples has nearly all of the bending."""
    best = 0
    clipped = np.minimum(energy, np.quantile(energy, 0.98))
    for period in range(2, min(COMBED, len(energy) // FEWEST) + 1):
        shares = np.bincount(np.arange(len(energy)) % period, weights=clipped, minlength=period)
        if shares.max() > 0.97 * shares.sum():
            best = period
    return best
