"""The catalogue of effects: every module of this package that defines `EFFECT`, found by itself."""

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
