"""Quantities that several channels make together: density at an altitude, dynamic pressure, Mach number, weight."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from bayes_aero.flight.aircraft import AIRCRAFT_UNITS
from bayes_aero.flight.card.card import Card
from bayes_aero.flight.card.tables import ATMOSPHERE, RULES
from bayes_aero.flight.channel import STANDARD_CHANNELS
from bayes_aero.flight.health.air import UNITS, as_calibrated, off_by_factor
from bayes_aero.flight.health.finding import GAS, Findings, declared, found, other_units, shown, standard_air
from bayes_aero.flight.health.signals import channels_of
from bayes_aero.flight.record import GRAVITY, FlightRecord
from bayes_aero.units import same_unit, to_si

DAY = 0.30  # as a logarithm: the density that no weather makes at a pressure altitude (35 %, some 75 K)
NEAR = 0.15  # to the density of the day that a unit must come, as a logarithm
COLD = 0.15  # likewise, of the speed of sound at an altitude
MOVING = 0.5  # of the median airspeed, above which air data are read
LEAST, MOST = 0.03, 4.5  # lift coefficients between which level flight is flown
USUAL = (0.08, 2.5)  # those that a unit must lead to, to be named
MIDDLING = 0.5  # among units that lead to usual ones, the nearest to this is named
THINNEST, THICKEST = 0.05, 1.6  # kg/m3; 22 km, and sea level at -70 degC
CONSTANTS = {"mass": ("lb", "slug", "kg"), "wing_area": ("ft^2", "m^2")}

View = Mapping[str, np.ndarray]


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
    known = channels_of(record, card)
    V = known.get("airspeed")
    moving = np.ones(record.n, bool) if V is None else max(MOVING * float(np.nanmedian(V)), 1.0) < V
    view = {name: x[moving] for name, x in known.items() if np.isfinite(x).all()}
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
    if said := off_by_factor(record, card, k, powers, meant, off=DAY, near=NEAR, grave=True, explained=True):
        yield from said
        return
    off = abs(np.log(max(k, 1e-9)))
    stated = not record.has("density") and "density" in card.constants
    for unit, factor in other_units(card, "altitude", UNITS["altitude"]):
        near = abs(np.log(_middle(view["density"] / standard_air(factor * view["altitude"])[0]))) < NEAR
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
        rho, off, near = standard_air(view["altitude"])[0], DAY, NEAR
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
