"""Causes of diagnosis.json, and the candidates of the first screening."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from bayes_aero.diagnosis.result import Cause, Diagnosis, Gain
from bayes_aero.diagnosis.view.results import Ranking
from bayes_aero.report.tables.diagnosis_tables import screen_table

SCORES = ("r2", "rmse", "r", "theil")


def screen(d: Diagnosis, rankings: Sequence[Ranking]) -> list[dict[str, Any]]:
    """Every candidate in the first election of each stage, the highest score first."""
    causes = {(c.stage, c.name) for c in d.causes}
    found = [(ranking, s) for ranking in rankings for s in ranking.candidate_scores]
    return [
        row
        | {
            "threshold": ranking.threshold,
            "parameters": {name: {"estimate": x, "sd": sd} for name, (x, sd) in s.estimate.items()},
            "cause": (ranking.stage, s.effect) in causes,
        }
        for row, (ranking, s) in zip(screen_table(rankings, d).records(), found, strict=True)
    ]


def cause_results(cause: Cause) -> dict[str, Any]:
    """One named cause."""
    return {
        "name": cause.name,
        "kind": cause.kind,
        "claim": cause.claim,
        "stage": cause.stage,
        "probability": cause.probability,
        "p_value": cause.p_value,
        "excited": cause.excited,
        "confirmed": cause.confirmed,
        "loss_without": {"elpd": cause.missed[0], "elpd_se": cause.missed[1]},
        "sure": cause.sure,
        "implausible": dict(cause.implausible),
        "own_share": cause.own_share,
        "ambiguous_with": list(cause.ambiguous_with),
        "rival_gains": _gains(cause.rival_gains),
        "joint": dict(cause.joint),
        "parameters": {
            name: {
                "mean": size.mean,
                "sd": size.sd,
                "ci95": list(size.ci95),
                "unit": size.unit,
                "at_bound": size.at_bound,
            }
            for name, size in cause.parameters.items()
        },
        "gain": _gain(cause.gain),
    }


def _gains(gains: Mapping[str, tuple[float, float]]) -> dict[str, dict[str, float]]:
    return {name: {"elpd": elpd, "elpd_se": se} for name, (elpd, se) in gains.items()}


def _gain(gain: Gain) -> dict[str, Any]:
    return {
        "elpd": gain.elpd,
        "elpd_se": gain.elpd_se,
        "split": gain.split,
        "degraded": _gains(gain.degraded),
        "by_coefficient": {
            name: {
                f"{key}_{when}": getattr(scores[name], key)
                for key in SCORES
                for when, scores in (("before", gain.before), ("after", gain.after))
            }
            for name in gain.before
            if name in gain.after
        },
    }
