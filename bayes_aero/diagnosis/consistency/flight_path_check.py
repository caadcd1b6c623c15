"""Where a record leaves its flight path by more than the sensors' noise permits.

Airspeed, flow angles, attitude and altitude must move as accelerometers and gyros say. What does not is compared with
the same of records of noise (see `path_noise`) by three measures of each channel: its root mean square over the record;
the same once the best constant errors are taken out; and over windows of ten seconds. The largest of all, in units of
what noise leaves there, decides: the rate of false alarms is that of a whole record, not of each window.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum
from itertools import groupby, pairwise

import numpy as np
from jaxtyping import Float

from bayes_aero.diagnosis.consistency.flight_path_noise import (
    AIR_DATA,
    CALM,
    LIGHT_TURBULENCE,
    MARGIN,
    SensorNoise,
    disturbances,
    gusts,
    sensor_noise,
)
from bayes_aero.diagnosis.consistency.flight_path_residuals import path_residuals
from bayes_aero.flight.agreement import Departure, PathCheck
from bayes_aero.flight.card.card import Card
from bayes_aero.physics.flightpath import PATH_NEEDS, STRAIGHT, path_outputs

WINDOW = 10.0  # s
REPLICATES = 200  # records of noise: one in 200 that are as noisy as permitted exceeds them all in a kind of measure
SPREAD = 0.6  # of the windows: a channel that exceeds in more of them does so over the whole record
FITTED = 2000  # samples that constant errors are fitted to
RANK = 1e-8  # constant errors that make a column weaker than this, beside others, make none of their own
TOGETHER = 8  # records that are measured at a time


class Kind(IntEnum):
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
    kind: tuple[Kind, ...]


def path_check(name: str, time: Float[np.ndarray, " n"], channels: Channels, card: Card, seed: int = 0) -> PathCheck:
    """Compare the flight path of one record with what noise permits.

    Args:
        name: of the record.
        time: s, evenly sampled.
        channels: (n,) each, SI; spikes repaired, errors of sensors that are known taken out.
        card: says the sensors' noise and where the accelerometer is.
        seed: of the records of noise.
    """
    assumed = tuple(n for n in STRAIGHT if n not in channels)
    outputs, place, rng = path_outputs(channels), card.aircraft.accelerometer, _draws(seed)
    full, recorded, noise, dt = _recorded(time, channels, card)
    met = _gusts_shown(recorded[0], outputs, full, noise, dt, rng)
    turbulence = float(np.clip(MARGIN * met, CALM, LIGHT_TURBULENCE))
    added = disturbances(full, noise, turbulence, dt, rng, REPLICATES)
    drawn, columns = (
        path_residuals(full, by, outputs, place, dt) for by in (added, _constant_errors(noise, len(time)))
    )
    drawn -= recorded
    columns -= recorded
    found = _measures(np.concatenate([recorded, drawn]), columns, outputs, time)
    return PathCheck(name, _departures(name, found), _whole(found), turbulence, met, assumed)


def gusts_met(time: Float[np.ndarray, " n"], channels: Channels, card: Card, seed: int = 0) -> float:
    """Standard deviation of the gusts that one record shows, m/s, as in `PathCheck`; arguments as of `path_check`."""
    full, recorded, noise, dt = _recorded(time, channels, card)
    return _gusts_shown(recorded[0], path_outputs(channels), full, noise, dt, _draws(seed))


def _draws(seed: int) -> np.random.Generator:
    return np.random.default_rng([seed, 31])


def _recorded(
    time: Float[np.ndarray, " n"], channels: Channels, card: Card
) -> tuple[dict[str, np.ndarray], Float[np.ndarray, "1 n c"], SensorNoise, float]:
    """Channels with zeros for those that are absent, what the flight path leaves of them, their noise, sample time."""
    full = {n: np.asarray(channels[n]) if n in channels else np.zeros(len(time)) for n in PATH_NEEDS}
    dt = float(time[-1] - time[0]) / (len(time) - 1)
    noise = sensor_noise({n: full[n] for n in channels if n in full}, card)
    still = {"q": np.zeros((1, len(time)))}
    return full, path_residuals(full, still, path_outputs(channels), card.aircraft.accelerometer, dt), noise, dt


def _gusts_shown(
    residual: Float[np.ndarray, "n c"],
    outputs: Sequence[str],
    channels: Channels,
    noise: SensorNoise,
    dt: float,
    rng: np.random.Generator,
) -> float:
    """Standard deviation of gusts (m/s) that the calmest of the air-data channels shows within windows, for air is
    alike in all directions (MIL-F-8785C, 3.7.2.2): an error of one sensor is no gust."""
    V = np.asarray(channels["airspeed"])
    levels = []
    for name in (n for n in AIR_DATA if n in outputs):
        along = name == "airspeed"
        unit = gusts(rng, 16, len(V), dt, float(np.median(V)), across=not along)
        share = float(np.mean(np.median(_local(unit.T, dt) ** 2, axis=0)))
        scale = np.ones_like(V) if along else V
        inside = _local((residual[:, outputs.index(name)] * scale)[:, None], dt)[:, 0]
        white = noise.shown[name] * float(np.median(scale))
        levels.append(float(np.median(np.maximum(inside**2 - white**2, 0.0))) / max(share, 1e-12))
    return float(np.sqrt(min(levels, default=0.0)))


def _constant_errors(noise: SensorNoise, n: int) -> dict[str, Float[np.ndarray, "m n"]]:
    """A constant error of each sensor by itself, as large as is permitted."""
    names = list(noise.constant)
    return {
        name: np.outer(np.arange(len(names)) == i, np.full(n, noise.constant[name])) for i, name in enumerate(names)
    }


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
    values = [
        _of_some(residual[first : first + TOGETHER], constants, windows) for first in range(0, len(residual), TOGETHER)
    ]
    begin, end, kinds = [time[0]] * 2, [time[-1]] * 2, [Kind.DRIFT, Kind.SHAPE]
    for part in windows:
        begin, end, kinds = [*begin, time[part][0]], [*end, time[part][-1]], [*kinds, Kind.WINDOW]
    count = len(outputs)
    return _Measures(
        np.concatenate(values),
        tuple(outputs) * len(kinds),
        tuple(float(t) for t in np.repeat(begin, count)),
        tuple(float(t) for t in np.repeat(end, count)),
        tuple(kind for kind in kinds for _ in range(count)),
    )


def _of_some(
    residual: Float[np.ndarray, "r n c"], constants: _Constants, windows: Sequence[slice]
) -> Float[np.ndarray, "r k"]:
    """The measures of a few records, which stay in the processor's cache."""
    centred = residual - residual.mean(axis=1, keepdims=True)
    parts = [_rms_about_line(residual[:, part]) for part in windows]
    return np.concatenate([np.sqrt(np.mean(centred**2, axis=1)), constants.rms_without(centred), *parts], axis=1)


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


