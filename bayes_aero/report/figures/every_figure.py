"""Every figure of a report by the stem of its file, and one function that writes them all."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TypeVar

from matplotlib.figure import Figure

from bayes_aero.errors import failure
from bayes_aero.inference.identification import Identification
from bayes_aero.progress import Progress
from bayes_aero.report.diagnosis_view import View
from bayes_aero.report.figures import comparison as figures_comparison
from bayes_aero.report.figures import diagnosis as figures_diagnosis
from bayes_aero.report.figures import found as figures_found
from bayes_aero.report.figures import pit as figures_pit
from bayes_aero.report.figures import posterior as figures_posterior
from bayes_aero.report.figures import prior as figures_prior
from bayes_aero.report.figures import scatter as figures_scatter
from bayes_aero.report.figures import stall as figures_stall
from bayes_aero.report.figures import time_histories as figures_flight
from bayes_aero.report.figures import trajectories as figures_trajectory
from bayes_aero.report.style import Drawing, NotDrawn, save

FIGURES: dict[str, Drawing] = {
    "fig1_time_history": figures_flight.time_history,
    "fig2_gpr_fit": figures_flight.gpr_fit,
    "fig3_validation_CL": figures_flight.validation_CL,
    "fig4_correlation_CL": figures_scatter.correlation_CL,
    "fig5_stall_hysteresis": figures_scatter.hysteresis,
    "fig6_validation_CD": figures_flight.validation_CD,
    "fig7_correlation_CD": figures_scatter.correlation_CD,
    "fig8_validation_Cm": figures_flight.validation_Cm,
    "fig9_correlation_Cm": figures_scatter.correlation_Cm,
    "stall": figures_stall.stall,
    "stall_narrow": figures_stall.stall_narrow,
    "separation": figures_stall.separation,
    "forest": figures_comparison.forest,
    "crb_vs_credible": figures_comparison.crb_vs_credible,
    "prior_posterior": figures_prior.prior_posterior,
    "gp_prior_posterior": figures_prior.gp_prior_posterior,
    "trace_emcee": figures_posterior.trace_emcee,
    "trace_nuts": figures_posterior.trace_nuts,
    "rank_emcee": figures_posterior.rank_emcee,
    "rank_nuts": figures_posterior.rank_nuts,
    "pair": figures_posterior.pair,
    "pit": figures_pit.pit_histogram,
}
"""The seed paper's nine under its numbers, then what a Bayesian identification adds."""

ViewFigures = Mapping[str, Callable[[View], Figure]]

DIAGNOSIS_FIGURES: ViewFigures = {
    "found": figures_found.found,
    "found_narrow": figures_found.found_narrow,
    "measured_simulated": figures_diagnosis.measured_simulated,
    "ranking": figures_diagnosis.ranking,
    "gain": figures_diagnosis.gain,
    "moves": figures_diagnosis.moves,
    "stall_models": figures_stall.stall_models,
    "separation_models": figures_stall.separation_models,
    "residual_profiles": figures_diagnosis.residual_profiles,
    "residual_colour": figures_diagnosis.residual_colour,
    "trajectories_unseen": figures_trajectory.trajectories_unseen,
    "trajectories_fitted": figures_trajectory.trajectories_fitted,
}
"""What a diagnosis shows."""
FLOWN_FIGURES = ("found", "found_narrow", "trajectories_unseen", "trajectories_fitted")
"""Those that need trajectories, or show them if they are there."""

Shown = TypeVar("Shown")


def write_figures(
    identification: Identification, folder: Path, progress: Progress | None = None
) -> tuple[list[Path], tuple[str, ...]]:
    """Draw every figure for which an identification holds something; see `draw_all`."""
    return draw_all(FIGURES, identification, folder, progress)


def draw_all(
    figures: Mapping[str, Callable[[Shown], Figure]], shown: Shown, folder: Path, progress: Progress | None = None
) -> tuple[list[Path], tuple[str, ...]]:
    """Draw every figure of a registry for which `shown` holds something into `folder` as PNG.

    Returns the paths written, and for each figure that failed a sentence. A figure that fails leaves no file and does
    not keep the others from being drawn; one for which there is nothing to show is left out.
    """
    folder.mkdir(parents=True, exist_ok=True)
    written: list[Path] = []
    failed: list[str] = []
    for number, (stem, draw) in enumerate(figures.items()):
        if progress:
            progress(f"figure {stem}", number / len(figures))
        try:
            (folder / f"{stem}.png").unlink(missing_ok=True)  # of an earlier run
            written.append(save(draw(shown), folder / f"{stem}.png"))
        except NotDrawn:
            continue
        except Exception as reason:  # whatever it is, the other figures and the results stand; it is reported by name
            failed.append(failure(f"Figure {stem} was not drawn", reason, folder.parent))
    if progress:
        progress("figures", 1.0)
    return written, tuple(failed)
