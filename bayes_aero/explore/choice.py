"""What is chosen on the page: values, effects that are off, effects that are added, and the model of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

from bayes_aero.effect import Effect, Stage
from bayes_aero.effects import CATALOGUE
from bayes_aero.model.model import Model


@dataclass(frozen=True)
class Choice:
    """Values (SI) of parameters that differ from the result's, names of effects that are `off` and that are `added`."""

    values: Mapping[str, float] = field(default_factory=dict)
    off: frozenset[str] = frozenset()
    added: tuple[str, ...] = ()


def shown_effects(model: Model, added: Sequence[str] = ()) -> tuple[Effect, ...]:
    """Effects of a model that can be switched off, and the added ones: those with parameters that a simulation without
    noise follows, not fixed at neutral."""
    wider = with_added(model, added)
    return tuple(e for e in wider.acting if e.parameters and e.disturbance is None)


def addable(model: Model, channels: Sequence[str]) -> tuple[Effect, ...]:
    """Effects of the catalogue that may be added: candidates on the model's axes whose channels were recorded."""
    own = {e.name for e in model.acting}
    names = {p.name for p in model.parameters}
    have = {*channels, "alpha_dot", "X", "dt", "start", "elapsed", "first", "last"}
    return tuple(
        e
        for e in CATALOGUE.values()
        if e.candidate
        and e.name not in own
        and e.disturbance is None
        and e.acts_on(model.axes)
        and have.issuperset(e.channels)
        and names.issuperset(e.uses)
        and (e.name in {x.name for x in model.effects} or names.isdisjoint(p.name for p in e.parameters))
    )


def flown_model(model: Model, choice: Choice) -> Model:
    """The model that is flown: every parameter of the effects that act is free, and nothing else is there.

    A lag that is off is left out: its separation point would be a state with the least lag. So are random processes,
    which a simulation without noise does not follow, and effects that the card fixes at neutral.
    """
    wider = with_added(model, choice.added)
    neutral = {p.name: p.neutral for e in wider.effects for p in e.parameters}
    gone = {e.name for e in wider.acting if e.stage is Stage.LAG and e.name in choice.off}
    kept = tuple(e for e in wider.acting if e.name not in gone and e.disturbance is None)
    own = {p.name for e in kept for p in e.parameters}
    held = {name: dict(wider.fixed).get(name, x) for name, x in neutral.items() if name not in own}
    parameters = tuple(p for p in wider.parameters if p.name in own)
    return replace(wider, effects=kept, parameters=parameters, fixed=tuple(held.items()))


def values_of(model: Model, values: Mapping[str, float], choice: Choice) -> dict[str, float]:
    """Values of the model's parameters, SI: chosen, else the result's, else where a fit begins; neutral where off.

    Args:
        model: of `flown_model`.
        values: of the result.
        choice: what was chosen.
    """
    found = {p.name: choice.values.get(p.name, values.get(p.name, p.start)) for p in model.parameters}
    for e in model.effects:
        for p in e.parameters:
            if e.name in choice.added and p.name not in choice.values:
                found[p.name] = p.start
            if e.name in choice.off:
                found[p.name] = p.neutral
    return found


def with_added(model: Model, added: Sequence[str]) -> Model:
    """The model with the `added` effects, their parameters free: a card may hold an effect at neutral."""
    there = {e.name for e in model.effects}
    freed = {p.name for e in model.effects if e.name in added for p in e.parameters}
    fixed = tuple((name, x) for name, x in model.fixed if name not in freed)
    return replace(model, fixed=fixed).extended(*(name for name in added if name not in there))
