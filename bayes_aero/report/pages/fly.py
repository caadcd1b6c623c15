"""The page of a fit to trajectories: records, errors, parameters."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from bayes_aero.diagnosis.trajectories.results import (
    FITTED,
    START,
    Motion,
    ProcessNoise,
    SimulatedManoeuvre,
    Trajectories,
    TrajectoryFit,
)
from bayes_aero.flight.agreement import Consistency
from bayes_aero.flight.card.card import Card
from bayes_aero.flight.channel import STANDARD_CHANNELS
from bayes_aero.flight.health import HealthFinding
from bayes_aero.flight.record import FlightRecord
from bayes_aero.inference.posterior.posterior import Posterior
from bayes_aero.report.colours import COLOURS
from bayes_aero.report.figures.time_histories import stem_of
from bayes_aero.report.frequency import frequency_blocks
from bayes_aero.report.html.page import (
    Block,
    Facts,
    Fold,
    Page,
    Plot,
    Text,
    bullets,
    conventions,
    doubts,
    filled,
    first,
    histories,
    provenance_blocks,
    records_and_faults,
    section,
    symbols,
)
from bayes_aero.report.html.parts import FLOWN, page_table, words
from bayes_aero.report.html.pictures import Gallery
from bayes_aero.report.html.plots import LOW, Line, Panel
from bayes_aero.report.motion import mode_table
from bayes_aero.report.tables import fly
from bayes_aero.report.tables.fly import (
    SPLIT_NAMES,
    hold_out_error_table,
    hold_out_tolerance_table,
    one_step_table,
    posterior_table,
    process_noise_table,
)
from bayes_aero.report.text.fly import prediction_sentences, tolerance_origin
from bayes_aero.report.text.phrases import GREEK, axis_label, for_people, several, short
from bayes_aero.report.text.restraints import unfinished
from bayes_aero.units import number

MODELS = (
    (START, "first values", COLOURS["before"], "dashed"),
    (FITTED, "fitted model", COLOURS["after"], "solid"),
)


@dataclass(frozen=True)
class FlyContext:
    """What the page needs beside the fit: its sentences, the verdict first, and its notes."""

    card: Card
    records: Sequence[FlightRecord]
    source: Mapping[str, Any]
    sentences: Sequence[str]
    notes: Sequence[str] = ()
    figures: Mapping[str, Path] = field(default_factory=dict)  # those drawn, by stem
    consistency: Consistency | None = None
    failures: Sequence[str] = ()  # parts that failed unexpectedly
    health: Sequence[HealthFinding] = ()  # what is wrong with channels
    process_noise: ProcessNoise | None = None  # the same parameters by a filter
    posteriors: Mapping[str, Posterior] = field(default_factory=dict)  # of that, by sampler
    motion: Motion | None = None


def fly_page(flown: TrajectoryFit, context: FlyContext) -> Page:
    """The page; nothing on it but the fit's own numbers."""
    verdict, *rest = context.sentences
    return Page(
        title=f"{'Flight path' if flown.of_path else 'Trajectories'}: {context.card.title}",
        subtitle="Errors of sensors, from recorded accelerations and rates"
        if flown.of_path
        else "A model fitted to trajectories by output error",
        verdict=verdict,
        doubts=doubts(context.health, context.consistency, corrects=False, failures=context.failures),
        lead=(*_lead(flown), *_opening(flown, context.figures)),
        sections=filled(
            section("findings", "Findings", lambda: (*bullets([*rest, *context.notes]), words(FLOWN))),
            section(
                "records",
                "The records at a glance",
                lambda: records_and_faults(context.records, context.card, context.health),
            ),
            section("fit", "Measured and simulated", lambda: _flights(flown)),
            section("errors", "Errors", lambda: _errors(flown, context.card)),
            section("parameters", "Parameters", lambda: _parameters(flown, context)),
            section("frequency", "In the frequency domain", lambda: frequency_blocks(flown, context.figures)),
            section("motion", "Modes of motion", lambda: _motion(context.motion)),
            section("predictions", "One-step predictions", lambda: _predictions(flown, context)),
            section("posterior", "Posterior", lambda: _posterior(context)),
            section("provenance", "Provenance", lambda: _provenance(context.source)),
        ),
    )


def _lead(flown: TrajectoryFit) -> tuple[Block, ...]:
    """The gain at once: error at first values and of the fit, all manoeuvres together; a warning if it failed."""
    if not flown.converged:
        return (Text("Do not use the numbers on this page: the fit stopped there without converging.", "warning"),)
    listed = []
    for output, (before, after) in flown.rms_errors.items():
        unit, factor = for_people(flown.units[output])
        item = f"{GREEK.get(output, output)} {short(factor * before)} → {short(factor * after)} {unit}"
        listed.append(item.replace(" ", "\u00a0"))  # never broken in the middle
    return (Text(f"Root-mean-square error of the simulation, first values → fit: {several(listed)}.", "lead"),)


