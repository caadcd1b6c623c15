"""The page of a diagnosis: causes, sizes, gains, rivals, unexplained structure."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from bayes_aero.diagnosis.result import (
    COEFFICIENTS,
    INNOVATIONS,
    TRAJECTORIES,
    CausesInBand,
    Diagnosis,
    DiagnosisView,
    Ranking,
    View,
)
from bayes_aero.physics.aircraft import LATERAL
from bayes_aero.report import design
from bayes_aero.report.figures.diagnosis import coefficient_panels
from bayes_aero.report.html import page as html
from bayes_aero.report.html.page import Block, Fold, Gallery, Section, Text, bullets, page_table, section
from bayes_aero.report.pages.captions import diagnosis_alternatives, gained, stall_table
from bayes_aero.report.pages.fly import trajectories
from bayes_aero.report.tables import diagnosis_tables
from bayes_aero.report.text.check import open_sentences
from bayes_aero.report.text.diagnosis import diagnosis_sentences, findings, sentences
from bayes_aero.report.text.fly import simulation_gain, trajectory_sentences
from bayes_aero.report.text.phrases import WORDS, several

CONTEXT = ("alpha", "elevator", "stabilizer", "thrust", "airspeed")
SIX_CONTEXT = ("alpha", "beta", "elevator", "aileron", "rudder", "p")
FROM_WHAT = {
    COEFFICIENTS: "",
    TRAJECTORIES: ", from trajectories alone: the record has no coefficients",
    INNOVATIONS: ", from innovations: process noise and gusts are estimated",
}
FEW = 4  # manoeuvres that are listed one by one in the open
INTERVALS = "Intervals are from normal draws with the covariance of the fit, autocorrelation included."


@dataclass(frozen=True)
class DiagnosisContext(html.PageContext):
    """Data of a diagnosis page in addition to the diagnosis."""

    test_points: Mapping[str, Any] = field(default_factory=dict)
    in_band: CausesInBand | None = None
    revealed: Sequence[str] = ()


def diagnosis_page(view: DiagnosisView, context: DiagnosisContext) -> html.Report:
    """The page of a diagnosis, by coefficients or by trajectories alone."""
    d, by_coefficients = view.diagnosis, isinstance(view, View)
    gallery = Gallery(context.figures, diagnosis_alternatives(view) if isinstance(view, View) else {})
    verdict, *rest = diagnosis_sentences(d) if by_coefficients else sentences(view)
    return html.Report(
        title=f"Diagnosis: {context.card.title}",
        subtitle=f"The model error, its causes, and the gain of the extended model{FROM_WHAT[d.compared]}",
        verdict=verdict,
        lead=_lead(view, context, gallery),
        doubts=html.doubts(context.health, context.consistency, corrects=by_coefficients, failures=context.failures),
        sections=html.filled(
            html.records_section(context.records, context.card, context.health),
            section(
                "causes",
                "Causes of the model error",
                lambda: (*_causes(d, view.rankings, gallery), *design.in_band_blocks(context.in_band)),
            ),
            *_sections(view, context, gallery, rest),
            section("provenance", "Provenance", lambda: html.provenance_blocks(context.source, context.notes)),
        ),
    )


def _lead(view: DiagnosisView, context: DiagnosisContext, gallery: Gallery) -> tuple[Block, ...]:
    """What was hidden, if anything was; what the extension gains; the first figure."""
    lead: list[Block] = [Text(one, "lead") for one in context.revealed]
    if isinstance(view, View) and gained(view):
        lead.append(Text(f"On hold-out data, before and after: {gained(view)}", "lead"))
    if view.trajectories is not None and (gain := simulation_gain(view.trajectories)):
        lead.append(Text(gain, "lead"))
    lead += gallery("found") or gallery("measured_simulated")
    if view.diagnosis.compared == TRAJECTORIES:
        lead.append(Text("The record lacks channels from which lift, drag and moment coefficients are formed."))
    elif isinstance(view, View) and not context.figures:
        lead.append(html.NOT_DRAWN)
    return tuple(lead)


def _sections(
    view: DiagnosisView, context: DiagnosisContext, gallery: Gallery, rest: Sequence[str]
) -> tuple[Section, ...]:
    """Those that depend on what the diagnosis compared: coefficients, or trajectories alone or innovations."""

    def flown() -> tuple[Block, ...]:
        if view.trajectories is None:
            return (Text("No trajectories were simulated in this run."),)
        remarks = trajectory_sentences(view.trajectories, tolerances=False)  # the table has those
        return (*trajectories(view.trajectories, context.card), *bullets(remarks))

    both = section("trajectories", "Trajectories, before and after", flown)
    d, no_lift = view.diagnosis, "CLmax and the stall angle are not given"
    if isinstance(view, View):
        labels = {"card": "card's model", "extended": "extended model"}

        def stall() -> tuple[Block, ...]:
            if not view.stalls:
                return (Text(f"{no_lift}: no coefficients were formed."),)
            stalls = {labels[key]: s for key, s in view.stalls.items()}
            return (*stall_table(stalls, INTERVALS), *gallery("stall_models", "separation_models"))

        def residuals() -> tuple[Block, ...]:
            pictures = gallery("residual_profiles", "residual_colour")
            title = "Residuals: size, composition, autocorrelation, calibration"
            return (Fold(title, (*map(page_table, diagnosis_tables.residual_tables(view)), *pictures)),)

        def moves() -> tuple[Block, ...]:
            known = html.symbols(view.parameters, view.moves, degrees=True)
            return (page_table(diagnosis_tables.moves_table(view)), known, *gallery("moves")) if view.moves else ()

        return (
            section("gain", "Gain of the extended model on hold-out data", lambda: _gain(view, gallery)),
            section("open", "Rivals and unexplained structure", lambda: _open(d, context)),
            section("fit", "Measured and simulated coefficients", lambda: _coefficients(view)),
            both,
            section("stall", "The stall", stall),
            section("parameters", "Change of the card's parameters", moves),
            section("diagnostics", "Diagnostics", residuals),
        )
    listed = () if context.consistency is None else html.open_list(context.consistency)
    reason = "without accelerometers lift is not measured"
    if d.compared == INNOVATIONS:
        reason = "a diagnosis by innovations forms no lift coefficient"
    return (
        section("open", "Findings in full", lambda: (*bullets(rest), *listed, *html.not_testable_list(d.not_testable))),
        both,
        section("stall", "The stall", lambda: (Text(f"{no_lift}: {reason}."),)),
    )


def _causes(d: Diagnosis, rankings: Sequence[Ranking], gallery: Gallery) -> tuple[Block, ...]:
    blocks: list[Block] = [Text("No cause is named.")]
    if d.causes:
        shared = "; rivals (last column) share it" if any(c.ambiguous_with for c in d.causes) else ""
        blocks = [Text(f"{WORDS['paragraphs']['causes']}{shared}."), page_table(diagnosis_tables.causes_table(d))]
    if d.minor:
        verb = "were" if len(d.minor) > 1 else "was"
        blocks.append(Text(f"Too small to be named: {several(d.minor)} {verb} in the model during the selection."))
    leaders = [replace(ranking, candidate_scores=ranking.leaders) for ranking in rankings]
    listed = [page_table(diagnosis_tables.screen_table([ranking], d)) for ranking in leaders]
    title = "Every candidate's score before anything was added"
    return (*blocks, html.terms("glossary"), Fold(title, (*listed, *gallery("ranking"))))


def _gain(view: View, gallery: Gallery) -> tuple[Block, ...]:
    """Scores on hold-out data, then of the manoeuvres one by one, where they were scored; many are folded."""
    table = diagnosis_tables.gain_table(view)
    if table is None:
        return (Text("Nothing was added, so there is no gain to report."),)
    each: list[Block] = [] if view.holdout is None else [page_table(diagnosis_tables.holdout_table(view.holdout))]
    if each and len(view.names) > FEW:
        each = [Fold("The same, manoeuvre by manoeuvre", tuple(each))]
    return (page_table(table), *each, *gallery("gain"))


def _open(d: Diagnosis, context: DiagnosisContext) -> tuple[Block, ...]:
    said = findings(d)
    sets = [f"{c.name} or {several(c.ambiguous_with)}" for c in d.causes if c.ambiguous_with]
    rivals = f"Rival explanations on this record: {'; '.join(sets)}."
    blocks: list[Block] = [Text(rivals if sets else "No named cause has a rival on this record.")]
    blocks += [*bullets(said["cancelling"]), *design.test_point_blocks(context.test_points)]
    if context.consistency is not None:
        blocks += [*bullets(open_sentences(context.consistency)), *html.open_list(context.consistency)]
    structure = ("beyond", "unexplained", "terms", "changes")
    unexplained = bullets([s for kind in structure for s in said[kind]])
    blocks += unexplained or (Text("No structure remains that a recorded channel predicts."),)
    blocks += [page_table(diagnosis_tables.terms_table(d))] if d.terms else []
    blocks += [page_table(diagnosis_tables.changes_table(d))] if d.changes else []
    apart = {"verdict", "causes", "cancelling", *structure}
    others = bullets([s for kind, listed in said.items() if kind not in apart for s in listed]) or (Text("None."),)
    blocks.append(Fold("Noise, and effects that this record cannot test", others))
    return (*blocks, *html.not_testable_list(d.not_testable))


def _coefficients(view: View) -> tuple[Block, ...]:
    shown, more = html.first(view.names)
    plots: list[Block] = [*more]
    context = SIX_CONTEXT if set(LATERAL) & set(view.coefficients) else CONTEXT
    what = "Coefficients measured and simulated by the card's and the extended model, and the controls,"
    for number, name in enumerate(shown):
        mine, panels = view.manoeuvre == number, coefficient_panels(view, number)
        last = panels[0].lines[-1]
        curves = [(line.label, line.colour, line.style) for line in panels[0].lines]
        legend = (*curves, (f"error of the {last.label}", last.colour, "area"))
        moved = {c: np.asarray(view.channels[c], float)[mine] for c in context if c in view.channels}
        panels += html.context_panels({c: values for c, values in moved.items() if np.ptp(values) > 0.0})
        plots.append(html.histories(name, f"time-coefficients-{number}", view.time[mine], panels, legend, what))
    text = WORDS["paragraphs"]["coefficients"]
    return (Text(text), *plots)
