"""What a record must satisfy before anything is computed from it; each failure is told with its remedy."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from bayes_aero.errors import InputError
from bayes_aero.flight.channel import STANDARD_CHANNELS, StandardChannel
from bayes_aero.flight.record import FlightRecord

__all__ = ["GAP", "JITTER", "MIN_SAMPLES", "check_record", "failures"]

MIN_SAMPLES = 50
"""The derivative filter alone spans 17 samples and changes its form over the 9 next to either end."""

GAP = 1.5
"""A step longer than this many median steps is a gap: at least one sample is lost."""

JITTER = 0.01
"""Largest departure of a step from the median step, relative, that still passes for even sampling."""

RATES = (1e-4, 2.0)
"""Bounds of the sampling interval, s, outside which the unit of time must be wrong."""

ALPHA_MOVES = 1e-6
"""Smallest range of alpha, rad, that counts as variation at all."""


def check_record(record: FlightRecord, *, even: bool = True) -> None:
    """Raise InputError, naming channel, sample and remedy, for the first thing that is wrong with a record.

    With `even=False` gaps and uneven sampling pass: the record is about to be resampled.
    """
    for check in _checks(even):
        check(record)


def failures(record: FlightRecord, *, even: bool = True) -> list[str]:
    """Everything that is wrong with a record, one sentence each; `check_record` raises the first."""
    said = []
    for check in _checks(even):
        try:
            check(record)
        except InputError as reason:
            said.append(str(reason))
            if check in (_length, _monotonic) or not np.isfinite(record.time).all():
                break  # what follows needs samples and time that increases
    return said


def _checks(even: bool) -> list[Callable[[FlightRecord], None]]:
    sampled = [_evenly_sampled] if even else []
    return [_length, _finite, _plausible, _monotonic, _rate, *sampled, _positive, _in_g, _varies]


def _at(record: FlightRecord, index: int | np.integer) -> str:
    return f"sample {int(index)} (counted from 0; t = {record.time[index]:.6g} s)"


def _length(record: FlightRecord) -> None:
    if record.n < MIN_SAMPLES:
        raise InputError(
            f"the record has {record.n} samples; at least {MIN_SAMPLES} are needed (the derivative filter "
            f"alone takes "
            f"20): use a longer record"
        )


def _finite(record: FlightRecord) -> None:
    for name in record.names:
        values = record[name]
        bad = ~np.isfinite(values)
        if bad.any():
            first = int(np.argmax(bad))
            kind = "not a number (NaN)" if np.isnan(values[first]) else "infinite"
            when = f"sample {first} (counted from 0)" if name == "time" else _at(record, first)
            raise InputError(
                f"channel {name} is {kind} at {when}, {int(bad.sum())} of {record.n} samples in all; "
                f"repair or cut out these samples, or take the channel off the card if it is not needed"
            )


def _monotonic(record: FlightRecord) -> None:
    step = np.diff(record.time)
    if (step <= 0.0).any():
        i = int(np.argmax(step <= 0.0)) + 1
        what = "repeats" if step[i - 1] == 0.0 else "runs backwards from"
        raise InputError(
            f"channel time {what} {record.time[i - 1]:.9g} s at {_at(record, i)}; time must increase: "
            f"sort the samples, drop the repeated ones, or split the file into one record per manoeuvre"
        )


def _rate(record: FlightRecord) -> None:
    median = float(np.median(np.diff(record.time)))
    if not RATES[0] <= median <= RATES[1]:
        hint = 'looks like milliseconds: set unit = "ms"' if median > RATES[1] else "is its unit hours or days? Set it"
        raise InputError(
            f"channel time has a median step of {median:.6g} s from {_at(record, 0)}, outside "
            f"{RATES[0]:g} to {RATES[1]:g} s; {hint} on the card"
        )


def _evenly_sampled(record: FlightRecord) -> None:
    step = np.diff(record.time)
    median = float(np.median(step))
    if (step > GAP * median).any():
        i = int(np.argmax(step > GAP * median))
        raise InputError(
            f"channel time has a gap of {step[i]:.6g} s after {_at(record, i)}, where {median:.6g} s is the "
            f"sampling interval; cut the record there into two files, or ask for resampling if the gap is "
            f"short"
        )
    off = np.abs(step - median) > JITTER * median
    if off.any():
        i = int(np.argmax(off))
        raise InputError(
            f"channel time is sampled unevenly: the step after {_at(record, i)} is {step[i]:.6g} s, the "
            f"median step "
            f"{median:.6g} s, {int(off.sum())} steps differ by more than {JITTER:.0%}; write time with more "
            f"digits, "
            f"or ask for resampling (resample = {median:.4g})"
        )


def _plausible(record: FlightRecord) -> None:
    for name in record.names:
        known = STANDARD_CHANNELS.get(name)
        if known is None:
            continue
        values = record[name]
        lo, hi = known.plausible
        outside = (values < lo) | (values > hi)
        if outside.any() and not (lo == 0.0 and (values < lo).any()):  # signs are told better by _positive
            raise InputError(_implausible(record, known, int(np.argmax(outside))))


def _implausible(record: FlightRecord, known: StandardChannel, index: int) -> str:
    value, (lo, hi) = record[known.name][index], known.plausible
    hint = known.hint or f"correct its unit on the card ({known.unit} inside the program) or repair the sample"
    return (
        f"channel {known.name} is {value:.6g} {known.unit} at {_at(record, index)}, outside {lo:g} to {hi:g} "
        f"{known.unit}; {hint}"
    )


def _positive(record: FlightRecord) -> None:
    remedies = {
        "airspeed": "coefficients divide by dynamic pressure: cut the record to the part in flight",
        "density": "coefficients divide by dynamic pressure: repair the channel",
    }
    for name, remedy in remedies.items():
        if not record.has(name):
            continue
        bad = record[name] <= 0.0
        if bad.any():
            i = int(np.argmax(bad))
            raise InputError(
                f"channel {name} is {record[name][i]:.6g} {STANDARD_CHANNELS[name].unit} at "
                f"{_at(record, i)}, "
                f"{int(bad.sum())} samples not above zero; {remedy}"
            )


def _in_g(record: FlightRecord) -> None:
    if not all(record.has(axis) for axis in ("ax", "ay", "az")):
        return
    load = float(np.median(np.sqrt(record["ax"] ** 2 + record["ay"] ** 2 + record["az"] ** 2)))
    if 0.7 < load < 1.4:  # near 9.8 in m/s2; only a record flown at a tenth of gravity throughout would look like this
        i = int(np.argmax(np.abs(record["az"])))
        raise InputError(
            f"channels ax, ay, az have a median magnitude of {load:.3g} m/s^2 (az is {record['az'][i]:.3g} "
            f"at "
            f'{_at(record, i)}); looks like multiples of gravity: set unit = "g" for them on the card'
        )


def _varies(record: FlightRecord) -> None:
    if record.has("alpha") and float(np.ptp(record["alpha"])) < ALPHA_MOVES:
        raise InputError(
            f"channel alpha stays at {record['alpha'][0]:.6g} rad from {_at(record, 0)} to "
            f"{_at(record, record.n - 1)}; "
            f"nothing can be identified from a constant angle of attack: check the sensor and the card's "
            f"column or label"
        )
