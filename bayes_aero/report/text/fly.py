"""A fit to trajectories in sentences."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from bayes_aero.diagnosis.result import FITTED, Disagreement, ProcessNoise, Trajectories, TrajectoryFit
from bayes_aero.effects import CATALOGUE
from bayes_aero.flight.channel import STANDARD_CHANNELS
from bayes_aero.flight.record import TOLERANCES
from bayes_aero.inference.results import COLOURED_INNOVATIONS, Calibration, OneStep, OutputErrorStatus
from bayes_aero.report.text.identification import inseparable_sentences, sign_sentences
from bayes_aero.report.text.phrases import amounts, nats_text, plus_minus, several, short, size_text, symbol, unparted

MIN_INFLATION = 1.5  # variance inflation from which a sentence is written; our choice
MAX_OUTSIDE = 0.5  # share of the time outside a tolerance from which a sentence is written; our choice
ADVICE = (
    " Gusts or errors of the model cause this, and bias output error: the option --process-noise fits the same model "
    "in disturbed air."
)
GUSTS = {"vertical_gust": "vertical", "longitudinal_gust": "longitudinal", "lateral_gust": "lateral"}
MIN_GROWTH = 2.0  # noise growth in fully separated flow from which a sentence is written; our choice


def fly_sentences(flown: TrajectoryFit, hindered: str = "", *, disturbed: bool = False) -> list[str]:
    """Sentences on the end of the fit, its errors, and what the records do not determine.

    `hindered` is why diagnose cannot use the records; empty if it can. `disturbed`: process noise is fitted, too.
    """
    fit, left = flown.fit, flown.fit.status is OutputErrorStatus.LEFT_ENVELOPE
    bound = f" ({several(fit.at_bound)})" if fit.at_bound else ""
    errors = {n: amounts(flown.units[n], *pair) for n, pair in flown.rms_errors.items()}
    rms = several(f"{symbol(output)} {after}{unit}" for output, (_, after, unit) in errors.items())
    off = f"; the RMS error of the trajectories is {rms}" if fit.status is OutputErrorStatus.CONVERGED else ""
    sentences = [f"The fit {unparted(fit.status.value, flown.following)}{bound}{off}."]
    if left:
        sentences = [f"The fit failed: {fit.status.value}."]
    if flown.worse:
        listed = [(symbol(output), *errors[output]) for output in flown.worse]
        sentences.append(
            f"The fit is worse than the record as it is (RMS "
            f"{several(f'{name} {before} to {after}{unit}' for name, before, after, unit in listed)}): an error of a "
            "sensor that is not among the parameters is behind it. The estimates are not usable, and no corrected "
            "record is written."
        )
    sentences += [] if left else _settings(flown)
    shares = {name: share for name, share in outside(flown).items() if share > MAX_OUTSIDE}
    if shares and flown.converged:  # a fit that has not converged may still improve
        said = several(f"{symbol(name)} {share:.0%} of the time" for name, share in shares.items())
        looks = f", and diagnose cannot look for it: {hindered}" if hindered else "; bayes-aero diagnose looks for it"
        sentences.append(
            f"The flight path is outside its tolerances ({said}): an error of a sensor or of the air is missing."
            if flown.of_path
            else f"The fitted model is outside its tolerances ({said}): the model lacks an effect"
            f"{looks if flown.by_effects else ''}."
        )
    if flown.variance_inflation >= MIN_INFLATION and not left:
        sentences.append(
            f"The residuals are autocorrelated. The variance inflation is {short(flown.variance_inflation)} in the "
            "median, and the Cramér-Rao bound is too small; use the corrected standard error."
            f"{'' if disturbed or flown.of_path else ADVICE}"
        )
    growth = {name: times for name, times in flown.noise_growth.items() if times > MIN_GROWTH}
    if growth:
        said = several(f"{symbol(name)} {short(times)} times" for name, times in growth.items())
        sentences.append(f"Residuals grow where the flow has separated ({said}): these samples have less weight.")
    estimates = zip(fit.names, fit.estimate, fit.sd_corrected, strict=True)
    found = {name: (float(value), float(sd)) for name, value, sd in estimates}
    sentences += sign_sentences(found, fit.parameters, flown.following)
    if fit.held_by_prior and not left:
        sentences.append(
            f"The trajectories contain little information on {several(fit.held_by_prior)}; the prior decides."
        )
    if fit.undetermined and flown.converged:
        sentences.append(
            f"The trajectories do not determine {several(fit.undetermined)}, and there are no priors: these values "
            "are not usable. Fix them on the card, or fit with priors."
        )
    if flown.converged:
        sentences += inseparable_sentences(fit.inseparable)
    if lost := [p.manoeuvre for p in flown.paths if p.model == FITTED and not p.inside]:
        sentences.append(f"Outside the flight envelope at the end of the fit: {several(lost)}.")
    return sentences


def _settings(flown: TrajectoryFit) -> list[str]:
    """The cost of the published programs, and the settings that differ from the defaults."""
    outputs, setting = several(map(symbol, flown.fit.flown.outputs)), flown.setting
    sentences = [f"det R is {flown.fit.det_R:.5g} (residual covariance of {outputs}, SI and radians)."]
    how = [] if setting.priors else ["without priors"]
    how += [] if setting.initial is None else ["with initial states fixed"]
    how += ["with inputs held between samples"] if setting.held else []
    sentences += [f"It was fitted {several(how)}."] if how else []
    if setting.held:
        late = 0.5 * float(np.median(np.asarray(flown.fit.flown.dt)))
        sentences.append(
            f"Held inputs act half a sample ({late:.2g} s) later than interpolated ones, which moves the derivatives "
            "of fast controls. That is right for a command that a digital system holds until the next sample, and "
            "wrong for a recorded position of a surface: leave --inputs held out for that."
        )
    return sentences


def disagreement_sentences(found: Sequence[Disagreement], hindered: str = "") -> list[str]:
    """Parameters for which the coefficients of the same record give other values; `hindered` as of the fit."""
    if not found:
        return []
    listed = several(
        f"{d.name} {plus_minus(*d.coefficients)} from the coefficients, {plus_minus(*d.trajectories)} from "
        f"trajectories{'' if d.unit == '1' else f' {d.unit}'} ({d.apart:.1f} combined standard errors apart)"
        for d in found
    )
    look = "check looks for an error of a sensor" if hindered else "check and diagnose look for the last two"
    return [
        f"The coefficients of the same record, as identify fits them, disagree with the trajectories: {listed}. "
        "Neither interval covers the difference. Possible causes are turbulence, a sensor error or an effect that the "
        f"model lacks; {look}."
    ]


def outside(flown: TrajectoryFit) -> dict[str, float]:
    """Share of the time over all manoeuvres for which the fit of each output is outside its tolerance."""
    shares = {}
    for output in flown.outputs:
        listed = [(p.errors[output].within, len(p.time)) for p in flown.paths if p.model == FITTED and p.inside]
        within = [(share, n) for share, n in listed if share is not None]
        if within:
            shares[output] = 1.0 - float(np.average([s for s, _ in within], weights=[n for _, n in within]))
    return shares


# --- Simulated trajectories in sentences.

MODELS = ("card", "extended")
STOPPED = "stopped before the optimum, so its errors may be too large"


def simulation_gain(flown: Trajectories) -> str:
    """RMS errors of both models over all hold-out flights; empty if they are equal or a model leaves the envelope."""
    if not all(p.inside for p in flown.paths if p.split == "hold_out"):
        return ""
    listed = []
    for output in flown.outputs:
        rms = {m: [p.errors[output].rms for p in flown.paths if (p.model, p.split) == (m, "hold_out")] for m in MODELS}
        if not all(rms.values()) or not np.isfinite([x for values in rms.values() for x in values]).all():
            return ""
        joint = (float(np.sqrt(np.mean(np.square(rms[m])))) for m in MODELS)
        before, after, unit = amounts(STANDARD_CHANNELS[output].unit, *joint)
        if before != after:
            listed.append(f"{symbol(output)} from {before} to {after}{unit}")
    if not listed:
        return ""
    besides = [f"with {flown.lag.effect}"] if flown.lag is not None and flown.lag.kept else []
    besides += [f"without {several(flown.out)}"] if flown.out else []
    model = f" ({several(besides)})" if besides else ""
    text = f"On hold-out flights the extended model{model} changes the RMS error of the simulation: {several(listed)}."
    return " ".join([text, *status_sentences(flown)])


def trajectory_sentences(flown: Trajectories, *, tolerances: bool = True) -> list[str]:
    """How the fits ended, what was held, and, if asked, the share of time within the tolerances."""
    sentences = [*status_sentences(flown), *lag_sentences(flown), *cause_sentences(flown)]
    for name, held in flown.held.items():
        if held:
            are, value = "are", "they are held at their joint estimates"
            if len(held) == 1:
                are, value = "is", "it is held at its joint estimate"
            sentences.append(f"Without {name}, {several(held)} {are} not identifiable from the other flights; {value}.")
    if flown.extended.held:
        sentences.append(
            f"The trajectories contain little information on {several(flown.extended.held)}; the prior decides."
        )
    unseen = [p for p in flown.paths if (p.model, p.split) == ("extended", "hold_out")]
    if lost := [p.manoeuvre for p in unseen if not p.inside]:
        leaves = "leaves" if len(lost) == 1 else "leave"
        sentences.append(f"In the hold-out simulation {several(lost)} {leaves} the flight envelope.")
    inside, listed = [p for p in unseen if p.inside], []
    for output in flown.outputs if tolerances else ():
        shares = {p.manoeuvre: x for p in inside if (x := p.errors[output].within) is not None}
        if shares:
            worst = min(shares, key=lambda name: shares[name])
            where = f" (least, {worst})" if len(shares) > 1 and shares[worst] < max(shares.values()) else ""
            listed.append(f"{symbol(output)} {shares[worst]:.0%}{where}")
    if listed:
        what = "every flight is" if len(inside) > 1 else f"{inside[0].manoeuvre} is"
        bands = {n: e.tolerance for n, e in inside[0].errors.items() if e.tolerance is not None}
        sentences.append(
            f"In the hold-out simulation {what} within tolerance for at least this share of the time: "
            f"{', '.join(listed)}. {tolerance_origin(bands)}"
        )
    return sentences


def tolerance_origin(bands: Mapping[str, float]) -> str:
    """The origin of the tolerances; `bands` by output, SI."""
    if all(name in TOLERANCES and value == TOLERANCES[name].value for name, value in bands.items()):
        return (
            "The card states no tolerances; the tolerances for flight simulators of 14 CFR Part 60 are used. "
            "[tolerances] of the card replaces them."
        )
    return "The tolerances are those of the card."


def lag_sentences(flown: Trajectories) -> list[str]:
    """The lag test on trajectories, where the coefficients do not decide."""
    lag = flown.lag
    if lag is None:
        return []
    elpd, elpd_se = lag.unseen
    if not lag.kept:
        asked = f", hold-out {nats_text(elpd, elpd_se, '+')}" if math.isfinite(elpd) else ""
        gained = f"fit {lag.gain:+.1f} nats{asked}" if math.isfinite(lag.gain) else "its fit did not converge"
        why = "give a size that is too small to be named" if lag.slight else "do not support it"
        return [f"The coefficients do not decide on {lag.effect}; the trajectory data {why} ({gained})."]
    names = [p.name for p in CATALOGUE[lag.effect].parameters]
    after = flown.extended
    sizes = [f"{n} {size_text(after.values[n], flown.deviation[n], after.units[n])}" for n in names]
    instead = f" in place of {several(lag.instead)}" if lag.instead else ""
    return [
        f"The trajectory fit supports {lag.effect}{instead}: {several(sizes)}. The coefficients do not decide on it; "
        f"it gains {lag.gain:.0f} nats in the trajectory fit and {nats_text(elpd, elpd_se)} on hold-out flights."
    ]


def cause_sentences(flown: Trajectories) -> list[str]:
    """Which confirmed causes the hold-out trajectories need, and by how much."""
    missed, kept, harmed, sentences = flown.asked.missed, flown.asked.kept, flown.asked.harmed, []
    for e, worse in harmed.items():
        gains = [f"{output} by {nats_text(-gain, se)}" for output, (gain, se) in worse.items()]
        sentences.append(f"With {e} hold-out trajectories are predicted worse in {several(gains)}: it is omitted.")
    if idle := [e for e in flown.out if e not in harmed]:
        gains = [f"{e} (by {nats_text(*missed[e], '+')})" for e in idle]
        them, omits = ("it", "omits it") if len(gains) == 1 else ("them", "omits them")
        sentences.append(
            f"Removing {several(gains)} does not significantly degrade the prediction of hold-out trajectories. The "
            f"search confirms {them}; the simulated model {omits}."
        )
    if kept:
        finite = [e for e in kept if math.isfinite(missed[e][0])]  # without the others the flight leaves its envelope
        least = min(finite, key=lambda e: missed[e][0] / missed[e][1], default=None)
        least_of = f"least for {least}, " if len(kept) > 1 else ""
        by = f" ({least_of}by {nats_text(*missed[least])})" if least else ""
        sentences.append(f"Removing {several(kept)} degrades the prediction of hold-out trajectories{by}.")
    return sentences


def status_sentences(flown: Trajectories) -> list[str]:
    """How the fits of both models ended, where one did not converge."""
    sentences = []
    for who, fit in (("The card's model", flown.card), ("The extended model", flown.extended)):
        if fit.status is not OutputErrorStatus.CONVERGED:
            names = f" ({several(fit.at_bound)})" if fit.at_bound else ""
            how = STOPPED if fit.status is OutputErrorStatus.NOT_CONVERGED else fit.status.value
            sentences.append(f"{who}, fitted to the trajectories: {how}{names}.")
    return sentences


# --- Sentences on a fit with process noise, compared with output error.

MIN_DIFFERENCE = 3.0  # combined standard errors of two estimates from which a parameter is named; our choice
LEVEL = 0.95  # of the intervals whose shares a sentence states
FAULTS = {
    Calibration.TOO_NARROW: "intervals of {} are too narrow",
    Calibration.TOO_WIDE: "intervals of {} are too wide",
    Calibration.NOT_NORMAL: "innovations of {} are not normally distributed",
    Calibration.COLOURED: "innovations of {} are autocorrelated",
}
MIN_INTENSITY = 2.0  # standard errors from which an intensity is distinguishable from zero; our choice


def gust_sentences(gusts: Mapping[str, float], fit: ProcessNoise | None = None) -> list[str]:
    """Records that need process noise by their `gusts` (m/s), and which estimates of trajectories to use."""
    if not gusts:
        return []
    estimated = several(f"{name} {size:.2g} m/s" for name, size in gusts.items())
    text = (
        f"The flight path alone, without aerodynamics, shows gusts (standard deviation: {estimated}). Such a record "
        "needs process noise; --no-process-noise leaves it out."
    )
    better = " Use the estimates with process noise: in gusts those of output error are biased."
    return [text + (better if fit is not None and fit.preferred else "")]


def settled_sentences(
    found: Sequence[Disagreement], fit: ProcessNoise | None, apart: Sequence[str], *, asked: bool
) -> list[str]:
    """Which estimates to prefer where output error and coefficients disagree; `asked`: process noise is for that."""
    if not found or fit is None:
        return []
    names = several(d.name for d in found)
    why = (
        f"The coefficients and output error disagree on {names}. Such a record needs process noise; "
        "--no-process-noise leaves it out. "
    )
    if not fit.preferred:
        return [why.strip()] if asked else []
    listed = several(f"{d.name} {plus_minus(*fit.estimates[d.name])}" for d in found if d.name in fit.estimates)
    if apart:
        text = f"{several(apart)} still {'differs' if len(apart) == 1 else 'differ'} from the coefficients ({listed}): "
        text += "the model lacks an effect, or a sensor is wrong."
    else:
        text = f"{names} agree{'s' * (len(found) == 1)} with the coefficients ({listed}): prefer them to those of "
        text += "output error."
    return [f"{why if asked else ''}With process noise {text}"]


def process_noise_sentences(found: ProcessNoise, flown: TrajectoryFit) -> list[str]:
    """Changes by process noise, and the assumption of its standard errors."""
    predicted = [] if found.one_step is None else prediction_sentences(found.one_step)
    if not found.converged:
        return [f"The fit with process noise is not usable: {found.status}."]
    if found.gain <= 0.0:
        adequate = "Process noise does not increase the likelihood of the trajectories: output error is adequate."
        return [adequate, *predicted]
    sentences = [
        f"With process noise the log likelihood is {found.gain:.0f} nats higher than by output error, both for white "
        "residuals. Turbulence causes this, and so do errors of the model.",
        *_estimated_gusts(found),
    ]
    fit, changed = flown.fit, []
    for name, estimate, sd in zip(fit.names, fit.estimate, fit.sd_corrected, strict=True):
        other, other_sd = found.estimates.get(name, (float(estimate), float(sd)))
        if abs(other - estimate) > MIN_DIFFERENCE * float((sd**2 + other_sd**2) ** 0.5):
            changed.append(f"{name} {plus_minus(other, other_sd)} (output error {plus_minus(estimate, sd)})")
    if changed:
        sentences.append(
            f"Parameters that process noise changes by more than {MIN_DIFFERENCE:g} standard errors: "
            f"{several(changed)}."
        )
    coloured = [f"{name} ({r:.2f})" for name, r in found.autocorrelation.items() if abs(r) > COLOURED_INNOVATIONS]
    if coloured:
        sentences.append(
            f"Innovations are autocorrelated (neighbouring samples of {several(coloured)}): a disturbance, or an error "
            "of the model or of a sensor, is not modelled, and these standard errors are too small."
        )
    return sentences + predicted


def prediction_sentences(found: OneStep) -> list[str]:
    """The share of each output inside its 95 % intervals, and whether predictions are calibrated."""
    inside = []
    for name, one in found.outputs.items():
        share = next(s for s in one.shares if s.level == LEVEL)
        digits = 0 if share.sd >= 0.01 else 1
        inside.append(f"{symbol(name)} {100.0 * share.share:.{digits}f} % (± {100.0 * share.sd:.{digits}f})")
    if found.status == "undecided":
        verdict = "Whether they are calibrated is not decided: there are too few independent innovations."
    elif found.status == "calibrated":
        verdict = (
            "They are calibrated: no share departs from its probability by more than chance, and innovations are not "
            "autocorrelated. Their noise was fitted to the same record."
        )
    else:
        every = {symbol(name): one.calibration for name, one in found.outputs.items()}
        every["all outputs together"] = found.together.calibration
        faulty = {fault: [n for n, kind in every.items() if kind is wrong] for wrong, fault in FAULTS.items()}
        listed = "; ".join(fault.format(several(names)) for fault, names in faulty.items() if names)
        verdict = f"They are not calibrated: {listed}."
    level = f"{100.0 * LEVEL:.0f} %"
    return [
        f"One-step predictions: share of the samples inside their {level} intervals: {several(inside)}.",
        verdict,
    ]


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
        (intensity, sd), length = found.gusts["buffet"], found.gusts["buffet_length"]
        sentences.append(
            f"Buffet: the lift coefficient of fully separated flow fluctuates by {plus_minus(intensity, sd)} (standard "
            f"deviation; correlated over {plus_minus(*length)} chords)."
            if intensity > MIN_INTENSITY * sd
            else "No buffet is distinguishable from noise of the states."
        )
    return sentences
