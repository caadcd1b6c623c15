"""Extend the model by what earns its place: elect, add, refit, exchange, drop, until nothing is left to add."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from bayes_aero.criticism.election import REPLICATES, Nulls, Standing, noise_only, standings
from bayes_aero.criticism.lagged import Fit
from bayes_aero.criticism.state import State, moved, refitted, swelling

ALPHA = 0.05  # family-wise rate of false alarms of each election
CLEAR = 15.0  # nats beyond which no noise-only replicate has ever come near, so none are drawn
TRIED = 6  # leaders considered in one election
MARGIN = 3.0  # nats by which another effect must be better before it takes a place

Progress = Callable[[str, float], None]


@dataclass(frozen=True)
class Step:
    """One election: every candidate's standing, the chosen one (None: nobody), its p-value and why it was taken."""

    chosen: str | None
    p_value: float
    standings: tuple[Standing, ...]
    nulls: Nulls
    unseen: float  # log-density gained on folds left out, nats
    minor: bool = False  # significant but smaller than is worth modelling: kept as a nuisance, never named


@dataclass(frozen=True)
class Extension:
    """The state with everything that was added, its fit, the elections, and which additions are worth a name."""

    base: State
    base_fit: Fit
    state: State
    fit: Fit
    steps: tuple[Step, ...]
    causes: tuple[str, ...]
    minor: tuple[str, ...]
    excluded: tuple[str, ...] = ()


def settled(state: State) -> tuple[State, Fit]:
    """Refit, measure how the noise grows with separation, and refit with it."""
    state, fit = refitted(state)
    return refitted(moved(replace(state, swell=swelling(state, fit)), state.theta))


def extend(state: State, *, seed: int = 0, most: int = 8, progress: Progress | None = None) -> Extension:
    """Add effects to `state` until none is both beyond chance and useful on data left out; at most `most`.

    Each election's p-value is family-wise over all candidates, from noise-only replicates.
    """
    state, fit = settled(state)
    first, first_fit = state, fit
    steps: list[Step] = []
    for number in range(most):
        if progress:
            progress("causes", number / most)
        step = _election(state, fit, seed + number)
        steps.append(step)
        if step.chosen is None:
            break
        winner = next(s for s in step.standings if s.effect == step.chosen)
        if progress:
            progress(f"adding {winner.effect}", number / most)
        state, fit = refitted(_added(state, winner))
        state, fit = _reconsidered(state, fit)
    causes, minor = _worth(state)
    return Extension(first, first_fit, state, fit, tuple(steps), causes, minor)


def _election(state: State, fit: Fit, seed: int) -> Step:
    ranking = standings(state, fit)
    clear = bool(ranking) and ranking[0].log_bayes > CLEAR
    nulls = Nulls(np.full(REPLICATES, -np.inf), fit.phi) if clear else noise_only(state, fit, seed)
    best: dict[str, Standing] = {}
    for standing in ranking:
        best.setdefault(standing.effect, standing)
    for standing in list(best.values())[:TRIED]:
        p = nulls.p_value(standing.log_bayes)
        if p > ALPHA or standing.log_bayes <= 0.0:
            break
        gain = unseen_gain(state, standing)
        if gain > 0.0:
            return Step(standing.effect, p, tuple(ranking), nulls, gain)
    top = ranking[0].log_bayes if ranking else -np.inf
    return Step(None, nulls.p_value(top), tuple(ranking), nulls, float("nan"))


def unseen_gain(state: State, standing: Standing) -> float:
    """Log-density that the candidate gains on folds left out, each predicted from the others' fit, nats."""
    folds = range(len(state.folds))
    columns = state.columns()
    wide = np.concatenate([columns, np.array(standing.columns, int)])
    total = 0.0
    for fold in folds:
        train = state.lagged.over([f for f in folds if f != fold])
        left = state.lagged.over([fold])
        without = _offsets_free(state, left, train.fit(columns, state.mean, state.precision))
        with_it = _offsets_free(state, left, train.fit(wide, state.mean, state.precision))
        total += with_it - without
    return total


def _offsets_free(state: State, left, fit: Fit) -> float:
    """Log-density of a fold at the trained parameters; only where its flight-path integrals begin is fitted there."""
    own = state.offsets
    trained = ~np.isin(fit.columns, own)
    mean = state.mean.copy()
    mean[fit.columns[trained]] = fit.step[trained]
    precision = state.precision.copy()
    precision[fit.columns[trained]] = 1e14 * np.maximum(1.0, state.precision[fit.columns[trained]])
    return left.log_density_at(fit, mean, precision)


def _added(state: State, winner: Standing) -> State:
    theta = state.theta.copy()
    names = state.field.parameters_of(winner.effect)
    if winner.value is not None:
        scan = next(s for s in state.scans if s.effect == winner.effect and s.value == winner.value)
        theta[state.field.columns([scan.parameter])[0]] = winner.value
    else:
        at = state.field.columns(names)
        bounds = np.array([state.field.model.free[i].bounds for i in at])
        theta[at] = np.clip(theta[at] + np.array(winner.step), bounds[:, 0], bounds[:, 1])
    return moved(state, theta, (*state.active, winner.effect))


def removed(state: State, effect: str) -> State:
    """The state without one of its additions, that effect's parameters at neutral."""
    theta = state.theta.copy()
    neutral = state.field.neutral
    for name in state.field.parameters_of(effect):
        theta[state.field.columns([name])[0]] = neutral[name]
    return moved(state, theta, tuple(e for e in state.active if e != effect), scan=True)


def _reconsidered(state: State, fit: Fit) -> tuple[State, Fit]:
    """Look at each earlier addition again: drop it if it is superfluous by now, exchange it if it was a proxy."""
    for effect in state.active[:-1]:
        ranking = standings(state, fit, without=effect)
        own = next((s.log_bayes for s in ranking if s.effect == effect), -np.inf)
        if own < 0.0:
            state, fit = refitted(removed(state, effect))
        elif ranking[0].effect != effect and ranking[0].log_bayes > own + MARGIN:
            bare = removed(state, effect)
            state, fit = refitted(_added(bare, ranking[0]))
    return state, fit


def _worth(state: State) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Additions large enough to be worth modelling, and those that are only a nuisance."""
    causes, minor = [], []
    neutral = state.field.neutral
    values = dict(zip(state.field.model.names, state.theta, strict=True))
    for name in state.active:
        effect = next(e for e in state.field.candidates if e.name == name)
        large = any(abs(values[p] - neutral[p]) >= least for p, (least, _) in effect.sizes.items())
        (causes if large or not effect.sizes else minor).append(name)
    return tuple(causes), tuple(minor)
