"""What a diagnosis says and shows: verdict, causes, what stays unexplained, tables, both models; its page."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from itertools import product
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from bayes_aero.effect import Stage
from bayes_aero.effects import CATALOGUE
from bayes_aero.flight.channel import STANDARD_CHANNELS
from bayes_aero.physics.aircraft import LATERAL
from bayes_aero.report.figures.diagnosis import coefficient_panels, telling
from bayes_aero.report.page import Gallery, Report, fold, section
from bayes_aero.report.pages import parts
from bayes_aero.report.pages.estimates import LIMIT, band_text, sign_sentences
from bayes_aero.report.pages.qualification import points_sentences, points_table
from bayes_aero.report.pages.trajectories import gust_sentences, simulation_gain, trajectories, trajectory_sentences
from bayes_aero.report.phrases import (
    WORDS,
    amounts,
    bracket,
    filled,
    for_people,
    from_to,
    not_testable_sentences,
    plain_unit,
    plus_minus,
    sentence,
    several,
    size_text,
    symbol,
)
from bayes_aero.report.plots import MODELS, Panel
from bayes_aero.report.screen import Screen, actions, claims, doubts_of
from bayes_aero.report.table import NONE, BeforeAfter, Column, Estimate, Table, columns_of, table
from bayes_aero.units import number

if TYPE_CHECKING:
    import pandas as pd

    from bayes_aero.diagnosis.result import (
        Cause,
        CausesInBand,
        Diagnosis,
        DiagnosisView,
        HoldoutScores,
        ParameterChange,
        Ranking,
        Size,
        Tested,
        Trajectories,
        View,
        WrongChannel,
    )
    from bayes_aero.flight.card import Card
    from bayes_aero.flight.record import FlightRecord
    from bayes_aero.jobs.results import Outcome

SHOWN = 4  # other terms that are named
SEEN = 0.005  # change of R² that two digits show
FROM_WHAT = {
    "coefficients": "",
    "trajectories": ", from trajectories alone: the record has no coefficients",
    "innovations": ", from innovations: process noise and gusts are estimated",
}
FEW = 4  # manoeuvres that are listed one by one in the open


def sentences(d: Diagnosis, flown: Trajectories | None = None) -> list[str]:
    """The findings, one sentence or two each: verdict, causes, unexplained structure, what is not testable."""
    return [text for listed in findings(d, flown).values() for text in listed]


def findings(d: Diagnosis, flown: Trajectories | None = None) -> dict[str, list[str]]:
    """The same by what they are on, in the order of reading."""
    bases = {name: (after, sd) for name, (_, after, sd) in d.base_moves.items()}
    absorbed = [(a, " or ".join(f"{n} {_size(x)}" for n, x in a.sizes.items())) for a in d.absorbed]
    beside = " in comparison with the unexplained structure" if d.left else ""
    return {
        "verdict": [verdict_sentence(d)],
        "gusts": gust_sentences(d.gusts),
        "tested": tested_sentences(d),
        "signs": sign_sentences(bases, d.parameters, d.following),
        "causes": [*(_cause(cause) for cause in d.causes), *_unsure(d)],
        "next step": _taken_over(d),
        "cancelling": [sentence("cancelling", pair=p, size=(p.mean, p.sd)) for p in d.together],
        "absorbed": [sentence("absorbed", a=a, sizes=sizes) for a, sizes in absorbed],
        "beyond": _beyond(d),
        "minor": [sentence("minor", beside=beside, names=d.minor)] if d.minor else [],
        "unexplained": _unexplained(d),
        "terms": _terms(d),
        "changes": change_sentences(d.changes),
        "noise": _noise(d),
        "not testable": not_testable_sentences(d.not_testable),
        "trajectories": [] if flown is None else trajectory_sentences(flown),
        "notes": list(d.notes),
    }


def _beyond(d: Diagnosis) -> list[str]:
    """What is left out of the model: channels that are wrong as a whole, what is larger than on any aircraft, then what
    was estimated together with that."""
    large, joint = [_whole_channel(c.name, c.wrong) for c in d.beyond if c.wrong], []
    for c, (name, x) in ((cause, item) for cause in d.beyond if not cause.wrong for item in cause.parameters.items()):
        about = {"name": name, "x": x, "size": (x.mean, x.sd)}
        limits = {n: (c.implausible[n], 0.0) for n in (name, f"1/{name}") if n in c.implausible}
        large += [sentence("too_large", **about, large=n, most=most) for n, most in limits.items()]
        joint += [] if c.implausible else [sentence("not_alone", **about, joint=parts.joint_text(c.joint))]
    return large + joint


def _whole_channel(name: str, w: WrongChannel) -> str:
    way, size = ("large", w.times) if w.times > 1.0 else ("small", 1.0 / w.times)
    return sentence(
        "whole_channel", name=name, w=w, size=number(size), way=way, looks=f", as if in {w.unit}" * bool(w.unit)
    )


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
        text.append(sentence("estimated_together", joint=parts.joint_text(cause.joint)))
    if cause.bounded:
        text.append(f"{several(cause.bounded)} is at a parameter bound: suspect another cause.")
    for name, largest in cause.implausible.items():
        unit = cause.parameters[name].unit if name in cause.parameters else "1"
        text.append(sentence("implausible", name=name, most=(largest, 0.0), unit=unit))
    if cause.hardly_excited:
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
    gain, (lost, sd) = cause.gain, cause.missed
    if worse := [f"{name} {change:+z.1f} ± {se:.1f}" for name, (change, se) in gain.degraded.items()]:
        return f"with it they are predicted worse: log density of {several(worse)}"
    if lost > 0.0 and gain.elpd < 0.0:
        return f"beside the causes before it: log density {gain.elpd:+z.1f} ± {gain.elpd_se:.1f}"
    return f"removed: log density {-lost:+z.1f} ± {sd:.1f}"


def _taken_over(d: Diagnosis) -> list[str]:
    """How to put the causes that the verdict rests on into the card: errors have their size, effects are fitted."""
    clear = {c.name: c for c in d.causes if c.sure and not c.ambiguous_with}
    known = [c for name, c in clear.items() if name in CATALOGUE and set(c.joint) <= set(clear)]
    errors = [c for c in known if CATALOGUE[c.name].stage <= Stage.AIRCRAFT]
    fixed = [f"{name} = {x.mean:.4g}" for c in errors for name, x in c.parameters.items()]
    both = {"correct_errors": errors, "include_effects": [c for c in known if c not in errors]}
    return [sentence(k, names=[f'"{c.name}"' for c in some], fixed=fixed) for k, some in both.items() if some]


def _unexplained(d: Diagnosis) -> list[str]:
    """Along trajectories an effect may be true and fail its test, which is less powerful than that of the terms."""
    texts, none = [], "explains this" if d.tested is None else "passes its own test along the trajectories"
    for u in d.unknown:
        rivals = several(u.rivals)
        if u.offsets:
            sizes = [f"{name} {size_text(x, sd, '1')}" for name, (x, sd) in u.offsets.items()]
            alike = f" {rivals} would explain them about as well and cannot be told from them." if rivals else ""
            texts.append(sentence("offset", u=u, sizes=sizes, alike=alike))
        else:
            texts.append(sentence("unattributed" if rivals else "unexplained", u=u, rivals=rivals, none=none))
    return texts


def _terms(d: Diagnosis) -> list[str]:
    texts = []
    for t in d.terms:
        past = "" if t.term.code is not None else " It depends on the past, which no effect file can state."
        others = several([f"{term.name} ({weight:.0%})" for term, weight in t.others], SHOWN)
        alike = f"These records do not tell it ({t.weight:.0%}) from {others}."
        none = "No other term of the library is as good."
        texts.append(sentence("term", t=t, past=past, alike=alike if t.others else none))
    return texts + ([sentence("write_terms")] if any(t.term.code is not None for t in d.terms) else [])


def _noise(d: Diagnosis) -> list[str]:
    texts, noise = [], d.noise
    if noise.of_innovations and noise.coloured:
        lags = [f"{name} ({noise.lag1[name]:.2f})" for name in noise.coloured]
        texts.append(sentence("coloured_innovations", names=lags, more=""))
    elif "colored" in noise.labels:
        texts.append(sentence("coloured_noise", lags=", ".join(f"{name} {x:.2f}" for name, x in noise.lag1.items())))
    if "buffet" in noise.labels:
        growth = ", ".join(f"{name} {value:.1f} times" for name, value in noise.noise_growth.items() if value > 1.05)
        texts.append(sentence("growing_noise", growth=growth))
    if "outliers" in noise.labels:
        replaced = ", ".join(f"{name} {n}" for name, n in noise.outliers.items() if n)
        texts.append(f"Noise: outliers were replaced ({replaced}).")
    return texts


def revealed(effects: Mapping[str, Mapping[str, float]], named: Mapping[str, str]) -> list[str]:
    texts = []
    for name, values in effects.items():
        units = {p.name: p.unit for p in CATALOGUE[name].parameters}
        sizes = several(f"{key} = {size_text(x, 0.0, units[key])}" for key, x in values.items())
        texts.append(f"Hidden effect: {name} ({sizes}). {WORDS['revealed'][named[name]]}")
    return texts


def change_sentences(changes: Sequence[ParameterChange]) -> list[str]:
    texts = []
    for c in changes:
        begin, end = c.interval
        span = f" (95 %: {begin:.1f} to {end:.1f} s)" if end > begin else ""
        when = f"at {c.at:.1f} s of {c.manoeuvre}{span}"
        if c.between:
            when = f"from {c.manoeuvre} on" if c.lasts else f"in {c.manoeuvre}"
        back, reasons = "" if c.lasts else ", and the value before in later records", WORDS["reasons"].get(c.parameter)
        text = [sentence("changed", c=c, when=when, back=back)]
        text += [sentence("as_well", rivals=c.ambiguous_with)] if c.ambiguous_with else []
        text += [sentence("reasons", reasons=reasons)] if reasons else []
        texts.append(" ".join(text))
    return texts


# --- The verdict. It rests on causes that are confirmed, probable and of plausible size.


def verdict_sentence(d: Diagnosis) -> str:
    """Whether the card's model is in error, and whether causes explain that."""
    sure = sum(c.sure for c in d.causes)
    if d.tested is not None:
        return _flown_verdict(d, d.tested, sure)
    key = "nothing_explains" if d.verdict == "unexplained" and not d.causes else d.verdict.value
    return sentence(f"verdict_{key}", n=sure)


