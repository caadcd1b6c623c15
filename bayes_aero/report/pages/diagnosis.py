"""What a diagnosis shows: its verdict, causes, what stays unexplained, what the extended model gains; its page."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from bayes_aero.diagnosis.result import LITTLE
from bayes_aero.effect import Stage
from bayes_aero.effects import CATALOGUE
from bayes_aero.flight.channel import STANDARD_CHANNELS
from bayes_aero.physics.aircraft import LATERAL
from bayes_aero.report.figures.diagnosis import coefficient_panels, telling
from bayes_aero.report.html.page import Gallery, Report, Section, Text, fold, section
from bayes_aero.report.pages import parts
from bayes_aero.report.pages.estimates import LIMIT, band_text, sign_sentences
from bayes_aero.report.pages.fly import gust_sentences
from bayes_aero.report.pages.parts import DEG, interval, joint_text
from bayes_aero.report.pages.qualification import points_sentences, points_table
from bayes_aero.report.pages.trajectories import simulation_gain, trajectories, trajectory_sentences
from bayes_aero.report.phrases import (
    WORDS,
    amounts,
    bracket,
    for_people,
    from_to,
    not_testable_sentences,
    plain_unit,
    sentence,
    several,
    size_text,
    symbol,
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
    from bayes_aero.diagnosis.accuracy import Size
    from bayes_aero.diagnosis.result import Cause, CausesInBand, Diagnosis, ParameterChange, Tested
    from bayes_aero.diagnosis.trajectory_result import DiagnosisView, HoldoutScores, Ranking, Trajectories, View

NOTES = WORDS["notes"]
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
    return [sentence("tested", listed=listed) + (f" {sentence('tested_beyond', names=beyond)}" if beyond else "")]


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


# --- Tables: causes, changes, terms, candidates.

ON_A_TERMINAL = 3  # coefficients whose R² fit in 80 columns: those that change most


def causes_table(d: Diagnosis) -> Table:
    """A row for each cause, in files for each of its parameters, SI and radians, with scores on hold-out data."""
    column = columns_of(d.causes)

    def each(get: Callable[[Any], Any], *heads: Any, **how: Any) -> Column:
        return column(lambda c: [get(size) for size in c.parameters.values()], *heads, **how)

    def score(name: str, kind: str) -> Column:
        files = tuple(f"{name}_{kind}_{when}" for when in ("before", "after"))
        head = f"R² {name}" if kind == "r2" and name in shown else None
        return column(lambda c: _change(c, name, kind), files, None, head, ".2f")

    names = dict.fromkeys(name for c in d.causes for name in c.gain.before)
    shown: Sequence[str] = ()
    if d.by_coefficients:  # those whose R² any of the causes changes most
        pairs = {name: [x for c in d.causes if (x := _change(c, name, "r2")) is not None] for name in names}
        sizes = {n: [abs(b - a) for a, b in found if a is not None and b is not None] for n, found in pairs.items()}
        shown = sorted(names, key=lambda name: -max(map(float, np.nan_to_num(sizes[name])), default=0.0))
        shown = shown[:ON_A_TERMINAL]
    if_removed = "hold-out data\nif removed" if any(np.isfinite(c.missed[0]) for c in d.causes) else None
    rivals = "rivals", None if d.by_coefficients else "rivals"
    title, note = _causes_heading(d, len(shown), len(names))
    return Table(
        [
            Column(range(1, len(d.causes) + 1), "order"),
            column(lambda c: c.name if c.sure else f"{c.name}{'†' if c.confirmed else '*'}", terminal="cause"),
            column(lambda c: c.name, "cause", "cause"),
            *(column(lambda c, key=key: getattr(c, key), key) for key in ("kind", "stage", "confirmed", "sure")),
            column(lambda c: c.claim, page="what it means", words=True),
            column(lambda c: list(c.parameters), "parameter"),
            column(_sizes, page="size"),
            each(_size, terminal="size", words=True),
            each(lambda s: Estimate(s.mean, s.sd, *s.ci95), ("mean", "sd", "ci95_low", "ci95_high")),
            each(_interval, page="95 % interval"),
            each(lambda s: s.unit, "unit"),
            column(lambda c: c.probability, "probability", "probability", "prob.", probability),
            column(lambda c: c.p_value, "p_value", "p", form=2),
            column(lambda c: " ".join(c.ambiguous_with), "ambiguous_with"),
            column(lambda c: (c.gain.elpd, c.gain.elpd_se), ("elpd", "elpd_se")),
            column(lambda c: Estimate(-c.missed[0], c.missed[1]), ("taken_out_elpd", "taken_out_elpd_se")),
            column(lambda c: c, page=if_removed, form=_if_removed),
            column(lambda c: several(c.ambiguous_with), "", *rivals, or_dash, str),
            *(score(name, kind) for name in names for kind in ("r2", "rmse")),
        ],
        "Causes, in the order of selection",
        NOTES["causes"],
        title,
        note,
    )


def _causes_heading(d: Diagnosis, shown: int, scored: int) -> tuple[str, str]:
    """Title and note of the causes on a terminal."""
    if not d.by_coefficients:
        source = "innovations" if d.compared == "innovations" else "trajectories alone"
        return f"Causes, from {source}", "" if all(c.sure for c in d.causes) else NOTES["causes_flown"]
    most = f"R² of the {shown} coefficients that change most. " if 0 < shown < scored else ""
    return f"Causes; R² on hold-out data ({WORDS['splits'][d.split]}), before → after", most + NOTES["causes_terminal"]


def _sizes(c: Cause) -> list[str]:
    """Sizes, with names where there are several."""
    texts = {name: _size(s).replace("c/V", "chords") for name, s in c.parameters.items()}
    return [f"{name} {text}" for name, text in texts.items()] if len(texts) > 1 else list(texts.values())


def _interval(s: Any) -> str:
    factor = for_people(s.unit)[1]
    return from_to(factor * s.ci95[0], factor * s.ci95[1], factor * s.sd)


def probability(value: float) -> str:
    """Two digits, never rounded to certainty."""
    return "> 0.99" if value > 0.99 else f"{value:.2f}"


def _if_removed(c: Cause) -> str:
    text = f"{-c.missed[0]:+z.1f} ± {c.missed[1]:.1f}" if np.isfinite(c.missed[0]) else NONE
    return text if c.confirmed else f"{text} *"


def _change(c: Cause, name: str, kind: str) -> BeforeAfter | None:
    """A score of a coefficient on hold-out data without and with a cause."""
    if name not in c.gain.before:
        return None
    return BeforeAfter(getattr(c.gain.before[name], kind), getattr(c.gain.after[name], kind))


def changes_table(d: Diagnosis) -> Table:
    """A row for each parameter that takes another value during the records, in files SI and radians."""
    column, parts_ = columns_of(d.changes), ("before", "after", "size")
    heads = {"before": "before", "after": "after", "size": "change"}
    return Table(
        [
            column(lambda c: c.parameter, "parameter", "parameter", "parameter"),
            column(lambda c: c.unit, "unit"),
            column(lambda c: c.manoeuvre, "manoeuvre", "manoeuvre", "manoeuvre"),
            column(lambda c: c.at, "at", "at, s", "at, s", ".1f"),
            column(lambda c: BeforeAfter(*c.interval), ("at_low", "at_high")),
            column(lambda c: from_to(*c.interval, 0.5), page="95 % interval, s"),
            column(lambda c: c.lasts, "lasts"),
            *(column(lambda c, n=n: Estimate(*getattr(c, n)), (n, f"{n}_sd")) for n in parts_),
            *(
                column(lambda c, n=n: size_text(*getattr(c, n), c.unit), page=head, terminal=head)
                for n, head in heads.items()
            ),
            column(lambda c: c.share, "share"),
            column(lambda c: c.p_value, "p_value", "p", "p", 2),
            column(lambda c: c.gain, "elpd", "hold-out gain", None, ".1f"),
            column(lambda c: several(c.ambiguous_with), "ambiguous_with", "rivals", "rivals", or_dash),
        ],
        "Parameters that change during the records",
        NOTES["changes"],
    )


def terms_table(d: Diagnosis) -> Table:
    """A row for each term that describes unexplained structure, in files SI and radians."""
    column, alike = columns_of(d.terms), lambda t: "; ".join(o.name for o, _ in t.others)
    return Table(
        [
            column(lambda t: t.coefficient, "coefficient", "coefficient"),
            column(lambda t: t.term.name, "term", "term"),
            column(lambda t: t.term.unit, "unit"),
            column(lambda t: Estimate(*t.size), ("size", "size_sd")),
            column(lambda t: size_text(*t.size, t.term.unit), page="factor"),
            column(lambda t: t.share, "share", "share left", form=".0%"),
            column(lambda t: t.gain, "elpd", "hold-out gain", None, ".1f"),
            column(lambda t: t.weight, "probability", "probability", form=".2f"),
            column(alike, "ambiguous_with", "as good", None, or_dash, words=True),
        ],
        "Terms that describe unexplained structure",
        NOTES["terms"],
    )


def screen_table(rankings: Sequence[Ranking], d: Diagnosis) -> Table:
    """Every candidate of `rankings`: those of the first screening of each stage, the highest score first."""
    causes = {(c.stage, c.name) for c in d.causes}
    rows = [(r, s) for r in rankings for s in r.candidate_scores]
    limits = [r for r in rankings[:1] if np.isfinite(r.threshold)]
    beyond = "".join(f" Noise alone exceeds {r.threshold:.1f} in {100.0 * r.level:g} % of replicates." for r in limits)
    column = columns_of([s for _, s in rows])
    return Table(
        [
            Column([r.stage for r, _ in rows], "stage", terminal="stage"),
            column(lambda s: s.effect, "name", "effect", "candidate"),
            column(lambda s: s.kind, "kind", "kind", words=True),
            column(lambda s: s.score, "score", "score", "score", ".1f"),
            column(lambda s: s.p_value, "p_value", "p", "p", ".3f"),
            Column(["yes" if (r.stage, s.effect) in causes else "" for r, s in rows], page="named"),
        ],
        f"Leading candidates of the stage “{rankings[0].stage if rankings else ''}”",
        sentence("screen_note", beyond=beyond, named_if=NOTES["named_if"]),
        "Leading candidates",
        f"p is family-wise, 0.005 at the least. {NOTES['named_if']}",
    )


# --- The card's and the extended model side by side: hold-out scores, parameters, residuals.


def scores_frame(found: HoldoutScores) -> pd.DataFrame:
    """A row for each model, fit, manoeuvre, coefficient: scores of 5 Hz means, and the gain of the extended model."""
    rows = []
    for (model, data, k), scores in sorted(found.scores.items()):
        for name, one in scores.items():
            row = {"model": model, "data": data, "manoeuvre": found.names[k], "coefficient": name}
            row |= {"r": one.r, "r2": one.r2, "rmse": one.rmse, "theil": one.theil}
            if (model, data) == ("extended", "hold_out"):
                gain = found.gains[found.names[k], name]
                row |= {"elpd_gain": gain.elpd, "elpd_gain_sd": gain.elpd_sd}
                row |= {"r2_gain": gain.r2, "r2_gain_sd": gain.r2_sd}
            rows.append(row)
    return pd.DataFrame(rows)


def gain_table(view: DiagnosisView) -> Table | None:
    """Scores of each coefficient on hold-out data; nothing where nothing was added."""
    if view.unseen_scores is None:
        return None
    names = list(view.unseen_scores[1])
    columns = [Column(names, page="coefficient")]
    for when, scores in zip(("before", "after"), view.unseen_scores, strict=True):
        columns.append(Column([scores[name].r2 for name in names], page=f"R² {when}", form=".3f"))
        columns.append(Column([scores[name].rmse for name in names], page=f"RMSE {when} [-]", form=".4f"))
    by_manoeuvre = view.diagnosis.split == "manoeuvre"
    what = "each manoeuvre predicted from the others" if by_manoeuvre else "each block from the others"
    return Table(
        columns,
        f"Hold-out data ({what}): the card's model before, with all confirmed causes after",
        "5 Hz means. R² below zero: worse than a constant.",
    )


def holdout_table(unseen: HoldoutScores) -> Table:
    """Both models on each hold-out manoeuvre, and whether the difference is significant."""
    rows = []
    for k, manoeuvre in enumerate(unseen.names):
        before, after = (unseen.scores[model, "hold_out", k] for model in ("card", "extended"))
        rows += [(manoeuvre, n, BeforeAfter(before[n].r2, after[n].r2), unseen.gains[manoeuvre, n]) for n in before]
    column = columns_of(rows)
    worse = several(f"{name} of {manoeuvre}" for manoeuvre, name in unseen.worse()) or "no manoeuvre"
    return Table(
        [
            column(lambda r: r[0], page="manoeuvre"),
            column(lambda r: r[1], page="coefficient"),
            column(lambda r: r[2], page=("R²\ncard", "R²\nextended"), form=".3f"),
            column(lambda r: f"{r[3].r2:+z.3f} ± {r[3].r2_sd:.3f}", page="change of R²"),
            column(lambda r: f"{r[3].elpd:+z.1f} ± {r[3].elpd_sd:.1f}", page="log density\ngained"),
        ],
        "Hold-out manoeuvres: the card's model and the extended model",
        f"{NOTES['holdout']} The log density decreases significantly (one-sided, 5 %) for {worse}.",
    )


def moves_table(view: View) -> Table:
    """The card's own parameters before and after."""
    column = columns_of([(name, m, *for_people(m.unit)) for name, m in view.moves.items()])
    return Table(
        [
            column(lambda r: f"{r[0]} {bracket(plain_unit(r[2]))}", page="parameter"),
            column(lambda r: Estimate(r[3] * r[1].before, r[3] * r[1].sd_before), page="card's model"),
            column(lambda r: Estimate(r[3] * r[1].after, r[3] * r[1].sd_after), page="extended model"),
            column(
                lambda r: (r[1].after - r[1].before) / r[1].sd_after if r[1].sd_after > 0.0 else None,
                page="change\n[standard errors]",
                form="+.1f",
            ),
        ],
        "The card's parameters, fitted without and with the causes",
        "± is one standard error, autocorrelation included.",
    )


