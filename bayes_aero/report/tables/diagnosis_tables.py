"""A diagnosis as tables of numbers: its causes, every candidate, and scores by manoeuvre."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pandas as pd

from bayes_aero.diagnosis.result import (
    INNOVATIONS,
    LEVELS,
    Cause,
    Diagnosis,
    DiagnosisView,
    HoldoutScores,
    Ranking,
    View,
)
from bayes_aero.report.tables.table import NONE, BeforeAfter, Column, Estimate, Table, columns_of, or_dash
from bayes_aero.report.text.phrases import WORDS, bracket, for_people, from_to, plain_unit, several, size_text

SPLITS = {
    "manoeuvre": "each manoeuvre predicted from the others",
    "block": "each block of the manoeuvre predicted from the others",
}
ON_A_TERMINAL = 3  # coefficients whose R² fit in 80 columns: those that change most
NAMED_IF = WORDS["notes"]["named_if"]


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
    mark = "†: the verdict does not rest on it, see below."
    if d.by_coefficients:
        title = f"Causes; R² on hold-out data ({SPLITS[d.split]}), before → after"
        note = f"R² of the {len(shown)} coefficients that change most. " if 0 < len(shown) < len(names) else ""
        note += (
            "Before: the card's model, with corrected sensors where sensor errors were found. ±: one standard error. "
            f"*: not confirmed on hold-out data, not in the extended model. {mark}"
        )
    else:
        title = f"Causes, from {'innovations' if d.compared == INNOVATIONS else 'trajectories alone'}"
        note = "" if all(c.sure for c in d.causes) else f"*: not confirmed on hold-out data. {mark}"
    return Table(
        [
            Column(range(1, len(d.causes) + 1), "order"),
            column(lambda c: c.name if c.sure else f"{c.name}{'†' if c.confirmed else '*'}", terminal="cause"),
            column(lambda c: c.name, "cause", "cause"),
            *(column(lambda c, key=key: getattr(c, key), key) for key in ("kind", "stage", "confirmed", "sure")),
            column(lambda c: c.claim, page="what it means", words=True),
            column(lambda c: list(c.parameters), "parameter"),
            column(_sizes, page="size"),
            each(lambda s: size_text(s.mean, s.sd, s.unit), terminal="size", words=True),
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
        WORDS["notes"]["causes"],
        title,
        note,
    )


def _sizes(c: Cause) -> list[str]:
    """Sizes, with names where there are several."""
    texts = {name: size_text(s.mean, s.sd, s.unit).replace("c/V", "chords") for name, s in c.parameters.items()}
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
    column = columns_of(d.changes)
    return Table(
        [
            column(lambda c: c.parameter, "parameter", "parameter", "parameter"),
            column(lambda c: c.unit, "unit"),
            column(lambda c: c.manoeuvre, "manoeuvre", "manoeuvre", "manoeuvre"),
            column(lambda c: c.at, "at", "at, s", "at, s", ".1f"),
            column(lambda c: BeforeAfter(c.interval[0], c.interval[1]), ("at_low", "at_high")),
            column(lambda c: from_to(c.interval[0], c.interval[1], 0.5), page="95 % interval, s"),
            column(lambda c: c.lasts, "lasts"),
            *(
                column(lambda c, name=name: Estimate(*getattr(c, name)), (name, f"{name}_sd"))
                for name in ("before", "after", "size")
            ),
            column(lambda c: size_text(c.before[0], c.before[1], c.unit), page="before", terminal="before"),
            column(lambda c: size_text(c.after[0], c.after[1], c.unit), page="after", terminal="after"),
            column(lambda c: size_text(c.size[0], c.size[1], c.unit), page="change", terminal="change"),
            column(lambda c: c.share, "share"),
            column(lambda c: c.p_value, "p_value", "p", "p", 2),
            column(lambda c: c.gain, "elpd", "hold-out gain", None, ".1f"),
            column(lambda c: several(c.ambiguous_with), "ambiguous_with", "rivals", "rivals", or_dash),
        ],
        "Parameters that change during the records",
        WORDS["notes"]["changes"],
    )


def terms_table(d: Diagnosis) -> Table:
    """A row for each term that describes unexplained structure, in files SI and radians."""
    column = columns_of(d.terms)
    return Table(
        [
            column(lambda t: t.coefficient, "coefficient", "coefficient"),
            column(lambda t: t.term.name, "term", "term"),
            column(lambda t: t.term.unit, "unit"),
            column(lambda t: Estimate(*t.size), ("size", "size_sd")),
            column(lambda t: size_text(t.size[0], t.size[1], t.term.unit), page="factor"),
            column(lambda t: t.share, "share", "share left", form=".0%"),
            column(lambda t: t.gain, "elpd", "hold-out gain", None, ".1f"),
            column(lambda t: t.weight, "probability", "probability", form=".2f"),
            column(
                lambda t: "; ".join(o.name for o, _ in t.others), "ambiguous_with", "as good", None, or_dash, words=True
            ),
        ],
        "Terms that describe unexplained structure",
        WORDS["notes"]["terms"],
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
        f"Score: estimate over its standard error, autocorrelation included.{beyond} p is family-wise over all "
        f"candidates, 0.005 at the least. {NAMED_IF} screen.csv lists all candidates.",
        "Leading candidates",
        f"p is family-wise, 0.005 at the least. {NAMED_IF}",
    )


def scores_frame(found: HoldoutScores) -> pd.DataFrame:
    """A row for each model, fit, manoeuvre, coefficient: scores of 5 Hz means, and the gain of the extended model."""
    rows = []
    for model in ("card", "extended"):
        for data in ("fitted", "hold_out"):
            for k, manoeuvre in enumerate(found.names):
                for name, one in found.scores[model, data, k].items():
                    row = {"model": model, "data": data, "manoeuvre": manoeuvre, "coefficient": name}
                    row |= {"r": one.r, "r2": one.r2, "rmse": one.rmse, "theil": one.theil}
                    if (model, data) == ("extended", "hold_out"):
                        gain = found.gains[manoeuvre, name]
                        row |= {"elpd_gain": gain.elpd, "elpd_gain_sd": gain.elpd_sd}
                        row |= {"r2_gain": gain.r2, "r2_gain_sd": gain.r2_sd}
                    rows.append(row)
    return pd.DataFrame(rows)


# --- The card's and the extended model side by side: hold-out scores, parameters, residuals.


def gain_table(view: DiagnosisView) -> Table | None:
    """Scores of each coefficient on hold-out data; nothing where nothing was added."""
    if view.unseen_scores is None:
        return None
    before, after = view.unseen_scores
    names = list(after)
    columns = [Column(names, page="coefficient")]
    for when, scores in (("before", before), ("after", after)):
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
            column(lambda r: r[3], page="change of R²", form=lambda gain: f"{gain.r2:+z.3f} ± {gain.r2_sd:.3f}"),
            column(
                lambda r: r[3], page="log density\ngained", form=lambda gain: f"{gain.elpd:+z.1f} ± {gain.elpd_sd:.1f}"
            ),
        ],
        "Hold-out manoeuvres: the card's model and the extended model",
        f"{WORDS['notes']['holdout']} The log density decreases significantly (one-sided, 5 %) for {worse}.",
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
    levels = [f"{level:g}" for level in LEVELS]
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
        WORDS["notes"]["residuals"],
    ), Table(
        [
            first,
            *(column(lambda n, x=x: n["calibration"][x], page=f"{100.0 * float(x):.0f} %", form=".0%") for x in levels),
        ],
        "Calibration: share of 5 Hz residuals inside the fitted noise's bands",
        "A right noise model shows the heading's share in each column.",
    )
