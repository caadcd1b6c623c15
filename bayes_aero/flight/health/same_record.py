"""One flight given twice, also cut, renamed, rounded or thinned out: samples are compared, not names."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import product

import numpy as np

from bayes_aero.flight.health.finding import Findings, found
from bayes_aero.flight.health.signals import quantum
from bayes_aero.flight.record import FlightRecord

FIRST = ("q", "alpha", "az", "theta", "airspeed", "elevator", "p", "ax", "phi", "altitude", "r", "beta", "ay")
"""Channels that tell flights apart best; those of a card's own names come after them."""
FEWEST = 40  # samples in common
NEAR = 0.5  # correlation of sample-to-sample differences from which a shift of time is looked at closely
ALIKE = 0.999  # the same, noise included, that two flights never have
CHANNELS = 2  # channels that must agree, at least
OTHERWISE = 2  # channels that may differ: repaired or filtered anew in one of the files
SLOWER = 20  # times, at most, that one of the records may be the slower
COARSEST = 0.1  # of a channel's range: the largest digit to which it may be rounded and still tell


def same_records(records: Sequence[FlightRecord]) -> Findings:
    """A finding for each pair of records that share samples."""
    for j, two in enumerate(records):
        for one in records[:j]:
            if (shared := repeats_of(one, two)) is not None:
                words, at = shared
                words += ", so the flight counts twice and every interval is too narrow; give the flight once"
                yield found(two, "record", "same_record", words, at=at)


def repeats_of(one: FlightRecord, two: FlightRecord) -> tuple[str, tuple[int, int]] | None:
    """What the record `two` repeats of `one`, in words, and its first and last such sample; None if nothing. Another
    name, order of channels, origin of time, number of digits or a whole part of the rate make no new record."""
    slow = max(one.dt, two.dt)
    every = [round(slow / record.dt) for record in (one, two)]
    if max(every) > SLOWER or any(abs(k * r.dt - slow) > 1e-3 * slow for k, r in zip(every, (one, two), strict=True)):
        return None
    names = [n for n in FIRST if n in one.channels] + [n for n in one.channels if n not in FIRST]
    names = [n for n in names if n in two.channels and np.ptp(one[n]) > 0.0 and np.ptp(two[n]) > 0.0]
    if len(names) < CHANNELS:
        return None
    for begin in product(*map(range, every)):
        x, y = ({n: r[n][b::k] for n in names} for r, b, k in zip((one, two), begin, every, strict=True))
        if (shared := _shared(x, y)) is not None:
            first, count = shared
            lengths = len(x[names[0]]), len(y[names[0]])
            part = "shares a part with the record"
            if count >= min(lengths) - 2:
                part = f"is {'' if lengths[0] == lengths[1] else 'part of '}the same record as"
            ends = (begin[1] + every[1] * first, begin[1] + every[1] * (first + count - 1))
            return f"{part} {one.name}: {count} samples ({count * slow:.4g} s) are the same samples", ends
    return None


def _shared(one: Mapping[str, np.ndarray], two: Mapping[str, np.ndarray]) -> tuple[int, int] | None:
    """First sample in `two` and number of the samples that both have; None if there are none."""
    for lead in list(one)[:3]:
        lag = _lag(np.diff(one[lead]), np.diff(two[lead]))
        if lag is None:
            continue
        begin, end = max(0, -lag), min(len(two[lead]), len(one[lead]) - lag)  # samples of `two` that `one` has, too
        alike = sum(alike_samples(one[n][begin + lag : end + lag], two[n][begin:end]) for n in one)
        if alike >= max(CHANNELS, len(one) - OTHERWISE):
            return begin, end - begin
    return None


def alike_samples(x: np.ndarray, y: np.ndarray) -> bool:
    """Whether two channels step alike, noise included, or differ by no more than their last digits."""
    dx, dy = np.diff(x), np.diff(y)
    power = np.sqrt(float(dx @ dx) * float(dy @ dy))
    digit = quantum(x) + quantum(y)
    rounded = digit < COARSEST * np.ptp(y) and float(np.max(np.abs(x - y))) <= 0.51 * digit
    return bool(rounded or (power > 0.0 and float(dx @ dy) > ALIKE * power))


def _lag(x: np.ndarray, y: np.ndarray) -> int | None:
    """By how many samples y lies behind x where the two correlate best, among overlaps that are long enough."""
    size = 1 << (len(x) + len(y) - 1).bit_length()
    spectra = np.fft.rfft(x, size) * np.fft.rfft(y[::-1], size)
    product = np.fft.irfft(spectra, size)[: len(x) + len(y) - 1]
    lags = np.arange(-(len(y) - 1), len(x))
    power_x, power_y = (np.concatenate([[0.0], np.cumsum(v**2)]) for v in (x, y))
    begin = np.maximum(0, -lags)
    end = np.minimum(len(y), len(x) - lags)
    power = (power_x[end + lags] - power_x[begin + lags]) * (power_y[end] - power_y[begin])
    long = (end - begin >= FEWEST) & (power > 1e-12 * power_x[-1] * power_y[-1])
    if not long.any():
        return None
    score = np.where(long, product / np.sqrt(np.where(long, power, 1.0)), -1.0)
    best = int(np.argmax(score))
    return int(lags[best]) if score[best] > NEAR else None