def residual_tables(view: View) -> tuple[Table, Table]:
    """Each coefficient's residuals before and after: scores, Theil's parts, autocorrelation; then calibration."""
    models = [("card's", view.card), *([("extended", view.extended)] if view.changed else [])]
    rows = [(f"{name}, {label}", fitted.composition[name]) for name in view.coefficients for label, fitted in models]
    column, first = columns_of([numbers for _, numbers in rows]), Column([label for label, _ in rows], page="")
    group = "Theil's shares of the squared error"
    shares = [
        column(lambda n, part=part: n[f"theil_{part}"], page=part, form=".0%", group=group)
        for part in ("bias", "variance", "covariance")
    ]
    levels = sorted({level for _, numbers in rows for level in numbers["calibration"]}, key=float)
    return Table(
        [
            first,
            column(lambda n: n["r2"], page="R²", form=".3f"),
            column(lambda n: n["rmse"], page="RMSE [-]", form=".4f"),
            column(lambda n: n["theil"], page="Theil U", form=".3f"),
            *shares,
            column(lambda n: n["lag1"], page="lag-1\ncorrelation", form="+.2f"),
        ],
        "Residuals at the recorded rate, all manoeuvres fitted jointly",
        NOTES["residuals"],
    ), Table(
        [
            first,
            *(column(lambda n, x=x: n["calibration"][x], page=f"{100.0 * float(x):.0f} %", form=".0%") for x in levels),
        ],
        "Calibration: share of 5 Hz residuals inside the fitted noise's bands",
        "A right noise model shows the heading's share in each column.",
    )


