"""Air data that must agree with each other: p = rho R T, Mach number, calibrated and true airspeed, altitude."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bayes_aero.flight.card import Card
from bayes_aero.flight.channel import STANDARD_CHANNELS
from bayes_aero.flight.health.finding import HealthFinding, declared, found
from bayes_aero.flight.health.readings import DENSITY0, THIN, thinness
from bayes_aero.flight.record import FlightRecord
from bayes_aero.units import same_unit, to_si

GAS, GAMMA = 287.05287, 1.4  # J/(kg K)
NEAR = 0.06  # of a factor, to that of two units, as a logarithm
OFF = 0.10  # departure that no weather and no sensor makes, as a logarithm
UNITS = {
    "static_pressure": ("Pa", "hPa", "kPa", "psi"),
    "density": ("kg/m^3", "slug/ft^3", "g/m^3"),
    "airspeed": ("m/s", "kt", "km/h", "ft/s", "mph"),
    "calibrated_airspeed": ("m/s", "kt", "km/h", "ft/s", "mph"),
    "altitude": ("m", "ft"),
    "mach": ("1", "%"),
}


def air_data(record: FlightRecord, card: Card) -> list[HealthFinding]:
    """A finding for each relation between air data that does not hold."""
    have = frozenset(n for n in record.channels if np.all(np.isfinite(record[n])))
    median = {n: float(np.median(record[n])) for n in have}
    said = []
    if {"static_pressure", "density", "static_temperature"} <= have and median["static_temperature"] > 0.0:
        k = median["static_pressure"] / (median["density"] * GAS * median["static_temperature"])
        said += _off_by_factor(record, card, k, "static_pressure", ("density",), "density times R T")
    if {"mach", "airspeed", "static_temperature"} <= have and median["static_temperature"] > 0.0:
        moving = record["mach"] > 0.05
        if moving.mean() > 0.5:
            sound = np.sqrt(GAMMA * GAS * median["static_temperature"])
            k = float(np.median(record["airspeed"][moving] / record["mach"][moving])) / sound
            meant = "Mach number times the speed of sound"
            said += _as_calibrated(record, k, meant) or _off_by_factor(record, card, k, "airspeed", ("mach",), meant)
    ratio = thinness(record.channels, have)
    if {"calibrated_airspeed", "airspeed"} <= have and ratio is not None and median["airspeed"] > 0.0:
        moving = record["airspeed"] > 0.5 * median["airspeed"]
        k = float(np.median(record["calibrated_airspeed"][moving] / (record["airspeed"] * ratio)[moving]))
        said += _calibrated(record, card, k, float(np.median(ratio)))
    if {"static_pressure", "altitude"} <= have and 1000.0 < median["static_pressure"] < 1.2e5:
        said += _pressure_altitude(record, card, median)
    return said


def _off_by_factor(
    record: FlightRecord, card: Card, k: float, name: str, others: Sequence[str], meant: str, grave: bool = True
) -> list[HealthFinding]:
    """A channel that is k times what it must be, with the units that would explain it."""
    if not np.isfinite(k) or k <= 0.0 or abs(np.log(k)) < OFF:
        return []
    culprits = [(n, u) for n, power in ((name, 1), *((o, -1) for o in others)) for u in _explains(card, n, k, power)]
    if culprits:
        channel, unit = culprits[0]
        why = " or ".join(f"{n}, {declared(card, n).unit} on the card, is in {u}" for n, u in culprits)
        mend = f'set unit = "{unit}" for {channel} on the card'
    else:
        channel, why = name, "no unit explains it"
        mend = f"correct {name}{''.join(f' or {o}' for o in others)} in the file, or take it off the card"
    sentence = f"{name} is {k:.3g} times {meant} throughout ({why}); {mend}"
    grave = grave and channel in ("density", "airspeed", "altitude", "mach")
    return [found(record, channel, "unit", sentence, at=(0, record.n - 1), grave=grave)]


def _explains(card: Card, name: str, k: float, power: int) -> list[str]:
    """Units of a channel, other than the card's, that would make the factor one."""
    has, standard = declared(card, name).unit, STANDARD_CHANNELS[name].unit
    fit = []
    for unit in UNITS[name]:
        if same_unit(unit, has) is not False:
            continue
        factor = float(to_si(1.0, unit, name, standard) / to_si(1.0, has, name, standard))
        if abs(np.log(k * factor**power)) < NEAR:
            fit.append(unit)
    return fit


def _as_calibrated(record: FlightRecord, k: float, meant: str) -> list[HealthFinding]:
    """True airspeed that is what calibrated airspeed would be."""
    ratio = thinness(record.channels, frozenset(record.channels))
    if (
        ratio is None
        or not (middle := float(np.median(ratio))) < THIN
        or abs(np.log(k / middle)) > 0.35 * -np.log(middle)
    ):
        return []
    sentence = (
        f"airspeed is {k:.3g} times {meant}, as calibrated airspeed is at this density ({middle:.3g}): true airspeed "
        "is needed; divide it by the square root of density over 1.225 kg/m^3 in the file, or map the true airspeed"
    )
    return [found(record, "airspeed", "airspeed_kind", sentence, at=(0, record.n - 1))]


def _calibrated(record: FlightRecord, card: Card, k: float, ratio: float) -> list[HealthFinding]:
    """Calibrated airspeed against true airspeed times the root of the density ratio."""
    if ratio < THIN and abs(np.log(k * ratio)) < 0.01:
        sentence = (
            "airspeed and calibrated_airspeed are the same numbers, and at this density true airspeed is "
            f"{1.0 / ratio:.3g} times calibrated airspeed; map each to its own column"
        )
        return [found(record, "airspeed", "airspeed_kind", sentence, at=(0, record.n - 1))]
    meant = f"true airspeed times the root of density over {DENSITY0} kg/m^3"
    return _off_by_factor(record, card, k, "calibrated_airspeed", (), meant, grave=False)


def _pressure_altitude(record: FlightRecord, card: Card, median: dict[str, float]) -> list[HealthFinding]:
    """Altitude against that of the static pressure in a standard atmosphere; the ground pressure may differ by 5 %."""
    meant = (1.0 - (median["static_pressure"] / 101325.0) ** 0.190263) / 2.25577e-5
    if meant < 500.0 or median["altitude"] < 150.0:
        return []
    k = median["altitude"] / meant
    fit = _explains(card, "altitude", k, 1)
    return _off_by_factor(record, card, k, "altitude", (), "the altitude of the static pressure") if fit else []
