"""Air data that must agree with each other, with altitude and weight, and what tells flight from ground."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import binary_closing, median_filter, uniform_filter1d

from bayes_aero.flight import health
from bayes_aero.flight.card import ATMOSPHERE, RULES, Card
from bayes_aero.flight.channel import unit_choices
from bayes_aero.flight.health import Findings, HealthFinding
from bayes_aero.flight.health.kinematics import DENSITY0, View, thinness
from bayes_aero.flight.record import SHORTEST as FEWEST
from bayes_aero.flight.record import FlightRecord, parts_of
from bayes_aero.physics.aircraft import GAMMA, GAS, GRAVITY, standard_air
from bayes_aero.units import instant

# --- A quantity that is a factor away from what other channels make of it, and the unit that would explain the factor.

Limits = tuple[float, float]
"""Departure that still passes, and how near to one a unit must bring the factor; logarithms."""
GRAVE = ("density", "airspeed", "altitude", "mach")  # what results rest on
SENSORS: Limits = (0.10, 0.06)  # a departure that no weather and no sensor makes
DAY: Limits = (0.30, 0.15)  # of the density that no weather makes at a pressure altitude (35 %, some 75 K)
COLD: Limits = (0.15, 0.10)  # likewise, of the speed of sound at an altitude
THRUST: Limits = (4.0, 2.5)  # of the largest thrust over a tenth of the weight: 50 times, and 12 times
NOTHING = np.zeros(0)


def _off(k: float, limits: Limits) -> bool:
    return bool(np.isfinite(k) and k > 0.0 and abs(np.log(k)) >= limits[0])


def _middle(x: np.ndarray) -> float:
    return float(np.median(x)) if len(x) else float("nan")


@dataclass(frozen=True)
class _Ratio:
    """A channel that is `k` times what it must be (`meant`). `powers`: channels and the power with which each enters k,
    that first which is talked of. `unnamed`: whether it is grave where no unit explains it; None: it is none then."""

    k: float
    powers: Mapping[str, int]
    meant: str
    limits: Limits = SENSORS
    unnamed: bool | None = None

    def findings(self, record: FlightRecord, card: Card, grave: Collection[str] = GRAVE) -> list[HealthFinding]:
        """A finding if a unit explains the factor, or none does."""
        culprits, name = [], next(iter(self.powers))
        for n, power in self.powers.items():
            left = {u: abs(np.log(self.k * x**power)) for u, x in health.other_units(card, n, unit_choices(n))}
            culprits += [(n, unit) for unit in sorted(left, key=left.__getitem__) if left[unit] < self.limits[1]]
        if not _off(self.k, self.limits) or (not culprits and self.unnamed is None):
            return []
        fact = f"{name} is {self.k:.3g} times {self.meant} throughout"
        if not culprits:
            mend = f"correct {' or '.join(self.powers)} in the file, or take it off the card"
            why = " (no unit explains it)"
            return [health.finding(record, name, "factor", (fact, why, mend), grave=bool(self.unnamed))]
        channel, unit = culprits[0]
        why = " or ".join(f"{n}, {health.declared(card, n).unit} on the card, is in {u}" for n, u in culprits)
        mend = f'set unit = "{unit}" for {channel} on the card'
        return [health.finding(record, channel, "unit", (fact, f" ({why})", mend), grave=channel in grave)]


# --- Quantities that several channels make together: density, dynamic pressure, Mach number, altitude, weight.

LEAST, MOST = 0.03, 4.5  # lift coefficients between which level flight is flown
THINNEST, THICKEST = 0.05, 1.6  # kg/m3; 22 km, and sea level at -70 degC


def air_data(record: FlightRecord, card: Card) -> Findings:
    """A finding for each relation between air data, altitude and weight that does not hold."""
    view = _view(record, card)
    formed = card.derived.get("density") == "dynamic pressure" and _made_of(card, record) != {"density": 1}
    for ratio in _ratios(record, card, view):
        yield from ratio.findings(record, card, (*GRAVE, "dynamic_pressure") if formed else GRAVE)
    if {"density", "altitude"} <= view.keys() and len(view["density"]):
        yield from _density(record, card, view)
    mass, area = float(card.aircraft.mass), float(card.aircraft.wing_area)
    engines = [n for n in ("thrust", "thrust_left", "thrust_right") if n in record.channels and n in view]
    if engines and np.isfinite(mass):  # a tenth of the weight is that of cruise: near enough for a factor of a thousand
        k = max(float(np.max(np.abs(view[n]))) for n in engines) / (0.1 * mass * GRAVITY)
        yield from _Ratio(k, {engines[0]: 1}, "a tenth of the weight", THRUST).findings(record, card, ())
    if len(view.get("airspeed", ())) > 1 and "density" in view and np.isfinite(mass * area):
        rho, V = _middle(view["density"]), _middle(view["airspeed"])
        # The lift coefficient of level flight, which these make together.
        CL = _middle(mass * GRAVITY / np.maximum(0.5 * view["density"] * view["airspeed"] ** 2 * area, 1e-9))
        if not LEAST <= CL <= MOST:
            yield health.finding(
                record, "airspeed" if THINNEST < rho < THICKEST else "density", "load",
                (f"level flight would need a lift coefficient of {CL:.3g}",
                f" (mass {mass:.4g} kg, wing area {area:.4g} m^2, density {rho:.3g} kg/m^3, airspeed {V:.4g} m/s)",
                "correct the unit of one of them on the card"), None,
            )  # fmt: skip


def _ratios(record: FlightRecord, card: Card, view: View) -> Iterator[_Ratio]:
    """Gas law; altitude; airspeed over Mach number times the speed of sound, of the temperature, else of a standard
    atmosphere; dynamic pressure over half of density times airspeed squared."""
    have = view.keys() & record.channels.keys()
    warm, altitude = _middle(view.get("static_temperature", NOTHING)) > 0.0, "altitude" in view
    if warm and {"static_temperature", "static_pressure", "density"} <= have:
        k = _middle(view["static_pressure"] / np.maximum(view["density"] * GAS * view["static_temperature"], 1e-9))
        yield _Ratio(k, {"static_pressure": 1, "density": -1}, "density times R T", unnamed=False)
    if {"static_pressure", "altitude"} <= have:
        # that of the static pressure in a standard atmosphere; the ground pressure may differ by 5 %
        pressure = float(np.clip(_middle(view["static_pressure"]), 1000.0, 1.2e5))
        height = (1.0 - (pressure / 101325.0) ** 0.190263) / 2.25577e-5
        if pressure > 1000.0 and height >= 500.0 and _middle(view["altitude"]) >= 150.0:
            yield _Ratio(_middle(view["altitude"]) / height, {"altitude": 1}, "the altitude of the static pressure")
    flying = view.get("mach", NOTHING) > 0.05
    if len(view.get("airspeed", ())) < 2:
        return
    if "mach" in have and (warm or altitude) and flying.mean() > 0.5:
        sound = np.sqrt(GAMMA * GAS * view["static_temperature"]) if warm else standard_air(view["altitude"])[1]
        k = _middle((view["airspeed"] / (view["mach"] * np.maximum(sound, 1.0)))[flying])
        meant = "Mach number times the speed of sound" + ("" if warm else " at the altitude")
        yield _Ratio(k, {"airspeed": 1, "mach": -1}, meant, SENSORS if warm else COLD, True if warm else None)
    recorded = "density" in view and _made_of(card, record) == {"density": 1}
    if "dynamic_pressure" in have and (recorded or altitude):
        rho, limits = (view["density"], SENSORS) if recorded else (standard_air(view["altitude"])[0], DAY)
        k = _middle(view["dynamic_pressure"] / (0.5 * rho * view["airspeed"] ** 2))
        powers = {"dynamic_pressure": 1, **({"density": -1} if recorded else {}), "airspeed": -2}
        # Density or airspeed may be what is wrong.
        yield _Ratio(k, powers, "half of density times airspeed squared", limits, not recorded or _off(k, DAY))


def _view(record: FlightRecord, card: Card) -> dict[str, np.ndarray]:
    """Finite channels and constants where the aircraft moves, and density by the card's rule if it was not recorded."""
    channels = health.channels_of(record, card)
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


