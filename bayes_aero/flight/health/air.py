"""Air data that must agree with each other, with altitude and weight, and what tells flight from ground."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np
from scipy.ndimage import binary_closing, median_filter, uniform_filter1d

from bayes_aero.flight.card import Card
from bayes_aero.flight.card_tables import ATMOSPHERE, RULES
from bayes_aero.flight.channel import STANDARD_CHANNELS
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
from bayes_aero.flight.health.kinematics import AGREES, DENSITY0, OFF, THIN, View, thinness
from bayes_aero.flight.record import FlightRecord
from bayes_aero.physics.aircraft import AIRCRAFT_UNITS, GAMMA, GAS, GRAVITY, standard_air
from bayes_aero.units import instant, same_unit, to_si


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
SPEEDS = ("m/s", "kt", "km/h", "ft/s", "mph")
UNITS = {
    "static_pressure": ("Pa", "hPa", "kPa", "psi", "lbf/ft^2", "inHg"),
    "dynamic_pressure": ("Pa", "hPa", "kPa", "psi", "lbf/ft^2", "inHg"),
    "density": ("kg/m^3", "slug/ft^3", "lb/ft^3", "g/m^3"), "airspeed": SPEEDS, "calibrated_airspeed": SPEEDS,
    "altitude": ("m", "ft"), "mach": ("1", "%"), **dict.fromkeys(("p_dot", "q_dot", "r_dot"), ("rad/s^2", "deg/s^2")),
    **dict.fromkeys(("alpha_dot", "beta_dot"), ("rad/s", "deg/s")),
}  # fmt: skip
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
    """A finding if a channel is k times what it must be, with the units that would explain it. powers: channels and the
    power with which each enters k; the first is the one that is talked of. meant: what it must be, in words. off:
    departure, as a logarithm, that still passes. near: how near to one, as a logarithm, a unit must bring the factor.
    grave: None: if the finding is about a channel of `GRAVE`. explained: whether nothing is said where no unit explains
    the factor."""
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


# --- Quantities that several channels make together: density at an altitude, dynamic pressure, Mach number, weight.

DAY = 0.30  # as a logarithm: the density that no weather makes at a pressure altitude (35 %, some 75 K)
NEAR_DAY = 0.15  # to the density of the day that a unit must come, as a logarithm
COLD = 0.15  # likewise, of the speed of sound at an altitude
MOVING = 0.5  # of the median airspeed, above which air data are read
LEAST, MOST = 0.03, 4.5  # lift coefficients between which level flight is flown
USUAL = (0.08, 2.5)  # those that a unit must lead to, to be named
MIDDLING = 0.5  # among units that lead to usual ones, the nearest to this is named
THINNEST, THICKEST = 0.05, 1.6  # kg/m3; 22 km, and sea level at -70 degC
CONSTANTS = {"mass": ("lb", "slug", "kg"), "wing_area": ("ft^2", "m^2")}


def across(record: FlightRecord, card: Card) -> Findings:
    """A finding for each such relation that does not hold."""
    view = _view(record, card)
    yield from _density(record, card, view)
    if len(view.get("airspeed", ())) > 1:
        yield from _dynamic_pressure(record, card, view)
        yield from _mach(record, card, view)
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


def _density(record: FlightRecord, card: Card, view: View) -> Findings:
    """Density against that of a standard atmosphere at the altitude: a unit of what makes it, or of the altitude, or
    none explains it."""
    powers = _made_of(card, record)
    if "density" not in view or "altitude" not in view or not powers or not len(view["density"]):
        return
    k = _middle(view["density"] / standard_air(view["altitude"])[0])
    meant = "that of a standard atmosphere at the altitude"
    if "density" not in powers:
        meant = f"what a standard atmosphere at the altitude would need ({card.derived['density']} on the card)"
    if said := off_by_factor(record, card, k, powers, meant, off=DAY, near=NEAR_DAY, grave=True, explained=True):
        yield from said
        return
    off = abs(np.log(max(k, 1e-9)))
    stated = not record.has("density") and "density" in card.constants
    for unit, factor in other_units(card, "altitude", UNITS["altitude"]):
        near = abs(np.log(_middle(view["density"] / standard_air(factor * view["altitude"])[0]))) < NEAR_DAY
        if near and off >= DAY and record.has("altitude") and "density" not in card.constants:
            sentence = (
                f"altitude, {declared(card, 'altitude').unit} on the card, looks like {unit}: the density is {k:.3g} "
                f'times that of a standard atmosphere there; set unit = "{unit}" for altitude on the card'
            )
            yield found(record, "altitude", "unit", sentence, grave=not record.has("density"))
            return
    if np.isfinite(k) and k > 0.0 and off >= DAY:  # grave if it is the card's, or off by a factor of e
        name, height = next(iter(powers)), shown(card, "altitude", _middle(view["altitude"]))
        sentence = (
            f"the density, {_middle(view['density']):.3g} kg/m^3, is {k:.3g} times that of a standard atmosphere at "
            f"the altitude, {height}; no unit explains it: correct {name} or altitude"
        )
        yield found(record, name, "density", sentence, grave=stated or abs(np.log(k)) > 1.0)


def _dynamic_pressure(record: FlightRecord, card: Card, view: View) -> Findings:
    """Dynamic pressure against half of density times true airspeed squared."""
    if "dynamic_pressure" not in view or not record.has("dynamic_pressure"):
        return
    recorded = "density" in view and _made_of(card, record) == {"density": 1}
    if recorded:
        rho, off, near = view["density"], 0.10, 0.06
    elif "altitude" in view:
        rho, off, near = standard_air(view["altitude"])[0], DAY, NEAR_DAY
    else:
        return
    k = _middle(view["dynamic_pressure"] / (0.5 * rho * view["airspeed"] ** 2))
    if not k > 0.0:
        return
    powers = {"dynamic_pressure": 1, **({"density": -1} if recorded else {"airspeed": -2})}
    if recorded:
        powers["airspeed"] = -2
    meant = "half of density times airspeed squared"
    rests = True if card.derived.get("density") == "dynamic pressure" and not recorded else None
    said = off_by_factor(record, card, k, powers, meant, off=off, near=near, grave=rests, explained=True)
    if not said and abs(np.log(k)) >= off:
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
        grave = bool(rests or abs(np.log(k)) > DAY)  # density or airspeed may be what is wrong
        said = said or off_by_factor(record, card, k, powers, meant, off=off, grave=grave)
    yield from said


def _mach(record: FlightRecord, card: Card, view: View) -> Findings:
    """Mach number against airspeed over the standard speed of sound, where no temperature was recorded."""
    if not {"mach", "altitude"} <= set(view) or "static_temperature" in view or not record.has("mach"):
        return
    flying = view["mach"] > 0.05
    if not flying.mean() > 0.5:
        return
    sound = standard_air(view["altitude"])[1]
    k = _middle((view["airspeed"] / (view["mach"] * sound))[flying])
    meant = "Mach number times the speed of sound at the altitude"
    said = off_by_factor(record, card, k, {"airspeed": 1, "mach": -1}, meant, off=COLD, near=0.1, explained=True)
    yield from said or (as_calibrated(record, k, meant) if abs(np.log(k)) > COLD else [])


def _level_flight(record: FlightRecord, card: Card, view: View) -> Findings:
    """The lift coefficient of level flight, which mass, wing area, density and airspeed make together."""
    mass, area = float(card.aircraft.mass), float(card.aircraft.wing_area)
    if not (np.isfinite(mass) and np.isfinite(area)) or "density" not in view or not len(view["airspeed"]):
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
    power = {"density": -1} if strange else {"airspeed": -2, "mass": 1, "wing_area": -1}
    for name, exponent in power.items():
        standard = STANDARD_CHANNELS[name].unit if name in STANDARD_CHANNELS else AIRCRAFT_UNITS[name]
        has = declared(card, name).unit if name in STANDARD_CHANNELS else standard
        fit = {}
        for unit in UNITS.get(name, CONSTANTS.get(name, ())):
            if same_unit(unit, has) is not False:
                continue
            factor = float(to_si(1.0, unit, name, standard) / to_si(1.0, has, name, standard))
            made = CL * factor**exponent
            if USUAL[0] < made < USUAL[1] and (name != "density" or THINNEST < rho * factor < THICKEST):
                fit[unit] = abs(np.log(made / MIDDLING))
        if fit:
            says = "the card says" if name in STANDARD_CHANNELS else "taken as"
            yield f"{name} were in {min(fit, key=lambda unit: fit[unit])} ({says} {has})"


def _middle(x: np.ndarray) -> float:
    return float(np.median(x)) if len(x) else float("nan")
