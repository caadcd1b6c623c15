"""What is wrong with one channel of one record, and the words and measures that all kinds of fault share."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from itertools import combinations, product
from typing import Any

import numpy as np

from bayes_aero.flight.card import Card
from bayes_aero.flight.channel import STANDARD_CHANNELS, Channel
from bayes_aero.flight.record import FlightRecord
from bayes_aero.units import instant, same_unit, to_si


@dataclass(frozen=True)
class HealthFinding:
    """One fault of one channel."""

    record: str
    channel: str  # "record" where all of them are meant
    fault: str  # short key of the kind of fault, e.g. "frozen"
    begin: float | None  # first time that is concerned, s, as in the record; None where it is the whole record
    end: float | None  # last such time, s
    claim: str  # what is wrong, in one sentence
    why: str  # what it looks like, and by how much; may be empty
    mend: str  # what to do about it
    sentence: str  # the record and all three
    grave: bool  # whether results that rest on the channel cannot be trusted


Findings = Iterator[HealthFinding]


def only_following(health: Iterable[HealthFinding]) -> tuple[str, ...]:
    """Surfaces that only follow the outputs: no derivative with respect to them is known."""
    return tuple(dict.fromkeys(finding.channel for finding in health if finding.fault == "feedback"))


def finding(
    record: FlightRecord, channel: str, fault: str, words: tuple[str, str, str],
    at: tuple[int, int] | None = (0, -1), *, grave: bool = True,
) -> HealthFinding:  # fmt: skip
    """A finding whose sentence begins with the record's name; `words` are claim, why and mend, `at` its first and last
    sample."""
    claim, why, mend = words
    begin, end = (None, None) if at is None else (float(record.time[at[0]]), float(record.time[at[1]]))
    sentence = f"{record.name}: {claim}{why}{f'; {mend}' if mend else ''}"
    return HealthFinding(record.name, channel, fault, begin, end, claim, why, mend, sentence, grave)


def declared(card: Card, name: str) -> Channel:
    """What the card says of a channel; of one that it does not map, the program's own unit."""
    standard = STANDARD_CHANNELS.get(name)
    return next((c for c in card.channels if c.name == name), Channel(name, standard.unit if standard else "1"))


def other_units(card: Card, name: str, units: Iterable[str]) -> Iterator[tuple[str, float]]:
    """Of these units those that the card does not state, and the factor by which SI values would be larger in them."""
    channel = declared(card, name)
    for unit in units:
        if same_unit(unit, channel.unit) is False:
            yield unit, float(to_si(1.0, unit, name, channel.si) / to_si(1.0, channel.unit, name, channel.si))


def as_filed(card: Card, name: str, value: float) -> float:
    """An SI value of a channel in the unit and with the sign of the file, in six digits to undo conversion."""
    filed = float(declared(card, name).filed(value))
    return 0.0 if abs(filed) < 1e-9 else float(f"{filed:.6g}")


def shown(card: Card, name: str, value: float) -> str:
    """A value with the card's unit: "3.2 deg"."""
    return f"{as_filed(card, name, value):.4g} {declared(card, name).unit}".removesuffix(" 1")


def span(record: FlightRecord, first: int, last: int) -> str:
    return f"from {instant(record.time[first])} to {instant(record.time[last])} s"


def when(record: FlightRecord, index: np.ndarray) -> str:
    return f"t = {', '.join(f'{record.time[i]:.6g}' for i in index[:3])}{' ...' if len(index) > 3 else ''} s"


# --- What was decided when the record was read, and records too short for the filters and the motion of the aircraft.


def decided(record: FlightRecord, _card: Card) -> Findings:
    """Optional channels that no sound record could have and that were left out; text that could mean two things."""
    for name, why in record.dropped.items():
        yield finding(record, name, "left_out", (why, "", "it is not required and was left out"), None, grave=False)
    for remark in record.remarks:
        yield finding(record, "record", "read", (remark, "", ""), None, grave=False)


ENDS = 30  # samples at both ends together that the smoother (7) and the differentiator (8) distort
CHORDS = 120.0  # lengths travelled: two short periods, or a separation and, at 20 to 30 chords, its reattachment
LEAST = 5.0  # s, where the card states no chord


