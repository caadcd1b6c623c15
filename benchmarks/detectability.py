"""How large a hidden effect is against what a diagnosis could have seen of it."""

from __future__ import annotations

from collections.abc import Mapping

from bayes_aero.diagnosis.diagnose import Diagnosis
from bayes_aero.effects import CATALOGUE


def standard_scores(found: Diagnosis, effects: Mapping[str, Mapping[str, float]]) -> dict[str, float]:
    """Each hidden effect's size over the standard error that its first election gave it.

    The largest over its parameters, and over the stages in which it stood (flight path, coefficients); an effect that
    stood in neither has none.
    """
    scores: dict[str, float] = {}
    for name, values in effects.items():
        for stage in (found.sensors, found.aerodynamics):
            standing = stage.steps[0].screening.of(name) if stage is not None and stage.steps else None
            if standing is not None:
                owned = [p for p in CATALOGUE[name].parameters if p.name in values]
                sizes = [
                    abs(values[p.name] - p.neutral) / max(sd, 1e-300) for p, sd in zip(owned, standing.sd, strict=False)
                ]
                scores[name] = max(scores.get(name, 0.0), *sizes)
    return scores
