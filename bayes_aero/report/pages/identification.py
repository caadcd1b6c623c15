"""What an identification shows: parameters by every method, validation, fit, chains, the next flight; its page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from bayes_aero.effect import Stage
from bayes_aero.flight.health import only_following
from bayes_aero.physics.aircraft import Axis
from bayes_aero.report.figures.posterior import CORRELATIONS
from bayes_aero.report.page import Gallery, Report, fold, section
from bayes_aero.report.pages import estimates, parts
from bayes_aero.report.pages.estimates import label_of, ordered, unit_of
from bayes_aero.report.pages.parts import DEG, interval
from bayes_aero.report.pages.trajectories import given_flights
from bayes_aero.report.phrases import WORDS, from_to, plain_unit, plus_minus, sentence, several, unparted
from bayes_aero.report.plots import Panel, compared_panel
from bayes_aero.report.screen import Screen, actions, claims, doubts_of
from bayes_aero.report.table import Column, Estimate, Table, columns_of, parameter_columns, table, with_error
from bayes_aero.units import number

if TYPE_CHECKING:
    from pathlib import Path

    from bayes_aero.diagnosis.result import SimulatedManoeuvre
    from bayes_aero.flight.card import Card
    from bayes_aero.flight.record import FlightRecord
    from bayes_aero.inference.results import Identification

ONE_BY_ONE = 4  # manoeuvres that are shown; files have more
ML = "maximum likelihood\n± standard error"
SAMPLED = "posterior\nmean ± standard deviation, 95 % interval"
PARTS = ("", "sd", "ci95_low", "ci95_high")


def parameter_table(run: Identification) -> Table:
    """The model's parameters by every method, SI and radians. Methods not (yet) run have no columns."""
    mle, (bound, corrected, *sampled) = run.mle, estimates.methods(run)
    names = ordered(mle.names, mle.parameters)
    truth = [] if run.truth is None else [run.truth.get(n) for n in names]
    columns = [
        *parameter_columns(names, [unit_of(run, n) for n in names]),
        *([Column(truth, page="true", form=".4g")] if truth else []),
        Column(bound.of(names), ("estimate", "crb"), "Cramér–Rao", group=ML),
        Column(corrected.of(names), ("", "crb_corrected"), "corrected", group=ML),
        *([Column(truth, "flown")] if truth else []),
    ]
    if run.noise == "white" and sampled:
        columns.append(Column(sampled[0].of(names), ("white_mean", "white_sd")))
    for m in sampled:
        ends = () if m.key == "white" else ("ci95_low", "ci95_high")
        files = tuple(f"{m.key}_{part}" for part in ("mean", "sd", *ends))
        columns.append(Column(m.of(names), files, m.label.replace(", ", "\n", 1), form=_interval, group=SAMPLED))
    columns += [] if run.frequency is None else estimates.frequency_columns(names, run.frequency)
    columns += _alone_columns(run, names) if run.alone else []
    remark = " “True” are the values with which the records were simulated." if truth else ""
    return table("parameters", columns, known=remark)


def identification_screen(run: Identification, card: Card, records: Sequence[FlightRecord]) -> Screen:
    """Every parameter with its standard error by maximum likelihood and by the posterior, and what is doubtful."""
    mle, (_, corrected, *sampled) = run.mle, estimates.methods(run)
    record, mend = parts.record_block(records, run.health, run.consistency)
    names = ordered(mle.names, mle.parameters)
    chosen = next((m for m in sampled if m.key == next(iter(estimates.chosen_posteriors(run)), None)), None)
    columns = [
        Column(names, page="parameter"),
        Column([plain_unit(unit_of(run, n)) for n in names], page="unit"),
        Column(corrected.of(names), page=corrected.label, form=with_error),
        *([Column(chosen.of(names), page=chosen.label, form=with_error)] if chosen else []),
    ]
    status = unparted(mle.status.value, only_following(run.health))
    R2 = ", ".join(f"{name} {number(of.r2, 3)}" for name, of in mle.fit.items())
    shown: list[str | Table] = [sentence("identified", status=status, R2=R2)]
    if run.stall is not None and run.stall.seen:
        peak = {"CL": interval(run.stall.CL_max, 1.0, 2), "alpha": interval(run.stall.alpha_max, DEG, 1)}
        shown.append(sentence("headline_stall", **peak))
    shown += [Table(columns)] if estimates.usable(mle) else [sentence("no_parameters")]
    messages = doubts_of(estimates.verdict(run))
    more = [sentence("next_diagnose", given=parts.given(records, card))]
    return Screen(record, shown, [*run.failures, *claims(messages), *run.notes], [*mend, *actions(messages), *more])


