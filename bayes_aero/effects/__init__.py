"""The catalogue of effects: every module of this package that defines `EFFECT`, found by itself.

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
    found: dict[str, Effect] = {}
    for module in pkgutil.iter_modules(__path__):
        effect = importlib.import_module(f"{__name__}.{module.name}").EFFECT
        if effect.name != module.name:
            raise InputError(f"the effect in {module.name}.py calls itself {effect.name}; the two must agree")
        found[effect.name] = effect
    return found


CATALOGUE: dict[str, Effect] = _discover()
"""All built-in effects by name, in alphabetical order."""
