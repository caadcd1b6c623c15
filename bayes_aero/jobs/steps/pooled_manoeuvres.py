"""The next flight of an identification: its manoeuvres alone, freed from the bias of sensor noise, and pooled."""

from __future__ import annotations

from collections.abc import Sequence

from bayes_aero.flight.record import FlightRecord
from bayes_aero.inference.identification import Identification
from bayes_aero.inference.likelihood.noise_bias import without_noise_bias
from bayes_aero.inference.posterior.next_flight import next_flight
from bayes_aero.inference.posterior.next_flight_result import NextFlight
from bayes_aero.model.observations import Forming
from bayes_aero.progress import Progress


def pooled_manoeuvres(
    run: Identification, without_spikes: Sequence[FlightRecord], *, seed: int = 0, progress: Progress | None = None
) -> NextFlight:
    """Pool the manoeuvres of a run; `without_spikes` are its records as they were fitted.

    Raises:
        InputError: fewer than two manoeuvres have a usable fit.
    """
    alone = run.alone
    if run.forming is Forming.MATCHED:  # the joint fit, beside which they stand, has no such bias either
        alone = {
            name: without_noise_bias(fit, [record], run.card, run.model, seed=seed)
            for (name, fit), record in zip(alone.items(), without_spikes, strict=True)
        }
    return next_flight(run.model, run.observations, alone, seed=seed, progress=progress)
