"""The candidates of every stage in the order of their scores, as tables and figures show them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from bayes_aero.diagnosis.result import COEFFICIENTS, FLIGHT_PATH, TRAJECTORIES, Diagnosis
from bayes_aero.diagnosis.screening.screening import ScreeningResult
from bayes_aero.diagnosis.selection.forward_selection import Extension, explained

LEADERS = 10  # candidates of a stage that are listed, by their scores
CONSIDERED = 3  # and by the share of what is left that they explain
FALSE_ALARMS = 0.05  # share of noise-only replicates whose best score is beyond the threshold


@dataclass(frozen=True)
class RankedCandidate:
    """One candidate of a stage's first screening, at its best value: `estimate` and `sd` by parameter.

    `explains` is the share of the remaining variance that it would take away, by which candidates are taken in turn.
    """

    effect: str
    kind: str
    score: float
    p_value: float
    explains: float
    estimate: Mapping[str, tuple[float, float]]


@dataclass(frozen=True)
class Ranking:
    """Candidates of one stage, the highest score first; `threshold` is what noise alone exceeds once in twenty."""

    stage: str
    candidate_scores: tuple[RankedCandidate, ...]
    threshold: float

    @property
    def leaders(self) -> tuple[RankedCandidate, ...]:
        """Those that tables and figures show: the `LEADERS` highest scores, and what is considered first."""
        first = {s.effect for s in sorted(self.candidate_scores, key=lambda s: -s.explains)[:CONSIDERED]}
        return tuple(s for k, s in enumerate(self.candidate_scores) if k < LEADERS or s.effect in first)


def stages(diagnosis: Diagnosis) -> list[tuple[str, Extension]]:
    """Stages of the diagnosis by the names that its causes carry."""
    found = [(FLIGHT_PATH, diagnosis.sensors)] if diagnosis.sensors is not None else []
    return [*found, (COEFFICIENTS if diagnosis.by_coefficients else TRAJECTORIES, diagnosis.aerodynamics)]


def rankings_of(diagnosis: Diagnosis) -> list[Ranking]:
    """Candidates of every stage."""
    found = []
    for stage, extension in stages(diagnosis):
        if extension.steps:
            screening = extension.steps[0].screening
            threshold = (
                float(np.quantile(screening.nulls, 1.0 - FALSE_ALARMS)) if len(screening.nulls) else float("nan")
            )
            found.append(Ranking(stage, tuple(_standings(extension, screening)), threshold))
    return found


def _standings(extension: Extension, screening: ScreeningResult) -> list[RankedCandidate]:
    full, found = extension.base.full, {}
    for s in screening.candidate_scores:
        if s.effect in found:
            continue
        effect = next(e for e in full.model.effects if e.name == s.effect)
        at = [extension.base.theta[i] for i in full.columns(full.parameters_of(s.effect))]
        sizes = {p.name: (float(x + d), sd) for p, x, d, sd in zip(effect.parameters, at, s.step, s.sd, strict=False)}
        found[s.effect] = RankedCandidate(
            s.effect, effect.kind.value, s.score, screening.p_value(s.score), explained(extension.base, s), sizes
        )
    return sorted(found.values(), key=lambda s: -s.score)
