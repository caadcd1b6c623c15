"""Air data that must agree with each other: p = rho R T, Mach number, calibrated and true airspeed, altitude."""

from __future__ import annotations

import numpy as np

from bayes_aero.flight.card.card import Card
from bayes_aero.flight.health.across.explained import off_by_factor
from bayes_aero.flight.health.finding import HealthFinding, found
from bayes_aero.flight.health.readings import AGREES, DENSITY0, THIN, thinness
from bayes_aero.flight.health.standard import GAMMA, GAS
from bayes_aero.flight.record import FlightRecord


def air_data(record: FlightRecord, card: Card) -> list[HealthFinding]:
    """A finding for each relation between air data that does not hold."""
    have = frozenset(n for n in record.channels if np.all(np.isfinite(record[n])))
    median = {n: float(np.median(record[n])) for n in have}
    said = []
    if {"static_pressure", "density", "static_temperature"} <= have and median["static_temperature"] > 0.0:
        k = median["static_pressure"] / (median["density"] * GAS * median["static_temperature"])
        said += off_by_factor(record, card, k, {"static_pressure": 1, "density": -1}, "density times R T")
    if {"mach", "airspeed", "static_temperature"} <= have and median["static_temperature"] > 0.0:
        moving = record["mach"] > 0.05
        if moving.mean() > 0.5:
            sound = np.sqrt(GAMMA * GAS * median["static_temperature"])
            k = float(np.median(record["airspeed"][moving] / record["mach"][moving])) / sound
            meant = "Mach number times the speed of sound"
            said += as_calibrated(record, k, meant) or off_by_factor(
                record, card, k, {"airspeed": 1, "mach": -1}, meant
            )
    ratio = thinness(record.channels, have)
    if {"calibrated_airspeed", "airspeed"} <= have and ratio is not None and median["airspeed"] > 0.0:
        moving = record["airspeed"] > 0.5 * median["airspeed"]
        k = float(np.median(record["calibrated_airspeed"][moving] / (record["airspeed"] * ratio)[moving]))
        said += _calibrated(record, card, k, float(np.median(ratio)))
    if {"static_pressure", "altitude"} <= have and 1000.0 < median["static_pressure"] < 1.2e5:
        said += _pressure_altitude(record, card, median)
    return said


def as_calibrated(record: FlightRecord, k: float, meant: str) -> list[HealthFinding]:
    """True airspeed that is what calibrated airspeed would be."""
    ratio = thinness(record.channels, frozenset(record.channels))
    if (
        ratio is None
        or not (middle := float(np.median(ratio))) < THIN
        or abs(np.log(k / middle)) > AGREES
        or abs(np.log(k)) < AGREES
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
    return off_by_factor(record, card, k, {"calibrated_airspeed": 1}, meant, grave=False)


def _pressure_altitude(record: FlightRecord, card: Card, median: dict[str, float]) -> list[HealthFinding]:
    """Altitude against that of the static pressure in a standard atmosphere; the ground pressure may differ by 5 %."""
    meant = (1.0 - (median["static_pressure"] / 101325.0) ** 0.190263) / 2.25577e-5
    if meant < 500.0 or median["altitude"] < 150.0:
        return []
    k = median["altitude"] / meant
    return off_by_factor(record, card, k, {"altitude": 1}, "the altitude of the static pressure", explained=True)
