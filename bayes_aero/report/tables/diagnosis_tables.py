"""A diagnosis as tables of numbers: its causes, and every candidate."""

from __future__ import annotations

import pandas as pd

from bayes_aero.report.diagnosis_view import DiagnosisView


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
