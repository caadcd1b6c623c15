"""What a diagnosis shows: tables of causes and candidates, both models side by side; its page."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, cast

import numpy as np
import pandas as pd

from bayes_aero.physics.aircraft import LATERAL
from bayes_aero.report.figures.diagnosis import coefficient_panels, telling
from bayes_aero.report.html.page import Gallery, Report, Section, Text, fold, section
from bayes_aero.report.pages import parts
from bayes_aero.report.pages.estimates import band_text
from bayes_aero.report.pages.findings import diagnosis_sentences, findings, in_band_sentences, sentences
from bayes_aero.report.pages.qualification import points_sentences, points_table
from bayes_aero.report.pages.trajectories import simulation_gain, trajectories, trajectory_sentences
from bayes_aero.report.phrases import (
    WORDS,
    bracket,
    filled,
    for_people,
    from_to,
    plain_unit,
    sentence,
    several,
    size_text,
)
from bayes_aero.report.table import (
    NONE,
    BeforeAfter,
    Column,
    Estimate,
    Table,
    columns_of,
    in_brackets,
    or_dash,
    parameter_columns,
    table,
)

if TYPE_CHECKING:
    from bayes_aero.diagnosis.result import Cause, CausesInBand, Diagnosis, DiagnosisView, HoldoutScores, Ranking, View

NOTES = WORDS["notes"]


# --- Tables: causes, changes, terms, candidates.

ON_A_TERMINAL = 3  # coefficients whose R² fit in 80 columns: those that change most


def causes_table(d: Diagnosis) -> Table:
    """A row for each cause, in files for each of its parameters, SI and radians, with scores on hold-out data."""
    column = columns_of(d.causes)

    def each(get: Callable[[Any], Any], *heads: Any, **how: Any) -> Column:
        return column(lambda c: [get(size) for size in c.parameters.values()], *heads, **how)

    def score(name: str, kind: str) -> Column:
        files = tuple(f"{name}_{kind}_{when}" for when in ("before", "after"))
        head = f"R² {name}" if kind == "r2" and name in shown else None
        return column(lambda c: _change(c, name, kind), files, None, head, ".2f")

    names = dict.fromkeys(name for c in d.causes for name in c.gain.before)
    shown: Sequence[str] = ()
    if d.by_coefficients:  # those whose R² any of the causes changes most
        pairs = {name: [x for c in d.causes if (x := _change(c, name, "r2")) is not None] for name in names}
        sizes = {n: [abs(b - a) for a, b in found if a is not None and b is not None] for n, found in pairs.items()}
        shown = sorted(names, key=lambda name: -max(map(float, np.nan_to_num(sizes[name])), default=0.0))
        shown = shown[:ON_A_TERMINAL]
    if_removed = "hold-out data\nif removed" if any(np.isfinite(c.missed[0]) for c in d.causes) else None
    rivals = "rivals", None if d.by_coefficients else "rivals"
    columns = [
        Column(range(1, len(d.causes) + 1), "order"),
        column(lambda c: c.name if c.sure else f"{c.name}{'†' if c.confirmed else '*'}", terminal="cause"),
        column(lambda c: c.name, "cause", "cause"),
        *(column(lambda c, key=key: getattr(c, key), key) for key in ("kind", "stage", "confirmed", "sure")),
        column(lambda c: c.claim, page="what it means", words=True),
        column(lambda c: list(c.parameters), "parameter"),
        column(_sizes, page="size"),
        each(lambda s: size_text(s.mean, s.sd, s.unit), terminal="size", words=True),
        each(lambda s: Estimate(s.mean, s.sd, *s.ci95), ("mean", "sd", "ci95_low", "ci95_high")),
        each(_interval, page="95 % interval"),
        each(lambda s: s.unit, "unit"),
        column(lambda c: c.probability, "probability", "probability", "prob.", probability),
        column(lambda c: c.p_value, "p_value", "p", form=2),
        column(lambda c: " ".join(c.ambiguous_with), "ambiguous_with"),
        column(lambda c: (c.gain.elpd, c.gain.elpd_se), ("elpd", "elpd_se")),
        column(lambda c: Estimate(-c.missed[0], c.missed[1]), ("taken_out_elpd", "taken_out_elpd_se")),
        column(lambda c: c, page=if_removed, form=_if_removed),
        column(lambda c: several(c.ambiguous_with), "", *rivals, or_dash, str),
        *(score(name, kind) for name in names for kind in ("r2", "rmse")),
    ]
    if d.by_coefficients:
        most = f"R² of the {len(shown)} coefficients that change most. " if 0 < len(shown) < len(names) else ""
        return table("causes", columns, split=WORDS["splits"][d.split], most=most)
    source = "innovations" if d.compared == "innovations" else "trajectories alone"
    unsure = "" if all(c.sure for c in d.causes) else NOTES["causes_flown"]
    return table("causes_flown", columns, source=source, unsure=unsure)


def _sizes(c: Cause) -> list[str]:
    """Sizes, with names where there are several."""
    texts = {name: size_text(s.mean, s.sd, s.unit).replace("c/V", "chords") for name, s in c.parameters.items()}
    return [f"{name} {text}" for name, text in texts.items()] if len(texts) > 1 else list(texts.values())


def _interval(s: Any) -> str:
    factor = for_people(s.unit)[1]
    return from_to(factor * s.ci95[0], factor * s.ci95[1], factor * s.sd)


def probability(value: float) -> str:
    """Two digits, never rounded to certainty."""
    return "> 0.99" if value > 0.99 else f"{value:.2f}"


def _if_removed(c: Cause) -> str:
    text = f"{-c.missed[0]:+z.1f} ± {c.missed[1]:.1f}" if np.isfinite(c.missed[0]) else NONE
    return text if c.confirmed else f"{text} *"


def _change(c: Cause, name: str, kind: str) -> BeforeAfter | None:
    """A score of a coefficient on hold-out data without and with a cause."""
    if name not in c.gain.before:
        return None
    return BeforeAfter(getattr(c.gain.before[name], kind), getattr(c.gain.after[name], kind))


def changes_table(d: Diagnosis) -> Table:
    """A row for each parameter that takes another value during the records, in files SI and radians."""
    column, parts_ = columns_of(d.changes), ("before", "after", "size")
    heads = {"before": "before", "after": "after", "size": "change"}
    columns = [
        column(lambda c: c.parameter, "parameter", "parameter", "parameter"),
        column(lambda c: c.unit, "unit"),
        column(lambda c: c.manoeuvre, "manoeuvre", "manoeuvre", "manoeuvre"),
        column(lambda c: c.at, "at", "at, s", "at, s", ".1f"),
        column(lambda c: BeforeAfter(*c.interval), ("at_low", "at_high")),
        column(lambda c: from_to(c.interval[0], c.interval[1], 0.5), page="95 % interval, s"),
        column(lambda c: c.lasts, "lasts"),
        *(column(lambda c, n=n: Estimate(*getattr(c, n)), (n, f"{n}_sd")) for n in parts_),
        *(
            column(lambda c, n=n: filled("{x:±{unit}}", x=getattr(c, n), unit=c.unit), page=head, terminal=head)
            for n, head in heads.items()
        ),
        column(lambda c: c.share, "share"),
        column(lambda c: c.p_value, "p_value", "p", "p", 2),
        column(lambda c: c.gain, "elpd", "hold-out gain", None, ".1f"),
        column(lambda c: several(c.ambiguous_with), "ambiguous_with", "rivals", "rivals", or_dash),
    ]
    return table("changes", columns)


def terms_table(d: Diagnosis) -> Table:
    """A row for each term that describes unexplained structure, in files SI and radians."""
    column, alike = columns_of(d.terms), lambda t: "; ".join(o.name for o, _ in t.others)
    columns = [
        column(lambda t: t.coefficient, "coefficient", "coefficient"),
        column(lambda t: t.term.name, "term", "term"),
        column(lambda t: t.term.unit, "unit"),
        column(lambda t: Estimate(*t.size), ("size", "size_sd")),
        column(lambda t: filled("{t.size:±{t.term.unit}}", t=t), page="factor"),
        column(lambda t: t.share, "share", "share left", form=".0%"),
        column(lambda t: t.gain, "elpd", "hold-out gain", None, ".1f"),
        column(lambda t: t.weight, "probability", "probability", form=".2f"),
        column(alike, "ambiguous_with", "as good", None, or_dash, words=True),
    ]
    return table("terms", columns)


def screen_table(rankings: Sequence[Ranking], d: Diagnosis) -> Table:
    """Every candidate of `rankings`: those of the first screening of each stage, the highest score first."""
    causes = {(c.stage, c.name) for c in d.causes}
    rows = [(r, s) for r in rankings for s in r.candidate_scores]
    limits = [r for r in rankings[:1] if np.isfinite(r.threshold)]
    beyond = "".join(f" Noise alone exceeds {r.threshold:.1f} in {100.0 * r.level:g} % of replicates." for r in limits)
    column = columns_of([s for _, s in rows])
    columns = [
        Column([r.stage for r, _ in rows], "stage", terminal="stage"),
        column(lambda s: s.effect, "name", "effect", "candidate"),
        column(lambda s: s.kind, "kind", "kind", words=True),
        column(lambda s: s.score, "score", "score", "score", ".1f"),
        column(lambda s: s.p_value, "p_value", "p", "p", ".3f"),
        Column(["yes" if (r.stage, s.effect) in causes else "" for r, s in rows], page="named"),
    ]
    return table("screen", columns, stage=rankings[0].stage if rankings else "", beyond=beyond)


# --- The card's and the extended model side by side: hold-out scores, parameters, residuals.


def scores_frame(found: HoldoutScores) -> pd.DataFrame:
    """A row for each model, fit, manoeuvre, coefficient: scores of 5 Hz means, and the gain of the extended model."""
    rows = []
    for (model, data, k), scores in sorted(found.scores.items()):
        for name, one in scores.items():
            row = {"model": model, "data": data, "manoeuvre": found.names[k], "coefficient": name}
            row |= {"r": one.r, "r2": one.r2, "rmse": one.rmse, "theil": one.theil}
            if (model, data) == ("extended", "hold_out"):
                gain = found.gains[found.names[k], name]
                row |= {"elpd_gain": gain.elpd, "elpd_gain_sd": gain.elpd_sd}
                row |= {"r2_gain": gain.r2, "r2_gain_sd": gain.r2_sd}
            rows.append(row)
    return pd.DataFrame(rows)


def gain_table(view: DiagnosisView) -> Table | None:
    """Scores of each coefficient on hold-out data; nothing where nothing was added."""
    if view.unseen_scores is None:
        return None
    names = list(view.unseen_scores[1])
    columns = [Column(names, page="coefficient")]
    for when, scores in zip(("before", "after"), view.unseen_scores, strict=True):
        columns.append(Column([scores[name].r2 for name in names], page=f"R² {when}", form=".3f"))
        columns.append(Column([scores[name].rmse for name in names], page=f"RMSE {when} [-]", form=".4f"))
    by_manoeuvre = view.diagnosis.split == "manoeuvre"
    what = "each manoeuvre predicted from the others" if by_manoeuvre else "each block from the others"
    return table("gain", columns, what=what)


def holdout_table(unseen: HoldoutScores) -> Table:
    """Both models on each hold-out manoeuvre, and whether the difference is significant."""
    rows = []
    for k, manoeuvre in enumerate(unseen.names):
        before, after = (unseen.scores[model, "hold_out", k] for model in ("card", "extended"))
        rows += [(manoeuvre, n, BeforeAfter(before[n].r2, after[n].r2), unseen.gains[manoeuvre, n]) for n in before]
    column = columns_of(rows)
    worse = several(f"{name} of {manoeuvre}" for manoeuvre, name in unseen.worse()) or "no manoeuvre"
    columns = [
        column(lambda r: r[0], page="manoeuvre"),
        column(lambda r: r[1], page="coefficient"),
        column(lambda r: r[2], page=("R²\ncard", "R²\nextended"), form=".3f"),
        column(lambda r: f"{r[3].r2:+z.3f} ± {r[3].r2_sd:.3f}", page="change of R²"),
        column(lambda r: f"{r[3].elpd:+z.1f} ± {r[3].elpd_sd:.1f}", page="log density\ngained"),
    ]
    return table("holdout", columns, worse=worse)


def moves_table(view: View) -> Table:
    """The card's own parameters before and after."""
    column = columns_of([(name, m, *for_people(m.unit)) for name, m in view.moves.items()])
    columns = [
        column(lambda r: f"{r[0]} {bracket(plain_unit(r[2]))}", page="parameter"),
        column(lambda r: Estimate(r[3] * r[1].before, r[3] * r[1].sd_before), page="card's model"),
        column(lambda r: Estimate(r[3] * r[1].after, r[3] * r[1].sd_after), page="extended model"),
        column(
            lambda r: (r[1].after - r[1].before) / r[1].sd_after if r[1].sd_after > 0.0 else None,
            page="change\n[standard errors]",
            form="+.1f",
        ),
    ]
    return table("moves", columns)