def short(record: FlightRecord, card: Card) -> Findings:
    """A finding if the record is shorter than a manoeuvre must be to be identified by itself."""
    lasts, chord = float(record.time[-1] - record.time[0]), float(card.aircraft.chord)
    speed = float(np.median(record["airspeed"])) if record.has("airspeed") else np.nan
    motion, ends = CHORDS * chord / speed if chord > 0.0 and speed > 5.0 else LEAST, 4.0 * ENDS * record.dt
    if card.linear is not None:  # it is flown, nothing is filtered
        motion, ends = min(motion, LEAST), 0.0
    if lasts < max(motion, ends):
        why = f"{ENDS} samples at the ends, which the filters distort, must not be more than a quarter of it"
        if motion >= ends:
            why = f"{CHORDS:.0f} chords of flight, in which an aircraft has answered a control and a stall has come "
            why += "and gone"
        least, has = np.ceil(10.0 * max(motion, ends)) / 10.0, np.floor(10.0 * lasts) / 10.0  # never the same number
        yield finding(
            record, "record", "short",
            (f"the record is too short: {has:g} s, and {least:g} s are needed", f" ({why})",
            "estimates can be off by several standard errors, so give the whole manoeuvre with some seconds of trimmed "
            "flight before it"),
        )  # fmt: skip


# --- Simple measures of a recorded signal: how it scatters, steps, repeats.

CONTROLS = frozenset(
    {"elevator", "elevator_left", "elevator_right", "elevon_left", "elevon_right", "canard", "stabilizer", "rudder"}
    | {"aileron", "aileron_left", "aileron_right", "flap", "spoiler_left", "spoiler_right", "dlc_left", "dlc_right"}
    | {"gear", "engine_speed", "throttle", "throttle_left", "throttle_right", "n1_left", "n1_right", "fuel_used"}
    | {"thrust_left", "thrust_right", "thrust"}
)
"""Channels that may rightly stand still, step, and rest at a stop."""


def channels_of(record: FlightRecord, card: Card) -> dict[str, np.ndarray]:
    """The record's channels and what the card states where nothing was recorded, each (n,) in SI."""
    return {name: np.full(record.n, value) for name, value in card.constants.items()} | {**record.channels}


def noise_of(*parts: np.ndarray) -> float:
    """Standard deviation of the noise of (n,) samples that is new at each, outliers left out; zero below 8 samples.
    Steps, spikes and passages of buffet do not count; a channel that mostly stands still has none. Source: third
    differences of white noise have 20 times its variance; 1.4826 times the median of their size is their standard
    deviation. Several `parts` follow each other with gaps."""
    if sum(map(len, parts)) < 8:
        return 0.0
    return float(1.4826 * np.median(np.abs(np.concatenate([np.diff(x, 3) for x in parts]))) / np.sqrt(20.0))


def noise_alone(x: np.ndarray, *parts: np.ndarray) -> bool:
    """Whether more than half of what (n,) samples scatter about the mean, of each of `parts`, is white noise."""
    parts = parts or (x,)
    return bool(noise_of(*parts) ** 2 > 0.5 * float(sum(len(p) * np.var(p) for p in parts)) / len(x))


def quantum_of(x: np.ndarray) -> float:
    """The step in which (n,) samples are recorded; zero if they are continuous. Small steps between those of a channel
    computed from a quantised one (airspeed from a pressure) are not counted."""
    steps = np.abs(np.diff(x))
    if not np.any(steps > 0.0):
        return 0.0
    large = float(np.quantile(steps[steps > 0.0], 0.9))
    if np.mean(steps <= 0.1 * large) < 0.4:  # Gaussian noise has 0.13
        repeated = 1.0 - len(np.unique(x)) / len(x)
        return float(np.quantile(steps[steps > 1e-9 * large], 0.05)) if repeated > 0.5 else 0.0
    return float(np.median(steps[steps > 0.1 * large]))


def quantum(x: np.ndarray) -> float:
    """The least distance of different values among (n,) samples, which is that of the last digit written; 0 if none."""
    gaps = np.diff(np.unique(x))
    gaps = gaps[gaps > 1e-9 * np.max(np.abs(x), initial=0.0)]
    return float(gaps.min()) if len(gaps) else 0.0


def runs_of(equal: np.ndarray) -> list[tuple[int, int]]:
    """First and last index of each run of true values."""
    edges = np.flatnonzero(np.diff(equal.astype(np.int8), prepend=0, append=0)).tolist()
    return [(first, after - 1) for first, after in zip(edges[::2], edges[1::2], strict=True)]


def longest(runs: Iterable[tuple[int, int]]) -> tuple[int, int]:
    return max(runs, key=lambda run: run[1] - run[0])


