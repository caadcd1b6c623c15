"""A flight from rigid-body kinematics alone, so that every channel agrees with every other, and sensors with noise."""

import json
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bayes_aero.flight.card import parse_card
from bayes_aero.flight.record import FlightRecord

BOOK = Path(__file__).parents[2].parent / "shared" / "book"
needs_book = pytest.mark.skipif(not BOOK.is_dir(), reason="the records of the book are not in ../shared/book")
G, DEG, KNOT, FOOT = 9.80665, np.pi / 180.0, 1852.0 / 3600.0, 0.3048
NOISE = {
    "ax": 0.03, "ay": 0.03, "az": 0.06, "p": 4e-4, "q": 4e-4, "r": 4e-4, "phi": 3e-4, "theta": 3e-4, "psi": 3e-4,
    "alpha": 9e-4, "beta": 9e-4, "airspeed": 0.15, "altitude": 0.4, "elevator": 3e-4,
}  # fmt: skip
UNITS = {
    "ax": "m/s^2", "ay": "m/s^2", "az": "m/s^2", "p": "deg/s", "q": "deg/s", "r": "deg/s", "phi": "deg", "theta": "deg",
    "psi": "deg", "alpha": "deg", "beta": "deg", "airspeed": "m/s", "altitude": "m", "elevator": "deg",
}  # fmt: skip


def card(**changes):
    """Of an aircraft with these channels; `changes` are whole tables of [channels], or other sections."""
    return _card(json.dumps(changes))


@cache
def _card(changes):
    changes = json.loads(changes)
    sections = {key: changes.pop(key) for key in ("constants",) if key in changes}
    channels = {name: {"unit": unit} for name, unit in UNITS.items()} | {"time": {"unit": "s"}} | changes
    channels = {name: {"label": name, **entry} for name, entry in channels.items()}
    aircraft = {
        "mass": "5700 kg", "Ix": "9000 kg m^2", "Iy": "14000 kg m^2", "Iz": "20000 kg m^2", "Ixz": "0 kg m^2",
        "wing_area": "28 m^2", "chord": "2 m", "half_span": "7 m", "aspect_ratio": 7.0, "tail_arm": "7 m",
    }  # fmt: skip
    table = {"aircraft": aircraft, "channels": channels, "model": {"effects": ["attached_lift"]}, **sections}
    return parse_card(table, "test", "test.toml")


def smooth(rng, n, dt, seconds):
    """A random signal of unit size that moves within `seconds`."""
    x = rng.standard_normal(n + 8 * round(seconds / dt))
    half = np.exp(-0.5 * (np.arange(-4.0 * seconds, 4.0 * seconds, dt) / seconds) ** 2)
    x = np.convolve(x, half, mode="same")[4 * round(seconds / dt) :][:n]
    return x / x.std()


def flight(seed=0, dt=0.04, seconds=60.0, noise=1.0, altitude=4000.0, bank=0.4, digits=None) -> FlightRecord:
    """Attitude, speed and flow angles chosen freely; rates, specific force and altitude follow from kinematics."""
    rng = np.random.default_rng(seed)
    n = round(seconds / dt) + 1
    t = np.arange(n) * dt
    rate = lambda x: np.gradient(x, dt)
    phi, theta = bank * smooth(rng, n, dt, 2.0), 0.05 + 0.1 * smooth(rng, n, dt, 1.5)
    alpha, beta = 0.12 + 0.05 * smooth(rng, n, dt, 1.0), 0.03 * smooth(rng, n, dt, 1.0)
    V = 80.0 + 6.0 * smooth(rng, n, dt, 3.0)
    climb = np.cos(alpha) * np.cos(beta) * np.sin(theta)
    climb -= (np.sin(beta) * np.sin(phi) + np.sin(alpha) * np.cos(beta) * np.cos(phi)) * np.cos(theta)
    h = altitude + np.cumsum(V * climb) * dt
    psi = np.cumsum(G / V * np.tan(phi)) * dt
    p = rate(phi) - rate(psi) * np.sin(theta)
    q = rate(theta) * np.cos(phi) + rate(psi) * np.sin(phi) * np.cos(theta)
    r = rate(psi) * np.cos(phi) * np.cos(theta) - rate(theta) * np.sin(phi)
    u, v, w = V * np.cos(alpha) * np.cos(beta), V * np.sin(beta), V * np.sin(alpha) * np.cos(beta)
    ax = rate(u) + q * w - r * v + G * np.sin(theta)
    ay = rate(v) + r * u - p * w - G * np.sin(phi) * np.cos(theta)
    az = rate(w) + p * v - q * u - G * np.cos(phi) * np.cos(theta)
    # An elevator that makes this pitching motion, nose down when it goes down.
    elevator = (-4.0 * (alpha - 0.12) - 2.0 * q - rate(q)) / 6.0
    true = {"ax": ax, "ay": ay, "az": az, "p": p, "q": q, "r": r, "phi": phi, "theta": theta, "psi": psi}
    true |= {"alpha": alpha, "beta": beta, "airspeed": V, "altitude": h, "elevator": elevator}
    recorded = {k: x + noise * NOISE[k] * rng.standard_normal(n) for k, x in true.items()}
    for name, digit in (digits or {}).items():
        recorded[name] = np.round(recorded[name] / digit) * digit
    return FlightRecord.from_arrays("flight", t, recorded)


def changed(record: FlightRecord, name: Any = "flight", without: Any = (), **channels) -> FlightRecord:
    """The record with other channels (or time)."""
    kept = {k: x for k, x in record.channels.items() if k not in without}
    time = channels.pop("time", record.time)
    return FlightRecord.from_arrays(name, time, {**kept, **channels})


def put(x, index, value):
    """A copy with samples replaced."""
    x = np.array(x)
    x[index] = value
    return x


def rounded(x, step):
    """To a last digit of this size, or as it is."""
    return step * np.round(x / step) if step else np.asarray(x)
