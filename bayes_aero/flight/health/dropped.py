"""What was decided when the record was read: optional channels that were left out, text that could mean two things."""

from __future__ import annotations

from bayes_aero.flight.card.card import Card
from bayes_aero.flight.health.finding import HealthFinding, found
from bayes_aero.flight.record import FlightRecord


def dropped_channels(record: FlightRecord, card: Card) -> list[HealthFinding]:  # noqa: ARG001 - one signature
    """A finding for each channel that the card does not require and that no sound record could have."""
    return [
        found(record, name, "left_out", f"{why}; it is not required and was left out", grave=False)
        for name, why in record.dropped.items()
    ]


def read_remarks(record: FlightRecord, card: Card) -> list[HealthFinding]:  # noqa: ARG001 - one signature
    """A finding for each sentence on how the file was understood."""
    return [found(record, "record", "read", remark, grave=False) for remark in record.remarks]
