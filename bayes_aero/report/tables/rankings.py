"""The candidates of every stage in the order of their scores, as tables and figures show them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from bayes_aero.diagnosis.result import COEFFICIENTS, FLIGHT_PATH, TRAJECTORIES, Diagnosis
from bayes_aero.diagnosis.screening.screening import Poll
from bayes_aero.diagnosis.selection.forward_selection import Extension, explained

LEADERS = 10  # candidates of a stage that are listed, by their scores
CONSIDERED = 3  # and by the share of what is left that they explain
FALSE_ALARMS = 0.05  # share of noise-only replicates whose best score is beyond the threshold


@dataclass(frozen=True)
class Standing:
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
    standings: tuple[Standing, ...]
    threshold: float

    @property
    def leaders(self) -> tuple[Standing, ...]:
        """Those that tables and figures show: the `LEADERS` highest scores, and what is considered first."""
        first = {s.effect for s in sorted(self.standings, key=lambda s: -s.explains)[:CONSIDERED]}
        return tuple(s for k, s in enumerate(self.standings) if k < LEADERS or s.effect in first)


def stages(diagnosis: Diagnosis) -> list[tuple[str, Extension]]:
    """Stages of the diagnosis by the names that its causes carry."""
    found = [(FLIGHT_PATH, diagnosis.sensors)] if diagnosis.sensors is not None else []
    return [*found, (COEFFICIENTS if diagnosis.by_coefficients else TRAJECTORIES, diagnosis.aerodynamics)]


def rankings_of(diagnosis: Diagnosis) -> list[Ranking]:
    """Candidates of every stage."""
    found = []
    for stage, extension in stages(diagnosis):
        if extension.steps:
            poll = extension.steps[0].poll
            threshold = float(np.quantile(poll.nulls, 1.0 - FALSE_ALARMS)) if len(poll.nulls) else float("nan")
            found.append(Ranking(stage, tuple(_standings(extension, poll)), threshold))
    return found


def _standings(extension: Extension, poll: Poll) -> list[Standing]:
    field, found = extension.base.field, {}
    for s in poll.standings:
        if s.effect in found:
            continue
        effect = next(e for e in field.model.effects if e.name == s.effect)
        at = [extension.base.theta[i] for i in field.columns(field.parameters_of(s.effect))]
        sizes = {p.name: (float(x + d), sd) for p, x, d, sd in zip(effect.parameters, at, s.step, s.sd, strict=False)}
        found[s.effect] = Standing(
            s.effect, effect.kind.value, s.score, poll.p_value(s.score), explained(extension.base, s), sizes
        )
    return sorted(found.values(), key=lambda s: -s.score)
