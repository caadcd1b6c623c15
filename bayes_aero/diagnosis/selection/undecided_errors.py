"""What the flight path cannot decide about errors of sensors: those it asks for in vain, and those that others imitate.

An offset of the pitch attitude turns gravity in the body axes. Accelerometers that are off by as much as that look the
same, so without another measurement (the altitude, a calm wind) the record knows the sum of both and neither of them.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np
from jaxtyping import Float, Int

from bayes_aero.diagnosis.screening.parameter_fit import refitted
from bayes_aero.diagnosis.screening.regression import TINY, Fit, inverse, partialled
from bayes_aero.diagnosis.screening.screening import CandidateScore
from bayes_aero.diagnosis.screening.selection_state import SelectionState, moved
from bayes_aero.diagnosis.selection.forward_selection import Extension, explained
from bayes_aero.diagnosis.settings import DiagnosisSettings
from bayes_aero.effect import Effect
from bayes_aero.flight.agreement import OpenError
from bayes_aero.inference.variance.variance_inflation import nats


def open_errors(found: Extension) -> tuple[OpenError, ...]:
    """Each error of one parameter that is asked for and not confirmed, or imitated by others; the former first.

    One that was added and is beyond absence, estimated with all others, is decided.

    Args:
        found: the search along the flight path, ended by `widened`.
    """
    state = found.state
    effects = [e for e in state.full.candidates if _felt(state, e)]
    gram, right = _information(state, found.fit, effects)
    columns = _columns(state, effects)
    # Priors weigh against a white likelihood as against the coloured one: see `SelectionState.variance_inflation`.
    covariance = inverse(gram + np.diag(state.precision[columns]))
    among = np.sqrt(state.variance_inflation * np.diag(covariance))
    jointly = covariance @ (right + gram @ state.departure[columns])
    screening = found.steps[-1].screening
    told = []
    for place, effect in enumerate(effects):
        parameter = effect.parameters[0]
        standing = None if effect.name in state.active else screening.of(effect.name)
        asked = standing is not None and _asked(state, effect, standing)
        mean, sd = _size(found, effect, standing)
        wide = max(sd, float(among[place]))
        least, _ = effect.sizes[parameter.name]
        there = max(least, abs(mean)) if standing is None else least
        imitators, share = _imitators(gram, effects, place, state.settings, there)
        decided = standing is None and abs(jointly[place]) >= state.settings.least_score * wide
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


def _columns(state: SelectionState, effects: Sequence[Effect]) -> Int[np.ndarray, " k"]:
    """Columns of the one parameter of each effect."""
    return state.full.columns([e.parameters[0].name for e in effects])


def _information(
    state: SelectionState, fit: Fit, effects: Sequence[Effect]
) -> tuple[Float[np.ndarray, "k k"], Float[np.ndarray, " k"]]:
    """Information on one parameter of each effect, where integrals begin being free, and the right side of what is
    left."""
    X, begin = (state.scaled[state.inside][:, :, own] for own in (_columns(state, effects), state.offsets))
    weight = 1.0 / fit.variance
    X = partialled(X, begin, weight)
    right = np.einsum("mci,c,mc->i", X, weight, state.left(fit)[state.inside])
    return np.einsum("mci,c,mcj->ij", X, weight, X), right


def with_several_instead(state: SelectionState, fit: Fit) -> tuple[SelectionState, Fit]:
    """The state with an addition exchanged for several errors that together do nearly the same, where these explain the
    record decisively better.

    Offset and scale of an airspeed come one by one. Neither gains what an offset of its pitot pressure does.
    """
    effects = [e for e in state.full.candidates if _felt(state, e)]
    gram, _ = _information(state, fit, effects)
    for place, effect in enumerate(effects):
        if effect.name not in state.active:
            continue
        others = [name for name in state.active if name != effect.name]
        neutral = state.full.at_neutral(state.theta, [effect.name])
        least, _ = effect.sizes[effect.parameters[0].name]  # those of absurd size are taken out afterwards
        for together, share in _nearest(gram, effects, place, state.settings, least):
            if len(together) < 2 or share < state.settings.imitated or set(together) & set(others):
                continue
            wider, wider_fit = refitted(moved(state, neutral, (*others, *together)))
            choice = (len(together) - 1) * math.log(len(state.full.candidates))
            if nats(fit.deviance - wider_fit.deviance, state.variance_inflation) - choice > state.settings.decisive:
                return with_several_instead(wider, wider_fit)
    return state, fit


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
    gram: Float[np.ndarray, "k k"], effects: Sequence[Effect], place: int, settings: DiagnosisSettings, size: float
) -> tuple[tuple[str, ...], float]:
    """The fewest other errors, each of a size that sensors have, that do what one of this size does; and their share
    of it."""
    nearest = _nearest(gram, effects, place, settings, size)
    return next((one for one in nearest if one[1] >= settings.imitated), ((), 0.0))


def _nearest(
    gram: Float[np.ndarray, "k k"], effects: Sequence[Effect], place: int, settings: DiagnosisSettings, size: float
) -> Iterator[tuple[tuple[str, ...], float]]:
    """One other error, two, and so on, that do most of what one error does; and their share of it."""
    chosen: list[int] = []
    for _ in range(settings.imitators):
        others = [k for k in range(len(effects)) if k != place and k not in chosen]
        shares = {k: _share(gram, effects, place, [*chosen, k], size) for k in others}
        if not shares:
            return
        best = max(shares, key=lambda k: shares[k])
        chosen.append(best)
        yield tuple(effects[k].name for k in chosen), shares[best]


def _share(
    gram: Float[np.ndarray, "k k"], effects: Sequence[Effect], place: int, others: Sequence[int], size: float
) -> float:
    """Share of what an error of this size does that `others` do; none if they must be too large."""
    at = np.array(others)
    factors = inverse(gram[np.ix_(at, at)]) @ gram[at, place]
    largest = np.array([effects[k].sizes[effects[k].parameters[0].name][1] for k in others])
    if np.any(np.abs(factors) * size > largest):
        return 0.0
    return float(factors @ gram[at, place]) / max(float(gram[place, place]), TINY)
