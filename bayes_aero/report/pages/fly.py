"""What a fit to trajectories shows: how it ended, parameters, errors, process noise, modes of motion; its page."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from bayes_aero.report.page import Gallery, Report, section
from bayes_aero.report.pages import estimates, parts, trajectories
from bayes_aero.report.phrases import (
    WORDS,
    amounts,
    axis_label,
    decimals,
    for_people,
    plain_unit,
    sentence,
    several,
    short,
    symbol,
    unit_behind,
    unparted,
)
from bayes_aero.report.plots import FLOWN, LOW, Panel, measured_panel, output_panels
from bayes_aero.report.screen import Screen, actions, claims, doubts_of
from bayes_aero.report.table import Column, Estimate, Table, parameter_columns, table, with_error
from bayes_aero.units import number

if TYPE_CHECKING:
    from bayes_aero.diagnosis.result import Disagreement, Motion, TrajectoryFit
    from bayes_aero.flight.card import Card
    from bayes_aero.flight.record import FlightRecord
    from bayes_aero.jobs.results import Flight

START, FITTED = FLOWN
MIN_INFLATION = 1.5  # variance inflation from which a sentence is written; our choice
MAX_OUTSIDE = 0.5  # share of the time outside a tolerance from which a sentence is written; our choice
MOST_ERRORS = 4  # outputs of which the screen gives the errors
CORRECTED, WHITE = "output error ± corrected", "process noise ± white"  # kinds of standard error
MIN_GROWTH = 2.0  # noise growth in fully separated flow from which a sentence is written; our choice
MARKS = {"held_by_prior": "held by its prior", "at_bound": "at its bound", "undetermined": "not determined"}
MAX_RELATIVE_ERROR = 100.0  # standard error over value from which digits of the value are not shown
QUANTITIES = {
    "period": "period, s", "damping_ratio": "damping ratio", "time_constant": "time constant, s",
    "time_to_half": "time to half, s", "time_to_double": "time to double, s",
}  # fmt: skip


def fly_sentences(flown: TrajectoryFit, hindered: str = "", *, disturbed: bool = False) -> list[str]:
    """Sentences on the end of the fit, its errors, and what the records do not determine.

    `hindered` is why diagnose cannot use the records; empty if it can. `disturbed`: process noise is fitted, too.
    """
    fit, left = flown.fit, flown.fit.status.name == "LEFT_ENVELOPE"
    bound = f" ({several(fit.at_bound)})" if fit.at_bound else ""
    errors = {n: amounts(flown.units[n], *pair) for n, pair in flown.rms_errors.items()}
    rms = several(f"{symbol(n)} {after}{unit}" for n, (_, after, unit) in errors.items())
    off = f"; the RMS error of the trajectories is {rms}" if fit.status.name == "CONVERGED" else ""
    sentences = [f"The fit {unparted(fit.status.value, flown.following)}{bound}{off}."]
    if left:
        sentences = [f"The fit failed: {fit.status.value}."]
    if flown.worse:
        listed = ["{} {} to {}{}".format(symbol(n), *errors[n]) for n in flown.worse]
        sentences.append(sentence("worse_than_record", errors=listed))
    sentences += [] if left else _settings(flown)
    shares = [f"{symbol(name)} {x:.0%} of the time" for name, x in outside(flown).items() if x > MAX_OUTSIDE]
    if shares and flown.converged:  # a fit that has not converged may still improve
        remedy = f", and diagnose cannot look for it: {hindered}" if hindered else "; bayes-aero diagnose looks for it"
        key = "path_outside" if flown.of_path else "model_outside"
        sentences.append(sentence(key, shares=shares, looks=remedy if flown.by_effects else ""))
    if flown.variance_inflation >= MIN_INFLATION and not left:
        advice = "" if disturbed or flown.of_path else f" {sentence('in_disturbed_air')}"
        sentences.append(sentence("inflated", times=short(flown.variance_inflation), advice=advice))
    if growth := [f"{symbol(name)} {short(x)} times" for name, x in flown.noise_growth.items() if x > MIN_GROWTH]:
        sentences.append(sentence("noise_growth", outputs=growth))
    both = zip(fit.names, fit.estimate, fit.sd_corrected, strict=True)
    values = {name: (float(value), float(sd)) for name, value, sd in both}
    sentences += estimates.sign_sentences(values, fit.parameters, flown.following)
    if fit.held_by_prior and not left:
        sentences.append(sentence("held_by_prior", names=fit.held_by_prior))
    if flown.converged:
        sentences += [sentence("undetermined", names=fit.undetermined)] if fit.undetermined else []
        sentences += estimates.inseparable_sentences(fit.inseparable)
    if lost := [p.manoeuvre for p in flown.paths if p.model == FITTED and not p.inside]:
        sentences.append(sentence("ended", what="The fit", status=f"{several(lost)} left the flight envelope"))
    return sentences


def fly_screen(result: Flight, card: Card, records: Sequence[FlightRecord]) -> Screen:
    """Errors before and after the fit, every parameter with its corrected standard error, and what is doubtful."""
    flown, fit, beside = result.flown, result.flown.fit, result.process_noise
    record, mend = parts.record_block(records, result.health, None if flown.of_path else result.consistency)
    filtered = beside is not None and beside.converged
    units = [plain_unit(p.unit) for p in fit.parameters]
    fitted = list(map(Estimate, map(float, fit.estimate), map(float, fit.sd_corrected)))
    columns = [
        Column(fit.names, page="parameter"),
        Column(units, page="unit"),
        Column([float(x) for x in flown.start], page="first value", form=4),
        Column(fitted, page=CORRECTED, form=with_error),
    ]
    if beside is not None and filtered:
        both = [Estimate(*beside.estimates[n]) if n in beside.estimates else None for n in fit.names]
        columns.append(Column(both, page=WHITE, form=with_error))
    status = unparted(fit.status.value, flown.following)
    errors = {n: amounts(flown.units[n], *pair) for n, pair in flown.rms_errors.items()}
    listed = [f"{symbol(n)} {before} → {after}{unit}" for n, (before, after, unit) in errors.items()]
    more = f" and {len(listed) - MOST_ERRORS} more" if len(listed) > MOST_ERRORS else ""
    few = sentence("flown_errors", listed=f"{', '.join(listed[:MOST_ERRORS])}{more}")
    ended = few if flown.converged else sentence("not_converged")
    shown = [sentence("flown_fit", status=status), ended, Table(columns)]
    messages = doubts_of(result.sentences)
    then = "next_diagnose" if flown.by_effects else "next_qualify"
    steps = [*mend, *actions(messages)]
    steps += [sentence(then, given=parts.given(records, card))] if flown.converged and not flown.worse else []
    return Screen(record, shown, [*result.failures, *claims(messages), *result.notes], steps)


def _settings(flown: TrajectoryFit) -> list[str]:
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


def disagreement_sentences(disagree: Sequence[Disagreement], hindered: str = "") -> list[str]:
    """Parameters for which the coefficients of the same record give other values; `hindered` as of the fit."""
    if not disagree:
        return []
    listed = [sentence("two_values", d=d, unit=unit_behind(d.unit)) for d in disagree]
    look = "check looks for an error of a sensor" if hindered else "check and diagnose look for the last two"
    return [sentence("coefficients_disagree", names=[d.name for d in disagree], listed=listed, look=look)]


def outside(flown: TrajectoryFit) -> dict[str, float]:
    """Share of the time over all manoeuvres for which the fit of each output is outside its tolerance."""
    shares = {}
    for output in flown.outputs:
        inside = [(p.errors[output].within, len(p.time)) for p in flown.paths if p.model == FITTED and p.inside]
        if within := [(share, n) for share, n in inside if share is not None]:
            shares[output] = 1.0 - float(np.average([s for s, _ in within], weights=[n for _, n in within]))
    return shares


def motion_sentences(motion: Motion | None) -> list[str]:
    """Why there are no modes, and which have no rate beyond its error."""
    if motion is None:
        return []
    sentences = [f"Modes of motion are not given: {motion.why_not}."] if motion.why_not else []
    undecided = [mode.name for mode in motion.modes if not mode.quantities]
    return sentences + ([sentence("rate_undecided", names=undecided)] if undecided else [])


def parameter_table(flown: TrajectoryFit) -> Table:
    """Every parameter, SI and radians; `crb` is infinite where the data alone do not determine it."""
    fit, errors = flown.fit, "standard error"
    start, estimate, crb, sd = (list(map(float, x)) for x in (flown.start, fit.estimate, fit.crb, fit.sd_corrected))
    origins = [f"{p.prior.text}, {'card' if p.prior.by_card else 'default'}" for p in fit.parameters]
    priors = origins if flown.setting.priors else ["none"] * len(origins)
    marked = {mark: getattr(fit, mark) for mark in MARKS}
    remarks = [", ".join(MARKS[mark] for mark, names in marked.items() if name in names) for name in fit.names]
    both = list(map(Estimate, estimate, sd))
    bands = [estimates.frequency_columns(fit.names, band) for band in flown.frequency]
    columns = [
        *parameter_columns(fit.names, [p.unit for p in fit.parameters]),
        Column(start, "start", "first value", form=4),
        Column(both, ("estimate",), "fit", form=_fit),
        Column(crb, "crb", "Cramér–Rao", form=2, group=errors),
        Column(sd, "sd_corrected", "corrected", form=2, group=errors),
        *(column for columns in bands for column in columns),
        Column(priors, "prior", "prior"),
        Column([p.bounds for p in fit.parameters], page="bounds", form=_bounds),
        *(Column([name in names for name in fit.names], mark) for mark, names in marked.items()),
        Column(remarks, page="remark", words=True),
    ]
    return table("trajectory_parameters", columns)


def parameter_rows(flown: TrajectoryFit) -> dict[str, dict[str, Any]]:
    """The same by parameter, as JSON has it: `prior` in its parts, and None where the fit had none."""
    rows = {str(row.pop("parameter")): row for row in parameter_table(replace(flown, frequency=())).records()}
    for parameter in flown.fit.parameters:
        prior = parameter.prior
        fields = {key: getattr(prior, key) for key in ("family", "location", "scale", "source")}
        rows[parameter.name]["prior"] = fields | {"default": not prior.by_card} if flown.setting.priors else None
    return rows


def _fit(e: Estimate) -> str:
    """As many digits as the standard error allows; three if it is far larger than the value."""
    return f"{e.centre:.{decimals(e.sd)}f}" if 0.0 < e.sd < MAX_RELATIVE_ERROR * abs(e.centre) else number(e.centre, 3)


def _bounds(bounds: tuple[float, float]) -> str:
    lower, upper = (None if math.isinf(x) else number(x) for x in bounds)
    if lower is None or upper is None:
        return f"≥ {lower}" if lower else f"≤ {upper}" if upper else "none"
    return f"{lower} to {upper}"


def error_table(flown: TrajectoryFit) -> Table:
    """Errors at the first values and of the fit by manoeuvre and output, Theil's parts, and time inside tolerances."""
    fitted, flights = flown.fit.flown.outputs, {m: [flown.path(m, model) for model in FLOWN] for m in flown.manoeuvres}
    initial = "measured" if flown.setting.initial is None else "fixed"
    left = "" if set(flown.outputs) <= set(fitted) else " *: reported, not fitted."
    heads = ("first values", "fit")
    return trajectories.error_table("errors", flights, flown.units, heads, fitted=fitted, left=left, initial=initial)


