"""The catalogue of effects: every module below this package defines one as `EFFECT`; none is listed by hand.

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
    for module in pkgutil.walk_packages(__path__, f"{__name__}."):
        if module.ispkg:
            continue
        effect, name = importlib.import_module(module.name).EFFECT, module.name.rpartition(".")[2]
        if effect.name != name:
            raise InputError(f"the effect in {name}.py calls itself {effect.name}; the two must agree")
        found[name] = effect
    return dict(sorted(found.items()))


CATALOGUE: dict[str, Effect] = _discover()
"""All built-in effects by name, in alphabetical order."""
