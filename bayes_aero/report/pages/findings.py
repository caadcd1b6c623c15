"""What a diagnosis says: its verdict, causes, and what stays unexplained."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from bayes_aero.diagnosis.result import LITTLE
from bayes_aero.effect import Stage
from bayes_aero.effects import CATALOGUE
from bayes_aero.flight.channel import STANDARD_CHANNELS
from bayes_aero.report.pages.estimates import LIMIT, band_text, sign_sentences
from bayes_aero.report.pages.parts import joint_text
from bayes_aero.report.pages.trajectories import gust_sentences, trajectory_sentences
from bayes_aero.report.phrases import WORDS, amounts, not_testable_sentences, sentence, several, size_text, symbol
from bayes_aero.report.table import Estimate, in_brackets

if TYPE_CHECKING:
    from bayes_aero.diagnosis.result import (
        Cause,
        CausesInBand,
        Diagnosis,
        DiagnosisView,
        ParameterChange,
        Size,
        Tested,
        Trajectories,
    )

SHOWN = 4  # other terms that are named
MAX_SIZED = 3  # causes whose sizes are in the verdict


def sentences(view: DiagnosisView) -> list[str]:
    """The findings, one sentence or two each: verdict, causes, unexplained structure, what is not testable."""
    return diagnosis_sentences(view.diagnosis, view.trajectories)


def diagnosis_sentences(d: Diagnosis, flown: Trajectories | None = None) -> list[str]:
    """As `sentences`, of a diagnosis alone."""
    return [said for listed in findings(d, flown).values() for said in listed]


def findings(d: Diagnosis, flown: Trajectories | None = None) -> dict[str, list[str]]:
    """The sentences by what they are on, in the order of reading."""
    bases = {name: (after, sd) for name, (_, after, sd) in d.base_moves.items()}
    left_out = [(c, name, x) for c in d.beyond for name, x in c.parameters.items()]
    too_large = [(c, name, x, n) for c, name, x in left_out for n in (name, f"1/{name}") if n in c.implausible]
    beside = " in comparison with the unexplained structure" if d.left else ""
    return {
        "verdict": [verdict_sentence(d)],
        "gusts": gust_sentences(d.gusts),
        "tested": tested_sentences(d),
        "signs": sign_sentences(bases, d.parameters, d.following),
        "causes": [_cause(cause) for cause in d.causes],
        "next step": _taken_over(d),
        "cancelling": [
            sentence(
                "cancelling",
                pair=pair,
                size=(pair.mean, pair.sd),
                sign="+" if pair.factor > 0.0 else "-",
                factor="" if abs(pair.factor) == 1.0 else f"{abs(pair.factor):.3g} ",
            )
            for pair in d.together
        ],
        "absorbed": [
            sentence("absorbed", a=a, sizes=" or ".join(f"{n} {_size(x)}" for n, x in a.sizes.items()))
            for a in d.absorbed
        ],
        "beyond": [
            sentence("too_large", name=name, x=x, size=(x.mean, x.sd), large=large, most=(c.implausible[large], 0.0))
            for c, name, x, large in too_large
        ]
        + [
            sentence("not_alone", name=name, x=x, size=(x.mean, x.sd), joint=joint_text(c.joint))
            for c, name, x in left_out
            if not c.implausible
        ],
        "minor": [sentence("minor", beside=beside, names=d.minor)] if d.minor else [],
        "unexplained": _unexplained(d),
        "terms": _terms(d),
        "changes": change_sentences(d.changes),
        "noise": _noise(d),
        "not testable": not_testable_sentences(d.not_testable),
        "trajectories": [] if flown is None else trajectory_sentences(flown),
        "notes": list(d.notes),
    }


def _size(x: Size) -> str:
    return size_text(x.mean, x.sd, x.unit)


def _cause(cause: Cause) -> str:
    text = [f"{cause.name}: {cause.claim}"]
    if cause.ambiguous_with:
        gains = {n: f"{gain:+z.1f} ± {sd:.1f}" for n, (gain, sd) in cause.rival_gains.items()}
        place = {n: f" (in its place: log density of hold-out data {gain})" for n, gain in gains.items()}
        rivals = [f"{name}{place.get(name, '')}" for name in cause.ambiguous_with]
        text.append(sentence("as_well", rivals=rivals))
    if cause.joint:
        text.append(sentence("estimated_together", joint=joint_text(cause.joint)))
    if cause.bounded:
        text.append(f"{several(cause.bounded)} is at a parameter bound: suspect another cause.")
    for name, largest in cause.implausible.items():
        unit = cause.parameters[name].unit if name in cause.parameters else "1"
        text.append(sentence("implausible", name=name, most=(largest, 0.0), unit=unit))
    if cause.own_share < LITTLE:
        share = f"{100.0 * cause.own_share:.1f} %" if cause.own_share >= 0.001 else "less than 0.1 %"
        text.append(sentence("hardly_excited", share=share))
    if not cause.excited:
        text.append("Not every manoeuvre excites it.")
    lost, sd = cause.missed
    if np.isfinite(lost) and cause.confirmed:
        text.append(f"Removing it degrades hold-out prediction: log density {-lost:+z.1f} ± {sd:.1f}.")
    elif np.isfinite(lost):
        model = "simulation" if cause.stage == "flight path" else "extended model"
        text.append(f"Hold-out data do not confirm it ({_why_not_confirmed(cause)}); the {model} omits it.")
    return " ".join(text)


def _why_not_confirmed(cause: Cause) -> str:
    """The loss because of which a cause is not confirmed."""
    worse, gain = [], cause.gain
    for name, (change, sd) in gain.degraded.items():
        both = name in gain.before and name in gain.after
        r2 = f", R² from {gain.before[name].r2:.2f} to {gain.after[name].r2:.2f}" if both else ""
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
    both = {"include_effects": fitted, "correct_errors": errors}
    return [sentence(key, names=names) for key, names in both.items() if names]


def _unexplained(d: Diagnosis) -> list[str]:
    """Along trajectories an effect may be true and fail its test, which is less powerful than that of the terms."""
    said, none = [], "explains this" if d.tested is None else "passes its own test along the trajectories"
    for u in d.unknown:
        rivals = several(u.rivals)
        if u.offsets:
            sizes = [f"{name} {size_text(x, sd, '1')}" for name, (x, sd) in u.offsets.items()]
            alike = f" {rivals} would explain them about as well and cannot be told from them." if rivals else ""
            said.append(sentence("offset", u=u, sizes=sizes, alike=alike))
        else:
            said.append(sentence("unattributed" if rivals else "unexplained", u=u, rivals=rivals, none=none))
    return said


def _terms(d: Diagnosis) -> list[str]:
    """A sentence on each term, and how to put them into a card."""
    said = []
    for one in d.terms:
        past = "" if one.term.code is not None else " It depends on the past, which no effect file can state."
        others = several([f"{term.name} ({weight:.0%})" for term, weight in one.others], SHOWN)
        alike = f"These records do not tell it ({one.weight:.0%}) from {others}."
        none = "No other term of the library is as good."
        said.append(sentence("term", one=one, past=past, alike=alike if one.others else none))
    return said + ([sentence("write_terms")] if any(one.term.code is not None for one in d.terms) else [])


def _noise(d: Diagnosis) -> list[str]:
    said, noise = [], d.noise
    if noise.of_innovations and noise.coloured:
        lags = [f"{name} ({noise.lag1[name]:.2f})" for name in noise.coloured]
        said.append(sentence("coloured_innovations", names=lags, more=""))
    elif "colored" in noise.labels:
        lags = ", ".join(f"{name} {value:.2f}" for name, value in noise.lag1.items())
        said.append(sentence("coloured_noise", lags=lags))
    if "buffet" in noise.labels:
        growth = ", ".join(f"{name} {value:.1f} times" for name, value in noise.noise_growth.items() if value > 1.05)
        said.append(sentence("growing_noise", growth=growth))
    if "outliers" in noise.labels:
        count = ", ".join(f"{name} {n}" for name, n in noise.outliers.items() if n)
        said.append(f"Noise: outliers were replaced ({count}).")
    return said


def revealed(effects: Mapping[str, Mapping[str, float]], named: Mapping[str, str]) -> list[str]:
    """The hidden effects, and whether they were found."""
    answers = WORDS["revealed"]
    found = []
    for name, values in effects.items():
        units = {p.name: p.unit for p in CATALOGUE[name].parameters}
        sizes = several(f"{key} = {size_text(x, 0.0, units[key])}" for key, x in values.items())
        found.append(f"Hidden effect: {name} ({sizes}). {answers[named[name]]}")
    return found


def change_sentences(found: Sequence[ParameterChange]) -> list[str]:
    """Parameters that change according to a diagnosis: when, by how much, and possible reasons."""
    said = []
    for one in found:
        begin, end = one.interval
        span = f" (95 %: {begin:.1f} to {end:.1f} s)" if end > begin else ""
        when = f"at {one.at:.1f} s of {one.manoeuvre}{span}"
        if one.between:
            when = f"from {one.manoeuvre} on" if one.lasts else f"in {one.manoeuvre}"
        back = "" if one.lasts else ", and the value before in later records"
        text = [sentence("changed", c=one, when=when, back=back)]
        if one.ambiguous_with:
            text.append(sentence("as_well", rivals=one.ambiguous_with))
        if one.parameter in WORDS["reasons"]:
            text.append(sentence("reasons", reasons=WORDS["reasons"][one.parameter]))
        said.append(" ".join(text))
    return said


# --- The verdict. It rests on causes that are confirmed, probable and of plausible size.


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
    key = "nothing_explains" if d.verdict == "unexplained" and not d.causes else d.verdict.value
    return sentence(f"verdict_{key}", n=len(sure), names=names, left=left, doubtful=_doubtful(d))


def _flown_verdict(d: Diagnosis, tested: Tested, sure: int, names: str, left: str) -> str:
    """The same from trajectories alone: causes explain the error only if the residual is sensor noise."""
    sought = sentence("structure_remains" if d.unknown else "no_structure", left=left)
    sizes, where = "", ""
    if tested.beyond:  # on hold-out flights where there are any
        unseen = all(math.isfinite(tested.outputs[name].unseen) for name in tested.beyond)
        listed = {n: one.unseen if unseen else one.fitted for n, one in tested.outputs.items() if one.beyond}
        sizes = several(f"{symbol(name)} {_rms(name, x)}" for name, x in listed.items())
        where = "on hold-out flights, " if unseen else ""
    key = "errors_remain" if tested.beyond else "within_noise" if tested.outputs else "error_not_computed"
    rest = sentence(key, where=where, sizes=sizes, sought=sought)
    if sure:
        key = "flown_explain" if d.verdict == "explained" else "flown_improve"
        return f"{sentence(key, n=sure, names=names)} {rest}"
    no_effect = d.verdict == "no_effect"
    first = "flown_no_error" if no_effect else "flown_no_reliable" if d.causes else "flown_no_improvement"
    more = f" {sentence('flown_undecided')}" if d.verdict == "undecided" else ""
    return f"{sentence(first)}{_doubtful(d)}. {rest}{more}"


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
    beyond = [symbol(name) for name in d.tested.beyond]
    return [sentence("tested", listed=listed), *([sentence("tested_beyond", names=beyond)] if beyond else [])]


def _named(cause: Cause, sized: bool) -> str:
    """Its name, its size if requested, and its rivals."""
    sizes = ", ".join(_size(x) for x in cause.parameters.values()) if sized else ""
    rivals = f"or {' or '.join(cause.ambiguous_with)}" if cause.ambiguous_with else ""
    text = ", ".join(part for part in (sizes, rivals) if part)
    return f"{cause.name} ({text})" if text else cause.name


def _doubtful(d: Diagnosis) -> str:
    """Named causes on which the verdict does not rest, each with the first reason."""
    reasons: dict[str, list[str]] = {}
    for cause in (c for c in d.causes if not c.sure):
        why = "named, but no more probable than its rivals"
        if cause.bounded:
            why = "at a parameter bound: suspect another cause"
        elif cause.implausible:
            why = "larger than on any aircraft: suspect another cause"
        elif not cause.confirmed:
            why = f"named, but not {'confirmed' if math.isfinite(cause.missed[0]) else 'tested'} on hold-out data"
        reasons.setdefault(why, []).append(_named(cause, sized=False))
    return "".join(f"; {why}: {several(names)}" for why, names in reasons.items())


def in_band_sentences(found: CausesInBand | None) -> tuple[str, ...]:
    """Whether the band confirms the causes."""
    if found is None:
        return ()
    band = band_text(found)
    if not found.converged:
        return (f"The causes could not be fitted from {band}: the band does not determine them.",)
    apart = [s for s in found.sizes if s.apart > LIMIT]
    agree = dict.fromkeys(s.cause for s in found.sizes if s.cause not in {a.cause for a in apart})
    said = [sentence("band_agrees", band=band, names=agree)] if agree else []
    for s in apart:
        inside, whole = (in_brackets(Estimate.normal(*size)) for size in (s.in_band, s.coefficients))
        said.append(sentence("band_differs", s=s, band=band, inside=inside, whole=whole))
    return (*said, *([f"The band does not show {several(found.unseen)}."] if found.unseen else []))
