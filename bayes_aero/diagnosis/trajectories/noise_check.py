"""What a diagnosis by trajectories alone has tested: does the simulation miss more than measurement noise?

Of structure without a name only terms of the library are sought along trajectories. Causes that improve the fit explain
what the card's model gets wrong only as far as nothing is left beside the noise of the sensors, an absolute scale.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from bayes_aero.diagnosis.consistency.flight_path_noise import sensor_noise
from bayes_aero.diagnosis.result import Diagnosis, OutputMiss, Tested, verdict_of
from bayes_aero.diagnosis.trajectories.results import Trajectories
from bayes_aero.flight.card.card import Card
from bayes_aero.flight.health.signals import channels_of
from bayes_aero.flight.record import FlightRecord


def with_tested(found: Diagnosis, flown: Trajectories | None, records: Sequence[FlightRecord], card: Card) -> Diagnosis:
    """The diagnosis with what the simulation still misses, and a verdict that claims no more than that.

    Args:
        found: by trajectories alone, its causes judged on hold-out flights.
        flown: its extended model, flown; None where that was not done.
        records: what it rests on.
        card: states the sensors' noise; a usual installation's where it does not.
    """
    tested = Tested({} if flown is None else beyond_noise(flown, records, card))
    return replace(found, tested=tested, verdict=verdict_of(found.causes, found.left, tested))


def beyond_noise(flown: Trajectories, records: Sequence[FlightRecord], card: Card) -> dict[str, OutputMiss]:
    """What the extended model misses of every fitted output (root mean squares, SI), and the noise that is allowed."""
    noises = [sensor_noise(channels_of(record, card), card).white for record in records]
    lengths = [record.n for record in records]
    return {
        name: OutputMiss(
            noise=float(np.sqrt(np.average([n.get(name, 0.0) ** 2 for n in noises], weights=lengths))),
            fitted=_rms(flown, name, "fitted"),
            unseen=_rms(flown, name, "hold_out"),
        )
        for name in flown.fitted
    }


def _rms(flown: Trajectories, output: str, split: str) -> float:
    """Root mean square error of the extended model over all its flights of one split."""
    paths = [p for p in flown.paths if (p.model, p.split) == ("extended", split)]
    if not paths:
        return float("nan")
    squares = [p.errors[output].rms ** 2 for p in paths]
    return float(np.sqrt(np.average(squares, weights=[len(p.time) for p in paths])))