def initial_table(flown: TrajectoryFit) -> Table:
    """The fitted state at each manoeuvre's first sample, and how far it is from the measured one."""
    rows = [(m, s, *values) for m in flown.manoeuvres for s, values in flown.initial[m].items()]
    factors = [for_people(flown.units.get(state, "1"))[1] for _, state, *_ in rows]
    free, by_factor = flown.setting.initial is None, list(zip(rows, factors, strict=True))
    values = [factor * value for (*_, value, _), factor in by_factor]
    columns = [
        Column([axis_label(state, flown.units.get(state, "1")) for _, state, *_ in rows], page="state"),
        Column(values, page="fitted" if free else "value", form=4),
    ]
    if free:
        columns.append(Column([f * departure for (*_, departure), f in by_factor], page="departure", form="+.2g"))
    return table("initial_fitted" if free else "initial_fixed", columns, below=[row[0] for row in rows])


def mode_table(motion: Motion) -> Table:
    rows: list[tuple[str, str, Estimate | None]] = []
    for mode in motion.modes:  # people read the times of what does not oscillate, of a spiral the times to half, double
        read = ("period", "damping_ratio") if mode.eigenvalue.imag > 0.0 else ("time_constant",)
        read = (*(("time_to_half",) if mode.name == "spiral" else read), "time_to_double")
        sizes = [(mode.name, QUANTITIES[n], Estimate(*x)) for n, x in mode.quantities.items() if n in read]
        rows += sizes or [(mode.name, "neither grows nor falls beyond its error", None)]
    linear, about = "the card's linear equations", sentence("level_flight", m=motion)
    of = "with process noise, with errors for white innovations" if motion.filtered else "of output error"
    names, quantities, values = zip(*rows, strict=True)
    columns = [Column(names, "", "mode"), Column(quantities, "", "quantity"), Column(values, "", "value")]
    return table("modes", columns, equations=linear if math.isnan(motion.airspeed) else about, estimates=of)


