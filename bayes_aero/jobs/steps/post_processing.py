"""What follows a diagnosis while trajectories are flown: test points, sizes in a band, stalls, scores, figures."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import CancelledError, Executor, ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from threading import Event
from typing import Any, Generic, TypeVar

import numpy as np

from bayes_aero.diagnosis.design import next_test_points
from bayes_aero.diagnosis.in_band import causes_in_band
from bayes_aero.diagnosis.result import Diagnosis
from bayes_aero.diagnosis.trajectories.results import Trajectories
from bayes_aero.diagnosis.trajectories.trajectories import compare_trajectories
from bayes_aero.diagnosis.view.models import with_holdout_scores, with_stalls
from bayes_aero.diagnosis.view.results import View
from bayes_aero.dynamics.output_channels import FLIGHT
from bayes_aero.dynamics.simulated.manoeuvres import ANYWHERE
from bayes_aero.flight.aircraft import Envelope
from bayes_aero.flight.card.card import Card
from bayes_aero.flight.record import FlightRecord
from bayes_aero.jobs.io.result_store import ResultStore
from bayes_aero.jobs.provenance import picked
from bayes_aero.model.joined_channels import despiked, join
from bayes_aero.progress import Progress
from bayes_aero.report.figures.every_figure import ViewFigures, draw_all


def follow(
    kept: ResultStore, test_points: bool, figures: ViewFigures, tell: Progress, envelope: Envelope
) -> dict[str, Path]:
    """All that needs no trajectories, kept piece by piece; stalls and figures only where there is a folder for them.

    Returns the figures drawn, by name.
    """
    found = kept.outcome.diagnosis
    if test_points:
        what = "Test points that would decide what is open were not chosen"
        kept.attempt(what, lambda: kept.test_points(proposed_points(found, envelope)))
        kept.attempt("Causes were not fitted in a band of frequencies", lambda: kept.in_band(causes_in_band(found)))
    if kept.path is None:
        return {}
    view = kept.outcome.view
    if isinstance(view, View):
        tell("stall", 0.0)
        kept.attempt("Stall left out", lambda: kept.shown(with_stalls(view), "stalls"))
        what = "Manoeuvres were not scored one by one"
        kept.attempt(what, lambda: kept.shown(with_holdout_scores(view), "holdout"))
    return drawings(kept, figures, tell)


def drawings(kept: ResultStore, figures: ViewFigures, tell: Progress | None) -> dict[str, Path]:
    """Draw `figures` of what was found so far: paths by name; a note for each that failed."""
    view = kept.outcome.view
    if not figures or kept.path is None or not isinstance(view, View):
        return {}
    written, failed = draw_all(figures, view, kept.path / "figures", tell)
    kept.fail(failed)
    return {path.stem: path for path in written}


# --- What follows from a diagnosis: the flights that would settle what it left open, and simulated ones.

SETS = 2  # ambiguity sets for which the manoeuvres are judged


def proposed_points(diagnosis: Diagnosis, envelope: Envelope = ANYWHERE) -> dict[str, Any]:
    """The manoeuvres that decide all that the coefficients leave open, in the order of flying; empty if there is
    nothing to decide. Raises `InputError` if the model cannot be flown."""
    sets = open_sets(diagnosis)
    if not sets:
        return {}
    state = diagnosis.aerodynamics.state
    theta = state.theta.copy()
    for one in diagnosis.absorbed:  # at its usual value: as fitted, the control may do nothing
        theta[state.full.columns([one.parameter])] = one.usual[0]
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
    known = {c.name for c in diagnosis.causes if c.stage == "coefficients"}
    for pair in diagnosis.together:
        if set(pair.effects) <= known:  # at the least sizes worth modelling: the estimates mean nothing
            sets = {frozenset(pair.effects): {}} | sets
    sets = dict(list(sets.items())[:SETS])
    parameters = {p.name: e.name for e in candidates for p in e.parameters}
    for one in diagnosis.absorbed:
        sets.setdefault(one.members, {p: abs(one.sizes[e].mean) for p, e in parameters.items() if e in one.sizes})
    return sets


def simulations(
    diagnosis: Diagnosis, card: Card, records: Sequence[FlightRecord], seed: int, progress: Progress | None = None
) -> Trajectories:
    """Simulate the card's and the extended model with the records' inputs, fitted to all and on hold-out flights."""
    bands = {name: tolerance.value for name, tolerance in card.tolerances.items()}
    flights = despiked(join(records, card, FLIGHT))[0]
    return compare_trajectories(flights, diagnosis, bands, biases=card.output_biases, seed=seed, progress=progress)


# --- A job beside others: on the core that they leave free, and stopped when they are.

Result = TypeVar("Result")


class BackgroundJob(Generic[Result]):
    """A job that runs. Where it is will be shown from when it is waited for."""

    def __init__(self, pool: Executor, job: Callable[[Progress], Result], progress: Progress | None) -> None:
        self.stopped, self._waited = Event(), Event()

        def tell(text: str, share: float) -> None:
            if self.stopped.is_set():  # the job ends where it next tells where it is
                raise CancelledError
            if progress and self._waited.is_set():
                progress(text, share)

        self._running = pool.submit(job, tell)

    def result(self) -> Result:
        """What the job returns, or raises, once it has."""
        self._waited.set()
        return self._running.result()


@contextmanager
def in_background(
    job: Callable[[Progress], Result], progress: Progress | None = None
) -> Iterator[BackgroundJob[Result]]:
    """Run `job` in a thread of its own while the block lasts, and until it ends.

    The job is handed a function to be told where it is. There it ends if the block fails: Ctrl-C does not wait for its
    whole length.
    """
    with ThreadPoolExecutor(1) as pool:
        running = BackgroundJob(pool, job, progress)
        try:
            yield running
        except BaseException:
            running.stopped.set()
            raise