def _flown_verdict(d: Diagnosis, tested: Tested, sure: int) -> str:
    """The same from trajectories alone: causes explain the error only if the residual is sensor noise."""
    sizes, where = "", ""
    if tested.beyond:  # on hold-out flights where there are any
        unseen = all(math.isfinite(tested.outputs[name].unseen) for name in tested.beyond)
        missed = {n: tested.outputs[n].unseen if unseen else tested.outputs[n].fitted for n in tested.beyond}
        sizes = several(f"{symbol(name)} {_rms(name, x)}" for name, x in missed.items())
        where = "on hold-out flights, " if unseen else ""
    left = "errors_remain" if tested.beyond else "within_noise" if tested.outputs else "error_not_computed"
    first = "flown_explain" if d.verdict == "explained" else "flown_improve"
    if not sure:
        without = "flown_no_reliable" if d.causes else "flown_no_improvement"
        first = "flown_no_error" if d.verdict == "no_effect" else without
    undecided = ["flown_undecided"] if d.verdict == "undecided" and not sure else []
    keys = (first, left, "structure_remains" if d.unknown else "no_structure", *undecided)
    return " ".join(sentence(key, n=sure, where=where, sizes=sizes) for key in keys)


def _rms(output: str, value: float) -> str:
    return "".join(amounts(STANDARD_CHANNELS[output].unit, value))


