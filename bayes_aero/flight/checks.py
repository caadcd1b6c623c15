"""What a record must satisfy before anything is computed from it; each failure is reported with its remedy."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from bayes_aero.errors import InputError
from bayes_aero.flight.channel import STANDARD_CHANNELS, Channel, StandardChannel, unit_choices
from bayes_aero.flight.health.channel import held_period
from bayes_aero.flight.record import GAP, FlightRecord
from bayes_aero.units import from_si, instant, number, same_unit, to_si

MIN_SAMPLES = 50  # the derivative filter alone spans 17 samples and changes its form over the 9 next to either end
JITTER = 0.01  # largest departure of a step from the median step, relative, that still passes for even sampling
RATES = (1e-4, 2.0)  # bounds of the sampling interval, s, outside which the unit of time must be wrong
ALPHA_MOVES = 1e-6  # smallest range of alpha, rad, that counts as variation at all
ROUNDED = 0.15
"""Part of the median step from which a common divisor of all steps is taken for the rounding of time stamps."""

SLOWEST, REGULAR, FEWER = 10, 0.9, 0.7
"""Fewest values of a channel with blanks, and the share of them a step apart, from which it has a rate of its own; the
most samples of the file that it then has."""

SOME = 0.1  # share of repeated stamps up to which samples were written twice, and beyond which stamps are rounded
Card = Mapping[str, Channel]
Check = Callable[[FlightRecord, Card, bool], str]
"""A sentence on what is wrong, empty for a sound record: of a record, the card's channels and whether time is even."""


def check_record(record: FlightRecord, *, even: bool = True, channels: Sequence[Channel] = ()) -> None:
    """Raise InputError, with channel, sample and remedy, for the first fault; `even=False`: it is to be resampled."""
    for reason in failures(record, even=even, channels=channels):
        raise InputError(reason)


def failures(record: FlightRecord, *, even: bool = True, channels: Sequence[Channel] = ()) -> Iterator[str]:
    """Everything that is wrong with a record, one sentence each; `check_record` raises the first."""
    card = {channel.name: channel for channel in channels}
    for check in CHECKS:
        if reason := check(record, card, even):
            yield reason
            if check in (length, monotonic) or not np.isfinite(record.time).all():
                return  # what follows needs samples and time that increases


def check_arrays(record: FlightRecord, channels: Sequence[Channel]) -> None:
    """Raise InputError if a record made in memory is too short, lacks numbers, or its time does not increase."""
    used = {c.name: record[c.name] for c in channels if c.required and c.name in record.channels}
    for check in (length, finite, monotonic):
        if reason := check(replace(record, channels=used), {}, True):
            raise InputError(f"record {record.name}: {reason}")


# --- The checks. `even` is false where a record is about to be resampled.


def length(record: FlightRecord, _card: Card, _even: bool) -> str:
    if record.n >= MIN_SAMPLES:
        return ""
    return (
        f"the record has {record.n} samples; at least {MIN_SAMPLES} are needed (the derivative filter alone takes "
        "20): use a longer record"
    )


def finite(record: FlightRecord, _card: Card, even: bool) -> str:
    """Missing samples that are about to be interpolated pass; those of time do not, nor infinities."""
    for name in record.names:
        values = record[name]
        bad, missing = ~np.isfinite(values), np.isnan(values)
        bridged = not even and name != "time" and not np.isinf(values).any() and not missing.all()
        if not bad.any() or bridged:
            continue
        first = int(np.argmax(bad))
        if name != "time" and missing[first] and (rates := several_rates(record, name)):
            return rates
        kind = "empty or not a number (NaN)" if missing[first] else "infinite"
        when = f"sample {first} (counted from 0)" if name == "time" else at(record, first)
        return (
            f"channel {name} is {kind} at {when}, {int(bad.sum())} of {record.n} samples in all; "
            f"repair or cut out these samples, ask for resampling if they are few (it interpolates), or take the "
            f"channel off the card if it is not needed"
        )
    return ""


def several_rates(record: FlightRecord, name: str) -> str:
    """What to do where a channel has samples of its own at its own rate; empty if its blanks have no such order."""
    there = np.flatnonzero(np.isfinite(record[name]))
    if len(there) < SLOWEST or len(there) > FEWER * record.n or (np.diff(record.time) <= 0.0).any():
        return ""
    steps = np.diff(record.time[there])
    step = float(np.median(steps))
    if np.mean(np.abs(steps - step) <= 0.5 * step) < REGULAR:
        return ""
    fastest = sampling_step(record)
    return (
        f"channel {name} has a value at {len(there)} of {record.n} samples only: it is of {1.0 / step:.4g} Hz in a "
        f"file of several rates ({1.0 / fastest:.4g} Hz the fastest); resample the record, which interpolates each "
        f"channel between its own samples (--resample {fastest:.4g}, in Python resample={fastest:.4g})"
    )