def _opening(flown: TrajectoryFit, figures: Mapping[str, Path]) -> tuple[Block, ...]:
    """The output that the fit follows least: whose error is the largest share of its movement."""
    errors = {n: pair for n, pair in flown.rms_errors.items() if stem_of(n) in figures and pair[1] > 0.0}
    if not errors:
        return ()
    flights = [flown.path(name, FITTED).measured for name in flown.manoeuvres]
    moved = {n: float(np.sqrt(np.mean([np.var(flight[n]) for flight in flights]))) for n in errors}
    worst = max(errors, key=lambda n: errors[n][1] / max(moved[n], 1e-300))
    (before, after), (unit, factor) = errors[worst], for_people(flown.units[worst])
    change = f"{short(factor * before)} {unit} with the first values, {short(factor * after)} {unit} as fitted"
    caption = f"{GREEK.get(worst, worst)}, which the fit follows least: measured and simulated."
    alt = f"Time histories of {worst}, measured and simulated. Root-mean-square error: {change}."
    return Gallery(figures, {stem_of(worst): (caption, alt)})(stem_of(worst))


def _flights(flown: TrajectoryFit) -> tuple[Block, ...]:
    shown, remark = first(flown.manoeuvres)
    units = {name: flown.units[name] for name in flown.outputs}
    plots = []
    for order, name in enumerate(shown):
        curves = [Curve(flown.path(name, model), *how) for model, *how in MODELS]
        what = "Measured outputs, those simulated from the first values and by the fit, and the inputs"
        plots.append(over_measured(name, f"time-flown-{order}", curves, units, what, _inputs(flown, order)))
    free = flown.setting.initial is None
    began = "from the measured initial state" if free else "from the fixed initial state"
    what_fits = "parameters and initial state" if free else "parameters"
    what = "Recorded accelerations and rates" if flown.of_path else "The recorded inputs"
    text = (
        f"{what} drive the simulation, without correction by measurements: with the first values of the parameters "
        f"{began} (dashed), and with {what_fits} fitted. The error of the fit is shaded."
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
        values = for_people(unit)[1] * np.asarray(flights.channels[name], float)[mine]
        if np.ptp(values) > 0.0:
            line = Line("measured", COLOURS["measured"], values)
            panels.append(Panel(axis_label(name, unit), (line,), height=LOW))
    return panels


def _errors(flown: TrajectoryFit, card: Card) -> tuple[Block, ...]:
    kept = fly.tolerance_table(flown)
    units = {name: flown.units[name] for name in flown.outputs}
    errors = page_table(fly.error_table(flown))
    return (errors, *(() if kept is None else (page_table(kept), *sources(card, units))))


def _parameters(flown: TrajectoryFit, context: FlyContext) -> tuple[Block, ...]:
    parameters, found = flown.fit.parameters, context.process_noise
    return (
        page_table(fly.parameter_table(flown)),
        *(
            ()
            if found is None or not found.converged
            else (page_table(process_noise_table(found, flown, context.posteriors)),)
        ),
        *_gusts(context),
        symbols(parameters, [p.name for p in parameters], conventions(context.card)),
        page_table(fly.initial_table(flown)),
    )


def _motion(found: Motion | None) -> tuple[Block, ...]:
    """Modes, where there are any."""
    return (page_table(mode_table(found)),) if found is not None and found.modes else ()


def _gusts(context: FlyContext) -> tuple[Block, ...]:
    """What was met, where any gust has an intensity."""
    if context.process_noise is None or "gusts" not in context.figures:
        return ()
    most = {
        name: float(np.max(np.abs(mean)))
        for h in context.process_noise.histories
        for name, (mean, _) in h.gusts.items()
    }
    largest = several(
        [f"{name} {value:.2g}{' m/s' if name.startswith('gust') else ''}" for name, value in most.items()]
    )
    caption = "Estimated gusts of each manoeuvre: mean and 95 % band, from all samples (Rauch-Tung-Striebel smoother)."
    return Gallery(
        context.figures, {"gusts": (caption, f"Time histories of the gusts; largest in magnitude: {largest}.")}
    )("gusts")


def _predictions(flown: TrajectoryFit, context: FlyContext) -> tuple[Block, ...]:
    """Whether the filter's are calibrated: by output, in numbers and quantiles."""
    found = None if context.process_noise is None else context.process_noise.one_step
    if found is None:
        return ()
    caption = (
        "Quantiles of innovations over their predicted standard deviations, against those of a standard normal "
        "distribution: steeper than the dotted line where predictive intervals are too narrow, S-shaped where tails "
        "are heavier than normal. Grey: the 95 % band of all points of calibrated predictions, with the "
        "autocorrelation counted."
    )
    by = several(
        f"{name} {100.0 * share.share:.0f} % in their {100.0 * share.level:.0f} % intervals"
        for name, one in found.outputs.items()
        for share in one.shares[-2:-1]
    )
    pictures = Gallery(context.figures, {"one_step": (caption, f"Quantile plots of innovations by output: {by}.")})
    return (
        *bullets(prediction_sentences(found)),
        page_table(one_step_table(found, flown.units)),
        *pictures("one_step"),
    )


def _posterior(context: FlyContext) -> tuple[Block, ...]:
    """Marginals by both samplers, doubts of their chains first, and what varies together; nothing without."""
    if not context.posteriors:
        return ()
    caption = "Draws of the parameters with the largest correlations, and their marginal densities."
    doubtful = unfinished(context.posteriors)
    return (
        *(Text(sentence, "warning") for sentence in doubtful),
        Text(
            "The density is that of the fit with process noise, with the priors of the parameters and weak lognormal "
            "priors of process noise and measurement noise."
        ),
        page_table(posterior_table(context.posteriors)),
        *Gallery(context.figures, {"pair": (caption, f"Pair plot. {caption}")})("pair"),
    )


def _provenance(source: Mapping[str, Any]) -> tuple[Block, ...]:
    return (Fold("Inputs, versions and the command that repeat the run", provenance_blocks(source)),)


# --- Simulated trajectories on the page: errors before and after, and time histories with tolerance bands.

COMPARED_MODELS = (
    ("card", "card's model", COLOURS["before"], "dashed"),
    ("extended", "extended model", COLOURS["after"], "solid"),
)
SPLITS = {
    "hold_out": "Hold-out: simulated from the measured initial state with the fit to the other flights",
    "fitted": "Fitted: parameters and initial states fitted to all flights",
}


class Curve(NamedTuple):
    """A simulated manoeuvre and how it is drawn."""

    path: SimulatedManoeuvre
    label: str
    colour: str
    style: str


def trajectories(flown: Trajectories, card: Card) -> tuple[Block, ...]:
    """Tables, then the hold-out flights, then the fitted ones, folded."""
    blocks: list[Block] = [
        Text(
            "Both models simulated with the recorded inputs, without correction by measurements. “Hold-out” "
            "flights were "
            "not used in the fit. The grey band is the tolerance about the measurement. "
            + tolerance_origin({name: t.value for name, t in card.tolerances.items()})
        ),
        page_table(hold_out_error_table(flown)),
        page_table(hold_out_tolerance_table(flown)),
    ]
    unseen, fitted = (_flight_plots(flown, split) for split in ("hold_out", "fitted"))
    blocks += unseen
    if fitted:
        blocks.append(Fold("The same, fitted to all flights", fitted))
    return (*blocks, *sources(card, {n: STANDARD_CHANNELS[n].unit for n in flown.outputs}))


def sources(card: Card, units: Mapping[str, str]) -> tuple[Block, ...]:
    """Where the tolerances of outputs (by their SI units) come from; nothing where the card has none."""
    facts = tuple(
        (f"{GREEK.get(n, n)} ± {number(factor * t.value)} {unit}", t.source)
        for n, t in card.tolerances.items()
        if n in units
        for unit, factor in (for_people(units[n]),)
    )
    return (Fold("Origin of the tolerances", (Facts(facts),)),) if facts else ()


def _names(flown: Trajectories, split: str) -> list[str]:
    return list(dict.fromkeys(p.manoeuvre for p in flown.paths if p.split == split))


def _flight_plots(flown: Trajectories, split: str) -> tuple[Block, ...]:
    shown, remark = first(_names(flown, split))
    plots: list[Block] = [*remark]
    units = {name: STANDARD_CHANNELS[name].unit for name in flown.outputs}
    for order, name in enumerate(shown):
        curves = [Curve(p, *how) for key, *how in COMPARED_MODELS if (p := flown.path(name, key, split)) is not None]
        what = f"{SPLITS[split]}: measured and simulated outputs"
        plot = over_measured(name, f"time-{split}-{order}", curves, units, what)
        caption = f"{SPLITS[split]}. {plot.caption}"
        plots.append(replace(plot, caption=caption, title=f"{name}, {SPLIT_NAMES[split]}"))
    return tuple(plots)


def over_measured(
    name: str, key: str, curves: Sequence[Curve], units: Mapping[str, str], what: str, context: Sequence[Panel] = ()
) -> Plot:
    """One manoeuvre: a panel for each output of `units` (SI), the last curve's error shaded; then those of `context`.

    All curves are of the same flight; their tolerances are about what was measured.
    """
    path = curves[0].path
    panels = [_panel(output, unit, curves) for output, unit in units.items() if output in path.measured]
    legend = [
        ("measured", COLOURS["measured"], "solid"),
        *((c.label, c.colour, c.style) for c in curves),
        (f"error of the {curves[-1].label}", curves[-1].colour, "area"),
    ]
    if any(panel.band is not None for panel in panels):
        legend.append(("tolerance", "#999999", "area"))
    return histories(name, key, path.time, [*panels, *context], tuple(legend), what)


def _panel(output: str, unit: str, curves: Sequence[Curve]) -> Panel:
    factor = for_people(unit)[1]
    path = curves[0].path
    lines = [Line("measured", COLOURS["measured"], factor * path.measured[output], width=1.0)]
    with np.errstate(over="ignore"):  # first values of parameters may fly anywhere
        lines += [Line(c.label, c.colour, factor * c.path.simulated[output], c.style) for c in curves]
    tolerance = path.errors[output].tolerance
    band = None if tolerance is None else factor * tolerance
    return Panel(axis_label(output, unit), tuple(lines), shade=((0, len(curves)),), band=band)
