"""Records of different sampling rates in one job."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bayes_aero.flight.health.finding import HealthFinding, found
from bayes_aero.flight.record import FlightRecord

ALIKE = 0.01  # relative difference of rates that is none


def different_rates(records: Sequence[FlightRecord]) -> list[HealthFinding]:
    """A finding for the first record whose rate is not that of the others, with all rates."""
    if len(records) < 2:
        return []
    rates = np.array([1.0 / record.dt for record in records])
    off = np.flatnonzero(np.abs(np.log(rates / rates[0])) > ALIKE)
    if not len(off):
        return []
    listed = ", ".join(f"{r.name} {rate:.4g} Hz" for r, rate in zip(records, rates, strict=True))
    sentence = (
        f"the records have different sampling rates ({listed}): filters span samples, so derivatives and noise differ "
        f"between them; identify brings them to the lowest rate by default, elsewhere resample "
        f"(--resample {1.0 / rates.min():.4g})"
    )
    return [found(records[int(off[0])], "time", "rates", sentence)]
