"""Fits of flights: coefficients, first values from them, output error, process noise, pooled manoeuvres."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from bayes_aero.diagnosis.consistency import no_flight_path
from bayes_aero.diagnosis.trajectories.histories import fly_given, with_process_noise
from bayes_aero.diagnosis.trajectories.results import ProcessNoise, Setting, SimulatedManoeuvre, TrajectoryFit
from bayes_aero.diagnosis.trajectories.trajectories import fit_trajectories
from bayes_aero.dynamics.flight import Dynamics, aircraft_dynamics, taken_as_zero
from bayes_aero.dynamics.linear import linear_dynamics
from bayes_aero.dynamics.output_channels import FLIGHT
from bayes_aero.dynamics.path import path_dynamics
from bayes_aero.errors import InputError, attempted
from bayes_aero.flight.card.card import Card, channel_units
from bayes_aero.flight.channel import STANDARD_CHANNELS
from bayes_aero.flight.record import FlightRecord
from bayes_aero.inference.frequency import linear_in_band
from bayes_aero.inference.identification import Identification
from bayes_aero.inference.likelihood.mle import MAX_SEPARATE_FITS, fit_mle, without_noise_bias
from bayes_aero.inference.likelihood.mle_result import MleResult
from bayes_aero.inference.pooled import next_flight
from bayes_aero.inference.pooled_result import NextFlight
from bayes_aero.inference.posterior.nuts import ENGINES
from bayes_aero.inference.posterior.posterior import Posterior
from bayes_aero.jobs.io.fly_json import Flight
from bayes_aero.jobs.options import FREE, HELD, FlyOptions
from bayes_aero.jobs.steps.record_checks import repaired, spike_notes
from bayes_aero.model.joined_channels import Flights, despiked, join
from bayes_aero.model.model import Model
from bayes_aero.model.observations import Forming, observe
from bayes_aero.physics.flightpath import PATH_CORE
from bayes_aero.progress import Progress
from bayes_aero.report.style import MOST_MANOEUVRES
from bayes_aero.report.text.fly import posterior_sentences
from bayes_aero.report.text.phrases import several
from bayes_aero.residuals.frequency_error import lines_in


def check_band(
    band: tuple[float, float] | None, records: Sequence[FlightRecord], card: Card, *, flown: bool = False
) -> None:
    """Refuse a band in which a record has no frequency, and trajectories of effects, before anything is computed."""
    if band is None:
        return
    if flown and card.linear is None:
        raise InputError(
            f"trajectories are fitted in the frequency domain for linear cards only; card {card.name} has a model of "
            "effects, so use bayes-aero identify --frequency"
        )
    for record in records:
        lines_in(band, record.n, record.dt, record.name)


def setting_of(options: FlyOptions, card: Card) -> Setting:
    """How trajectories are fitted; what is not given is the card's."""
    outputs, initial = (None, {}) if options.flight_path else (card.fly.outputs, card.fly.initial_state)
    if options.outputs is not None:
        names = options.outputs.split(",") if isinstance(options.outputs, str) else options.outputs
        outputs = tuple(dict.fromkeys(name.strip() for name in names))
    return Setting(outputs, None if options.initial_state == FREE else initial, options.priors, options.inputs == HELD)


def coefficient_fit(
    records: Sequence[FlightRecord], card: Card, options: FlyOptions, out: Path | None, progress: Progress | None
) -> tuple[MleResult | None, tuple[str, ...]]:
    """The fit of the coefficients, as `identify` does it, where they can be formed; what failed unexpectedly."""
    if options.flight_path or card.linear is not None:
        return None, ()
    if progress:
        progress("coefficients", 0.0)

    def fitted() -> MleResult | None:
        model, (without_spikes, _) = Model.from_card(card), repaired(records)
        try:
            found = fit_mle(model, observe(without_spikes, card, model), seed=options.seed)
            return without_noise_bias(found, without_spikes, card, model, seed=options.seed)
        except InputError:
            return None

    return attempted("The coefficients gave no first values", fitted, None, out, own=bool(card.effect_files))


def output_error_fit(
    flights: Flights,
    dynamics: Dynamics,
    card: Card,
    coefficients: MleResult | None,
    options: FlyOptions,
    progress: Progress | None,
) -> TrajectoryFit:
    """The card's model fitted to the trajectories, and in a band, as the options say.

    It starts from what the fit of the coefficients has found, too: a trajectory has optima far from the flight.
    """
    starts = []
    if coefficients is not None:
        near = dict(zip(coefficients.names, coefficients.estimate, strict=True))
        lower, upper = (np.array([p.bounds[i] for p in dynamics.free], float) for i in (0, 1))
        start = np.array([near.get(p.name, p.start) for p in dynamics.free])
        starts = [np.clip(start, lower, upper)] if np.all(np.isfinite(start)) else []
    found = fit_trajectories(
        flights,
        dynamics,
        {name: STANDARD_CHANNELS[name].unit for name in STANDARD_CHANNELS} | channel_units(card),
        starts=starts,
        window=options.windows,
        tolerances={name: tolerance.value for name, tolerance in card.tolerances.items()},
        biases={} if options.flight_path else card.output_biases,
        setting=setting_of(options, card),
        progress=progress,
    )
    if options.frequency is None:
        return found
    in_band, responses = linear_in_band(flights, dynamics, options.frequency)
    return replace(found, frequency=in_band, frequency_responses=responses)


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


def fly_identified(
    records: Sequence[FlightRecord], card: Card, model: Model, mle: MleResult, out: Path
) -> tuple[tuple[SimulatedManoeuvre, ...], tuple[str, ...], tuple[str, ...]]:
    """Every record from its measured initial state, notes and failures; nothing where a channel that drives it is
    missing, with a note that says so."""
    values, left_out = dict(zip(mle.names, map(float, mle.estimate), strict=True)), "The identified model was not flown"
    bands = {name: tolerance.value for name, tolerance in card.tolerances.items()}

    def flown() -> tuple[SimulatedManoeuvre, ...]:
        return fly_given(despiked(join(records, card, FLIGHT))[0], model, values, bands)

    try:
        paths, failures = attempted(left_out, flown, (), out, own=bool(card.effect_files))
    except InputError as error:
        return (), (f"{left_out}: {error}",), ()
    return paths, (), failures


# --- The fit with process noise beside output error, and its posterior.

Sampling = Callable[[str], dict[str, Posterior]]


def process_noise(
    flown: TrajectoryFit, options: FlyOptions, card: Card, out: Path | None, progress: Progress | None
) -> tuple[tuple[ProcessNoise | None, Sampling | None], tuple[str, ...]]:
    """The fit with process noise where it was asked for and output error has a result to start from; what samples its
    posterior where that was asked for and the fit has converged."""
    if not (options.process_noise and flown.converged):
        return (None, None), ()
    if progress:
        progress("process noise", 0.9)
    what, fit = "Process noise was not fitted", partial(with_process_noise, flown)
    found, failed = attempted(what, fit, None, out, own=bool(card.effect_files))
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
    """Pool the manoeuvres of a run, without the bias of sensor noise; `without_spikes` are its records as fitted."""
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
