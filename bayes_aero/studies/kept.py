"""What a diagnosis has found so far, on disk as soon as it is known, whichever thread found it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from threading import Lock
from typing import Any

from bayes_aero.criticism.finding import Diagnosis
from bayes_aero.criticism.trajectory import Trajectories
from bayes_aero.flight.agreement import Consistency
from bayes_aero.flight.card import Card
from bayes_aero.flight.health import HealthFinding
from bayes_aero.flight.record import FlightRecord
from bayes_aero.report.diagnosed import View
from bayes_aero.report.page import put_page
from bayes_aero.report.page_context import PageContext
from bayes_aero.report.page_diagnosis import diagnosis_page
from bayes_aero.report.tables import write_csv
from bayes_aero.report.words_diagnosis import causes_frame, revealed, screen_frame, sentences
from bayes_aero.studies.diagnosis_results import diagnosis_results
from bayes_aero.studies.histories import diagnosed, flights, put_histories
from bayes_aero.studies.provenance import write_json
from bayes_aero.studies.unfinished import NOTHING, RESTS_ON, RESULTS, Earlier

Hidden = Mapping[str, Mapping[str, float]]
"""True values of what simulated records hide, by effect."""


@dataclass(frozen=True)
class Outcome:
    """A diagnosis with what is shown of it; `named`: each hidden effect is first, named, ambiguous, minor or missed."""

    view: View
    hidden: Hidden | None
    named: Mapping[str, str]
    notes: tuple[str, ...]
    health: tuple[HealthFinding, ...] = ()
    consistency: Consistency | None = None

    @property
    def diagnosis(self) -> Diagnosis:
        """The finding itself."""
        return self.view.diagnosis


class Kept:
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
        if path is not None:
            write_csv(causes_frame(outcome.view), path / "causes.csv")
            write_csv(screen_frame(outcome.view), path / "screen.csv")
        self._write()
        self._put_histories()

    def has(self, stage: str) -> bool:
        """Whether `predictors`, `separating` or `trajectories` are there."""
        held = {"predictors": self._predictors, "separating": self._separating}
        return bool(held[stage]) if stage in held else self.outcome.view.trajectories is not None

    def trajectories(self, found: Trajectories) -> None:
        """Keep simulated trajectories."""
        self._grow(trajectories=found)

    def stalls(self, view: View) -> None:
        """Keep the stalls of a view of the same diagnosis."""
        self._grow(stalls=view.stalls)

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
        )
        failure = None if self.path is None else put_page(lambda: diagnosis_page(outcome.view, told), self.path)
        if failure:
            self.note(failure)

    def _grow(self, notes: Sequence[str] = (), **changes: Any) -> None:
        with self._lock:
            view = replace(self.outcome.view, **changes) if changes else self.outcome.view
            self.outcome = replace(self.outcome, view=view, notes=(*self.outcome.notes, *notes))
            self._write()
            if "trajectories" in changes:
                self._put_histories()

    def _put_histories(self) -> None:
        if self.path is None:
            return
        view = self.outcome.view
        flown = view.trajectories.paths if view.trajectories else ()
        failure = put_histories(
            lambda: {**diagnosed(view), **flights(flown)}, self.path, self._source.get(RESTS_ON, "")
        )
        if failure:
            self.outcome = replace(self.outcome, notes=(*self.outcome.notes, failure))
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
            agreement=self.outcome.consistency,
            health=self.outcome.health,
        )
        write_json(content, self.path / RESULTS)
