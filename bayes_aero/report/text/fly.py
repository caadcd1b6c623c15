"""A fit to trajectories in sentences."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bayes_aero.diagnosis.trajectories.results import FITTED, Disagreement, TrajectoryFit
from bayes_aero.inference.likelihood.output_error_result import OutputErrorStatus
from bayes_aero.report.text.phrases import SYMBOLS, for_people, plus_minus, several, short
from bayes_aero.report.text.restraints import inseparable_sentences, sign_sentences, unparted

MIN_INFLATION = 1.5  # variance inflation from which a sentence is written; our choice
MAX_OUTSIDE = 0.5  # share of the time outside a tolerance from which a sentence is written; our choice
ADVICE = (
    " Gusts or errors of the model cause this, and bias output error: the option --process-noise fits the same model "
    "in disturbed air."
)
MIN_GROWTH = 2.0  # noise growth in fully separated flow from which a sentence is written; our choice


def fly_sentences(flown: TrajectoryFit, hindered: str = "", *, disturbed: bool = False) -> list[str]:
    """Sentences on the end of the fit, its errors, the variance inflation, unidentified parameters, and manoeuvres
    outside the envelope.

    `hindered` is why diagnose cannot use the records; empty if it can. `disturbed`: process noise is fitted, too.
    """
    fit = flown.fit
    bound = f" ({several(fit.at_bound)})" if fit.at_bound else ""
    sentences = [f"The fit {unparted(fit.status.value, flown.following)}{bound}{_off(flown)}."]
    if fit.status is OutputErrorStatus.LEFT_ENVELOPE:
        sentences = [f"The fit failed: {fit.status.value}."]
    sentences += _worse(flown)
    sentences += _settings(flown)
    sentences += _wanting(flown, hindered)
    if flown.variance_inflation >= MIN_INFLATION and fit.status is not OutputErrorStatus.LEFT_ENVELOPE:
        sentences.append(
            f"The residuals are autocorrelated. The variance inflation is {short(flown.variance_inflation)} in the "
            f"median, and the "
            "Cramér-Rao bound is too small; use the corrected standard error."
            f"{'' if disturbed or flown.of_path else ADVICE}"
        )
    growth = {name: times for name, times in flown.noise_growth.items() if times > MIN_GROWTH}
    if growth:
        listed = several(f"{SYMBOLS.get(name, name)} {short(times)} times" for name, times in growth.items())
        sentences.append(f"Residuals grow where the flow has separated ({listed}): these samples have less weight.")
    estimates = zip(fit.names, fit.estimate, fit.sd_corrected, strict=True)
    found = {name: (float(value), float(sd)) for name, value, sd in estimates}
    sentences += sign_sentences(found, fit.parameters, flown.following)
    if fit.held_by_prior and fit.status is not OutputErrorStatus.LEFT_ENVELOPE:
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
    lost = [p.manoeuvre for p in flown.paths if p.model == FITTED and not p.inside]
    if lost:
        sentences.append(f"Outside the flight envelope at the end of the fit: {several(lost)}.")
    return sentences


def _worse(flown: TrajectoryFit) -> list[str]:
    """A sentence on outputs that a flight path fits worse than without errors of sensors."""
    if not flown.worse:
        return []
    listed = []
    for output in flown.worse:
        unit, factor = for_people(flown.units[output])
        before, after = (short(factor * x) for x in flown.rms_errors[output])
        listed.append(f"{SYMBOLS.get(output, output)} {before} to {after}{'' if unit == '1' else ' ' + unit}")
    return [
        f"The fit is worse than the record as it is (RMS {several(listed)}): an error of a sensor that is not among "
        "the parameters is behind it. The estimates are not usable, and no corrected record is written."
    ]


def disagreement_sentences(found: Sequence[Disagreement], hindered: str = "") -> list[str]:
    """Parameters for which the coefficients of the same record give other values.

    `hindered` is why diagnose cannot use the records; empty if it can.
    """
    if not found:
        return []
    listed = several(
        f"{d.name} {plus_minus(*d.coefficients)} from the coefficients, {plus_minus(*d.trajectories)} from "
        f"trajectories{'' if d.unit == '1' else f' {d.unit}'} ({d.apart:.1f} combined "
        "standard errors apart)"
        for d in found
    )
    look = "check looks for an error of a sensor" if hindered else "check and diagnose look for the last two"
    return [
        f"The coefficients of the same record, as identify fits them, disagree with the trajectories: {listed}. "
        "Neither interval covers the difference. Possible causes are turbulence, a sensor error or an effect that the "
        f"model lacks; {look}."
    ]


def _settings(flown: TrajectoryFit) -> list[str]:
    """The cost of the published programs, and the settings that differ from the defaults."""
    if flown.fit.status is OutputErrorStatus.LEFT_ENVELOPE:
        return []
    outputs = several(SYMBOLS.get(name, name) for name in flown.fit.flown.outputs)
    sentences = [f"det R is {flown.fit.det_R:.5g} (residual covariance of {outputs}, SI and radians)."]
    how = [] if flown.setting.priors else ["without priors"]
    how += [] if flown.setting.initial is None else ["with initial states fixed"]
    how += ["with inputs held between samples"] if flown.setting.held else []
    sentences += [f"It was fitted {several(how)}."] if how else []
    if flown.setting.held:
        late = 0.5 * float(np.median(np.asarray(flown.fit.flown.dt)))
        sentences.append(
            f"Held inputs act half a sample ({late:.2g} s) later than interpolated ones, which moves the derivatives "
            "of fast controls. That is right for a command that a digital system holds until the next sample, and "
            "wrong for a recorded position of a surface: leave --inputs held out for that."
        )
    return sentences


def outside(flown: TrajectoryFit) -> dict[str, float]:
    """Share of the time over all manoeuvres for which the fit of each output is outside its tolerance."""
    paths = [p for p in flown.paths if p.model == FITTED and p.inside]
    shares = {}
    for output in flown.outputs:
        listed = [(p.errors[output].within, len(p.time)) for p in paths]
        within = [(share, n) for share, n in listed if share is not None]
        if within:
            shares[output] = 1.0 - float(np.average([s for s, _ in within], weights=[n for _, n in within]))
    return shares


def _wanting(flown: TrajectoryFit, hindered: str) -> list[str]:
    """A sentence on a lacking effect, if the fit is mostly outside the tolerances."""
    shares = {name: share for name, share in outside(flown).items() if share > MAX_OUTSIDE}
    if not (shares and flown.converged):  # a fit that has not converged may still improve
        return []
    listed = several(f"{SYMBOLS.get(name, name)} {share:.0%} of the time" for name, share in shares.items())
    if flown.of_path:
        return [f"The flight path is outside its tolerances ({listed}): an error of a sensor or of the air is missing."]
    looks = f", and diagnose cannot look for it: {hindered}" if hindered else "; bayes-aero diagnose looks for it"
    where = looks if flown.by_effects else ""
    return [f"The fitted model is outside its tolerances ({listed}): the model lacks an effect{where}."]


def _off(flown: TrajectoryFit) -> str:
    """Errors of a converged fit."""
    if flown.fit.status is not OutputErrorStatus.CONVERGED:
        return ""
    listed = []
    for output, (_, rms) in flown.rms_errors.items():
        unit, factor = for_people(flown.units[output])
        listed.append(f"{SYMBOLS.get(output, output)} {short(factor * rms)}{'' if unit == '1' else ' ' + unit}")
    return f"; the RMS error of the trajectories is {several(listed)}"
