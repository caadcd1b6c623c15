"""What a fit to trajectories shows: how it ended, parameters, errors, process noise, modes of motion; its page."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from bayes_aero.report.colours import COLOURS
from bayes_aero.report.figures.time_histories import FLOWN, Curve, stem_of
from bayes_aero.report.html.page import Gallery, Report, Text, section
from bayes_aero.report.html.plots import LOW, Line, Panel
from bayes_aero.report.pages import estimates, parts, trajectories
from bayes_aero.report.phrases import (
    WORDS,
    amounts,
    axis_label,
    decimals,
    for_people,
    sentence,
    several,
    short,
    symbol,
    unit_behind,
    unparted,
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
from bayes_aero.units import number

if TYPE_CHECKING:
    from bayes_aero.diagnosis.result import Disagreement, Error, Motion, ProcessNoise, TrajectoryFit
    from bayes_aero.inference.results import Posterior
    from bayes_aero.parameter import Prior

START, FITTED = (model for model, *_ in FLOWN)
NOTES = WORDS["notes"]
MIN_INFLATION = 1.5  # variance inflation from which a sentence is written; our choice
MAX_OUTSIDE = 0.5  # share of the time outside a tolerance from which a sentence is written; our choice
MIN_GROWTH = 2.0  # noise growth in fully separated flow from which a sentence is written; our choice


def fly_sentences(flown: TrajectoryFit, hindered: str = "", *, disturbed: bool = False) -> list[str]:
    """Sentences on the end of the fit, its errors, and what the records do not determine.

    `hindered` is why diagnose cannot use the records; empty if it can. `disturbed`: process noise is fitted, too.
    """
    fit, left = flown.fit, flown.fit.status.name == "LEFT_ENVELOPE"
    bound = f" ({several(fit.at_bound)})" if fit.at_bound else ""
    errors = {symbol(n): amounts(flown.units[n], *pair) for n, pair in flown.rms_errors.items()}
    rms = several(f"{output} {after}{unit}" for output, (_, after, unit) in errors.items())
    off = f"; the RMS error of the trajectories is {rms}" if fit.status.name == "CONVERGED" else ""
    sentences = [f"The fit {unparted(fit.status.value, flown.following)}{bound}{off}."]
    if left:
        sentences = [f"The fit failed: {fit.status.value}."]
    if flown.worse:
        worse = [(symbol(output), *errors[symbol(output)]) for output in flown.worse]
        listed = [f"{name} {before} to {after}{unit}" for name, before, after, unit in worse]
        sentences.append(sentence("worse_than_record", errors=listed))
    sentences += [] if left else _settings(flown)
    shares = [f"{symbol(name)} {x:.0%} of the time" for name, x in outside(flown).items() if x > MAX_OUTSIDE]
    if shares and flown.converged:  # a fit that has not converged may still improve
        looks = f", and diagnose cannot look for it: {hindered}" if hindered else "; bayes-aero diagnose looks for it"
        key = "path_outside" if flown.of_path else "model_outside"
        sentences.append(sentence(key, shares=shares, looks=looks if flown.by_effects else ""))
    if flown.variance_inflation >= MIN_INFLATION and not left:
        advice = "" if disturbed or flown.of_path else f" {sentence('in_disturbed_air')}"
        sentences.append(sentence("inflated", times=short(flown.variance_inflation), advice=advice))
    growth = [f"{symbol(name)} {short(x)} times" for name, x in flown.noise_growth.items() if x > MIN_GROWTH]
    sentences += [sentence("noise_growth", outputs=growth)] if growth else []
    both = zip(fit.names, fit.estimate, fit.sd_corrected, strict=True)
    found = {name: (float(value), float(sd)) for name, value, sd in both}
    sentences += estimates.sign_sentences(found, fit.parameters, flown.following)
    if fit.held_by_prior and not left:
        sentences.append(sentence("held_by_prior", names=fit.held_by_prior))
    if fit.undetermined and flown.converged:
        sentences.append(sentence("undetermined", names=fit.undetermined))
    sentences += estimates.inseparable_sentences(fit.inseparable) if flown.converged else []
    if lost := [p.manoeuvre for p in flown.paths if p.model == FITTED and not p.inside]:
        sentences.append(f"Outside the flight envelope at the end of the fit: {several(lost)}.")
    return sentences


def _settings(flown: TrajectoryFit) -> list[str]:
    """The cost of the published programs, and the settings that differ from the defaults."""
    outputs, setting = [symbol(name) for name in flown.fit.flown.outputs], flown.setting
    how = [] if setting.priors else ["without priors"]
    how += [] if setting.initial is None else ["with initial states fixed"]
    how += ["with inputs held between samples"] if setting.held else []
    late = 0.5 * float(np.median(np.asarray(flown.fit.flown.dt)))
    return [
        sentence("det_R", det_R=flown.fit.det_R, outputs=outputs),
        *([f"It was fitted {several(how)}."] if how else []),
        *([sentence("held_inputs", late=late)] if setting.held else []),
    ]


def disagreement_sentences(found: Sequence[Disagreement], hindered: str = "") -> list[str]:
    """Parameters for which the coefficients of the same record give other values; `hindered` as of the fit."""
    if not found:
        return []
    listed = [sentence("two_values", d=d, unit=unit_behind(d.unit)) for d in found]
    look = "check looks for an error of a sensor" if hindered else "check and diagnose look for the last two"
    return [sentence("coefficients_disagree", listed=listed, look=look)]


def outside(flown: TrajectoryFit) -> dict[str, float]:
    """Share of the time over all manoeuvres for which the fit of each output is outside its tolerance."""
    shares = {}
    for output in flown.outputs:
        listed = [(p.errors[output].within, len(p.time)) for p in flown.paths if p.model == FITTED and p.inside]
        within = [(share, n) for share, n in listed if share is not None]
        if within:
            shares[output] = 1.0 - float(np.average([s for s, _ in within], weights=[n for _, n in within]))
    return shares


def motion_sentences(found: Motion | None) -> list[str]:
    """Why there are no modes, and which have no rate beyond its error."""
    if found is None:
        return []
    sentences = [f"Modes of motion are not given: {found.why_not}."] if found.why_not else []
    undecided = [mode.name for mode in found.modes if not mode.quantities]
    return sentences + ([sentence("rate_undecided", names=undecided)] if undecided else [])


# --- Tables: parameters, errors, tolerances, initial states.

MARKS = {"held_by_prior": "held by its prior", "at_bound": "at its bound", "undetermined": "not determined"}
MAX_RELATIVE_ERROR = 100.0  # standard error over value from which digits of the value are not shown


def parameter_table(flown: TrajectoryFit) -> Table:
    """Every parameter, SI and radians; `crb` is infinite where the data alone do not determine it."""
    fit, errors = flown.fit, "standard error"
    in_bands = [column for band in flown.frequency for column in estimates.frequency_columns(fit.names, band)]
    start, estimate, crb, sd = (list(map(float, x)) for x in (flown.start, fit.estimate, fit.crb, fit.sd_corrected))
    priors = [prior_text(p.prior if flown.setting.priors else None) for p in fit.parameters]
    said = NOTES["trajectory_priors"] if flown.setting.priors else "There are no priors."
    marked = dict(zip(MARKS, (fit.held_by_prior, fit.at_bound, fit.undetermined), strict=True))
    remarks = [", ".join(MARKS[mark] for mark, some in marked.items() if name in some) for name in fit.names]
    both = list(map(Estimate, estimate, sd))
    columns = [
        *parameter_columns(fit.names, [p.unit for p in fit.parameters]),
        Column(start, "start", "first value", form=4),
        Column(both, ("estimate",), "fit", "estimate", _fit, lambda e: in_brackets(e) if math.isfinite(e.sd) else NONE),
        Column(crb, "crb", "Cramér–Rao", "CRB", 2, group=errors),
        Column(sd, "sd_corrected", "corrected", "sd corr.", 2, group=errors),
        *in_bands,
        Column(priors, "prior", "prior", "prior"),
        Column([p.bounds for p in fit.parameters], page="bounds", form=_bounds),
        *(Column([name in some for name in fit.names], mark) for mark, some in marked.items()),
        Column(remarks, page="remark", terminal="", form=or_dash, terminal_form=str, words=True),
    ]
    status = unparted(fit.status.name.lower().replace("_", " "), flown.following)
    return table("trajectory_parameters", columns, status=status, priors=said)


def beside_table(flown: TrajectoryFit) -> Table:
    """For a terminal, which has no room for more columns: output error in the time domain, then the fits in a band."""
    fit, bands = flown.fit, flown.frequency
    time = [Estimate.normal(x, sd) for x, sd in zip(fit.estimate, fit.sd_corrected, strict=True)]
    in_bands = [estimates.frequency_columns(fit.names, band, band.method.replace(" ", "\n", 1)) for band in bands]
    columns = [
        *parameter_columns(fit.names, [p.unit for p in fit.parameters]),
        Column(time, terminal="time\ndomain", terminal_form=in_brackets),
        *(column for columns in in_bands for column in columns),
    ]
    return table("in_bands", columns, band=estimates.band_text(bands[0]))


def parameter_rows(flown: TrajectoryFit) -> dict[str, dict[str, Any]]:
    """The same by parameter, as JSON has it: `prior` in its parts, and None where the fit had none."""
    rows = {str(row.pop("parameter")): row for row in parameter_table(replace(flown, frequency=())).records()}
    for parameter in flown.fit.parameters:
        prior = parameter.prior
        known = {key: getattr(prior, key) for key in ("family", "location", "scale", "source")}
        rows[parameter.name]["prior"] = known | {"default": not prior.by_card} if flown.setting.priors else None
    return rows


def prior_text(prior: Prior | None) -> str:
    """A prior, and whether it is the default or the card's."""
    if prior is None:
        return "none"
    location, scale, end = (number(x, 4) for x in (prior.location, prior.scale, prior.location + prior.scale))
    text = {
        "normal": f"{location} ± {scale}",
        "lognormal": f"{location} × e^±{scale}",
        "halfnormal": f"{location} + |{scale}|",
        "uniform": f"{location} to {end}",
    }[prior.family]
    return f"{text}, {'card' if prior.by_card else 'default'}"