def tested_sentences(d: Diagnosis) -> list[str]:
    if d.tested is None or not d.tested.outputs:
        return []
    of = d.tested.outputs
    listed = [f"{symbol(n)} {_rms(n, miss.fitted)} (noise {_rms(n, miss.noise)})" for n, miss in of.items()]
    beyond = [symbol(name) for name in d.tested.beyond]
    return [sentence("tested", listed=listed), *([sentence("tested_beyond", names=beyond)] if beyond else [])]


def _unsure(d: Diagnosis) -> list[str]:
    """Causes on which the verdict does not rest, a sentence for each reason."""
    reasons: dict[str, list[str]] = {}
    for cause in (c for c in d.causes if not c.sure):
        why = "named, but no more probable than its rivals"
        if cause.beside_wrong:
            why = "sought beside a channel that is wrong as a whole"
        elif cause.bounded:
            why = "at a parameter bound: suspect another cause"
        elif cause.implausible:
            why = "larger than on any aircraft: suspect another cause"
        elif not cause.confirmed:
            why = f"named, but not {'confirmed' if math.isfinite(cause.missed[0]) else 'tested'} on hold-out data"
        reasons.setdefault(why, []).append(cause.name)
    return [sentence("unsure_cause", names=names, why=why) for why, names in reasons.items()]


