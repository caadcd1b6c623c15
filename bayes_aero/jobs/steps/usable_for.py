"""What records allow, told before anything is fitted: which command can use them, and why another one cannot."""

from __future__ import annotations

from collections.abc import Sequence

from bayes_aero.diagnosis.folds import too_short
from bayes_aero.dynamics.output_channels import needed_channels
from bayes_aero.flight.card.card import Card
from bayes_aero.flight.record import FlightRecord
from bayes_aero.model.derived_channels import with_sums
from bayes_aero.model.model import Model
from bayes_aero.physics.coefficient_names import required_of
from bayes_aero.physics.filters import FILTER_STEP
from bayes_aero.residuals.windows import too_few_windows

DERIVED = ("alpha_dot",)  # formed from recorded channels


def usable_for(records: Sequence[FlightRecord], card: Card) -> dict[str, str]:
    """Why each command cannot use the records with the card, by command; empty where it can.

    A command that the card does not serve is left out.
    """
    have = available(records, card)
    if card.linear is not None:
        return {"fly": _lacks([n for n in (*card.linear.states, *card.linear.inputs) if n not in have])}
    asked = [n for n in Model.from_card(card).channels if n not in DERIVED]
    missing = [n for n in dict.fromkeys((*required_of(card.axes), *asked)) if n not in have]
    flown = [n for n in dict.fromkeys((*needed_channels(card.axes), *asked)) if n not in have]
    uses = {"identify": _lacks(missing), "diagnose": _lacks(missing), "fly": _lacks(flown)}
    if missing and not flown:
        uses["diagnose"] = too_few_windows(records)
        uses["diagnose by coefficients"] = _lacks(missing)
    if len(records) == 1 and not uses["diagnose"]:
        uses["diagnose"] = too_short(records[0].n // FILTER_STEP * FILTER_STEP * records[0].dt)
    return uses


def available(records: Sequence[FlightRecord], card: Card) -> set[str]:
    """Channels that every record has, by itself or by what the card states."""
    return set.intersection(*(set(with_sums(record, card)) for record in records))


def _lacks(missing: Sequence[str]) -> str:
    if not missing:
        return ""
    return f"no channel {', '.join(missing)}: map {'it' if len(missing) == 1 else 'them'}, or state a constant"
