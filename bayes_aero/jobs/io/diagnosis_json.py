"""diagnosis.json: what one diagnosis found, in a versioned schema."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from msgspec import UNSET

from bayes_aero.diagnosis.result import COEFFICIENTS, Cause, CausesInBand, Diagnosis, FoundTerm, Tested
from bayes_aero.diagnosis.trajectory_result import DiagnosisView, SimulatedManoeuvre, Trajectories, View
from bayes_aero.flight.card import Card
from bayes_aero.flight.channel import STANDARD_CHANNELS
from bayes_aero.flight.health.finding import Consistency, HealthFinding
from bayes_aero.flight.record import FlightRecord
from bayes_aero.jobs.io import documents as parts
from bayes_aero.model.records import with_sums
from bayes_aero.physics.filters import differentiate, smooth
from bayes_aero.report.pages.findings import sentences

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
) -> parts.DiagnosisDocument:
    """Everything found, as plain numbers and text; `hidden` is the truth where the records are simulated."""
    view, d = outcome.view, outcome.diagnosis
    seen = view if isinstance(view, View) else None  # coefficients; else only trajectories were compared
    named = {(c.stage, c.name) for c in d.causes}
    models = {} if seen is None else {"before": seen.card, "after": seen.extended}
    return parts.DiagnosisDocument.of(
        d,
        schema=SCHEMA,
        card=card,
        records=record_parts(records, card),
        consistency=parts.ConsistencyPart.of(outcome.consistency),
        tested=tested_part(d.tested, d.compared),
        sentences=sentences(view),
        causes=[cause_part(cause) for cause in d.causes],
        unexplained=d.unknown,
        terms=[term_part(one) for one in d.terms],
        cancelling=d.together,
        screening=[
            parts.ScreenedPart.of(s, stage=r.stage, threshold=r.threshold, cause=(r.stage, s.effect) in named)
            for r in view.rankings
            for s in r.candidate_scores
        ],  # every candidate in the first election of each stage, the highest score first
        base_parameters=view.moves,
        covariance=view.covariance and parts.CovariancePart.of(view.covariance, residuals="coloured"),
        residuals={when: model.composition for when, model in models.items()},
        trajectories=trajectories_part(view.trajectories, card),
        stall={} if seen is None else {name: stall.numbers() for name, stall in seen.stalls.items()},
        test_points=outcome.test_points,
        in_band=outcome.in_band,
        health=outcome.health,
        notes=(*d.notes, *outcome.notes),
        failures=outcome.failures,
        provenance=provenance,
        hidden=UNSET if outcome.hidden is None else parts.HiddenPart.of((outcome.hidden, outcome.named)),
    )


def term_part(found: FoundTerm) -> parts.TermPart:
    """A form of unexplained structure."""
    term, others = found.term, {term.name: weight for term, weight in found.others}
    return parts.TermPart.of(found, term=term.name, code=term.code, unit=term.unit, ambiguous_with=others)


def tested_part(tested: Tested | None, compared: str) -> parts.TestedPart:
    """What a diagnosis by trajectories alone has tested; of one by coefficients, that it sought structure, too."""
    if tested is None:
        return parts.TestedPart.of((compared, compared == COEFFICIENTS, None, {}))
    outputs = {n: parts.TestedOutput.of(one, unit=STANDARD_CHANNELS[n].unit) for n, one in tested.outputs.items()}
    return parts.TestedPart("trajectories", False, tested.within_noise if outputs else None, outputs)


def record_parts(records: Sequence[FlightRecord], card: Card) -> list[parts.RecordPart]:
    """The records at a glance, with the flown range of each channel (SI), a spike left out."""
    told = []
    for r in records:
        channels = {name: np.asarray(x, dtype=float) for name, x in with_sums(r, card).items()}
        if "alpha" in channels and "alpha_dot" not in channels:  # its rate, which effects read
            channels["alpha_dot"] = np.asarray(differentiate(smooth(channels["alpha"]), r.dt))
        ranges = {name: tuple(map(float, np.quantile(x, FLOWN))) for name, x in channels.items()}
        told.append(parts.RecordPart.of((r.name, r.n, r.dt, float(np.ptp(r.time)), ranges)))
    return told


def cause_part(cause: Cause) -> parts.CausePart:
    """One named cause, and what it gains on data that were not fitted."""
    gain, when = cause.gain, {"before": cause.gain.before, "after": cause.gain.after}
    scores = [(key, word, by) for key in ("r2", "rmse", "r", "theil") for word, by in when.items()]
    by_coefficient = {
        name: {f"{key}_{word}": getattr(by[name], key) for key, word, by in scores}
        for name in gain.before
        if name in gain.after
    }
    return parts.CausePart.of(cause, gain=parts.GainPart.of(gain, by_coefficient=by_coefficient))


# --- Simulated trajectories.


def trajectories_part(flown: Trajectories | None, card: Card) -> parts.TrajectoriesPart:
    """Errors by manoeuvre, model and split; parameters; tolerances with their sources. SI throughout."""
    if flown is None:
        return parts.TrajectoriesPart()
    before, after, asked = flown.card, flown.extended, flown.asked
    return parts.TrajectoriesPart.of(
        flown,
        status={"card": before.status.name, "extended": after.status.name},
        at_bound={"card": before.at_bound, "extended": after.at_bound},
        causes={name: parts.KeptPart(*missed, name in asked.kept) for name, missed in asked.missed.items()},
        tolerances=stated_tolerances(card, {name: STANDARD_CHANNELS[name].unit for name in flown.outputs}),
        paths=[path_part(parts.ComparedPath, path) for path in flown.paths],
        parameters={
            name: parts.FlownEstimate(
                before.values.get(name),
                value,
                flown.deviation[name],
                after.units[name],
                name in after.held,
                name in after.at_bound,
            )
            for name, value in after.values.items()
        },
    )


def stated_tolerances(card: Card, units: Mapping[str, str]) -> dict[str, parts.StatedTolerance]:
    """The card's tolerances of these outputs."""
    stated = {name: t for name, t in card.tolerances.items() if name in units}
    return {name: parts.StatedTolerance(t.value, units[name], t.source) for name, t in stated.items()}


def path_part(
    kind: type[parts.ComparedPath | parts.FlownPath], path: SimulatedManoeuvre, units: Mapping[str, str] | None = None
) -> Any:
    """One simulated manoeuvre; `units` of outputs (SI) for channels that the program does not know by name."""
    part = parts.ComparedOutput if kind is parts.ComparedPath else parts.PathOutput
    outputs = {
        name: part.of(
            **vars(error) | vars(error.theil), unit=STANDARD_CHANNELS[name].unit if units is None else units[name]
        )
        for name, error in path.errors.items()
    }
    return kind.of(path, outputs=outputs)
