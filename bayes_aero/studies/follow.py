"""What a diagnosis is followed by while trajectories are flown: predictors, separating manoeuvres, stalls, figures."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from bayes_aero.criticism.finding import Diagnosis
from bayes_aero.errors import InputError
from bayes_aero.report.diagnosed import with_stalls
from bayes_aero.report.figures import ViewFigures, draw_all
from bayes_aero.studies.kept import Kept
from bayes_aero.studies.outlook import separations

Progress = Callable[[str, float], None]
Predict = Callable[[Diagnosis, Progress], Mapping[str, Any]]


def follow(kept: Kept, predict: Predict | None, figures: ViewFigures, tell: Progress) -> dict[str, Path]:
    """All that needs no trajectories, kept piece by piece; stalls and figures only where there is a folder for them.

    Returns the figures drawn, by name.
    """
    found = kept.outcome.diagnosis
    if predict is not None and not kept.has("predictors"):
        try:
            kept.predictors(predict(found, tell))
        except InputError as error:
            kept.note(f"Predictors were not compared: {error}")
    if predict is not None and not kept.has("separating"):
        kept.separating(separations(found, tell))
    if kept.path is None:
        return {}
    tell("stall", 0.0)
    try:
        kept.stalls(with_stalls(kept.outcome.view))
    except Exception as reason:  # an effect of the user's own may not bear a steady flow; the rest stands
        kept.note(f"Stall left out: {type(reason).__name__}: {reason}")
    return drawings(kept, figures, tell)


def drawings(kept: Kept, figures: ViewFigures, tell: Progress | None) -> dict[str, Path]:
    """Draw `figures` of what was found so far: paths by name; a note for each that failed."""
    if not figures or kept.path is None:
        return {}
    written, failed = draw_all(figures, kept.outcome.view, kept.path / "figures", tell)
    if failed:
        kept.note(*(f"Figure {name} was not drawn: {why}" for name, why in failed.items()))
    return {path.stem: path for path in written}
