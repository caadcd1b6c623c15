"""Sentences on a fit with process noise, compared with output error."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from bayes_aero.diagnosis.trajectories.results import Disagreement, ProcessNoise, TrajectoryFit
from bayes_aero.inference.posterior.posterior import Posterior
from bayes_aero.inference.scores import COLOURED_INNOVATIONS, Calibration, OneStep, Share
from bayes_aero.report.text.phrases import SYMBOLS, plus_minus, several
from bayes_aero.report.text.samplers import agreement_of_engines, unfinished

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
    """Which estimates to prefer where output error and the coefficients disagree.

    `apart`: parameters of which the fit with process noise also disagrees with the coefficients. `asked`: process noise
    was fitted because output error disagrees.
    """
    if not found or fit is None:
        return []
    names = several(d.name for d in found)
    why = (
        f"The coefficients and output error disagree on {names}. Such a record needs process noise; "
        "--no-process-noise leaves it out. "
    )
    if not fit.preferred:
        return [why.strip()] if asked else []
    other = {d.name: fit.estimates[d.name] for d in found if d.name in fit.estimates}
    listed = several(f"{name} {plus_minus(x, sd)}" for name, (x, sd) in other.items())
    if apart:
        verb = "differs" if len(apart) == 1 else "differ"
        text = f"With process noise {several(apart)} still {verb} from the coefficients ({listed})"
        return [(why if asked else "") + f"{text}: the model lacks an effect, or a sensor is wrong."]
    text = f"With process noise {names} agree{'s' * (len(found) == 1)} with the coefficients ({listed})"
    return [(why if asked else "") + f"{text}: prefer them to those of output error."]


def process_noise_sentences(found: ProcessNoise, flown: TrajectoryFit) -> list[str]:
    """Changes by process noise, and the assumption of its standard errors."""
    if not found.converged:
        return [f"The fit with process noise is not usable: {found.status}."]
    if found.gain <= 0.0:
        sentences = ["Process noise does not increase the likelihood of the trajectories: output error is adequate."]
        return sentences + _predicted(found)
    sentences = [
        f"With process noise the log likelihood is {found.gain:.0f} nats higher than by output error, both for white "
        "residuals. Turbulence causes this, and so do errors of the model."
    ]
    fit = flown.fit
    changed = []
    for name, estimate, sd in zip(fit.names, fit.estimate, fit.sd_corrected, strict=True):
        other, other_sd = found.estimates.get(name, (float(estimate), float(sd)))
        if abs(other - estimate) > MIN_DIFFERENCE * float((sd**2 + other_sd**2) ** 0.5):
            changed.append(f"{name} {plus_minus(other, other_sd)} (output error {plus_minus(estimate, sd)})")
    sentences += _estimated_gusts(found)
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
    return sentences + _predicted(found)


def prediction_sentences(found: OneStep) -> list[str]:
    """The share of each output inside its 95 % intervals, and whether predictions are calibrated."""
    shares = {name: next(s for s in one.shares if s.level == LEVEL) for name, one in found.outputs.items()}
    inside = several(f"{SYMBOLS.get(name, name)} {_per_cent(share)}" for name, share in shares.items())
    level = f"{100.0 * LEVEL:.0f} %"
    return [f"One-step predictions: share of the samples inside their {level} intervals: {inside}.", _verdict(found)]


def _predicted(found: ProcessNoise) -> list[str]:
    return [] if found.one_step is None else prediction_sentences(found.one_step)


def _per_cent(share: Share) -> str:
    digits = 0 if share.sd >= 0.01 else 1
    return f"{100.0 * share.share:.{digits}f} % (± {100.0 * share.sd:.{digits}f})"


def _verdict(found: OneStep) -> str:
    if found.status == "undecided":
        return "Whether they are calibrated is not decided: there are too few independent innovations."
    if found.status == "calibrated":
        return (
            "They are calibrated: no share departs from its probability by more than chance, and innovations are not "
            "autocorrelated. Their noise was fitted to the same record."
        )
    every = {SYMBOLS.get(n, n): one.calibration for n, one in found.outputs.items()}
    every["all outputs together"] = found.together.calibration
    wrong = []
    for kind, fault in FAULTS.items():
        names = [name for name, calibration in every.items() if calibration is kind]
        wrong += [fault.format(several(names))] if names else []
    return f"They are not calibrated: {'; '.join(wrong)}."


def posterior_sentences(posteriors: Mapping[str, Posterior]) -> list[str]:
    """Chains that did not converge, and whether the samplers agree."""
    return [*unfinished(posteriors), *agreement_of_engines(posteriors)]


def _estimated_gusts(found: ProcessNoise) -> list[str]:
    """Intensities of the gusts, and scale lengths of gusts with an intensity."""
    estimated, undetected = [], []
    for name in (n for n in found.gusts if n.endswith("_gust")):
        (intensity, sd), (length, length_sd) = found.gusts[name], found.gusts[f"{name}_length"]
        word = name.removesuffix("_gust").replace("_", " ")
        if intensity > MIN_INTENSITY * sd:
            estimated.append(f"{word} {plus_minus(intensity, sd)} m/s (scale length {length:z.0f} ± {length_sd:.0f} m)")
        else:
            undetected.append(word)
    sentences = [f"Estimated gusts, standard deviation: {several(estimated)}."] if estimated else []
    if undetected:
        sentences.append(f"No {' and no '.join(undetected)} gusts are distinguishable from noise of the states.")
    return sentences + _buffet(found)


def _buffet(found: ProcessNoise) -> list[str]:
    """Intensity and correlation length of buffet, where the model has it."""
    if "buffet" not in found.gusts:
        return []
    (intensity, sd), (length, length_sd) = found.gusts["buffet"], found.gusts["buffet_length"]
    if intensity <= MIN_INTENSITY * sd:
        return ["No buffet is distinguishable from noise of the states."]
    return [
        f"Buffet: the lift coefficient of fully separated flow fluctuates by {plus_minus(intensity, sd)} (standard "
        f"deviation; correlated over {plus_minus(length, length_sd)} chords)."
    ]