def fly_page(flown: TrajectoryFit, context: parts.PageContext) -> Report:
    result = context.result
    card, motion = context.card, result.motion
    units = {name: flown.units[name] for name in flown.outputs}
    gallery = Gallery(context.figures, WORDS["captions"])
    bands = [text for fit in flown.frequency for text in estimates.frequency_sentences(fit)]
    of_path = "Flight path", "Errors of sensors, from recorded accelerations and rates"
    of_model = "Trajectories", "A model fitted to trajectories by output error"
    title, subtitle = of_path if flown.of_path else of_model
    posteriors, about = result.posteriors, WORDS["paragraphs"]["posterior"]

    def predictions() -> Any:
        of = result.process_noise and result.process_noise.one_step
        return of and (trajectories.prediction_sentences(of), trajectories.one_step_table(of, flown.units))

    def posterior() -> Any:
        unsure = parts.warnings(estimates.unfinished(posteriors))
        return posteriors and (unsure, about, trajectories.posterior_table(posteriors), gallery("pair"))

    return Report(
        title=f"{title}: {card.title}",
        subtitle=subtitle,
        verdict=fly_screen(result, card, context.records),
        lead=[],
        sections=[
            section("findings", "Findings", lambda: ([*result.sentences, *result.notes], parts.terms("terms_of_fly"))),
            parts.records_section(card, context.records, result.health),
            section("fit", "Measured and simulated", lambda: _flights(flown, units)),
            section("errors", "Errors", lambda: (error_table(flown), trajectories.sources(card, units))),
            section("parameters", "Parameters", lambda: _parameters(flown, context, gallery)),
            section("frequency", "In the frequency domain", lambda: (bands, gallery("bode"))),
            section("motion", "Modes of motion", lambda: mode_table(motion) if motion and motion.modes else None),
            section("predictions", "One-step predictions", predictions),
            section("posterior", "Posterior", posterior),
            parts.provenance_section(context.source, folded=True),
        ],
    )


