"""The page of a fit to trajectories: records, errors, parameters."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from bayes_aero.diagnosis.result import FITTED, Motion, ProcessNoise, Trajectories, TrajectoryFit
from bayes_aero.flight.card import Card
from bayes_aero.flight.channel import STANDARD_CHANNELS
from bayes_aero.inference.results import Posterior
from bayes_aero.report.colours import COLOURS
from bayes_aero.report.figures.time_histories import FLOWN, MET, MODELS, Curve, output_panels, stem_of
from bayes_aero.report.frequency import frequency_blocks
from bayes_aero.report.html import page as html
from bayes_aero.report.html.page import Block, Fold, Gallery, Text, bullets, page_table, section
from bayes_aero.report.html.plots import LOW, Line, Panel
from bayes_aero.report.tables import fly
from bayes_aero.report.text.fly import prediction_sentences, tolerance_origin
from bayes_aero.report.text.identification import unfinished
from bayes_aero.report.text.phrases import WORDS, amounts, for_people, several, symbol
from bayes_aero.units import number


@dataclass(frozen=True)
class FlyContext(html.PageContext):
    """What the page needs beside the fit: its sentences, the verdict first; process noise and motion, if any."""

    sentences: Sequence[str] = ()
    process_noise: ProcessNoise | None = None  # the same parameters by a filter
    posteriors: Mapping[str, Posterior] = field(default_factory=dict)  # of that, by sampler
    motion: Motion | None = None


def fly_page(flown: TrajectoryFit, context: FlyContext) -> html.Report:
    """The page; nothing on it but the fit's own numbers."""
    verdict, *rest = context.sentences
    motion = context.motion
    return html.Report(
        title=f"{'Flight path' if flown.of_path else 'Trajectories'}: {context.card.title}",
        subtitle="Errors of sensors, from recorded accelerations and rates"
        if flown.of_path
        else "A model fitted to trajectories by output error",
        verdict=verdict,
        doubts=html.doubts(context.health, context.consistency, corrects=False, failures=context.failures),
        lead=(_lead(flown), *_opening(flown, context.figures)),
        sections=html.filled(
            section("findings", "Findings", lambda: (*bullets([*rest, *context.notes]), html.terms("terms_of_fly"))),
            html.records_section(context.records, context.card, context.health),
            section("fit", "Measured and simulated", lambda: _flights(flown)),
            section("errors", "Errors", lambda: _errors(flown, context.card)),
            section("parameters", "Parameters", lambda: _parameters(flown, context)),
            section("frequency", "In the frequency domain", lambda: frequency_blocks(flown, context.figures)),
            section(
                "motion",
                "Modes of motion",
                lambda: [page_table(fly.mode_table(motion))] if motion and motion.modes else [],
            ),
            section("predictions", "One-step predictions", lambda: _predictions(flown, context)),
            section("posterior", "Posterior", lambda: _posterior(context)),
            html.provenance_section(context.source),
        ),
    )


def _lead(flown: TrajectoryFit) -> Block:
    """The gain at once: error at first values and of the fit, all manoeuvres together; a warning if it failed."""
    if not flown.converged:
        return Text("Do not use the numbers on this page: the fit stopped there without converging.", "warning")
    listed = []
    for output, pair in flown.rms_errors.items():
        before, after, unit = amounts(flown.units[output], *pair)
        listed.append(f"{symbol(output)} {before} → {after}{unit}".replace(" ", "\u00a0"))  # never broken
    return Text(f"Root-mean-square error of the simulation, first values → fit: {several(listed)}.", "lead")


def _opening(flown: TrajectoryFit, figures: Mapping[str, Path]) -> tuple[Block, ...]:
    """The output that the fit follows least: whose error is the largest share of its movement."""
    errors = {n: pair for n, pair in flown.rms_errors.items() if stem_of(n) in figures and pair[1] > 0.0}
    if not errors:
        return ()
    flights = [flown.path(name, FITTED).measured for name in flown.manoeuvres]
    moved = {n: float(np.sqrt(np.mean([np.var(flight[n]) for flight in flights]))) for n in errors}
    worst = max(errors, key=lambda n: errors[n][1] / max(moved[n], 1e-300))
    before, after, unit = amounts(flown.units[worst], *errors[worst])
    change = f"{before}{unit} with the first values, {after}{unit} as fitted"
    caption = f"{symbol(worst)}, which the fit follows least: measured and simulated."
    alt = f"Time histories of {worst}, measured and simulated. Root-mean-square error: {change}."
    return Gallery(figures, {stem_of(worst): (caption, alt)})(stem_of(worst))


