"""Air data that must agree with each other, with altitude and weight, and what tells flight from ground."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

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
    finding,
    longest,
    noise_of,
    other_units,
    runs_of,
    shown,
)
from bayes_aero.flight.health.kinematics import AGREES, DENSITY0, THIN, thinness
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


def _off(k: float, limits: Limits) -> bool:
    return bool(np.isfinite(k) and k > 0.0 and abs(np.log(k)) >= limits[0])


def _middle(x: np.ndarray) -> float:
    return float(np.median(x)) if len(x) else float("nan")


@dataclass(frozen=True)
class _Ratio:
    """A channel that is `k` times what it must be (`meant`). `powers`: channels and the power with which each enters k,
    that first which is talked of. `grave`: None: if it is of those that results rest on."""

    k: float
    powers: Mapping[str, int]
    meant: str
    limits: Limits = SENSORS
    grave: bool | None = None

    def findings(self, record: FlightRecord, card: Card, *, unexplained: bool = True) -> list[HealthFinding]:
        """A finding if a unit explains the factor, or, with `unexplained`, if none does."""
        if not _off(self.k, self.limits):
            return []
        culprits, name = [], next(iter(self.powers))
        for n, power in self.powers.items():
            left = {u: abs(np.log(self.k * x**power)) for u, x in other_units(card, n, unit_choices(n))}
            culprits += [(n, unit) for unit in sorted(left, key=left.__getitem__) if left[unit] < self.limits[1]]
        channel, unit = culprits[0] if culprits else (name, "")
        why = " or ".join(f"{n}, {declared(card, n).unit} on the card, is in {u}" for n, u in culprits)
        mend = f'set unit = "{unit}" for {channel} on the card'
        if not culprits:
            mend = f"correct {' or '.join(self.powers)} in the file, or take it off the card"
        sentence = f"{name} is {self.k:.3g} times {self.meant} throughout ({why or 'no unit explains it'}); {mend}"
        grave = channel in ("density", "airspeed", "altitude", "mach") if self.grave is None else self.grave
        fault = "unit" if culprits else "factor"
        return [finding(record, channel, fault, sentence, grave=grave)] if culprits or unexplained else []


# --- Quantities that several channels make together: density, dynamic pressure, Mach number, altitude, weight.

LEAST, MOST = 0.03, 4.5  # lift coefficients between which level flight is flown
USUAL, MIDDLING = (0.08, 2.5), 0.5  # those that a unit must lead to, to be named: the nearest to the middling one
THINNEST, THICKEST = 0.05, 1.6  # kg/m3; 22 km, and sea level at -70 degC


def air_data(record: FlightRecord, card: Card) -> Findings:
    """A finding for each relation between air data, altitude and weight that does not hold."""
    view = _view(record, card)
    have = frozenset(view) & frozenset(record.channels)
    moves = len(view.get("airspeed", ())) > 1
    if {"static_temperature", "static_pressure", "density"} <= have and _middle(view["static_temperature"]) > 0.0:
        k = _middle(view["static_pressure"] / np.maximum(view["density"] * GAS * view["static_temperature"], 1e-9))
        yield from _Ratio(k, {"static_pressure": 1, "density": -1}, "density times R T").findings(record, card)
    if {"static_pressure", "altitude"} <= have:
        # that of the static pressure in a standard atmosphere; the ground pressure may differ by 5 %
        pressure = float(np.clip(_middle(view["static_pressure"]), 1000.0, 1.2e5))
        height, altitude = (1.0 - (pressure / 101325.0) ** 0.190263) / 2.25577e-5, _middle(view["altitude"])
        if pressure > 1000.0 and height >= 500.0 and altitude >= 150.0:
            heights = _Ratio(altitude / height, {"altitude": 1}, "the altitude of the static pressure")
            yield from heights.findings(record, card, unexplained=False)
    if moves and "mach" in have:
        yield from _mach(record, card, view)
    if (
        moves
        and {"calibrated_airspeed", "airspeed"} <= have
        and (ratio := thinness({name: view[name] for name in have})) is not None
    ):
        k, thin = _middle(view["calibrated_airspeed"] / (view["airspeed"] * ratio)), _middle(ratio)
        if thin < THIN and k > 0.0 and abs(np.log(k * thin)) < 0.01:
            yield finding(
                record, "airspeed", "airspeed_kind",
                "airspeed and calibrated_airspeed are the same numbers, and at this density true airspeed is "
                f"{1.0 / thin:.3g} times calibrated airspeed; map each to its own column",
            )  # fmt: skip
        else:
            meant = f"true airspeed times the root of density over {DENSITY0} kg/m^3"
            yield from _Ratio(k, {"calibrated_airspeed": 1}, meant, grave=False).findings(record, card)
    if {"density", "altitude"} <= view.keys() and len(view["density"]):
        yield from _density(record, card, view)
    if moves and "dynamic_pressure" in have:
        yield from _dynamic_pressure(record, card, view)
    if moves and "density" in view:
        yield from _level_flight(record, card, view)


def _view(record: FlightRecord, card: Card) -> dict[str, np.ndarray]:
    """Finite channels and constants where the aircraft moves, and density by the card's rule if it was not recorded."""
    channels = channels_of(record, card)
    V = channels.get("airspeed")
    moving = np.ones(record.n, bool) if V is None else max(0.5 * float(np.nanmedian(V)), 1.0) < V
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