def residual_tables(view: View) -> tuple[Table, Table]:
    """Each coefficient's residuals before and after: scores, Theil's parts, autocorrelation; then calibration."""
    models = [("card's", view.card), *([("extended", view.extended)] if view.changed else [])]
    rows = [(f"{name}, {label}", fitted.composition[name]) for name in view.coefficients for label, fitted in models]
    column, first = columns_of([numbers for _, numbers in rows]), Column([label for label, _ in rows], page="")
    group = "Theil's shares of the squared error"
    shares = [
        column(lambda n, part=part: n[f"theil_{part}"], page=part, form=".0%", group=group)
        for part in ("bias", "variance", "covariance")
    ]
    levels = sorted({level for _, numbers in rows for level in numbers["calibration"]}, key=float)
    sizes = [
        first,
        column(lambda n: n["r2"], page="R²", form=".3f"),
        column(lambda n: n["rmse"], page="RMSE [-]", form=".4f"),
        column(lambda n: n["theil"], page="Theil U", form=".3f"),
        *shares,
        column(lambda n: n["lag1"], page="lag-1\ncorrelation", form="+.2f"),
    ]
    inside = [column(lambda n, x=x: n["calibration"][x], page=f"{100.0 * float(x):.0f} %", form=".0%") for x in levels]
    return table("residuals", sizes), table("calibration", [first, *inside])