def _flights(flown: TrajectoryFit) -> tuple[Block, ...]:
    shown, remark = html.first(flown.manoeuvres)
    units = {name: flown.units[name] for name in flown.outputs}
    plots = []
    for order, name in enumerate(shown):
        curves = [Curve(flown.path(name, model), *how) for model, *how in FLOWN]
        what = "Measured outputs, those simulated from the first values and by the fit, and the inputs"
        plots.append(over_measured(name, f"time-flown-{order}", curves, units, what, _inputs(flown, order)))
    free = flown.setting.initial is None
    what = "Recorded accelerations and rates" if flown.of_path else "The recorded inputs"
    text = (
        f"{what} drive the simulation, without correction by measurements: with the first values of the parameters "
        f"from the {'measured' if free else 'fixed'} initial state (dashed), and with "
        f"{'parameters and initial state' if free else 'parameters'} fitted. The error of the fit is shaded."
    )
    if any(error.tolerance is not None for path in flown.paths for error in path.errors.values()):
        text += " The grey band is the tolerance about the measurement."
    return (Text(text), *remark, *plots)


def _inputs(flown: TrajectoryFit, order: int) -> list[Panel]:
    """What drove the simulation and moved; states and outputs have panels already."""
    flights = flown.fit.flown.flights
    mine = flights.manoeuvre == order
    panels = []
    for name in flown.fit.flown.dynamics.inputs:
        unit = flown.units.get(name)
        if unit is None or name in flown.outputs or name not in flights.channels:
            continue
        shown, factor = for_people(unit)
        values = factor * np.asarray(flights.channels[name], float)[mine]
        if np.ptp(values) > 0.0:
            line = Line("measured", COLOURS["measured"], values)
            panels.append(Panel(symbol(name), shown, (line,), height=LOW))
    return panels


def _errors(flown: TrajectoryFit, card: Card) -> tuple[Block, ...]:
    kept, errors = fly.tolerance_table(flown), page_table(fly.error_table(flown))
    units = {name: flown.units[name] for name in flown.outputs}
    return (errors, *(() if kept is None else (page_table(kept), *sources(card, units))))


def _parameters(flown: TrajectoryFit, context: FlyContext) -> tuple[Block, ...]:
    """Every parameter with and without process noise, the gusts that were met, and the initial states."""
    parameters, found, tables = flown.fit.parameters, context.process_noise, [fly.parameter_table(flown)]
    if found is not None and found.converged:
        tables.append(fly.process_noise_table(found, flown, context.posteriors))
    gusts: tuple[Block, ...] = ()
    if found is not None and "gusts" in context.figures:
        pairs = [(name, mean) for h in found.histories for name, (mean, _) in h.gusts.items()]
        most = {name: float(np.max(np.abs(mean))) for name, mean in pairs}
        known = {name: MET.get(name, (name, "")) for name in most}
        sizes = several(f"{word} {most[name]:.2g} {unit}".rstrip() for name, (word, unit) in known.items())
        caption = (
            "Estimated gusts of each manoeuvre: mean and 95 % band, from all samples (Rauch-Tung-Striebel smoother)."
        )
        alt = f"Time histories of the gusts; largest in magnitude: {sizes}."
        gusts = Gallery(context.figures, {"gusts": (caption, alt)})("gusts")
    return (
        *map(page_table, tables),
        *gusts,
        html.symbols(parameters, [p.name for p in parameters], html.conventions(context.card)),
        page_table(fly.initial_table(flown)),
    )