def _fit(e: Estimate) -> str:
    """As many digits as the standard error allows; three if it is far larger than the value."""
    return f"{e.centre:.{decimals(e.sd)}f}" if 0.0 < e.sd < MAX_RELATIVE_ERROR * abs(e.centre) else number(e.centre, 3)


def _bounds(bounds: tuple[float, float]) -> str:
    lower, upper = (None if math.isinf(x) else number(x) for x in bounds)
    if lower is None or upper is None:
        return f"≥ {lower}" if lower else f"≤ {upper}" if upper else "none"
    return f"{lower} to {upper}"


class OutputErrors(NamedTuple):
    """One output of one manoeuvre: errors of first values and of the fit, and the unit for people with its factor."""

    manoeuvre: str
    output: str
    before: Error
    after: Error
    unit: str
    factor: float


def _errors(flown: TrajectoryFit) -> list[OutputErrors]:
    return [
        OutputErrors(name, output, flown.path(name, START).errors[output], error, *for_people(flown.units[output]))
        for name in flown.manoeuvres
        for output, error in flown.path(name, FITTED).errors.items()
    ]


def error_table(flown: TrajectoryFit) -> Table:
    """Error at the first values and of the fit by manoeuvre and output, with Theil's coefficient and its parts."""
    rows, fitted = _errors(flown), flown.fit.flown.outputs
    left = "" if set(flown.outputs) <= set(fitted) else " *: reported, not fitted."
    column, rms = columns_of(rows), [BeforeAfter(r.factor * r.before.rms, r.factor * r.after.rms) for r in rows]
    shares = "shares of the fit's squared error"
    initial = "measured" if flown.setting.initial is None else "fixed"
    columns = [
        Column([row.manoeuvre for row in rows], terminal="manoeuvre", words=True),
        column(lambda r: _label(flown, r.output) + ("" if r.output in fitted else " *"), "", "output", "output"),
        Column(rms, "", ("first values", "fit"), "RMS: start → fitted", short, group="root mean square"),
        column(lambda r: r.factor * r.after.largest, "", "fit", "largest", short, group="largest"),
        column(lambda r: r.after.theil.theil, "", "fit", "U", ".3f", group="Theil U"),
        *(
            column(lambda r, part=part: getattr(r.after.theil, part), "", part, head, ".0%", group=shares)
            for part, head in (("bias", "bias"), ("variance", "var."), ("covariance", "cov."))
        ),
    ]
    return table("errors", columns, below=[row.manoeuvre for row in rows], left=left, initial=initial)


