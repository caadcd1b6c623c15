"""Long parts of a record in which nothing is flown."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import maximum_filter1d, median_filter, minimum_filter1d

from bayes_aero.flight.card.card import Card
from bayes_aero.flight.health.finding import HealthFinding, found, span
from bayes_aero.flight.health.signals import runs_of
from bayes_aero.flight.record import FlightRecord

WINDOW = 10.0  # s
CALM = {
    "alpha": np.deg2rad(0.7), "q": np.deg2rad(1.0), "elevator": np.deg2rad(0.5), "stabilizer": np.deg2rad(0.2),
    "phi": np.deg2rad(2.0), "p": np.deg2rad(1.5), "beta": np.deg2rad(1.0), "rudder": np.deg2rad(0.5),
    "aileron": np.deg2rad(0.5), "aileron_left": np.deg2rad(0.5), "airspeed": 2.5,
}  # fmt: skip
"""Ranges within a window, SI, that no manoeuvre stays within."""
LONGEST = 30.0  # s that a manoeuvre may begin or end with


def idle(record: FlightRecord, card: Card) -> list[HealthFinding]:  # noqa: ARG001 - the checks have one signature
    """A finding for the longest part without motion, if it is longer than any entry into a manoeuvre."""
    have = [name for name in CALM if record.has(name)]
    if len(have) < 3 or record.n * record.dt < LONGEST + WINDOW:
        return []
    samples = max(3, round(WINDOW / record.dt))
    calm = np.ones(record.n, bool)
    for name in have:
        x = median_filter(record[name], 5, mode="nearest")
        calm &= maximum_filter1d(x, samples) - minimum_filter1d(x, samples) < CALM[name]
    runs = [(a - samples // 2, b + samples // 2) for a, b in runs_of(calm)]
    runs = [(max(a, 0), min(b, record.n - 1)) for a, b in runs]
    runs = [(a, b) for a, b in runs if (b - a) * record.dt >= LONGEST]
    if not runs:
        return []
    first, last = max(runs, key=lambda run: run[1] - run[0])
    sentence = (
        f"no manoeuvre is flown {span(record, first, last)} ({', '.join(have[:3])} and "
        "all else hardly move): this part only adds noise; cut it out, or keep it for the estimates of biases"
    )
    return [found(record, "record", "idle", sentence, at=(first, last), grave=False)]
