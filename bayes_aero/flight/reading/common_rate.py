"""Records brought to one sampling rate, at which filters that span samples span the seconds they were made for."""

from __future__ import annotations

from collections.abc import Sequence

from bayes_aero.flight.reading.resample import resample_record
from bayes_aero.flight.record import FlightRecord

RATE = 25.0  # samples a second; that of the records for which the smoothing filters were published
SPARE = 1.25  # times that, up to which a record is taken as it is
SAME = 0.01  # relative difference of intervals that count as one


def common_interval(records: Sequence[FlightRecord]) -> float:
    """Sampling interval, s, that suits all records: the longest of theirs, or that of `RATE` where they are faster."""
    longest = max(record.dt for record in records)
    return 1.0 / RATE if longest * RATE * SPARE < 1.0 else longest


def at_common_rate(records: Sequence[FlightRecord]) -> list[FlightRecord]:
    """The records at `common_interval`, filtered against aliasing; those that have it, unchanged."""
    dt = common_interval(records) if records else 0.0
    return [record if abs(record.dt - dt) <= SAME * dt else resample_record(record, dt) for record in records]


def rate_notes(records: Sequence[FlightRecord]) -> tuple[str, ...]:
    """A sentence where records were brought to another rate; none where they were not."""
    changed = [old for old, new in zip(records, at_common_rate(records), strict=True) if new is not old]
    if not changed:
        return ()
    rates = ", ".join(f"{record.name} ({1.0 / record.dt:.4g} Hz)" for record in changed)
    return (
        f"Brought to the common rate of {1.0 / common_interval(records):.4g} Hz, filtered against aliasing: {rates}.",
    )
