"""Effects and parameters as a card or a caller chooses them."""

from __future__ import annotations

import math
from difflib import get_close_matches

from bayes_aero.effect import Effect
from bayes_aero.effects import CATALOGUE
from bayes_aero.errors import InputError
from bayes_aero.flight.aircraft import Aircraft
from bayes_aero.flight.axes import Axis
from bayes_aero.flight.card.card import Card
from bayes_aero.parameter import Lengths, Parameter

TRANSPORT_SPAN = 21.5  # m, of the transport of some 20 t for which `effects` states sizes


def lengths_of(a: Aircraft) -> Lengths:
    """How often the card's reference lengths go into chord, half span and span."""
    given = (a.chord, a.rate_length), (a.half_span, a.lateral_rate_length), (2.0 * a.half_span, a.lateral_length)
    span = 2.0 * float(a.half_span) / TRANSPORT_SPAN
    rate, lateral_rate, moment = (1.0 if length is None else float(usual) / float(length) for usual, length in given)
    return Lengths(rate, lateral_rate, moment, span if math.isfinite(span) else 1.0)


def no_such_axis(effect: Effect, axes: tuple[Axis, ...]) -> str:
    """The sentence on an effect that adds to none of the coefficients of a model of `axes`."""
    added = ", ".join(effect.example.increments)
    return (
        f"effect {effect.name} acts on {added} of the {' and '.join(effect.axes)} axis, which the model lacks; "
        f'remove it, or add "{effect.axes[0]}" to the axes ({", ".join(axes)})'
    )


def effect_named(name: str) -> Effect:
    """An effect of the catalogue by name.

    Raises:
        InputError: there is none; the message suggests a similar name.
    """
    if name in CATALOGUE:
        return CATALOGUE[name]
    close = get_close_matches(name, CATALOGUE, n=1)
    hint = f"did you mean {close[0]}?" if close else f"the catalogue has {', '.join(CATALOGUE)}"
    raise InputError(f"there is no effect {name!r}; {hint}")


def as_on_card(parameter: Parameter, card: Card) -> Parameter:
    """A parameter with the start, bounds and prior that a card states."""
    change = card.changes.get(parameter.name)
    if change is None:
        return parameter
    given = {key: value for key, value in vars(change).items() if value is not None}
    try:
        return parameter.changed(**given)
    except InputError as error:
        raise InputError(f"card {card.name}: {error}") from None
