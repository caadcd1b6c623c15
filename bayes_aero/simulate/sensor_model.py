"""What a recorder stores of a simulated flight: channels by the card's names, with the noise of their sensors."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from bayes_aero.flight.card.card import Card

OTHER_SENSORS = {
    "ay": 0.02,
    "phi": 3e-4,
    "theta": 3e-4,
    "psi": 3e-4,
    "beta": 9e-4,
    "altitude": 0.5,
    "elevator": 3e-4,
    "stabilizer": 2e-4,
    "mach": 6e-4,
}
"""White noise of channels of which a card says nothing, SI: platform, vane, potentiometers; our choice."""

FLOWN = (
    "ax", "ay", "az", "p", "r", "elevator", "q", "phi", "theta", "psi", "alpha", "beta", "airspeed", "altitude",
    "stabilizer", "rudder", "flap", "spoiler_left", "spoiler_right", "dlc_left", "dlc_right", "mach", "density",
    "thrust",
)  # fmt: skip
"""Channels of a flight that a recorder may store, in the order in which their noise is drawn."""
RIGID = (*FLOWN, "aileron", "aileron_left", "aileron_right")
"""Those of a flight in six degrees of freedom."""

OUTLIER_SHARE, OUTLIER_SIZE, SPIKED = 0.005, 10.0, ("ax", "ay", "az", "q")


def sensed(
    rng: np.random.Generator, channels: Mapping[str, np.ndarray], card: Card, scale: float, spikes: bool
) -> dict[str, np.ndarray]:
    """With sensor noise, thrust by engine, outliers; the channels that the card maps."""
    engines = {f"thrust_{side}": channels["thrust"] / 2.0 for side in ("left", "right")}
    engine = card.sensors.get("thrust", 0.0) / math.sqrt(2.0)  # each
    deviations: dict[str, float] = {**OTHER_SENSORS, **card.sensors, **dict.fromkeys(engines, engine)}
    mapped = {channel.name for channel in card.channels}
    sensed = {}
    for name, values in (dict(channels) | engines).items():
        n, sd = len(values), scale * deviations.get(name, 0.0)
        noisy = values + sd * rng.standard_normal(n)
        hit, sign = rng.uniform(size=n) < OUTLIER_SHARE, rng.choice([-1.0, 1.0], n)
        if spikes and name in SPIKED:
            noisy = noisy + OUTLIER_SIZE * sd * hit * sign
        if name in mapped:
            sensed[name] = noisy
    return sensed
