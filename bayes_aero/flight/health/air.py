"""Air data that must agree with each other, with altitude and weight, and what tells flight from ground."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np
from scipy.ndimage import binary_closing, median_filter, uniform_filter1d

from bayes_aero.flight.card import Card
from bayes_aero.flight.card_tables import ATMOSPHERE, RULES
from bayes_aero.flight.channel import STANDARD_CHANNELS, UNITS, unit_choices
from bayes_aero.flight.health import (
    Findings,
    HealthFinding,
    channels_of,
    declared,
    found,
    noise_of,
    other_units,
    runs_of,
    shown,
)
from bayes_aero.flight.health.kinematics import AGREES, DENSITY0, THIN, View, thinness
from bayes_aero.flight.record import FlightRecord
from bayes_aero.physics.aircraft import AIRCRAFT_UNITS, GAMMA, GAS, GRAVITY, standard_air
from bayes_aero.units import instant, same_unit, to_si

# --- A quantity that is a factor away from what other channels make of it, and the unit that would explain the factor.

Limits = tuple[float, float]
"""Departure that still passes, and how near to one a unit must bring the factor; logarithms."""
SENSORS: Limits = (0.10, 0.06)  # a departure that no weather and no sensor makes
DAY: Limits = (0.30, 0.15)  # of the density that no weather makes at a pressure altitude (35 %, some 75 K)
COLD: Limits = (0.15, 0.10)  # likewise, of the speed of sound at an altitude
SLOPE: Limits = (1.5, 0.7)  # of a derivative: a factor of 4.5, where degrees for radians are one of 57
GRAVE = ("density", "airspeed", "altitude", "mach")


def other_unit(
    record: FlightRecord, card: Card, k: float, powers: Mapping[str, int], meant: str, limits: Limits = SENSORS,
    grave: bool | None = None,
) -> list[HealthFinding]:  # fmt: skip
    """A finding if a channel is k times what it must be and a unit explains that. powers: channels and the power with
    which each enters k, that first which is talked of. meant: what it must be. grave: None: if it is of `GRAVE`."""
    culprits = []
    for n, power in powers.items() if _off(k, limits) else ():
        left = {unit: abs(np.log(k * factor**power)) for unit, factor in other_units(card, n, unit_choices(n))}
        culprits += [(n, unit) for unit in sorted(left, key=lambda unit: left[unit]) if left[unit] < limits[1]]
    if not culprits:
        return []
    channel, unit = culprits[0]
    why = " or ".join(f"{n}, {declared(card, n).unit} on the card, is in {u}" for n, u in culprits)
    sentence = f"{next(iter(powers))} is {k:.3g} times {meant} throughout ({why})"
    sentence += f'; set unit = "{unit}" for {channel} on the card'
    return [found(record, channel, "unit", sentence, at=(0, record.n - 1), grave=_grave(channel, grave))]


def off_by_factor(
    record: FlightRecord, card: Card, k: float, powers: Mapping[str, int], meant: str, limits: Limits = SENSORS,
    grave: bool | None = None,
) -> list[HealthFinding]:  # fmt: skip
    """As `other_unit`; or a finding that no unit explains it."""
    unit, name = other_unit(record, card, k, powers, meant, limits, grave), next(iter(powers))
    if unit or not _off(k, limits):
        return unit
    sentence = (
        f"{name} is {k:.3g} times {meant} throughout (no unit explains it); correct {' or '.join(powers)} in the file, "
        "or take it off the card"
    )
    return [found(record, name, "factor", sentence, at=(0, record.n - 1), grave=_grave(name, grave))]


def _off(k: float, limits: Limits) -> bool:
    return bool(np.isfinite(k) and k > 0.0 and abs(np.log(k)) >= limits[0])


def _grave(channel: str, grave: bool | None) -> bool:
    return channel in GRAVE if grave is None else grave


# --- Quantities that several channels make together: density, dynamic pressure, Mach number, altitude, weight.

MOVING = 0.5  # of the median airspeed, above which air data are read
LEAST, MOST = 0.03, 4.5  # lift coefficients between which level flight is flown
USUAL = (0.08, 2.5)  # those that a unit must lead to, to be named
MIDDLING = 0.5  # among units that lead to usual ones, the nearest to this is named
THINNEST, THICKEST = 0.05, 1.6  # kg/m3; 22 km, and sea level at -70 degC


def air_data(record: FlightRecord, card: Card) -> Findings:
    """A finding for each relation between air data, altitude and weight that does not hold."""
    view = _view(record, card)
    have = frozenset(view) & frozenset(record.channels)
    warm = _middle(view["static_temperature"]) > 0.0 if "static_temperature" in have else False
    if warm and {"static_pressure", "density"} <= have:
        k = _middle(view["static_pressure"] / np.maximum(view["density"] * GAS * view["static_temperature"], 1e-9))
        yield from off_by_factor(record, card, k, {"static_pressure": 1, "density": -1}, "density times R T")
    if {"static_pressure", "altitude"} <= have:
        # that of the static pressure in a standard atmosphere; the ground pressure may differ by 5 %
        pressure = float(np.clip(_middle(view["static_pressure"]), 1000.0, 1.2e5))
        height, altitude = (1.0 - (pressure / 101325.0) ** 0.190263) / 2.25577e-5, _middle(view["altitude"])
        if pressure > 1000.0 and height >= 500.0 and altitude >= 150.0:
            meant = "the altitude of the static pressure"
            yield from other_unit(record, card, altitude / height, {"altitude": 1}, meant)
    if len(view.get("airspeed", ())) > 1:
        yield from _mach(record, card, view)
        yield from _calibrated(record, card, view, have)
    yield from _density(record, card, view)
    if len(view.get("airspeed", ())) > 1:
        yield from _dynamic_pressure(record, card, view)
        yield from _level_flight(record, card, view)


def _view(record: FlightRecord, card: Card) -> dict[str, np.ndarray]:
    """Finite channels and constants where the aircraft moves, and density by the card's rule if it was not recorded."""
    channels = channels_of(record, card)
    V = channels.get("airspeed")
    moving = np.ones(record.n, bool) if V is None else max(MOVING * float(np.nanmedian(V)), 1.0) < V
    view = {name: x[moving] for name, x in channels.items() if np.isfinite(x).all()}
    rule = card.derived.get("density", ATMOSPHERE)
    if "density" in view or not set(RULES["density"][rule]) <= set(view):
        return view
    if rule == "dynamic pressure":
        view["density"] = 2.0 * view["dynamic_pressure"] / view["airspeed"] ** 2
    elif rule == "gas law":
        view["density"] = view["static_pressure"] / (GAS * view["static_temperature"])
    elif "density" in card.derived:
        view["density"] = standard_air(view["altitude"])[0]
    return view