def _interval(e: Estimate) -> str:
    return f"{plus_minus(e.centre, e.sd)}\n{from_to(e.low, e.high, e.sd)}"


def _alone_columns(run: Identification, names: Sequence[str]) -> list[Column]:
    """Manoeuvres fitted alone: files have every fit, people the scatter of those that are usable."""
    columns = []
    for manoeuvre, fit in run.alone.items():
        single = estimates.bounds(fit, fit.crb)
        columns.append(Column([single.get(n) for n in names], (f"{manoeuvre}_estimate", f"{manoeuvre}_crb")))
    scatter, group = [estimates.scatter(run, n) or (None, None) for n in names], "manoeuvres fitted alone"
    sd, largest = zip(*scatter, strict=True)
    return [
        *columns,
        Column(sd, "between_manoeuvres_sd", "scatter\n(sd)", form=2, group=group),
        Column(largest, "largest_difference_in_crb", "largest\ndifference", form=".1f", group=group),
    ]


def validation_table(run: Identification, *, each_fold: bool = True) -> Table:
    """Scores of GPR and maximum likelihood on the same test points by split, fold (and all folds) and coefficient."""
    rows: list[tuple[str, str, str, Any]] = []
    for gp, split, folds in () if run.gp is None else [(run.gp, *item) for item in run.gp.splits.items()]:
        for name in run.observations.coefficients:
            if each_fold and len(folds) > 1:
                rows += [(split, str(k), name, fold[name]) for k, fold in enumerate(folds, start=1)]
            rows.append((split, "all", name, gp.pooled(split, name)))
    column = columns_of([row[-1] for row in rows])
    ml, gpr = {"group": "maximum likelihood"}, {"group": "GPR"}
    columns = [
        *(Column([row[k] for row in rows], name) for k, name in enumerate(("split", "fold", "coefficient"))),
        Column([f"{split}, {name}" for split, _, name, _ in rows], page="split, coefficient"),
        column(lambda v: len(v.measured), "points", "points"),
        column(lambda v: v.mle_scores.r, page="r", form=".4f", **ml),
        column(lambda v: v.mle_scores.rmse, page="RMSE [-]", form=3, **ml),
        column(lambda v: v.gp_scores.r, "gpr_r", "r", form=".4f", **gpr),
        column(lambda v: v.gp_scores.rmse, "gpr_rmse", "RMSE [-]", form=3, **gpr),
        column(lambda v: v.gp_scores.theil, "gpr_theil"),
        column(lambda v: v.gp_scores.r2, "gpr_r2"),
        column(lambda v: v.coverage.get(0.5), "gpr_coverage50"),
        column(lambda v: v.coverage.get(0.9), "gpr_coverage90"),
        column(lambda v: v.coverage.get(0.95), "gpr_coverage95", "inside 95 %", form=".0%", **gpr),
        column(lambda v: v.k_hat, "gpr_k_hat", "Pareto k", form=2, **gpr),
        column(lambda v: v.mle_scores.r, "mle_r"),
        column(lambda v: v.mle_scores.rmse, "mle_rmse"),
        column(lambda v: v.status, "gpr_status"),
    ]
    return table("validation", columns, index=3)


def fit_table(run: Identification) -> Table:
    column = columns_of([(name, run.mle.fit[name], run.mle.lag1[name]) for name in run.mle.fit])
    columns = [
        column(lambda r: r[0], page=""),
        column(lambda r: r[1].r, page="correlation r", form=".4f"),
        column(lambda r: r[1].r2, page="R²", form=".3f"),
        column(lambda r: r[1].rmse, page="RMSE [-]", form=3),
        column(lambda r: r[1].theil, page="Theil U", form=".3f"),
        column(lambda r: r[2], page="lag-1 correlation\nof residuals", form="+.2f"),
    ]
    return table("fit", columns)


