"""Interpolation of an unevenly sampled record onto an even grid, done only when asked for."""

from __future__ import annotations

import math

import numpy as np

from bayes_aero.errors import InputError
from bayes_aero.flight.record import FlightRecord

__all__ = ["MAX_GAP", "resample_record"]

MAX_GAP = 5.0
"""Longest step, in median steps, that is bridged; beyond it interpolation would invent flight data."""

MAX_SAMPLES = 5_000_000

# Angles that jump by a full turn in files; interpolating across the jump would sweep through the whole
# circle.
_WRAPPED = ("phi", "psi", "longitude")
_STEPWISE = ("gear",)


def resample_record(record: FlightRecord, dt: float, max_gap: float = MAX_GAP) -> FlightRecord:
    """The record on the grid time[0], time[0] + dt, ... by cubic interpolation.

    Args:
        record: finite, with increasing time.
        dt: the new interval, s. A coarser one than the record's is low-pass filtered first, against aliasing.
        max_gap: a step longer than this many median steps is refused.

    The last sample is dropped unless it falls on the grid. Heading, bank and longitude come back unwrapped.
    """
    if not (math.isfinite(dt) and dt > 0.0):
        raise InputError(f"record {record.name}: cannot resample to an interval of {dt!r} s; give a positive number")
    step = np.diff(record.time)
    median = float(np.median(step))
    if (step > max_gap * median).any():
        i = int(np.argmax(step > max_gap * median))
        raise InputError(
            f"record {record.name}: channel time has a gap of {step[i]:.6g} s after sample {i} (counted "
            f"from 0; "
            f"t = {record.time[i]:.6g} s), longer than the {max_gap:g} median steps ({max_gap * median:.4g} "
            f"s) that "
            f"resampling bridges; cut the record there into two files"
        )
    # A coarse grid is reached through a fine one about as dense as the record: interpolate, filter, thin out.
    factor = max(1, math.ceil(dt / median - 1e-6)) if dt > 1.001 * median else 1
    fine = dt / factor
    duration = float(record.time[-1] - record.time[0])
    if duration / fine > MAX_SAMPLES:
        raise InputError(
            f"record {record.name}: resampling {duration:.6g} s to {dt:g} s makes more than {MAX_SAMPLES} "
            f"samples; "
            f"give a longer interval (the median step is {median:.6g} s)"
        )
    elapsed = np.arange(math.floor(duration / fine * (1.0 + 1e-12) + 1e-9) + 1) * fine
    time = np.minimum(record.time[0] + elapsed, record.time[-1])
    return FlightRecord(
        name=record.name,
        time=record.time[0] + elapsed[::factor],
        channels={key: _onto(record, key, time, factor) for key in record.channels},
        source=f"{record.source}, resampled to {dt:g} s",
        sha256=record.sha256,
        dropped=record.dropped,
    )


def _onto(record: FlightRecord, name: str, time: np.ndarray, factor: int) -> np.ndarray:
    values = record.channels[name]
    if name in _STEPWISE:
        return values[np.searchsorted(record.time, time, side="right") - 1][::factor]
    from scipy.interpolate import CubicSpline
    from scipy.signal import resample_poly

    if name in _WRAPPED:
        values = np.unwrap(values)
    with np.errstate(all="ignore"):  # numbers near the largest double overflow; the check afterwards tells it
        values = CubicSpline(record.time, values)(time)
        # "line": the filter sees the record go on along its trend, not fall to zero, at both ends.
        return values if factor == 1 else resample_poly(values, 1, factor, padtype="line")
