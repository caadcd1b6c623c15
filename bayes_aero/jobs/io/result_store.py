"""What a diagnosis has found so far, on disk as soon as it is known, whichever thread found it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from threading import Lock
from typing import Any

from bayes_aero.diagnosis.result import Diagnosis
from bayes_aero.diagnosis.trajectories.results import Trajectories
from bayes_aero.diagnosis.view.results import DiagnosisView, View
from bayes_aero.errors import InputError, attempted
from bayes_aero.flight.agreement import Consistency
from bayes_aero.flight.card.card import Card
from bayes_aero.flight.health import HealthFinding
from bayes_aero.flight.record import FlightRecord
from bayes_aero.jobs.io.diagnosis_json import diagnosis_results
from bayes_aero.jobs.io.resume import NOTHING, RESTS_ON, RESULTS, Earlier
from bayes_aero.jobs.io.time_histories import diagnosed, flights, put_histories
from bayes_aero.jobs.provenance.provenance import write_json
from bayes_aero.report.html.page import put_page
from bayes_aero.report.page_context import PageContext
from bayes_aero.report.pages.diagnosis import diagnosis_page
from bayes_aero.report.tables.diagnosis_tables import causes_frame, screen_frame
from bayes_aero.report.tables.run_tables import write_csv
from bayes_aero.report.text.diagnosis import revealed, sentences

Hidden = Mapping[str, Mapping[str, float]]
"""True values of what simulated records hide, by effect."""


@dataclass(frozen=True)
class Outcome:
    """A diagnosis with what is shown of it; `named`: each hidden effect is first, named, ambiguous, minor or missed."""

    view: DiagnosisView
    hidden: Hidden | None
    named: Mapping[str, str]
    notes: tuple[str, ...]
    health: tuple[HealthFinding, ...] = ()
    consistency: Consistency | None = None
    failures: tuple[str, ...] = ()  # parts that failed unexpectedly

    @property
    def diagnosis(self) -> Diagnosis:
        """The finding itself."""
        return self.view.diagnosis


class ResultStore:
    """An outcome that grows, and diagnosis.json with it; `path` is the folder, if there is one.

    What an interrupted run had found (`earlier`) is there from the beginning.
    """

    def __init__(
        self,
        outcome: Outcome,
        path: Path | None,
        card: Card,
        records: Sequence[FlightRecord],
        source: Mapping[str, Any],
        earlier: Earlier = NOTHING,
    ) -> None:
        self.outcome = replace(outcome, view=replace(outcome.view, trajectories=earlier.trajectories))
        self.path = path
        self._card, self._records, self._source, self._lock = card, records, source, Lock()
        self._predictors, self._separating = earlier.predictors, earlier.separating
        self._put_tables()
        self._write()
        self._put_histories()

    def has(self, stage: str) -> bool:
        """Whether `predictors`, `separating` or `trajectories` are there."""
        held = {"predictors": self._predictors, "separating": self._separating}
        return bool(held[stage]) if stage in held else self.outcome.view.trajectories is not None

    def trajectories(self, found: Trajectories) -> None:
        """Keep simulated trajectories."""
        self._grow(trajectories=found)

    def judged(self, found: Diagnosis) -> None:
        """Keep the diagnosis with what hold-out flights say of its causes."""
        self._grow(diagnosis=found)
        self._put_tables()

    def stalls(self, view: View) -> None:
        """Keep the stalls of a view of the same diagnosis."""
        self._grow(stalls=view.stalls)

    def holdout(self, view: View) -> None:
        """Keep the scores by manoeuvre of a view of the same diagnosis."""
        self._grow(holdout=view.holdout)

    def predictors(self, found: Mapping[str, Any]) -> None:
        """Keep a comparison of predictors."""
        self._predictors = found
        self._grow()

    def separating(self, found: Sequence[Mapping[str, Any]]) -> None:
        """Keep the manoeuvres that would separate."""
        self._separating = found
        self._grow()

    def note(self, *notes: str) -> None:
        """Keep what was left out, and why."""
        self._grow(notes)

    def attempt(self, what: str, do: Callable[[], None]) -> None:
        """Do what may fail: for bad input it is left out and noted, and anything else is a failure.

        Args:
            what: that it was not done, the beginning of the sentence on why.
            do: what keeps its own results.
        """
        try:
            _, failed = attempted(what, do, None, self.path, own=bool(self._card.effect_files))
        except InputError as error:
            self.note(f"{what}: {error}")
        else:
            self.fail(failed)

    def fail(self, failures: Sequence[str]) -> None:
        """Keep what failed unexpectedly; none is nothing."""
        if failures:
            self._grow(failures=failures)

    def put_page(self, drawn: Mapping[str, Path]) -> None:
        """report.html with the figures `drawn`; a note says why if there is none."""
        outcome = self.outcome
        told = PageContext(
            self._card,
            self._records,
            self._source,
            drawn,
            self._predictors,
            self._separating,
            revealed(outcome.hidden, outcome.named) if outcome.hidden else (),
            outcome.notes,
            outcome.consistency,
            outcome.failures,
            outcome.health,
        )
        self.fail(() if self.path is None else put_page(lambda: diagnosis_page(outcome.view, told), self.path))

    def _grow(self, notes: Sequence[str] = (), failures: Sequence[str] = (), **changes: Any) -> None:
        with self._lock:
            o = self.outcome
            view = replace(o.view, **changes) if changes else o.view
            self.outcome = replace(o, view=view, notes=(*o.notes, *notes), failures=(*o.failures, *failures))
            self._write()
            if "trajectories" in changes:
                self._put_histories()

    def _put_tables(self) -> None:
        if self.path is not None:
            write_csv(causes_frame(self.outcome.view), self.path / "causes.csv")
            write_csv(screen_frame(self.outcome.view), self.path / "screen.csv")

    def _put_histories(self) -> None:
        if self.path is None:
            return
        view = self.outcome.view
        flown = view.trajectories.paths if view.trajectories else ()
        failed = put_histories(
            lambda: {**(diagnosed(view) if isinstance(view, View) else {}), **flights(flown)},
            self.path,
            self._source.get(RESTS_ON, ""),
        )
        if failed:
            self.outcome = replace(self.outcome, failures=(*self.outcome.failures, *failed))
            self._write()

    def _write(self) -> None:
        if self.path is None:
            return
        hidden, named = self.outcome.hidden, self.outcome.named
        content = diagnosis_results(
            self.outcome.view,
            self._card,
            self._records,
            self._source,
            sentences=sentences(self.outcome.view),
            predictors=self._predictors,
            separating=self._separating,
            hidden=None if hidden is None else {"effects": hidden, "named": named},
            notes=self.outcome.notes,
            failures=self.outcome.failures,
            agreement=self.outcome.consistency,
            health=self.outcome.health,
        )
        write_json(content, self.path / RESULTS)
