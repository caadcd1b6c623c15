"""Random stall manoeuvres of the demo's kind, with banks, sideslip and steps of thrust and stabilizer."""

from __future__ import annotations

from collections.abc import Collection

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from bayes_aero.dynamics.simulate import Pilot

DT = 0.04  # s
LONGEST = 100.0  # s
MARGIN = 50  # samples flown before and after the record, for what reaches across its ends (delays)
SAMPLES = round(LONGEST / DT) + 1 + 2 * MARGIN
IDLE, CRUISE = 5_000.0, 22_000.0  # N
SURFACES = ("rudder", "spoiler", "dlc", "flap")

Series = Float[np.ndarray, " n"]


def flight_time() -> Series:
    """Time of every sample flown in s; the record begins at 0."""
    return (np.arange(SAMPLES) - MARGIN) * DT


def random_pilot(
    rng: np.random.Generator,
    duration: float,
    stall: float,
    disturbance: Float[np.ndarray, "n 3"],
    buffet: float,
    moved: Collection[str],
) -> Pilot:
    """One manoeuvre of `duration` s at random, into a stall at alpha `stall` (rad).

    Of `SURFACES` only those in `moved` are deflected.
    """
    time = flight_time()
    surfaces = {name: _pulses(time, rng, duration, 3, *DEFLECTIONS[name]) for name in SURFACES}  # drawn in any case
    return Pilot(
        alpha=jnp.asarray(_alpha(time, rng, duration, np.rad2deg(stall))),
        thrust=jnp.asarray(_thrust(time, rng, duration)),
        excitation=jnp.asarray(_three_two_one_one(time, rng, duration)),
        disturbance=jnp.asarray(disturbance),
        alpha_gain=jnp.asarray(0.7),
        rate_gain=jnp.asarray(0.2),
        phi=jnp.asarray(_banks(time, rng, duration)),
        beta=jnp.asarray(_sideslips(time, rng, duration)),
        stabilizer=jnp.asarray(_stabilizer(time, rng, duration)),
        buffet=jnp.asarray(buffet),
        trim_gain=jnp.asarray(0.15),
        **{name: jnp.asarray(x if name in moved else np.zeros_like(time)) for name, x in surfaces.items()},
    )


DEFLECTIONS = {
    "rudder": (3.0, True),  # greatest deflection in deg, and whether to either side
    "spoiler": (15.0, False),
    "dlc": (10.0, True),
    "flap": (14.0, False),
}


