"""What the page of a diagnosis shows beside the finding itself."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from bayes_aero.flight.agreement import Consistency
from bayes_aero.flight.card.card import Card
from bayes_aero.flight.health import HealthFinding
from bayes_aero.flight.record import FlightRecord


@dataclass(frozen=True)
class PageContext:
    """What a diagnosis page needs beside the finding; `notes` are stages that were left out and why."""

    card: Card
    records: Sequence[FlightRecord]
    source: Mapping[str, Any]
    figures: Mapping[str, Path] = field(default_factory=dict)
    predictors: Mapping[str, Any] = field(default_factory=dict)
    separating: Sequence[Mapping[str, Any]] = ()
    revealed: Sequence[str] = ()
    notes: Sequence[str] = ()
    consistency: Consistency | None = None
    failures: Sequence[str] = ()  # parts that failed unexpectedly
    health: Sequence[HealthFinding] = ()  # what is wrong with channels
