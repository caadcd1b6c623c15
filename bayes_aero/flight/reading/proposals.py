"""The parts of a file that are worth a record of their own: those in flight, and the manoeuvres in them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import binary_closing, binary_dilation, uniform_filter1d

from bayes_aero.flight.card.card import Card
from bayes_aero.flight.health.across.ground import grounded
from bayes_aero.flight.health.signals import runs_of
from bayes_aero.flight.reading.segments import SHORTEST, parts_of
from bayes_aero.flight.record import FlightRecord
from bayes_aero.units import instant

__all__ = ["Proposal", "proposals"]

WINDOW = 2.0  # s over which a control or a rate must move
PAUSE = 4.0  # s of rest that divide two manoeuvres
LEAD = 2.0  # s kept before and after
BRIEFEST = 3.0  # s of movement that make a manoeuvre
ABOVE = 4.0  # times the quiet tenth of the record
MOST = 0.8  # of a part; a manoeuvre that fills more of it is the part
MOVES = {
    "p": np.deg2rad(1.0), "q": np.deg2rad(0.5), "r": np.deg2rad(0.5),
    "elevator": np.deg2rad(0.3), "aileron_left": np.deg2rad(0.5), "aileron_right": np.deg2rad(0.5),
    "aileron": np.deg2rad(0.5), "rudder": np.deg2rad(0.5),
}  # fmt: skip
"""Standard deviation over `WINDOW`, rad/s or rad, below which nothing was flown whatever the record's noise."""


@dataclass(frozen=True)
class Proposal:
    """A part of a file as it is written behind "@", what it is, and its first and last time in s."""

    part: str
    what: str
    begin: float
    end: float


def proposals(record: FlightRecord, card: Card) -> tuple[Proposal, ...]:
    """Parts to analyse in place of a whole file; none where the file is one flight that is one manoeuvre.

    Args:
        record: the whole file, in SI, unchecked: time may have gaps or start over.
        card: the aircraft, which tells flight from ground.
    """
    parts = [(a, b) for a, b in parts_of(record.time) if b - a >= SHORTEST]
    forward = bool((np.diff(record.time) > 0.0).all())
    flown: list[tuple[int, int]] = []
    for a, b in parts:
        flown += _in_flight(_window(record, a, b), card, a)
    found = []
    if flown != [(0, record.n)]:
        found += [_proposal(record, a, b, "in flight", forward) for a, b in flown]
    if forward:
        for a, b in flown:
            moved = _manoeuvres(_window(record, a, b), a)
            if len(moved) > 1 or (moved and moved[0][1] - moved[0][0] < MOST * (b - a)):
                found += [_proposal(record, i, j, "manoeuvre", forward) for i, j in moved]
    return tuple(found)


def _window(record: FlightRecord, a: int, b: int) -> FlightRecord:
    return FlightRecord(record.name, record.time[a:b], {n: x[a:b] for n, x in record.channels.items()}, "", "")


def _in_flight(part: FlightRecord, card: Card, offset: int) -> list[tuple[int, int]]:
    """First sample and the one after the last of what is flown."""
    if part.has("airspeed") and not np.isfinite(part["airspeed"]).all():
        return [(offset, offset + part.n)]
    ground = grounded(part, card)
    edges = [0, *(i for a, b in ground for i in (a, b + 1)), part.n]
    pairs = zip(edges[::2], edges[1::2], strict=True)
    return [(offset + a, offset + b) for a, b in pairs if b - a >= SHORTEST]


def _manoeuvres(part: FlightRecord, offset: int) -> list[tuple[int, int]]:
    """Where controls or rates move, with some seconds before and after."""
    size = max(round(WINDOW / part.dt), 3)
    moving = np.zeros(part.n, bool)
    for name, least in MOVES.items():
        if not part.has(name) or not np.isfinite(part[name]).all():
            continue
        mean = uniform_filter1d(part[name], size)
        spread = np.sqrt(np.maximum(uniform_filter1d((part[name] - mean) ** 2, size), 0.0))
        moving |= spread > max(least, ABOVE * float(np.quantile(spread, 0.1)))
    pause, lead = max(round(PAUSE / part.dt), 1), max(round(LEAD / part.dt), 1)
    moving = binary_closing(np.pad(moving, pause), np.ones(pause))[pause:-pause]
    runs = [(a, b) for a, b in runs_of(moving) if (b - a) * part.dt >= BRIEFEST]
    kept = np.zeros(part.n, bool)
    for a, b in runs:
        kept[a : b + 1] = True
    kept = binary_dilation(kept, np.ones(2 * lead + 1))
    return [(offset + a, offset + b + 1) for a, b in runs_of(kept) if b + 1 - a >= SHORTEST]


def _proposal(record: FlightRecord, a: int, b: int, what: str, forward: bool) -> Proposal:
    begin, end = float(record.time[a]), float(record.time[b - 1])
    number = next((k for k, part in enumerate(parts_of(record.time), 1) if part == (a, b)), None)
    spec = f"{instant(begin)}:{instant(end)}" if forward or number is None else f"#{number}"
    return Proposal(spec, what, begin, end)
