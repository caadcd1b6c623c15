"""Angles that jump where they pass the end of their range."""

from __future__ import annotations

import numpy as np

from bayes_aero.flight.card.card import Card
from bayes_aero.flight.health.finding import HealthFinding, found
from bayes_aero.flight.record import FlightRecord

WITHIN = 4  # samples over which an anti-aliasing filter or an interpolation spreads a jump
ALIKE = 0.1  # of the jump
WORDS = {"psi": "heading", "phi": "bank angle", "longitude": "longitude"}


def wrapped(record: FlightRecord, card: Card) -> list[HealthFinding]:  # noqa: ARG001 - the checks have one signature
    """A finding for each angle with a jump of a full or half turn within a few samples."""
    said = []
    for name, word in WORDS.items():
        if not record.has(name):
            continue
        at, turn = jumps(record[name])
        if not len(at):
            continue
        times = ", ".join(f"{record.time[i + 1]:.6g}" for i in at[:3]) + (" ..." if len(at) > 3 else "")
        sentence = (
            f"{name}: the {word} jumps by {turn:.0f} deg {len(at)} times (t = {times} s), where it passes the end "
            "of its range; unwrap it in the file, or its rate is wrong there"
        )
        said.append(found(record, name, "wrapped", sentence, at=(int(at[0]), int(at[-1]) + 1), grave=name == "phi"))
    return said


def jumps(x: np.ndarray) -> tuple[np.ndarray, float]:
    """Samples before the jumps of an angle (n,) in rad, and their size in deg; filters may spread one over a few."""
    for turn in (2.0 * np.pi, np.pi):
        spread = np.zeros(len(x) - 1)
        for samples in range(1, WITHIN + 1):
            steps = np.abs(x[samples:] - x[:-samples])
            spread[: len(steps)] = np.maximum(spread[: len(steps)], steps)
        inside = np.flatnonzero(np.abs(spread - turn) < ALIKE * turn)
        if len(inside):
            return inside[np.diff(inside, prepend=-WITHIN - 9) > WITHIN], float(np.degrees(turn))
    return np.zeros(0, int), 0.0
