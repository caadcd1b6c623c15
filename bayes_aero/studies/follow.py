"""What a diagnosis is followed by while trajectories are flown: predictors, separating manoeuvres, stalls, figures."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from bayes_aero.criticism.finding import Diagnosis
from bayes_aero.errors import InputError
from bayes_aero.report.diagnosed import View, with_stalls
from bayes_aero.report.figures import ViewFigures, draw_all
from bayes_aero.studies.outlook import separations

Progress = Callable[[str, float], None]
Predict = Callable[[Diagnosis, Progress], Mapping[str, Any]]


@dataclass(frozen=True)
class Follows:
    """Predictors on unseen data, manoeuvres that would separate, the view with its stalls; and what failed."""

    view: View
    predictors: Mapping[str, Any] = field(default_factory=dict)
    separating: Sequence[Mapping[str, Any]] = ()
    drawn: Mapping[str, Path] = field(default_factory=dict)
    notes: tuple[str, ...] = ()


def follow(view: View, predict: Predict | None, figures: ViewFigures, out: Path | None, tell: Progress) -> Follows:
    """All that needs no trajectories; stalls and figures only where there is a folder for them."""
    predictors, separating, drawn, notes = {}, [], {}, []
    if predict is not None:
        try:
            predictors = predict(view.diagnosis, tell)
        except InputError as error:
            notes.append(f"Predictors were not compared: {error}")
        separating = separations(view.diagnosis, tell)
    if out is not None:
        try:
            view = with_stalls(view)
        except Exception as reason:  # an effect of the user's own may not bear a steady flow; the rest stands
            notes.append(f"Stall left out: {type(reason).__name__}: {reason}")
        drawn, failed = drawings(figures, view, out, tell)
        notes += failed
    return Follows(view, predictors, separating, drawn, tuple(notes))


def drawings(figures: ViewFigures, view: View, out: Path, tell: Progress | None) -> tuple[dict[str, Path], list[str]]:
    """Draw `figures` into the folder of results: paths by name, and a sentence for each that failed."""
    if not figures:
        return {}, []
    written, failed = draw_all(figures, view, out / "figures", tell)
    return {path.stem: path for path in written}, [f"Figure {n} was not drawn: {why}" for n, why in failed.items()]
