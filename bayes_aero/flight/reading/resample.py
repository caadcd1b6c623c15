"""Interpolation of a record of uneven or of several rates onto an even grid, done only when asked for."""

from __future__ import annotations

import math

import numpy as np

from bayes_aero.errors import InputError
from bayes_aero.flight.health.channel import held_period
from bayes_aero.flight.record import FlightRecord
from bayes_aero.units import instant

MAX_GAP = 5.0  # longest step, in median steps, that is bridged; beyond it interpolation would invent flight data
MAX_SAMPLES = 5_000_000

# Angles that jump by a full turn in files; interpolating across the jump would sweep through the whole
# circle.
_WRAPPED = ("phi", "psi", "longitude")
SHOWN = 4  # parts in a sentence
_STEPWISE = ("gear",)


def resample_record(record: FlightRecord, dt: float, max_gap: float = MAX_GAP) -> FlightRecord:
    """The record on the grid t0, t0 + dt, ... by cubic interpolation of each channel between its own samples.

    Args:
        record: with increasing time. A channel may be NaN where a slower sensor has no sample, or hold its last value
            there: only its true samples are used then, and a remark says so.
        dt: the new interval, s. A coarser one than the record's is low-pass filtered first, against aliasing.
        max_gap: a step longer than this many median steps (of the channel) is refused.

    Returns:
        From the first to the last instant at which all channels are known; the last sample is dropped unless it falls
        on the grid. Heading, bank and longitude come back unwrapped.
    """
    if not (math.isfinite(dt) and dt > 0.0):
        raise InputError(f"record {record.name}: cannot resample to an interval of {dt!r} s; give a positive number")
    knots = {name: sampled_at(name, values) for name, values in record.channels.items()}
    steps = [_bridged(record.name, n, record.time[own], max_gap) for n, own in knots.items() if len(own) < record.n]
    if len(steps) < len(knots) or not knots:  # time belongs to the channels that have all samples
        steps.append(_bridged(record.name, "time", record.time, max_gap))
    median = min(steps)
    begin = max((record.time[own[0]] for own in knots.values()), default=record.time[0])
    end = min((record.time[own[-1]] for name, own in knots.items() if np.isnan(record[name]).any()), default=np.inf)
    begin, end = float(begin), float(min(end, record.time[-1]))
    # A coarse grid is reached through a fine one about as dense as the record: interpolate, filter, thin out.
    factor = max(1, math.ceil(dt / median - 1e-6)) if dt > 1.001 * median else 1
    fine = dt / factor
    duration = end - begin
    if duration / fine > MAX_SAMPLES:
        raise InputError(
            f"record {record.name}: resampling {duration:.6g} s to {dt:g} s makes more than {MAX_SAMPLES} samples; "
            f"give a longer interval (the median step is {median:.6g} s)"
        )
    elapsed = np.arange(math.floor(duration / fine * (1.0 + 1e-12) + 1e-9) + 1) * fine
    time = np.minimum(begin + elapsed, end)
    return FlightRecord(
        name=record.name,
        time=begin + elapsed[::factor],
        channels={key: _onto(record, key, knots[key], time, factor) for key in record.channels},
        source=f"{record.source}, resampled to {dt:g} s",
        sha256=record.sha256,
        dropped=record.dropped,
        remarks=(*record.remarks, *_told(record, knots, median, dt)),
        read={**record.read, "resample": dt} if record.read else {},
    )


def _bridged(record: str, name: str, time: np.ndarray, max_gap: float) -> float:
    """The median step, s; refused where a step is too long to interpolate across."""
    step = np.diff(time)
    if len(step) < 3:
        raise InputError(f"record {record}: channel {name} has {len(time)} samples, too few to interpolate between")
    median = float(np.median(step))
    long = np.flatnonzero(step > max_gap * median)
    if len(long):
        i, mend = int(long[0]), "cut the record there into two (--split, or FILE@FROM:TO)"
        if name != "time":
            begin, end = ["", *map(instant, time[long + 1])], [*map(instant, time[long]), ""]
            parts = [f"FILE@{a}:{b}" for a, b in zip(begin, end, strict=True)]
            mend = (
                f"give {' '.join(parts[:SHOWN])}{' ...' if len(parts) > SHOWN else ''} instead of the file (there is "
                "none in time, so --split does not help), or take the channel off the card if it is not needed"
            )
        raise InputError(
            f"record {record}: channel {name} has a gap of {step[i]:.6g} s after t = {instant(time[i])} s, longer than "
            f"the {max_gap:g} median steps ({max_gap * median:.4g} s) that resampling bridges; {mend}"
        )
    return median


def sampled_at(name: str, values: np.ndarray) -> np.ndarray:
    """Where a channel was truly sampled: not where it is missing, nor where a slower sensor's value is only held."""
    there = np.flatnonzero(np.isfinite(values))
    period = 0.0 if name in _STEPWISE or len(there) < len(values) else held_period(values)
    if not period:
        return there
    changes = np.flatnonzero(np.diff(values)) + 1
    lengths = np.diff(np.r_[changes, len(values)])
    pieces = np.maximum(np.round(lengths / period), 1).astype(int)  # a true value may repeat
    parts = zip(changes, lengths, pieces, strict=True)
    return np.concatenate([begin + np.round(np.arange(k) * n / k).astype(int) for begin, n, k in parts])


def _told(record: FlightRecord, knots: dict[str, np.ndarray], median: float, dt: float) -> list[str]:
    """How each rate was brought onto the grid."""
    groups: dict[tuple[str, str], list[str]] = {}
    for name, own in knots.items():
        if len(own) < record.n:
            how = "missing samples" if np.isnan(record[name]).any() else "held samples"
            step = float(np.median(np.diff(record.time[own])))
            groups.setdefault((how, f"{1.0 / step:.4g}"), []).append(name)
    said = [
        f"resampled: {how} of {', '.join(names)} ({rate} Hz in a file of {1.0 / median:.4g} Hz) are replaced by a "
        f"cubic spline through the channel's own samples, at {1.0 / dt:.4g} Hz"
        for (how, rate), names in groups.items()
    ]
    return said or [f"resampled by cubic splines from {1.0 / median:.4g} Hz to {1.0 / dt:.4g} Hz"]


def _onto(record: FlightRecord, name: str, own: np.ndarray, time: np.ndarray, factor: int) -> np.ndarray:
    values, known = record.channels[name][own], record.time[own]
    if name in _STEPWISE:
        return values[np.maximum(np.searchsorted(known, time, side="right") - 1, 0)][::factor]
    from scipy.interpolate import CubicSpline
    from scipy.signal import resample_poly

    if name in _WRAPPED:
        values = np.unwrap(values)
    with np.errstate(all="ignore"):  # numbers near the largest double overflow; the check afterwards tells it
        # A held value stands until the end: no spline is followed beyond the last sample.
        values = CubicSpline(known, values)(np.minimum(time, known[-1]))
        # "line": the filter sees the record go on along its trend, not fall to zero, at both ends.
        return values if factor == 1 else resample_poly(values, 1, factor, padtype="line")