# --- Sizes of the causes in a band of frequencies beside those of the coefficients: a table, and what it says.


def in_band_table(found: CausesInBand) -> Table:
    """A row for each parameter of a cause that the band shows, SI and radians."""
    sizes = found.sizes
    both = (([s.coefficients for s in sizes], "coefficients"), ([s.in_band for s in sizes], "in the band"))
    return Table(
        [
            Column([s.cause for s in sizes], "cause", "cause"),
            *parameter_columns([s.parameter for s in sizes], [s.unit for s in sizes]),
            *(Column([Estimate.normal(*x) for x in values], page=head, form=in_brackets) for values, head in both),
            Column([s.apart for s in sizes], page="difference\n[standard errors]", form=".1f"),
        ],
        f"Sizes from {band_text(found)}, where bias and drift drop out",
        "In brackets: standard error in units of the last digit. SI and radians.",
    )


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


# --- Captions and alternative texts of the figures, which say in numbers what each shows.


def diagnosis_alternatives(view: View) -> dict[str, tuple[str, str]]:
    """Caption and alternative text by stem."""
    before, after, best = view.card.composition, view.extended.composition, telling(view)
    what = best.quantity.replace("_", " ")
    leading = {r.stage: several(f"{s.effect} {s.score:.1f}" for s in r.candidate_scores[:3]) for r in view.rankings}
    moves = [(abs(m.after - m.before) / max(m.sd_after, 1e-300), n, m) for n, m in view.moves.items()]
    far = sorted(moves, key=lambda move: -move[0])[:3]
    peaks, apart = [], []
    for label, s in view.stalls.items():
        X, peak = s.X[1][1], {"CL": interval(s.CL_max), "alpha": interval(s.alpha_max, DEG, 1)}
        ends = {"begin": DEG * s.alpha[0], "end": DEG * s.alpha[-1], "first": X[0], "last": X[-1]}
        apart.append(sentence("model_separation", label=label, **ends))
        peaks.append(sentence("model_peak" if s.seen else "model_rises", label=label, **peak))
    values = {
        "what": what,
        "manoeuvre": best.manoeuvre,
        "change": several(f"{note} with the {label}" for label, _, _, note in best.simulated),
        "leaders": "; ".join(f"{stage}: {listed}" for stage, listed in leading.items()),
        "gained": gained(view),
        "moved": several(f"{n} from {number(m.before)} to {number(m.after)}" for _, n, m in far),
        "names": before,
        "errors": several(f"{n} {numbers['rmse']:.4f} and {after[n]['rmse']:.4f}" for n, numbers in before.items()),
        "lags": several(f"{n} {numbers['lag1']:.2f} and {after[n]['lag1']:.2f}" for n, numbers in before.items()),
        "peaks": " ".join(peaks),
        "apart": " ".join(apart),
    }
    stems = ["found", "ranking", "gain", "moves", "residual_profiles", "residual_colour", "stall_models"]
    stems += ["separation_models", "measured_simulated"]
    captions = WORDS["captions"]
    return {n: (captions[n].format(what, best.manoeuvre), sentence(f"alt_{n}", **values)) for n in stems}


