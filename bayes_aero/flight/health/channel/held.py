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
CORNERS = 10  # between straight lines that a pattern needs
CLEAR = 30.0  # steps of rounding of the bends at corners that may lie between samples
SPARSE = 6.0  # samples between such corners from which their order is no chance
ENDS, STRAY = 15, 0.02  # lines that do not fit halfway, at least; share of as many that do not fit at the knots
FOLLOW = 0.15  # share of such lines that are followed by another: the answer to a step now and then has none
EVEN = 0.42  # steps of rounding: samples miss lines between rounded ends by the root of 5/36 = 0.37 of one
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
    """Samples between the corners of a signal that is made of straight lines; zero if it is not.

    Corners a whole number of samples apart are found under coarse rounding, others where they are far apart and clear.
    """
    bends = np.abs(np.diff(x, 2))
    if len(bends) < 4 * FEWEST or not bends.any():
        return 0.0
    period, step = float(_between_knots(x)), quantum(x)
    large = float(np.sort(bends)[-CORNERS])
    if not period and large > CLEAR * step and len(still_runs(x)) <= 0.1 * len(x):
        period = _between_corners(bends > max(STRAIGHT * large, ROUNDED * step))
    return period


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


def _between_knots(x: np.ndarray) -> int:
    """The largest whole period of straight lines between every so many of (n,) values; zero where there is none.

    Rounding moves no sample by more than a step from the line between two others. So the samples lie within a step of
    the lines between knots. They lie further from lines between the samples halfway. By chance `ENDS` lines are all of
    the second kind once in 2 to the power of `ENDS`. A smooth signal departs from both kinds or from neither. Knots
    between samples are not sought: under coarse rounding such a signal is not found.
    """
    best, step = 0, quantum(x)
    for period in range(2, min(SLOWEST, len(x) // FEWEST) + 1):
        lag = period // 2
        bends = (x[2 * lag :] - 2.0 * x[lag:-lag] + x[: -2 * lag]) ** 2
        corner = int(np.argmax(np.bincount((lag + np.arange(len(bends))) % period, bends, period)))
        on, off = _off_lines(x, corner, period), _off_lines(x, (corner + lag) % period, period)
        limit = 1.001 * max(step, STRAIGHT * float(np.sqrt(np.mean(off**2))))
        stray, ends = np.any(on > limit, axis=1), np.any(off > limit, axis=1)
        if ends.sum() < ENDS or stray.sum() > STRAY * ends.sum() or ends[1:][ends[:-1]].mean() < FOLLOW:
            continue
        if np.sqrt(np.mean(on[~stray] ** 2)) < EVEN * limit:
            best = period
    return best


def _off_lines(x: np.ndarray, first: int, period: int) -> np.ndarray:
    """How far the samples between every `period`-th one are from the line through these, (lines, period - 1)."""
    lines = (len(x) - 1 - first) // period
    part, along = x[first : first + lines * period + 1], np.arange(1, period) / period
    begin, end = part[:-1:period, None], part[period::period, None]
    return np.abs(part[:-1].reshape(lines, period)[:, 1:] - begin - (end - begin) * along)
