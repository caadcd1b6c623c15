"""Whether the sensors agree, as the first stage of every job: should it fail unexpectedly, the job goes on without."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from bayes_aero.diagnosis.consistency.consistency import KnownErrors, consistency
from bayes_aero.errors import attempted
from bayes_aero.flight.agreement import Consistency
from bayes_aero.flight.card.card import Card
from bayes_aero.flight.record import FlightRecord


def sensors_agree(
    records: Sequence[FlightRecord], card: Card, seed: int, out: Path | None, known: KnownErrors | None = None
) -> tuple[Consistency, tuple[str, ...]]:
    """The answer of `consistency`, and a sentence if the check itself has failed."""
    return attempted(
        "Whether the sensors agree was not checked",
        lambda: consistency(records, card, seed=seed, known=known),
        Consistency("the check failed"),
        out,
    )
