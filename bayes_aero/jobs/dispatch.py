"""The two jobs on records by their options alone, as the command line and studies give them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from bayes_aero.flight.card.card import Card
from bayes_aero.flight.record import FlightRecord
from bayes_aero.jobs.diagnose import run
from bayes_aero.jobs.io.result_store import Hidden, Outcome
from bayes_aero.jobs.steps.post_diagnosis import predictors as compared
from bayes_aero.jobs.steps.post_diagnosis import simulations
from bayes_aero.progress import Progress


def diagnose_records(
    flights: Sequence[FlightRecord],
    card: Card,
    *,
    out: Path | None,
    seed: int = 0,
    max_effects: int = 8,
    predictors: bool = True,
    trajectories: bool = True,
    figures: bool = True,
    hidden: Hidden | None = None,
    progress: Progress | None = None,
) -> Outcome:
    """Diagnose, as `bayes-aero diagnose` does."""
    return run(
        flights,
        card,
        out=out,
        seed=seed,
        most=max_effects,
        hidden=hidden,
        predict=(lambda found, tell: compared(found, card, tell)) if predictors else None,
        fly=(lambda found, tell: simulations(found, card, flights, seed, tell)) if trajectories else None,
        figures=figures,
        progress=progress,
    )
