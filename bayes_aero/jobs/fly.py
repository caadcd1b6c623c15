"""The job of `bayes-aero fly`: parameters fitted to trajectories by output error; numbers are on disk first."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from bayes_aero.diagnosis.consistency import in_gusts
from bayes_aero.diagnosis.trajectories.motion import motion_of
from bayes_aero.diagnosis.trajectories.results import FITTED, ProcessNoise, Setting, TrajectoryFit
from bayes_aero.diagnosis.trajectories.trajectories import WINDOW, fit_disagreements, still_apart
from bayes_aero.dynamics.flight import DERIVED
from bayes_aero.dynamics.output_channels import OF_AXIS
from bayes_aero.errors import attempted
from bayes_aero.flight.card.card import Card
from bayes_aero.flight.health.finding import only_following
from bayes_aero.flight.record import FlightRecord
from bayes_aero.inference.frequency import linear_in_band
from bayes_aero.jobs.io.fly_json import RESULTS, Flight, fly_results
from bayes_aero.jobs.io.output_folder import writable
from bayes_aero.jobs.io.time_histories import flights, put_histories
from bayes_aero.jobs.options import FREE, LINEAR, FlyOptions, check_band
from bayes_aero.jobs.provenance import provenance, write_json
from bayes_aero.jobs.steps.flights import (
    coefficient_fit,
    flown_dynamics,
    output_error_fit,
    process_noise,
    starts_of,
    with_posterior,
)
from bayes_aero.jobs.steps.record_checks import record_checks, usable_for
from bayes_aero.model.joined_records import on_recorded_axes
from bayes_aero.progress import Progress
from bayes_aero.report.figures.every_figure import draw_all
from bayes_aero.report.figures.posterior import one_step_quantiles, pair_of
from bayes_aero.report.figures.time_histories import fly_figures, gusts
from bayes_aero.report.frequency import FREQUENCY_FIGURES, frequency_sentences
from bayes_aero.report.html.page import put_page
from bayes_aero.report.motion import motion_sentences
from bayes_aero.report.pages.fly import FlyContext, fly_page
from bayes_aero.report.style import MOST_MANOEUVRES
from bayes_aero.report.tables.fly import gust_table, parameter_table, posterior_table
from bayes_aero.report.tables.table import write_csv
from bayes_aero.report.text.fly import (
    disagreement_sentences,
    fly_sentences,
    gust_sentences,
    process_noise_sentences,
    settled_sentences,
)

DISTURBED = {"gusts": gusts, "one_step": one_step_quantiles}


def fly(
    records: Sequence[FlightRecord],
    card: Card,
    *,
    out: Path | None = None,
    windows: float = WINDOW,
    initial_state: str = FREE,
    priors: bool = True,
    outputs: str | Sequence[str] | None = None,
    inputs: str = LINEAR,
    seed: int = 0,
    figures: bool = True,
    process_noise: bool | None = None,
    posterior: bool = False,
    frequency: tuple[float, float] | None = None,
    progress: Progress | None = None,
) -> Flight:
    """Fit the card's model to the trajectories of the records (output error), as `bayes-aero fly` does.

    A model of effects starts from the card's values and, if coefficients can be formed, also from their fit.

    Args:
        records: flights, fitted jointly.
        card: one with a model of effects or a linear one.
        out: a folder for trajectories.json, parameters.csv, histories.nc, figures and report.html; None writes nothing.
        windows: length in s of the windows that are fitted before whole manoeuvres.
        initial_state: "free", fitted for each manoeuvre, or "fixed": the card's ([fly] initial_state), and where it
            names none the first sample.
        priors: False omits all priors from the reported fit, including those of free initial states.
        outputs: names of the outputs that are compared, a list or separated by commas; default: the card's ([fly]
            outputs), and without these all recorded ones but altitude and q_dot.
        inputs: "linear" between samples, or "held" until the next one.
        seed: of the fit of the coefficients.
        figures: False draws none.
        process_noise: True fits the same model with process noise, too, by an extended Kalman filter; None: if the
            flight path of a record shows gusts, or if output error and the coefficients disagree.
        posterior: True also samples the posterior of the fit with process noise, by emcee and NUTS.
        frequency: lowest and highest frequency, Hz, of a band in which a linear card is fitted, too, by equation error
            and output error.
        progress: called with a stage and the share of it that is done.

    Returns:
        The fit (`flown.fit` has estimates, standard errors and `det_R`) with its findings. SI and radians.

    Raises:
        InputError: the records cannot be simulated with the card, or a setting is unknown.

    Source:
        Jategaonkar, Flight Vehicle System Identification, 2nd ed. 2015, ch. 4.
    """
    chosen = (windows, initial_state, priors, outputs, inputs, seed, figures, process_noise, posterior)
    options = FlyOptions(*chosen, frequency=frequency)
    return fly_records(records, card, options, out=out, progress=progress)


def fly_records(
    records: Sequence[FlightRecord],
    card: Card,
    options: FlyOptions = FlyOptions(),
    *,
    out: Path | None = None,
    progress: Progress | None = None,
) -> Flight:
    """`fly` with its options in one."""
    setting, seed = options.setting(card), options.seed
    check_band(options.frequency, records, card, flown=True)
    card, left_out = on_recorded_axes(card, records, OF_AXIS, DERIVED)
    flights, dynamics, notes = flown_dynamics(records, card, setting.outputs or (), path=options.flight_path)
    notes = [*left_out, *notes]
    if out is not None:
        writable(out)
    if progress:
        progress("do the sensors agree?", 0.0)
    checks = record_checks(records, card, seed, out)
    asked = options.process_noise is None and not options.filtered
    gusts = in_gusts(records, card, seed) if asked and checks.consistency.recorded else {}
    if gusts:
        options = replace(options, process_noise=True)
    coefficients, failed = attempted(
        "The coefficients gave no first values",
        lambda: None if options.flight_path else coefficient_fit(records, card, seed, progress),
        None,
        out,
        own=bool(card.effect_files),
    )
    starts = starts_of(coefficients, dynamics)
    flown = output_error_fit(flights, dynamics, card, starts, options, progress)
    flown = replace(flown, following=only_following(checks.health))
    if options.frequency is not None:
        in_band, responses = linear_in_band(flights, dynamics, options.frequency)
        flown = replace(flown, frequency=in_band, frequency_responses=responses)
        notes += [said for fit in flown.frequency for said in frequency_sentences(fit)]
    apart = () if coefficients is None else fit_disagreements(coefficients, flown)
    disputed = asked and not gusts and bool(apart)
    options = replace(options, process_noise=options.filtered or disputed)
    source = provenance(card, records, seed, _told(options, setting), options)
    (beside, sample), more = process_noise(flown, options, card, out, progress)
    if options.filtered and not flown.converged:
        notes.append("Process noise was not fitted, because output error did not converge.")
    moves, unmoved = attempted("Modes of motion were not found", lambda: motion_of(flown, beside), None, out)
    hindered = usable_for(records, card).get("diagnose", "")
    plain = fly_sentences(flown, hindered, disturbed=options.filtered)
    decided = settled_sentences(apart, beside, still_apart(apart, beside), asked=disputed)
    filtered = (*gust_sentences(gusts, beside), *decided, *_filtered(beside, flown))
    said = (*filtered, *plain, *disagreement_sentences(apart, hindered), *motion_sentences(moves))
    failed = (*checks.failures, *failed, *more, *unmoved)
    found = Flight(flown, said, tuple(notes), checks.health, checks.consistency, failed, apart, beside, motion=moves)

    def put(found: Flight) -> None:
        if out is not None:
            _put_numbers(found, out)
            write_json(fly_results(found, card, records, source), out / RESULTS)

    if sample is not None:
        found = with_posterior(found, sample, card, out, put)
    if out is None:
        return found
    return _written(found, card, records, source, out, figures=options.figures, progress=progress)


def _filtered(beside: ProcessNoise | None, flown: TrajectoryFit) -> tuple[str, ...]:
    """What the fit with process noise says; nothing without one."""
    return () if beside is None else tuple(process_noise_sentences(beside, flown))


def _told(options: FlyOptions, setting: Setting) -> dict[str, Any]:
    """The settings by the names of the options; `outputs` only where they were chosen."""
    chosen = {} if setting.outputs is None else {"outputs": list(setting.outputs)}
    chosen |= {"frequency": list(options.frequency)} if options.frequency is not None else {}
    names = ("windows", "initial_state", "priors", "inputs", "posterior")
    return {name: getattr(options, name) for name in names} | {"process_noise": options.filtered} | chosen


def _written(
    found: Flight,
    card: Card,
    records: Sequence[FlightRecord],
    source: dict[str, Any],
    out: Path,
    *,
    figures: bool,
    progress: Progress | None,
) -> Flight:
    """Numbers first; what cannot be drawn or shown after them is a note, and the numbers are written again with it."""

    def noted(said: Sequence[str], failures: Sequence[str]) -> Flight:
        more = replace(found, notes=(*found.notes, *said), failures=(*found.failures, *failures))
        write_json(fly_results(more, card, records, source), out / RESULTS)
        return more

    _put_numbers(found, out)
    together = [replace(path, split=FITTED) for path in found.flown.paths]  # first values and fit side by side
    found = noted((), ())
    failed = put_histories(lambda: flights(together, found.flown.units), out)
    found = noted((), failed) if failed else found
    drawn: list[Path] = []
    if figures:
        drawings = fly_figures(found.flown) | FREQUENCY_FIGURES
        drawn, failed = draw_all(drawings, found.flown, out / "figures", progress)
        if found.process_noise is not None:
            met, more = draw_all(DISTURBED, found.process_noise, out / "figures")
            drawn, failed = [*drawn, *met], (*failed, *more)
        if found.posteriors:
            pairs, more = draw_all({"pair": pair_of}, found.posteriors, out / "figures")
            drawn, failed = [*drawn, *pairs], (*failed, *more)
        many = len(records) > MOST_MANOEUVRES
        said = [f"Figures are drawn for up to {MOST_MANOEUVRES} manoeuvres."] if many else []
        found = noted(said, failed) if said or failed else found
    if progress:
        progress("report", 0.95)
    shown = {path.stem: path for path in drawn}
    context = FlyContext(
        card,
        records,
        source,
        found.sentences,
        found.notes,
        shown,
        found.consistency,
        found.failures,
        found.health,
        found.process_noise,
        found.posteriors,
        found.motion,
    )
    failed = put_page(lambda: fly_page(found.flown, context), out)
    return noted((), failed) if failed else found


def _put_numbers(found: Flight, out: Path) -> None:
    """Tables, and a file of each sampler; posteriors that an earlier run has left there go."""
    write_csv(parameter_table(found.flown), out / "parameters.csv")
    if found.process_noise is not None and found.process_noise.histories:
        write_csv(gust_table(found.process_noise), out / "gusts.csv")
    for engine in ("nuts", "emcee"):
        (out / f"posterior_{engine}.nc").unlink(missing_ok=True)
    (out / "posterior.csv").unlink(missing_ok=True)
    for engine, posterior in found.posteriors.items():
        posterior.save(out / f"posterior_{engine}.nc")
    if found.posteriors:
        write_csv(posterior_table(found.posteriors), out / "posterior.csv")