def tolerance_table(flown: TrajectoryFit) -> Table | None:
    """Share of the time inside the tolerance, before and after; nothing where no output has one."""
    rows = [r for r in _errors(flown) if None not in (r.after.tolerance, r.after.within, r.before.within)]
    column = columns_of(rows)
    columns = [
        column(lambda r: _label(flown, r.output), page="output"),
        column(lambda r: f"± {number(r.factor * r.after.tolerance)} {r.unit}", page="tolerance"),
        column(lambda r: BeforeAfter(r.before.within, r.after.within), page=("first values", "fit"), form=".0%"),
    ]
    return table("tolerances", columns, below=[r.manoeuvre for r in rows]) if rows else None


def initial_table(flown: TrajectoryFit) -> Table:
    """The fitted state at each manoeuvre's first sample, how far it is from the measured one, and the prior of that."""
    rows = [
        (name, state, value, departure, for_people(flown.units.get(state, "1"))[1])
        for name in flown.manoeuvres
        for state, (value, departure) in flown.initial[name].items()
    ]
    own, free = flown.departure_sd, flown.setting.initial is None
    columns = [
        Column([_label(flown, state) for _, state, *_ in rows], page="state"),
        Column([factor * value for *_, value, _, factor in rows], page="fitted" if free else "value", form=4),
    ]
    if free:
        priors = [f"0 ± {number(factor * own[s], 2)}, default" if own else "none" for _, s, *_, factor in rows]
        columns += [
            Column(
                [factor * x for *_, x, factor in rows],
                page="departure",
                form=lambda x: f"{'+' if x > 0.0 else ''}{number(x, 2)}",
            ),
            Column(priors, page="prior of the departure"),
        ]
    return table("initial_fitted" if free else "initial_fixed", columns, below=[row[0] for row in rows])