def sampler_table(run: Identification, key: str) -> Table:
    posterior, divergent = run.posteriors[key], ""
    column = columns_of([(n, posterior.marginals[n]) for n in ordered(posterior.names, run.mle.parameters)])
    if key == "nuts":
        stats = posterior.tree["sample_stats"].to_dataset() if "sample_stats" in posterior.tree.children else {}
        count = int(np.sum(np.asarray(stats["diverging"]))) if "diverging" in stats else "not recorded"
        divergent = f" Divergent transitions: {count}."
    columns = [
        column(lambda r: r[0], page=""),
        column(lambda r: r[1].rhat, page="R-hat", form=".4f"),
        column(lambda r: r[1].ess_bulk, page="bulk ESS", form=".0f"),
        column(lambda r: r[1].ess_tail, page="tail ESS", form=".0f"),
    ]
    about = {"engine": label_of(posterior.engine), "noise": label_of(posterior.noise)}
    return table("sampler", columns, **about, status=posterior.status.value, divergent=divergent)


def next_flight_table(run: Identification) -> Table:
    """A row for each parameter, SI and radians; ValueError if the run has not pooled its manoeuvres."""
    pooled = run.next_flight
    if pooled is None:
        raise ValueError("the manoeuvres of this run are not pooled")
    names = ordered(pooled.aircraft, pooled.parameters)
    one_by_one = len(pooled.manoeuvres) <= ONE_BY_ONE
    joint = estimates.bounds(run.mle, run.mle.crb_corrected)
    columns = [
        *parameter_columns(names, [unit_of(run, n) for n in names]),
        Column([joint[n] for n in names], ("joint", "joint_sd"), "joint"),
    ]
    for m in pooled.manoeuvres:
        alone = pooled.alone[m]
        single = [Estimate.normal(*alone[n]) if n in alone else None for n in names]
        for kind, values in (("alone", single), ("pooled", [Estimate.of(pooled.pooled[m][n]) for n in names])):
            columns.append(Column(values, (f"{m}_{kind}", f"{m}_{kind}_sd"), kind if one_by_one else None, group=m))
    for key, head, numbers, form in (
        ("aircraft", "aircraft", pooled.aircraft, ""),
        ("scatter", "scatter\n95 %", pooled.scatter, lambda e: f"{number(e.low, 2)} to {number(e.high, 2)}"),
        ("next_flight", "next flight\n95 %", pooled.following, lambda e: from_to(e.low, e.high, e.sd)),
    ):
        files = tuple(f"{key}_{part}".rstrip("_") for part in PARTS)
        values = [Estimate.of(numbers[n]) for n in names]
        columns.append(Column(values, files, head, form=form))
    narrowed = [pooled.narrowed[n] for n in names]
    columns.append(Column(narrowed, "scatter_over_prior", "scatter\nover prior", form=".2f"))
    return table("next_flight", columns)


def identification_page(
    run: Identification,
    source: Mapping[str, Any],
    figures: Mapping[str, Path],
    flown: Sequence[SimulatedManoeuvre] = (),
) -> Report:
    """The page, with the drawn `figures` by stem and the simulated manoeuvres, where there are any."""
    gallery = Gallery(figures, _captions(run))
    findings, pooled = estimates.verdict(run), run.next_flight is not None
    return Report(
        title=f"Identification: {run.card.title}",
        subtitle="Aerodynamic model identified from flight data, with uncertainty",
        verdict=identification_screen(run, run.card, run.records),
        lead=[
            parts.warnings(estimates.unfinished(run.posteriors)),
            gallery("stall") or gallery("crb_vs_credible"),
            "" if figures else WORDS["paragraphs"]["not_drawn"],
        ],
        sections=[
            section("findings", "Findings", lambda: (findings, parts.terms("glossary"))),
            parts.records_section(run.card, run.records, run.health),
            section("fit", "Measured and fitted", lambda: _fit(run)),
            section("simulated", "Measured and simulated", lambda: given_flights(flown, run.card)),
            section("stall", "The stall", lambda: _stall(run, gallery)),
            section("parameters", "Parameters", lambda: _parameters(run, gallery)),
            section("next-flight", "The next flight", lambda: next_flight_table(run) if pooled else None),
            section("prediction", "Prediction of hold-out data", lambda: _validation(run, gallery)),
            section("diagnostics", "Diagnostics", lambda: _diagnostics(run, gallery)),
            parts.provenance_section(source, run.notes, run.seconds),
        ],
    )


