"""A diagnosis as sentences: verdict, causes, unexplained structure, what is not testable."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from bayes_aero.diagnosis.result import (
    LITTLE,
    Cause,
    Diagnosis,
    DiagnosisView,
    ParameterChange,
    Tested,
    Trajectories,
    Verdict,
)
from bayes_aero.effect import Stage
from bayes_aero.effects import CATALOGUE
from bayes_aero.flight.channel import STANDARD_CHANNELS
from bayes_aero.report.text.check import joint_text
from bayes_aero.report.text.fly import gust_sentences, trajectory_sentences
from bayes_aero.report.text.identification import sign_sentences
from bayes_aero.report.text.phrases import WORDS, amounts, not_testable_sentences, several, size_text, symbol

SHOWN = 4  # other terms that are named


def sentences(view: DiagnosisView) -> list[str]:
    """The findings, one sentence or two each: verdict, causes, unexplained structure, what is not testable."""
    return diagnosis_sentences(view.diagnosis, view.trajectories)


def diagnosis_sentences(d: Diagnosis, flown: Trajectories | None = None) -> list[str]:
    """As `sentences`, of a diagnosis alone."""
    return [sentence for listed in findings(d, flown).values() for sentence in listed]


def findings(d: Diagnosis, flown: Trajectories | None = None) -> dict[str, list[str]]:
    """The sentences by what they are on, in the order of reading."""
    bases = {name: (after, sd) for name, (_, after, sd) in d.base_moves.items()}
    return {
        "verdict": [verdict_sentence(d)],
        "gusts": gust_sentences(d.gusts),
        "tested": tested_sentences(d),
        "signs": sign_sentences(bases, d.parameters, d.following),
        "causes": [_cause(cause) for cause in d.causes],
        "next step": _taken_over(d),
        "cancelling": _cancelling(d),
        "absorbed": _absorbed(d),
        "beyond": _beyond(d),
        "minor": _minor(d),
        "unexplained": _unexplained(d),
        "terms": _terms(d),
        "changes": change_sentences(d.changes),
        "noise": _noise(d),
        "not testable": not_testable_sentences(d.not_testable),
        "trajectories": [] if flown is None else trajectory_sentences(flown),
        "notes": list(d.notes),
    }


def _cause(cause: Cause) -> str:
    text = f"{cause.name}: {cause.claim}"
    if cause.ambiguous_with:
        gains = {n: f"{gain:+z.1f} ± {sd:.1f}" for n, (gain, sd) in cause.rival_gains.items()}
        place = {n: f" (in its place: log density of hold-out data {gain})" for n, gain in gains.items()}
        listed = [f"{name}{place.get(name, '')}" for name in cause.ambiguous_with]
        text += f" On this record {several(listed)} would explain the data about as well."
    if cause.joint:
        text += f" It is estimated together with {joint_text(cause.joint)}: neither size holds without the other."
    if cause.bounded:
        text += f" {several(cause.bounded)} is at a parameter bound: suspect another cause."
    for name, largest in cause.implausible.items():
        most = size_text(largest, 0.0, cause.parameters[name].unit if name in cause.parameters else "1")
        text += f" {name} is larger than on any aircraft (at most {most}): suspect another cause."
    if cause.own_share < LITTLE:
        share = f"{100.0 * cause.own_share:.1f} %" if cause.own_share >= 0.001 else "less than 0.1 %"
        text += (
            f" The record hardly excites it: other parameters reproduce all but {share} of its contribution, so small "
            "model errors change its estimate strongly."
        )
    if not cause.excited:
        text += " Not every manoeuvre excites it."
    lost, sd = cause.missed
    if np.isfinite(lost) and cause.confirmed:
        text += f" Removing it degrades hold-out prediction: log density {-lost:+z.1f} ± {sd:.1f}."
    elif np.isfinite(lost):
        model = "simulation" if cause.stage == "flight path" else "extended model"
        text += f" Hold-out data do not confirm it ({_why_not_confirmed(cause)}); the {model} omits it."
    return text


def _why_not_confirmed(cause: Cause) -> str:
    """The loss because of which a cause is not confirmed."""
    worse, gain = [], cause.gain
    for name, (change, sd) in gain.degraded.items():
        r2 = ""
        if name in gain.before and name in gain.after:
            r2 = f", R² from {gain.before[name].r2:.2f} to {gain.after[name].r2:.2f}"
        worse.append(f"{name} {change:+z.1f} ± {sd:.1f}{r2}")
    if worse:
        return f"with it they are predicted worse: log density of {several(worse)}"
    lost, sd = cause.missed
    if lost > 0.0 and gain.elpd < 0.0:
        return f"beside the causes before it: log density {gain.elpd:+z.1f} ± {gain.elpd_se:.1f}"
    return f"removed: log density {-lost:+z.1f} ± {sd:.1f}"


def _taken_over(d: Diagnosis) -> list[str]:
    """How to put the causes that the verdict rests on into the card."""
    clear = {c.name: c for c in d.causes if c.sure and not c.ambiguous_with}
    sure = [name for name, c in clear.items() if name in CATALOGUE and set(c.joint) <= set(clear)]
    fitted = [name for name in sure if CATALOGUE[name].stage > Stage.AIRCRAFT]
    errors = [name for name in sure if name not in fitted]
    sentences = []
    if fitted:
        sentences.append(
            f"To include {several(fitted)} in the model, add the name to effects under [model] of the card and fit "
            "again."
        )
    if errors:
        sentences.append(
            f"{several(errors)}: correct the record or the card's constants; or add the name to effects and its "
            "size to fixed under [model]."
        )
    return sentences


def _cancelling(d: Diagnosis) -> list[str]:
    """The combination that the record determines of two terms that cancel."""
    sentences = []
    for pair in d.together:
        one, other = pair.parameters
        factor = "" if abs(pair.factor) == 1.0 else f"{abs(pair.factor):.3g} "
        size = size_text(pair.mean, pair.sd, pair.unit)
        sentences.append(
            f"{several(pair.effects)} cancel each other (correlation {pair.correlation:+.2f}): this record "
            f"determines only {one} {'+' if pair.factor > 0.0 else '-'} {factor}{other} = {size}. A manoeuvre that "
            "excites them differently would determine both."
        )
    return sentences


def _absorbed(d: Diagnosis) -> list[str]:
    """Parameters of controls at rest, and what they may have taken up."""
    said = []
    for one in d.absorbed:
        sizes = [f"{name} {size_text(x.mean, x.sd, x.unit)}" for name, x in one.sizes.items()]
        said.append(
            f"The {one.control} does not move in these records, so {one.parameter} takes up what stays constant: it is "
            f"{size_text(*one.estimate, one.unit)}. With its usual value, {size_text(*one.usual, one.unit)}, there "
            f"would be {' or '.join(sizes)}. These records cannot tell which."
        )
    return said


def _beyond(d: Diagnosis) -> list[str]:
    """Estimates that are no causes: implausibly large ones, then those that hold only together with others."""
    each = [(cause, name, x) for cause in d.beyond for name, x in cause.parameters.items()]
    return [
        f"The estimate of {name} is {size_text(x.mean, x.sd, x.unit)}. On this aircraft {large} is at most "
        f"{size_text(cause.implausible[large], 0.0, x.unit)}: suspect another fault of the record or of the model. It "
        "is not a cause, and is left out of the model."
        for cause, name, x in each
        for large in (name, f"1/{name}")
        if large in cause.implausible
    ] + [
        f"The estimate of {name} is {size_text(x.mean, x.sd, x.unit)}, together with {joint_text(cause.joint)}: "
        "neither size holds without the other, and none of them is a cause or a correction by itself."
        for cause, name, x in each
        if not cause.implausible
    ]


def _minor(d: Diagnosis) -> list[str]:
    if not d.minor:
        return []
    verb = "were" if len(d.minor) > 1 else "was"
    beside = " in comparison with the unexplained structure" if d.left else ""
    return [f"Too small{beside} to be named: {several(d.minor)} {verb} in the model during the selection."]


def _unexplained(d: Diagnosis) -> list[str]:
    """Along trajectories an effect may be true and fail its test, which is less powerful than that of the terms."""
    sentences, none = [], "explains this" if d.tested is None else "passes its own test along the trajectories"
    for u in d.unknown:
        share, rivals = f"({u.share:.0%} of the remaining variance)", several(u.rivals)
        if u.offsets:
            sizes = several([f"{name} {size_text(x, sd, '1')}" for name, (x, sd) in u.offsets.items()])
            alike = f" {rivals} would explain them about as well and cannot be told from them." if rivals else ""
            sentences.append(
                f"Offset: the constant of {u.coefficient} differs between manoeuvres {share}, from that of the first "
                f"by {sizes}. A sensor bias, a wrong weight, a trim, flap or throttle set between them, or a form of "
                f"{u.coefficient} that does not hold over all of them makes such offsets; only what moves within a "
                f"manoeuvre tells which.{alike}"
            )
        elif rivals:
            sentences.append(
                f"Unexplained: {u.coefficient} shows structure over {u.channel} {share} that this record cannot "
                f"attribute: {rivals} would explain it about equally well."
            )
        else:
            still = f"{u.coefficient} still depends on {u.channel} {share}"
            sentences.append(f"Unexplained: {still}, and no effect of the catalogue {none}.")
    return sentences


def _terms(d: Diagnosis) -> list[str]:
    """A sentence on each term, and how to put them into a card."""
    sentences = []
    for one in d.terms:
        text = (
            f"Form: {one.coefficient} has a term {one.term.name} of factor {size_text(*one.size, one.term.unit)} "
            f"({one.share:.0%} of the variance left without it; log density of hold-out data {one.gain:+.0f}). "
        )
        if one.term.code is None:
            text += "It depends on the past, which no effect file can state. "
        others = several([f"{term.name} ({weight:.0%})" for term, weight in one.others[:SHOWN]])
        more = f" and {len(one.others) - SHOWN} more" if len(one.others) > SHOWN else ""
        alike = f"These records do not tell it ({one.weight:.0%}) from {others}{more}."
        sentences.append(text + (alike if one.others else "No other term of the library is as good."))
    if any(one.term.code is not None for one in d.terms):
        sentences.append(
            "Form: bayes-aero diagnose with --write-effect FILE writes these terms as effects for effect_files on the "
            "card; diagnose then tests them as it tests the catalogue."
        )
    return sentences


def _noise(d: Diagnosis) -> list[str]:
    sentences, noise = [], d.noise
    if noise.of_innovations and noise.coloured:
        lags = several([f"{name} ({noise.lag1[name]:.2f})" for name in noise.coloured])
        sentences.append(
            f"Innovations are autocorrelated (neighbouring samples of {lags}): a disturbance, or an error of the model "
            "or of a sensor, is not modelled."
        )
    elif "colored" in noise.labels:
        lags = ", ".join(f"{name} {value:.2f}" for name, value in noise.lag1.items())
        sentences.append(
            "Noise: neighbouring residuals are correlated (coloured noise; lag-1 correlation of means over five "
            f"samples {lags}, where white noise leaves a third)."
        )
    if "buffet" in noise.labels:
        growth = ", ".join(f"{name} {value:.1f} times" for name, value in noise.noise_growth.items() if value > 1.05)
        sentences.append(
            f"Noise: its standard deviation grows as the flow separates or the dynamic pressure falls ({growth})."
        )
    if "outliers" in noise.labels:
        count = ", ".join(f"{name} {n}" for name, n in noise.outliers.items() if n)
        sentences.append(f"Noise: outliers were replaced ({count}).")
    return sentences


def revealed(effects: Mapping[str, Mapping[str, float]], named: Mapping[str, str]) -> list[str]:
    """The hidden effects, and whether they were found."""
    answers = {
        "first": "It was named first.",
        "named": "It was named, though not first.",
        "minor": "It was found, but is too small to be named.",
        "ambiguous": "It was reported as indistinguishable from a named cause.",
        "missed": "It was not found.",
    }
    found = []
    for name, values in effects.items():
        units = {p.name: p.unit for p in CATALOGUE[name].parameters}
        sizes = several(f"{key} = {size_text(x, 0.0, units[key])}" for key, x in values.items())
        found.append(f"Hidden effect: {name} ({sizes}). {answers[named[name]]}")
    return found


# --- Changes of parameters during a record in sentences: which, when, and by how much.


def change_sentences(found: Sequence[ParameterChange]) -> list[str]:
    """Parameters that change according to a diagnosis: when, by how much, and possible reasons."""
    sentences = []
    for one in found:
        begin, end = one.interval
        span = f" (95 %: {begin:.1f} to {end:.1f} s)" if end > begin else ""
        when = f"at {one.at:.1f} s of {one.manoeuvre}{span}"
        if one.between:
            when = f"from {one.manoeuvre} on" if one.lasts else f"in {one.manoeuvre}"
        back = "" if one.lasts else ", and the value before in later records"
        before, after, size = (size_text(*x, one.unit) for x in (one.before, one.after, one.size))
        text = (
            f"Changed: {one.parameter} has another value {when}: {before} before, {after} after{back}, a change of "
            f"{size} ({one.share:.0%} of the remaining variance)."
        )
        if one.ambiguous_with:
            text += f" On this record {several(one.ambiguous_with)} would explain the data about as well."
        if one.parameter in WORDS["reasons"]:
            text += f" Possible reasons are {WORDS['reasons'][one.parameter]}; the record does not determine which."
        sentences.append(text)
    return sentences


# --- The headline of a diagnosis. It rests on causes that are confirmed, probable and of plausible size.

MAX_SIZED = 3  # causes whose sizes are in the verdict


def verdict_sentence(d: Diagnosis) -> str:
    """The causes that explain the model error, those that are only named, and the unexplained structure."""
    sure = [c for c in d.causes if c.sure]
    names = f": {several(_named(c, len(sure) <= MAX_SIZED) for c in sure)}{_doubtful(d)}"
    changes = [f"{one.parameter} changes {'at' if one.between else 'in'} {one.manoeuvre}" for one in d.changes]
    structure = {
        f"{u.coefficient} {'between' if u.offsets else 'over'} {u.channel}{'s' if u.offsets else ''}" for u in d.unknown
    }
    unknown = several([*sorted(structure), *dict.fromkeys(changes)])
    left = f" ({unknown})" if unknown else ""
    if d.tested is not None:
        return _flown_verdict(d, d.tested, len(sure), names, left)
    plural = "causes explain" if len(sure) > 1 else "cause explains"
    subject = f"{len(sure)} {plural}"
    return {
        Verdict.NO_EFFECT: f"No significant model error is detectable in these records{_doubtful(d)}.",
        Verdict.EXPLAINED: f"{subject} the error of the card's model{names}.",
        Verdict.PARTLY_EXPLAINED: f"{subject} part of the error of the card's model{names}; "
        f"unexplained structure remains{left}.",
        Verdict.UNEXPLAINED: f"The card's model is wrong and no reliable cause explains it{left}{_doubtful(d)}."
        if d.causes
        else f"The card's model is wrong and no effect of the catalogue explains it{left}.",
        Verdict.UNDECIDED: "These records cannot decide whether the card's model is wrong.",
    }[d.verdict]


def _flown_verdict(d: Diagnosis, tested: Tested, sure: int, names: str, left: str) -> str:
    """The same from trajectories alone: causes explain the error only if the residual is sensor noise."""
    sought = (
        f"structure outside the catalogue remains{left}"
        if d.unknown
        else "no term of the library describes structure outside the catalogue"
    )
    if tested.beyond:  # on hold-out flights where there are any
        unseen = all(math.isfinite(tested.outputs[name].unseen) for name in tested.beyond)
        sizes = {n: one.unseen if unseen else one.fitted for n, one in tested.outputs.items() if one.beyond}
        listed = several(f"{symbol(name)} {_rms(name, x)}" for name, x in sizes.items())
        where = f"{'on hold-out flights, ' if unseen else ''}RMS: {listed}"
        rest = f"Errors larger than the sensor noise remain ({where}); {sought}."
    elif tested.outputs:
        rest = f"The remaining error of the simulation is within the sensor noise; {sought}."
    else:
        rest = f"The remaining error of the simulation was not computed; {sought}."
    if sure and d.verdict is Verdict.EXPLAINED:
        plural = "causes explain" if sure > 1 else "cause explains"
        return f"{sure} {plural} the error of the card's model in the trajectories{names}. {rest}"
    if sure:
        plural = "causes improve" if sure > 1 else "cause improves"
        return f"{sure} {plural} the fit to the trajectories{names}. {rest}"
    if d.verdict is Verdict.NO_EFFECT:
        first = "No significant model error is detectable in these trajectories"
    elif d.causes:
        first = "No reliable cause improves the fit to the trajectories"
    else:
        first = "No effect of the catalogue improves the fit to the trajectories significantly"
    if d.verdict is Verdict.UNDECIDED:
        rest += " Disturbed air or an error of the model causes them; trajectories alone cannot decide which."
    return f"{first}{_doubtful(d)}. {rest}"


def _rms(output: str, value: float) -> str:
    return "".join(amounts(STANDARD_CHANNELS[output].unit, value))


def tested_sentences(d: Diagnosis) -> list[str]:
    """The error of each output against the noise of its sensor, from trajectories alone."""
    if d.tested is None or not d.tested.outputs:
        return []
    listed = [
        f"{symbol(name)} {_rms(name, one.fitted)} (noise {_rms(name, one.noise)})"
        for name, one in d.tested.outputs.items()
    ]
    text = f"The RMS error of the extended model, fitted to all flights, is {several(listed)}."
    if d.tested.beyond:
        text += (
            f" More than half of the mean square error of {several(map(symbol, d.tested.beyond))} is not "
            "noise. Possible causes are turbulence, a sensor error, or an effect that the model lacks."
        )
    return [text]


def _named(cause: Cause, sized: bool) -> str:
    """Its name, its size if requested, and its rivals."""
    sizes = ", ".join(size_text(x.mean, x.sd, x.unit) for x in cause.parameters.values()) if sized else ""
    rivals = f"or {' or '.join(cause.ambiguous_with)}" if cause.ambiguous_with else ""
    text = ", ".join(part for part in (sizes, rivals) if part)
    return f"{cause.name} ({text})" if text else cause.name


def _doubtful(d: Diagnosis) -> str:
    """Named causes on which the verdict does not rest, each with the first reason."""
    reasons: dict[str, list[str]] = {}
    for cause in d.causes:
        if not cause.sure:
            why = "named, but no more probable than its rivals"
            if cause.bounded:
                why = "at a parameter bound: suspect another cause"
            elif cause.implausible:
                why = "larger than on any aircraft: suspect another cause"
            elif not cause.confirmed:
                why = f"named, but not {'confirmed' if math.isfinite(cause.missed[0]) else 'tested'} on hold-out data"
            reasons.setdefault(why, []).append(_named(cause, sized=False))
    return "".join(f"; {why}: {several(names)}" for why, names in reasons.items())