def _smooth(signal: Series, seconds: float) -> Series:
    """Convolved with a Hann window of this length; held constant beyond the ends."""
    window = np.hanning(round(seconds / DT) | 1)
    padded = np.pad(signal, len(window) // 2, mode="edge")
    return np.convolve(padded, window / window.sum(), mode="valid")


def _alpha(time: Series, rng: np.random.Generator, duration: float, stall: float) -> Series:
    """Slow approach to the stall, then two or three excursions past it, in rad: straight lines. `stall` in deg."""
    points = [(0.0, rng.uniform(5.5, 7.0)), (rng.uniform(7.0, 12.0), rng.uniform(5.5, 7.0))]
    t = rng.uniform(28.0, 40.0)
    points.append((t, stall + rng.uniform(-1.5, 0.0)))
    for _ in range(rng.integers(2, 4)):
        t += rng.uniform(3.0, 5.0)
        points.append((t, stall + rng.uniform(0.5, 2.5)))
        t += rng.uniform(3.0, 5.0)
        points.append((t, rng.uniform(10.0, 13.0)))
        t += rng.uniform(5.0, 8.0)
        points.append((t, stall + rng.uniform(-1.0, 1.0)))
    t += rng.uniform(8.0, 14.0)
    points += [(t, rng.uniform(7.5, 9.0)), (max(t + 8.0, duration), rng.uniform(5.5, 7.5))]
    return np.deg2rad(np.interp(time, *np.array(points).T))


def _thrust(time: Series, rng: np.random.Generator, duration: float) -> Series:
    """Cruise, idle with one or two bursts of power, cruise; N, each change within one to three seconds."""
    points, t = [(0.0, CRUISE)], rng.uniform(4.0, 7.0)
    points += [(t, CRUISE), (t + rng.uniform(1.0, 3.0), IDLE)]
    t = rng.uniform(14.0, 20.0)
    for _ in range(rng.integers(1, 3)):
        power = IDLE + rng.uniform(0.4, 1.0) * (CRUISE - IDLE)
        rise, hold, fall = rng.uniform(1.0, 3.0), rng.uniform(4.0, 8.0), rng.uniform(1.0, 3.0)
        points += [(t, IDLE), (t + rise, power), (t + rise + hold, power), (t + rise + hold + fall, IDLE)]
        t += rise + hold + fall + rng.uniform(8.0, 22.0)
    t = duration - rng.uniform(14.0, 20.0)
    points += [(t, IDLE), (t + rng.uniform(1.0, 3.0), CRUISE)]
    return np.interp(time, *np.array(points).T)


def _three_two_one_one(time: Series, rng: np.random.Generator, duration: float) -> Series:
    """Four elevator 3-2-1-1 sequences, rounded as by an actuator; rad."""
    signal = np.zeros_like(time)
    for begin in np.sort(rng.uniform(4.0, duration - 10.0, 4)):
        unit, size = rng.uniform(0.6, 1.0), np.deg2rad(rng.uniform(1.0, 2.0)) * rng.choice([-1.0, 1.0])
        for sign, first, last in ((1, 0, 3), (-1, 3, 5), (1, 5, 6), (-1, 6, 7)):
            signal[(time >= begin + first * unit) & (time < begin + last * unit)] = sign * size
    return _smooth(signal, 0.4)


def _banks(time: Series, rng: np.random.Generator, duration: float) -> Series:
    """Bank to bank, up to 30 deg either way, with wings level in between; rad."""
    points, t, side = [(0.0, 0.0)], rng.uniform(4.0, 12.0), rng.choice([-1.0, 1.0])
    while t < duration - 16.0:
        for sign in (side, -side):
            angle = sign * rng.uniform(12.0, 30.0)
            points += [(t, points[-1][1]), (t + 0.1, angle)]
            t += rng.uniform(5.0, 9.0)
        points += [(t, points[-1][1]), (t + 0.1, 0.0)]
        t += rng.uniform(6.0, 18.0)
    return _smooth(np.deg2rad(np.interp(time, *np.array(points).T)), 5.0)


def _sideslips(time: Series, rng: np.random.Generator, duration: float) -> Series:
    """Two or three excursions to one side and the other, up to 5 deg; rad."""
    return _smooth(_pulses(time, rng, duration, int(rng.integers(2, 4)), 5.0, True), 2.0)


def _stabilizer(time: Series, rng: np.random.Generator, duration: float) -> Series:
    """Trimmed in two or three steps of up to 1 deg; rad."""
    signal = np.full_like(time, rng.uniform(-1.0, 1.0))
    for begin in rng.uniform(6.0, duration - 10.0, rng.integers(2, 4)):
        signal[time >= begin] += rng.choice([-1.0, 1.0]) * rng.uniform(0.4, 1.0)
    return _smooth(np.deg2rad(signal), 2.0)


def _pulses(
    time: Series, rng: np.random.Generator, duration: float, count: int, degrees: float, either: bool
) -> Series:
    """Deflections held for some seconds at random times, `either` side in turn or one side only; rad."""
    signal = np.zeros_like(time)
    for slot in range(count):  # one to each share of the record, so that none hides another
        share = (duration - 20.0) / count
        begin = 6.0 + slot * share + rng.uniform(0.0, 0.4) * share
        hold, size = rng.uniform(2.5, 4.0), np.deg2rad(degrees) * rng.uniform(0.6, 1.0)
        sign = rng.choice([-1.0, 1.0]) if either else 1.0
        signal[(time >= begin) & (time < begin + hold)] = sign * size
        if either:
            signal[(time >= begin + hold) & (time < begin + 2.0 * hold)] = -sign * size
    return _smooth(signal, 1.0)