def gained(view: View) -> str:
    """R² of each coefficient on hold-out data before and after, where it changes."""
    if view.unseen_scores is None:
        return ""
    first, last = view.unseen_scores
    pairs = {n: (f"{first[n].r2:.3f}", f"{last[n].r2:.3f}") for n in first if n in last}
    moved = {n: pair for n, pair in pairs.items() if pair[0] != pair[1]}
    return several(f"{n} R² from {before} to {after}" for n, (before, after) in moved.items()) + "." if moved else ""


# --- The page.

CONTEXT = ("alpha", "elevator", "stabilizer", "thrust", "airspeed")
FROM_WHAT = {
    "coefficients": "",
    "trajectories": ", from trajectories alone: the record has no coefficients",
    "innovations": ", from innovations: process noise and gusts are estimated",
}
FEW = 4  # manoeuvres that are listed one by one in the open


@dataclass(frozen=True)
class DiagnosisContext(parts.PageContext):
    """Data of a diagnosis page in addition to the diagnosis."""

    test_points: Mapping[str, Any] = field(default_factory=dict)
    in_band: CausesInBand | None = None
    revealed: Sequence[str] = ()


def diagnosis_page(view: DiagnosisView | View, context: DiagnosisContext) -> Report:
    """The page of a diagnosis, by coefficients or by trajectories alone."""
    d, by_coefficients = view.diagnosis, hasattr(view, "card")
    gallery = Gallery(context.figures, diagnosis_alternatives(view) if by_coefficients else {})
    verdict, *rest = diagnosis_sentences(d) if by_coefficients else sentences(view)
    lead: list[Any] = [Text(one, "lead") for one in context.revealed]
    if by_coefficients and gained(view):
        lead.append(Text(f"On hold-out data, before and after: {gained(view)}", "lead"))
    if view.trajectories is not None and (gain := simulation_gain(view.trajectories)):
        lead.append(Text(gain, "lead"))
    lead.append(gallery("found") or gallery("measured_simulated"))
    if d.compared == "trajectories":
        lead.append("The record lacks channels from which lift, drag and moment coefficients are formed.")
    elif by_coefficients and not context.figures:
        lead.append(WORDS["paragraphs"]["not_drawn"])
    return Report(
        title=f"Diagnosis: {context.card.title}",
        subtitle=f"The model error, its causes, and the gain of the extended model{FROM_WHAT[d.compared]}",
        verdict=verdict,
        lead=lead,
        doubts=parts.doubts(context.consistency, context.health, context.failures, corrects=by_coefficients),
        sections=[
            parts.records_section(context),
            section("causes", "Causes of the model error", lambda: _causes(view, context, gallery)),
            *(_by_coefficients(view, context, gallery) if by_coefficients else _flown_alone(view, context, rest)),
            parts.provenance_section(context.source, context.notes),
        ],
    )