# --- Records of different sampling rates in one job; one flight given twice, also cut, renamed or rounded.


def different_rates(records: Sequence[FlightRecord]) -> Findings:
    """A finding for the first record whose rate is not that of the others, with all rates."""
    rates = np.array([1.0 / record.dt for record in records])
    for i in np.flatnonzero(np.abs(np.log(rates / rates[:1])) > 0.01)[:1]:
        listed = ", ".join(f"{r.name} {rate:.4g} Hz" for r, rate in zip(records, rates, strict=True))
        yield finding(
            records[i], "time", "rates",
            ("the records have different sampling rates",
            f" ({listed}): filters span samples, so derivatives and noise differ between them",
            "identify brings them to the lowest rate by default, elsewhere resample "
            f"(--resample {1.0 / rates.min():.4g})"), None,
        )  # fmt: skip


FIRST = ("q", "alpha", "az", "theta", "airspeed", "elevator", "p", "ax", "phi", "altitude", "r", "beta", "ay")
"""Channels that tell flights apart best; those of a card's own names come after them."""
FEWEST = 40  # samples in common
SLOWER = 20  # times, up to which a copy may be thinned
CHANNELS = 2  # channels that must agree at least, and that may differ: repaired or filtered anew in one of the files


def same_records(records: Sequence[FlightRecord]) -> Findings:
    """A finding for each pair of records that share samples: these are compared, not names."""
    for original, copy in combinations(records, 2):
        if shared := repeats_of(original, copy):
            words, at = shared
            why = ", so the flight counts twice and every interval is too narrow"
            yield finding(copy, "record", "same_record", (words, why, "give the flight once"), at)


def repeats_of(original: FlightRecord, copy: FlightRecord) -> tuple[str, tuple[int, int]] | None:
    """What the record `copy` repeats of `original`, in words, and its first and last such sample; None if nothing."""
    names = dict.fromkeys(n for n in (*FIRST, *original.channels) if n in original.channels and n in copy.channels)
    names = [n for n in names if np.ptp(original[n]) > 0.0 and np.ptp(copy[n]) > 0.0]
    slow = max(original.dt, copy.dt)
    every = [round(slow / record.dt) for record in (original, copy)]
    whole = all(abs(k * record.dt - slow) < 1e-3 * slow for k, record in zip(every, (original, copy), strict=True))
    if len(names) < CHANNELS or max(every) > SLOWER or not whole:
        return None
    for skipped in product(*map(range, every)):  # a copy may be thinned to a lower rate, from any of its samples on
        x, y = ({n: r[n][s::k] for n in names} for r, s, k in zip((original, copy), skipped, every, strict=True))
        if shared := _shared(x, y):
            begin, count = shared
            sizes, first = (len(x[names[0]]), len(y[names[0]])), skipped[1] + every[1] * begin
            part = f"is {'' if sizes[0] == sizes[1] else 'part of '}the same record as"
            part = part if count >= min(sizes) - 2 else "shares a part with the record"
            words = f"{part} {original.name}: {count} samples ({count * slow:.4g} s) are the same samples"
            return words, (first, first + every[1] * (count - 1))
    return None


def _shared(original: Mapping[str, np.ndarray], copy: Mapping[str, np.ndarray]) -> tuple[int, int] | None:
    """The first sample of `copy` that `original` has, too, and how many follow; None if there are none."""
    for a, b in ((np.diff(original[lead]), np.diff(copy[lead])) for lead in list(original)[:3]):
        # By how many samples b lies behind a where the two correlate best, among overlaps that are long enough.
        lags = np.arange(-(len(b) - 1), len(a))
        matched = np.fft.irfft(np.fft.rfft(a, 2 * len(lags)) * np.fft.rfft(b[::-1], 2 * len(lags)))[: len(lags)]
        power_a, power_b = (np.concatenate([[0.0], np.cumsum(v**2)]) for v in (a, b))
        begins, ends = np.maximum(0, -lags), np.minimum(len(b), len(a) - lags)
        power = (power_a[ends + lags] - power_a[begins + lags]) * (power_b[ends] - power_b[begins])
        enough = (ends - begins >= FEWEST) & (power > 1e-12 * power_a[-1] * power_b[-1])
        score = np.where(enough, matched / np.sqrt(np.where(enough, power, 1.0)), -1.0)
        lag = int(lags[np.argmax(score)]) if len(score) else 0
        if not len(score) or score.max() <= 0.5:
            continue
        begin, end = max(0, -lag), min(len(b) + 1, len(a) + 1 - lag)
        alike = 0
        for name in original:  # they step alike, noise included, or differ by no more than their last digits
            x, y = original[name][begin + lag : end + lag], copy[name][begin:end]
            dx, dy, digit = np.diff(x), np.diff(y), quantum(x) + quantum(y)
            power = np.sqrt(float(dx @ dx) * float(dy @ dy))
            rounded = digit < 0.1 * np.ptp(y) and float(np.max(np.abs(x - y))) <= 0.51 * digit
            alike += rounded or (power > 0.0 and float(dx @ dy) > 0.999 * power)  # which two flights never have
        if alike >= max(CHANNELS, len(original) - CHANNELS):
            return begin, end - begin
    return None


