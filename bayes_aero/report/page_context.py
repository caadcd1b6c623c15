"""Data of a diagnosis page in addition to the diagnosis."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from bayes_aero.diagnosis.result import CausesInBand
from bayes_aero.flight.agreement import Consistency
from bayes_aero.flight.card.card import Card
from bayes_aero.flight.health import HealthFinding
from bayes_aero.flight.record import FlightRecord


@dataclass(frozen=True)
class PageContext:
    """Data of a diagnosis page in addition to the diagnosis; `notes` are stages that were left out, with the reason."""

    card: Card
    records: Sequence[FlightRecord]
    source: Mapping[str, Any]
    figures: Mapping[str, Path] = field(default_factory=dict)
    test_points: Mapping[str, Any] = field(default_factory=dict)
    in_band: CausesInBand | None = None
    revealed: Sequence[str] = ()
    notes: Sequence[str] = ()
    consistency: Consistency | None = None
    failures: Sequence[str] = ()  # parts that failed unexpectedly
    health: Sequence[HealthFinding] = ()  # faults of channels