def _density(record: FlightRecord, card: Card, view: View) -> Findings:
    """Density against that of a standard atmosphere: a unit of it, or of the altitude, or none explains it."""
    if not (powers := _made_of(card, record)):
        return
    k = _middle(view["density"] / standard_air(view["altitude"])[0])
    meant = "that of a standard atmosphere at the altitude"
    if "density" not in powers:
        meant = f"what a standard atmosphere at the altitude would need ({card.derived['density']} on the card)"
    named = _Ratio(k, powers, meant, DAY).findings(record, card, powers)
    yield from named
    if named or not _off(k, DAY):
        return
    for unit, factor in health.other_units(card, "altitude", unit_choices("altitude")):
        near = abs(np.log(_middle(view["density"] / standard_air(factor * view["altitude"])[0]))) < DAY[1]
        if near and record.has("altitude") and "density" not in card.constants:
            yield health.finding(
                record, "altitude", "unit",
                (f"altitude looks like {unit}", f": the density is {k:.3g} times that of a standard atmosphere there",
                f'set unit = "{unit}" for altitude on the card'), None,
                grave=not record.has("density"),
            )  # fmt: skip
            return
    name, height = next(iter(powers)), health.shown(card, "altitude", _middle(view["altitude"]))
    stated = not record.has("density") and "density" in card.constants
    yield health.finding(
        record, name, "density",
        (f"the density, {_middle(view['density']):.3g} kg/m^3, is {k:.3g} times that of a standard atmosphere",
        f" at the altitude, {height}; no unit explains it", f"correct {name} or altitude"), None,
        grave=stated or abs(np.log(k)) > 1.0,
    )  # fmt: skip


# --- Parts of a record on the ground: no wing carries the aircraft at such a speed.

SHORTEST = 1.0  # s
DROPOUTS = 7  # samples of a median, for a dropout is no landing