def _captions(run: Identification) -> dict[str, str]:
    captions = dict(WORDS["captions"])
    captions["fig2_gpr_fit"] = captions["fig2_gpr_fit"].format(several(run.mle.fit))
    for engine in run.posteriors:
        captions |= {f"{kind}_{engine}": captions[kind].format(label_of(engine)) for kind in ("trace", "rank")}
    captions |= {CORRELATIONS[c]: captions["correlation"].format(c) for c in run.mle.fit}
    return captions


def _fit(run: Identification) -> list[Any]:
    o, measured = run.observations, np.asarray(run.observations.measured)

    def drawn(order: int, _: str) -> tuple[np.ndarray, list[Panel]]:
        mine, panels = o.manoeuvre == order, []
        for i, coefficient in enumerate(o.coefficients):
            fitted = {"fitted (maximum likelihood)": run.fitted[mine, i]}
            panels.append(compared_panel(coefficient, "1", measured[mine, i], fitted))
        return o.time[mine], panels + parts.context_panels(o.signals, mine, lateral=Axis.LATERAL in run.model.axes)

    what = "Measured and fitted coefficients, and the manoeuvre flown,"
    return [WORDS["paragraphs"]["fit"], parts.flights(o.names, "fit", what, drawn), fit_table(run)]


def _stall(run: Identification, gallery: Gallery) -> tuple[Any, ...]:
    if all(effect.stage is not Stage.SEPARATION for effect in run.model.effects):
        return ("The card's model has no separation of the flow, and so no stall.",)
    if run.stall is None:
        why = "no posterior was sampled or the fit did not reach an optimum"
        return (f"CLmax and the stall angle are not given: {why}.",)
    label = f"{label_of(next(iter(estimates.chosen_posteriors(run))))}, {label_of(run.noise)} noise"
    return (
        parts.stall_table({label: run.stall}, "Intervals are those of the posterior."),
        "The figure at the top of the page shows lift, time spent at each angle of attack, and the drag polar.",
        gallery("separation") if "stall" in gallery.paths else gallery("stall", "separation"),
    )


def _parameters(run: Identification, gallery: Gallery) -> tuple[Any, ...]:
    return (
        parameter_table(run),
        parts.symbols(run.card, run.model.parameters, ordered(run.mle.names, run.mle.parameters)),
        gallery("crb_vs_credible", "forest"),  # the high one last: printed, it needs its own sheet
    )


def _validation(run: Identification, gallery: Gallery) -> tuple[Any, ...]:
    if run.gp is None:
        return ("There are no hold-out data: this run trained no Gaussian process.",)
    return (
        validation_table(run, each_fold=False),
        gallery("fig2_gpr_fit"),
        fold("Measured against predicted", gallery(*CORRELATIONS.values())),
    )


def _diagnostics(run: Identification, gallery: Gallery) -> list[Any]:
    mle, tables = run.mle, [sampler_table(run, key) for key in run.posteriors]
    drawn = gallery("rank_emcee", "rank_nuts", "trace_emcee", "trace_nuts") if tables else ()
    eigen = np.asarray(mle.eigenvalues)
    rank = {"rank": int(np.sum(eigen > 1e-11 * eigen.max())), "of": len(eigen), "least": eigen.min()}
    strong = [f"{a} and {b}: {r:+.3f}" for a, b, r in mle.strong_correlations()]
    return [
        fold("Calibration of the posterior's predictions", gallery("pit")),
        fold("Convergence of the samplers: R-hat, effective sample size, rank plots", tables, drawn),
        fold("Prior and posterior", gallery("prior_posterior", "pair", "gp_prior_posterior")),
        fold(
            "Identifiability: information matrix, correlated parameters",
            sentence("information", mle=mle, **rank),
            strong or "No two parameters are correlated beyond 0.9.",
        ),
    ]
