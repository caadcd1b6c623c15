"""The identified model flown through the recorded inputs: what its coefficients' errors become on the way."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path as Folder

from bayes_aero.diagnosis.trajectories.results import Path
from bayes_aero.diagnosis.trajectories.time_histories import fly_given
from bayes_aero.dynamics.output_channels import FLIGHT
from bayes_aero.errors import InputError, attempted
from bayes_aero.flight.card.card import Card
from bayes_aero.flight.record import FlightRecord
from bayes_aero.inference.likelihood.mle_result import MleResult
from bayes_aero.model.joined_channels import despiked, join
from bayes_aero.model.model import Model

WHAT = "The identified model"


def fly_identified(
    records: Sequence[FlightRecord], card: Card, model: Model, mle: MleResult, out: Folder
) -> tuple[tuple[Path, ...], tuple[str, ...], tuple[str, ...]]:
    """Every record from its measured initial state, notes and failures; nothing where a channel that drives it is
    missing, with a note that says so."""
    values = dict(zip(mle.names, map(float, mle.estimate), strict=True))
    bands = {name: tolerance.value for name, tolerance in card.tolerances.items()}

    def flown() -> tuple[Path, ...]:
        flights, _ = despiked(join(records, card, FLIGHT))
        return fly_given(flights, model, values, bands)

    try:
        paths, failures = attempted(f"{WHAT} was not flown", flown, (), out, own=bool(card.effect_files))
    except InputError as error:
        return (), (f"{WHAT} was not flown: {error}",), ()
    return paths, (), failures
