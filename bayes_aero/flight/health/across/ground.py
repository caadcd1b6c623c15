"""Parts of a record on the ground: no wing carries the aircraft at such a speed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.ndimage import binary_closing, median_filter

from bayes_aero.flight.card.card import Card
from bayes_aero.flight.health.finding import HealthFinding, found
from bayes_aero.flight.health.readings import DENSITY0, thinness
from bayes_aero.flight.health.signals import runs_of
from bayes_aero.flight.record import FlightRecord
from bayes_aero.flight.tolerances import GRAVITY
from bayes_aero.units import instant

LIFT = 4.5  # lift coefficient that no wing has, for a load factor of one
SLOW = 0.25  # of the speed that the record keeps in its faster half, where the card states no wing
SHORTEST = 1.0  # s
LEVEL = 15.0  # m that the altitude of a runway and its noise stay within
DROPOUTS = 7  # samples of a median, for a dropout is no landing
FEWEST = 50  # samples of flight that the other checks need


def on_ground(record: FlightRecord, card: Card) -> list[HealthFinding]:
    """A finding if the airspeed is too low to fly for a second or more."""
    runs = grounded(record, card)
    if not runs:
        return []
    parts = " and ".join(f"{instant(record.time[a])} to {instant(record.time[b])} s" for a, b in runs[:3])
    seconds = sum(b - a + 1 for a, b in runs) * record.dt
    slow = np.median(np.concatenate([record["airspeed"][a : b + 1] for a, b in runs]))
    sentence = (
        f"airspeed is too low to fly from {parts} ({seconds:.3g} s, median {slow:.3g} m/s): the aircraft is on the "
        "ground there; cut these parts out of the record"
    )
    return [found(record, "airspeed", "ground", sentence, at=(runs[0][0], runs[-1][1]))]


def in_flight(record: FlightRecord, card: Card) -> FlightRecord:
    """The longest part of the record that is flown, under the record's name; the record itself if all of it is."""
    runs = grounded(record, card)
    if not runs:
        return record
    edges = [-1, *(i for a, b in runs for i in (a - 1, b)), record.n - 1]
    first, last = max(zip(edges[::2], edges[1::2], strict=True), key=lambda part: part[1] - part[0])
    if last - first < FEWEST:
        return record
    return replace(record.window(record.time[first + 1], record.time[last]), name=record.name)


def grounded(record: FlightRecord, card: Card) -> list[tuple[int, int]]:
    """First and last sample of each part on the ground; none if the whole record looks like that."""
    if not record.has("airspeed"):
        return []
    V, aircraft = np.maximum(median_filter(record["airspeed"], DROPOUTS, mode="nearest"), 1e-3), card.aircraft
    ratio = thinness(record.channels, frozenset(record.channels))
    density = DENSITY0 * (1.0 if ratio is None else ratio**2)
    weight, area = float(aircraft.mass) * GRAVITY, float(aircraft.wing_area)
    if np.isfinite(weight) and np.isfinite(area) and area > 0.0:
        load = np.clip(-record["az"] / GRAVITY, 0.3, 1.0) if record.has("az") else 1.0
        too_slow = load * weight / (0.5 * density * V**2 * area) > LIFT
    else:
        too_slow = SLOW * np.quantile(V, 0.75) > V
    if np.mean(too_slow) > 0.95:  # all of it: the unit or kind of airspeed, which others tell
        return []
    gap = max(1, round(SHORTEST / record.dt))
    too_slow = binary_closing(np.pad(too_slow, gap, mode="edge"), np.ones(gap))[gap:-gap]
    runs = [run for run in runs_of(too_slow) if (run[1] - run[0]) * record.dt >= SHORTEST]
    if not record.has("altitude"):
        return runs
    height = median_filter(record["altitude"], DROPOUTS, mode="nearest")
    return [(a, b) for a, b in runs if np.ptp(height[a : b + 1]) < LEVEL]
