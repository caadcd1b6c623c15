"""Where a record leaves its flight path by more than the sensors' noise permits.

Airspeed, flow angles, attitude and altitude must move as accelerometers and gyros say. What does not is compared with
the same of records of noise by three measures of each channel: its root mean square over the record;
the same once the best constant errors are taken out; and over windows of ten seconds. The largest of all, in units of
what noise leaves there, decides: the rate of false alarms is that of a whole record, not of each window.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from enum import IntEnum
from itertools import groupby, pairwise

import numpy as np
from jaxtyping import Float
from scipy.fft import next_fast_len

from bayes_aero.flight.card import Card
from bayes_aero.flight.health import Departure, PathCheck, noise_of
from bayes_aero.physics.aircraft import NO_AIRCRAFT
from bayes_aero.physics.filters import differentiate_joined
from bayes_aero.physics.kinematics import PATH_NEEDS, RATES, STRAIGHT, integral, path_outputs, path_rates

WINDOW = 10.0  # s
REPLICATES = 200  # records of noise: one in 200 that are as noisy as permitted exceeds them all in a kind of measure
SPREAD = 0.6  # of the windows: a channel that exceeds in more of them does so over the whole record
FITTED = 2000  # samples that constant errors are fitted to
RANK = 1e-8  # constant errors that make a column weaker than this, beside others, make none of their own
TOGETHER = 8  # records that are measured at a time


class Measure(IntEnum):
    """Of root mean squares: over the record, the same without the best constant errors, within a window."""

    DRIFT = 0
    SHAPE = 1
    WINDOW = 2


Channels = Mapping[str, Float[np.ndarray, " n"]]


@dataclass(frozen=True)
class _Measures:
    """Root mean squares, a row for each residual record (the recorded one first), and what each column is."""

    values: Float[np.ndarray, "r k"]
    channel: tuple[str, ...]
    begin: tuple[float, ...]
    end: tuple[float, ...]
    kind: tuple[Measure, ...]


def path_check(name: str, time: Float[np.ndarray, " n"], channels: Channels, card: Card, seed: int = 0) -> PathCheck:
    """Compare the flight path of one record, in SI and without known errors of sensors, with what noise permits."""
    path = _RecordedPath(time, channels, card, seed)
    met, outputs, constant = path.gusts_shown(), path.outputs, path.constant
    turbulence = float(np.clip(MARGIN * met, CALM, LIGHT_TURBULENCE))
    drawn = path.residuals(path.disturbances(turbulence, REPLICATES)) - path.recorded
    whole = np.ones(len(time))  # a constant error of each sensor by itself, as large as is permitted
    each = zip(constant.items(), np.eye(len(constant)), strict=True)
    columns = path.residuals({n: np.outer(own, sd * whole) for (n, sd), own in each}) - path.recorded
    measures = _measures(np.concatenate([path.recorded, drawn]), columns, outputs, time)
    count, permitted = len(outputs), _permitted(measures)
    shape = {n: (float(measures.values[0, count + i]), float(permitted[count + i])) for i, n in enumerate(outputs)}
    assumed = tuple(n for n in STRAIGHT if n not in channels)
    return PathCheck(name, _departures(name, measures), shape, turbulence, met, assumed)


def gusts_met(time: Float[np.ndarray, " n"], channels: Channels, card: Card, seed: int = 0) -> float:
    """Standard deviation of the gusts that one record shows, m/s, as in `PathCheck`; arguments as of `path_check`."""
    return _RecordedPath(time, channels, card, seed).gusts_shown()


class _RecordedPath:
    """The channels of one record, zeros for those that are absent, and what the flight path leaves of them."""

    def __init__(self, time: Float[np.ndarray, " n"], channels: Channels, card: Card, seed: int) -> None:
        self.full = {n: np.asarray(channels[n]) if n in channels else np.zeros(len(time)) for n in PATH_NEEDS}
        self.outputs, self.dt = path_outputs(channels), float(time[-1] - time[0]) / (len(time) - 1)
        given = {n: self.full[n] for n in channels if n in self.full}
        self.white, self.constant, self.shown = sensor_noise(given, card)
        self.aircraft = replace(NO_AIRCRAFT, accelerometer=card.aircraft.accelerometer)
        self.rng = np.random.default_rng([seed, 31])
        self.recorded = self.residuals({"q": np.zeros((1, len(time)))})

    def residuals(self, added: Mapping[str, Float[np.ndarray, "r n"]]) -> Float[np.ndarray, "r n c"]:
        """Recorded minus integrated from the start, for each of r disturbances that are `added` to some channels."""
        n, count = len(self.full["q"]), len(next(iter(added.values())))
        steps, start = np.full(n, self.dt), np.arange(n) == 0
        first, last = np.zeros(n, int), np.full(n, n - 1)
        residuals = np.empty((count, n, len(self.outputs)))
        for begin in range(0, count, TOGETHER):
            part = slice(begin, begin + TOGETHER)
            s = {name: x + added[name][part] if name in added else x for name, x in self.full.items()}
            s |= {f"{name}_dot": differentiate_joined(s[name], steps, first, last) for name in RATES}
            rates = path_rates(s, self.aircraft)
            for c, name in enumerate(self.outputs):
                residuals[part, :, c] = s[name] - integral(rates[name], steps, start, first)
        return residuals

    def gusts_shown(self) -> float:
        """Standard deviation of gusts (m/s) that the calmest of the air-data channels shows within windows, for air is
        alike in all directions (MIL-F-8785C, 3.7.2.2): an error of one sensor is no gust."""
        V, levels = self.full["airspeed"], []
        for name in (n for n in AIR_DATA if n in self.outputs):
            along = name == "airspeed"
            unit = gusts(self.rng, 16, len(V), self.dt, float(np.median(V)), across=not along)
            share = float(np.mean(np.median(_local(unit.T, self.dt) ** 2, axis=0)))
            scale = np.ones_like(V) if along else V
            inside = _local((self.recorded[0, :, self.outputs.index(name)] * scale)[:, None], self.dt)[:, 0]
            white = self.shown[name] * float(np.median(scale))
            levels.append(float(np.median(np.maximum(inside**2 - white**2, 0.0))) / max(share, 1e-12))
        return float(np.sqrt(min(levels, default=0.0)))

    def disturbances(self, turbulence: float, count: int) -> dict[str, Float[np.ndarray, "r n"]]:
        """What `count` sensors and airs of this kind add to the channels; `turbulence` in m/s."""
        V, rng = np.maximum(self.full["airspeed"], 1.0), self.rng
        added = {
            name: sd * rng.standard_normal((count, len(V))) + self.constant[name] * rng.standard_normal((count, 1))
            for name, sd in self.white.items()
        }
        for name in (name for name in AIR_DATA if name in added):
            along = name == "airspeed"
            gust = turbulence * gusts(rng, count, len(V), self.dt, float(np.median(V)), across=not along)
            added[name] += gust if along else gust / V
        return added


def _windows(n: int, dt: float) -> list[slice]:
    """Equal parts of about `WINDOW` s."""
    parts = max(1, round(n * dt / WINDOW))
    edges = np.linspace(0, n, parts + 1).astype(int)
    return [slice(int(a), int(b)) for a, b in pairwise(edges)]


def _local(x: Float[np.ndarray, "n c"], dt: float) -> Float[np.ndarray, "w c"]:
    """Root mean square within each window about its own straight line."""
    return np.stack([_rms_about_line(x[part][None])[0] for part in _windows(len(x), dt)])


def _rms_about_line(x: Float[np.ndarray, "r n c"]) -> Float[np.ndarray, "r c"]:
    line = np.linalg.qr(np.stack([np.ones(x.shape[1]), np.arange(x.shape[1])], axis=1))[0]
    left = x - line @ (line.T @ x)
    return np.sqrt(np.mean(left**2, axis=1))


def _measures(
    residual: Float[np.ndarray, "r n c"],
    columns: Float[np.ndarray, "m n c"],
    outputs: Sequence[str],
    time: Float[np.ndarray, " n"],
) -> _Measures:
    """All three measures of the recorded residual, the first, and of those of noise."""
    windows = _windows(len(time), float(time[-1] - time[0]) / (len(time) - 1))
    constants = _Constants(residual[1:], columns, time)
    values = []
    for first in range(0, len(residual), TOGETHER):  # a few records stay in the processor's cache
        some = residual[first : first + TOGETHER]
        centred, parts = some - some.mean(axis=1, keepdims=True), [_rms_about_line(some[:, part]) for part in windows]
        whole = np.sqrt(np.mean(centred**2, axis=1))
        values.append(np.concatenate([whole, constants.rms_without(centred), *parts], axis=1))
    begin, end, kinds = [time[0]] * 2, [time[-1]] * 2, [Measure.DRIFT, Measure.SHAPE]
    for part in windows:
        begin, end, kinds = [*begin, time[part][0]], [*end, time[part][-1]], [*kinds, Measure.WINDOW]
    count = len(outputs)
    return _Measures(
        np.concatenate(values),
        tuple(outputs) * len(kinds),
        tuple(float(t) for t in np.repeat(begin, count)),
        tuple(float(t) for t in np.repeat(end, count)),
        tuple(kind for kind in kinds for _ in range(count)),
    )


class _Constants:
    """The constant errors that suit all outputs of a record best, of any size, and a steady vertical wind."""

    def __init__(
        self, noise: Float[np.ndarray, "r n c"], columns: Float[np.ndarray, "m n c"], time: Float[np.ndarray, " n"]
    ) -> None:
        """`noise` gives the scale of the outputs; a constant error of each sensor makes `columns` of the residual."""
        self.step = max(1, len(time) // FITTED)
        self.scale = np.sqrt(np.mean([np.var(x[:: self.step], axis=0) for x in noise], axis=0))
        wind = np.zeros_like(columns[:1])
        wind[0, :, -1] = time
        B = np.concatenate([columns, wind])[:, :: self.step]
        B = (B - B.mean(axis=1, keepdims=True)) / self.scale
        size = np.sqrt(np.mean(B**2, axis=(1, 2)))
        unit = (B / np.maximum(size, 1e-300)[:, None, None])[size > 0.0].reshape(int(np.sum(size > 0.0)), -1).T
        directions, strengths, _ = np.linalg.svd(unit, full_matrices=False)
        self.basis = directions[:, strengths > RANK * strengths.max(initial=0.0)]

    def rms_without(self, centred: Float[np.ndarray, "r n c"]) -> Float[np.ndarray, "r c"]:
        """Root mean square of each output once they are taken out."""
        x = centred[:, :: self.step] / self.scale
        rows = x.reshape(len(x), -1)
        left = rows - (rows @ self.basis) @ self.basis.T
        return np.sqrt(np.mean(left.reshape(x.shape) ** 2, axis=1)) * self.scale


def _permitted(measures: _Measures) -> Float[np.ndarray, " k"]:
    """What noise permits: as many times a measure's usual size as the largest of its kind in any record of noise."""
    usual = np.sqrt(np.mean(measures.values[1:] ** 2, axis=0))
    largest, kind = measures.values[1:] / usual, np.array(measures.kind)
    return usual * np.array([np.max(largest[:, kind == k]) for k in kind])