def _mach(record: FlightRecord, card: Card, view: Mapping[str, np.ndarray]) -> Findings:
    """Mach number against airspeed over the speed of sound: of the temperature, else of a standard atmosphere."""
    warm, flying = "static_temperature" in view, view["mach"] > 0.05
    if not (warm or "altitude" in view) or not flying.mean() > 0.5:
        return
    sound = np.sqrt(GAMMA * GAS * np.abs(view["static_temperature"])) if warm else standard_air(view["altitude"])[1]
    k = _middle((view["airspeed"] / (view["mach"] * np.maximum(sound, 1.0)))[flying])
    meant = "Mach number times the speed of sound" + ("" if warm else " at the altitude")
    ratio = _Ratio(k, {"airspeed": 1, "mach": -1}, meant, SENSORS if warm else COLD)
    unit = ratio.findings(record, card, unexplained=False)
    yield from unit or _as_calibrated(record, k, meant) or (ratio.findings(record, card) if warm else [])


def _as_calibrated(record: FlightRecord, k: float, meant: str) -> list[HealthFinding]:
    """True airspeed that is what calibrated airspeed would be."""
    ratio = thinness(record.channels)
    middle = 1.0 if ratio is None else float(np.median(ratio))
    if not (middle < THIN and _off(k, (AGREES, 0.0))) or abs(np.log(k / middle)) > AGREES:
        return []
    sentence = (
        f"airspeed is {k:.3g} times {meant}, as calibrated airspeed is at this density ({middle:.3g}): true airspeed "
        "is needed; divide it by the square root of density over 1.225 kg/m^3 in the file, or map the true airspeed"
    )
    return [finding(record, "airspeed", "airspeed_kind", sentence)]


def _density(record: FlightRecord, card: Card, view: Mapping[str, np.ndarray]) -> Findings:
    """Density against that of a standard atmosphere: a unit of it, or of the altitude, or none explains it."""
    if not (powers := _made_of(card, record)):
        return
    k = _middle(view["density"] / standard_air(view["altitude"])[0])
    meant = "that of a standard atmosphere at the altitude"
    if "density" not in powers:
        meant = f"what a standard atmosphere at the altitude would need ({card.derived['density']} on the card)"
    named = _Ratio(k, powers, meant, DAY, grave=True).findings(record, card, unexplained=False)
    yield from named
    if named or not _off(k, DAY):
        return
    for unit, factor in other_units(card, "altitude", unit_choices("altitude")):
        near = abs(np.log(_middle(view["density"] / standard_air(factor * view["altitude"])[0]))) < DAY[1]
        if near and record.has("altitude") and "density" not in card.constants:
            yield finding(
                record, "altitude", "unit",
                f"altitude, {declared(card, 'altitude').unit} on the card, looks like {unit}: the density is {k:.3g} "
                f'times that of a standard atmosphere there; set unit = "{unit}" for altitude on the card', None,
                grave=not record.has("density"),
            )  # fmt: skip
            return
    name, height = next(iter(powers)), shown(card, "altitude", _middle(view["altitude"]))
    stated = not record.has("density") and "density" in card.constants
    yield finding(
        record, name, "density",
        f"the density, {_middle(view['density']):.3g} kg/m^3, is {k:.3g} times that of a standard atmosphere at "
        f"the altitude, {height}; no unit explains it: correct {name} or altitude", None,
        grave=stated or abs(np.log(k)) > 1.0,
    )  # fmt: skip


