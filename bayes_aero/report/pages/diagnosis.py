"""The page of a diagnosis: causes, sizes, gains, rivals, unexplained structure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from bayes_aero.diagnosis.result import COEFFICIENTS, INNOVATIONS, TRAJECTORIES, Diagnosis
from bayes_aero.diagnosis.trajectories.results import Trajectories
from bayes_aero.diagnosis.view.results import DiagnosisView, Ranking, View
from bayes_aero.physics.coefficient_names import LATERAL
from bayes_aero.report.colours import COLOURS
from bayes_aero.report.design import in_band_blocks, test_point_blocks
from bayes_aero.report.figures.time_histories import SYMBOLS, shown_in
from bayes_aero.report.html.page import (
    Block,
    Fold,
    Page,
    Section,
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
from bayes_aero.report.html.parts import WORDS, not_testable_list, open_list, page_table
from bayes_aero.report.html.pictures import Gallery
from bayes_aero.report.html.plots import LOW, Line, Panel
from bayes_aero.report.page_context import PageContext
from bayes_aero.report.pages.captions import diagnosis_alternatives, gained, stall_table
from bayes_aero.report.pages.fly import trajectories
from bayes_aero.report.tables.across_cases import gain_table, holdout_table, moves_table, residual_tables
from bayes_aero.report.tables.diagnosis_tables import causes_table, changes_table, screen_table, terms_table
from bayes_aero.report.text.check import open_sentences
from bayes_aero.report.text.diagnosis import diagnosis_sentences, sentences
from bayes_aero.report.text.fly import simulation_gain, trajectory_sentences
from bayes_aero.report.text.phrases import bracket, several

CONTEXT = ("alpha", "elevator", "stabilizer", "thrust", "airspeed")
SIX_CONTEXT = ("alpha", "beta", "elevator", "aileron", "rudder", "p")
FROM_WHAT = {
    COEFFICIENTS: "",
    TRAJECTORIES: ", from trajectories alone: the record has no coefficients",
    INNOVATIONS: ", from innovations: process noise and gusts are estimated",
}
FEW = 4  # manoeuvres that are listed one by one in the open


def diagnosis_page(view: DiagnosisView, context: PageContext) -> Page:
    """The page of a diagnosis, by coefficients or by trajectories alone."""
    d, by_coefficients = view.diagnosis, isinstance(view, View)
    gallery = Gallery(context.figures, diagnosis_alternatives(view) if isinstance(view, View) else {})
    verdict, *rest = diagnosis_sentences(d) if by_coefficients else sentences(view)
    from_what = FROM_WHAT[d.compared]
    return Page(
        title=f"Diagnosis: {context.card.title}",
        subtitle=f"The model error, its causes, and the gain of the extended model{from_what}",
        verdict=verdict,
        lead=_lead(view, context, gallery),
        doubts=doubts(context.health, context.consistency, corrects=by_coefficients, failures=context.failures),
        sections=filled(
            section(
                "records",
                "The records at a glance",
                lambda: records_and_faults(context.records, context.card, context.health),
            ),
            section(
                "causes",
                "Causes of the model error",
                lambda: (*_causes(d, view.rankings, gallery), *in_band_blocks(context.in_band)),
            ),
            *(
                _of_coefficients(view, context, gallery, rest)
                if isinstance(view, View)
                else _findings(view, context, rest)
            ),
            section("provenance", "Provenance", lambda: provenance_blocks(context.source, context.notes)),
        ),
    )


def _lead(view: DiagnosisView, context: PageContext, gallery: Gallery) -> tuple[Block, ...]:
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
        lead.append(Text("Static pictures were not drawn in this run; tables and interactive figures are complete."))
    return tuple(lead)


def _of_coefficients(view: View, context: PageContext, gallery: Gallery, rest: Sequence[str]) -> tuple[Section, ...]:
    """Sections of a diagnosis by coefficients."""
    return (
        section("gain", "Gain of the extended model on hold-out data", lambda: _gain(view, gallery)),
        section("open", "Rivals and unexplained structure", lambda: _open(view.diagnosis, context, rest)),
        section("fit", "Measured and simulated coefficients", lambda: _coefficients(view)),
        section("trajectories", "Trajectories, before and after", lambda: _flown(view.trajectories, context)),
        section("stall", "The stall", lambda: _stall(view, gallery)),
        section("parameters", "Change of the card's parameters", lambda: _parameters(view, gallery)),
        section("diagnostics", "Diagnostics", lambda: _diagnostics(view, gallery)),
    )


def _findings(view: DiagnosisView, context: PageContext, rest: Sequence[str]) -> tuple[Section, ...]:
    """Sections of a diagnosis by trajectories alone or innovations."""
    listed = () if context.consistency is None else open_list(context.consistency)
    reason = "without accelerometers lift is not measured"
    if view.diagnosis.compared == INNOVATIONS:
        reason = "a diagnosis by innovations forms no lift coefficient"
    no_lift = f"CLmax and the stall angle are not given: {reason}."
    return (
        section(
            "open",
            "Findings in full",
            lambda: (*bullets(rest), *listed, *not_testable_list(view.diagnosis.not_testable)),
        ),
        section("trajectories", "Trajectories, before and after", lambda: _flown(view.trajectories, context)),
        section("stall", "The stall", lambda: (Text(no_lift),)),
    )


def _causes(d: Diagnosis, rankings: Sequence[Ranking], gallery: Gallery) -> tuple[Block, ...]:
    blocks: list[Block] = []
    shared = any(c.ambiguous_with for c in d.causes)
    if d.causes:
        blocks += [
            Text(
                "Each cause is one effect of the catalogue that the card's model lacks. Sizes are estimates with one "
                "standard error. The probability is that of the effect being present"
                + ("; rivals (last column) share it." if shared else ".")
            ),
            page_table(causes_table(d)),
        ]
    else:
        blocks.append(Text("No cause is named."))
    if d.minor:
        verb = "were" if len(d.minor) > 1 else "was"
        text = f"{several(d.minor)} {verb} in the model during the selection"
        blocks.append(Text(f"Too small to be named: {text}."))
    leaders = [replace(ranking, candidate_scores=ranking.leaders) for ranking in rankings]
    listed = [page_table(screen_table([ranking], d)) for ranking in leaders]
    blocks += [WORDS, Fold("Every candidate's score before anything was added", (*listed, *gallery.folded("ranking")))]
    return tuple(blocks)


def _gain(view: View, gallery: Gallery) -> tuple[Block, ...]:
    table = gain_table(view)
    if table is None:
        return (Text("Nothing was added, so there is no gain to report."),)
    return (
        page_table(table),
        *_each(view),
        *gallery("gain"),
    )


def _each(view: View) -> tuple[Block, ...]:
    """The manoeuvres one by one, where they were scored; many are folded."""
    if view.holdout is None:
        return ()
    table = page_table(holdout_table(view.holdout))
    return (table,) if len(view.names) <= FEW else (Fold("The same, manoeuvre by manoeuvre", (table,)),)


def _open(d: Diagnosis, context: PageContext, rest: Sequence[str]) -> tuple[Block, ...]:
    blocks: list[Block] = []
    sets = [f"{c.name} or {several(c.ambiguous_with)}" for c in d.causes if c.ambiguous_with]
    if sets:
        blocks.append(Text(f"Rival explanations on this record: {'; '.join(sets)}."))
    else:
        blocks.append(Text("No named cause has a rival on this record."))
    pairs = [one for one in rest if " cancel each other " in one]
    blocks += [*bullets(pairs), *test_point_blocks(context.test_points)]
    if context.consistency is not None:
        blocks += [*bullets(open_sentences(context.consistency)), *open_list(context.consistency)]
    unknown = [one for one in rest if one.startswith(("Unexplained", "Form", "Changed", "The estimate of"))]
    blocks += bullets(unknown) or (Text("No structure remains that a recorded channel predicts."),)
    blocks += [page_table(terms_table(d))] if d.terms else []
    blocks += [page_table(changes_table(d))] if d.changes else []
    others = [s for s in rest if s not in (*unknown, *pairs) and not any(s.startswith(f"{c.name}: ") for c in d.causes)]
    blocks.append(Fold("Noise, and effects that this record cannot test", bullets(others) or (Text("None."),)))
    blocks += not_testable_list(d.not_testable)
    return tuple(blocks)


def _coefficients(view: View) -> tuple[Block, ...]:
    models = [("card's model", COLOURS["before"], view.card, "dashed")]
    if view.changed:
        models.append(("extended model", COLOURS["after"], view.extended, "solid"))
    legend = (
        ("measured", COLOURS["measured"], "solid"),
        *((label, colour, style) for label, colour, _, style in models),
        (f"error of the {models[-1][0]}", models[-1][1], "area"),
    )
    shown, more = first(view.names)
    plots: list[Block] = [*more]
    for number, name in enumerate(shown):
        mine = view.manoeuvre == number
        panels = []
        for c, coefficient in enumerate(view.coefficients):
            z = view.measured[mine, c]
            lines = [Line("measured", COLOURS["measured"], z, width=1.0)]
            lines += [Line(label, colour, z - f.residual[mine, c], style) for label, colour, f, style in models]
            panels.append(Panel(f"{coefficient} [-]", tuple(lines), shade=((0, len(models)),)))
        for channel in SIX_CONTEXT if set(LATERAL) & set(view.coefficients) else CONTEXT:
            if channel in view.channels and np.ptp(np.asarray(view.channels[channel])[mine]) > 0.0:
                unit, factor = shown_in(channel)
                values = factor * np.asarray(view.channels[channel], float)[mine]
                label = f"{SYMBOLS.get(channel, channel)} {bracket(unit)}"
                panels.append(Panel(label, (Line("measured", COLOURS["measured"], values),), height=LOW))
        what = "Coefficients measured and simulated by the card's and the extended model, and the controls,"
        plots.append(histories(name, f"time-coefficients-{number}", view.time[mine], panels, legend, what))
    return (
        Text(
            "Coefficients of forces and moments from the accelerometers and rate gyros, and both models "
            "fitted to all "
            "manoeuvres. The error of the extended model is shaded."
        ),
        *plots,
    )


def _flown(flown: Trajectories | None, context: PageContext) -> tuple[Block, ...]:
    if flown is None:
        return (Text("No trajectories were simulated in this run."),)
    remarks = [s for s in trajectory_sentences(flown) if "within tolerance" not in s]  # the table has those
    return (*trajectories(flown, context.card), *bullets(remarks))


def _stall(view: View, gallery: Gallery) -> tuple[Block, ...]:
    if not view.stalls:
        return (Text("CLmax and the stall angle are not given: no coefficients were formed."),)
    labels = {"card": "card's model", "extended": "extended model"}
    what = "Intervals are from normal draws with the covariance of the fit, autocorrelation included."
    return (
        *stall_table({labels[key]: s for key, s in view.stalls.items()}, what),
        *gallery("stall_models", "separation_models"),
    )


def _parameters(view: View, gallery: Gallery) -> tuple[Block, ...]:
    if not view.moves:
        return ()
    return (page_table(moves_table(view)), symbols(view.parameters, view.moves, degrees=True), *gallery("moves"))


def _diagnostics(view: View, gallery: Gallery) -> tuple[Block, ...]:
    return (
        Fold(
            "Residuals: size, composition, autocorrelation, calibration",
            (*map(page_table, residual_tables(view)), *gallery.folded("residual_profiles", "residual_colour")),
        ),
    )
