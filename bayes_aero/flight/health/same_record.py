"""One flight given twice, also cut or renamed: samples are compared, not names."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bayes_aero.flight.health.finding import HealthFinding, found
from bayes_aero.flight.record import FlightRecord

COMPARED = ("q", "alpha", "az", "theta", "airspeed", "elevator", "p", "ax", "phi", "altitude", "r", "beta", "ay")
FEWEST = 40  # samples in common
ALIKE = 0.999  # correlation of sample-to-sample differences, noise included, that two flights never have
CHANNELS = 2  # channels that must agree, at least
OTHERWISE = 2  # channels that may differ: repaired or filtered anew in one of the files


def same_records(records: Sequence[FlightRecord]) -> list[HealthFinding]:
    """A finding for each pair of records that share samples."""
    said = []
    for j, two in enumerate(records):
        for one in records[:j]:
            shared = _shared(one, two)
            if shared is None:
                continue
            first, count = shared
            whole = count >= min(one.n, two.n) - 2
            part = (
                "is the same record as"
                if whole and one.n == two.n
                else "is part of the same record as"
                if whole
                else "shares a part with the record"
            )
            sentence = (
                f"{part} {one.name}: {count} samples ({count * two.dt:.4g} s) are the same samples, so the flight "
                "counts twice and every interval is too narrow; give the flight once"
            )
            said.append(found(two, "record", "same_record", sentence, at=(first, first + count - 1)))
    return said


def _shared(one: FlightRecord, two: FlightRecord) -> tuple[int, int] | None:
    """First sample in `two` and number of the samples that both have; None if there are none."""
    if abs(one.dt - two.dt) > 1e-3 * two.dt:
        return None
    names = [n for n in COMPARED if one.has(n) and two.has(n) and np.ptp(one[n]) > 0.0 and np.ptp(two[n]) > 0.0]
    if len(names) < CHANNELS:
        return None
    steps = {n: (np.diff(one[n]), np.diff(two[n])) for n in names}
    for lead in names[:3]:
        lag = _lag(*steps[lead])
        if lag is None:
            continue
        begin, end = max(0, -lag), min(two.n - 1, one.n - 1 - lag)  # steps of `two` that `one` has, too
        alike = 0
        for n in names:
            x, y = steps[n][0][begin + lag : end + lag], steps[n][1][begin:end]
            power = np.sqrt(float(x @ x) * float(y @ y))
            alike += bool(power > 0.0 and float(x @ y) > ALIKE * power)
        if alike >= max(CHANNELS, len(names) - OTHERWISE):
            return begin, end - begin + 1
    return None


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
    return int(lags[best]) if score[best] > 0.9 else None
