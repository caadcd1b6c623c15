"""The jobs of `bayes-aero fly` and `path`: fits to trajectories by output error; numbers are on disk first."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np

from bayes_aero.diagnosis.consistency import in_gusts, no_flight_path
from bayes_aero.diagnosis.result import FITTED, Setting, TrajectoryFit
from bayes_aero.diagnosis.trajectories import (
    fit_disagreements,
    fit_trajectories,
    motion_of,
    still_apart,
    with_process_noise,
)
from bayes_aero.dynamics.flight import (
    DERIVED,
    Dynamics,
    aircraft_dynamics,
    linear_dynamics,
    path_dynamics,
    taken_as_zero,
)
from bayes_aero.errors import InputError, attempted
from bayes_aero.flight.card import Card, channel_units
from bayes_aero.flight.channel import STANDARD_CHANNELS
from bayes_aero.flight.health import only_following
from bayes_aero.flight.record import FlightRecord, is_file, write_record
from bayes_aero.inference.frequency import linear_in_band
from bayes_aero.inference.mle import fit_mle, without_noise_bias
from bayes_aero.inference.prediction_error import ENGINES
from bayes_aero.inference.results import MleResult, Posterior
from bayes_aero.jobs.check import record_checks, repaired, spike_notes, usable_for
from bayes_aero.jobs.options import FREE, HELD, FlyOptions, PathOptions, keywords
from bayes_aero.jobs.results import RESULTS, Flight, flights, fly_results, put_histories
from bayes_aero.jobs.store import (
    Growing,
    older_files,
    provenance,
    remove_older,
    safe_name,
    sha256_of,
    writable,
    write_json,
)
from bayes_aero.model.model import Model
from bayes_aero.model.observations import despiked, join, observe
from bayes_aero.model.records import Flights, on_recorded_axes
from bayes_aero.physics.aircraft import FLIGHT, OF_AXIS
from bayes_aero.physics.kinematics import PATH_CORE
from bayes_aero.progress import Progress, quiet
from bayes_aero.report.figures.every_figure import draw_all
from bayes_aero.report.figures.posterior import pair_of
from bayes_aero.report.figures.time_histories import fly_figures, gusts
from bayes_aero.report.page import put_page
from bayes_aero.report.pages import fly as text
from bayes_aero.report.pages import trajectories
from bayes_aero.report.pages.estimates import frequency_sentences, posterior_sentences
from bayes_aero.report.pages.fly import fly_page, motion_sentences, parameter_table
from bayes_aero.report.pages.parts import PageContext
from bayes_aero.report.pages.trajectories import gust_table, posterior_table
from bayes_aero.report.phrases import several
from bayes_aero.report.style import MOST_MANOEUVRES
from bayes_aero.report.table import write_csv
from bayes_aero.residuals.equation_error import lines_in

Sampling = Callable[[str], dict[str, Posterior]]  # draws by the name of the sampler


@keywords(FlyOptions)
def fly(
    records: Sequence[FlightRecord],
    card: Card,
    options: FlyOptions = FlyOptions(),
    *,
    out: Path | None = None,
    progress: Progress = quiet,
) -> Flight:
    """Fit the card's model to the trajectories of the records (output error), as `bayes-aero fly` does.

    A model of effects starts from the card's values and, if coefficients can be formed, also from their fit.

    Args:
        records: flights, fitted jointly.
        card: one with a model of effects or a linear one.
        options: the settings; instead of them their names may be given, e.g. `fly(records, card, windows=5.0)`.
        out: a folder for trajectories.json, parameters.csv, histories.nc, figures and report.html; None writes nothing.
        progress: called with a stage and the share of it that is done.

    Returns:
        The fit (`flown.fit` has estimates, standard errors and `det_R`) with its findings. SI and radians.

    Raises:
        InputError: the records cannot be simulated with the card, or a setting is unknown.

    Source:
        Jategaonkar, Flight Vehicle System Identification, 2nd ed. 2015, ch. 4.
    """
    older = {} if out is None else older_files(out, ("posterior_nuts.nc", "posterior_emcee.nc", "posterior.csv"))
    kept = fitted(records, card, options, out, progress)
    remove_older(older)
    kept.show(figures=options.figures, progress=progress)
    return kept.result


def fitted(
    records: Sequence[FlightRecord], card: Card, options: FlyOptions, out: Path | None, progress: Progress
) -> FlightStore:
    setting = setting_of(options, card)
    if options.frequency is not None:
        if card.linear is None:
            raise InputError(f"card {card.name} has a model of effects; use bayes-aero identify --frequency")
        for record in records:  # refuses a band in which it has no frequency
            lines_in(options.frequency, record.n, record.dt, record.name)
    card, left_out = on_recorded_axes(card, records, OF_AXIS, DERIVED)
    flights, dynamics, notes = flown_dynamics(records, card, setting.outputs or (), path=options.flight_path)
    if out is not None:
        writable(out)
    checks = record_checks(records, card, options.seed, out, progress=progress)
    undecided = options.process_noise is None
    met = in_gusts(records, card, options.seed) if undecided and checks.consistency.recorded else {}
    coefficients, failed, user_code = None, (), bool(card.effect_files)
    if not options.flight_path and card.linear is None:
        progress("coefficients", 0.0)
        what, fit = "The coefficients gave no first values", partial(coefficient_fit, records, card, options.seed)
        coefficients, failed = attempted(what, fit, None, out, user_code=user_code)
    flown = output_error_fit(flights, dynamics, card, coefficients, options, progress)
    flown = replace(flown, following=only_following(checks.health))
    apart = () if coefficients is None else fit_disagreements(coefficients, flown)
    disputed = undecided and not met and bool(apart)
    options = replace(options, process_noise=bool(options.process_noise or met or disputed))
    chosen = {} if setting.outputs is None else {"outputs": list(setting.outputs)}
    source = provenance(card, records, options.seed, options.settings | chosen, options)
    beside, sample, more = None, None, ()
    if options.process_noise and flown.converged:
        progress("process noise", 0.9)
        filtered, more = attempted(
            "Process noise was not fitted", lambda: with_process_noise(flown), None, out, user_code=user_code
        )
        beside, sample = filtered or (None, None)
    notes = [*left_out, *notes, *(line for fit in flown.frequency for line in frequency_sentences(fit))]
    if options.process_noise and not flown.converged:
        notes.append("Process noise was not fitted, because output error did not converge.")
    moves, unmoved = attempted("Modes of motion were not found", lambda: motion_of(flown, beside), None, out)
    hindered = usable_for(records, card).get("diagnose", "")  # why diagnose cannot use the records
    failed = (*checks.failures, *failed, *more, *unmoved)
    sentences = (
        *trajectories.gust_sentences(met, beside),
        *trajectories.settled_sentences(apart, beside, still_apart(apart, beside), disputed=disputed),
        *(() if beside is None else trajectories.process_noise_sentences(beside, flown)),
        *text.fly_sentences(flown, hindered, disturbed=bool(options.process_noise)),
        *text.disagreement_sentences(apart, hindered),
        *motion_sentences(moves),
    )
    kept = FlightStore(card, records, out, source)
    parts = (flown, sentences, tuple(notes), checks.health, checks.consistency, failed, apart, beside)
    kept.result = Flight(*parts, motion=moves)
    kept.keep()
    if sample is not None and beside is not None and options.posterior and beside.converged:
        kept.sample(partial(sample, options.seed, progress))
    return kept


class FlightStore(Growing[Flight]):
    def write(self, out: Path) -> None:
        flight = self.result
        write_csv(parameter_table(flight.flown), out / "parameters.csv")
        if flight.process_noise is not None and flight.process_noise.histories:
            write_csv(gust_table(flight.process_noise), out / "gusts.csv")
        if flight.posteriors:
            write_csv(posterior_table(flight.posteriors), out / "posterior.csv")
        write_json(fly_results(flight, self.card, self.records, self.source), out / RESULTS)

    def sample(self, sample: Sampling) -> None:
        begun, posteriors = self.result, {}
        for engine in ENGINES:
            new = self.attempt("The posterior was not sampled", partial(sample, engine), {})
            posteriors |= new
            for name, posterior in new.items():
                if self.out is not None:
                    posterior.save(self.out / f"posterior_{name}.nc")
            self.keep(posteriors=posteriors, sentences=(*begun.sentences, *posterior_sentences(posteriors)))

    def show(self, *, figures: bool, progress: Progress) -> None:
        """Histories, figures and page, and what could not be made of them."""
        flight, out = self.result, self.out
        if out is None:
            return
        together = [replace(path, split=FITTED) for path in flight.flown.paths]  # first values and fit side by side
        failed = put_histories(lambda: flights(together, flight.flown.units), out)
        drawn: list[Path] = []
        if figures:
            every: list[tuple[Any, Any]] = [(fly_figures(flight.flown), flight.flown)]
            every += [] if flight.process_noise is None else [({"gusts": gusts}, flight.process_noise)]
            every += [({"pair": pair_of}, flight.posteriors)] if flight.posteriors else []
            for number, (drawings, shown) in enumerate(every):
                paths, more = draw_all(drawings, shown, out / "figures", quiet if number else progress)
                drawn, failed = [*drawn, *paths], (*failed, *more)
        many = figures and len(self.records) > MOST_MANOEUVRES
        self.keep([f"Figures are drawn for up to {MOST_MANOEUVRES} manoeuvres."] if many else (), failed)
        progress("report", 0.95)
        context = PageContext(self.card, self.records, self.source, {path.stem: path for path in drawn}, self.result)
        self.fail(put_page(lambda: fly_page(flight.flown, context), out))


# --- The fits: coefficients, first values from them, output error.


def setting_of(options: FlyOptions, card: Card) -> Setting:
    outputs, initial = (None, {}) if options.flight_path else (card.fly.outputs, card.fly.initial_state)
    if options.outputs is not None:
        names = options.outputs.split(",") if isinstance(options.outputs, str) else options.outputs
        outputs = tuple(dict.fromkeys(name.strip() for name in names))
    return Setting(
        outputs,
        None if options.initial_state == FREE else initial,
        options.priors,
        options.inputs == HELD,
        options.windows,
        {} if options.flight_path else card.output_biases,
    )


def coefficient_fit(records: Sequence[FlightRecord], card: Card, seed: int) -> MleResult | None:
    model, (without_spikes, _) = Model.from_card(card), repaired(records)
    try:
        fit = fit_mle(model, observe(without_spikes, card, model), seed=seed)
        return without_noise_bias(fit, without_spikes, card, model, seed=seed)
    except InputError:
        return None


def output_error_fit(
    flights: Flights,
    dynamics: Dynamics,
    card: Card,
    coefficients: MleResult | None,
    options: FlyOptions,
    progress: Progress,
) -> TrajectoryFit:
    """From first values and from those of the coefficients, for a trajectory has optima far from the flight."""
    starts = []
    if coefficients is not None:
        near = dict(zip(coefficients.names, coefficients.estimate, strict=True))
        lower, upper = (np.array([p.bounds[i] for p in dynamics.free], float) for i in (0, 1))
        start = np.array([near.get(p.name, p.start) for p in dynamics.free])
        starts = [np.clip(start, lower, upper)] if np.all(np.isfinite(start)) else []
    fit = fit_trajectories(
        flights,
        dynamics,
        {name: STANDARD_CHANNELS[name].unit for name in STANDARD_CHANNELS} | channel_units(card),
        starts=starts,
        tolerances={name: tolerance.value for name, tolerance in card.tolerances.items()},
        setting=setting_of(options, card),
        progress=progress,
    )
    if options.frequency is None:
        return fit
    in_band, responses = linear_in_band(flights, dynamics, options.frequency)
    return replace(fit, frequency=in_band, frequency_responses=responses)


# --- What a record is flown by: the card's model of effects, its linear system, or its accelerations and rates.


def flown_dynamics(
    records: Sequence[FlightRecord], card: Card, outputs: Sequence[str], *, path: bool
) -> tuple[Flights, Dynamics, list[str]]:
    """Records end to end without spikes, what flies them (`path`: recorded accelerations and rates), and notes."""
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


# --- The flight path by itself: errors of sensors, and the records without them.

CORRECTED = "corrected"
WRITTEN, SCHEMA = "written.json", "bayes_aero/corrected/1"  # the files of the folder, with their hashes


@keywords(PathOptions)
def flight_path(
    records: Sequence[FlightRecord],
    card: Card,
    options: PathOptions = PathOptions(),
    *,
    out: Path | None = None,
    progress: Progress = quiet,
) -> Flight:
    """Reconstruct the flight path, as `bayes-aero path` does: errors of sensors by output error, without aerodynamics.

    Args:
        records: flights, fitted jointly; biases of accelerometers and gyros and the wind are each flight's own.
        card: says where the accelerometer is. Errors of sensors that it states keep their values.
        options: the settings; instead of them their names may be given, e.g. `process_noise=True`.
        out: a folder for trajectories.json, parameters.csv, figures, report.html and the corrected records; None writes
            nothing.
        progress: called with a stage and the share of it that is done.

    Returns:
        The fit with its findings. SI and radians.

    Raises:
        InputError: the flight path needs a channel that was not recorded.

    Source:
        Klein and Morelli, Aircraft System Identification, 2006, ch. 10.
    """
    targets = [] if out is None else corrected_files(records, out / CORRECTED)
    flight = fly(records, card, options.fly, out=out, progress=progress)
    if out is None:
        return flight
    folder = out / CORRECTED
    for left in written_before(folder):  # records of an earlier run are none of this one, whatever comes of it
        left.unlink()
    if flight.flown.converged and not flight.flown.worse:
        folder.mkdir(exist_ok=True)
        for record, target in zip(corrected_records(records, flight.flown), targets, strict=True):
            write_record(record, target, card.channels)
            files = {path.name: sha256_of(path) for path in targets if path.is_file()}
            write_json({"schema": SCHEMA, "files": files}, folder / WRITTEN)
    return flight


def corrected_files(records: Sequence[FlightRecord], folder: Path) -> list[Path]:
    """Where the corrected records go, a file each; `InputError` for one that this command did not write as it is."""
    written, targets = written_before(folder), []
    for record in records:
        name = safe_name(re.sub(r"[^\w.@+-]", "_", record.name))
        paths = (folder / f"{name}{'' if k == 1 else f'_{k}'}.csv" for k in count(1))
        path = next(path for path in paths if path not in targets)
        if path.exists() and path not in written:
            raise InputError(
                f"{path} is not as bayes-aero path wrote it, and would be replaced; move it, or give another --out"
            )
        targets.append(path)
    return targets


def written_before(folder: Path) -> list[Path]:
    """The files of an earlier run that are as it wrote them; all others are the user's."""
    try:
        files = dict(json.loads((folder / WRITTEN).read_text(encoding="utf-8"))["files"])
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return []
    there = {folder / Path(name).name: sha256 for name, sha256 in files.items()}
    return [path for path, sha256 in there.items() if is_file(path) and sha256_of(path) == sha256]


def corrected_records(records: Sequence[FlightRecord], flown: TrajectoryFit) -> list[FlightRecord]:
    """The records without the errors that were found: flow angles and accelerations as at the true sensors."""
    fit = flown.fit
    flights, dynamics = fit.flown.flights, fit.flown.dynamics
    true = dynamics.corrected(dynamics.values(fit.estimate), flights.channels, flights.aircraft)
    corrected, begin = [], 0
    for record, length in zip(records, flights.lengths, strict=True):
        part = slice(begin, begin + length)
        new = {n: np.asarray(x[part]) for n, x in true.items() if n in record.channels and x is not flights.channels[n]}
        corrected.append(replace(record, channels={**record.channels, **new}))
        begin += length
    return corrected
