"""The catalogue of effects: every `Effect` at the top level of a module of this package; none is listed elsewhere.

`longitudinal`, `lateral` and `separation` are the aerodynamics, `sensors` the errors of the record,
`aircraft_air` those of masses, thrust and air. An effect is one entry (see `effect` in `bayes_aero.effect`).

The `sizes` are engineering judgement for a transport of some 20 t at 60 to 100 m/s, never tuned to a result. The least
departure worth modelling changes CL by about 0.01, CD by 0.001 or Cm by 0.002 over the usual swing of its signal in a
stall manoeuvre (alpha 0.08, elevator 0.06, beta 0.07 rad, qhat 0.002, Mach 0.1), or is what a good installation holds.
"""

from __future__ import annotations

import importlib
import pkgutil

from bayes_aero.effect import Effect
from bayes_aero.errors import InputError


def _discover() -> dict[str, Effect]:
    catalogue: dict[str, Effect] = {}
    for module in pkgutil.iter_modules(__path__, f"{__name__}."):
        for value in vars(importlib.import_module(module.name)).values():
            if isinstance(value, Effect) and catalogue.setdefault(value.name, value) is not value:
                raise InputError(f"{module.name} has a second effect {value.name}; give it another name")
    return dict(sorted(catalogue.items()))


CATALOGUE: dict[str, Effect] = _discover()  # all built-in effects by name, in alphabetical order