def _made_of(card: Card, record: FlightRecord) -> dict[str, int]:
    """The channels that the density came from, with their powers."""
    rule = card.derived.get("density")
    if record.has("density") or "density" in card.constants or rule is None:
        return {"density": 1}
    powers = {"dynamic pressure": {"dynamic_pressure": 1, "airspeed": -2}, "gas law": {"static_pressure": 1}}
    return powers.get(rule, {})


def _mach(record: FlightRecord, card: Card, view: View) -> Findings:
    """Mach number against airspeed over the speed of sound: of the temperature, else of a standard atmosphere."""
    warm = "static_temperature" in view
    if "mach" not in view or not record.has("mach") or not (warm or "altitude" in view):
        return
    flying = view["mach"] > 0.05
    if not flying.mean() > 0.5:
        return
    sound = np.sqrt(GAMMA * GAS * np.abs(view["static_temperature"])) if warm else standard_air(view["altitude"])[1]
    k = _middle((view["airspeed"] / (view["mach"] * np.maximum(sound, 1.0)))[flying])
    meant, powers = "Mach number times the speed of sound", {"airspeed": 1, "mach": -1}
    if warm:
        yield from as_calibrated(record, k, meant) or off_by_factor(record, card, k, powers, meant)
        return
    meant += " at the altitude"
    yield from other_unit(record, card, k, powers, meant, COLD) or (
        as_calibrated(record, k, meant) if _off(k, COLD) else []
    )


