"""A channel recorded in steps that are too coarse for what is asked of it."""

from __future__ import annotations

import numpy as np

from bayes_aero.flight.card.card import Card
from bayes_aero.flight.health.finding import HealthFinding, found, shown
from bayes_aero.flight.health.signals import level_step
from bayes_aero.flight.record import FlightRecord

COARSEST = {
    "alpha": np.deg2rad(0.45), "beta": np.deg2rad(0.9), "theta": np.deg2rad(0.45), "phi": np.deg2rad(0.9),
    "elevator": np.deg2rad(0.45), "p": np.deg2rad(0.9), "q": np.deg2rad(0.45), "r": np.deg2rad(0.45),
    "ax": 0.2, "ay": 0.2, "az": 0.4, "airspeed": 1.2, "altitude": 15.0, "mach": 0.01, "density": 0.02,
}  # fmt: skip
"""Steps, SI, whose rounding error (a step over the square root of 12) is as large as a good sensor's error is tenfold;
recorders for accident investigation keep 0.2 to 0.35 deg, 0.01 g, 1 kt and are not reported."""
LEVELS = 8  # levels that the motion must cross, at least
CHANGES = 40  # a rounded channel changes its value often; an input in steps, a 3-2-1-1 without noise, some ten times


def quantised(record: FlightRecord, card: Card) -> list[HealthFinding]:
    """A finding for each channel whose step is too coarse in itself or for the motion that is flown."""
    said = []
    for name, coarsest in COARSEST.items():
        if not record.has(name) or np.count_nonzero(np.diff(record[name])) < CHANGES:
            continue
        x = record[name]
        step = level_step(x)
        moved = float(np.diff(np.quantile(x, (0.005, 0.995)))[0])
        few = name in ("alpha", "q", "az", "elevator") and step > 0.3 * coarsest and moved < LEVELS * step
        if step < coarsest and not few:
            continue
        sentence = (
            f"{name} is recorded in steps of {shown(card, name, step, size=True)}, and the flight crosses "
            f"{moved / step:.0f} of them: its rounding error of {shown(card, name, step / np.sqrt(12.0), size=True)} "
            "is not random noise; record it with more digits, or do not rely on results that use it"
        )
        said.append(found(record, name, "quantised", sentence, at=(0, record.n - 1)))
    return said
