"""Weights of models that hold-out data hardly separate: stacking of predictive distributions.

A rival in place of a cause is another model of the same records. The weights are those of the mixture of all models'
predictive distributions that predicts left-out data best, so they say what each adds to the prediction, and stay
sensible where none of them is true. Without a prior the weights of models that predict about alike lie at random in a
corner; with one they are equal.

Source: Y. Yao, A. Vehtari, D. Simpson and A. Gelman, Using stacking to average Bayesian predictive distributions,
Bayesian Analysis 13, 2018; with a prior: Y. Yao, G. Pirs, A. Vehtari and A. Gelman, Bayesian hierarchical stacking,
Bayesian Analysis 17, 2022; resampling of blocks by D. B. Rubin, The Bayesian bootstrap, Annals of Statistics 9, 1981.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy.optimize import LinearConstraint, minimize

from bayes_aero.diagnosis.screening.parameter_fit import refitted
from bayes_aero.diagnosis.screening.screening import screen
from bayes_aero.diagnosis.screening.selection_state import SelectionState, moved
from bayes_aero.diagnosis.selection.cross_validation import LeftOut, holdout_gain, truncated
from bayes_aero.diagnosis.selection.forward_selection import Extension, added, removed

RESAMPLED = 200  # weightings of the blocks
PRIOR = 2.0  # of the Dirichlet distribution of the weights: each model has predicted one sample alone beforehand
LEAST = 1e-6  # weight where a prior forbids none
BAND = (0.05, 0.95)  # quantiles of a weight over them


@dataclass(frozen=True)
class StackedModel:
    """One of the models that the records hardly separate.

    Attributes:
        effects: additions to the card's model.
        instead: the cause that a rival replaces in it, and the rival; None in the model as it was selected.
        theta: its parameters, fitted to all records.
        weight: in the mixture that predicts left-out data best, in the mean over resampled blocks.
        band: 90 % of the resampled weights.
        elpd: log density of left-out data beyond the model as it was selected, over the variance inflation, and its
            standard error.
    """

    effects: tuple[str, ...]
    instead: tuple[str, str] | None
    theta: Float[np.ndarray, " k"]
    weight: float
    band: tuple[float, float]
    elpd: tuple[float, float]


@dataclass(frozen=True)
class Stacking:
    """All models of one stage, that which was selected first; `blocks` were resampled."""

    stage: str
    models: tuple[StackedModel, ...]
    blocks: int

    def has(self, effect: str) -> bool:
        """Whether any model has an effect."""
        return any(effect in m.effects for m in self.models)

    def compares(self, cause: str) -> bool:
        """Whether a rival stands in place of a cause in any model."""
        return any(m.instead is not None and m.instead[0] == cause for m in self.models)

    def weight(self, effect: str) -> float:
        """Weight of all models that have an effect."""
        return float(sum(m.weight for m in self.models if effect in m.effects))


def stacked(
    extension: Extension, stage: str, rivals: Mapping[str, Sequence[str]], kept: Sequence[str], *, seed: int
) -> Stacking | None:
    """Weights of the confirmed extension and of those with a rival in place of one of its causes; None without rivals.

    Args:
        extension: of one stage.
        stage: its name.
        rivals: by cause, effects that explain the records about as well.
        kept: additions that hold-out data confirm.
        seed: of the resampled blocks.
    """
    state = truncated(extension.state, kept)
    states, instead = [state], list[tuple[str, str] | None]([None])
    for cause in (name for name in rivals if name in kept):
        ranking = screen(extension.state, extension.fit, seed=0, nulls=False, without=cause)
        for rival in (name for name in rivals[cause] if name not in extension.state.active):
            standing = ranking.of(rival)
            if standing is not None:
                other, _ = refitted(added(removed(extension.state, cause), standing))
                states.append(truncated(other, [*(e for e in kept if e != cause), rival]))
                instead.append((cause, rival))
    if len(states) == 1:
        return None
    states = [refitted(one)[0] for one in states]
    left = [LeftOut.refitted(one) for one in states]
    density = np.stack([one.density() for one in left], axis=1)
    block = blocks_of_time(state)[left[0].inside]
    weights = resampled_weights(density, block, state.variance_inflation, seed)
    low, high = np.quantile(weights, BAND, axis=0)
    models = [
        StackedModel(
            one.active, instead[k], one.theta, float(weights[:, k].mean()), (float(low[k]), float(high[k])),
            holdout_gain(left[0], left[k], state) if k else (0.0, 0.0),
        )
        for k, one in enumerate(states)
    ]  # fmt: skip
    return Stacking(stage, tuple(models), len(np.unique(block)))


def states_of(found: Stacking, extension: Extension) -> list[SelectionState]:
    """The models where they were fitted."""
    return [moved(extension.state, one.theta, one.effects) for one in found.models]


def blocks_of_time(state: SelectionState) -> Int[np.ndarray, " m"]:
    """Number of the block of some `settings.block` seconds to which each sample belongs; none spans two manoeuvres."""
    found, number = np.zeros(len(state.residual), int), 0
    for k in range(len(state.responses.flights.lengths)):
        own = np.flatnonzero(state.responses.manoeuvre == k)
        for part in np.array_split(own, max(1, round(len(own) * state.responses.seconds / state.settings.block))):
            found[part] = number
            number += 1
    return found


def resampled_weights(
    density: Float[np.ndarray, "n k"], block: Int[np.ndarray, " n"], inflation: float, seed: int
) -> Float[np.ndarray, "r k"]:
    """Stacking weights under random weights of whole blocks, whose samples hang together."""
    numbers, own = np.unique(block, return_inverse=True)
    shares = np.random.default_rng(seed).dirichlet(np.ones(len(numbers)), RESAMPLED)
    return np.array([stacking_weights(density, inflation, len(numbers) * share[own]) for share in shares])


def stacking_weights(
    density: Float[np.ndarray, "n k"],
    inflation: float,
    share: Float[np.ndarray, " n"] | None = None,
    prior: float = PRIOR,
) -> Float[np.ndarray, " k"]:
    """Most probable weights of the mixture, by the log density of left-out samples and a Dirichlet prior.

    Models that predict alike have equal weights. One that gains D nats over one other, to second order in what they
    differ by, leaves it about (2 D)^-1/2.

    Args:
        density: log predictive density of each of n samples by each of k models.
        inflation: variance inflation, by which the log density is divided.
        share: how much each sample counts; default: 1.
        prior: parameter of the Dirichlet distribution; 1 is stacking without a prior.
    """
    count = density.shape[1]
    share = (np.ones(len(density)) if share is None else share) / max(inflation, 1.0)
    likelihood, scale = np.exp(density - density.max(axis=1, keepdims=True)), 1.0 / share.sum()

    def loss(w: np.ndarray) -> tuple[float, np.ndarray]:
        mixed, w = np.maximum(likelihood @ w, 1e-300), np.maximum(w, LEAST)
        value = share @ np.log(mixed) + (prior - 1.0) * np.log(w).sum()
        return -scale * float(value), -scale * ((share / mixed) @ likelihood + (prior - 1.0) / w)

    best = minimize(
        loss, np.full(count, 1.0 / count), jac=True, bounds=[(0.0 if prior == 1.0 else LEAST, 1.0)] * count,
        method="SLSQP", constraints=LinearConstraint(np.ones((1, count)), 1.0, 1.0), options={"ftol": 1e-10},
    )  # fmt: skip
    weights = np.clip(best.x, 0.0, 1.0)
    return weights / weights.sum()