# --- Sizes of the causes in a band of frequencies beside those of the coefficients: a table, and what it says.


def in_band_table(found: CausesInBand) -> Table:
    """A row for each parameter of a cause that the band shows, SI and radians."""
    sizes = found.sizes
    both = (([s.coefficients for s in sizes], "coefficients"), ([s.in_band for s in sizes], "in the band"))
    columns = [
        Column([s.cause for s in sizes], "cause", "cause"),
        *parameter_columns([s.parameter for s in sizes], [s.unit for s in sizes]),
        *(Column([Estimate.normal(*x) for x in values], page=head, form=in_brackets) for values, head in both),
        Column([s.apart for s in sizes], page="difference\n[standard errors]", form=".1f"),
    ]
    return table("in_band", columns, band=band_text(found))


# --- The page.

FIGURES = (
    "found", "ranking", "gain", "moves", "residual_profiles", "residual_colour", "stall_models", "separation_models",
    "measured_simulated",
)  # fmt: skip


def gained(view: View) -> str:
    """R² of each coefficient on hold-out data before and after, where it changes."""
    if view.unseen_scores is None:
        return ""
    first, last = view.unseen_scores
    pairs = {n: (f"{first[n].r2:.3f}", f"{last[n].r2:.3f}") for n in first if n in last}
    moved = {n: pair for n, pair in pairs.items() if pair[0] != pair[1]}
    return several(f"{n} R² from {before} to {after}" for n, (before, after) in moved.items()) + "." if moved else ""