def on_ground(record: FlightRecord, card: Card) -> Findings:
    """A finding if the airspeed is too low to fly for a second or more."""
    if runs := grounded(record, card):
        parts = " and ".join(f"{instant(record.time[a])} to {instant(record.time[b])} s" for a, b in runs[:3])
        seconds = sum(b - a + 1 for a, b in runs) * record.dt
        slow = np.median(np.concatenate([record["airspeed"][a : b + 1] for a, b in runs]))
        yield health.finding(
            record, "airspeed", "ground",
            (f"airspeed is too low to fly from {parts}",
            f" ({seconds:.3g} s, median {slow:.3g} m/s): the aircraft is on the ground there",
            "cut these parts out of the record"), (runs[0][0], runs[-1][1]),
        )  # fmt: skip


def in_flight(record: FlightRecord, card: Card) -> FlightRecord:
    """The longest part of the record that is flown, under the record's name; the record itself if all of it is."""
    edges = [-1, *(i for a, b in grounded(record, card) for i in (a - 1, b)), record.n - 1]
    first, last = health.longest(zip(edges[::2], edges[1::2], strict=True))
    if len(edges) == 2 or last - first < FEWEST:
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
    height = median_filter(record.channels.get("altitude", np.zeros(record.n)), DROPOUTS, mode="nearest")
    # The altitude of a runway and its noise stay within 15 m.
    runs = [(a, b) for a, b in health.runs_of(too_slow) if np.ptp(height[a : b + 1]) < 15.0]
    return [(a, b) for a, b in runs if (b - a) * record.dt >= SHORTEST]


# --- The parts of a file that are worth a record of their own: those in flight, and the manoeuvres in them.

WINDOW = 2.0  # s over which a control or a rate must move
MOVES = {"p": 1.0, "q": 0.5, "r": 0.5, "elevator": 0.3, "aileron_left": 0.5, "aileron_right": 0.5, "aileron": 0.5,
         "rudder": 0.5}  # fmt: skip
"""Standard deviation over `WINDOW`, deg/s or deg, below which nothing was flown whatever the record's noise."""


@dataclass(frozen=True)
class Proposal:
    """A part of a file as it is written behind "@", what it is, and its first and last time in s."""

    part: str
    what: str
    begin: float
    end: float


def proposals(record: FlightRecord, card: Card) -> tuple[Proposal, ...]:
    """Parts to analyse in place of a whole file; none where the file is one flight that is one manoeuvre. The record is
    the whole file, in SI, unchecked: time may have gaps or start over. The card tells flight from ground."""
    parts, forward = parts_of(record.time), bool((np.diff(record.time) > 0.0).all())
    flown: list[tuple[int, int]] = []
    for a, b in (part for part in parts if part[1] - part[0] >= FEWEST):
        part = record.part(slice(a, b))
        sound = not part.has("airspeed") or np.isfinite(part["airspeed"]).all()
        edges = [0, *(i for first, last in (grounded(part, card) if sound else ()) for i in (first, last + 1)), part.n]
        pairs = zip(edges[::2], edges[1::2], strict=True)
        flown += [(a + first, a + after) for first, after in pairs if after - first >= FEWEST]
    spans = [] if flown == [(0, record.n)] else [(a, b, "in flight") for a, b in flown]
    for a, b in flown if forward else ():
        moved = [(a + first, a + after) for first, after in _manoeuvres(record.part(slice(a, b)))]
        if len(moved) > 1 or (moved and moved[0][1] - moved[0][0] < 0.8 * (b - a)):
            spans += [(first, after, "manoeuvre") for first, after in moved]
    proposed = []
    for a, b, what in spans:
        begin, end = float(record.time[a]), float(record.time[b - 1])
        times = f"{instant(begin)}:{instant(end)}"
        number = None if forward or (a, b) not in parts else parts.index((a, b)) + 1
        proposed.append(Proposal(f"#{number}" if number else times, what, begin, end))
    return tuple(proposed)


def _manoeuvres(part: FlightRecord) -> list[tuple[int, int]]:
    """Where controls or rates move, with some seconds before and after: first sample, and the one behind."""
    size, moving = max(round(WINDOW / part.dt), 3), np.zeros(part.n, bool)
    for name, least in MOVES.items():
        if part.has(name) and np.isfinite(part[name]).all():
            mean = uniform_filter1d(part[name], size)
            spread = np.sqrt(np.maximum(uniform_filter1d((part[name] - mean) ** 2, size), 0.0))
            moving |= spread > max(np.deg2rad(least), 4.0 * float(np.quantile(spread, 0.1)))  # the quiet tenth
    # Rest of 4 s divides two manoeuvres of 3 s or more; 2 s before and after are kept.
    pause, lead = max(round(4.0 / part.dt), 1), max(round(2.0 / part.dt), 1)
    moving, kept = binary_closing(np.pad(moving, pause), np.ones(pause))[pause:-pause], np.zeros(part.n, bool)
    for a, b in health.runs_of(moving):
        kept[max(a - lead, 0) : b + lead + 1] |= (b - a) * part.dt >= 3.0
    return [(a, b + 1) for a, b in health.runs_of(kept) if b + 1 - a >= FEWEST]
