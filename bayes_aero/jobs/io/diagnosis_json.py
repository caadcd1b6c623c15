"""diagnosis.json: what one diagnosis found, in a versioned schema (diagnosis.schema.json beside this file)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from bayes_aero.diagnosis.result import COEFFICIENTS, Cause, CausesInBand, Diagnosis, FoundTerm, ParameterChange, Tested
from bayes_aero.diagnosis.trajectory_result import DiagnosisView, Ranking, SimulatedManoeuvre, Trajectories, View
from bayes_aero.flight.card import Card
from bayes_aero.flight.channel import STANDARD_CHANNELS
from bayes_aero.flight.health.finding import Consistency, HealthFinding
from bayes_aero.flight.record import FlightRecord
from bayes_aero.jobs.io.consistency_json import consistency_results
from bayes_aero.jobs.provenance import named_pairs, picked
from bayes_aero.model.records import with_sums
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
    seen = view if isinstance(view, View) else None  # coefficients; else only trajectories were compared
    models = {} if seen is None else {"before": seen.card, "after": seen.extended}
    rows = ("labels", "lag1", "sd=deviation", "noise_growth", "outliers")
    unknown = ("coefficient", "channel", "share_of_variance=share", "p_value", "rivals")
    found: dict[str, Any] = {
        "schema": SCHEMA,
        "card": picked(card, "name", "title"),
        "records": record_results(records, card),
        "consistency": consistency_results(outcome.consistency),
        "verdict": d.verdict.value,
        "tested": tested_results(d.tested, d.compared),
        "sentences": list(sentences(view)),
        "causes": [cause_results(cause) for cause in d.causes],
        "minor": list(d.minor),
        "unexplained": [picked(u, *unknown) | {"offsets": named_pairs(u.offsets, *SIZE)} for u in d.unknown],
        "terms": [term_results(one) for one in d.terms],
        "changes": [change_results(one) for one in d.changes],
        "cancelling": list(d.together),
        "absorbed": absorbed_results(d),
        "noise": picked(d.noise, *rows),
        "not_testable": d.not_testable,
        "screening": screening_results(d, view.rankings),
        "split": d.split,
        "base_parameters": view.moves,
        "covariance": None
        if view.covariance is None
        else picked(view.covariance, "parameters=names", "matrix") | {"residuals": "coloured"},
        "residuals": {when: model.composition for when, model in models.items()},
        "trajectories": {} if view.trajectories is None else trajectory_results(view.trajectories, card),
        "stall": {} if seen is None else {name: stall.numbers() for name, stall in seen.stalls.items()},
        **picked(outcome, "test_points", "in_band", "health"),
        "notes": [*d.notes, *outcome.notes],
        "failures": list(outcome.failures),
        "provenance": provenance,
    }
    if outcome.hidden is not None:
        found["hidden"] = {"effects": outcome.hidden, "named": outcome.named}
    return found


SIZE, GAIN = ("mean", "sd"), ("elpd", "elpd_se")


def term_results(found: FoundTerm) -> dict[str, Any]:
    """A form of unexplained structure."""
    return {
        "coefficient": found.coefficient,
        **picked(found.term, "term=name", "code", "unit"),
        **named_pairs({"size": found.size}, *SIZE),
        **picked(found, "share_of_variance=share", "elpd=gain", "probability=weight"),
        "ambiguous_with": {term.name: weight for term, weight in found.others},
    }


def change_results(found: ParameterChange) -> dict[str, Any]:
    """A parameter that takes another value during the records."""
    return {
        **picked(found, "parameter", "unit", "manoeuvre", "at", "ci95=interval", "lasts"),
        **named_pairs({"before": found.before, "after": found.after, "size": found.size}, *SIZE),
        **picked(found, "share_of_variance=share", "p_value", "elpd=gain", "ambiguous_with"),
    }


def absorbed_results(d: Diagnosis) -> list[dict[str, Any]]:
    """Derivatives of controls at rest that may have taken up an effect."""
    return [
        {
            **picked(one, "effect", "parameter", "unit", "control"),
            **named_pairs({"estimate": one.estimate, "usual": one.usual}, *SIZE),
            "sizes": {name: picked(x, "mean", "sd", "unit") for name, x in one.sizes.items()},
        }
        for one in d.absorbed
    ]


def tested_results(tested: Tested | None, compared: str) -> dict[str, Any]:
    """What a diagnosis by trajectories alone has tested; of one by coefficients, that it sought structure, too."""
    if tested is None:
        sought = compared == COEFFICIENTS
        return {"rests_on": compared, "unnamed_structure": sought, "within_noise": None, "outputs": {}}
    rows = ("noise", "fitted", "hold_out=unseen", "beyond_noise=beyond")
    return {
        "rests_on": "trajectories",
        "unnamed_structure": False,
        "within_noise": tested.within_noise if tested.outputs else None,
        "outputs": {
            name: {"unit": STANDARD_CHANNELS[name].unit, **picked(one, *rows)} for name, one in tested.outputs.items()
        },
    }


def record_results(records: Sequence[FlightRecord], card: Card) -> list[dict[str, Any]]:
    """The records at a glance, with the flown range of each channel (SI), a spike left out."""
    told = []
    for r in records:
        channels = {name: np.asarray(x, dtype=float) for name, x in with_sums(r, card).items()}
        if "alpha" in channels and "alpha_dot" not in channels:  # its rate, which effects read
            channels["alpha_dot"] = np.asarray(differentiate(smooth(channels["alpha"]), r.dt))
        ranges = {name: list(map(float, np.quantile(x, FLOWN))) for name, x in channels.items()}
        told.append({**picked(r, "name", "samples=n", "dt"), "duration": float(np.ptp(r.time)), "ranges": ranges})
    return told


def screening_results(d: Diagnosis, rankings: Sequence[Ranking]) -> list[dict[str, Any]]:
    """Every candidate in the first election of each stage, the highest score first."""
    causes = {(c.stage, c.name) for c in d.causes}
    found = [(ranking, s) for ranking in rankings for s in ranking.candidate_scores]
    return [
        row
        | {
            "threshold": ranking.threshold,
            "parameters": named_pairs(s.estimate, "estimate", "sd"),
            "cause": (ranking.stage, s.effect) in causes,
        }
        for row, (ranking, s) in zip(screen_table(rankings, d).records(), found, strict=True)
    ]


def cause_results(cause: Cause) -> dict[str, Any]:
    """One named cause, and what it gains on data that were not fitted."""
    about = ("name", "kind", "claim", "stage", "probability", "p_value", "excited", "confirmed")
    gain, when = cause.gain, {"before": cause.gain.before, "after": cause.gain.after}
    scores = [(key, word, by) for key in ("r2", "rmse", "r", "theil") for word, by in when.items()]
    return {
        **picked(cause, *about),
        **named_pairs({"loss_without": cause.missed}, *GAIN),
        **picked(cause, "sure", "implausible", "own_share", "ambiguous_with"),
        "rival_gains": named_pairs(cause.rival_gains, *GAIN),
        "joint": cause.joint,
        "parameters": {n: picked(size, *SIZE, "ci95", "unit", "at_bound") for n, size in cause.parameters.items()},
        "gain": {
            **picked(gain, *GAIN, "split"),
            "degraded": named_pairs(gain.degraded, *GAIN),
            "by_coefficient": {
                name: {f"{key}_{word}": getattr(by[name], key) for key, word, by in scores}
                for name in gain.before
                if name in gain.after
            },
        },
    }


# --- Simulated trajectories.


def trajectory_results(flown: Trajectories, card: Card) -> dict[str, Any]:
    """Errors by manoeuvre, model and split; parameters; tolerances with their sources. SI throughout."""
    before, after, lag = flown.card, flown.extended, flown.lag
    return {
        "fitted_outputs": list(flown.fitted),
        "status": {"card": before.status.name, "extended": after.status.name},
        "at_bound": {"card": list(before.at_bound), "extended": list(after.at_bound)},
        **picked(flown, "variance_inflation", "noise_growth"),
        "lag": None
        if lag is None
        else {
            **picked(lag, "effect", "gain"),
            "hold_out": dict(zip(("elpd", "elpd_se"), lag.unseen, strict=True)),
            **picked(lag, "kept", "instead_of=instead", "slight"),
        },
        "causes": {
            name: {"elpd": elpd, "elpd_se": elpd_se, "kept": name in flown.asked.kept}
            for name, (elpd, elpd_se) in flown.asked.missed.items()
        },
        "tolerances": tolerance_results(card, {name: STANDARD_CHANNELS[name].unit for name in flown.outputs}),
        "paths": [path_results(path) for path in flown.paths],
        "held_without": flown.held,
        "parameters": {
            name: {
                "card": before.values.get(name),
                "extended": value,
                "sd": flown.deviation[name],
                "unit": after.units[name],
                "held_by_prior": name in after.held,
                "at_bound": name in after.at_bound,
            }
            for name, value in after.values.items()
        },
    }


def tolerance_results(card: Card, units: Mapping[str, str]) -> dict[str, Any]:
    """The card's tolerances of these outputs."""
    stated = {name: t for name, t in card.tolerances.items() if name in units}
    return {name: {"value": t.value, "unit": units[name], "source": t.source} for name, t in stated.items()}


def path_results(path: SimulatedManoeuvre, units: Mapping[str, str] | None = None, *, alone: bool = False) -> Any:
    """One simulated manoeuvre; `units` of outputs (SI) for channels that the program does not know by name.

    `alone`: no other flight is beside it, so it has neither a split nor a chance to stay inside.
    """
    outputs = {}
    for name, error in path.errors.items():
        parts = [f"theil_{part}={part}" for part in ("bias", "variance", "covariance")]
        outputs[name] = {
            "unit": STANDARD_CHANNELS[name].unit if units is None else units[name],
            **picked(error, "rms", "largest"),
            **picked(error.theil, "theil", *parts),
            **picked(error, "within_tolerance=within", *([] if alone else ["probability_within=probability"])),
        }
    about = ("manoeuvre", "model", *(() if alone else ("split",)), "inside_envelope=inside")
    return picked(path, *about) | {"outputs": outputs}
