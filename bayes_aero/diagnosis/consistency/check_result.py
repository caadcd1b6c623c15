"""What a check of records has found, before anything is fitted."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from bayes_aero.flight.agreement import Consistency
from bayes_aero.flight.card.card import Card
from bayes_aero.flight.health import HealthFinding
from bayes_aero.flight.reading.inspection import RecordReport


@dataclass(frozen=True)
class SensorCheck:
    """Flight-path consistency: the sensor errors and winds it asks for, and root mean squares before and after, SI."""

    note: str  # why it was not done; empty where it was
    errors: dict[str, dict[str, Any]]
    rms: dict[str, tuple[float, float]]


@dataclass(frozen=True)
class CheckReport:
    """All records together. `uses` says of each command why it cannot work on them; empty text: it can.

    `health` is what is wrong with the channels of the usable records, and `cautions` its sentences. `left_out` has a
    sentence on each axis of the card that the records do not serve.
    """

    card: Card
    records: tuple[RecordReport, ...]
    uses: dict[str, str]
    not_testable: dict[str, str]
    sensors: SensorCheck
    consistency: Consistency
    health: tuple[HealthFinding, ...] = ()
    left_out: tuple[str, ...] = ()
    failures: tuple[str, ...] = ()  # of checks that went wrong themselves

    @property
    def cautions(self) -> tuple[str, ...]:
        """What is wrong with the records, in words."""
        return tuple(finding.sentence for finding in self.health)

    @property
    def usable(self) -> bool:
        """Whether every record can be read and some command can work on all of them."""
        return not any(r.problems for r in self.records) and "" in self.uses.values()