CONTEXT = ("alpha", "elevator", "stabilizer", "thrust", "airspeed")
FROM_WHAT = {
    "coefficients": "",
    "trajectories": ", from trajectories alone: the record has no coefficients",
    "innovations": ", from innovations: process noise and gusts are estimated",
}
FEW = 4  # manoeuvres that are listed one by one in the open


@dataclass(frozen=True)
class DiagnosisContext(parts.PageContext):
    """Data of a diagnosis page in addition to the diagnosis."""

    test_points: Mapping[str, Any] = field(default_factory=dict)
    in_band: CausesInBand | None = None
    revealed: Sequence[str] = ()


def diagnosis_page(view: DiagnosisView, context: DiagnosisContext) -> Report:
    """The page of a diagnosis, by coefficients or by trajectories alone."""
    d, whole = view.diagnosis, cast("View | None", view if hasattr(view, "card") else None)
    by_coefficients = whole is not None
    captions, best = WORDS["captions"], None if whole is None else telling(whole)
    what = () if best is None else (best.quantity.replace("_", " "), best.manoeuvre)
    gallery = Gallery(context.figures, {stem: captions[stem].format(*what) for stem in FIGURES} if what else {})
    verdict, *rest = diagnosis_sentences(d) if by_coefficients else sentences(view)
    lead: list[Any] = [Text(one, "lead") for one in context.revealed]
    if whole is not None and gained(whole):
        lead.append(Text(f"On hold-out data, before and after: {gained(whole)}", "lead"))
    if view.trajectories is not None and (gain := simulation_gain(view.trajectories)):
        lead.append(Text(gain, "lead"))
    lead.append(gallery("found") or gallery("measured_simulated"))
    if d.compared == "trajectories":
        lead.append("The record lacks channels from which lift, drag and moment coefficients are formed.")
    elif by_coefficients and not context.figures:
        lead.append(WORDS["paragraphs"]["not_drawn"])
    return Report(
        title=f"Diagnosis: {context.card.title}",
        subtitle=f"The model error, its causes, and the gain of the extended model{FROM_WHAT[d.compared]}",
        verdict=verdict,
        lead=lead,
        doubts=parts.doubts(context.consistency, context.health, context.failures, corrects=by_coefficients),
        sections=[
            parts.records_section(context),
            section("causes", "Causes of the model error", lambda: _causes(view, context, gallery)),
            *(_flown_alone(view, context, rest) if whole is None else _by_coefficients(whole, context, gallery)),
            parts.provenance_section(context.source, context.notes),
        ],
    )