# --- The screen.


def diagnosis_screen(outcome: Outcome, card: Card, records: Sequence[FlightRecord]) -> Screen:
    """The causes on which the verdict rests, in the order in which an engineer mends them, and all doubts."""
    d, flown = outcome.diagnosis, outcome.view.trajectories
    record, mend = parts.record_block(records, outcome.health, outcome.consistency, corrects=d.by_coefficients)
    stages = {name: effect.stage for name, effect in CATALOGUE.items()}  # sensors, aircraft, then the model
    sure = sorted((c for c in d.causes if c.sure), key=lambda c: stages.get(c.name, math.inf))
    gain, answer = "" if flown is None else simulation_gain(flown), verdict_sentence(d)
    shown = [getattr(answer, "claim", answer), *([sure_table(sure)] if sure else []), *([gain] if gain else [])]
    shown += revealed(outcome.hidden, outcome.named) if outcome.hidden else []
    listed = findings(d, flown)
    messages = doubts_of(text for kind, texts in listed.items() if kind != "verdict" for text in texts)
    doubts = [*outcome.failures, *claims(messages), *d.notes, *outcome.notes]
    steps = [*mend, *actions([*_taken_over(d), *messages]), *points_sentences(outcome.test_points)[:1]]
    then = sentence("next_anyway" if d.unreliable else "next_fly", given=parts.given(records, card))
    return Screen(record, shown, doubts, list(dict.fromkeys([*steps, then])))


def sure_table(causes: Sequence[Cause]) -> Table:
    """Each cause with its size, and what it gains on hold-out data."""
    column, rivals = columns_of(causes), "or these"
    columns = [
        column(lambda c: c.name, page="cause"),
        column(_sizes, page="size ± standard error", words=True),
        column(_held_out, page="hold-out data"),
    ]
    if any(c.ambiguous_with for c in causes):
        columns.append(column(lambda c: several(c.ambiguous_with), page=rivals, words=True))
    return Table(columns)


def _held_out(c: Cause) -> str:
    """R² of the coefficient that gains most, before and after; without a gain in sight, what removal costs."""
    pairs = {n: (c.gain.before[n].r2, c.gain.after[n].r2) for n in c.gain.before if n in c.gain.after}
    gains = {n: (b - a, a, b) for n, (a, b) in pairs.items() if math.isfinite(a + b)}
    if gains and (name := max(gains, key=lambda n: gains[n][0])) and gains[name][0] >= SEEN:
        return f"R² {name} {gains[name][1]:z.2f} → {gains[name][2]:z.2f}"
    return f"{-c.missed[0]:+z.0f} ± {c.missed[1]:.0f} nats if removed" if math.isfinite(c.missed[0]) else NONE


def in_band_sentences(sizes: CausesInBand | None) -> tuple[str, ...]:
    if sizes is None:
        return ()
    band = band_text(sizes)
    if not sizes.converged:
        return (f"The causes could not be fitted from {band}: the band does not determine them.",)
    apart = [s for s in sizes.sizes if s.apart > LIMIT]
    agree = dict.fromkeys(s.cause for s in sizes.sizes if s.cause not in {a.cause for a in apart})
    texts = [sentence("band_agrees", band=band, names=agree)] if agree else []
    for s in apart:
        inside, whole = (plus_minus(*size) for size in (s.in_band, s.coefficients))
        texts.append(sentence("band_differs", s=s, band=band, inside=inside, whole=whole))
    return (*texts, *([f"The band does not show {several(sizes.unseen)}."] if sizes.unseen else []))