def _causes(view: DiagnosisView, context: DiagnosisContext, gallery: Gallery) -> list[Any]:
    d, band = view.diagnosis, context.in_band
    shared = "; rivals (last column) share it" if any(c.ambiguous_with for c in d.causes) else ""
    about = f"{WORDS['paragraphs']['causes']}{shared}.", causes_table(d)
    leaders = [replace(ranking, candidate_scores=ranking.leaders) for ranking in view.rankings]
    screens = [screen_table([ranking], d) for ranking in leaders]
    return [
        about if d.causes else "No cause is named.",
        sentence("minor", beside="", names=d.minor) if d.minor else None,
        parts.terms("glossary"),
        fold("Every candidate's score before anything was added", screens, gallery("ranking")),
        list(in_band_sentences(band)),
        in_band_table(band) if band is not None and band.sizes else None,
    ]


def _by_coefficients(view: View, context: DiagnosisContext, gallery: Gallery) -> list[Section]:
    d, labels = view.diagnosis, {"card": "card's model", "extended": "extended model"}

    def stall() -> tuple[Any, ...]:
        if not view.stalls:
            return ("CLmax and the stall angle are not given: no coefficients were formed.",)
        stalls = {labels[key]: s for key, s in view.stalls.items()}
        said = "Intervals are from normal draws with the covariance of the fit, autocorrelation included."
        return parts.stall_table(stalls, said), gallery("stall_models", "separation_models")

    def residuals() -> Any:
        title = "Residuals: size, composition, autocorrelation, calibration"
        return fold(title, residual_tables(view), gallery("residual_profiles", "residual_colour"))

    def moves() -> tuple[Any, ...]:
        known = parts.symbols(view.parameters, view.moves, degrees=True)
        return (moves_table(view), known, gallery("moves")) if view.moves else ()

    return [
        section("gain", "Gain of the extended model on hold-out data", lambda: _gain(view, gallery)),
        section("open", "Rivals and unexplained structure", lambda: _open(d, context)),
        section("fit", "Measured and simulated coefficients", lambda: _coefficients(view)),
        section("trajectories", "Trajectories, before and after", lambda: _flown(view, context)),
        section("stall", "The stall", stall),
        section("parameters", "Change of the card's parameters", moves),
        section("diagnostics", "Diagnostics", residuals),
    ]


