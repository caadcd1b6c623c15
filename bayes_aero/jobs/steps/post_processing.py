"""What follows a diagnosis while trajectories are flown: test points, sizes in a band, stalls, scores, figures."""

from __future__ import annotations

from pathlib import Path

from bayes_aero.diagnosis.in_band.fit import causes_in_band
from bayes_aero.diagnosis.view.holdout import with_holdout_scores
from bayes_aero.diagnosis.view.models import with_stalls
from bayes_aero.diagnosis.view.results import View
from bayes_aero.flight.envelope import Envelope
from bayes_aero.jobs.io.result_store import ResultStore
from bayes_aero.jobs.steps.post_diagnosis import proposed_points
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
        kept.attempt("Stall left out", lambda: kept.stalls(with_stalls(view)))
        what = "Manoeuvres were not scored one by one"
        kept.attempt(what, lambda: kept.holdout(with_holdout_scores(view)))
    return drawings(kept, figures, tell)


def drawings(kept: ResultStore, figures: ViewFigures, tell: Progress | None) -> dict[str, Path]:
    """Draw `figures` of what was found so far: paths by name; a note for each that failed."""
    view = kept.outcome.view
    if not figures or kept.path is None or not isinstance(view, View):
        return {}
    written, failed = draw_all(figures, view, kept.path / "figures", tell)
    kept.fail(failed)
    return {path.stem: path for path in written}