def causes_table(d: Diagnosis) -> Table:
    """A row for each cause, in files for each of its parameters, SI and radians, with scores on hold-out data."""
    column = columns_of(d.causes)

    def each(get: Callable[[Any], Any], *heads: Any, **how: Any) -> Column:
        return column(lambda c: [get(size) for size in c.parameters.values()], *heads, **how)

    def change(c: Cause, name: str, kind: str) -> BeforeAfter | None:
        both = c.gain.before, c.gain.after
        return BeforeAfter(*(getattr(of[name], kind) for of in both)) if name in c.gain.before else None

    scores = []
    for n, kind in product(dict.fromkeys(name for c in d.causes for name in c.gain.before), ("r2", "rmse")):
        files = f"{n}_{kind}_before", f"{n}_{kind}_after"
        scores.append(column(lambda c, n=n, kind=kind: change(c, n, kind), files))
    if_removed = "hold-out data\nif removed" if any(np.isfinite(c.missed[0]) for c in d.causes) else None
    removed = [f"{-c.missed[0]:+z.1f} ± {c.missed[1]:.1f}" if np.isfinite(c.missed[0]) else NONE for c in d.causes]
    removed = [text if c.confirmed else f"{text} *" for text, c in zip(removed, d.causes, strict=True)]
    columns = [
        Column(range(1, len(d.causes) + 1), "order"),
        column(lambda c: c.name, "cause", "cause"),
        *(column(lambda c, key=key: getattr(c, key), key) for key in ("kind", "stage", "confirmed", "sure")),
        column(lambda c: c.claim, page="what it means", words=True),
        column(lambda c: list(c.parameters), "parameter"),
        column(_sizes, page="size"),
        each(lambda s: Estimate(s.mean, s.sd, *s.ci95), ("mean", "sd", "ci95_low", "ci95_high")),
        each(lambda s: from_to(*(for_people(s.unit)[1] * x for x in (*s.ci95, s.sd))), page="95 % interval"),
        each(lambda s: s.unit, "unit"),
        column(lambda c: c.probability, "probability", "probability", form=probability),
        column(lambda c: c.p_value, "p_value", "p", form=2),
        column(lambda c: " ".join(c.ambiguous_with), "ambiguous_with"),
        column(lambda c: (c.gain.elpd, c.gain.elpd_se), ("elpd", "elpd_se")),
        column(lambda c: Estimate(-c.missed[0], c.missed[1]), ("taken_out_elpd", "taken_out_elpd_se")),
        Column(removed, page=if_removed),
        column(lambda c: several(c.ambiguous_with), page="rivals"),
        *scores,
    ]
    return table("causes", columns)


def _sizes(c: Cause) -> list[str]:
    texts = {name: size_text(s.mean, s.sd, s.unit).replace("c/V", "chords") for name, s in c.parameters.items()}
    return [f"{name} {text}" if len(texts) > 1 else text for name, text in texts.items()]


def probability(value: float) -> str:
    """Two digits, never rounded to certainty."""
    return "> 0.99" if value > 0.99 else f"{value:.2f}"


def changes_table(d: Diagnosis) -> Table:
    """A row for each parameter that takes another value during the records, in files SI and radians."""
    column, sizes = columns_of(d.changes), []
    for n, head in (("before", "before"), ("after", "after"), ("size", "change")):
        sizes.append(column(lambda c, n=n: Estimate(*getattr(c, n)), (n, f"{n}_sd")))
        texts = [filled("{x:±{unit}}", x=getattr(c, n), unit=c.unit) for c in d.changes]
        sizes.append(Column(texts, page=head))
    columns = [
        column(lambda c: c.parameter, "parameter", "parameter"),
        column(lambda c: c.unit, "unit"),
        column(lambda c: c.manoeuvre, "manoeuvre", "manoeuvre"),
        column(lambda c: c.at, "at", "at, s", form=".1f"),
        column(lambda c: BeforeAfter(*c.interval), ("at_low", "at_high")),
        column(lambda c: from_to(c.interval[0], c.interval[1], 0.5), page="95 % interval, s"),
        column(lambda c: c.lasts, "lasts"),
        *sizes,
        column(lambda c: c.share, "share"),
        column(lambda c: c.p_value, "p_value", "p", form=2),
        column(lambda c: c.gain, "elpd", "hold-out gain", form=".1f"),
        column(lambda c: several(c.ambiguous_with), "ambiguous_with", "rivals"),
    ]
    return table("changes", columns)