def _flown_alone(view: DiagnosisView, context: DiagnosisContext, rest: Sequence[str]) -> list[Section]:
    """The sections of a diagnosis by trajectories alone or by innovations."""
    d = view.diagnosis
    reason = "without accelerometers lift is not measured"
    if d.compared == "innovations":
        reason = "a diagnosis by innovations forms no lift coefficient"
    full = (list(rest), parts.open_list(context.consistency), parts.not_testable_list(d.not_testable))
    return [
        section("open", "Findings in full", lambda: full),
        section("trajectories", "Trajectories, before and after", lambda: _flown(view, context)),
        section("stall", "The stall", lambda: f"CLmax and the stall angle are not given: {reason}."),
    ]


def _flown(view: DiagnosisView, context: DiagnosisContext) -> tuple[Any, ...]:
    if view.trajectories is None:
        return ("No trajectories were simulated in this run.",)
    remarks = trajectory_sentences(view.trajectories, tolerances=False)  # the table has those
    return trajectories(view.trajectories, context.card), remarks


def _gain(view: View, gallery: Gallery) -> tuple[Any, ...]:
    """Scores on hold-out data, then of the manoeuvres one by one, where they were scored; many are folded."""
    table = gain_table(view)
    if table is None:
        return ("Nothing was added, so there is no gain to report.",)
    each = None if view.holdout is None else holdout_table(view.holdout)
    return table, fold("The same, manoeuvre by manoeuvre", each) if len(view.names) > FEW else each, gallery("gain")