def _causes(view: DiagnosisView, context: DiagnosisContext, gallery: Gallery) -> list[Any]:
    d, band = view.diagnosis, context.in_band
    shared = "; rivals (last column) share it" if any(c.ambiguous_with for c in d.causes) else ""
    about = f"{WORDS['paragraphs']['causes']}{shared}.", causes_table(d)
    leaders = [replace(ranking, candidate_scores=ranking.leaders) for ranking in view.rankings]
    screens = [screen_table([ranking], d) for ranking in leaders]
    return [
        about if d.causes else "No cause is named.",
        sentence("minor", beside="", names=d.minor) if d.minor else None,
        parts.terms("glossary"),
        fold("Every candidate's score before anything was added", screens, gallery("ranking")),
        list(in_band_sentences(band)),
        in_band_table(band) if band is not None and band.sizes else None,
    ]


def _by_coefficients(view: View, context: DiagnosisContext, gallery: Gallery) -> list[Section]:
    d, labels = view.diagnosis, {"card": "card's model", "extended": "extended model"}

    def stall() -> tuple[Any, ...]:
        if not view.stalls:
            return ("CLmax and the stall angle are not given: no coefficients were formed.",)
        stalls = {labels[key]: s for key, s in view.stalls.items()}
        said = "Intervals are from normal draws with the covariance of the fit, autocorrelation included."
        return parts.stall_table(stalls, said), gallery("stall_models", "separation_models")

    def residuals() -> Any:
        title = "Residuals: size, composition, autocorrelation, calibration"
        return fold(title, residual_tables(view), gallery("residual_profiles", "residual_colour"))

    def moves() -> tuple[Any, ...]:
        known = parts.symbols(view.parameters, view.moves, degrees=True)
        return (moves_table(view), known, gallery("moves")) if view.moves else ()

    return [
        section("gain", "Gain of the extended model on hold-out data", lambda: _gain(view, gallery)),
        section("open", "Rivals and unexplained structure", lambda: _open(d, context)),
        section("fit", "Measured and simulated coefficients", lambda: _coefficients(view)),
        section("trajectories", "Trajectories, before and after", lambda: _flown(view, context)),
        section("stall", "The stall", stall),
        section("parameters", "Change of the card's parameters", moves),
        section("diagnostics", "Diagnostics", residuals),
    ]


