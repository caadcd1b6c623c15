"""The report of an identification: what stands on the page, in which order, in whose words."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from bayes_aero.diagnosis.result import SimulatedManoeuvre
from bayes_aero.effect import Stage
from bayes_aero.flight.card import Card
from bayes_aero.flight.channel import STANDARD_CHANNELS
from bayes_aero.flight.health import only_following
from bayes_aero.inference.results import Identification, PosteriorStatus
from bayes_aero.physics.aircraft import Axis
from bayes_aero.report.colours import COLOURS
from bayes_aero.report.figures.posterior import CORRELATIONS, pit_words
from bayes_aero.report.figures.time_histories import Curve
from bayes_aero.report.html import page as html
from bayes_aero.report.html.page import Block, Fold, Gallery, Text, bullets, page_table, section
from bayes_aero.report.html.plots import Line, Panel
from bayes_aero.report.pages.captions import DEG, identification_alternatives, interval, stall_table
from bayes_aero.report.pages.fly import over_measured, sources
from bayes_aero.report.tables import run_tables
from bayes_aero.report.tables.comparison import chosen_posteriors, engine_label, methods, noise_label, ordered, usable
from bayes_aero.report.tables.fly import given_table
from bayes_aero.report.tables.run_tables import next_flight_table
from bayes_aero.report.text.identification import disputed, verdict
from bayes_aero.report.text.phrases import WORDS, several, unparted

CONTEXT = ("alpha", "elevator", "q", "airspeed", "altitude")
SIX_CONTEXT = ("alpha", "beta", "elevator", "aileron", "rudder", "p")
LEGEND = (
    html.MEASURED,
    ("fitted (maximum likelihood)", COLOURS["mle"], "solid"),
    ("error", COLOURS["mle"], "area"),
)


def identification_page(
    run: Identification,
    source: Mapping[str, Any],
    figures: Mapping[str, Path],
    flown: Sequence[SimulatedManoeuvre] = (),
) -> html.Report:
    """The page, with the drawn `figures` by stem and the simulated manoeuvres, where there are any."""
    gallery = Gallery(figures, identification_alternatives(run))
    sentences = verdict(run)
    doubtful = [p for p in run.posteriors.values() if p.status is not PosteriorStatus.CONVERGED]
    labels = [f"{engine_label(p.engine)} under {noise_label(p.noise)} noise: {p.status.value}." for p in doubtful]
    return html.Report(
        title=f"Identification: {run.card.title}",
        subtitle="Aerodynamic model identified from flight data, with uncertainty",
        verdict=headline(run),
        lead=(
            *(Text(label, "warning") for label in labels),
            *(gallery("stall") or gallery("crb_vs_credible")),
            *(() if figures else (html.NOT_DRAWN,)),
        ),
        doubts=html.doubts(run.health, run.consistency, corrects=False, failures=run.failures),
        sections=html.filled(
            section("findings", "Findings", lambda: (*bullets(sentences), html.terms("glossary"))),
            html.records_section(run.records, run.card, run.health),
            section("fit", "Measured and fitted", lambda: _fit(run)),
            section("simulated", "Measured and simulated", lambda: given_flights(flown, run.card)),
            section("stall", "The stall", lambda: _stall(run, gallery)),
            section("parameters", "Parameters", lambda: _parameters(run, gallery)),
            section(
                "next-flight",
                "The next flight",
                lambda: (page_table(next_flight_table(run)), *gallery("next_flight")) if run.next_flight else (),
            ),
            section("prediction", "Prediction of hold-out data", lambda: _validation(run, gallery)),
            section("diagnostics", "Diagnostics", lambda: _diagnostics(run, gallery)),
            section("provenance", "Provenance", lambda: html.provenance_blocks(source, run.notes, run.seconds)),
        ),
    )


def headline(run: Identification) -> str:
    """The run in one sentence."""
    mle = run.mle
    if not usable(mle):
        return f"No parameters can be given: {mle.status.value}."
    if following := only_following(run.health):
        return f"No derivative of this axis can be given: {unparted(mle.status.value, following)}."
    fit = several(f"{mle.fit[name].r:.3f} ({name})" for name in mle.fit)
    text = f"The model follows the measured coefficients with correlations of {fit}"
    if run.stall is not None and run.stall.seen:
        s = run.stall
        text += (
            f"; the steady stall is at CLmax = {interval(s.CL_max, 1.0, 2)} and α = {interval(s.alpha_max, DEG, 1)} "
            "deg (95 % intervals)"
        )
    elif run.stall is not None:
        text += "; the records do not show the angle of the steady stall"
    crb, corrected = (m.estimates for m in methods(run)[:2])
    ratios = [corrected[n].sd / crb[n].sd for n in crb if crb[n].sd > 0.0 and np.isfinite(corrected[n].sd)]
    if ratios and np.median(ratios) > 1.25:
        text += f"; Cramér–Rao bounds are about {np.median(ratios):.1f} times too small"
    if unsure := disputed(run):
        text += f"; noise models disagree about {several(unsure)} beyond their intervals, so these are not reliable"
    return text + "."


def _fit(run: Identification) -> list[Block]:
    """Time histories of each manoeuvre, and the scores of the fit."""
    o = run.observations
    fitted, measured = run.fitted, np.asarray(o.measured)
    shown, listed = html.first(o.names)
    context = SIX_CONTEXT if Axis.LATERAL in run.model.axes else CONTEXT
    plots: list[Block] = [*listed]
    for number, name in enumerate(shown):
        mine, panels = o.manoeuvre == number, []
        for i, coefficient in enumerate(o.coefficients):
            line = Line("measured", COLOURS["measured"], measured[mine, i], width=1.0)
            both = (line, Line("fitted", COLOURS["mle"], fitted[mine, i]))
            panels.append(Panel(coefficient, "1", both, shade=((0, 1),)))
        panels += html.context_panels({c: np.asarray(o.signals[c])[mine] for c in context if c in o.signals})
        what = "Measured and fitted coefficients, and the manoeuvre flown,"
        plots.append(html.histories(name, f"time-fit-{number}", o.time[mine], panels, LEGEND, what))
    text = WORDS["paragraphs"]["fit"]
    return [Text(text), *plots, page_table(run_tables.fit_table(run))]


def _stall(run: Identification, gallery: Gallery) -> tuple[Block, ...]:
    if all(effect.stage is not Stage.SEPARATION for effect in run.model.effects):
        return (Text("The card's model has no separation of the flow, and so no stall."),)
    if run.stall is None:
        why = "no posterior was sampled or the fit did not reach an optimum"
        return (Text(f"CLmax and the stall angle are not given: {why}."),)
    label = f"{engine_label(next(iter(chosen_posteriors(run))))}, {noise_label(run.noise)} noise"
    pictures = gallery("separation") if "stall" in gallery.paths else gallery("stall", "separation")
    return (
        *stall_table({label: run.stall}, "Intervals are those of the posterior."),
        Text("The figure at the top of the page shows lift, time spent at each angle of attack, and the drag polar."),
        *pictures,
    )


def _parameters(run: Identification, gallery: Gallery) -> tuple[Block, ...]:
    single = run_tables.alone_table(run)
    return (
        page_table(run_tables.parameter_table(run)),
        *(() if single is None else (Fold("Each manoeuvre fitted alone", (page_table(single),)),)),
        html.symbols(run.model.parameters, ordered(run.mle.names, run.mle.parameters)),
        *gallery("crb_vs_credible"),
        *gallery("forest"),  # the high one last: printed, it needs its own sheet
    )


def _validation(run: Identification, gallery: Gallery) -> tuple[Block, ...]:
    if run.gp is None:
        return (Text("There are no hold-out data: this run trained no Gaussian process."),)
    return (
        page_table(run_tables.validation_table(run, each_fold=False)),
        *gallery("gpr_fit", "fig2_gpr_fit"),
        Fold("Measured against predicted", gallery(*CORRELATIONS.values())),
    )


def _diagnostics(run: Identification, gallery: Gallery) -> tuple[Block, ...]:
    mle, calibration = run.mle, run_tables.coverage_table(run)
    calibrated = [] if calibration is None else [page_table(calibration)]
    bars = Gallery(gallery.paths, {"pit": pit_words(run)})("pit") if "pit" in gallery.paths else ()
    chains: list[Block] = [page_table(run_tables.sampler_table(run, key)) for key in run.posteriors]
    chains += gallery("rank_emcee", "rank_nuts", "trace_emcee", "trace_nuts") if chains else ()
    eigen = np.asarray(mle.eigenvalues)
    rank = (
        f"Maximum likelihood: {mle.status.value}, {mle.iterations} iterations. Information matrix of rank "
        f"{int(np.sum(eigen > 1e-11 * eigen.max()))} of {len(eigen)}; smallest eigenvalue (scaled to unit diagonal) "
        f"{eigen.min():.2g}. det R = {mle.det_R:.5g}."
    )
    strong = bullets(f"{a} and {b}: {r:+.3f}" for a, b, r in mle.strong_correlations())
    folds: dict[str, Sequence[Block]] = {
        "Calibration of the posterior's predictions": [*calibrated, *bars],
        "Convergence of the samplers: R-hat, effective sample size, rank plots": chains,
        "Prior and posterior": gallery("prior_posterior", "pair", "gp_prior_posterior"),
        "Identifiability: information matrix, correlated parameters": [
            Text(rank),
            *(strong or (Text("No two parameters are correlated beyond 0.9."),)),
        ],
    }
    return tuple(Fold(title, tuple(blocks)) for title, blocks in folds.items() if blocks)


# --- The identified model simulated with the recorded inputs: errors of its trajectories, and time histories.


def given_flights(paths: Sequence[SimulatedManoeuvre], card: Card) -> tuple[Block, ...]:
    """A table of errors, then each manoeuvre with the error shaded; nothing if nothing was simulated."""
    if not paths:
        return ()
    units = {name: STANDARD_CHANNELS[name].unit for name in paths[0].errors}
    _, listed = html.first([path.manoeuvre for path in paths])
    text = WORDS["paragraphs"]["given_flights"]
    if any(error.tolerance is not None for error in paths[0].errors.values()):
        text += " The grey band is the tolerance about the measurement."
    what, plots = "Measured outputs, and those simulated with the fitted coefficients,", []
    for order, path in enumerate(paths[: html.MOST_SHOWN]):
        curves = [Curve(path, "simulation", COLOURS["mle"], "solid")]
        plots.append(over_measured(path.manoeuvre, f"time-given-{order}", curves, units, what))
    left = [path.manoeuvre for path in paths if not path.inside]
    lost = [Text(f"The simulation of {name} leaves the flight envelope.", "warning") for name in left]
    return (Text(text), *lost, *listed, *plots, page_table(given_table(paths)), *sources(card, units))
