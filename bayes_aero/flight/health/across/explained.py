"""A quantity that is a factor away from what other channels make of it, and the unit that would explain the factor."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from bayes_aero.flight.card.card import Card
from bayes_aero.flight.channel import STANDARD_CHANNELS
from bayes_aero.flight.health.finding import HealthFinding, declared, found
from bayes_aero.flight.record import FlightRecord
from bayes_aero.units import same_unit, to_si

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

    Args:
        record: the record.
        card: what its channels are said to be.
        k: the factor.
        powers: channels and the power with which each enters k; the first is the one that is talked of.
        meant: what it must be, in words.
        off: departure, as a logarithm, that still passes.
        near: how near to one, as a logarithm, a unit must bring the factor.
        grave: whether the finding is; None: if it is about a channel of `GRAVE`.
        explained: whether nothing is said where no unit explains the factor.
    """
    if not np.isfinite(k) or k <= 0.0 or abs(np.log(k)) < off:
        return []
    name = next(iter(powers))
    culprits = [(n, unit) for n, power in powers.items() for unit in _explains(card, n, k, power, near)]
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


def _explains(card: Card, name: str, k: float, power: int, near: float) -> list[str]:
    """Units of a channel, other than the card's, that would make the factor one; the nearest first."""
    has, standard = declared(card, name).unit, STANDARD_CHANNELS[name].unit
    fit = {}
    for unit in UNITS.get(name, ()):
        if same_unit(unit, has) is not False:
            continue
        factor = float(to_si(1.0, unit, name, standard) / to_si(1.0, has, name, standard))
        if (left := abs(np.log(k * factor**power))) < near:
            fit[unit] = left
    return sorted(fit, key=lambda unit: fit[unit])
