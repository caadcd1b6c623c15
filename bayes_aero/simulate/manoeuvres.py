"""Random stall manoeuvres of the demo's kind, with banks, sideslip and steps of thrust and stabilizer."""

from __future__ import annotations

from collections.abc import Collection, Iterable

import numpy as np
from jaxtyping import Float
from scipy.interpolate import CubicSpline
from scipy.signal import lfilter

from bayes_aero.dynamics.simulated.manoeuvres import Series, pulses, ramps, rounded, three_two_one_one
from bayes_aero.dynamics.simulated.simulate import Pilot
from bayes_aero.effect import Effect

DT = 0.04  # s
LONGEST = 100.0  # s
MARGIN = 50  # samples flown before and after the record, for what reaches across its ends (delays)
SAMPLES = round(LONGEST / DT) + 1 + 2 * MARGIN
IDLE, CRUISE = 5_000.0, 22_000.0  # N
SURFACES = ("rudder", "spoiler", "dlc", "flap")


def flight_time() -> Series:
    """Time of every sample flown in s; the record begins at 0."""
    return (np.arange(SAMPLES) - MARGIN) * DT


def random_pilot(rng: np.random.Generator, duration: float, stall: float, moved: Collection[str]) -> Pilot:
    """One manoeuvre of `duration` s at random, into a stall at alpha `stall` (rad), at the samples of `flight_time`.

    Of `SURFACES` only those in `moved` are deflected.
    """
    time = flight_time()
    surfaces = {name: _pulses(time, rng, duration, 3, *DEFLECTIONS[name]) for name in SURFACES}  # drawn in any case
    return Pilot(
        alpha=_alpha(time, rng, duration, np.rad2deg(stall)),
        thrust=_thrust(time, rng, duration),
        excitation=_excitation(time, rng, duration),
        phi=_banks(time, rng, duration),
        beta=_sideslips(time, rng, duration),
        stabilizer=_stabilizer(time, rng, duration),
        trim_gain=0.15,
        **{name: x if name in moved else np.zeros_like(time) for name, x in surfaces.items()},
    )


def resampled(pilot: Pilot, time: Series) -> Pilot:
    """A pilot of `random_pilot` at other samples; what is differentiated stays smooth."""
    own = flight_time()
    smooth = {name: CubicSpline(own, getattr(pilot, name))(time) for name in ("phi", "beta")}
    rows = {name: np.interp(time, own, x) for name, x in pilot._asdict().items() if np.ndim(x) and name not in smooth}
    return pilot._replace(**smooth, **rows)


def moved_by(effects: Iterable[Effect]) -> list[str]:
    """`SURFACES` through which any of the effects acts."""
    needed = {channel for effect in effects for channel in effect.channels}
    return [name for name in SURFACES if {name, f"{name}_left"} & needed]


def autoregressive(white: Float[np.ndarray, "n 3"], rho: Iterable[float], sigma: Iterable[float]) -> np.ndarray:
    """Disturbances of CL, CD, Cm (n, 3) with lag-1 correlations `rho`, stationary from the first sample."""

    def series(x: Series, r: float, s: float) -> Series:
        drive = np.concatenate([x[:1], np.sqrt(1.0 - r**2) * x[1:]])
        return s * np.asarray(lfilter([1.0], [1.0, -r], drive))

    return np.stack([series(*row) for row in zip(white.T, rho, sigma, strict=True)], axis=1)


DEFLECTIONS = {
    "rudder": (3.0, True),  # greatest deflection in deg, and whether to either side
    "spoiler": (15.0, False),
    "dlc": (10.0, True),
    "flap": (14.0, False),
}


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
    return np.deg2rad(ramps(time, points))


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
    return ramps(time, points)


def _excitation(time: Series, rng: np.random.Generator, duration: float) -> Series:
    """Four elevator 3-2-1-1 sequences; rad."""
    parts = []
    for begin in np.sort(rng.uniform(4.0, duration - 10.0, 4)):
        unit, size = rng.uniform(0.6, 1.0), np.deg2rad(rng.uniform(1.0, 2.0)) * rng.choice([-1.0, 1.0])
        parts += three_two_one_one(begin, unit, size)
    return rounded(pulses(time, parts), 0.4, DT)


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
    return rounded(np.deg2rad(ramps(time, points)), 5.0, DT)


def _sideslips(time: Series, rng: np.random.Generator, duration: float) -> Series:
    """Two or three excursions to one side and the other, up to 5 deg; rad."""
    return rounded(_pulses(time, rng, duration, int(rng.integers(2, 4)), 5.0, True), 2.0, DT)


def _stabilizer(time: Series, rng: np.random.Generator, duration: float) -> Series:
    """Trimmed in two or three steps of up to 1 deg; rad."""
    signal = np.full_like(time, rng.uniform(-1.0, 1.0))
    for begin in rng.uniform(6.0, duration - 10.0, rng.integers(2, 4)):
        signal[time >= begin] += rng.choice([-1.0, 1.0]) * rng.uniform(0.4, 1.0)
    return rounded(np.deg2rad(signal), 2.0, DT)


def _pulses(
    time: Series, rng: np.random.Generator, duration: float, count: int, degrees: float, either: bool
) -> Series:
    """Deflections held for some seconds at random times, `either` side in turn or one side only; rad."""
    parts = []
    for slot in range(count):  # one to each share of the record, so that none hides another
        share = (duration - 20.0) / count
        begin = 6.0 + slot * share + rng.uniform(0.0, 0.4) * share
        hold, size = rng.uniform(2.5, 4.0), np.deg2rad(degrees) * rng.uniform(0.6, 1.0)
        sign = rng.choice([-1.0, 1.0]) if either else 1.0
        parts.append((begin, begin + hold, sign * size))
        if either:
            parts.append((begin + hold, begin + 2.0 * hold, -sign * size))
    return rounded(pulses(time, parts), 1.0, DT)