def _label(flown: TrajectoryFit, channel: str) -> str:
    return axis_label(channel, flown.units.get(channel, "1"))


# --- Modes of motion.

QUANTITIES = {
    "period": "period, s",
    "damping_ratio": "damping ratio",
    "time_constant": "time constant, s",
    "time_to_half": "time to half, s",
    "time_to_double": "time to double, s",
    "": "neither grows nor falls beyond its error",
}
SWINGS, DECAYS, SPIRALS = ("period", "damping_ratio"), ("time_constant",), ("time_to_half",)
"""What people read beside the time to double: of an oscillation, of what does not oscillate, of a spiral."""


def mode_table(found: Motion) -> Table:
    """Period and damping, or times, of every mode of motion."""
    rows = []
    for mode in found.modes:
        read = SWINGS if mode.eigenvalue.imag > 0.0 else SPIRALS if mode.name == "spiral" else DECAYS
        quantities = [(mode, n, Estimate(*x)) for n, x in mode.quantities.items() if n in (*read, "time_to_double")]
        rows += quantities or [(mode, "", Estimate(math.nan, math.nan))]
    column = columns_of(rows)
    about = sentence("level_flight", m=found)
    equations = "the card's linear equations" if math.isnan(found.airspeed) else about
    of = "with process noise, with errors for white innovations" if found.filtered else "of output error"
    columns = [
        column(lambda r: r[0].name, "", "mode", "mode"),
        column(lambda r: QUANTITIES[r[1]], "", "quantity", "quantity"),
        column(lambda r: r[2], "", "value", "value", in_brackets),
    ]
    return table("modes", columns, equations=equations, estimates=of)


