"""A diagnosis as sentences: verdict, causes, unexplained structure, what is not testable."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from bayes_aero.diagnosis.result import LITTLE, Cause, Diagnosis, FoundTerm, ParameterChange, UnexplainedStructure
from bayes_aero.diagnosis.trajectories.results import Trajectories
from bayes_aero.diagnosis.view.results import DiagnosisView
from bayes_aero.effect import Stage
from bayes_aero.effects import CATALOGUE
from bayes_aero.report.text.check import joint_text
from bayes_aero.report.text.fly import gust_sentences, trajectory_sentences
from bayes_aero.report.text.phrases import (
    not_testable_sentences,
    several,
    size_text,
    tested_sentences,
    verdict_sentence,
)
from bayes_aero.report.text.restraints import sign_sentences

SHOWN = 4  # other terms that are named


def sentences(view: DiagnosisView) -> list[str]:
    """The findings, one sentence or two each: verdict, causes, unexplained structure, what is not testable."""
    return diagnosis_sentences(view.diagnosis, view.trajectories)


def diagnosis_sentences(d: Diagnosis, flown: Trajectories | None = None) -> list[str]:
    """As `sentences`, of a diagnosis alone."""
    return [
        verdict_sentence(d),
        *gust_sentences(d.gusts),
        *tested_sentences(d),
        *sign_sentences(
            {name: (after, sd) for name, (_, after, sd) in d.base_moves.items()},
            d.parameters,
            d.following,
        ),
        *(_cause(cause) for cause in d.causes),
        *_taken_over(d),
        *_together(d),
        *_absorbed(d),
        *_beyond(d),
        *_minor(d),
        *_unknown(d),
        *_terms(d.terms),
        *change_sentences(d.changes),
        *_noise(d),
        *not_testable_sentences(d.not_testable),
        *([] if flown is None else trajectory_sentences(flown)),
        *d.notes,
    ]


def _cause(cause: Cause) -> str:
    text = f"{cause.name}: {cause.claim}"
    if cause.ambiguous_with:
        listed = [f"{name}{_in_place(cause, name)}" for name in cause.ambiguous_with]
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


def _in_place(cause: Cause, rival: str) -> str:
    """What hold-out data gain with a rival in place of a cause."""
    if rival not in cause.rival_gains:
        return ""
    gain, sd = cause.rival_gains[rival]
    return f" (in its place: log density of hold-out data {gain:+z.1f} ± {sd:.1f})"


def _why_not_confirmed(cause: Cause) -> str:
    """The loss because of which a cause is not confirmed."""
    worse = [f"{name} {gain:+z.1f} ± {sd:.1f}{_r2(cause, name)}" for name, (gain, sd) in cause.gain.degraded.items()]
    if worse:
        return f"with it they are predicted worse: log density of {several(worse)}"
    lost, sd = cause.missed
    if lost > 0.0 and cause.gain.elpd < 0.0:
        return f"beside the causes before it: log density {cause.gain.elpd:+z.1f} ± {cause.gain.elpd_se:.1f}"
    return f"removed: log density {-lost:+z.1f} ± {sd:.1f}"


def _r2(cause: Cause, coefficient: str) -> str:
    before, after = (scores.get(coefficient) for scores in (cause.gain.before, cause.gain.after))
    return "" if before is None or after is None else f", R² from {before.r2:.2f} to {after.r2:.2f}"


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
            f"again."
        )
    if errors:
        sentences.append(
            f"{several(errors)}: correct the record or the card's constants; or add the name to effects and its "
            f"size to "
            "fixed under [model]."
        )
    return sentences


def _together(d: Diagnosis) -> list[str]:
    """The combination that the record determines of two terms that cancel."""
    sentences = []
    for pair in d.together:
        one, other = pair.parameters
        factor = "" if abs(pair.factor) == 1.0 else f"{abs(pair.factor):.3g} "
        sign = "+" if pair.factor > 0.0 else "-"
        size = size_text(pair.mean, pair.sd, pair.unit)
        sentences.append(
            f"{several(pair.effects)} cancel each other (correlation {pair.correlation:+.2f}): this record "
            f"determines only {one} {sign} {factor}{other} = {size}. A manoeuvre that excites them differently would "
            "determine both."
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
    return [
        f"The estimate of {name} is {size_text(x.mean, x.sd, x.unit)}. On this aircraft {large} is at most "
        f"{size_text(cause.implausible[large], 0.0, x.unit)}: suspect another fault of the record or of the model. It "
        "is not a cause, and is left out of the model."
        for cause in d.beyond
        for name, x in cause.parameters.items()
        for large in (name, f"1/{name}")
        if large in cause.implausible
    ] + [
        f"The estimate of {name} is {size_text(x.mean, x.sd, x.unit)}, together with {joint_text(cause.joint)}: "
        "neither size holds without the other, and none of them is a cause or a correction by itself."
        for cause in d.beyond
        if not cause.implausible
        for name, x in cause.parameters.items()
    ]


def _minor(d: Diagnosis) -> list[str]:
    if not d.minor:
        return []
    verb = "were" if len(d.minor) > 1 else "was"
    beside = " in comparison with the unexplained structure" if d.left else ""
    return [f"Too small{beside} to be named: {several(d.minor)} {verb} in the model during the selection."]


def _unknown(d: Diagnosis) -> list[str]:
    """Along trajectories an effect may be true and fail its test, which is less powerful than that of the terms."""
    none = "explains this" if d.tested is None else "passes its own test along the trajectories"
    return [
        _offsets(u)
        if u.offsets
        else f"Unexplained: {u.coefficient} shows structure over {u.channel} ({u.share:.0%} of the remaining variance) "
        f"that this record cannot attribute: {several(u.rivals)} would explain it about equally well."
        if u.rivals
        else f"Unexplained: {u.coefficient} still depends on {u.channel} ({u.share:.0%} of the remaining variance), "
        f"and no effect of the catalogue {none}."
        for u in d.unknown
    ]


def _offsets(u: UnexplainedStructure) -> str:
    sizes = several([f"{name} {size_text(x, sd, '1')}" for name, (x, sd) in u.offsets.items()])
    rivals = f" {several(u.rivals)} would explain them about as well and cannot be told from them." if u.rivals else ""
    return (
        f"Offset: the constant of {u.coefficient} differs between manoeuvres ({u.share:.0%} of the remaining "
        f"variance), from that of the first by {sizes}. A sensor bias, a wrong weight, a trim, flap or throttle "
        f"set between them, or a form of {u.coefficient} that does not hold over all of them makes such offsets; only "
        f"what moves within a manoeuvre tells which.{rivals}"
    )


def _terms(terms: Sequence[FoundTerm]) -> list[str]:
    """A sentence on each term, and how to put them into a card."""
    found = [_term(one) for one in terms]
    if any(one.term.code is not None for one in terms):
        found.append(
            "Form: bayes-aero diagnose with --write-effect FILE writes these terms as effects for effect_files on the "
            "card; diagnose then tests them as it tests the catalogue."
        )
    return found


def _term(one: FoundTerm) -> str:
    size = size_text(*one.size, one.term.unit)
    text = (
        f"Form: {one.coefficient} has a term {one.term.name} of factor {size} ({one.share:.0%} of the variance left "
        f"without it; log density of hold-out data {one.gain:+.0f}). "
    )
    if one.term.code is None:
        text += "It depends on the past, which no effect file can state. "
    if not one.others:
        return text + "No other term of the library is as good."
    others = [f"{term.name} ({weight:.0%})" for term, weight in one.others[:SHOWN]]
    more = f" and {len(one.others) - SHOWN} more" if len(one.others) > SHOWN else ""
    return f"{text}These records do not tell it ({one.weight:.0%}) from {several(others)}{more}."


def _noise(d: Diagnosis) -> list[str]:
    sentences = []
    labels = d.noise.labels
    if d.noise.of_innovations and d.noise.coloured:
        lags = several([f"{name} ({d.noise.lag1[name]:.2f})" for name in d.noise.coloured])
        sentences.append(
            f"Innovations are autocorrelated (neighbouring samples of {lags}): a disturbance, or an error of the model "
            "or of a sensor, is not modelled."
        )
    elif "colored" in labels:
        lags = ", ".join(f"{name} {value:.2f}" for name, value in d.noise.lag1.items())
        sentences.append(
            f"Noise: neighbouring residuals are correlated (coloured noise; lag-1 correlation of means over five "
            f"samples {lags}, where "
            "white noise leaves a third)."
        )
    if "buffet" in labels:
        growth = ", ".join(f"{name} {value:.1f} times" for name, value in d.noise.noise_growth.items() if value > 1.05)
        sentences.append(
            f"Noise: its standard deviation grows as the flow separates or the dynamic pressure falls ({growth})."
        )
    if "outliers" in labels:
        count = ", ".join(f"{name} {n}" for name, n in d.noise.outliers.items() if n)
        sentences.append(f"Noise: outliers were replaced ({count}).")
    return sentences


def revealed(effects: Mapping[str, Mapping[str, float]], named: Mapping[str, str]) -> list[str]:
    """The hidden effects, and whether they were found."""
    sentences = {
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
        found.append(f"Hidden effect: {name} ({sizes}). {sentences[named[name]]}")
    return found


# --- Changes of parameters during a record in sentences: which, when, and by how much.

LIFT, DRAG = "ice or damage of the wing, flaps or slats that moved", "ice, or gear, flaps or spoilers that moved"
STABILITY = "a shift of the centre of gravity (fuel that was burnt or moved, a load), or ice on the tail"
STALL = "ice or damage of the wing"
REASONS = {
    "CL0": f"{LIFT}, or an offset of the vane",
    "CLa": LIFT,
    "CLaM": LIFT,
    "CD0": DRAG,
    "e": DRAG,
    "Cm0": "a stuck tab, another setting of trim or flaps, or a shift of the centre of gravity",
    "Cma": STABILITY,
    "Cmq": STABILITY,
    "Cmde": "ice on the tail, a damaged elevator, or a shift of the centre of gravity",
    "a1": STALL,
    "alpha_star": STALL,
    "CDX": STALL,
    "CmX": STALL,
}
"""What changes a parameter in flight, for those that have usual reasons."""


def change_sentences(found: Sequence[ParameterChange]) -> list[str]:
    """Parameters that change according to a diagnosis: when, by how much, and possible reasons."""
    return [_change(one) for one in found]


def _change(found: ParameterChange) -> str:
    begin, end = found.interval
    span = f" (95 %: {begin:.1f} to {end:.1f} s)" if end > begin else ""
    when = (
        f"from {found.manoeuvre} on"
        if found.between and found.lasts
        else f"in {found.manoeuvre}"
        if found.between
        else f"at {found.at:.1f} s of {found.manoeuvre}{span}"
    )
    back = "" if found.lasts else ", and the value before in later records"
    text = (
        f"Changed: {found.parameter} has another value {when}: {size_text(*found.before, found.unit)} before, "
        f"{size_text(*found.after, found.unit)} after{back}, a change of {size_text(*found.size, found.unit)} "
        f"({found.share:.0%} of the remaining variance)."
    )
    if found.ambiguous_with:
        text += f" On this record {several(found.ambiguous_with)} would explain the data about as well."
    if found.parameter in REASONS:
        text += f" Possible reasons are {REASONS[found.parameter]}; the record does not determine which."
    return text
