"""What the flight path cannot decide about errors of sensors: those it asks for in vain, and those that others imitate.

An offset of the pitch attitude turns gravity in the body axes. Accelerometers that are off by as much as that look the
same, so without another measurement (the altitude, a calm wind) the record knows the sum of both and neither of them.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from bayes_aero.diagnosis.screening.regression import TINY, inverse, partialled
from bayes_aero.diagnosis.screening.screening import CandidateScore
from bayes_aero.diagnosis.screening.selection_state import SelectionState
from bayes_aero.diagnosis.selection.forward_selection import Extension, explained
from bayes_aero.diagnosis.settings import DiagnosisSettings
from bayes_aero.effect import Effect
from bayes_aero.flight.agreement import OpenError


def open_errors(found: Extension) -> tuple[OpenError, ...]:
    """Each error of one parameter that is asked for and not confirmed, or imitated by others; the former first.

    One that was added and is beyond absence whatever others are there, too, is decided.

    Args:
        found: the search along the flight path, ended by `widened`.
    """
    state = found.state
    effects = [e for e in state.full.candidates if _felt(state, e)]
    gram, columns = _information(found, effects)
    # Priors weigh against a white likelihood as against the coloured one: see `SelectionState.variance_inflation`.
    among = np.sqrt(state.variance_inflation * np.diag(inverse(gram + np.diag(state.precision[columns]))))
    screening = found.steps[-1].screening
    told = []
    for place, effect in enumerate(effects):
        parameter = effect.parameters[0]
        standing = None if effect.name in state.active else screening.of(effect.name)
        asked = standing is not None and _asked(state, effect, standing)
        mean, sd = _size(found, effect, standing)
        wide = max(sd, float(among[place]))
        imitators, share = _imitators(gram, effects, place, state.settings)
        least, _ = effect.sizes[parameter.name]
        decided = standing is None and abs(mean) >= state.settings.least_score * wide
        if decided or state.settings.least_score * wide < least:  # nobody hides an error that is worth a name
            imitators, share = (), 0.0
        if not (asked or imitators):
            continue
        told.append(
            OpenError(
                name=effect.name,
                unit=parameter.unit,
                mean=mean,
                sd=sd,
                among=wide,
                asked=asked,
                imitators=imitators,
                share=share,
            )
        )
    rank = {standing.effect: k for k, standing in reversed(list(enumerate(screening.candidate_scores)))}
    return tuple(sorted(told, key=lambda e: (not e.asked, rank.get(e.name, len(rank)))))


def _felt(state: SelectionState, effect: Effect) -> bool:
    """Whether an effect has one parameter, no break point, and moves the flight path."""
    if len(effect.parameters) != 1 or effect.scan or not effect.sizes:
        return False
    return bool(np.any(state.S[:, :, state.full.own_columns(effect.name)] != 0.0))


def _information(found: Extension, effects: Sequence[Effect]) -> tuple[Float[np.ndarray, "k k"], np.ndarray]:
    """Information on one parameter of each effect, where integrals begin being free, and these parameters' columns."""
    state = found.state
    columns = state.full.columns([e.parameters[0].name for e in effects])
    X, begin = (state.scaled[state.inside][:, :, own] for own in (columns, state.offsets))
    weight = 1.0 / found.fit.variance
    X = partialled(X, begin, weight)
    return np.einsum("mci,c,mcj->ij", X, weight, X), columns


def _asked(state: SelectionState, effect: Effect, standing: CandidateScore) -> bool:
    """Whether an error of a size worth a name would explain much of what is left, were it only confirmed."""
    least = effect.sizes[effect.parameters[0].name][0]
    clear = standing.score >= state.settings.least_score and standing.log_bayes > 0.0 and abs(standing.step[0]) >= least
    return clear and explained(state, standing) >= state.settings.open_share


def _size(found: Extension, effect: Effect, standing: CandidateScore | None) -> tuple[float, float]:
    """What the record says of an error, were it the only one."""
    if standing is not None:
        return float(standing.step[0]), float(standing.sd[0])
    size = found.sizes[effect.parameters[0].name]
    return size.mean, size.sd


def _imitators(
    gram: Float[np.ndarray, "k k"], effects: Sequence[Effect], place: int, settings: DiagnosisSettings
) -> tuple[tuple[str, ...], float]:
    """The fewest other errors, each of a size that sensors have, that do what one error does; and their share of it."""
    chosen: list[int] = []
    for _ in range(settings.imitators):
        others = [k for k in range(len(effects)) if k != place and k not in chosen]
        shares = {k: _share(gram, effects, place, [*chosen, k]) for k in others}
        if not shares:
            break
        best = max(shares, key=lambda k: shares[k])
        chosen.append(best)
        if shares[best] >= settings.imitated:
            return tuple(effects[k].name for k in chosen), shares[best]
    return (), 0.0


def _share(gram: Float[np.ndarray, "k k"], effects: Sequence[Effect], place: int, others: Sequence[int]) -> float:
    """Share of what an error of the least size worth a name does that `others` do; none if they must be too large."""
    at = np.array(others)
    factors = inverse(gram[np.ix_(at, at)]) @ gram[at, place]
    least, _ = effects[place].sizes[effects[place].parameters[0].name]
    largest = np.array([effects[k].sizes[effects[k].parameters[0].name][1] for k in others])
    if np.any(np.abs(factors) * least > largest):
        return 0.0
    return float(factors @ gram[at, place]) / max(float(gram[place, place]), TINY)