def _open(d: Diagnosis, context: DiagnosisContext) -> list[Any]:
    said, points = findings(d), context.test_points
    sets = [f"{c.name} or {several(c.ambiguous_with)}" for c in d.causes if c.ambiguous_with]
    rivals = f"Rival explanations on this record: {'; '.join(sets)}."
    structure = ("beyond", "unexplained", "terms", "changes")
    apart = {"verdict", "causes", "cancelling", *structure}
    others = [s for kind, listed in said.items() if kind not in apart for s in listed]
    sensors = context.consistency
    return [
        rivals if sets else "No named cause has a rival on this record.",
        said["cancelling"],
        list(points_sentences(points)),
        points_table(points) if points and points["points"] else None,
        None if sensors is None else (parts.open_sentences(sensors), parts.open_list(sensors)),
        [s for kind in structure for s in said[kind]] or "No structure remains that a recorded channel predicts.",
        terms_table(d) if d.terms else None,
        changes_table(d) if d.changes else None,
        fold("Noise, and effects that this record cannot test", others or "None."),
        parts.not_testable_list(d.not_testable),
    ]


def _coefficients(view: View) -> list[Any]:
    shown, more = parts.first(view.names)
    context = parts.SIX_CONTEXT if set(LATERAL) & set(view.coefficients) else CONTEXT
    what, plots = "Coefficients measured and simulated by the card's and the extended model, and the controls,", []
    for order, name in enumerate(shown):
        mine, panels = view.manoeuvre == order, coefficient_panels(view, order)
        last = panels[0].lines[-1]
        curves = [(line.label, line.colour, line.style) for line in panels[0].lines]
        legend = (*curves, (f"error of the {last.label}", last.colour, "area"))
        moved = {c: np.asarray(view.channels[c], float)[mine] for c in context if c in view.channels}
        panels += parts.context_panels({c: values for c, values in moved.items() if np.ptp(values) > 0.0})
        plots.append(parts.histories(name, f"time-coefficients-{order}", view.time[mine], panels, legend, what))
    return [WORDS["paragraphs"]["coefficients"], more, plots]
