"""What a fit to trajectories shows: how it ended, parameters, errors, process noise, modes of motion; its page."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from bayes_aero.inference.scores import COLOURED_INNOVATIONS
from bayes_aero.report.colours import COLOURS
from bayes_aero.report.figures.time_histories import FLOWN, MET, Curve, stem_of
from bayes_aero.report.html.page import Gallery, Report, Text, section
from bayes_aero.report.html.plots import LOW, Line, Panel
from bayes_aero.report.pages import parts
from bayes_aero.report.pages.estimates import (
    band_text,
    engine_label,
    frequency_columns,
    frequency_sentences,
    inseparable_sentences,
    sign_sentences,
    unfinished,
)
from bayes_aero.report.pages.trajectories import over_measured, sources
from bayes_aero.report.phrases import (
    WORDS,
    amounts,
    axis_label,
    decimals,
    for_people,
    plain_unit,
    plus_minus,
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
)
from bayes_aero.units import number

if TYPE_CHECKING:
    from bayes_aero.diagnosis.trajectory_result import Disagreement, Error, Motion, ProcessNoise, TrajectoryFit
    from bayes_aero.inference.results import Marginal, Posterior
    from bayes_aero.inference.scores import OneStep
    from bayes_aero.parameter import Prior

START, FITTED = (model for model, *_ in FLOWN)
NOTES = WORDS["notes"]
MIN_INFLATION = 1.5  # variance inflation from which a sentence is written; our choice
MAX_OUTSIDE = 0.5  # share of the time outside a tolerance from which a sentence is written; our choice
GUSTS = {"vertical_gust": "vertical", "longitudinal_gust": "longitudinal", "lateral_gust": "lateral"}
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
    estimates = zip(fit.names, fit.estimate, fit.sd_corrected, strict=True)
    found = {name: (float(value), float(sd)) for name, value, sd in estimates}
    sentences += sign_sentences(found, fit.parameters, flown.following)
    if fit.held_by_prior and not left:
        sentences.append(sentence("held_by_prior", names=fit.held_by_prior))
    if fit.undetermined and flown.converged:
        sentences.append(sentence("undetermined", names=fit.undetermined))
    sentences += inseparable_sentences(fit.inseparable) if flown.converged else []
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


# --- What process noise changes, and whether its one-step predictions are calibrated.

MIN_DIFFERENCE = 3.0  # combined standard errors of two estimates from which a parameter is named; our choice
LEVEL = 0.95  # of the intervals whose shares a sentence states
FAULTS = {
    "too_narrow": "intervals of {} are too narrow",
    "too_wide": "intervals of {} are too wide",
    "not_normal": "innovations of {} are not normally distributed",
    "coloured": "innovations of {} are autocorrelated",
}
MIN_INTENSITY = 2.0  # standard errors from which an intensity is distinguishable from zero; our choice


def gust_sentences(gusts: Mapping[str, float], fit: ProcessNoise | None = None) -> list[str]:
    """Records that need process noise by their `gusts` (m/s), and which estimates of trajectories to use."""
    if not gusts:
        return []
    better = " Use the estimates with process noise: in gusts those of output error are biased."
    estimated = [f"{name} {size:.2g} m/s" for name, size in gusts.items()]
    return [sentence("path_gusts", gusts=estimated, better=better if fit is not None and fit.preferred else "")]


def settled_sentences(
    found: Sequence[Disagreement], fit: ProcessNoise | None, apart: Sequence[str], *, asked: bool
) -> list[str]:
    """Which estimates to prefer where output error and coefficients disagree; `asked`: process noise is for that."""
    if not found or fit is None:
        return []
    names = [d.name for d in found]
    why = [sentence("disputed", names=names)] if asked else []
    if not fit.preferred:
        return why
    listed = [f"{name} {plus_minus(*fit.estimates[name])}" for name in names if name in fit.estimates]
    settled = sentence("still_apart" if apart else "settled", names=apart or names, listed=listed)
    return [" ".join([*why, settled])]


def process_noise_sentences(found: ProcessNoise, flown: TrajectoryFit) -> list[str]:
    """Changes by process noise, and the assumption of its standard errors."""
    predicted = [] if found.one_step is None else prediction_sentences(found.one_step)
    if not found.converged:
        return [f"The fit with process noise is not usable: {found.status}."]
    if found.gain <= 0.0:
        return [sentence("process_noise_no_gain"), *predicted]
    sentences = [sentence("process_noise_gain", gain=found.gain), *_estimated_gusts(found)]
    fit, changed = flown.fit, []
    for name, estimate, sd in zip(fit.names, fit.estimate, fit.sd_corrected, strict=True):
        other, other_sd = found.estimates.get(name, (float(estimate), float(sd)))
        if abs(other - estimate) > MIN_DIFFERENCE * float((sd**2 + other_sd**2) ** 0.5):
            changed.append(f"{name} {plus_minus(other, other_sd)} (output error {plus_minus(estimate, sd)})")
    if changed:
        sentences.append(sentence("process_noise_changes", limit=MIN_DIFFERENCE, changed=changed))
    coloured = [f"{name} ({r:.2f})" for name, r in found.autocorrelation.items() if abs(r) > COLOURED_INNOVATIONS]
    more = ", and these standard errors are too small"
    sentences += [sentence("coloured_innovations", names=coloured, more=more)] if coloured else []
    return sentences + predicted


def prediction_sentences(found: OneStep) -> list[str]:
    """The share of each output inside its 95 % intervals, and whether predictions are calibrated."""
    inside = []
    for name, one in found.outputs.items():
        share = next(s for s in one.shares if s.level == LEVEL)
        digits = 0 if share.sd >= 0.01 else 1
        inside.append(f"{symbol(name)} {100.0 * share.share:.{digits}f} % (± {100.0 * share.sd:.{digits}f})")
    every = {symbol(name): one.calibration.value for name, one in found.outputs.items()}
    every["all outputs together"] = found.together.calibration.value
    faulty = {fault: [n for n, kind in every.items() if kind == wrong] for wrong, fault in FAULTS.items()}
    faults = "; ".join(fault.format(several(names)) for fault, names in faulty.items() if names)
    key = found.status if found.status in ("undecided", "calibrated") else "not_calibrated"
    return [sentence("one_step", level=100.0 * LEVEL, inside=inside), sentence(key, faults=faults)]


def _estimated_gusts(found: ProcessNoise) -> list[str]:
    """Intensities of the gusts and of buffet, and scale lengths of those with an intensity."""
    estimated, undetected = [], []
    for name, word in ((n, word) for n, word in GUSTS.items() if n in found.gusts):
        (intensity, sd), (length, length_sd) = found.gusts[name], found.gusts[f"{name}_length"]
        if intensity > MIN_INTENSITY * sd:
            estimated.append(f"{word} {plus_minus(intensity, sd)} m/s (scale length {length:z.0f} ± {length_sd:.0f} m)")
        else:
            undetected.append(word)
    sentences = [f"Estimated gusts, standard deviation: {several(estimated)}."] if estimated else []
    if undetected:
        sentences.append(f"No {' and no '.join(undetected)} gusts are distinguishable from noise of the states.")
    if "buffet" in found.gusts:
        intensity, sd = found.gusts["buffet"]
        key = "buffet" if intensity > MIN_INTENSITY * sd else "no_buffet"
        sentences.append(sentence(key, intensity=(intensity, sd), length=found.gusts["buffet_length"]))
    return sentences


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
    in_bands = [column for band in flown.frequency for column in frequency_columns(fit.names, band)]
    start, estimate, crb, sd = (list(map(float, x)) for x in (flown.start, fit.estimate, fit.crb, fit.sd_corrected))
    priors = [prior_text(p.prior if flown.setting.priors else None) for p in fit.parameters]
    said = NOTES["trajectory_priors"] if flown.setting.priors else "There are no priors."
    marked = dict(zip(MARKS, (fit.held_by_prior, fit.at_bound, fit.undetermined), strict=True))
    remarks = [", ".join(MARKS[mark] for mark, some in marked.items() if name in some) for name in fit.names]
    both = list(map(Estimate, estimate, sd))
    return Table(
        [
            *parameter_columns(fit.names, [p.unit for p in fit.parameters]),
            Column(start, "start", "first value", form=4),
            Column(both, ("estimate",), "fit", "estimate", _fit, _known),
            Column(crb, "crb", "Cramér–Rao", "CRB", 2, group=errors),
            Column(sd, "sd_corrected", "corrected", "sd corr.", 2, group=errors),
            *in_bands,
            Column(priors, "prior", "prior", "prior"),
            Column([p.bounds for p in fit.parameters], page="bounds", form=_bounds),
            *(Column([name in some for name in fit.names], mark) for mark, some in marked.items()),
            Column(remarks, page="remark", terminal="", form=or_dash, terminal_form=str, words=True),
        ],
        "Parameters fitted to the trajectories",
        NOTES["trajectory_parameters"],
        "Parameters fitted to trajectories: " + unparted(fit.status.name.lower().replace("_", " "), flown.following),
        f"{NOTES['trajectory_parameters_terminal']} {said}",
    )


def beside_table(flown: TrajectoryFit) -> Table:
    """For a terminal, which has no room for more columns: output error in the time domain, then the fits in a band."""
    fit, bands = flown.fit, flown.frequency
    time = [Estimate.normal(x, sd) for x, sd in zip(fit.estimate, fit.sd_corrected, strict=True)]
    in_bands = [frequency_columns(fit.names, band, band.method.replace(" ", "\n", 1)) for band in bands]
    return Table(
        [
            *parameter_columns(fit.names, [p.unit for p in fit.parameters]),
            Column(time, terminal="time\ndomain", terminal_form=in_brackets),
            *(column for columns in in_bands for column in columns),
        ],
        terminal_title=f"Frequency domain, {band_text(bands[0])}",
        terminal_note="In brackets: corrected standard error in units of the last digit. SI and radians.",
    )


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


def _known(e: Estimate) -> str:
    return in_brackets(e) if math.isfinite(e.sd) else NONE


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
    start = sentence("start_note", initial="measured" if flown.setting.initial is None else "fixed", left=left)
    return Table(
        [
            Column([row.manoeuvre for row in rows], terminal="manoeuvre", words=True),
            column(lambda r: _label(flown, r.output) + ("" if r.output in fitted else " *"), "", "output", "output"),
            Column(rms, "", ("first values", "fit"), "RMS: start → fitted", short, group="root mean square"),
            column(lambda r: r.factor * r.after.largest, "", "fit", "largest", short, group="largest"),
            column(lambda r: r.after.theil.theil, "", "fit", "U", ".3f", group="Theil U"),
            *(
                column(lambda r, part=part: getattr(r.after.theil, part), "", part, head, ".0%", group=shares)
                for part, head in (("bias", "bias"), ("variance", "var."), ("covariance", "cov."))
            ),
        ],
        "Error of the simulated trajectories, in the unit of each output",
        NOTES["residuals"] + left,
        "Error of the simulated trajectory",
        start,
        below=[row.manoeuvre for row in rows],
    )


def tolerance_table(flown: TrajectoryFit) -> Table | None:
    """Share of the time inside the tolerance, before and after; nothing where no output has one."""
    rows = [r for r in _errors(flown) if None not in (r.after.tolerance, r.after.within, r.before.within)]
    column = columns_of(rows)
    table = Table(
        [
            column(lambda r: _label(flown, r.output), page="output"),
            column(lambda r: f"± {number(r.factor * r.after.tolerance)} {r.unit}", page="tolerance"),
            column(lambda r: BeforeAfter(r.before.within, r.after.within), page=("first values", "fit"), form=".0%"),
        ],
        "Share of the time inside the tolerance",
        "These data were fitted; errors on hold-out flights may be larger.",
        below=[r.manoeuvre for r in rows],
    )
    return table if rows else None


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
            Column([factor * x for *_, x, factor in rows], page="departure", form=_signed),
            Column(priors, page="prior of the departure"),
        ]
    return Table(
        columns,
        f"State at the first sample: {'fitted, and its departure from the measured one' if free else 'fixed'}",
        "" if free else "Fixed to the card's values, and to the first sample where the card gives none.",
        below=[row[0] for row in rows],
    )


def _signed(x: float) -> str:
    return f"{'+' if x > 0.0 else ''}{number(x, 2)}"


def _label(flown: TrajectoryFit, channel: str) -> str:
    return axis_label(channel, flown.units.get(channel, "1"))


# --- Tables of a fit with process noise: parameters, gusts, posterior by both samplers, one-step predictions.


def posterior_table(posteriors: Mapping[str, Posterior]) -> Table:
    """A row a parameter; of each sampler mean, deviation, 95 % interval, effective sample size and R-hat."""
    names = list(next(iter(posteriors.values())).names)
    columns = [Column(names, "parameter", "parameter", "")]
    for key, posterior in posteriors.items():
        rows = [posterior.marginals[name] for name in names]
        label = engine_label(key)
        files = tuple(f"{key}_{part}" for part in ("mean", "sd", "low", "high"))
        columns += [
            Column([Estimate.of(m) for m in rows], files, "mean", label, in_brackets, group=label),
            Column([_interval(m) for m in rows], page="95 % interval", group=label),
            Column([m.ess for m in rows], f"{key}_ess", "ESS", f"ESS {label}", ".0f", group=label),
            Column([m.rhat for m in rows], f"{key}_rhat", "R-hat", f"R-hat {label}", ".3f", group=label),
        ]
    return Table(columns, "Posterior with process noise", NOTES["posterior"], terminal_note=NOTES["posterior"])


def _interval(m: Marginal) -> str:
    return " to ".join(number(end, 3) for end in m.ci95)


def one_step_table(found: OneStep, units: Mapping[str, str]) -> Table:
    """A row an output, and one for all: error, innovations over their predicted deviations, shares inside intervals."""
    rows = [
        (axis_label(name, units.get(name, "1")), for_people(units.get(name, "1"))[1], one)
        for name, one in found.outputs.items()
    ]
    rows += [("all together", 1.0, found.together)] if len(rows) > 1 else []
    column = columns_of(rows)
    levels = [f"{100.0 * share.level:.0f} %" for share in found.together.shares]
    group = "inside the interval, %"
    inside = (
        column(lambda r, k=k: Estimate(r[2].shares[k].share, r[2].shares[k].sd), "", head, head, _per_cent, group=group)
        for k, head in enumerate(levels)
    )
    return Table(
        [
            column(lambda r: r[0], "", "output", ""),
            column(lambda r: None if r[2].rms is None else r[1] * r[2].rms, "", "RMS", "RMS", _rms),
            column(lambda r: Estimate(*r[2].ratio), "", "e/sd", "e/sd", in_brackets),
            *inside,
            column(lambda r: r[2].calibration.value.replace("_", " "), "", "predictions", "predictions"),
        ],
        "Errors, and innovations inside their predictive intervals",
        NOTES["one_step"],
        "One-step predictions",
        NOTES["one_step"],
    )


def _rms(x: float) -> str:
    """Small ones with an exponent: a record without noise is predicted to its last digits."""
    return short(x) if x >= 1e-4 else number(x, 2)


def _per_cent(e: Estimate) -> str:
    """A share with one digit of its standard error."""
    share, sd = 100.0 * e.centre, 100.0 * e.sd
    return f"{share:.0f}({sd:.0f})" if sd >= 0.95 else f"{share:.1f}({10.0 * sd:.0f})"


def process_noise_table(
    found: ProcessNoise, flown: TrajectoryFit, posteriors: Mapping[str, Posterior] | None = None
) -> Table:
    """Every parameter by output error and with process noise, and its credible interval where it was sampled."""
    fit = flown.fit
    every = zip(fit.parameters, fit.estimate, fit.sd_corrected, strict=True)
    rows = [(p, Estimate(float(x), float(sd))) for p, x, sd in every if p.name in found.estimates]
    ours, theirs = "output error", "with process noise"
    return Table(
        [
            Column([p.name for p, _ in rows], page="parameter", terminal=""),
            Column([plain_unit(p.unit) for p, _ in rows], page="unit"),
            Column([estimate for _, estimate in rows], "", ours, ours, in_brackets),
            Column([Estimate(*found.estimates[p.name]) for p, _ in rows], "", theirs, theirs, in_brackets),
            *(
                Column([_interval(posterior.marginals[p.name]) for p, _ in rows], "", head, head)
                for key, posterior in (posteriors or {}).items()
                for head in [f"95 % {engine_label(key)}"]
            ),
        ],
        "Parameters with and without process noise",
        NOTES["process_noise"],
        terminal_note=NOTES["process_noise_terminal"],
    )


def gust_table(found: ProcessNoise) -> Table:
    """A row for each sample: manoeuvre, time (s), mean and standard deviation of each gust (m/s)."""
    column = columns_of([(h, k) for h in found.histories for k in range(len(h.time))])
    names = dict.fromkeys(name for h in found.histories for name in h.gusts)
    gusts = (
        column(lambda r, name=name: Estimate(*(x[r[1]] for x in r[0].gusts[name])), (name, f"{name}_sd"))
        for name in names
    )
    return Table(
        [column(lambda r: r[0].manoeuvre, "manoeuvre"), column(lambda r: r[0].time[r[1]], "time"), *gusts], index=2
    )


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
    note = sentence(
        "eigenvalues",
        equations="the card's linear equations" if math.isnan(found.airspeed) else about,
        estimates="with process noise, with errors for white innovations" if found.filtered else "of output error",
    )
    return Table(
        [
            column(lambda r: r[0].name, "", "mode", "mode"),
            column(lambda r: QUANTITIES[r[1]], "", "quantity", "quantity"),
            column(lambda r: r[2], "", "value", "value", in_brackets),
        ],
        "Modes of motion",
        note,
        terminal_note=note,
    )


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
    inside = tolerance_table(flown)
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
            section("errors", "Errors", lambda: (error_table(flown), inside and (inside, sources(card, units)))),
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


def _picture(context: FlyContext, stem: str, caption: str, alt: str) -> Any:
    return Gallery(context.figures, {stem: (caption, alt)})(stem)


def _opening(flown: TrajectoryFit, context: FlyContext) -> Any:
    """The output that the fit follows least: whose error is the largest share of its movement."""
    errors = {n: pair for n, pair in flown.rms_errors.items() if stem_of(n) in context.figures and pair[1] > 0.0}
    if not errors:
        return None
    flights = [flown.path(name, FITTED).measured for name in flown.manoeuvres]
    moved = {n: float(np.sqrt(np.mean([np.var(flight[n]) for flight in flights]))) for n in errors}
    worst = max(errors, key=lambda n: errors[n][1] / max(moved[n], 1e-300))
    before, after, unit = amounts(flown.units[worst], *errors[worst])
    caption = f"{symbol(worst)}, which the fit follows least: measured and simulated."
    alt = sentence("alt_followed_least", name=worst, before=before, after=after, unit=unit)
    return _picture(context, stem_of(worst), caption, alt)


def _flights(flown: TrajectoryFit, units: Mapping[str, str]) -> list[Any]:
    shown, remark = parts.first(flown.manoeuvres)
    what, plots = "Measured outputs, those simulated from the first values and by the fit, and the inputs", []
    for order, name in enumerate(shown):
        curves = [Curve(flown.path(name, model), *how) for model, *how in FLOWN]
        plots.append(over_measured(name, f"time-flown-{order}", curves, units, what, _inputs(flown, order)))
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
    parameters, found, gusts = flown.fit.parameters, context.process_noise, None
    filtered = found is not None and found.converged
    if found is not None and "gusts" in context.figures:
        pairs = [(name, mean) for h in found.histories for name, (mean, _) in h.gusts.items()]
        most = {name: float(np.max(np.abs(mean))) for name, mean in pairs}
        known = {name: MET.get(name, (name, "")) for name in most}
        sizes = several(f"{word} {most[name]:.2g} {unit}".rstrip() for name, (word, unit) in known.items())
        alt = f"Time histories of the gusts; largest in magnitude: {sizes}."
        gusts = _picture(context, "gusts", WORDS["captions"]["gusts"], alt)
    return [
        parameter_table(flown),
        process_noise_table(found, flown, context.posteriors) if filtered else None,
        gusts,
        parts.symbols(parameters, [p.name for p in parameters], parts.conventions(context.card)),
        initial_table(flown),
    ]


def _frequency(flown: TrajectoryFit, context: FlyContext) -> tuple[Any, ...]:
    """Estimates in the band and responses; nothing where no band was asked for."""
    if not flown.frequency:
        return ()
    coherent = several(f"{r.output} over {r.input} {np.median(r.coherence):.2f}" for r in flown.frequency_responses)
    bode = _picture(context, "bode", WORDS["captions"]["bode"], f"Bode plots. Median coherence: {coherent}.")
    return [said for fit in flown.frequency for said in frequency_sentences(fit)], bode


def _predictions(flown: TrajectoryFit, context: FlyContext) -> tuple[Any, ...]:
    """Whether the filter's are calibrated: by output, in numbers and quantiles."""
    found = None if context.process_noise is None else context.process_noise.one_step
    if found is None:
        return ()
    by = several(
        f"{name} {100.0 * share.share:.0f} % in their {100.0 * share.level:.0f} % intervals"
        for name, one in found.outputs.items()
        for share in one.shares[-2:-1]
    )
    alt = f"Quantile plots of innovations by output: {by}."
    picture = _picture(context, "one_step", WORDS["captions"]["one_step"], alt)
    return prediction_sentences(found), one_step_table(found, flown.units), picture


def _posterior(context: FlyContext) -> tuple[Any, ...]:
    """Marginals by both samplers, doubts of their chains first, and what varies together; nothing without."""
    if not context.posteriors:
        return ()
    caption = "Draws of the parameters with the largest correlations, and their marginal densities."
    return (
        parts.warnings(unfinished(context.posteriors)),
        WORDS["paragraphs"]["posterior"],
        posterior_table(context.posteriors),
        _picture(context, "pair", caption, f"Pair plot. {caption}"),
    )
