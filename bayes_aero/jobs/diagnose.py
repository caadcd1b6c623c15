"""The diagnosis as a job: records in, what the model gets wrong out; numbers are on disk as soon as they are known."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import CancelledError, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from threading import Event
from typing import Any, TypeVar

import numpy as np

from bayes_aero.diagnosis.consistency import errors_of_diagnosis
from bayes_aero.diagnosis.design import next_test_points
from bayes_aero.diagnosis.diagnose import (
    causes_in_band,
    diagnose,
    judged_on_held_out_flights,
    sensors_not_missed,
    view_of,
    with_holdout_scores,
    with_stalls,
)
from bayes_aero.diagnosis.result import TRAJECTORIES, Diagnosis, Trajectories, View
from bayes_aero.diagnosis.selection_state import DiagnosisSettings
from bayes_aero.diagnosis.trajectories import beyond_noise, compare_trajectories
from bayes_aero.dynamics.pilot import ANYWHERE
from bayes_aero.dynamics.trim import can_simulate
from bayes_aero.effect import Kind
from bayes_aero.effects import CATALOGUE
from bayes_aero.errors import InputError
from bayes_aero.flight.card import Card
from bayes_aero.flight.health import Consistency, only_following
from bayes_aero.flight.record import FlightRecord
from bayes_aero.jobs.check import RecordChecks, record_checks
from bayes_aero.jobs.options import DiagnoseOptions
from bayes_aero.jobs.results import Hidden, Outcome, diagnosed, diagnosis_results, flights, put_histories
from bayes_aero.jobs.store import Growing, picked, provenance, writable, write_json
from bayes_aero.model.model import Model
from bayes_aero.model.observations import despiked, join
from bayes_aero.model.records import on_recorded_axes
from bayes_aero.physics.aircraft import FLIGHT, Envelope
from bayes_aero.processes import blas_threads, cores
from bayes_aero.progress import Progress, quiet
from bayes_aero.report.figures.every_figure import DIAGNOSIS_FIGURES, draw_all
from bayes_aero.report.page import put_page
from bayes_aero.report.pages.diagnosis import causes_table, changes_table, diagnosis_page, screen_table, terms_table
from bayes_aero.report.pages.parts import PageContext
from bayes_aero.report.pages.qualification import points_table
from bayes_aero.report.table import write_csv
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
    progress: Progress = quiet,
    answer: Callable[[RecordChecks | Outcome], None] = lambda _: None,
) -> Outcome:
    """Diagnose, as `bayes-aero diagnose` does; `hidden` is what simulated records hide. `answer` is given what the
    records are worth as soon as the errors of their sensors are known, then the outcome with the causes; trajectories,
    figures and the page follow."""
    card, left_out = on_recorded_axes(card, records)
    if out is not None:
        writable(out)
    kept = ResultStore(card, records, out, provenance(card, records, options.seed, options.settings, options))
    progress("do the sensors agree?", 0.0)
    settings = DiagnosisSettings(**picked(options, "max_effects", "process_noise", "anyway"))
    of, before = (records, card, options.seed, out), list[Consistency]()

    def told(report: Consistency) -> None:
        before.append(report)
        answer(record_checks(*of, before=report))

    diagnosis = diagnose(records, card, settings=settings, seed=options.seed, progress=progress, checked=told)
    options = replace(options, test_points=options.test_points and diagnosis.by_coefficients)
    if diagnosis.unreliable:
        options = replace(options, test_points=False, trajectories=False)
    errors = errors_of_diagnosis(diagnosis) if diagnosis.by_coefficients else None
    checks = record_checks(*of, errors=errors, before=next(iter(before), None))
    view = view_of(replace(diagnosis, following=only_following(checks.health)))
    named = {name: place_of(view.diagnosis, name) for name in hidden} if hidden else {}
    failed = (*checks.failures, *diagnosis.failures)
    kept.result = Outcome(view, hidden, named, (), checks.health, checks.consistency, failed)
    kept.keep(left_out, view={"diagnosis": view.diagnosis, "trajectories": view.trajectories})
    answer(kept.result)
    follow_up(kept, records, card, options, progress)
    return kept.result


def follow_up(
    kept: ResultStore, records: Sequence[FlightRecord], card: Card, options: DiagnoseOptions, progress: Progress
) -> None:
    """What follows the search for causes, the trajectories beside all the rest; then the page."""
    diagnosis, attempt = kept.result.diagnosis, partial(kept.attempt, bad="{}: {}")
    with (
        blas_threads(0),
        in_background(partial(follow, kept, options.test_points, card.envelope), progress) as following,
    ):  # one limit: of two, the first to end would lift both
        if cores() == 1:
            following()
        if options.trajectories:
            fly = partial(simulations, diagnosis, card, records, options.seed, progress)
            attempt("Trajectories were not simulated", lambda: kept.keep(view={"trajectories": fly()}))
        if diagnosis.compared == TRAJECTORIES:
            # By trajectories alone hold-out flights and the sensors' noise judge the causes.
            if (flown := kept.result.view.trajectories) is not None:
                held = {name for names in flown.held.values() for name in names}
                diagnosis = judged_on_held_out_flights(diagnosis, flown.asked, held)
            kept.keep(view={"diagnosis": diagnosis.judged(tested=beyond_noise(flown, records, card))})
            if not options.trajectories and diagnosis.causes:
                kept.keep(["Without trajectories no cause was tested on hold-out flights."])
        elif (flown := kept.result.view.trajectories) and (doubt := sensors_not_missed(diagnosis, flown.asked)).missed:
            kept.keep(view={"diagnosis": judged_on_held_out_flights(diagnosis, doubt)})
        following()
    if kept.out is not None:
        view, written = kept.result.view, []
        if options.figures and isinstance(view, View):
            written, failed = draw_all(DIAGNOSIS_FIGURES, view, kept.out / "figures", progress)
            kept.fail(failed)
        progress("report", 0.0)
        context = PageContext(card, records, kept.source, {path.stem: path for path in written}, kept.result)
        kept.fail(put_page(lambda: diagnosis_page(kept.result.view, context), kept.out))


def place_of(diagnosis: Diagnosis, name: str) -> str:
    names = [c.name for c in diagnosis.causes]
    if name in names:
        return "first" if names[0] == name else "named"
    if any(name in c.ambiguous_with for c in diagnosis.causes):
        return "ambiguous"
    return "minor" if name in diagnosis.minor else "missed"


class ResultStore(Growing[Outcome]):
    def write(self, out: Path) -> None:
        write_json(diagnosis_results(self.result, self.card, self.records, self.source), out / "diagnosis.json")

    def keep(
        self,
        notes: Sequence[str] = (),
        failures: Sequence[str] = (),
        view: Mapping[str, Any] | None = None,
        **changes: Any,
    ) -> None:
        with self.lock:
            seen = replace(self.result.view, **view) if view else self.result.view
            super().keep(notes, failures, view=seen, **changes)
        if self.out is None:
            return
        if changes.get("test_points", {}).get("points"):
            write_csv(points_table(changes["test_points"]), self.out / "test_points.csv")
        if view and "diagnosis" in view:
            d = view["diagnosis"]
            tables = {"causes": causes_table(d), "changes": changes_table(d), "terms": terms_table(d)}
            for name, table in (tables | {"screen": screen_table(seen.rankings, d)}).items():
                write_csv(table, self.out / f"{name}.csv")
        if view and "trajectories" in view:
            flown = seen.trajectories.paths if seen.trajectories else ()
            by_coefficients = partial(diagnosed, seen) if isinstance(seen, View) else dict
            self.fail(put_histories(lambda: {**by_coefficients(), **flights(flown)}, self.out))


# --- What follows a diagnosis while trajectories are flown: test points, sizes in a band, stalls, scores.


def follow(kept: ResultStore, test_points: bool, envelope: Envelope, tell: Progress) -> None:
    """All that needs no trajectories, kept piece by piece."""
    diagnosis, attempt = kept.result.diagnosis, partial(kept.attempt, bad="{}: {}")
    if test_points:
        what = "Test points that would decide what is open were not chosen"
        attempt(what, lambda: kept.keep(test_points=proposed_points(diagnosis, envelope)))
        attempt("Causes were not fitted in a band of frequencies", lambda: kept.keep(in_band=causes_in_band(diagnosis)))
    view = kept.result.view
    if kept.out is not None and isinstance(view, View):
        tell("stall", 0.0)
        attempt("Stall left out", lambda: kept.keep(view={"stalls": with_stalls(view).stalls}))
        what = "Manoeuvres were not scored one by one"
        attempt(what, lambda: kept.keep(view={"holdout": with_holdout_scores(view).holdout}))


# --- What follows from a diagnosis: the flights that would settle what it left open, and simulated ones.

SETS = 2  # ambiguity sets for which the manoeuvres are judged


def proposed_points(diagnosis: Diagnosis, envelope: Envelope = ANYWHERE) -> dict[str, Any]:
    """The manoeuvres that decide what the coefficients leave open, in the order of flying; empty where nothing is."""
    sets = open_sets(diagnosis)
    if not sets:
        return {}
    state = diagnosis.aerodynamics.state
    theta = state.theta.copy()
    for absorbed in diagnosis.absorbed:  # at its usual value: as fitted, the control may do nothing
        theta[state.full.columns([absorbed.parameter])] = absorbed.usual[0]
    points = next_test_points(state, sets, envelope, theta)
    rows = ("manoeuvre", "amplitude", "airspeed", "altitude", "seconds", "excursion")
    return {
        "questions": [
            picked(q, "effects", "enough") | {"present": present}
            for q, present in zip(points.questions, points.present, strict=True)
        ],
        "points": [picked(p, *rows, "standard_errors=expected", "nats_per_second=rate") for p in points.points],
        "refused": points.refused,
        "envelope": {name: [None if np.isinf(x) else x for x in pair] for name, pair in envelope.ranges.items()},
        "stated": list(envelope.stated),
    }


def open_sets(diagnosis: Diagnosis) -> dict[frozenset[str], dict[str, float]]:
    """What the coefficients leave open: effects, and the sizes of their parameters."""
    candidates = diagnosis.aerodynamics.state.full.candidates
    sets: dict[frozenset[str], dict[str, float]] = {}
    effects = {e.name for e in candidates}
    for cause in diagnosis.causes:
        members = frozenset({cause.name, *effects.intersection(cause.ambiguous_with)})  # a form cannot be flown
        if len(members) > 1 and cause.stage == "coefficients":
            sets.setdefault(members, {name: abs(size.mean) for name, size in cause.parameters.items()})
    causes = {c.name for c in diagnosis.causes if c.stage == "coefficients"}
    for pair in diagnosis.together:
        if set(pair.effects) <= causes:  # at the least sizes worth modelling: the estimates mean nothing
            sets = {frozenset(pair.effects): {}} | sets
    sets = dict(list(sets.items())[:SETS])
    parameters = {p.name: e.name for e in candidates for p in e.parameters}
    for entry in diagnosis.absorbed:
        sets.setdefault(entry.members, {p: abs(entry.sizes[e].mean) for p, e in parameters.items() if e in entry.sizes})
    return sets


def simulations(
    diagnosis: Diagnosis, card: Card, records: Sequence[FlightRecord], seed: int, progress: Progress = quiet
) -> Trajectories:
    bands = {name: tolerance.value for name, tolerance in card.tolerances.items()}
    flights = despiked(join(records, card, FLIGHT))[0]
    return compare_trajectories(flights, diagnosis, bands, biases=card.output_biases, seed=seed, progress=progress)


# --- A job beside others: on the core that they leave free, and stopped when they are.

Result = TypeVar("Result")


@contextmanager
def in_background(job: Callable[[Progress], Result], progress: Progress = quiet) -> Iterator[Callable[[], Result]]:
    """Run `job` in a thread while the block lasts; what it yields waits for its result. A block that fails ends it."""
    stopped, waited = Event(), Event()

    def tell(text: str, share: float) -> None:
        if stopped.is_set():
            raise CancelledError
        if waited.is_set():
            progress(text, share)

    with ThreadPoolExecutor(1) as pool:
        running = pool.submit(job, tell)

        def result() -> Result:
            waited.set()
            return running.result()

        try:
            yield result
        except BaseException:
            stopped.set()
            raise
