"""The candidates of every stage in the order of their scores, as tables and figures show them."""

from __future__ import annotations

from bayes_aero.diagnosis.result import FLIGHT_PATH, Diagnosis
from bayes_aero.diagnosis.screening.screening import ScreeningResult
from bayes_aero.diagnosis.selection.forward_selection import Extension, explained
from bayes_aero.diagnosis.view.results import RankedCandidate, Ranking


def stages(diagnosis: Diagnosis) -> list[tuple[str, Extension]]:
    """Stages of the diagnosis by the names that its causes carry."""
    found = [(FLIGHT_PATH, diagnosis.sensors)] if diagnosis.sensors is not None else []
    return [*found, (diagnosis.compared, diagnosis.aerodynamics)]


def rankings_of(diagnosis: Diagnosis) -> list[Ranking]:
    """Candidates of every stage."""
    found = []
    for stage, extension in stages(diagnosis):
        if extension.steps:
            screening = extension.steps[0].screening
            level = extension.state.settings.false_alarm_rate
            standings = tuple(_standings(extension, screening))
            found.append(Ranking(stage, standings, screening.threshold(level), level))
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
