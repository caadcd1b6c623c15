"""The report of an identification: what stands on the page, in which order, in whose words."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from bayes_aero.diagnosis.trajectories.results import SimulatedManoeuvre
from bayes_aero.diagnosis.trajectories.results import SimulatedManoeuvre as Simulated
from bayes_aero.effect import Stage
from bayes_aero.flight.card.card import Card
from bayes_aero.flight.channel import STANDARD_CHANNELS, Axis
from bayes_aero.flight.health.finding import only_following
from bayes_aero.inference.identification import Identification
from bayes_aero.inference.posterior.posterior import PosteriorStatus
from bayes_aero.physics.coefficient_names import LATERAL
from bayes_aero.report.colours import COLOURS
from bayes_aero.report.figures.posterior import pit_words
from bayes_aero.report.figures.time_histories import SYMBOLS, shown_in
from bayes_aero.report.html.page import (
    MOST_SHOWN,
    Block,
    Fold,
    Page,
    Text,
    bullets,
    doubts,
    filled,
    first,
    histories,
    provenance_blocks,
    records_and_faults,
    section,
    symbols,
)
from bayes_aero.report.html.parts import WORDS, page_table
from bayes_aero.report.html.pictures import Gallery
from bayes_aero.report.html.plots import LOW, Line, Panel
from bayes_aero.report.pages.captions import DEG, identification_alternatives, interval, stall_table
from bayes_aero.report.pages.fly import Curve, over_measured, sources
from bayes_aero.report.pooled import next_flight_table
from bayes_aero.report.tables.comparison import chosen_posteriors, engine_label, methods, noise_label, ordered, usable
from bayes_aero.report.tables.fly import given_table
from bayes_aero.report.tables.run_tables import (
    alone_table,
    coverage_table,
    fit_table,
    parameter_table,
    sampler_table,
    validation_table,
)
from bayes_aero.report.text.identification import disputed, verdict
from bayes_aero.report.text.phrases import bracket, several
from bayes_aero.report.text.restraints import unparted

CONTEXT = ("alpha", "elevator", "q", "airspeed", "altitude")
SIX_CONTEXT = ("alpha", "beta", "elevator", "aileron", "rudder", "p")
LEGEND = (
    ("measured", COLOURS["measured"], "solid"),
    ("fitted (maximum likelihood)", COLOURS["mle"], "solid"),
    ("error", COLOURS["mle"], "area"),
)
CORRELATIONS = (
    "fig4_correlation_CL",
    "fig7_correlation_CD",
    "fig9_correlation_Cm",
    *(f"correlation_{name}" for name in LATERAL),
)


def identification_page(
    run: Identification,
    source: Mapping[str, Any],
    figures: Mapping[str, Path],
    flown: Sequence[Simulated] = (),
) -> Page:
    """The page; `figures` are the drawn ones by stem, none where they were not asked for.

    `flown` are the simulated manoeuvres, none where the model could not be flown.
    """
    gallery = Gallery(figures, identification_alternatives(run))
    sentences = verdict(run)
    lead: list[Block] = [Text(w, "warning") for w in _warnings(run)]
    pictures = gallery("stall") or gallery("crb_vs_credible")
    lead += pictures
    if not figures:
        lead.append(Text("Static pictures were not drawn in this run; tables and interactive figures are complete."))
    return Page(
        title=f"Identification: {run.card.title}",
        subtitle="Aerodynamic model identified from flight data, with uncertainty",
        verdict=headline(run),
        lead=tuple(lead),
        doubts=doubts(run.health, run.consistency, corrects=False, failures=run.failures),
        sections=filled(
            section("findings", "Findings", lambda: (*bullets(sentences), WORDS)),
            section(
                "records", "The records at a glance", lambda: records_and_faults(run.records, run.card, run.health)
            ),
            section(
                "fit",
                "Measured and fitted",
                lambda: (
                    Text(
                        "Coefficients of forces and moments reconstructed from the accelerometers and rate "
                        "gyros, and "
                        "the fitted model. The shaded area between the curves is the error."
                    ),
                    *_histories(run),
                    page_table(fit_table(run)),
                ),
            ),
            section("simulated", "Measured and simulated", lambda: given_flights(flown, run.card)),
            section("stall", "The stall", lambda: _stall(run, gallery)),
            section("parameters", "Parameters", lambda: _parameters(run, gallery)),
            section("next-flight", "The next flight", lambda: _next_flight(run, gallery)),
            section("prediction", "Prediction of hold-out data", lambda: _validation(run, gallery)),
            section("diagnostics", "Diagnostics", lambda: _diagnostics(run, gallery)),
            section("provenance", "Provenance", lambda: provenance_blocks(source, run.notes, run.seconds)),
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
            f"deg "
            "(95 % intervals)"
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


def _warnings(run: Identification) -> list[str]:
    """Warnings that apply to the numbers."""
    return [
        f"{engine_label(p.engine)} under {noise_label(p.noise)} noise: {p.status.value}."
        for p in run.posteriors.values()
        if p.status is not PosteriorStatus.CONVERGED
    ]


def _histories(run: Identification) -> list[Block]:
    o = run.observations
    fitted, measured = run.fitted, np.asarray(o.measured)
    shown, listed = first(o.names)
    plots: list[Block] = [*listed]
    for number, name in enumerate(shown):
        mine = o.manoeuvre == number
        panels = [
            Panel(
                f"{c} [-]",
                (
                    Line("measured", COLOURS["measured"], measured[mine, i], width=1.0),
                    Line("fitted", COLOURS["mle"], fitted[mine, i]),
                ),
                shade=((0, 1),),
            )
            for i, c in enumerate(o.coefficients)
        ]
        for channel in SIX_CONTEXT if Axis.LATERAL in run.model.axes else CONTEXT:
            if channel in o.signals:
                unit, factor = shown_in(channel)
                values = factor * np.asarray(o.signals[channel])[mine]
                label = f"{SYMBOLS.get(channel, channel)} {bracket(unit)}"
                panels.append(Panel(label, (Line("measured", COLOURS["measured"], values),), height=LOW))
        what = "Measured and fitted coefficients, and the manoeuvre flown,"
        plots.append(histories(name, f"time-fit-{number}", o.time[mine], panels, LEGEND, what))
    return plots


def _stall(run: Identification, gallery: Gallery) -> tuple[Block, ...]:
    if all(effect.stage is not Stage.SEPARATION for effect in run.model.effects):
        return (Text("The card's model has no separation of the flow, and so no stall."),)
    if run.stall is None:
        return (
            Text(
                "CLmax and the stall angle are not given: no posterior was sampled or the fit did not reach an optimum."
            ),
        )
    engine = next(iter(chosen_posteriors(run)))
    label = f"{engine_label(engine)}, {noise_label(run.noise)} noise"
    pictures = gallery("separation") if "stall" in gallery.paths else gallery("stall", "separation")
    return (
        *stall_table({label: run.stall}, "Intervals are those of the posterior."),
        Text("The figure at the top of the page shows lift, time spent at each angle of attack, and the drag polar."),
        *pictures,
    )


def _parameters(run: Identification, gallery: Gallery) -> tuple[Block, ...]:
    names = ordered(run.mle.names, run.mle.parameters)
    pictures = [*gallery("crb_vs_credible"), *gallery("forest")]  # the high one last: printed, it needs its own sheet
    single = alone_table(run)
    return (
        page_table(parameter_table(run)),
        *(() if single is None else (Fold("Each manoeuvre fitted alone", (page_table(single),)),)),
        symbols(run.model.parameters, names),
        *pictures,
    )


def _next_flight(run: Identification, gallery: Gallery) -> tuple[Block, ...]:
    if run.next_flight is None:
        return ()
    return (page_table(next_flight_table(run)), *gallery("next_flight"))


def _validation(run: Identification, gallery: Gallery) -> tuple[Block, ...]:
    if run.gp is None:
        return (Text("There are no hold-out data: this run trained no Gaussian process."),)
    return (
        page_table(validation_table(run, each_fold=False)),
        *gallery("gpr_fit", "fig2_gpr_fit"),
        Fold(
            "Measured against predicted",
            gallery.folded(*CORRELATIONS),
        ),
    )


def _diagnostics(run: Identification, gallery: Gallery) -> tuple[Block, ...]:
    blocks: list[Block] = []
    calibrated = coverage_table(run)
    bars = Gallery(gallery.paths, {"pit": pit_words(run)}).folded("pit") if "pit" in gallery.paths else ()
    if calibrated is not None or bars:
        title = "Calibration of the posterior's predictions"
        blocks.append(Fold(title, (*([] if calibrated is None else [page_table(calibrated)]), *bars)))
    tables = [page_table(sampler_table(run, key)) for key in run.posteriors]
    if tables:
        pictures = gallery.folded("rank_emcee", "rank_nuts", "trace_emcee", "trace_nuts")
        blocks.append(
            Fold("Convergence of the samplers: R-hat, effective sample size, rank plots", (*tables, *pictures))
        )
    prior = gallery.folded("prior_posterior", "pair", "gp_prior_posterior")
    if prior:
        blocks.append(Fold("Prior and posterior", prior))
    mle = run.mle
    strong = [f"{a} and {b}: {r:+.3f}" for a, b, r in mle.strong_correlations()]
    eigen = np.asarray(mle.eigenvalues)
    rank = (
        f"Maximum likelihood: {mle.status.value}, {mle.iterations} iterations. Information matrix of rank "
        f"{int(np.sum(eigen > 1e-11 * eigen.max()))} of {len(eigen)}; smallest eigenvalue (scaled to unit diagonal) "
        f"{eigen.min():.2g}. det R = {mle.det_R:.5g}."
    )
    listed = bullets(strong) if strong else (Text("No two parameters are correlated beyond 0.9."),)
    blocks.append(Fold("Identifiability: information matrix, correlated parameters", (Text(rank), *listed)))
    return tuple(blocks)


# --- The identified model simulated with the recorded inputs: errors of its trajectories, and time histories.


def given_flights(paths: Sequence[SimulatedManoeuvre], card: Card) -> tuple[Block, ...]:
    """A table of errors, then each manoeuvre with the error shaded; nothing if nothing was simulated."""
    if not paths:
        return ()
    units = {name: STANDARD_CHANNELS[name].unit for name in paths[0].errors}
    _, listed = first([path.manoeuvre for path in paths])
    text = (
        "A simulation with the fitted coefficients and the recorded inputs from the measured initial state, without "
        "correction by measurements. Small errors of a coefficient accumulate here, so trajectories can drift although "
        "the coefficients agree. Nothing was fitted to these trajectories: bayes-aero fly fits trajectories, and "
        "bayes-aero diagnose names missing effects."
    )
    if any(error.tolerance is not None for error in paths[0].errors.values()):
        text += " The grey band is the tolerance about the measurement."
    what = "Measured outputs, and those simulated with the fitted coefficients,"
    plots = [
        over_measured(
            path.manoeuvre, f"time-given-{order}", [Curve(path, "simulation", COLOURS["mle"], "solid")], units, what
        )
        for order, path in enumerate(islice(paths, MOST_SHOWN))
    ]
    lost = [
        Text(f"The simulation of {path.manoeuvre} leaves the flight envelope.", "warning")
        for path in paths
        if not path.inside
    ]
    return (Text(text), *lost, *listed, *plots, page_table(given_table(paths)), *sources(card, units))
