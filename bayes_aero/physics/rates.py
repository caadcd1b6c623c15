"""Nondimensional rates and speeds of aerodynamic derivatives.

Texts differ in the length (chord, half chord, another one) and in the speed (present, or of the trim point). A card
states them under [aircraft] as `rate_length`, `lateral_rate_length` and `reference_speed`. Defaults are q c/V, p b/2V
and r b/2V.
"""

from __future__ import annotations

from bayes_aero.arrays import Samples
from bayes_aero.flight.aircraft import Aircraft

USUAL_SPEED = 100.0  # m/s, where the card names no reference speed; only keeps the ratio near one


def reduced(rate: Samples, airspeed: Samples, aircraft: Aircraft) -> Samples:
    """A rate (rad/s, or a multiple of one) times length over speed (m, m/s)."""
    length = aircraft.chord if aircraft.rate_length is None else aircraft.rate_length
    return rate * length / (airspeed if aircraft.reference_speed is None else aircraft.reference_speed)


def reduced_lateral(rate: Samples, airspeed: Samples, aircraft: Aircraft) -> Samples:
    """A roll or yaw rate (rad/s) times length over speed (m, m/s); b/2V unless the card says otherwise."""
    length = aircraft.half_span if aircraft.lateral_rate_length is None else aircraft.lateral_rate_length
    return rate * length / (airspeed if aircraft.reference_speed is None else aircraft.reference_speed)


def speed_ratio(airspeed: Samples, aircraft: Aircraft) -> Samples:
    """V/V0, of V0 the card's reference speed, or 100 m/s where it names none."""
    return airspeed / (USUAL_SPEED if aircraft.reference_speed is None else aircraft.reference_speed)
