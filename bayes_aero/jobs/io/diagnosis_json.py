"""diagnosis.json: what one diagnosis found, in a versioned schema (diagnosis.schema.json beside this file)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from bayes_aero.diagnosis.result import (
    COEFFICIENTS,
    Cause,
    CausesInBand,
    Diagnosis,
    FoundTerm,
    Gain,
    ParameterChange,
    Tested,
    UnexplainedStructure,
)
from bayes_aero.diagnosis.screening.autocorrelation import NoiseReport
from bayes_aero.diagnosis.view.results import DiagnosisView, Ranking, View
from bayes_aero.flight.agreement import Consistency
from bayes_aero.flight.card.card import Card
from bayes_aero.flight.channel import STANDARD_CHANNELS
from bayes_aero.flight.health import HealthFinding
from bayes_aero.flight.record import FlightRecord
from bayes_aero.jobs.io.consistency_json import consistency_results, health_results
from bayes_aero.jobs.io.trajectories_json import trajectory_results
from bayes_aero.model.derived_channels import with_sums
from bayes_aero.physics.filters import differentiate, smooth
from bayes_aero.report.tables.diagnosis_tables import screen_table
from bayes_aero.report.text.diagnosis import sentences

SCHEMA = "bayes_aero/diagnosis/5"
FLOWN = (0.001, 0.999)  # quantiles that bound the flown range of a channel

Hidden = Mapping[str, Mapping[str, float]]  # true values of what simulated records hide, by effect


@dataclass(frozen=True)
class Outcome:
    """A diagnosis with all that is shown of it.

    `named`: each hidden effect is first, named, ambiguous, minor or missed. `test_points` are the manoeuvres that
    decide all that is open, `in_band` the sizes of the causes in a band of frequencies, `failures` parts that
    failed unexpectedly.
    """

    view: DiagnosisView
    hidden: Hidden | None = None
    named: Mapping[str, str] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    health: tuple[HealthFinding, ...] = ()
    consistency: Consistency | None = None
    failures: tuple[str, ...] = ()
    test_points: Mapping[str, Any] = field(default_factory=dict)
    in_band: CausesInBand | None = None

    @property
    def diagnosis(self) -> Diagnosis:
        """The finding itself."""
        return self.view.diagnosis


def diagnosis_results(
    outcome: Outcome, card: Card, records: Sequence[FlightRecord], provenance: Mapping[str, Any]
) -> dict[str, Any]:
    """Everything found, as plain numbers and text; `hidden` is the truth where the records are simulated."""
    view, d = outcome.view, outcome.diagnosis
    found: dict[str, Any] = {
        "schema": SCHEMA,
        "card": {"name": card.name, "title": card.title},
        "records": record_results(records, card),
        "consistency": {} if outcome.consistency is None else consistency_results(outcome.consistency),
        "verdict": d.verdict.value,
        "tested": tested_results(d.tested, d.compared),
        "sentences": list(sentences(view)),
        "causes": [cause_results(cause) for cause in d.causes],
        "minor": list(d.minor),
        "unexplained": unknown_results(d.unknown),
        "terms": [term_results(one) for one in d.terms],
        "changes": [change_results(one) for one in d.changes],
        "cancelling": cancelling_results(d),
        "absorbed": absorbed_results(d),
        "noise": noise_results(d.noise),
        "not_testable": dict(d.not_testable),
        "screening": screen(d, view.rankings),
        "split": d.split,
        "base_parameters": {name: asdict(move) for name, move in view.moves.items()},
        "covariance": _covariance(view),
        "residuals": _residuals(view),
        "trajectories": {} if view.trajectories is None else trajectory_results(view.trajectories, card),
        "stall": {n: stall.numbers() for n, stall in view.stalls.items()} if isinstance(view, View) else {},
        "test_points": dict(outcome.test_points),
        "in_band": None if outcome.in_band is None else asdict(outcome.in_band),
        "health": health_results(outcome.health),
        "notes": [*d.notes, *outcome.notes],
        "failures": list(outcome.failures),
        "provenance": dict(provenance),
    }
    if outcome.hidden is not None:
        found["hidden"] = {"effects": outcome.hidden, "named": outcome.named}
    return found


def _covariance(view: DiagnosisView) -> dict[str, Any] | None:
    """Of the extended model's estimates, with the assumption on which it rests."""
    found = view.covariance
    if found is None:
        return None
    return {"parameters": list(found.names), "matrix": found.matrix, "residuals": "coloured"}


def _residuals(view: DiagnosisView) -> dict[str, Any]:
    """Of the coefficients by either model; empty where only trajectories were compared."""
    models = {"before": view.card, "after": view.extended} if isinstance(view, View) else {}
    return {when: dict(model.composition) for when, model in models.items()}


