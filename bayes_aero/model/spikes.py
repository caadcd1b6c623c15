"""Repair of single wild samples (spikes) in recorded channels."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float, Shaped
from scipy.ndimage import median_filter, rank_filter, uniform_filter1d

from bayes_aero.arrays import Array
from bayes_aero.flight.record import FlightRecord

SPIKED = ("ax", "ay", "az", "p", "q", "r", "alpha", "beta", "airspeed", "theta", "phi", "altitude")
SPIKE_FACTOR = 7.0  # local standard deviations from the median of five neighbours
STEP_WINDOW, STEP_RANK = 7, 2  # the typical step is the third smallest of seven; two spikes make four large ones
STEP_FACTOR = 2.5  # typical steps from the median, at least
END_SAMPLES = 5  # samples at either end that are not repaired
LOCAL_WINDOW = 51  # samples of the local standard deviation
STEPPED_SHARE = 0.4  # share of small steps from which a channel is quantised
SMALL_STEP = 0.1  # of the large steps


def _step_size(steps: Float[np.ndarray, " n"]) -> float:
    """The quantisation step of a channel; a small step of the noise where the channel is not quantised.

    A channel computed from a quantised one (airspeed from a pressure, in air of changing density) also has small steps
    between the large ones; they are ignored. A jump over a few steps is no spike.
    """
    moving = steps[steps > 0.0]
    if not len(moving):
        return 0.0
    large = np.quantile(moving, 0.9)
    if np.mean(steps <= SMALL_STEP * large) < STEPPED_SHARE:
        return float(np.quantile(moving, 0.05))
    return float(np.median(steps[steps > SMALL_STEP * large]))


def without_spikes(
    channels: Mapping[str, Array], lengths: Sequence[int]
) -> tuple[dict[str, Shaped[np.ndarray, " n"]], dict[str, int]]:
    """Replace isolated spikes by the median of their neighbours; the count of replaced samples by channel.

    A sample is a spike if it differs from the median of five by more than `SPIKE_FACTOR` local standard deviations and
    by more than `STEP_FACTOR` typical steps of the channel. Steps, buffet and the sharp peaks of a doublet are kept:
    the median follows a step, the local deviation grows with buffet, and a peak differs from the median by no more than
    the channel changes in a sample. A few steps of a quantised channel are no spike. The `END_SAMPLES` at either end
    are not repaired, because smoothing does not reach them and their neighbours are on one side. Source: Hampel's
    identifier.
    """
    repaired_channels, count = {name: np.asarray(x) for name, x in channels.items()}, {}
    for name in (name for name in SPIKED if name in repaired_channels):
        parts = [_without_spikes(part) for part in np.split(repaired_channels[name], np.cumsum(lengths)[:-1])]
        if spikes := sum(n for _, n in parts):
            repaired_channels[name], count[name] = np.concatenate([part for part, _ in parts]), spikes
    return repaired_channels, count


def despiked_records(records: Sequence[FlightRecord]) -> tuple[list[FlightRecord], dict[str, int]]:
    """The records without spikes, and the number of replaced samples by channel; see `without_spikes`."""
    repaired_channels, count = [], {}
    for record in records:
        channels, spikes = without_spikes(record.channels, (record.n,))
        count |= {name: count.get(name, 0) + found for name, found in spikes.items()}
        repaired_channels.append(replace(record, channels=channels))
    return repaired_channels, count


def _without_spikes(part: Float[np.ndarray, " n"]) -> tuple[Float[np.ndarray, " n"], int]:
    median = median_filter(part, 5, mode="nearest")
    deviation = np.abs(part - median)
    # The mean, not the median, of |away|: on a quantised channel the median is zero nearly everywhere.
    local = 1.25 * uniform_filter1d(deviation, LOCAL_WINDOW, mode="nearest")
    steps = np.abs(np.diff(part))
    floor = 1.25 * np.mean(deviation) + _step_size(steps) + np.abs(part).max() * 1e-9
    typical_step = rank_filter(np.append(steps, 0.0), STEP_RANK, STEP_WINDOW, mode="nearest")
    spikes = (deviation > SPIKE_FACTOR * np.maximum(local, floor)) & (deviation > STEP_FACTOR * typical_step)
    spikes[:END_SAMPLES] = spikes[len(spikes) - END_SAMPLES :] = False
    return np.where(spikes, median, part), int(spikes.sum())
