"""Values that no sound record has: fill values first, then units; the card's own unit is never advised."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from bayes_aero.flight.channel import STANDARD_CHANNELS, Channel, StandardChannel
from bayes_aero.flight.record import FlightRecord
from bayes_aero.units import from_si, instant, same_unit, to_si

_DIGITS = ("99", "999", "9999", "99999", "999999", "9999999", "99.99", "999.9", "999.99", "9999.9", "8888")
_LIMITS = ("32767", "32768", "65535", "1e10", "1e20", "1e30")
FILLS = frozenset(float(sign + digits) for digits in (*_DIGITS, *_LIMITS) for sign in ("", "-"))
"""What recorders write where they have no value, in the file's unit."""

UNITS: Mapping[str, tuple[str, ...]] = {
    "rad": ("deg", "rad"),
    "rad/s": ("deg/s", "rad/s"),
    "rad/s^2": ("deg/s^2", "rad/s^2"),
    "m/s": ("kt", "km/h", "ft/s", "mph", "m/s"),
    "m": ("ft", "m"),
    "m/s^2": ("g", "ft/s^2", "m/s^2"),
    "K": ("degC", "K", "degF"),
    "Pa": ("hPa", "Pa", "kPa", "inHg", "psi", "lbf/ft^2"),
    "1": ("%", "1"),
    "kg/m^3": ("g/m^3", "slug/ft^3", "kg/m^3"),
    "N": ("lbf", "N", "kN"),
    "kg": ("lb", "kg", "slug"),
}
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
    fill = _fill(record, known, channel, outside)
    if fill is not None:
        return fill
    if lo == 0.0 and (x < lo).any():  # airspeed and density not above zero: another check reports these
        return None
    i = int(np.argmax(outside))
    filed = (
        ""
        if channel is None or channel.unit == known.unit
        else f" ({_filed(x[i], channel, known):.6g} {channel.unit} in the file)"
    )
    return (
        f"channel {known.name} is {x[i]:.6g} {known.unit}{filed} at {at(record, i)}, outside {lo:g} to {hi:g} "
        f"{known.unit}, {int(outside.sum())} of {record.n} samples in all; {_unit_hint(x, known, channel)}"
    )


def at(record: FlightRecord, index: int | np.integer) -> str:
    """A sample in words."""
    return f"sample {int(index)} (counted from 0; t = {instant(record.time[index])} s)"


def _filed(value: float, channel: Channel, known: StandardChannel) -> float:
    return float(channel.sign * from_si(value, channel.unit, known.name, known.unit))


def _fill(record: FlightRecord, known: StandardChannel, channel: Channel | None, outside: np.ndarray) -> str | None:
    """A constant that stands where the recorder had no value."""
    own = channel or Channel(known.name, known.unit)
    values, counts = np.unique(record[known.name][outside], return_counts=True)
    if len(values) > FEW:
        return None
    filed = [float(f"{_filed(v, own, known):.6g}") for v in values]
    usual = all(value in FILLS for value in filed)
    if not usual and (counts.max() < 2 or outside.mean() > 0.5):
        return None
    i = int(np.argmax(outside))
    named = " and ".join(f"{value:.10g}" for value in filed)
    unit = "" if own.unit == "1" else f" {own.unit}"
    return (
        f"channel {known.name}: {named}{unit} stands at {int(outside.sum())} of {record.n} samples, the first at "
        f"{at(record, i)}: a fill value of the recorder, not a measurement; cut these samples out or interpolate "
        "across them in the file"
    )


def _unit_hint(x: np.ndarray, known: StandardChannel, channel: Channel | None) -> str:
    """Units that would make nearly all values plausible, less the card's own."""
    own = known.unit if channel is None else channel.unit
    filed = from_si(x, own, known.name, known.unit)
    lo, hi = known.plausible
    fit = []
    for unit in UNITS.get(known.unit, ()):
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
    """The record without optional channels that are not finite or not plausible; it remembers why.

    `blanks`: missing samples pass, for the record is about to be resampled.
    """
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
