"""A diagnosis as tables of numbers: its causes, every candidate, and scores by manoeuvre."""

from __future__ import annotations

import pandas as pd

from bayes_aero.diagnosis.view.results import Compared, DiagnosisView, HoldoutScores


def causes_frame(view: DiagnosisView) -> pd.DataFrame:
    """A row per parameter of every cause, SI and radians, with scores on hold-out data."""
    rows = []
    for order, cause in enumerate(view.diagnosis.causes, 1):
        for name, size in cause.parameters.items():
            row = {
                "order": order,
                "cause": cause.name,
                "kind": cause.kind,
                "stage": cause.stage,
                "confirmed": cause.confirmed,
                "sure": cause.sure,
                "parameter": name,
                "mean": size.mean,
                "sd": size.sd,
                "ci95_low": size.ci95[0],
                "ci95_high": size.ci95[1],
                "unit": size.unit,
                "probability": cause.probability,
                "p_value": cause.p_value,
                "ambiguous_with": " ".join(cause.ambiguous_with),
                "elpd": cause.gain.elpd,
                "elpd_se": cause.gain.elpd_se,
                "taken_out_elpd": -cause.missed[0],
                "taken_out_elpd_se": cause.missed[1],
            }
            for coefficient in cause.gain.before:
                for when, scores in (("before", cause.gain.before), ("after", cause.gain.after)):
                    row[f"{coefficient}_r2_{when}"] = scores[coefficient].r2
                    row[f"{coefficient}_rmse_{when}"] = scores[coefficient].rmse
            rows.append(row)
    columns = ["order", "cause", "kind", "stage", "parameter", "mean", "sd", "ci95_low", "ci95_high", "unit"]
    columns += ["probability", "p_value", "ambiguous_with", "elpd", "elpd_se", "taken_out_elpd", "taken_out_elpd_se"]
    frame = pd.DataFrame(rows) if rows else pd.DataFrame(columns=columns)
    return frame.set_index("order")


def screen_frame(view: DiagnosisView) -> pd.DataFrame:
    """Every candidate in the first screening of each stage."""
    rows = [
        {"stage": r.stage, "name": s.effect, "kind": s.kind, "score": s.score, "p_value": s.p_value}
        for r in view.rankings
        for s in r.candidate_scores
    ]
    return pd.DataFrame(rows, columns=["stage", "name", "kind", "score", "p_value"]).set_index("stage")


def scores_frame(found: HoldoutScores) -> pd.DataFrame:
    """A row for each model, fit, manoeuvre and coefficient: r, R2, RMSE [-] and Theil's coefficient of 5 Hz means.

    `fitted`: parameters from all manoeuvres. `unseen`: from the others; of a single one, each block from the others.
    Rows of the extended model on hold-out data have its gain over the card's: log density `elpd_gain` [nats] and
    `r2_gain`, each with its standard error (see `Compared`).
    """
    rows = []
    for model in ("card", "extended"):
        for data in ("fitted", "hold_out"):
            for k, manoeuvre in enumerate(found.names):
                for name, one in found.scores[model, data, k].items():
                    row = {"model": model, "data": data, "manoeuvre": manoeuvre, "coefficient": name}
                    row |= {"r": one.r, "r2": one.r2, "rmse": one.rmse, "theil": one.theil}
                    if (model, data) == ("extended", "hold_out"):
                        row |= _gain_columns(found.gains[manoeuvre, name])
                    rows.append(row)
    return pd.DataFrame(rows)


def _gain_columns(gain: Compared) -> dict[str, float]:
    names = {"elpd_gain": gain.elpd, "elpd_gain_sd": gain.elpd_sd}
    return names | {"r2_gain": gain.r2, "r2_gain_sd": gain.r2_sd}
