"""Ranges of the sliders: about the estimate by its standard error, within the parameter's bounds."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from bayes_aero.effect import Effect
from bayes_aero.explore.choice import Choice, flown_model, shown_effects, values_of
from bayes_aero.model.model import Model
from bayes_aero.parameter import Parameter
from bayes_aero.report.text.phrases import for_people, plain_unit

ERRORS = 5.0  # standard errors to either side
SHARE = 0.3  # of the value, at least: a parameter known to 0.1 % still moves something to see


@dataclass(frozen=True)
class Slider:
    """A parameter in the unit in which people read it: where it begins, its standard error (0: unknown), its range.

    `factor` converts SI to this unit.
    """

    name: str
    unit: str
    factor: float
    description: str
    value: float
    error: float
    low: float
    high: float


@dataclass(frozen=True)
class Group:
    """An effect with its sliders; `added`: it is not part of the result's model; `switch`: it can be switched off."""

    name: str
    claim: str
    added: bool
    sliders: tuple[Slider, ...]
    switch: bool = True


def groups_of(
    model: Model, values: Mapping[str, float], errors: Mapping[str, float], added: Sequence[str] = ()
) -> tuple[Group, ...]:
    """Every effect that can be switched off, with its sliders.

    Args:
        model: of the result.
        values: its parameters, SI.
        errors: standard errors, SI, where they are known.
        added: names of effects to add.
    """
    choice = Choice(added=tuple(added))
    begin = values_of(flown_model(model, choice), values, choice)
    known = {p.name: p for p in flown_model(model, choice).parameters}
    return tuple(
        Group(
            e.name,
            e.claim,
            e.name in added,
            tuple(
                slider(known[p.name], begin[p.name], errors.get(p.name, 0.0), _largest(known[p.name], e))
                for p in e.parameters
            ),
        )
        for e in shown_effects(model, added)
    )


def slider(p: Parameter, value: float, error: float, largest: float) -> Slider:
    """About `value` by the standard error `error` (0: unknown, then by the departure `largest`), SI."""
    reach = max(ERRORS * error, SHARE * abs(value), 0.0 if error else largest)
    low, high = max(value - reach, p.bounds[0]), min(value + reach, p.bounds[1])
    unit, factor = for_people(p.unit)
    shown = (factor * x for x in (value, error, low, high))
    return Slider(p.name, plain_unit(unit), factor, p.description, *shown)


def _largest(p: Parameter, effect: Effect) -> float:
    """The largest plausible departure from neutral, for a parameter without a standard error."""
    size = effect.sizes.get(p.name, (0.0, 0.0))[1]
    if math.isfinite(p.neutral) and size > 0.0:
        return size
    return 1.0 if p.start == 0.0 else abs(p.start)
