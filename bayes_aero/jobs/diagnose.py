"""The diagnosis as a job: records in, what the model gets wrong out; numbers are on disk as soon as they are known."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from bayes_aero.diagnosis.consistency import errors_of_diagnosis
from bayes_aero.diagnosis.diagnose import diagnose, judged_on_held_out_flights, sensors_not_missed
from bayes_aero.diagnosis.result import TRAJECTORIES, Diagnosis
from bayes_aero.diagnosis.settings import DiagnosisSettings
from bayes_aero.diagnosis.trajectories.trajectories import with_tested
from bayes_aero.diagnosis.view.models import view_of
from bayes_aero.dynamics.simulated.trim import can_simulate
from bayes_aero.effect import Kind
from bayes_aero.effects import CATALOGUE
from bayes_aero.errors import InputError
from bayes_aero.flight.card.card import Card
from bayes_aero.flight.health.finding import only_following
from bayes_aero.flight.record import FlightRecord
from bayes_aero.inference.compiled_programs import blas_threads, cores
from bayes_aero.jobs.io.diagnosis_json import Hidden, Outcome
from bayes_aero.jobs.io.output_folder import writable
from bayes_aero.jobs.io.result_store import ResultStore
from bayes_aero.jobs.options import DiagnoseOptions
from bayes_aero.jobs.provenance import provenance
from bayes_aero.jobs.steps.post_processing import drawings, follow, in_background, simulations
from bayes_aero.jobs.steps.record_checks import record_checks
from bayes_aero.model.joined_records import on_recorded_axes
from bayes_aero.model.model import Model
from bayes_aero.progress import Progress
from bayes_aero.report.figures.every_figure import AFTER_TRAJECTORIES, DIAGNOSIS_FIGURES
from bayes_aero.simulate.injection import FLOWN_AXES, draw_hidden, flyable


def hide_one(card: Card, seed: int, **options: Any) -> tuple[Hidden, list[FlightRecord]]:
    """One effect that the card's model lacks, drawn at random, hidden in simulated manoeuvres."""
    Model.from_card(card)  # a card without effects says so before anything is flown
    rng = np.random.default_rng([seed, 4])
    names = [
        e.name
        for e in CATALOGUE.values()
        if e.candidate
        and e.acts_on(FLOWN_AXES)
        and can_simulate(e)
        and e.kind is not Kind.NOISE
        and draw_hidden(np.random.default_rng(0), e.name)
        and (e.name not in card.effects or e.absent_in(card.fixed))  # lacking, or held at neutral
    ]
    failure = InputError("no effect of the catalogue can be hidden")
    for name in rng.permutation(names)[:5]:
        try:
            effects, flights = flyable([str(name)], seed=seed, card=card, **options)
        except InputError as error:
            failure = error
            continue
        return effects, [flight.record for flight in flights]
    raise failure


def diagnose_records(
    records: Sequence[FlightRecord],
    card: Card,
    options: DiagnoseOptions = DiagnoseOptions(),
    *,
    out: Path | None = None,
    hidden: Hidden | None = None,
    progress: Progress | None = None,
) -> Outcome:
    """Diagnose, as `bayes-aero diagnose` does, by coefficients or, where an accelerometer is missing, by trajectories
    alone; with `out` it writes diagnosis.json, causes.csv, changes.csv, terms.csv, screen.csv,
    histories.nc, figures and report.html.

    A stage that fails is left out, and the reason is a note. `hidden` is what simulated records hide, for the
    comparison with what was found.
    """
    card, left_out = on_recorded_axes(card, records)
    if out is not None:
        writable(out)
    source = provenance(card, records, options.seed, options.settings, options)
    if progress:
        progress("do the sensors agree?", 0.0)
    settings, noise = DiagnosisSettings(max_effects=options.max_effects), options.process_noise
    found = diagnose(records, card, settings=settings, seed=options.seed, process_noise=noise, progress=progress)
    alone = not found.by_coefficients
    options = replace(options, test_points=options.test_points and not alone)
    known = None if alone else errors_of_diagnosis(found)
    checks = record_checks(records, card, options.seed, out, known=known)
    view = view_of(replace(found, following=only_following(checks.health)))
    named = {name: place_of(view.diagnosis, name) for name in hidden} if hidden else {}
    failed = (*checks.failures, *found.failures)
    outcome = Outcome(view, hidden, named, (), checks.health, checks.consistency, failed)
    kept = ResultStore(outcome, out, card, records, source)
    for sentence in left_out:
        kept.note(sentence)
    follow_up(kept, records, card, options, progress)
    return kept.outcome


def follow_up(
    kept: ResultStore, records: Sequence[FlightRecord], card: Card, options: DiagnoseOptions, progress: Progress | None
) -> None:
    """What follows the search for causes, the trajectories beside all the rest; then the page."""
    diagnosis = kept.outcome.diagnosis
    shown = DIAGNOSIS_FIGURES if options.figures else {}
    early, late = ({n: draw for n, draw in shown.items() if (n in AFTER_TRAJECTORIES) == x} for x in (False, True))
    with (
        blas_threads(0),
        in_background(partial(follow, kept, options.test_points, early, envelope=card.envelope), progress) as following,
    ):  # one limit: of two, the first to end would lift both
        if cores() == 1:
            following.result()
        if options.trajectories:
            kept.attempt(
                "Trajectories were not simulated",
                lambda: kept.trajectories(simulations(diagnosis, card, records, options.seed, progress)),
            )
        if diagnosis.compared == TRAJECTORIES:
            # By trajectories alone hold-out flights and the sensors' noise judge the causes.
            if (flown := kept.outcome.view.trajectories) is not None:
                held = {name for names in flown.held.values() for name in names}
                diagnosis = judged_on_held_out_flights(diagnosis, flown.asked, held)
            kept.judged(with_tested(diagnosis, flown, records, card))
            if not options.trajectories and diagnosis.causes:
                kept.note("Without trajectories no cause was tested on hold-out flights.")
        elif (flown := kept.outcome.view.trajectories) and (
            doubtful := sensors_not_missed(diagnosis, flown.asked)
        ).missed:
            kept.judged(judged_on_held_out_flights(diagnosis, doubtful))
        drawn = following.result()
    if kept.path is not None:
        drawn |= drawings(kept, late, progress)
        if progress:
            progress("report", 0.0)
        kept.put_page(drawn)


def place_of(diagnosis: Diagnosis, name: str) -> str:
    """Where a hidden effect is in a diagnosis: first, named, ambiguous, minor or missed."""
    names = [c.name for c in diagnosis.causes]
    if name in names:
        return "first" if names[0] == name else "named"
    if any(name in c.ambiguous_with for c in diagnosis.causes):
        return "ambiguous"
    return "minor" if name in diagnosis.minor else "missed"