def _calibrated(record: FlightRecord, card: Card, view: View, have: frozenset[str]) -> Findings:
    """Calibrated airspeed against true airspeed."""
    ratio = thinness(view, have)
    if not {"calibrated_airspeed", "airspeed"} <= have or ratio is None:
        return
    k, thin = _middle(view["calibrated_airspeed"] / (view["airspeed"] * ratio)), _middle(ratio)
    if thin < THIN and k > 0.0 and abs(np.log(k * thin)) < 0.01:
        sentence = (
            "airspeed and calibrated_airspeed are the same numbers, and at this density true airspeed is "
            f"{1.0 / thin:.3g} times calibrated airspeed; map each to its own column"
        )
        yield found(record, "airspeed", "airspeed_kind", sentence, at=(0, record.n - 1))
    else:
        meant = f"true airspeed times the root of density over {DENSITY0} kg/m^3"
        yield from off_by_factor(record, card, k, {"calibrated_airspeed": 1}, meant, grave=False)


def as_calibrated(record: FlightRecord, k: float, meant: str) -> list[HealthFinding]:
    """True airspeed that is what calibrated airspeed would be."""
    ratio = thinness(record.channels, frozenset(record.channels))
    middle = 1.0 if ratio is None else float(np.median(ratio))
    if not (middle < THIN and _off(k, (AGREES, 0.0))) or abs(np.log(k / middle)) > AGREES:
        return []
    sentence = (
        f"airspeed is {k:.3g} times {meant}, as calibrated airspeed is at this density ({middle:.3g}): true airspeed "
        "is needed; divide it by the square root of density over 1.225 kg/m^3 in the file, or map the true airspeed"
    )
    return [found(record, "airspeed", "airspeed_kind", sentence, at=(0, record.n - 1))]


def _density(record: FlightRecord, card: Card, view: View) -> Findings:
    """Density against that of a standard atmosphere: a unit of it, or of the altitude, or none explains it."""
    powers = _made_of(card, record)
    if "density" not in view or "altitude" not in view or not powers or not len(view["density"]):
        return
    k = _middle(view["density"] / standard_air(view["altitude"])[0])
    meant = "that of a standard atmosphere at the altitude"
    if "density" not in powers:
        meant = f"what a standard atmosphere at the altitude would need ({card.derived['density']} on the card)"
    if unit := other_unit(record, card, k, powers, meant, DAY, True):
        yield from unit
        return
    if not _off(k, DAY):
        return
    stated = not record.has("density") and "density" in card.constants
    for unit, factor in other_units(card, "altitude", unit_choices("altitude")):
        near = abs(np.log(_middle(view["density"] / standard_air(factor * view["altitude"])[0]))) < DAY[1]
        if near and record.has("altitude") and "density" not in card.constants:
            sentence = (
                f"altitude, {declared(card, 'altitude').unit} on the card, looks like {unit}: the density is {k:.3g} "
                f'times that of a standard atmosphere there; set unit = "{unit}" for altitude on the card'
            )
            yield found(record, "altitude", "unit", sentence, grave=not record.has("density"))
            return
    name, height = next(iter(powers)), shown(card, "altitude", _middle(view["altitude"]))
    sentence = (
        f"the density, {_middle(view['density']):.3g} kg/m^3, is {k:.3g} times that of a standard atmosphere at "
        f"the altitude, {height}; no unit explains it: correct {name} or altitude"
    )
    yield found(record, name, "density", sentence, grave=stated or abs(np.log(k)) > 1.0)  # or off by a factor of e


