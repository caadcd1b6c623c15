"""The card's and the extended model side by side: hold-out scores, parameters, residuals."""

from __future__ import annotations

from bayes_aero.diagnosis.view.results import LEVELS, DiagnosisView, HoldoutScores, View
from bayes_aero.report.tables.table import Change, Column, Estimate, Table, columns_of
from bayes_aero.report.text.phrases import bracket, for_people, plain_unit, several


def gain_table(view: DiagnosisView) -> Table | None:
    """Scores of each coefficient on hold-out data; nothing where nothing was added."""
    if view.unseen_scores is None:
        return None
    before, after = view.unseen_scores
    names = list(after)
    column = columns_of(names)
    columns = [Column(names, page="coefficient")]
    for when, scores in (("before", before), ("after", after)):
        columns += [
            column(lambda name, scores=scores: scores[name].r2, page=f"R² {when}", form=".3f"),
            column(lambda name, scores=scores: scores[name].rmse, page=f"RMSE {when} [-]", form=".4f"),
        ]
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
        rows += [(manoeuvre, n, Change(before[n].r2, after[n].r2), unseen.gains[manoeuvre, n]) for n in before]
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
        "± is one standard error, autocorrelation included. Log density: natural logarithm of the probability density "
        "of the hold-out data; 3 more make them 20 times as probable. R² weighs every sample alike and depends on the "
        "few of the deepest stall; the log density includes the noise growth in separated flow. The log density "
        f"decreases significantly (one-sided, 5 %) for {worse}.",
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
    shares = [
        column(
            lambda n, part=part: n[f"theil_{part}"], page=part, form=".0%", group="Theil's shares of the squared error"
        )
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
        "A good model leaves covariance only (noise): bias is a constant offset, variance a wrong amplitude.",
    ), Table(
        [
            first,
            *(column(lambda n, x=x: n["calibration"][x], page=f"{100.0 * float(x):.0f} %", form=".0%") for x in levels),
        ],
        "Calibration: share of 5 Hz residuals inside the fitted noise's bands",
        "A right noise model shows the heading's share in each column.",
    )