def _departures(record: str, measures: _Measures) -> tuple[Departure, ...]:
    """Where the recorded measures exceed what is permitted: windows that touch make one, many the whole record."""
    permitted, recorded = _permitted(measures), measures.values[0]
    over = recorded > permitted
    departures = []
    for name in dict.fromkeys(measures.channel):
        at = [i for i, channel in enumerate(measures.channel) if channel == name]
        entire, parts = ([i for i in at if (measures.kind[i] is Measure.WINDOW) == w] for w in (False, True))
        chosen = [list(run) for exceeds, run in groupby(parts, lambda i: bool(over[i])) if exceeds]
        if not chosen or sum(over[parts]) > SPREAD * len(parts):
            chosen = [[max(entire, key=lambda i: recorded[i] / permitted[i])]] if any(over[entire]) else chosen
        for run in chosen:
            worst = max(run, key=lambda i: recorded[i] / permitted[i])
            size, limit = float(recorded[worst]), float(permitted[worst])
            departures.append(Departure(record, name, measures.begin[run[0]], measures.end[run[-1]], size, limit))
    return tuple(departures)


# --- What the flight path may leave if every sensor is as good as the card says: noise, constant errors, light
# turbulence.
# Drawn as records of disturbances of the recorded channels, so that whatever is computed from a record can be
# computed from disturbed ones, too, and compared in absolute terms.

