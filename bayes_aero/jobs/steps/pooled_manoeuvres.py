"""Several manoeuvres of an identification: what they say of the next flight, and what is left out of many."""

from __future__ import annotations

from collections.abc import Sequence

from bayes_aero.flight.record import FlightRecord
from bayes_aero.inference.identification import Identification
from bayes_aero.inference.likelihood.mle import MAX_SEPARATE_FITS
from bayes_aero.inference.likelihood.noise_bias import without_noise_bias
from bayes_aero.inference.posterior.pooled.next_flight import next_flight
from bayes_aero.inference.posterior.pooled.next_flight_result import NextFlight
from bayes_aero.model.observations import Forming
from bayes_aero.progress import Progress
from bayes_aero.report.style import MOST_MANOEUVRES


def pooled_manoeuvres(
    run: Identification, without_spikes: Sequence[FlightRecord], *, seed: int = 0, progress: Progress | None = None
) -> NextFlight:
    """Pool the manoeuvres of a run, without the bias of sensor noise; `without_spikes` are its records as fitted.

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


def left_out_of_many(manoeuvres: int) -> tuple[str, ...]:
    """What is left out because there are so many."""
    said = []
    if manoeuvres > MAX_SEPARATE_FITS:
        said.append(f"{manoeuvres} manoeuvres are fitted jointly; beyond {MAX_SEPARATE_FITS} none is fitted by itself.")
    if manoeuvres > MOST_MANOEUVRES:
        said.append(f"Figures with a panel for each manoeuvre are drawn for up to {MOST_MANOEUVRES} of them.")
    return tuple(said)