# --- The page.


@dataclass(frozen=True)
class FlyContext(parts.PageContext):
    """What the page needs beside the fit: its sentences, the verdict first; process noise and motion, if any."""

    sentences: Sequence[str] = ()
    process_noise: ProcessNoise | None = None  # the same parameters by a filter
    posteriors: Mapping[str, Posterior] = field(default_factory=dict)  # of that, by sampler
    motion: Motion | None = None


def fly_page(flown: TrajectoryFit, context: FlyContext) -> Report:
    """The page; nothing on it but the fit's own numbers."""
    verdict, *rest = context.sentences
    card, motion = context.card, context.motion
    units = {name: flown.units[name] for name in flown.outputs}

    def errors() -> tuple[Any, ...]:
        inside = tolerance_table(flown)
        return error_table(flown), inside and (inside, trajectories.sources(card, units))

    of_path, of_model = ("Flight path", "Errors of sensors, from recorded accelerations and rates"), (
        "Trajectories", "A model fitted to trajectories by output error"
    )  # fmt: skip
    title, subtitle = of_path if flown.of_path else of_model
    return Report(
        title=f"{title}: {card.title}",
        subtitle=subtitle,
        verdict=verdict,
        doubts=parts.doubts(context.consistency, context.health, context.failures),
        lead=[_lead(flown), _opening(flown, context)],
        sections=[
            section("findings", "Findings", lambda: ([*rest, *context.notes], parts.terms("terms_of_fly"))),
            parts.records_section(context),
            section("fit", "Measured and simulated", lambda: _flights(flown, units)),
            section("errors", "Errors", errors),
            section("parameters", "Parameters", lambda: _parameters(flown, context)),
            section("frequency", "In the frequency domain", lambda: _frequency(flown, context)),
            section("motion", "Modes of motion", lambda: mode_table(motion) if motion and motion.modes else None),
            section("predictions", "One-step predictions", lambda: _predictions(flown, context)),
            section("posterior", "Posterior", lambda: _posterior(context)),
            parts.provenance_section(context.source, folded=True),
        ],
    )


def _lead(flown: TrajectoryFit) -> Text:
    """The gain at once: error at first values and of the fit, all manoeuvres together; a warning if it failed."""
    if not flown.converged:
        return Text("Do not use the numbers on this page: the fit stopped there without converging.", "warning")
    listed = []
    for output, pair in flown.rms_errors.items():
        before, after, unit = amounts(flown.units[output], *pair)
        listed.append(f"{symbol(output)} {before} → {after}{unit}".replace(" ", "\u00a0"))  # never broken
    return Text(f"Root-mean-square error of the simulation, first values → fit: {several(listed)}.", "lead")


def _opening(flown: TrajectoryFit, context: FlyContext) -> Any:
    """The output that the fit follows least: whose error is the largest share of its movement."""
    errors = {n: pair for n, pair in flown.rms_errors.items() if stem_of(n) in context.figures and pair[1] > 0.0}
    if not errors:
        return None
    flights = [flown.path(name, FITTED).measured for name in flown.manoeuvres]
    moved = {n: float(np.sqrt(np.mean([np.var(flight[n]) for flight in flights]))) for n in errors}
    worst = max(errors, key=lambda n: errors[n][1] / max(moved[n], 1e-300))
    caption = f"{symbol(worst)}, which the fit follows least: measured and simulated."
    return Gallery(context.figures, {stem_of(worst): caption})(stem_of(worst))