def sampling_step(record: FlightRecord) -> float:
    """Median step of the channel that has most samples, s: time alone holds the stamps of all rates of a file."""
    there = [np.isfinite(values) for values in record.channels.values()]
    fullest = max(there, key=np.count_nonzero, default=np.ones(record.n, bool))
    return float(np.median(np.diff(record.time[fullest]))) if np.count_nonzero(fullest) > 1 else float("nan")


def monotonic(record: FlightRecord, _card: Card, _even: bool) -> str:
    back = np.diff(record.time) <= 0.0
    if not back.any():
        return ""
    i = int(np.argmax(back)) + 1
    what = "repeats" if record.time[i] == record.time[i - 1] else "runs backwards from"
    mend = "sort the samples, drop the repeated ones, or divide the record where time starts over (--split)"
    return (
        f"channel time {what} {instant(record.time[i - 1])} s at {at(record, i)}, {int(back.sum())} times in all; time "
        f"must increase: {_rounding(record) or mend}"
    )


def _rounding(record: FlightRecord) -> str:
    """What to do if the time stamps are rounded: all steps are multiples of one that is no small part of the median."""
    step = np.diff(record.time)
    positive = step[step > 0.0]
    if (step < 0.0).any() or len(positive) < 10 or 0.0 < np.mean(step == 0.0) < SOME:
        return ""
    mean = float((record.time[-1] - record.time[0]) / (record.n - 1))
    least = float(positive.min())
    off = np.abs(positive / least - np.round(positive / least))
    multiples = np.round(step / least)
    regular = abs(record.time[record.n // 2] - record.time[0] - mean * (record.n // 2)) <= 2.0 * max(least, mean)
    if least < ROUNDED * mean or off.max() > 0.02 or not 1.0 <= np.ptp(multiples) <= 3.0 or not regular:
        return ""
    return (
        f"the stamps are rounded to {least:.3g} s, and {record.n} samples in "
        f"{record.time[-1] - record.time[0]:.6g} s make {1.0 / mean:.4g} Hz; write time with more digits, or as sample "
        f"number times {mean:.6g} s"
    )


def rate(record: FlightRecord, card: Card, _even: bool) -> str:
    median = sampling_step(record)
    if RATES[0] <= median <= RATES[1]:
        return ""
    return (
        f"channel time has a median step of {median:.6g} s from {at(record, 0)}, outside "
        f"{RATES[0]:g} to {RATES[1]:g} s; {time_hint(median, card.get('time'))}"
    )


def evenly_sampled(record: FlightRecord, _card: Card, even: bool) -> str:
    step = np.diff(record.time)
    median, rounding = float(np.median(step)), _rounding(record)
    gaps, off = step > GAP * median, np.abs(step - median) > JITTER * median
    if even and gaps.any() and not rounding:
        i = int(np.argmax(gaps))
        return (
            f"channel time has a gap of {step[i]:.6g} s after {at(record, i)}, where {median:.6g} s is the "
            f"sampling interval; divide the record there (--split, or FILE@FROM:TO), or ask for resampling if the gap "
            "is short"
        )
    if even and off.any():
        i = int(np.argmax(off))
        mean = float(np.mean(step)) if rounding else median
        return (
            f"channel time is sampled unevenly: the step after {at(record, i)} is {step[i]:.6g} s, the median step "
            f"{median:.6g} s, {int(off.sum())} steps differ by more than {JITTER:.0%}; "
            f"{rounding or 'write time with more digits'}, or ask for resampling (--resample {mean:.4g})"
        )
    return ""


def plausible(record: FlightRecord, card: Card, _even: bool) -> str:
    standard = (STANDARD_CHANNELS[name] for name in record.names if name in STANDARD_CHANNELS)
    return next((why for one in standard if (why := implausible(record, one, card.get(one.name)))), "")


def positive(record: FlightRecord, _card: Card, _even: bool) -> str:
    remedies = {
        "airspeed": "coefficients divide by dynamic pressure: cut the record to the part in flight",
        "density": "coefficients divide by dynamic pressure: repair the channel",
    }
    for name, remedy in remedies.items():
        bad = record[name] <= 0.0 if record.has(name) else np.zeros(1, bool)
        if bad.any():
            i = int(np.argmax(bad))
            return (
                f"channel {name} is {record[name][i]:.6g} {STANDARD_CHANNELS[name].unit} at {at(record, i)}, "
                f"{int(bad.sum())} samples not above zero; {remedy}"
            )
    return ""


def in_g(record: FlightRecord, card: Card, _even: bool) -> str:
    if not all(record.has(axis) for axis in ("ax", "ay", "az")) or ("az" in card and same_unit(card["az"].unit, "g")):
        return ""
    load = float(np.median(np.sqrt(record["ax"] ** 2 + record["ay"] ** 2 + record["az"] ** 2)))
    if not 0.7 < load < 1.4:  # near 9.8 in m/s2; only a record flown at a tenth of gravity throughout is so
        return ""
    i = int(np.argmax(np.abs(record["az"])))
    return (
        f"channels ax, ay, az have a median magnitude of {number(load)} m/s^2 (az is {number(record['az'][i])} at "
        f'{at(record, i)}); looks like multiples of gravity: set unit = "g" for them on the card'
    )


def varies(record: FlightRecord, _card: Card, _even: bool) -> str:
    if not record.has("alpha") or float(np.ptp(record["alpha"])) >= ALPHA_MOVES:
        return ""
    return (
        f"channel alpha stays at {record['alpha'][0]:.6g} rad from {at(record, 0)} to {at(record, record.n - 1)}; "
        "nothing can be identified from a constant angle of attack: check the sensor and the card's column or label"
    )


CHECKS: tuple[Check, ...] = (
    length, finite, plausible, monotonic, rate, evenly_sampled, positive, in_g, varies,
)  # fmt: skip


# --- Values that no sound record has: fill values first, then units; the card's own unit is never advised.

_DIGITS = ("99", "999", "9999", "99999", "999999", "9999999", "99.99", "999.9", "999.99", "9999.9", "8888")
_LIMITS = ("32767", "32768", "65535", "1e10", "1e20", "1e30")
FILLS = frozenset(float(sign + digits) for digits in (*_DIGITS, *_LIMITS) for sign in ("", "-"))
"""What recorders write where they have no value, in the file's unit."""

WORDS = {
    "deg": "degrees", "rad": "radians", "deg/s": "degrees per second", "rad/s": "radians per second",
    "deg/s^2": "degrees per second squared", "kt": "knots", "ft": "feet", "m": "metres", "%": "per cent",
    "degC": "degrees Celsius", "g": "multiples of gravity", "us": "microseconds", "ms": "milliseconds",
    "ns": "nanoseconds", "s": "seconds", "min": "minutes", "h": "hours", "d": "days",
}  # fmt: skip
TIMES = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0, "d": 86400.0}
RECORDED = (0.002, 0.5)  # s between samples of a flight that is worth a look
NEARLY_ALL = 0.99
FEW = 3  # values at most that a channel's fill has


def implausible(record: FlightRecord, known: StandardChannel, channel: Channel | None) -> str | None:
    """What is wrong with values outside the channel's bounds, in one sentence; None if none is outside."""
    x = record[known.name]
    lo, hi = known.plausible
    outside = (x < lo) | (x > hi)
    if not outside.any():
        return None
    own = channel or Channel(known.name, known.unit)
    count, i = int(outside.sum()), int(np.argmax(outside))
    values, counts = np.unique(x[outside], return_counts=True)
    fills = [float(f"{float(own.filed(v)):.6g}") for v in values] if len(values) <= FEW else []
    usual = all(value in FILLS for value in fills)
    if fills and (usual or (counts.max() >= 2 and outside.mean() <= 0.5)):  # it stands where there was no value
        named = " and ".join(f"{value:.10g}" for value in fills)
        unit = "" if own.unit == "1" else f" {own.unit}"
        return (
            f"channel {known.name}: {named}{unit} stands at {count} of {record.n} samples, the first at "
            f"{at(record, i)}: a fill value of the recorder, not a measurement; cut these samples out or interpolate "
            "across them in the file"
        )
    if lo == 0.0 and (x < lo).any():  # airspeed and density not above zero: another check reports these
        return None
    as_filed = "" if own.unit == known.unit else f" ({float(own.filed(x[i])):.6g} {own.unit} in the file)"
    return (
        f"channel {known.name} is {x[i]:.6g} {known.unit}{as_filed} at {at(record, i)}, outside {lo:g} to {hi:g} "
        f"{known.unit}, {count} of {record.n} samples in all; {_unit_hint(x, known, own.unit)}"
    )


def at(record: FlightRecord, index: int | np.integer) -> str:
    """A sample in words."""
    return f"sample {int(index)} (counted from 0; t = {instant(record.time[index])} s)"


def _unit_hint(x: np.ndarray, known: StandardChannel, own: str) -> str:
    """Units that would make nearly all values plausible, less the card's `own`."""
    filed = from_si(x, own, known.name, known.unit)
    lo, hi = known.plausible
    fit = []
    for unit in unit_choices(known.name):
        if same_unit(unit, own) is not False:
            continue
        values = to_si(filed, unit, known.name, known.unit)
        if np.mean((values >= lo) & (values <= hi)) >= NEARLY_ALL:
            fit.append(unit)
    if np.mean((x >= lo) & (x <= hi)) >= NEARLY_ALL or not fit:
        return "no other unit explains that: repair or cut out these samples, or correct its column on the card"
    words, units = (
        " or ".join(one) for one in zip(*((WORDS.get(u, u), f'unit = "{u}"') for u in fit[:2]), strict=True)
    )
    return f"looks like {words}: set {units} for it on the card"


def time_hint(median: float, channel: Channel | None) -> str:
    """The unit of time in which steps of `median` s, as the card's unit makes them, would be those of a flight."""
    own = "s" if channel is None else channel.unit
    scale = next((size for unit, size in TIMES.items() if same_unit(unit, own)), 1.0)
    fit = [
        u for u, size in TIMES.items() if RECORDED[0] <= median / scale * size <= RECORDED[1] and not same_unit(u, own)
    ]
    if not fit:
        return f"no unit of time explains that ({own} on the card): correct its column on the card"
    return f'looks like {WORDS[fit[0]]}, where the card says {own}: set unit = "{fit[0]}" for time on the card'


def without_bad_options(record: FlightRecord, channels: Sequence[Channel], *, blanks: bool = False) -> FlightRecord:
    """The record without optional channels that are not finite (`blanks` pass) or not plausible; it remembers why."""
    dropped = {}
    for channel in channels:
        if channel.required or channel.name not in record.channels:
            continue
        x, known = record[channel.name], STANDARD_CHANNELS.get(channel.name)
        bad = ~np.isfinite(x)
        if bad.any() and not (blanks and bad.mean() < 1.0):
            dropped[channel.name] = (
                f"channel {channel.name} is not a number at {int(bad.sum())} of {record.n} samples, the first at "
                f"{at(record, int(np.argmax(bad)))}"
            )
        elif known is not None and (why := implausible(record, known, channel)) is not None:
            dropped[channel.name] = why
    if not dropped:
        return record
    kept = {name: x for name, x in record.channels.items() if name not in dropped}
    return replace(record, channels=kept, dropped={**record.dropped, **dropped})


# --- Interpolation of a record of uneven or of several rates onto an even grid, done only when asked for.

MAX_GAP = 5.0  # longest step, in median steps, that is bridged; beyond it interpolation would invent flight data
MAX_SAMPLES = 5_000_000

# Angles that jump by a full turn in files; interpolating across the jump would sweep through the whole
# circle.
_WRAPPED = ("phi", "psi", "longitude")
SHOWN = 4  # parts in a sentence
_STEPWISE = ("gear",)


def resample_record(record: FlightRecord, dt: float) -> FlightRecord:
    """The record on an even grid: cubic splines, low-pass filtered where `dt` is coarser; no gap is bridged."""
    if not (math.isfinite(dt) and dt > 0.0):
        raise InputError(f"record {record.name}: cannot resample to an interval of {dt!r} s; give a positive number")
    knots = {name: sampled_at(name, values) for name, values in record.channels.items()}
    steps = [_bridged(record.name, n, record.time[own]) for n, own in knots.items() if len(own) < record.n]
    if len(steps) < len(knots) or not knots:  # time belongs to the channels that have all samples
        steps.append(_bridged(record.name, "time", record.time))
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
        name=record.name, time=begin + elapsed[::factor],
        channels={key: _onto(record, key, knots[key], time, factor) for key in record.channels},
        source=f"{record.source}, resampled to {dt:g} s", sha256=record.sha256, dropped=record.dropped,
        remarks=(*record.remarks, *_told(record, knots, median, dt)),
        read={**record.read, "resample": dt} if record.read else {},
    )  # fmt: skip


def _bridged(record: str, name: str, time: np.ndarray) -> float:
    """The median step, s; refused where a step is too long to interpolate across."""
    step = np.diff(time)
    if len(step) < 3:
        raise InputError(f"record {record}: channel {name} has {len(time)} samples, too few to interpolate between")
    median = float(np.median(step))
    long = np.flatnonzero(step > MAX_GAP * median)
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
            f"the {MAX_GAP:g} median steps ({MAX_GAP * median:.4g} s) that resampling bridges; {mend}"
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
