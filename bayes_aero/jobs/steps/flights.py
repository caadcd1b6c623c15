"""Fits of flights: coefficients, first values from them, output error, process noise, pooled manoeuvres."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from pathlib import Path as Folder

import numpy as np
from jaxtyping import Float

from bayes_aero.diagnosis.consistency import no_flight_path
from bayes_aero.diagnosis.trajectories.histories import fly_given, with_process_noise
from bayes_aero.diagnosis.trajectories.results import ProcessNoise, SimulatedManoeuvre, TrajectoryFit
from bayes_aero.diagnosis.trajectories.trajectories import fit_trajectories
from bayes_aero.dynamics.flight import Dynamics, aircraft_dynamics, taken_as_zero
from bayes_aero.dynamics.linear import linear_dynamics
from bayes_aero.dynamics.output_channels import FLIGHT
from bayes_aero.dynamics.path import path_dynamics
from bayes_aero.errors import InputError, attempted
from bayes_aero.flight.card.card import Card, channel_units
from bayes_aero.flight.channel import STANDARD_CHANNELS
from bayes_aero.flight.record import FlightRecord
from bayes_aero.inference.identification import Identification
from bayes_aero.inference.likelihood.mle import MAX_SEPARATE_FITS, fit_mle, without_noise_bias
from bayes_aero.inference.likelihood.mle_result import MleResult
from bayes_aero.inference.pooled import next_flight
from bayes_aero.inference.pooled_result import NextFlight
from bayes_aero.inference.posterior.nuts import ENGINES
from bayes_aero.inference.posterior.posterior import Posterior
from bayes_aero.jobs.io.fly_json import Flight
from bayes_aero.jobs.options import FlyOptions
from bayes_aero.jobs.steps.record_checks import repaired, spike_notes
from bayes_aero.model.joined_channels import Flights, despiked, join
from bayes_aero.model.model import Model
from bayes_aero.model.observations import Forming, observe
from bayes_aero.physics.flightpath import PATH_CORE
from bayes_aero.progress import Progress
from bayes_aero.report.style import MOST_MANOEUVRES
from bayes_aero.report.text.fly import posterior_sentences
from bayes_aero.report.text.phrases import several


def coefficient_fit(
    records: Sequence[FlightRecord], card: Card, seed: int, progress: Progress | None
) -> MleResult | None:
    """The fit of the coefficients, as `identify` does it, where they can be formed."""
    if card.linear is not None:
        return None
    if progress:
        progress("coefficients", 0.0)
    model, (without_spikes, _) = Model.from_card(card), repaired(records)
    try:
        found = fit_mle(model, observe(without_spikes, card, model), seed=seed)
        return without_noise_bias(found, without_spikes, card, model, seed=seed)
    except InputError:
        return None


def starts_of(found: MleResult | None, dynamics: Dynamics) -> list[Float[np.ndarray, " k"]]:
    """What the fit of the coefficients has found: a trajectory has optima far from the flight."""
    if found is None:
        return []
    near = dict(zip(found.names, found.estimate, strict=True))
    lower, upper = (np.array([p.bounds[i] for p in dynamics.free], float) for i in (0, 1))
    start = np.array([near.get(p.name, p.start) for p in dynamics.free])
    return [np.clip(start, lower, upper)] if np.all(np.isfinite(start)) else []


def output_error_fit(
    flights: Flights,
    dynamics: Dynamics,
    card: Card,
    starts: Sequence[Float[np.ndarray, " k"]],
    options: FlyOptions,
    progress: Progress | None,
) -> TrajectoryFit:
    """The card's model fitted to the trajectories, as the options say."""
    return fit_trajectories(
        flights,
        dynamics,
        {name: STANDARD_CHANNELS[name].unit for name in STANDARD_CHANNELS} | channel_units(card),
        starts=starts,
        window=options.windows,
        tolerances={name: tolerance.value for name, tolerance in card.tolerances.items()},
        biases={} if options.flight_path else card.output_biases,
        setting=options.setting(card),
        progress=progress,
    )


# --- What a record is flown by: the card's model of effects, its linear system, or its accelerations and rates.


