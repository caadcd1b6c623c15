"""Dropouts: samples at one constant (0, -9999, 99999 ...) far from what stands before and after them."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import median_filter

from bayes_aero.flight.card.card import Card
from bayes_aero.flight.health.channel.held import held_period
from bayes_aero.flight.health.finding import HealthFinding, as_filed, declared, found
from bayes_aero.flight.health.signals import CONTROLS, noise_of, quantum_of, runs_of
from bayes_aero.flight.record import FlightRecord

OFF = 8.0  # deviations of the noise, and sizes of the usual step, that a dropout is away from its neighbours
STEPS = 3.5  # recording steps that it is away at least
MOST = 0.25  # share of a record that is a dropout at most: beyond it, the rest would be the exception
STEP = 0.12  # s that a control may not be away: no actuator goes and comes back in that time
CONTINUOUS = 0.95  # share of levels that occur once in a channel whose equal samples are no chance
TRIED = 20  # constants, the most frequent first
USUAL = 0.9  # quantile of the steps that is called usual


def dropouts(record: FlightRecord, card: Card) -> list[HealthFinding]:
    """A finding for each channel with samples at a constant that its neighbours refute."""
    said = []
    for name, x in record.channels.items():
        if held_period(x):  # each of its steps would be one
            continue
        at, value = dropped(x, record.dt, control=name in CONTROLS)
        if not at.any():
            continue
        filed = float(as_filed(card, name, value))
        index = np.flatnonzero(at)
        unit = declared(card, name).unit
        times = ", ".join(f"{record.time[i]:.6g}" for i in index[:3]) + (" ..." if len(index) > 3 else "")
        sentence = (
            f"{name} drops to {filed:.6g} {'' if unit == '1' else unit + ' '}in {len(index)} of {record.n} samples "
            f"(t = {times} s), far from the samples around them: a dropout of the sensor or the recorder; cut these "
            "samples out or interpolate across them in the file"
        )
        said.append(found(record, name, "dropout", sentence, at=(int(index[0]), int(index[-1]))))
    return said


def dropped(x: np.ndarray, dt: float, *, control: bool = False) -> tuple[np.ndarray, float]:
    """Which of (n,) samples are dropouts, and the value they stand at; the value with most of them, if several."""
    nothing = np.zeros(len(x), bool)
    steps = np.abs(np.diff(x))
    if len(x) < 8 or not steps.any():
        return nothing, 0.0
    floor = max(OFF * noise_of(x), STEPS * quantum_of(x), 1e-9 * float(np.abs(x).max()))
    away = np.abs(x - median_filter(x, 5, mode="nearest"))
    jumps = np.concatenate([[0.0], steps])
    suspect = np.unique(x[(away > floor) | (jumps > floor)])
    best, value = nothing, 0.0
    levels, counts = np.unique(x, return_counts=True)
    repeated = dict(zip(levels, counts, strict=True))
    often = [level for level in suspect if repeated[level] > 1 or level == 0.0]
    for level in sorted(often, key=lambda level: -repeated[level])[:TRIED]:
        at = _at(x, level, floor, dt, control=control)
        if at.sum() > best.sum() and (level == 0.0 or sum(1 for _ in runs_of(at)) > 1 or at.sum() > 3):
            best, value = at, float(level)
    continuous = np.mean(counts[levels != value] == 1) > CONTINUOUS
    return (x == value) & (best.any() & continuous) | best, value


def _at(x: np.ndarray, level: float, floor: float, dt: float, *, control: bool) -> np.ndarray:
    """Samples at a level that lie `floor`, and several usual steps, from the line between their neighbours."""
    at = x == level
    kept = np.flatnonzero(~at)
    if not 0 < at.sum() <= MOST * len(x) or len(kept) < 8:
        return np.zeros(len(x), bool)
    line = np.interp(np.arange(len(x)), kept, x[kept])
    local = np.abs(np.diff(x[kept]))
    pace = np.interp(np.arange(len(x)), kept[1:], _pace(local))
    enough = np.maximum(floor, OFF * np.maximum(pace, 0.25 * np.quantile(local, USUAL)))
    found = np.zeros(len(x), bool)
    for first, last in runs_of(at):
        beside = [i for i in (first - 1, last + 1) if 0 <= i < len(x)]
        leaves = all(abs(x[i] - level) > enough[i] for i in beside)
        returns = len(beside) < 2 or abs(x[beside[0]] - x[beside[1]]) <= max(
            enough[first], 3.0 * (last - first + 2) * pace[first]
        )
        short = last - first + 1 <= max(1, STEP / dt) if control else True
        if leaves and returns and short and np.abs(line[first : last + 1] - level).min() > enough[first]:
            found[first : last + 1] = True
    return found


def _pace(steps: np.ndarray, width: int = 11) -> np.ndarray:
    return median_filter(steps, width, mode="nearest")