def _dynamic_pressure(record: FlightRecord, card: Card, view: Mapping[str, np.ndarray]) -> Findings:
    """Dynamic pressure against half of density times true airspeed squared."""
    recorded = "density" in view and _made_of(card, record) == {"density": 1}
    if not recorded and "altitude" not in view:
        return
    rho, limits = (view["density"], SENSORS) if recorded else (standard_air(view["altitude"])[0], DAY)
    k = _middle(view["dynamic_pressure"] / (0.5 * rho * view["airspeed"] ** 2))
    rests = card.derived.get("density") == "dynamic pressure" and not recorded
    powers = {"dynamic_pressure": 1, **({"density": -1} if recorded else {}), "airspeed": -2}
    ratio = _Ratio(k, powers, "half of density times airspeed squared", limits, True if rests else None)
    findings = ratio.findings(record, card, unexplained=False)
    if not findings and _off(k, limits):
        findings = _as_calibrated(record, k**-0.5, "what dynamic pressure and density make")
        # Impact pressure, which the pitot tube measures, is larger than dynamic pressure at high Mach number.
        M = _middle(view["mach"]) if "mach" in view else 0.0
        impact = ((1.0 + 0.2 * M**2) ** 3.5 - 1.0) / (0.7 * M**2) if M > 0.0 else 1.0
        if not findings and "mach" in view and abs(np.log(k / impact)) <= 0.04:
            sentence = (
                f"dynamic_pressure is {k:.3g} times half of density times airspeed squared, as impact pressure is at "
                f"Mach {M:.2g}: map the dynamic pressure, or take it off the card"
            )
            findings = [finding(record, "dynamic_pressure", "unit", sentence, grave=False)]
        grave = rests or _off(k, DAY)  # density or airspeed may be what is wrong
        findings = findings or replace(ratio, grave=grave).findings(record, card)
    yield from findings


def _level_flight(record: FlightRecord, card: Card, view: Mapping[str, np.ndarray]) -> Findings:
    """The lift coefficient of level flight, which mass, wing area, density and airspeed make together."""
    mass, area = float(card.aircraft.mass), float(card.aircraft.wing_area)
    rho, V = _middle(view["density"]), _middle(view["airspeed"])
    CL = _middle(mass * GRAVITY / np.maximum(0.5 * view["density"] * view["airspeed"] ** 2 * area, 1e-9))
    if LEAST <= CL <= MOST or not np.isfinite(mass * area):
        return
    suspects = " or ".join(_suspects(card, CL, rho))
    yield finding(
        record, "airspeed" if THINNEST < rho < THICKEST else "density", "load",
        f"level flight would need a lift coefficient of {CL:.3g} (mass {mass:.4g} kg, wing area {area:.4g} m^2, "
        f"density {rho:.3g} kg/m^3, airspeed {V:.4g} m/s): "
        f"{f'looks as if {suspects}' if suspects else 'no one unit explains it'}; correct the unit on the card", None,
    )  # fmt: skip


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
            yield f"{name} were in {min(fit, key=fit.__getitem__)} ({'the card says' if channel else 'taken as'} {has})"


# --- Recorded rates of change against the change of what they belong to: q-dot and the derivative of q.

PAIRS = {"p_dot": "p", "q_dot": "q", "r_dot": "r", "alpha_dot": "alpha", "beta_dot": "beta"}
ALIKE = 0.8  # correlation from which the two are one motion