def terms_table(d: Diagnosis) -> Table:
    """A row for each term that describes unexplained structure, in files SI and radians."""
    column, alike = columns_of(d.terms), lambda t: "; ".join(o.name for o, _ in t.others)
    columns = [
        column(lambda t: t.coefficient, "coefficient", "coefficient"),
        column(lambda t: t.term.name, "term", "term"),
        column(lambda t: t.term.unit, "unit"),
        column(lambda t: Estimate(*t.size), ("size", "size_sd")),
        column(lambda t: filled("{t.size:±{t.term.unit}}", t=t), page="factor"),
        column(lambda t: t.share, "share", "share left", form=".0%"),
        column(lambda t: t.gain, "elpd", "hold-out gain", form=".1f"),
        column(lambda t: t.weight, "probability", "probability", form=".2f"),
        column(alike, "ambiguous_with", "as good", words=True),
    ]
    return table("terms", columns)


def screen_table(rankings: Sequence[Ranking], d: Diagnosis) -> Table:
    """Every candidate of `rankings`: those of the first screening of each stage, the highest score first."""
    causes = {(c.stage, c.name) for c in d.causes}
    rows = [(r, s) for r in rankings for s in r.candidate_scores]
    limits = [r for r in rankings[:1] if np.isfinite(r.threshold)]
    beyond = "".join(f" Noise alone exceeds {r.threshold:.1f} in {100.0 * r.level:g} % of replicates." for r in limits)
    column = columns_of([s for _, s in rows])
    columns = [
        Column([r.stage for r, _ in rows], "stage"),
        column(lambda s: s.effect, "name", "effect"),
        column(lambda s: s.kind, "kind", "kind", words=True),
        column(lambda s: s.score, "score", "score", form=".1f"),
        column(lambda s: s.p_value, "p_value", "p", form=".3f"),
        Column(["yes" if (r.stage, s.effect) in causes else "" for r, s in rows], page="named"),
    ]
    return table("screen", columns, stage=rankings[0].stage if rankings else "", beyond=beyond)


def scores_frame(holdout: HoldoutScores) -> pd.DataFrame:
    """A row for each model, fit, manoeuvre, coefficient: scores of 5 Hz means, and the gain of the extended model."""
    import pandas as pd  # it takes half a second to load

    rows = []
    for (model, data, k), scores in sorted(holdout.scores.items()):
        for name, score in scores.items():
            row = {"model": model, "data": data, "manoeuvre": holdout.names[k], "coefficient": name}
            row |= {"r": score.r, "r2": score.r2, "rmse": score.rmse, "theil": score.theil}
            if (model, data) == ("extended", "hold_out"):
                gain = holdout.gains[holdout.names[k], name]
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
    return table("gain", columns, what=WORDS["splits"][view.diagnosis.split])


def holdout_table(unseen: HoldoutScores) -> Table:
    """Both models on each hold-out manoeuvre, and whether the difference is significant."""
    rows = []
    for k, manoeuvre in enumerate(unseen.names):
        before, after = (unseen.scores[model, "hold_out", k] for model in ("card", "extended"))
        rows += [(manoeuvre, n, BeforeAfter(before[n].r2, after[n].r2), unseen.gains[manoeuvre, n]) for n in before]
    column = columns_of(rows)
    worse = several(f"{name} of {manoeuvre}" for manoeuvre, name in unseen.worse()) or "no manoeuvre"
    columns = [
        column(lambda r: r[0], page="manoeuvre"),
        column(lambda r: r[1], page="coefficient"),
        column(lambda r: r[2], page=("R²\ncard", "R²\nextended"), form=".3f"),
        column(lambda r: f"{r[3].r2:+z.3f} ± {r[3].r2_sd:.3f}", page="change of R²"),
        column(lambda r: f"{r[3].elpd:+z.1f} ± {r[3].elpd_sd:.1f}", page="log density\ngained"),
    ]
    return table("holdout", columns, worse=worse)


