"""What everything that reads records asks of them: are they different flights with sound channels, do sensors agree?"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from bayes_aero.diagnosis.consistency.consistency import KnownErrors, consistency
from bayes_aero.errors import InputError, attempted
from bayes_aero.flight.agreement import Consistency
from bayes_aero.flight.card.card import Card
from bayes_aero.flight.health import HealthFinding, channel_health
from bayes_aero.flight.record import FlightRecord


@dataclass(frozen=True)
class RecordChecks:
    """Faults of channels and records given twice, whether the sensors agree, and a sentence if that check failed."""

    health: tuple[HealthFinding, ...]
    consistency: Consistency
    failures: tuple[str, ...] = ()

    @contextmanager
    def behind(self) -> Iterator[None]:
        """Bad input that is found later is told with the faults that may be behind it."""
        try:
            yield
        except InputError as reason:
            faults = [finding.sentence for finding in self.health if finding.grave]
            raise InputError(". ".join([*faults, str(reason)])) from None


def record_checks(
    records: Sequence[FlightRecord],
    card: Card,
    seed: int,
    out: Path | None = None,
    *,
    known: KnownErrors | None = None,
    seek: bool = True,
    left_out: str = "",
) -> RecordChecks:
    """Check records, whichever command reads them; should the comparison of sensors fail, the job goes on without.

    Args:
        records: all that the command reads, in SI.
        card: what the channels are said to be.
        seed: of the records of noise.
        out: folder of the results.
        known: errors of sensors that a search has found.
        seek: whether to look for errors that explain why sensors disagree.
        left_out: why the sensors are not compared; empty: they are.
    """
    agreement, failures = attempted(
        "Whether the sensors agree was not checked",
        lambda: Consistency(left_out) if left_out else consistency(records, card, seed=seed, seek=seek, known=known),
        Consistency("the check failed"),
        out,
    )
    return RecordChecks(channel_health(records, card), agreement, failures)