def derivatives(record: FlightRecord, card: Card) -> Findings:
    """A finding for each recorded derivative in another unit, or of the other sign, than the derivative itself."""
    width = max(3, round(0.3 / record.dt))  # both are smoothed twice over 0.3 s
    for name, of in PAIRS.items():
        if not all(record.has(n) and np.isfinite(record[n]).all() for n in (name, of)) or record.n < 5 * width:
            continue
        x, slope = (
            uniform_filter1d(uniform_filter1d(values, width), width)[width:-width]
            for values in (record[name], np.gradient(record[of], record.dt))
        )
        # Five times the derivative of noise, over a mean of two times `width` samples.
        least = 5.0 * noise_of(record[of]) / (record.dt * width**1.5)
        if not (np.std(x) > 0.0 and np.std(slope) > 0.0) or np.std(slope) < least:
            continue
        alike, meant = float(np.corrcoef(x, slope)[0, 1]), f"the derivative of {of}"
        flown = card.linear is not None and name in {*card.linear.states, *card.linear.outputs}
        if alike <= -ALIKE:
            yield finding(
                record, name, "sign",
                f"{name} counts the other way than {meant} does throughout (correlation {alike:.2g}); write sign = "
                f"{-declared(card, name).sign} at {name} on the card", grave=flown,
            )  # fmt: skip
        elif alike >= ALIKE:
            ratio = _Ratio(float(np.std(x) / np.std(slope)), {name: 1}, meant, SLOPE, flown)
            yield from ratio.findings(record, card, unexplained=False)


# --- Parts of a record on the ground: no wing carries the aircraft at such a speed.

SHORTEST = 1.0  # s
DROPOUTS = 7  # samples of a median, for a dropout is no landing


def on_ground(record: FlightRecord, card: Card) -> Findings:
    """A finding if the airspeed is too low to fly for a second or more."""
    if runs := grounded(record, card):
        parts = " and ".join(f"{instant(record.time[a])} to {instant(record.time[b])} s" for a, b in runs[:3])
        seconds = sum(b - a + 1 for a, b in runs) * record.dt
        slow = np.median(np.concatenate([record["airspeed"][a : b + 1] for a, b in runs]))
        yield finding(
            record, "airspeed", "ground",
            f"airspeed is too low to fly from {parts} ({seconds:.3g} s, median {slow:.3g} m/s): the aircraft is on the "
            "ground there; cut these parts out of the record", (runs[0][0], runs[-1][1]),
        )  # fmt: skip


def in_flight(record: FlightRecord, card: Card) -> FlightRecord:
    """The longest part of the record that is flown, under the record's name; the record itself if all of it is."""
    edges = [-1, *(i for a, b in grounded(record, card) for i in (a - 1, b)), record.n - 1]
    first, last = longest(zip(edges[::2], edges[1::2], strict=True))
    if len(edges) == 2 or last - first < 50:  # samples that the other checks need
        return record
    return replace(record.window(record.time[first + 1], record.time[last]), name=record.name)


def grounded(record: FlightRecord, card: Card) -> list[tuple[int, int]]:
    """First and last sample of each part on the ground; none if the whole record looks like that."""
    if not record.has("airspeed"):
        return []
    V, aircraft = np.maximum(median_filter(record["airspeed"], DROPOUTS, mode="nearest"), 1e-3), card.aircraft
    ratio = thinness(record.channels)
    density = DENSITY0 * (1.0 if ratio is None else ratio**2)
    weight, area = float(aircraft.mass) * GRAVITY, float(aircraft.wing_area)
    if np.isfinite(weight) and np.isfinite(area) and area > 0.0:
        load = np.clip(-record["az"] / GRAVITY, 0.3, 1.0) if record.has("az") else 1.0
        too_slow = load * weight / (0.5 * density * V**2 * area) > MOST
    else:
        too_slow = 0.25 * np.quantile(V, 0.75) > V
    if np.mean(too_slow) > 0.95:  # all of it: the unit or kind of airspeed, which others tell
        return []
    gap = max(1, round(SHORTEST / record.dt))
    too_slow = binary_closing(np.pad(too_slow, gap, mode="edge"), np.ones(gap))[gap:-gap]
    height = median_filter(
        record["altitude"] if record.has("altitude") else np.zeros(record.n), DROPOUTS, mode="nearest"
    )
    # The altitude of a runway and its noise stay within 15 m.
    return [
        (a, b) for a, b in runs_of(too_slow) if (b - a) * record.dt >= SHORTEST and np.ptp(height[a : b + 1]) < 15.0
    ]  # fmt: skip