def _dynamic_pressure(record: FlightRecord, card: Card, view: View) -> Findings:
    """Dynamic pressure against half of density times true airspeed squared."""
    if "dynamic_pressure" not in view or not record.has("dynamic_pressure"):
        return
    recorded = "density" in view and _made_of(card, record) == {"density": 1}
    if not recorded and "altitude" not in view:
        return
    rho, limits = (view["density"], SENSORS) if recorded else (standard_air(view["altitude"])[0], DAY)
    k = _middle(view["dynamic_pressure"] / (0.5 * rho * view["airspeed"] ** 2))
    powers = {"dynamic_pressure": 1, **({"density": -1} if recorded else {}), "airspeed": -2}
    meant = "half of density times airspeed squared"
    rests = True if card.derived.get("density") == "dynamic pressure" and not recorded else None
    said = other_unit(record, card, k, powers, meant, limits, rests)
    if not said and _off(k, limits):
        said = as_calibrated(record, k**-0.5, "what dynamic pressure and density make")
        # Impact pressure, which the pitot tube measures, is larger than dynamic pressure at high Mach number.
        M = _middle(view["mach"]) if "mach" in view else 0.0
        impact = ((1.0 + 0.2 * M**2) ** 3.5 - 1.0) / (0.7 * M**2) if M > 0.0 else 1.0
        if not said and "mach" in view and abs(np.log(k / impact)) <= 0.04:
            sentence = (
                f"dynamic_pressure is {k:.3g} times half of density times airspeed squared, as impact pressure is at "
                f"Mach {M:.2g}: map the dynamic pressure, or take it off the card"
            )
            said = [found(record, "dynamic_pressure", "unit", sentence, grave=False)]
        grave = bool(rests or _off(k, DAY))  # density or airspeed may be what is wrong
        said = said or off_by_factor(record, card, k, powers, meant, (limits[0], SENSORS[1]), grave)
    yield from said


def _level_flight(record: FlightRecord, card: Card, view: View) -> Findings:
    """The lift coefficient of level flight, which mass, wing area, density and airspeed make together."""
    mass, area = float(card.aircraft.mass), float(card.aircraft.wing_area)
    if not (np.isfinite(mass) and np.isfinite(area)) or "density" not in view:
        return
    CL = _middle(mass * GRAVITY / np.maximum(0.5 * view["density"] * view["airspeed"] ** 2 * area, 1e-9))
    if LEAST <= CL <= MOST:
        return
    rho, V = _middle(view["density"]), _middle(view["airspeed"])
    suspects = list(_suspects(card, CL, rho))
    why = f"looks as if {' or '.join(suspects)}" if suspects else "no one unit explains it"
    sentence = (
        f"level flight would need a lift coefficient of {CL:.3g} (mass {mass:.4g} kg, wing area {area:.4g} m^2, "
        f"density {rho:.3g} kg/m^3, airspeed {V:.4g} m/s): {why}; correct the unit on the card"
    )
    yield found(record, "airspeed" if THINNEST < rho < THICKEST else "density", "load", sentence)


def _suspects(card: Card, CL: float, rho: float) -> Iterator[str]:
    """What would make a usual lift coefficient if it were in another unit: the density alone where it is no air's."""
    strange = not THINNEST < rho < THICKEST
    for name, exponent in ({"density": -1} if strange else {"airspeed": -2, "mass": 1, "wing_area": -1}).items():
        channel = name in STANDARD_CHANNELS
        standard = STANDARD_CHANNELS[name].unit if channel else AIRCRAFT_UNITS[name]
        has, fit = declared(card, name).unit if channel else standard, {}
        for unit in UNITS[standard]:
            factor = float(to_si(1.0, unit, name, standard) / to_si(1.0, has, name, standard))
            made = CL * factor**exponent
            usual = USUAL[0] < made < USUAL[1] and (name != "density" or THINNEST < rho * factor < THICKEST)
            if usual and same_unit(unit, has) is False:
                fit[unit] = abs(np.log(made / MIDDLING))
        if fit:
            says = "the card says" if channel else "taken as"
            yield f"{name} were in {min(fit, key=lambda unit: fit[unit])} ({says} {has})"


def _middle(x: np.ndarray) -> float:
    return float(np.median(x)) if len(x) else float("nan")


# --- Recorded rates of change against the change of what they belong to: q-dot and the derivative of q.

PAIRS = {"p_dot": "p", "q_dot": "q", "r_dot": "r", "alpha_dot": "alpha", "beta_dot": "beta"}
SECONDS = 0.3  # of the mean that both are smoothed by
EXCITED = 5.0  # standard deviations of the noise, smoothed and differentiated, that the derivative must have
ALIKE = 0.8  # correlation from which the two are one motion


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
            yield from other_unit(record, card, k, {name: 1}, meant, SLOPE, flown)


def _smooth(x: np.ndarray, width: int) -> np.ndarray:
    """Twice the mean over `width` samples, without the ends."""
    return uniform_filter1d(uniform_filter1d(x, width), width)[width:-width]


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
