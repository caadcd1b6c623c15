"""The section [envelope] of a card."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from bayes_aero.errors import InputError
from bayes_aero.flight.card.table_checks import known_keys
from bayes_aero.flight.envelope import DEFAULT_RANGES, UNITS, Envelope
from bayes_aero.units import quantity_to_si


def parse_envelope(table: Mapping[str, Any], where: str) -> Envelope:
    """[envelope] of a card: [least, greatest] of each quantity, with units; of `altitude_loss` the greatest alone."""
    known_keys(table, (*UNITS, "programmed_inputs"), where, "quantity of [envelope]")
    ranges, programmed = dict(DEFAULT_RANGES), table.get("programmed_inputs", False)
    if not isinstance(programmed, bool):
        raise InputError(f"card {where}: [envelope] programmed_inputs is {programmed!r}; write true or false")
    stated = {key: given for key, given in table.items() if key in UNITS}
    for key, given in stated.items():
        label = f"card {where}: [envelope] {key}"
        if key == "altitude_loss":
            ranges[key] = (-np.inf, quantity_to_si(given, UNITS[key], label))
            continue
        if not (isinstance(given, list) and len(given) == 2):
            raise InputError(f'{label} is {given!r}; write the least and the greatest value, e.g. ["-5 deg", "15 deg"]')
        lower, upper = (quantity_to_si(one, UNITS[key], label) for one in given)
        if not lower < upper:
            raise InputError(f"{label} is {given!r}; the first value must be less than the second")
        ranges[key] = (lower, upper)
    return Envelope(ranges, tuple(stated), programmed)