def moves_table(view: View) -> Table:
    rows = [(name, m, *for_people(m.unit)) for name, m in view.moves.items()]
    moved = [(m.after - m.before) / m.sd_after if m.sd_after > 0.0 else None for _, m, *_ in rows]
    columns = [
        Column([f"{name} {bracket(plain_unit(unit))}" for name, _, unit, _ in rows], page="parameter"),
        Column([Estimate(f * m.before, f * m.sd_before) for _, m, _, f in rows], page="card's model"),
        Column([Estimate(f * m.after, f * m.sd_after) for _, m, _, f in rows], page="extended model"),
        Column(moved, page="change\n[standard errors]", form="+.1f"),
    ]
    return table("moves", columns)


def residual_table(view: View) -> Table:
    """Each coefficient's residuals before and after: scores, Theil's parts, autocorrelation, and calibration."""
    models = [("card's", view.card), *([("extended", view.extended)] if view.changed else [])]
    rows = [(f"{name}, {label}", fitted.composition[name]) for name in view.coefficients for label, fitted in models]
    column = columns_of([numbers for _, numbers in rows])
    levels = sorted({level for _, numbers in rows for level in numbers["calibration"]}, key=float)
    shares, inside = {"form": ".0%", "group": "Theil's shares"}, {"form": ".0%", "group": "inside the noise's bands"}
    columns = [
        Column([label for label, _ in rows], page=""),
        column(lambda n: n["r2"], page="R²", form=".3f"),
        column(lambda n: n["rmse"], page="RMSE [-]", form=".4f"),
        column(lambda n: n["theil"], page="Theil U", form=".3f"),
        *(column(lambda n, p=p: n[f"theil_{p}"], page=p, **shares) for p in ("bias", "variance", "covariance")),
        column(lambda n: n["lag1"], page="lag-1\ncorrelation", form="+.2f"),
        *(column(lambda n, x=x: n["calibration"][x], page=f"{100.0 * float(x):.0f} %", **inside) for x in levels),
    ]
    return table("residuals", columns)


def diagnosis_page(view: DiagnosisView, context: parts.PageContext) -> Report:
    """The page of a diagnosis, by coefficients (which has a `View`) or by trajectories alone."""
    outcome, card, d = context.result, context.card, view.diagnosis
    whole, captions = cast("View | None", view if hasattr(view, "card") else None), dict(WORDS["captions"])
    if whole is not None:
        panel, manoeuvre, _ = telling(whole)
        captions["found"] = captions["found"].format(panel.name, manoeuvre)
    gallery = Gallery(context.figures, captions)
    lead: list[Any] = [gallery("found") or gallery("measured_simulated")]
    if d.compared == "trajectories":
        lead.append("The record lacks channels from which lift, drag and moment coefficients are formed.")
    elif whole is not None and not context.figures:
        lead.append(WORDS["paragraphs"]["not_drawn"])
    residuals = "Residuals: size, composition, autocorrelation, calibration"
    drawn = gallery("residual_profiles", "residual_colour")
    moves = (
        whole and whole.moves and (moves_table(whole), parts.symbols(card, whole.parameters, whole.moves, degrees=True))
    )
    in_full = sentences(d, view.trajectories)[1:], parts.not_testable_list(d.not_testable)
    return Report(
        title=f"Diagnosis: {card.title}",
        subtitle=f"The model error, its causes, and the gain of the extended model{FROM_WHAT[d.compared]}",
        verdict=diagnosis_screen(outcome, card, context.records),
        lead=lead,
        sections=[
            parts.records_section(card, context.records, outcome.health),
            section("causes", "Causes of the model error", lambda: _causes(view, context)),
            section("gain", "Gain of the extended model on hold-out data", lambda: whole and _gain(whole, gallery)),
            section("open", "What is open", lambda: _open(d, context) if whole else in_full),
            section("fit", "Measured and simulated coefficients", lambda: whole and _coefficients(whole)),
            section("trajectories", "Trajectories, before and after", lambda: _flown(view, card)),
            section("stall", "The stall", lambda: _stall(whole, gallery)),
            section("parameters", "Change of the card's parameters", lambda: moves),
            section("diagnostics", "Diagnostics", lambda: whole and fold(residuals, residual_table(whole), drawn)),
            parts.provenance_section(context.source, outcome.notes),
        ],
    )