def _flights(flown: TrajectoryFit, units: Mapping[str, str]) -> list[Any]:
    shown, remark = parts.first(flown.manoeuvres)
    what, plots = "Measured outputs, those simulated from the first values and by the fit, and the inputs", []
    for order, name in enumerate(shown):
        curves = [Curve(flown.path(name, model), *how) for model, *how in FLOWN]
        plots.append(
            trajectories.over_measured(name, f"time-flown-{order}", curves, units, what, _inputs(flown, order))
        )
    free = flown.setting.initial is None
    text = sentence(
        "flown",
        what="Recorded accelerations and rates" if flown.of_path else "The recorded inputs",
        initial="measured" if free else "fixed",
        fitted="parameters and initial state" if free else "parameters",
    )
    band = any(error.tolerance is not None for path in flown.paths for error in path.errors.values())
    return [text + (WORDS["paragraphs"]["tolerance_band"] if band else ""), remark, plots]


def _inputs(flown: TrajectoryFit, order: int) -> list[Panel]:
    """What drove the simulation and moved; states and outputs have panels already."""
    flights = flown.fit.flown.flights
    mine, panels = flights.manoeuvre == order, []
    for name in flown.fit.flown.dynamics.inputs:
        if flown.units.get(name) is None or name in flown.outputs or name not in flights.channels:
            continue
        shown, factor = for_people(flown.units[name])
        values = factor * np.asarray(flights.channels[name], float)[mine]
        if np.ptp(values) > 0.0:
            line = Line("measured", COLOURS["measured"], values)
            panels.append(Panel(symbol(name), shown, (line,), height=LOW))
    return panels


def _parameters(flown: TrajectoryFit, context: FlyContext) -> list[Any]:
    """Every parameter with and without process noise, the gusts that were met, and the initial states."""
    parameters, filtered = flown.fit.parameters, context.process_noise
    converged = filtered if filtered is not None and filtered.converged else None
    return [
        parameter_table(flown),
        converged and trajectories.process_noise_table(converged, flown, context.posteriors),
        Gallery(context.figures, WORDS["captions"])("gusts"),
        parts.symbols(parameters, [p.name for p in parameters], parts.conventions(context.card)),
        initial_table(flown),
    ]


def _frequency(flown: TrajectoryFit, context: FlyContext) -> tuple[Any, ...]:
    """Estimates in the band and responses; nothing where no band was asked for."""
    if not flown.frequency:
        return ()
    bode = Gallery(context.figures, WORDS["captions"])("bode")
    return [said for fit in flown.frequency for said in estimates.frequency_sentences(fit)], bode


def _predictions(flown: TrajectoryFit, context: FlyContext) -> tuple[Any, ...]:
    """Whether the filter's are calibrated: by output, in numbers and quantiles."""
    found = None if context.process_noise is None else context.process_noise.one_step
    if found is None:
        return ()
    picture = Gallery(context.figures, WORDS["captions"])("one_step")
    return trajectories.prediction_sentences(found), trajectories.one_step_table(found, flown.units), picture


def _posterior(context: FlyContext) -> tuple[Any, ...]:
    """Marginals by both samplers, doubts of their chains first, and what varies together; nothing without."""
    if not context.posteriors:
        return ()
    caption = "Draws of the parameters with the largest correlations, and their marginal densities."
    return (
        parts.warnings(estimates.unfinished(context.posteriors)),
        WORDS["paragraphs"]["posterior"],
        trajectories.posterior_table(context.posteriors),
        Gallery(context.figures, {"pair": caption})("pair"),
    )
