"""Windows of output error, between which the scatter tests effects where there are no accelerometers."""

from __future__ import annotations

from collections.abc import Sequence

from bayes_aero.flight.record import FlightRecord
from bayes_aero.model.joined_records import cuts_of
from bayes_aero.units import number

WINDOW = 10.0  # s: long enough to integrate model errors, short enough to stay near the record


def too_few_windows(records: Sequence[FlightRecord]) -> str:
    """Why effects cannot be tested by the scatter between windows; empty where they can."""
    if sum(len(cuts_of(record.n, record.dt, WINDOW)) for record in records) > 1:
        return ""
    seconds = records[0].time[-1] - records[0].time[0]
    return (
        f"without accelerometers an effect is tested by the scatter between windows of {WINDOW:g} s, and "
        f"{records[0].name} of {number(seconds)} s is one window; give a second manoeuvre, or one of {2 * WINDOW:g} s"
    )
