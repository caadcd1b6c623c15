"""What the flight path may leave if every sensor is as good as the card says: noise, constant errors, light turbulence.

Drawn as records of disturbances of the recorded channels, so that whatever is computed from a record can be computed
from disturbed ones, too, and compared in absolute terms.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.fft import next_fast_len

from bayes_aero.flight.card.card import Card
from bayes_aero.flight.health.signals import noise_of

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


@dataclass(frozen=True)
class SensorNoise:
    """Standard deviations in SI by channel: the `white` noise of each sample that is permitted, an error that is
    `constant` over a record, and the white noise that the record has `shown`."""

    white: Mapping[str, float]
    constant: Mapping[str, float]
    shown: Mapping[str, float]


def sensor_noise(channels: Mapping[str, Float[np.ndarray, " n"]], card: Card) -> SensorNoise:
    """Noise that is permitted in one record: as stated, or as the record shows it up to `NOISIER` times that.

    A constant error as large as the stated noise is permitted, too.
    """
    stated = {name: float(card.sensors.get(name) or DEFAULT_NOISE[name]) for name in DEFAULT_NOISE if name in channels}
    shown = {name: noise_of(np.asarray(channels[name])) for name in stated}
    permitted = {n: float(np.clip(shown[n], sd, NOISIER * sd)) for n, sd in stated.items()}
    return SensorNoise(permitted, stated, shown)


def gusts(
    rng: np.random.Generator, count: int, n: int, dt: float, airspeed: float, *, across: bool
) -> Float[np.ndarray, "r n"]:
    """Dryden turbulence of unit standard deviation along or across the path, met at a speed in m/s.

    Source: MIL-F-8785C, 3.7.2, T = L/V: along, 1/(1 + T s); across, (1 + sqrt(3) T s)/(1 + T s)^2.
    """
    run_in = min(n, 4000)
    T = SCALE_LENGTH / max(airspeed, 1.0)
    keep = math.exp(-dt / T)
    total = n + run_in
    size = next_fast_len(2 * total - 1 - run_in, real=True)  # what wraps around ends within the run-in
    spectrum = np.fft.rfft(_response(keep, total, across=across), size)
    drawn = np.fft.irfft(np.fft.rfft(rng.standard_normal((count, total)), size) * spectrum, size)
    return drawn[:, run_in:total] / _deviation(keep, across=across)


def _response(keep: float, n: int, *, across: bool) -> Float[np.ndarray, " n"]:
    """What `gusts` makes of a single sample of one."""
    k = np.arange(n)
    response = keep**k
    return response * (math.sqrt(3.0) + (1.0 - math.sqrt(3.0)) * (1.0 - keep) * (k + 1)) if across else response


def _deviation(keep: float, *, across: bool) -> float:
    """Standard deviation of what `gusts` filters from unit white noise: the sum of its squared impulse response."""
    return float(np.sqrt(np.sum(_response(keep, int(20.0 / -math.log(keep)) + 1, across=across) ** 2)))


def disturbances(
    channels: Mapping[str, Float[np.ndarray, " n"]],
    noise: SensorNoise,
    turbulence: float,
    dt: float,
    rng: np.random.Generator,
    count: int,
) -> dict[str, Float[np.ndarray, "r n"]]:
    """What `count` sensors and airs of this kind add to the channels of one record; `turbulence` in m/s."""
    n = len(next(iter(channels.values())))
    found = {
        name: sd * rng.standard_normal((count, n)) + noise.constant[name] * rng.standard_normal((count, 1))
        for name, sd in noise.white.items()
    }
    V = np.maximum(np.asarray(channels["airspeed"]), 1.0)
    for name in AIR_DATA:
        if name in found:
            along = name == "airspeed"
            gust = turbulence * gusts(rng, count, n, dt, float(np.median(V)), across=not along)
            found[name] += gust if along else gust / V
    return found
