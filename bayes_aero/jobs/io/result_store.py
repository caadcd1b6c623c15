"""What a diagnosis has found so far, on disk as soon as it is known, whichever thread found it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from threading import Lock
from typing import Any

from bayes_aero.diagnosis.result import CausesInBand, Diagnosis
from bayes_aero.diagnosis.trajectories.results import Trajectories
from bayes_aero.diagnosis.view.results import View
from bayes_aero.errors import InputError, attempted
from bayes_aero.flight.card.card import Card
from bayes_aero.flight.record import FlightRecord
from bayes_aero.jobs.io.diagnosis_json import Outcome, diagnosis_results
from bayes_aero.jobs.io.time_histories import diagnosed, flights, put_histories
from bayes_aero.jobs.provenance import write_json
from bayes_aero.report.design import points_table
from bayes_aero.report.html.page import put_page
from bayes_aero.report.page_context import PageContext
from bayes_aero.report.pages.diagnosis import diagnosis_page
from bayes_aero.report.tables.diagnosis_tables import causes_table, changes_table, screen_table, terms_table
from bayes_aero.report.tables.table import write_csv
from bayes_aero.report.text.diagnosis import revealed


class ResultStore:
    """An outcome that grows, and diagnosis.json with it; `path` is the folder, if there is one."""

    def __init__(
        self,
        outcome: Outcome,
        path: Path | None,
        card: Card,
        records: Sequence[FlightRecord],
        source: Mapping[str, Any],
    ) -> None:
        self.outcome, self.path = outcome, path
        self._card, self._records, self._source, self._lock = card, records, source, Lock()
        self._put_tables()
        self._write()
        self._put_histories()

    def trajectories(self, found: Trajectories) -> None:
        """Keep simulated trajectories."""
        self._grow(view={"trajectories": found})
        self._put_histories()

    def judged(self, found: Diagnosis) -> None:
        """Keep the diagnosis with what hold-out flights say of its causes."""
        self._grow(view={"diagnosis": found})
        self._put_tables()

    def shown(self, view: View, part: str) -> None:
        """Keep a part of a view of the same diagnosis: `stalls`, or `holdout`, the scores by manoeuvre."""
        self._grow(view={part: getattr(view, part)})

    def test_points(self, found: Mapping[str, Any]) -> None:
        """Keep the test points that decide what is open."""
        self._grow(test_points=found)
        if self.path is not None and found.get("points"):
            write_csv(points_table(found), self.path / "test_points.csv")

    def in_band(self, found: CausesInBand | None) -> None:
        """Keep the sizes of the causes in a band of frequencies."""
        self._grow(in_band=found)

    def note(self, *notes: str) -> None:
        """Keep what was left out, and why."""
        self._grow(notes=notes)

    def attempt(self, what: str, do: Callable[[], None]) -> None:
        """Do what may fail, which keeps its own results; for bad input `what` is noted, anything else is a failure."""
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
            outcome.test_points,
            outcome.in_band,
            revealed(outcome.hidden, outcome.named) if outcome.hidden else (),
            outcome.notes,
            outcome.consistency,
            outcome.failures,
            outcome.health,
        )
        self.fail(() if self.path is None else put_page(lambda: diagnosis_page(outcome.view, told), self.path))

    def _grow(
        self,
        notes: Sequence[str] = (),
        failures: Sequence[str] = (),
        view: Mapping[str, Any] | None = None,
        **changes: Any,
    ) -> None:
        with self._lock:
            o = self.outcome
            seen = replace(o.view, **view) if view else o.view
            more = {"notes": (*o.notes, *notes), "failures": (*o.failures, *failures)}
            self.outcome = replace(o, view=seen, **more, **changes)
            self._write()

    def _put_tables(self) -> None:
        if self.path is not None:
            found = self.outcome.diagnosis
            write_csv(causes_table(found), self.path / "causes.csv")
            write_csv(changes_table(found), self.path / "changes.csv")
            write_csv(terms_table(found), self.path / "terms.csv")
            write_csv(screen_table(self.outcome.view.rankings, found), self.path / "screen.csv")

    def _put_histories(self) -> None:
        if self.path is None:
            return
        view = self.outcome.view
        flown = view.trajectories.paths if view.trajectories else ()
        by_coefficients = partial(diagnosed, view) if isinstance(view, View) else dict
        self.fail(put_histories(lambda: {**by_coefficients(), **flights(flown)}, self.path))

    def _write(self) -> None:
        if self.path is not None:
            content = diagnosis_results(self.outcome, self._card, self._records, self._source)
            write_json(content, self.path / "diagnosis.json")
