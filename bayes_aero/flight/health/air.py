"""Air data that must agree with each other: p = rho R T, Mach number, calibrated and true airspeed, altitude."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from scipy.ndimage import binary_closing, median_filter, uniform_filter1d

from bayes_aero.flight.card.card import Card
from bayes_aero.flight.health.finding import GAMMA, GAS, Findings, HealthFinding, declared, found, other_units
from bayes_aero.flight.health.readings import AGREES, DENSITY0, THIN, thinness
from bayes_aero.flight.health.signals import noise_of, runs_of
from bayes_aero.flight.record import GRAVITY, FlightRecord
from bayes_aero.units import instant


def air_data(record: FlightRecord, card: Card) -> Findings:
    """A finding for each relation between air data that does not hold."""
    have = frozenset(n for n in record.channels if np.all(np.isfinite(record[n])))
    median = {n: float(np.median(record[n])) for n in have}
    if {"static_pressure", "density", "static_temperature"} <= have and median["static_temperature"] > 0.0:
        k = median["static_pressure"] / (median["density"] * GAS * median["static_temperature"])
        yield from off_by_factor(record, card, k, {"static_pressure": 1, "density": -1}, "density times R T")
    if {"mach", "airspeed", "static_temperature"} <= have and median["static_temperature"] > 0.0:
        moving = record["mach"] > 0.05
        if moving.mean() > 0.5:
            sound = np.sqrt(GAMMA * GAS * median["static_temperature"])
            k = float(np.median(record["airspeed"][moving] / record["mach"][moving])) / sound
            meant = "Mach number times the speed of sound"
            yield from as_calibrated(record, k, meant) or off_by_factor(
                record, card, k, {"airspeed": 1, "mach": -1}, meant
            )
    ratio = thinness(record.channels, have)
    if {"calibrated_airspeed", "airspeed"} <= have and ratio is not None and median["airspeed"] > 0.0:
        moving = record["airspeed"] > 0.5 * median["airspeed"]
        k = float(np.median(record["calibrated_airspeed"][moving] / (record["airspeed"] * ratio)[moving]))
        thin = float(np.median(ratio))
        if thin < THIN and abs(np.log(k * thin)) < 0.01:
            sentence = (
                "airspeed and calibrated_airspeed are the same numbers, and at this density true airspeed is "
                f"{1.0 / thin:.3g} times calibrated airspeed; map each to its own column"
            )
            yield found(record, "airspeed", "airspeed_kind", sentence, at=(0, record.n - 1))
        else:
            meant = f"true airspeed times the root of density over {DENSITY0} kg/m^3"
            yield from off_by_factor(record, card, k, {"calibrated_airspeed": 1}, meant, grave=False)
    if {"static_pressure", "altitude"} <= have and 1000.0 < median["static_pressure"] < 1.2e5:
        # that of the static pressure in a standard atmosphere; the ground pressure may differ by 5 %
        height = (1.0 - (median["static_pressure"] / 101325.0) ** 0.190263) / 2.25577e-5
        if height >= 500.0 and median["altitude"] >= 150.0:
            k, meant = median["altitude"] / height, "the altitude of the static pressure"
            yield from off_by_factor(record, card, k, {"altitude": 1}, meant, explained=True)


def as_calibrated(record: FlightRecord, k: float, meant: str) -> list[HealthFinding]:
    """True airspeed that is what calibrated airspeed would be."""
    ratio = thinness(record.channels, frozenset(record.channels))
    middle = 1.0 if ratio is None else float(np.median(ratio))
    if not middle < THIN or abs(np.log(k / middle)) > AGREES or abs(np.log(k)) < AGREES:
        return []
    sentence = (
        f"airspeed is {k:.3g} times {meant}, as calibrated airspeed is at this density ({middle:.3g}): true airspeed "
        "is needed; divide it by the square root of density over 1.225 kg/m^3 in the file, or map the true airspeed"
    )
    return [found(record, "airspeed", "airspeed_kind", sentence, at=(0, record.n - 1))]


# --- Parts of a record on the ground: no wing carries the aircraft at such a speed.

LIFT = 4.5  # lift coefficient that no wing has, for a load factor of one
SLOW = 0.25  # of the speed that the record keeps in its faster half, where the card states no wing
SHORTEST = 1.0  # s
LEVEL = 15.0  # m that the altitude of a runway and its noise stay within
DROPOUTS = 7  # samples of a median, for a dropout is no landing
FEWEST = 50  # samples of flight that the other checks need


def on_ground(record: FlightRecord, card: Card) -> Findings:
    """A finding if the airspeed is too low to fly for a second or more."""
    runs = grounded(record, card)
    if not runs:
        return
    parts = " and ".join(f"{instant(record.time[a])} to {instant(record.time[b])} s" for a, b in runs[:3])
    seconds = sum(b - a + 1 for a, b in runs) * record.dt
    slow = np.median(np.concatenate([record["airspeed"][a : b + 1] for a, b in runs]))
    sentence = (
        f"airspeed is too low to fly from {parts} ({seconds:.3g} s, median {slow:.3g} m/s): the aircraft is on the "
        "ground there; cut these parts out of the record"
    )
    yield found(record, "airspeed", "ground", sentence, at=(runs[0][0], runs[-1][1]))


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


# --- A quantity that is a factor away from what other channels make of it, and the unit that would explain the
# factor.

NEAR = 0.06  # of a factor, to that of two units, as a logarithm
OFF = 0.10  # departure that no weather and no sensor makes, as a logarithm
SPEEDS = ("m/s", "kt", "km/h", "ft/s", "mph")
UNITS = {
    "static_pressure": ("Pa", "hPa", "kPa", "psi", "lbf/ft^2", "inHg"),
    "dynamic_pressure": ("Pa", "hPa", "kPa", "psi", "lbf/ft^2", "inHg"),
    "density": ("kg/m^3", "slug/ft^3", "lb/ft^3", "g/m^3"),
    "airspeed": SPEEDS,
    "calibrated_airspeed": SPEEDS,
    "altitude": ("m", "ft"),
    "mach": ("1", "%"),
    **dict.fromkeys(("p_dot", "q_dot", "r_dot"), ("rad/s^2", "deg/s^2")),
    **dict.fromkeys(("alpha_dot", "beta_dot"), ("rad/s", "deg/s")),
}
GRAVE = ("density", "airspeed", "altitude", "mach")


def off_by_factor(
    record: FlightRecord,
    card: Card,
    k: float,
    powers: Mapping[str, int],
    meant: str,
    *,
    off: float = OFF,
    near: float = NEAR,
    grave: bool | None = None,
    explained: bool = False,
) -> list[HealthFinding]:
    """A finding if a channel is k times what it must be, with the units that would explain it.

    powers: channels and the power with which each enters k; the first is the one that is talked of. meant: what it must
    be, in words. off: departure, as a logarithm, that still passes. near: how near to one, as a logarithm, a unit must
    bring the factor. grave: None: if the finding is about a channel of `GRAVE`. explained: whether nothing is said
    where no unit explains the factor.
    """
    if not np.isfinite(k) or k <= 0.0 or abs(np.log(k)) < off:
        return []
    name = next(iter(powers))
    culprits = []
    for n, power in powers.items():
        left = {unit: abs(np.log(k * factor**power)) for unit, factor in other_units(card, n, UNITS.get(n, ()))}
        culprits += [(n, unit) for unit in sorted(left, key=lambda unit: left[unit]) if left[unit] < near]
    if explained and not culprits:
        return []
    if culprits:
        channel, unit, fault = *culprits[0], "unit"
        why = " or ".join(f"{n}, {declared(card, n).unit} on the card, is in {u}" for n, u in culprits)
        mend = f'set unit = "{unit}" for {channel} on the card'
    else:
        channel, why, fault = name, "no unit explains it", "factor"
        mend = f"correct {' or '.join(powers)} in the file, or take it off the card"
    sentence = f"{name} is {k:.3g} times {meant} throughout ({why}); {mend}"
    grave = channel in GRAVE if grave is None else grave
    return [found(record, channel, fault, sentence, at=(0, record.n - 1), grave=grave)]


# --- Recorded rates of change against the change of what they belong to: q-dot and the derivative of q.

PAIRS = {"p_dot": "p", "q_dot": "q", "r_dot": "r", "alpha_dot": "alpha", "beta_dot": "beta"}
SECONDS = 0.3  # of the mean that both are smoothed by
EXCITED = 5.0  # standard deviations of the noise, smoothed and differentiated, that the derivative must have
ALIKE = 0.8  # correlation from which the two are one motion
OFF_DERIVATIVE = 1.5  # as a logarithm: a factor of 4.5, where degrees for radians are one of 57


def derivatives(record: FlightRecord, card: Card) -> Findings:
    """A finding for each recorded derivative in another unit, or of the other sign, than the derivative itself."""
    for name, of in PAIRS.items():
        if not all(record.has(n) and np.isfinite(record[n]).all() for n in (name, of)):
            continue
        width = max(3, round(SECONDS / record.dt))
        x, slope = _smooth(record[name], width), _smooth(np.gradient(record[of], record.dt), width)
        if len(x) < 3 * width or not np.std(x) > 0.0:
            continue
        # The derivative of noise, over a mean of two times `width` samples.
        noise = noise_of(record[of]) / (record.dt * width**1.5)
        if np.std(slope) < EXCITED * noise or not np.std(slope) > 0.0:
            continue
        alike = float(np.corrcoef(x, slope)[0, 1])
        k, meant = float(np.std(x) / np.std(slope)), f"the derivative of {of}"
        flown = card.linear is not None and name in {*card.linear.states, *card.linear.outputs}
        if alike <= -ALIKE:
            sentence = (
                f"{name} counts the other way than {meant} does throughout (correlation {alike:.2g}); write sign = "
                f"{-declared(card, name).sign} at {name} on the card"
            )
            yield found(record, name, "sign", sentence, at=(0, record.n - 1), grave=flown)
        elif alike >= ALIKE:
            limits = {"off": OFF_DERIVATIVE, "near": 0.7}
            yield from off_by_factor(record, card, k, {name: 1}, meant, **limits, grave=flown, explained=True)


def _smooth(x: np.ndarray, width: int) -> np.ndarray:
    """Twice the mean over `width` samples, without the ends."""
    return uniform_filter1d(uniform_filter1d(x, width), width)[width:-width]
