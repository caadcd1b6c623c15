"""The repair of isolated spikes, and the note that every job gives on it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from bayes_aero.flight.record import FlightRecord
from bayes_aero.model.spikes import despiked_records
from bayes_aero.report.text.phrases import several


def repaired(records: Sequence[FlightRecord]) -> tuple[list[FlightRecord], tuple[str, ...]]:
    """The records without isolated spikes, and a note of what was replaced."""
    without, count = despiked_records(records)
    return without, spike_notes(count)


def spike_notes(count: Mapping[str, int]) -> tuple[str, ...]:
    """What was replaced, by channel; nothing where there were no spikes."""
    if not count:
        return ()
    counts = several(f"{number} of {name}" for name, number in count.items())
    return (f"Isolated spikes were replaced by the median of their neighbours: {counts}.",)
