"""Single wild samples in recorded channels, and what takes their place."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float, Shaped
from scipy.ndimage import median_filter, rank_filter, uniform_filter1d

from bayes_aero.arrays import Array
from bayes_aero.flight.record import FlightRecord

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


def without_spikes(
    channels: Mapping[str, Array], lengths: Sequence[int]
) -> tuple[dict[str, Shaped[np.ndarray, " n"]], dict[str, int]]:
    """Replace isolated spikes by the median of their neighbours; the count of replaced samples by channel.

    A sample is a spike if it lies `SPIKE` local deviations from the median of five, and stands out of how fast the
    channel moves there. Steps, buffet and the sharp peaks of a doublet are kept: a median follows the first, the local
    deviation grows with the second, and the third are no further from the median than the channel goes in a sample.
    Nor are some steps of a quantised channel a spike, nor the `END` samples next to either end, which smoothing leaves
    rough and which have neighbours on one side. Source: Hampel's identifier.
    """
    mended, count = {name: np.asarray(x) for name, x in channels.items()}, {}
    for name in (name for name in SPIKED if name in mended):
        parts = [_without_spikes(part) for part in np.split(mended[name], np.cumsum(lengths)[:-1])]
        if spikes := sum(n for _, n in parts):
            mended[name], count[name] = np.concatenate([part for part, _ in parts]), spikes
    return mended, count


def despiked_records(records: Sequence[FlightRecord]) -> tuple[list[FlightRecord], dict[str, int]]:
    """The records as `without_spikes` mends them, and its count."""
    mended, count = [], {}
    for record in records:
        channels, spikes = without_spikes(record.channels, (record.n,))
        count |= {name: count.get(name, 0) + found for name, found in spikes.items()}
        mended.append(replace(record, channels=channels))
    return mended, count


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
