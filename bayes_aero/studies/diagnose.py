"""The diagnosis as a job: records in, what the model gets wrong out; numbers are on disk before a figure is drawn."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from bayes_aero.criticism.diagnosis import diagnose
from bayes_aero.criticism.finding import Diagnosis
from bayes_aero.criticism.trajectory import Trajectories
from bayes_aero.effect import Kind
from bayes_aero.effects import CATALOGUE
from bayes_aero.errors import InputError
from bayes_aero.flight.card import Card
from bayes_aero.flight.record import FlightRecord
from bayes_aero.inference.cores import blas_threads, cores
from bayes_aero.model.model import Model
from bayes_aero.report.diagnosed import View, view_of
from bayes_aero.report.figures import DIAGNOSIS_FIGURES, FLOWN_FIGURES
from bayes_aero.report.page import put_page
from bayes_aero.report.page_diagnosis import Told, diagnosis_page
from bayes_aero.report.tables import write_csv
from bayes_aero.report.words_diagnosis import causes_frame, revealed, screen_frame, sentences
from bayes_aero.studies.beside import beside
from bayes_aero.studies.diagnosis_results import diagnosis_results
from bayes_aero.studies.folder import writable
from bayes_aero.studies.follow import Follows, Predict, drawings, follow
from bayes_aero.studies.hidden import draw_hidden, flyable
from bayes_aero.studies.provenance import provenance, write_json

Progress = Callable[[str, float], None]
Hidden = Mapping[str, Mapping[str, float]]
"""True values of what simulated records hide, by effect."""
Fly = Callable[[Diagnosis, Progress | None], Trajectories]


@dataclass(frozen=True)
class Outcome:
    """A diagnosis with what is shown of it; `named`: each hidden effect is first, named, ambiguous, minor or missed."""

    view: View
    hidden: Hidden | None
    named: Mapping[str, str]
    notes: tuple[str, ...]

    @property
    def diagnosis(self) -> Diagnosis:
        """The finding itself."""
        return self.view.diagnosis


def hide_one(card: Card, seed: int, **options: Any) -> tuple[Hidden, list[FlightRecord]]:
    """One effect that the card's model lacks, drawn at random, hidden in simulated manoeuvres."""
    Model.from_card(card)  # a card without effects says so before anything is flown
    rng = np.random.default_rng([seed, 4])
    names = [
        e.name
        for e in CATALOGUE.values()
        if e.candidate
        and e.kind is not Kind.NOISE
        and draw_hidden(np.random.default_rng(0), e.name)
        and _absent(card, e.name)
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


def _absent(card: Card, name: str) -> bool:
    """Whether the card's model lacks an effect, or holds it at neutral."""
    return name not in card.effects or all(card.fixed.get(p.name) == p.neutral for p in CATALOGUE[name].parameters)


def run(
    records: Sequence[FlightRecord],
    card: Card,
    *,
    out: Path | None = None,
    seed: int = 0,
    most: int = 8,
    hidden: Hidden | None = None,
    predict: Predict | None = None,
    fly: Fly | None = None,
    figures: bool = True,
    progress: Progress | None = None,
) -> Outcome:
    """Diagnose, as `bayes-aero diagnose` does; with `out` it writes diagnosis.json, causes.csv, screen.csv,
    figures and report.html.

    `most` is the number of effects that each stage may add. `predict` adds the comparison of predictors, which may
    fail (the reason is then a note), and the manoeuvres that would separate ambiguity sets. `fly` adds simulated
    trajectories. `hidden` is what simulated records hide, for the comparison with what was found.
    """
    if out is not None:
        writable(out)
    source = provenance(card, records, seed, {"max_effects": most})
    view = view_of(diagnose(records, card, seed=seed, most=most, progress=progress))
    named = {name: _found(view.diagnosis, name) for name in hidden} if hidden else {}
    outcome, follows = Outcome(view, hidden, named, ()), Follows(view)

    def write() -> None:
        if out is None:
            return
        truth = None if hidden is None else {"effects": hidden, "named": named}
        content = diagnosis_results(
            outcome.view,
            card,
            records,
            source,
            sentences=sentences(outcome.view),
            predictors=follows.predictors,
            separating=follows.separating,
            hidden=truth,
            notes=outcome.notes,
        )
        write_json(content, out / "diagnosis.json")

    if out is not None:
        write_csv(causes_frame(view), out / "causes.csv")
        write_csv(screen_frame(view), out / "screen.csv")
    write()
    shown = DIAGNOSIS_FIGURES if figures and out is not None else {}
    early, late = ({n: draw for n, draw in shown.items() if (n in FLOWN_FIGURES) == x} for x in (False, True))
    job = partial(follow, view, predict, early, out)
    with blas_threads(0), beside(job, progress) as following:  # one limit: of two, the first to end would lift both
        if cores() == 1:
            following.result()
        try:
            outcome = _simulated(outcome, fly, progress)
        finally:  # Ctrl-C leaves on disk what is there
            follows = following.result() if following.done else follows
            write()
        follows = following.result()
    view = replace(follows.view, trajectories=outcome.view.trajectories)
    outcome = replace(outcome, view=view, notes=(*outcome.notes, *follows.notes))
    write()
    if out is None:
        return outcome
    drawn, failed = drawings(late, view, out, progress)
    outcome = replace(outcome, notes=(*outcome.notes, *failed))
    write()
    if progress:
        progress("report", 0.0)
    told = Told(
        card,
        records,
        source,
        {**follows.drawn, **drawn},
        follows.predictors,
        follows.separating,
        revealed(hidden, named) if hidden else (),
        outcome.notes,
    )
    failure = put_page(lambda: diagnosis_page(outcome.view, told), out)
    if failure:
        outcome = replace(outcome, notes=(*outcome.notes, failure))
        write()
    return outcome


def _simulated(outcome: Outcome, fly: Fly | None, progress: Progress | None) -> Outcome:
    """With trajectories, or why there are none."""
    if fly is None:
        return outcome
    try:
        return replace(outcome, view=replace(outcome.view, trajectories=fly(outcome.diagnosis, progress)))
    except InputError as error:
        return replace(outcome, notes=(*outcome.notes, f"Trajectories were not simulated: {error}"))


def _found(diagnosis: Diagnosis, name: str) -> str:
    names = [c.name for c in diagnosis.causes]
    if name in names:
        return "first" if names[0] == name else "named"
    if any(name in c.ambiguous_with for c in diagnosis.causes):
        return "ambiguous"
    return "minor" if name in diagnosis.minor else "missed"