def _causes(view: DiagnosisView, context: parts.PageContext) -> list[Any]:
    d = view.diagnosis
    shared = "; rivals (last column) share it" if any(c.ambiguous_with for c in d.causes) else ""
    leaders = [replace(ranking, candidate_scores=ranking.leaders) for ranking in view.rankings]
    screens = [screen_table([ranking], d) for ranking in leaders]
    return [
        (f"{WORDS['paragraphs']['causes']}{shared}.", causes_table(d)) if d.causes else "No cause is named.",
        sentence("minor", beside="", names=d.minor) if d.minor else None,
        parts.terms("glossary"),
        fold("Every candidate's score before anything was added", screens),
        list(in_band_sentences(context.result.in_band)),
    ]


def _stall(view: View | None, gallery: Gallery) -> Any:
    if view is None or not view.stalls:
        return "CLmax and the stall angle are not given: they need lift coefficients."
    about = "Intervals are from normal draws with the covariance of the fit, autocorrelation included."
    stalls = {MODELS[key]: s for key, s in view.stalls.items()}
    return parts.stall_table(stalls, about), gallery("stall_models", "separation_models")


def _flown(view: DiagnosisView, card: Card) -> Any:
    if view.trajectories is None:
        return "No trajectories were simulated in this run."
    return trajectories(view.trajectories, card), trajectory_sentences(view.trajectories)


def _gain(view: View, gallery: Gallery) -> tuple[Any, ...]:
    whole = gain_table(view)
    if whole is None:
        return ("Nothing was added, so there is no gain to report.",)
    each = None if view.holdout is None else holdout_table(view.holdout)
    return whole, fold("The same, manoeuvre by manoeuvre", each) if len(view.names) > FEW else each, gallery("gain")


def _open(d: Diagnosis, context: parts.PageContext) -> list[Any]:
    listed, points, sensors = findings(d), context.result.test_points, context.result.consistency
    sets = [f"{c.name} or {several(c.ambiguous_with)}" for c in d.causes if c.ambiguous_with]
    rivals = f"Rival explanations on this record: {'; '.join(sets)}."
    structure = ("beyond", "unexplained", "terms", "changes")
    apart = {"verdict", "causes", "cancelling", *structure}
    others = [text for kind, texts in listed.items() if kind not in apart for text in texts]
    left = [text for kind in structure for text in listed[kind]]
    return [
        rivals if sets else "No named cause has a rival on this record.",
        listed["cancelling"],
        list(points_sentences(points)),
        points_table(points) if points and points["points"] else None,
        None if sensors is None else parts.open_sentences(sensors),
        left or "No structure remains that a recorded channel predicts.",
        terms_table(d) if d.terms else None,
        changes_table(d) if d.changes else None,
        fold("Noise, and effects that this record cannot test", others or "None."),
        parts.not_testable_list(d.not_testable),
    ]


def _coefficients(view: View) -> list[Any]:
    lateral = bool(set(LATERAL) & set(view.coefficients))
    what = "Coefficients measured and simulated by the card's and the extended model, and the controls,"

    def drawn(order: int, _: str) -> tuple[np.ndarray, list[Panel]]:
        mine = view.manoeuvre == order
        context = parts.context_panels(view.channels, mine, lateral=lateral)
        return view.time[mine], coefficient_panels(view, order) + context

    return [WORDS["paragraphs"]["coefficients"], parts.flights(view.names, "coefficients", what, drawn)]