def unknown_results(unknown: Sequence[UnexplainedStructure]) -> list[dict[str, Any]]:
    """Structure without a name, and that of which the record cannot choose a name."""
    return [
        {
            "coefficient": u.coefficient,
            "channel": u.channel,
            "share_of_variance": u.share,
            "p_value": u.p_value,
            "rivals": list(u.rivals),
            "offsets": {name: {"mean": mean, "sd": sd} for name, (mean, sd) in u.offsets.items()},
        }
        for u in unknown
    ]


def term_results(found: FoundTerm) -> dict[str, Any]:
    """A form of unexplained structure."""
    return {
        "coefficient": found.coefficient,
        "term": found.term.name,
        "code": found.term.code,
        "unit": found.term.unit,
        "size": {"mean": found.size[0], "sd": found.size[1]},
        "share_of_variance": found.share,
        "elpd": found.gain,
        "probability": found.weight,
        "ambiguous_with": {term.name: weight for term, weight in found.others},
    }


def change_results(found: ParameterChange) -> dict[str, Any]:
    """A parameter that takes another value during the records."""
    return {
        "parameter": found.parameter,
        "unit": found.unit,
        "manoeuvre": found.manoeuvre,
        "at": found.at,
        "ci95": list(found.interval),
        "lasts": found.lasts,
        "before": {"mean": found.before[0], "sd": found.before[1]},
        "after": {"mean": found.after[0], "sd": found.after[1]},
        "size": {"mean": found.size[0], "sd": found.size[1]},
        "share_of_variance": found.share,
        "p_value": found.p_value,
        "elpd": found.gain,
        "ambiguous_with": list(found.ambiguous_with),
    }


def absorbed_results(d: Diagnosis) -> list[dict[str, Any]]:
    """Derivatives of controls at rest that may have taken up an effect."""
    return [
        {
            "effect": one.effect,
            "parameter": one.parameter,
            "unit": one.unit,
            "control": one.control,
            "estimate": {"mean": one.estimate[0], "sd": one.estimate[1]},
            "usual": {"mean": one.usual[0], "sd": one.usual[1]},
            "sizes": {name: {"mean": x.mean, "sd": x.sd, "unit": x.unit} for name, x in one.sizes.items()},
        }
        for one in d.absorbed
    ]


def cancelling_results(d: Diagnosis) -> list[dict[str, Any]]:
    """Pairs of causes that cancel, and the combination that the record knows."""
    return [asdict(p) | {"effects": list(p.effects), "parameters": list(p.parameters)} for p in d.together]


def tested_results(tested: Tested | None, compared: str) -> dict[str, Any]:
    """What a diagnosis by trajectories alone has tested; of one by coefficients, that it sought structure, too."""
    if tested is None:
        sought = compared == COEFFICIENTS
        return {"rests_on": compared, "unnamed_structure": sought, "within_noise": None, "outputs": {}}
    return {
        "rests_on": "trajectories",
        "unnamed_structure": False,
        "within_noise": tested.within_noise if tested.outputs else None,
        "outputs": {
            name: {
                "unit": STANDARD_CHANNELS[name].unit,
                "noise": one.noise,
                "fitted": one.fitted,
                "hold_out": one.unseen,
                "beyond_noise": one.beyond,
            }
            for name, one in tested.outputs.items()
        },
    }


def noise_results(noise: NoiseReport) -> dict[str, Any]:
    """Colour, size, growth and outliers by output."""
    return {
        "labels": list(noise.labels),
        "lag1": dict(noise.lag1),
        "sd": dict(noise.deviation),
        "noise_growth": dict(noise.noise_growth),
        "outliers": dict(noise.outliers),
    }


def record_results(records: Sequence[FlightRecord], card: Card) -> list[dict[str, Any]]:
    """The records at a glance, with the flown range of each channel (SI), a spike left out."""
    return [
        {
            "name": r.name,
            "samples": r.n,
            "dt": r.dt,
            "duration": float(r.time[-1] - r.time[0]),
            "ranges": {name: list(map(float, np.quantile(x, FLOWN))) for name, x in _channels(r, card).items()},
        }
        for r in records
    ]


def _channels(record: FlightRecord, card: Card) -> dict[str, np.ndarray]:
    """Recorded and derived channels, and the rate of the angle of attack, which effects read."""
    found = {name: np.asarray(x, dtype=float) for name, x in with_sums(record, card).items()}
    if "alpha" in found and "alpha_dot" not in found:
        found["alpha_dot"] = np.asarray(differentiate(smooth(found["alpha"]), record.dt))
    return found


# --- Causes of diagnosis.json, and the candidates of the first screening.

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