def _predictions(flown: TrajectoryFit, context: FlyContext) -> tuple[Block, ...]:
    """Whether the filter's are calibrated: by output, in numbers and quantiles."""
    found = None if context.process_noise is None else context.process_noise.one_step
    if found is None:
        return ()
    caption = WORDS["captions"]["one_step"]
    by = several(
        f"{name} {100.0 * share.share:.0f} % in their {100.0 * share.level:.0f} % intervals"
        for name, one in found.outputs.items()
        for share in one.shares[-2:-1]
    )
    pictures = Gallery(context.figures, {"one_step": (caption, f"Quantile plots of innovations by output: {by}.")})
    table = page_table(fly.one_step_table(found, flown.units))
    return (*bullets(prediction_sentences(found)), table, *pictures("one_step"))


def _posterior(context: FlyContext) -> tuple[Block, ...]:
    """Marginals by both samplers, doubts of their chains first, and what varies together; nothing without."""
    if not context.posteriors:
        return ()
    caption = "Draws of the parameters with the largest correlations, and their marginal densities."
    return (
        *(Text(sentence, "warning") for sentence in unfinished(context.posteriors)),
        Text(WORDS["paragraphs"]["posterior"]),
        page_table(fly.posterior_table(context.posteriors)),
        *Gallery(context.figures, {"pair": (caption, f"Pair plot. {caption}")})("pair"),
    )


# --- Simulated trajectories on the page: errors before and after, and time histories with tolerance bands.

SPLITS = {
    "hold_out": "Hold-out: simulated from the measured initial state with the fit to the other flights",
    "fitted": "Fitted: parameters and initial states fitted to all flights",
}


def trajectories(flown: Trajectories, card: Card) -> tuple[Block, ...]:
    """Tables, then the hold-out flights, then the fitted ones, folded."""
    origin = tolerance_origin({name: t.value for name, t in card.tolerances.items()})
    unseen, fitted = (_flight_plots(flown, split) for split in ("hold_out", "fitted"))
    return (
        Text(f"{WORDS['paragraphs']['trajectories']} {origin}"),
        page_table(fly.hold_out_error_table(flown)),
        page_table(fly.hold_out_tolerance_table(flown)),
        *unseen,
        *([Fold("The same, fitted to all flights", fitted)] if fitted else []),
        *sources(card, {n: STANDARD_CHANNELS[n].unit for n in flown.outputs}),
    )


def sources(card: Card, units: Mapping[str, str]) -> tuple[Block, ...]:
    """Where the tolerances of outputs (by their SI units) come from; nothing where the card has none."""
    facts = tuple(
        (f"{symbol(n)} ± {number(factor * t.value)} {unit}", t.source)
        for n, t in card.tolerances.items()
        if n in units
        for unit, factor in (for_people(units[n]),)
    )
    return (Fold("Origin of the tolerances", (html.Facts(facts),)),) if facts else ()


def _flight_plots(flown: Trajectories, split: str) -> tuple[Block, ...]:
    shown, remark = html.first(list(dict.fromkeys(p.manoeuvre for p in flown.paths if p.split == split)))
    plots: list[Block] = [*remark]
    units = {name: STANDARD_CHANNELS[name].unit for name in flown.outputs}
    for order, name in enumerate(shown):
        curves = [Curve(p, *how) for key, *how in MODELS if (p := flown.path(name, key, split)) is not None]
        what = f"{SPLITS[split]}: measured and simulated outputs"
        plot = over_measured(name, f"time-{split}-{order}", curves, units, what)
        caption = f"{SPLITS[split]}. {plot.caption}"
        plots.append(replace(plot, caption=caption, title=f"{name}, {fly.SPLIT_NAMES[split]}"))
    return tuple(plots)


def over_measured(
    name: str, key: str, curves: Sequence[Curve], units: Mapping[str, str], what: str, context: Sequence[Panel] = ()
) -> html.Plot:
    """One manoeuvre: a panel for each output of `units` (SI), the last curve's error shaded; then `context`."""
    panels = output_panels(curves, units)
    legend = [
        html.MEASURED,
        *((c.label, c.colour, c.style) for c in curves),
        (f"error of the {curves[-1].label}", curves[-1].colour, "area"),
    ]
    if any(panel.band is not None for panel in panels):
        legend.append(("tolerance", "#999999", "area"))
    return html.histories(name, key, curves[0].path.time, [*panels, *context], tuple(legend), what)
