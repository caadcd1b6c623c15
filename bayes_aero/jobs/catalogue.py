"""The effects that a user can name: built-in ones and those of a card, described as plain data."""

from __future__ import annotations

from collections.abc import Mapping
from difflib import get_close_matches
from typing import Any

from bayes_aero.effect import Effect
from bayes_aero.effects import CATALOGUE
from bayes_aero.errors import InputError
from bayes_aero.flight.card.card import Card
from bayes_aero.model.model import own_effects
from bayes_aero.parameter import Parameter, Prior

WORDS = 3  # effects that an unknown name is taken to mean


def known_effects(card: Card | None = None) -> dict[str, Effect]:
    """The catalogue, and the effects of the card's own files, in alphabetical order."""
    own = own_effects(card.effect_files) if card is not None else {}
    return dict(sorted((CATALOGUE | own).items()))


def effect_named(name: str, among: Mapping[str, Effect]) -> Effect:
    """One effect; an unknown name is told with those that look like it."""
    if name in among:
        return among[name]
    close = get_close_matches(name, among, n=WORDS, cutoff=0.5)
    close = close or [other for other in among if name.casefold() in other][:WORDS]
    hint = f"did you mean {' or '.join(close)}?" if close else "bayes-aero effects lists them all"
    raise InputError(f"there is no effect {name!r}; {hint}")


def effect_facts(effect: Effect, card: Card | None = None) -> dict[str, Any]:
    """An effect as plain data; `model` says whether the card's model has it, null without a card."""
    return {
        "name": effect.name,
        "kind": effect.kind.value,
        "stage": effect.stage.name.lower(),
        "claim": effect.claim,
        "formula": effect.formula,
        "parameters": [_parameter(p, effect) for p in effect.parameters],
        "needs": list(effect.channels),
        "rests_on": list(effect.uses),
        "axes": [axis.value for axis in effect.axes],
        "proposed_by_diagnose": effect.candidate and (card is None or effect.acts_on(card.axes)),
        "example": {
            "parameters": dict(effect.example.parameters),
            "signals": dict(effect.example.signals),
            "known": dict(effect.example.known or {}),
            "increments": dict(effect.example.increments),
            "source": effect.example.source,
        },
        "source": effect.source,
        "model": None if card is None else effect.name in card.effects,
    }


def _parameter(p: Parameter, effect: Effect) -> dict[str, Any]:
    least, most = effect.sizes.get(p.name, (None, None))
    return {
        "name": p.name,
        "unit": p.unit,
        "description": p.description,
        "neutral": p.neutral,
        "start": p.start,
        "bounds": list(p.bounds),
        "prior": {
            "family": p.prior.family,
            "location": p.prior.location,
            "scale": p.prior.scale,
            "source": p.prior.source,
            "text": prior_in_words(p.prior),
        },
        "least_worth_modelling": least,
        "largest_plausible": most,
    }


def prior_in_words(prior: Prior) -> str:
    """A prior as people write it."""
    a, b = f"{prior.location:g}", f"{prior.scale:g}"
    return {
        "normal": f"normal, mean {a}, deviation {b}",
        "lognormal": f"lognormal, median {a}, deviation of the logarithm {b}",
        "halfnormal": f"half-normal above {a}, scale {b}",
        "uniform": f"uniform, {a} to {prior.location + prior.scale:g}",
    }[prior.family]