DEGREE = math.pi / 180.0
DEFAULT_NOISE = {
    "ax": 0.02, "ay": 0.02, "az": 0.05, "p": 0.02 * DEGREE, "q": 0.02 * DEGREE, "r": 0.02 * DEGREE,
    "phi": 0.1 * DEGREE, "theta": 0.1 * DEGREE, "alpha": 0.1 * DEGREE, "beta": 0.1 * DEGREE,
    "airspeed": 0.3, "altitude": 3.0,
}  # fmt: skip
"""Standard deviation of each sensor's noise where the card states none, SI: a usual flight-test installation."""

NOISIER = 3.0  # times the stated noise: white noise that a record shows is no disagreement up to here
LIGHT_TURBULENCE = 1.0  # m/s, standard deviation of light turbulence; MIL-F-8785C, 3.7
CALM = 0.3  # m/s: air is never taken for calmer
SCALE_LENGTH = 533.0  # m, of turbulence above 2000 ft (1750 ft): MIL-F-8785C, 3.7.2
MARGIN = 2.0  # times the calmest air-data channel's own gusts: turbulence comes and goes within a record
AIR_DATA = ("airspeed", "alpha", "beta")


def sensor_noise(channels: Channels, card: Card) -> tuple[dict[str, float], dict[str, float], dict[str, float]]:
    """Standard deviations in SI by channel: white noise that is permitted in one record (as stated, or as the record
    shows it up to `NOISIER` times that), a constant error as large as the stated noise, and the white noise shown."""
    stated = {name: float(card.sensors.get(name) or DEFAULT_NOISE[name]) for name in DEFAULT_NOISE if name in channels}
    shown = {name: noise_of(np.asarray(channels[name])) for name in stated}
    permitted = {n: float(np.clip(shown[n], sd, NOISIER * sd)) for n, sd in stated.items()}
    return permitted, stated, shown