def _permitted(found: _Measures) -> Float[np.ndarray, " k"]:
    """What noise permits of each measure: as many times its usual size as the largest of its kind in any record of
    noise."""
    usual = np.sqrt(np.mean(found.values[1:] ** 2, axis=0))
    largest, kind = found.values[1:] / usual, np.array(found.kind)
    return usual * np.array([np.max(largest[:, kind == k]) for k in kind])


def _departures(record: str, found: _Measures) -> tuple[Departure, ...]:
    """Where the recorded measures exceed what is permitted: windows that touch make one, many the whole record."""
    permitted, own = _permitted(found), found.values[0]
    over = own > permitted
    departures = []
    for name in dict.fromkeys(found.channel):
        at = [i for i, channel in enumerate(found.channel) if channel == name]
        entire, parts = ([i for i in at if (found.kind[i] is Kind.WINDOW) == w] for w in (False, True))
        runs = _runs([bool(over[i]) for i in parts])
        chosen = [[parts[i] for i in run] for run in runs]
        if not runs or sum(over[parts]) > SPREAD * len(parts):
            chosen = [[max(entire, key=lambda i: own[i] / permitted[i])]] if any(over[entire]) else chosen
        for run in chosen:
            worst = max(run, key=lambda i: own[i] / permitted[i])
            size, limit = float(own[worst]), float(permitted[worst])
            departures.append(Departure(record, name, found.begin[run[0]], found.end[run[-1]], size, limit))
    return tuple(departures)


def _runs(flags: Sequence[bool]) -> list[list[int]]:
    """Places of neighbouring true flags."""
    numbered = groupby(enumerate(flags), lambda pair: pair[1])
    return [[i for i, _ in run] for flag, run in numbered if flag]


def _whole(found: _Measures) -> dict[str, tuple[float, float]]:
    """Root mean square over the record once constant errors are out, and what is permitted, by channel."""
    permitted, names = _permitted(found), dict.fromkeys(found.channel)
    count = len(names)
    return {name: (float(found.values[0, count + i]), float(permitted[count + i])) for i, name in enumerate(names)}