# --- Whether the sensors of records agree along the flight path: the answer as plain data.


class Agreement(StrEnum):
    AGREE = "agree"
    EXPLAINED = "disagree_explained"
    UNEXPLAINED = "disagree_unexplained"
    NOT_CHECKED = "not_checked"


@dataclass(frozen=True)
class Departure:
    """A channel of a record that leaves the flight path: from `begin` to `end` (s) by `rms`, where noise permits
    `permitted` (both in the channel's SI unit, root mean square)."""

    record: str
    channel: str
    begin: float
    end: float
    rms: float
    permitted: float


@dataclass(frozen=True)
class PathCheck:
    """One record: where it departs, what is left of each channel (rms) and permitted. `turbulence`: gusts that were
    permitted, m/s, `gusts`: those that it shows; `assumed`: channels taken as zero."""

    record: str
    departures: tuple[Departure, ...]
    rms: Mapping[str, tuple[float, float]]
    turbulence: float
    gusts: float
    assumed: tuple[str, ...] = ()


@dataclass(frozen=True)
class OpenError:
    """An error of a sensor that the flight path cannot decide on, SI. `asked`: it would explain much, but parts of the
    record that were left out do not confirm it. `joint`: errors that were added with it, and the correlation, where one
    of them is larger than sensors have: none holds by itself."""

    name: str  # of the effect, which has one parameter
    unit: str  # of that parameter
    mean: float  # what the record says of it, were it the only error
    sd: float  # standard error of that
    among: float  # standard error with every other error of a sensor possible, as far as such errors usually go
    asked: bool
    imitators: tuple[str, ...]  # other errors that together do the same along this flight path
    share: float  # of what it does, that they do
    joint: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Consistency:
    """The flight path of each record as recorded, and with `errors` of sensors and winds taken out: claim, whether
    minor, parameters, and `joint`, others of which none holds without the other."""

    why_not: str = ""  # nothing was checked; empty where it was
    unchecked: tuple[str, ...] = ()  # channels that could not be checked, for they were not recorded
    recorded: tuple[PathCheck, ...] = ()  # a check of each record as it is
    corrected: tuple[PathCheck, ...] = ()  # the same with `errors` taken out; empty where none were sought or found
    errors: Mapping[str, Mapping[str, Any]] | None = None
    unsought: str = ""  # why no known error could be sought though the sensors disagree; empty where it could
    open: tuple[OpenError, ...] = ()  # errors of sensors that the flight path cannot decide on

    @property
    def agreement(self) -> Agreement:
        """Agree, disagree with or without an explanation, or not checked."""
        if self.why_not:
            return Agreement.NOT_CHECKED
        if not any(check.departures for check in self.recorded):
            return Agreement.AGREE
        explained = self.corrected and not any(check.departures for check in self.corrected)
        return Agreement.EXPLAINED if explained else Agreement.UNEXPLAINED

    @property
    def disagrees(self) -> bool:
        """Whether the sensors disagree, explained or not."""
        return self.agreement in (Agreement.EXPLAINED, Agreement.UNEXPLAINED)

    @property
    def departures(self) -> tuple[Departure, ...]:
        """Where records depart from their flight path; if errors explain that in part, where they still do."""
        left = tuple(d for check in self.corrected for d in check.departures)
        return left or tuple(d for check in self.recorded for d in check.departures)

    def beyond(self, tolerances: Mapping[str, float]) -> tuple[Departure, ...]:
        """Departures that no known error explains and that are larger than a simulation may be off (SI, by channel)."""
        unexplained = self.departures if self.agreement is Agreement.UNEXPLAINED else ()
        return tuple(d for d in unexplained if d.rms > tolerances.get(d.channel, np.inf))