def _parameters(flown: TrajectoryFit, context: parts.PageContext, gallery: Gallery) -> list[Any]:
    filtered, fit = context.result.process_noise, flown.fit
    return [
        parameter_table(flown),
        trajectories.process_noise_table(filtered, flown) if filtered and filtered.converged else None,
        gallery("gusts"),
        parts.symbols(context.card, fit.parameters, fit.names),
        initial_table(flown),
    ]


def _flights(flown: TrajectoryFit, units: Mapping[str, str]) -> list[Any]:
    what = "Measured outputs, those simulated from the first values and by the fit, and the inputs"
    flights = flown.fit.flown.flights
    recorded = (n for n in flown.fit.flown.dynamics.inputs if n in flown.units and n in flights.channels)
    inputs = [n for n in recorded if n not in flown.outputs]  # states and outputs have panels already

    def drawn(order: int, name: str) -> tuple[np.ndarray, list[Panel]]:
        paths = {label: flown.path(name, model) for model, label in FLOWN.items()}
        panels = output_panels(paths, units)
        for channel in inputs:
            values = np.asarray(flights.channels[channel], float)[flights.manoeuvre == order]
            if np.ptp(values) > 0.0:
                panels.append(measured_panel(channel, values, flown.units[channel], height=LOW))
        return paths["fitted model"].time, panels

    free = flown.setting.initial is None
    text = sentence(
        "flown",
        what="Recorded accelerations and rates" if flown.of_path else "The recorded inputs",
        initial="measured" if free else "fixed",
        fitted="parameters and initial state" if free else "parameters",
    )
    return [text + trajectories.tolerance_band(flown.paths), parts.flights(flown.manoeuvres, "flown", what, drawn)]
