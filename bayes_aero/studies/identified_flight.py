"""The identified model flown through the recorded inputs: what its coefficients' errors become on the way."""

from __future__ import annotations

from collections.abc import Sequence

from bayes_aero.criticism.flown_given import fly_given
from bayes_aero.criticism.flown_paths import Path
from bayes_aero.errors import InputError
from bayes_aero.flight.card import Card
from bayes_aero.flight.record import FlightRecord
from bayes_aero.inference.mle import MleResult
from bayes_aero.model.flights import despiked, join
from bayes_aero.model.flown_channels import FLIGHT
from bayes_aero.model.model import Model


def fly_identified(
    records: Sequence[FlightRecord], card: Card, model: Model, mle: MleResult
) -> tuple[tuple[Path, ...], tuple[str, ...]]:
    """Every record from its measured initial state, and notes: none of it where a channel that drives it is missing."""
    values = dict(zip(mle.names, map(float, mle.estimate), strict=True))
    bands = {name: tolerance.value for name, tolerance in card.tolerances.items()}
    try:
        flights, _ = despiked(join(records, card, FLIGHT))
        return fly_given(flights, model, values, bands), ()
    except InputError as error:
        return (), (f"The identified model was not flown: {error}",)
    except Exception as reason:  # an effect of the user's own may not bear it; the rest stands
        return (), (f"The identified model was not flown: {type(reason).__name__}: {reason}",)