def flown_dynamics(
    records: Sequence[FlightRecord], card: Card, outputs: Sequence[str], *, path: bool
) -> tuple[Flights, Dynamics, list[str]]:
    """The records end to end without spikes, what flies them, and what to say of it.

    `path`: the recorded accelerations and rates fly them, not the card's model.
    """
    notes: list[str] = []
    dynamics: Dynamics
    if path:
        flights, spikes = despiked(join(records, card, PATH_CORE))
        if why := no_flight_path(records, card):
            raise InputError(f"the flight path cannot be reconstructed: {why}")
        flights, dynamics = path_dynamics(flights, card)
        unused = "psi" in flights.channels and "psi" not in dynamics.states
        notes += ["The heading is left out: it jumps or stands still, or bank was not recorded."] if unused else []
    elif card.linear is not None:
        flights, spikes = despiked(join(records, card, card.linear.inputs))
        dynamics = linear_dynamics(card, flights.lengths)
    else:
        flights, spikes = despiked(join(records, card, FLIGHT))
        dynamics = aircraft_dynamics(Model.from_card(card), flights, outputs)
        still = taken_as_zero(flights)
        notes += [f"Not recorded, and taken as zero: {several(still)}."] if still else []
        notes += [f"Held to the record: {several(dynamics.prescribed)}."] if dynamics.prescribed else []
    unseen = [n for n in dynamics.start if n not in flights.channels and n in STANDARD_CHANNELS]
    notes += [f"States that were not recorded begin at zero or as fitted: {several(unseen)}."] if unseen else []
    notes += spike_notes(spikes)
    return flights, dynamics, notes


# --- The identified model flown through the recorded inputs: what its coefficients' errors become on the way.

WHAT = "The identified model"


def fly_identified(
    records: Sequence[FlightRecord], card: Card, model: Model, mle: MleResult, out: Folder
) -> tuple[tuple[SimulatedManoeuvre, ...], tuple[str, ...], tuple[str, ...]]:
    """Every record from its measured initial state, notes and failures; nothing where a channel that drives it is
    missing, with a note that says so."""
    values = dict(zip(mle.names, map(float, mle.estimate), strict=True))
    bands = {name: tolerance.value for name, tolerance in card.tolerances.items()}

    def flown() -> tuple[SimulatedManoeuvre, ...]:
        flights, _ = despiked(join(records, card, FLIGHT))
        return fly_given(flights, model, values, bands)

    try:
        paths, failures = attempted(f"{WHAT} was not flown", flown, (), out, own=bool(card.effect_files))
    except InputError as error:
        return (), (f"{WHAT} was not flown: {error}",), ()
    return paths, (), failures


# --- The fit with process noise beside output error, and its posterior.

Sampling = Callable[[str], dict[str, Posterior]]


def process_noise(
    flown: TrajectoryFit, options: FlyOptions, card: Card, out: Path | None, progress: Progress | None
) -> tuple[tuple[ProcessNoise | None, Sampling | None], tuple[str, ...]]:
    """The fit with process noise where it was asked for and output error has a result to start from; what samples its
    posterior where that was asked for and the fit has converged."""
    if not (options.filtered and flown.converged):
        return (None, None), ()
    if progress:
        progress("process noise", 0.9)
    own = bool(card.effect_files)
    fit = partial(with_process_noise, flown)
    found, failed = attempted("Process noise was not fitted", fit, None, out, own=own)
    if found is None:
        return (None, None), failed
    beside, sample = found
    wanted = options.posterior and beside.converged
    return (beside, partial(sample, options.seed, progress) if wanted else None), failed


def with_posterior(
    found: Flight, sample: Sampling, card: Card, out: Path | None, put: Callable[[Flight], None]
) -> Flight:
    """With the posterior, and what is said of its chains; what is known is `put` before each sampler, for minutes."""
    begun, posteriors, failures = found, {}, found.failures
    for engine in ENGINES:
        put(found)
        by = partial(sample, engine)
        new, failed = attempted("The posterior was not sampled", by, {}, out, own=bool(card.effect_files))
        posteriors, failures = posteriors | new, (*failures, *failed)
        said = (*begun.sentences, *posterior_sentences(posteriors))
        found = replace(begun, posteriors=posteriors, sentences=said, failures=failures)
    return found


# --- Several manoeuvres of an identification: what they say of the next flight, and what is left out of many.


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
