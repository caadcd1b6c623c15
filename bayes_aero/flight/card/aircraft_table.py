"""[aircraft] of a card: constants with their units; what follows from others need not be stated."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from bayes_aero.errors import InputError
from bayes_aero.flight.aircraft import AIRCRAFT_KEYS, AIRCRAFT_UNITS, OPTIONAL, Aircraft
from bayes_aero.flight.card.table_checks import known_keys
from bayes_aero.units import quantity_to_si

ROUNDED = 0.02  # moments of inertia are given to two or three digits
POSITIONS = ("reference_point", "accelerometer", "engine")
POSITIVE = (
    "mass", "Ix", "Iy", "Iz", "wing_area", "chord", "half_span", "span", "aspect_ratio", "tail_arm",
    "reference_speed", "rate_length", "lateral_length", "lateral_rate_length",
)  # fmt: skip


def parse_aircraft(table: Mapping[str, Any], where: str) -> Aircraft:
    """Constants in SI; the aspect ratio is span squared over wing area where it is not stated.

    Args:
        table: the section as the card has it.
        where: which card, for messages.
    """
    known_keys(table, tuple(AIRCRAFT_KEYS), where, "key of [aircraft]")
    if "span" in table and "half_span" in table:
        raise InputError(
            f"card {where}: [aircraft] has span ({table['span']}) and half_span ({table['half_span']}); "
            "keep one of them"
        )
    values: dict[str, Any] = {}
    for key, unit in AIRCRAFT_KEYS.items():
        if key not in table:
            if key in OPTIONAL or key == "span" or (key == "half_span" and "span" in table):
                continue
            other = f', or span = "... {unit}"' if key == "half_span" else ""
            raise InputError(
                f'card {where}: [aircraft] has no {key}; add it with its unit, e.g. {key} = "... {unit}"{other}'
            )
        given = table[key]
        if key in POSITIONS:
            if not (isinstance(given, list) and len(given) == 3):
                raise InputError(f"card {where}: [aircraft] {key} must be three lengths, [x, y, z]")
            values[key] = tuple(quantity_to_si(part, unit, f"card {where}: [aircraft] {key}") for part in given)
        else:
            values[key] = quantity_to_si(given, unit, f"card {where}: [aircraft] {key}")
    for key in POSITIVE:
        if key in values and not values[key] > 0.0:
            raise InputError(
                f"card {where}: [aircraft] {key} is {values[key]} {AIRCRAFT_KEYS[key]}; it must be positive"
            )
    if "span" in values:
        values["half_span"] = 0.5 * values.pop("span")
    values.setdefault("aspect_ratio", (2.0 * values["half_span"]) ** 2 / values["wing_area"])
    return Aircraft(**{key: values[key] for key in AIRCRAFT_UNITS if key in values})


def refuse_no_body(aircraft: Aircraft, where: str) -> None:
    """Refuse moments of inertia that no mass distribution has: each principal one is at most the sum of the others.

    Args:
        aircraft: constants in SI.
        where: which card, for messages.

    Raises:
        InputError: no body has these moments.
    Source: Goldstein, *Classical Mechanics*, 2nd ed. 1980, ch. 5.
    """
    given = {name: float(getattr(aircraft, name)) for name in ("Ix", "Iy", "Iz", "Ixy", "Ixz", "Iyz")}
    Ix, Iy, Iz, Ixy, Ixz, Iyz = given.values()
    principal = np.linalg.eigvalsh([[Ix, -Ixy, -Ixz], [-Ixy, Iy, -Iyz], [-Ixz, -Iyz, Iz]])
    if principal[0] > 0.0 and principal[2] <= (1.0 + ROUNDED) * (principal[0] + principal[1]):
        return
    told = ", ".join(f"{name} {value:g}" for name, value in given.items() if value)
    raise InputError(
        f"card {where}: [aircraft] no body has these moments of inertia ({told} kg m^2): the principal ones are "
        f"{', '.join(f'{x:.4g}' for x in principal)}, all must be positive and the largest at most the sum of the "
        "other two; correct them"
    )
