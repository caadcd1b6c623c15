"""Removal of an axis from a card where records lack its channels."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace

from bayes_aero.effect import Effect
from bayes_aero.effects import CATALOGUE
from bayes_aero.flight.axes import Axis
from bayes_aero.flight.card.card import Card
from bayes_aero.flight.record import FlightRecord
from bayes_aero.model.derived_channels import with_sums
from bayes_aero.model.own_effects import own_effects
from bayes_aero.physics.coefficient_names import COEFFICIENTS, FORMED_FROM

FORMED = ("alpha_dot",)  # from recorded channels, in any record


def on_recorded_axes(
    card: Card,
    records: Sequence[FlightRecord],
    needed: Mapping[Axis, Sequence[str]] = FORMED_FROM,
    made: Collection[str] = FORMED,
) -> tuple[Card, tuple[str, ...]]:
    """The card without an axis whose channels some record lacks, and a sentence on each that is left out.

    A card of one axis, or one whose axes all lack channels, is unchanged; the missing channels are reported later.

    Args:
        card: aircraft and model.
        records: flights, at least one.
        needed: channels that each axis needs beside those of its effects; default: for the coefficients.
        made: channels that effects read and that are computed from others.

    Returns:
        The card without these axes, and a sentence for each of them.
    """
    if len(card.axes) < 2 or not records:
        return card, ()
    catalogue = {**CATALOGUE, **own_effects(card.effect_files)}
    own = {a: [catalogue[n] for n in card.effects if n in catalogue and catalogue[n].axes == (a,)] for a in card.axes}
    missing = {axis: _missing(card, records, needed[axis], made, own[axis]) for axis in card.axes}
    kept = tuple(axis for axis in card.axes if not missing[axis])
    if not kept or kept == card.axes:
        return card, ()
    unknown = {name for axis in card.axes if axis not in kept for name in missing[axis][1:]}
    every = [catalogue[name] for name in card.effects if name in catalogue]
    gone = {e.name for e in every if not e.acts_on(kept) or not unknown.isdisjoint(e.channels)}
    theirs = {p.name for name in gone for p in catalogue[name].parameters}
    fewer = replace(
        card,
        axes=kept,
        effects=tuple(name for name in card.effects if name not in gone),
        fixed={name: x for name, x in card.fixed.items() if name not in theirs},
        changes={name: x for name, x in card.changes.items() if name not in theirs},
    )
    return fewer, tuple(_sentence(axis, *missing[axis]) for axis in card.axes if axis not in kept)


def _missing(
    card: Card,
    records: Sequence[FlightRecord],
    needed: Sequence[str],
    made: Collection[str],
    effects: Sequence[Effect],
) -> tuple[str, ...]:
    """The record that lacks channels of an axis, then the channels; nothing where all have them."""
    asked = dict.fromkeys((*needed, *(c for effect in effects for c in effect.channels)))
    for record in records:
        have = with_sums(record, card)
        lacks = [name for name in asked if name not in have and name not in made]
        if lacks:
            return record.name, *lacks
    return ()


def _sentence(axis: Axis, record: str, *channels: str) -> str:
    return (
        f"The {axis.value} axis ({', '.join(COEFFICIENTS[axis])}) is left out: record {record} has no channel "
        f"{', '.join(channels)}; map {'it' if len(channels) == 1 else 'them'} on the card to include it."
    )
