"""Records too short for the filters and for the motion of the aircraft."""

from __future__ import annotations

import numpy as np

from bayes_aero.flight.card.card import Card
from bayes_aero.flight.health.finding import HealthFinding, found
from bayes_aero.flight.record import FlightRecord

ENDS = 30  # samples at both ends together that the smoother (7) and the differentiator (8) distort
SHARE = 0.25  # of a record that may be ends
CHORDS = 120.0  # lengths travelled: two short periods, or a separation and, at 20 to 30 chords, its reattachment
LEAST = 5.0  # s, where the card states no chord


def short(record: FlightRecord, card: Card) -> list[HealthFinding]:
    """A finding if the record is shorter than a manoeuvre must be to be identified by itself."""
    lasts = float(record.time[-1] - record.time[0])
    chord = float(card.aircraft.chord)
    speed = float(np.median(record["airspeed"])) if record.has("airspeed") else np.nan
    motion = CHORDS * chord / speed if np.isfinite(chord) and chord > 0.0 and speed > 5.0 else LEAST
    ends = 0.0 if card.linear is not None else ENDS / SHARE * record.dt  # a linear model is flown, nothing is filtered
    motion = min(motion, LEAST) if card.linear is not None else motion
    needed = max(motion, ends)
    if lasts >= needed:
        return []
    why = (
        f"{CHORDS:.0f} chords of flight, in which an aircraft has answered a control and a stall has come and gone"
        if motion >= ends
        else f"{ENDS} samples at the ends, which the filters distort, must not be more than a quarter of it"
    )
    least, has = np.ceil(10.0 * needed) / 10.0, np.floor(10.0 * lasts) / 10.0  # never the same number
    sentence = (
        f"the record is too short: {has:g} s, and {least:g} s are needed ({why}); estimates can be off by "
        "several standard errors, so give the whole manoeuvre with some seconds of trimmed flight before it"
    )
    return [found(record, "record", "short", sentence, at=(0, record.n - 1))]