def gusts(
    rng: np.random.Generator, count: int, n: int, dt: float, airspeed: float, *, across: bool
) -> Float[np.ndarray, "r n"]:
    """Dryden turbulence of unit standard deviation along or across the path, met at a speed in m/s.

    Source: MIL-F-8785C, 3.7.2, T = L/V: along, 1/(1 + T s); across, (1 + sqrt(3) T s)/(1 + T s)^2.
    """
    keep = math.exp(-dt / (SCALE_LENGTH / max(airspeed, 1.0)))

    def response(n: int) -> Float[np.ndarray, " n"]:
        """To a single sample of one."""
        k = np.arange(n)
        second = math.sqrt(3.0) + (1.0 - math.sqrt(3.0)) * (1.0 - keep) * (k + 1) if across else 1.0
        return keep**k * second

    run_in = min(n, 4000)
    total = n + run_in
    size = next_fast_len(2 * total - 1 - run_in, real=True)  # what wraps around ends within the run-in
    spectrum = np.fft.rfft(response(total), size)
    drawn = np.fft.irfft(np.fft.rfft(rng.standard_normal((count, total)), size) * spectrum, size)
    deviation = np.sqrt(np.sum(response(int(20.0 / -math.log(keep)) + 1) ** 2))
    return drawn[:, run_in:total] / float(deviation)