def _flown_alone(view: DiagnosisView, context: DiagnosisContext, rest: Sequence[str]) -> list[Section]:
    """The sections of a diagnosis by trajectories alone or by innovations."""
    d = view.diagnosis
    reason = "without accelerometers lift is not measured"
    if d.compared == "innovations":
        reason = "a diagnosis by innovations forms no lift coefficient"
    full = (list(rest), parts.open_list(context.consistency), parts.not_testable_list(d.not_testable))
    return [
        section("open", "Findings in full", lambda: full),
        section("trajectories", "Trajectories, before and after", lambda: _flown(view, context)),
        section("stall", "The stall", lambda: f"CLmax and the stall angle are not given: {reason}."),
    ]


def _flown(view: DiagnosisView, context: DiagnosisContext) -> tuple[Any, ...]:
    if view.trajectories is None:
        return ("No trajectories were simulated in this run.",)
    remarks = trajectory_sentences(view.trajectories, tolerances=False)  # the table has those
    return trajectories(view.trajectories, context.card), remarks


def _gain(view: View, gallery: Gallery) -> tuple[Any, ...]:
    """Scores on hold-out data, then of the manoeuvres one by one, where they were scored; many are folded."""
    table = gain_table(view)
    if table is None:
        return ("Nothing was added, so there is no gain to report.",)
    each = None if view.holdout is None else holdout_table(view.holdout)
    return table, fold("The same, manoeuvre by manoeuvre", each) if len(view.names) > FEW else each, gallery("gain")


def _open(d: Diagnosis, context: DiagnosisContext) -> list[Any]:
    said, points = findings(d), context.test_points
    sets = [f"{c.name} or {several(c.ambiguous_with)}" for c in d.causes if c.ambiguous_with]
    rivals = f"Rival explanations on this record: {'; '.join(sets)}."
    structure = ("beyond", "unexplained", "terms", "changes")
    apart = {"verdict", "causes", "cancelling", *structure}
    others = [s for kind, listed in said.items() if kind not in apart for s in listed]
    sensors = context.consistency
    return [
        rivals if sets else "No named cause has a rival on this record.",
        said["cancelling"],
        list(points_sentences(points)),
        points_table(points) if points and points["points"] else None,
        None if sensors is None else (parts.open_sentences(sensors), parts.open_list(sensors)),
        [s for kind in structure for s in said[kind]] or "No structure remains that a recorded channel predicts.",
        terms_table(d) if d.terms else None,
        changes_table(d) if d.changes else None,
        fold("Noise, and effects that this record cannot test", others or "None."),
        parts.not_testable_list(d.not_testable),
    ]


def _coefficients(view: View) -> list[Any]:
    shown, more = parts.first(view.names)
    context = parts.SIX_CONTEXT if set(LATERAL) & set(view.coefficients) else CONTEXT
    what, plots = "Coefficients measured and simulated by the card's and the extended model, and the controls,", []
    for order, name in enumerate(shown):
        mine, panels = view.manoeuvre == order, coefficient_panels(view, order)
        last = panels[0].lines[-1]
        curves = [(line.label, line.colour, line.style) for line in panels[0].lines]
        legend = (*curves, (f"error of the {last.label}", last.colour, "area"))
        moved = {c: np.asarray(view.channels[c], float)[mine] for c in context if c in view.channels}
        panels += parts.context_panels({c: values for c, values in moved.items() if np.ptp(values) > 0.0})
        plots.append(parts.histories(name, f"time-coefficients-{order}", view.time[mine], panels, legend, what))
    return [WORDS["paragraphs"]["coefficients"], more, plots]
