"""Which form has unexplained structure: forward selection of terms by what they predict of left-out folds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from bayes_aero.diagnosis.result import FoundTerm
from bayes_aero.diagnosis.screening.autocorrelation import autocorrelation_of
from bayes_aero.diagnosis.screening.parameter_fit import PartialledRegression, inflation_along
from bayes_aero.diagnosis.screening.regression import Fit
from bayes_aero.diagnosis.screening.screening import block_jackknife_covariance, uncertainty
from bayes_aero.diagnosis.screening.selection_state import Component, SelectionState
from bayes_aero.diagnosis.selection.holdout import holdout_deviance_gain
from bayes_aero.diagnosis.structure.changes import chance_of, null_shares, share_of, with_components
from bayes_aero.diagnosis.terms.columns import Column, columns_of
from bayes_aero.diagnosis.terms.library import Term
from bayes_aero.inference.covariance import nats

NEAR = 0.5  # of the best term's gain, below which no other is compared with it; our choice
AS_GOOD = 0.1  # of what the function gains, what terms may gain less: it bends as it likes; our choice
SWING = {"CL": 0.01, "CD": 0.001, "Cm": 0.002, "CY": 0.01, "Cl": 0.001, "Cn": 0.001}
"""The least change of a coefficient worth modelling, as in the catalogue."""


@dataclass(frozen=True)
class Found:
    """A term that was added, with the deviance that it gains on left-out folds, and those that are as good."""

    column: Column
    gain: float
    share: float
    inflation: float
    weight: float
    others: tuple[tuple[Term, float], ...]
    p_value: float
    among: int  # terms of which it was chosen

    @property
    def cost(self) -> float:
        """Nats of a parameter and of the choice of a term."""
        return 1.0 + float(np.log(self.among))


def forms(state: SelectionState, coefficient: str, least_gain: float, *, seed: int) -> list[Found]:
    """Terms that describe what is left of a coefficient as well as the function of a channel by which it was found.

    Args:
        state: with all that was selected from the catalogue in.
        coefficient: whose residual is sought.
        least_gain: deviance of left-out folds that the function of the channel gains.
        seed: of the noise-only replicates.

    Returns:
        The terms, the first added first; empty where none predicts as well.
    """
    columns, found = columns_of(state, coefficient), list[Found]()
    for number in range(state.settings.terms_most):
        one = _next(state, columns, [f.column for f in found], seed + number)
        if one is None:
            break
        found.append(one)
    found = reconsidered(state, found)
    if not found:
        return []
    inflation = max(one.inflation for one in found)
    missed = nats(least_gain - gain_of(state, [f.column.component for f in found]), inflation)
    return found if missed < max(state.settings.ambiguous, AS_GOOD * nats(least_gain, inflation)) else []


def gain_of(state: SelectionState, components: Sequence[Component]) -> float:
    """Deviance of left-out folds that components gain together."""
    wide = with_components(state, (), components, state.folds)
    return holdout_deviance_gain(wide, wide.columns(), state.columns())


def reconsidered(state: SelectionState, found: Sequence[Found]) -> list[Found]:
    """The terms that are still worth their place beside all others, with what each gains there."""
    left = list(found)
    for one in found:
        others = [f.column.component for f in left if f is not one]
        trial = with_components(state, [one.column.component], others, state.folds)
        own = np.concatenate([trial.columns(), trial.component_columns[0]])
        share, gain = share_of(trial, own[-1:]), holdout_deviance_gain(trial, own)
        at = left.index(one)
        worth = share >= state.least_share(state.settings.unnamed_share) and gain > 0.0
        left[at : at + 1] = [replace(one, share=share, gain=gain)] if worth else []
    return left


def _next(state: SelectionState, columns: Sequence[Column], chosen: Sequence[Column], seed: int) -> Found | None:
    """The best term beside those chosen; None where none is beyond chance, large enough and useful."""
    settings, (one, _, trial) = state.settings, leader(state, columns, chosen)
    if nats(one.gain, one.inflation) < settings.ambiguous or one.share < settings.unnamed_share:
        return None
    own = np.append(trial.columns(), _of_term(trial, one))
    wider = trial.products.fit(own, trial.mean, trial.precision)
    colour = autocorrelation_of(trial.left(wider), trial.folds)
    p = chance_of(one.share, null_shares(trial, colour, wider.variance, seed))
    return None if p > settings.unnamed_false_alarm_rate else replace(one, p_value=p)


def leader(
    state: SelectionState, columns: Sequence[Column], chosen: Sequence[Column]
) -> tuple[Found, float, SelectionState]:
    """The best term beside those chosen, the nats that it explains, and the state in which the others stand."""
    labels = {c.component.label for c in chosen}
    open_ones = [c for c in columns if c.component.label not in labels]
    trial = with_components(state, [c.component for c in open_ones], [c.component for c in chosen], state.folds)
    fit = trial.fit()
    order, lost, inflation = _ranked(trial, fit)
    weights = weights_of(lost, [open_ones[j].term.cost for j in order])
    equal = [i for i in range(len(order)) if lost[i] < state.settings.ambiguous]
    first = max(equal, key=lambda i: weights[i])
    others = [(open_ones[order[i]].term, float(weights[i])) for i in equal if i != first]
    others.sort(key=lambda other: -other[1])
    column = trial.component_columns[order[first]]
    own = np.concatenate([trial.columns(), column])
    explained = nats(fit.deviance - trial.products.fit(own, trial.mean, trial.precision).deviance, inflation)
    one = Found(
        open_ones[order[first]], holdout_deviance_gain(trial, own), share_of(trial, column), inflation,
        float(weights[first]), tuple(others), float("nan"), len(columns),
    )  # fmt: skip
    return one, explained, trial


def _of_term(trial: SelectionState, one: Found) -> int:
    """The column of a term that stands."""
    return int(trial.component_columns[trial.components.index(one.column.component)][0])


def _ranked(trial: SelectionState, fit: Fit) -> tuple[list[int], Float[np.ndarray, " j"], float]:
    """Terms that gain at least half of what the best one does, the best first; by how many nats each explains less; and
    the variance inflation of the best.

    Two terms are told from each other by the residual along the difference of what they explain.
    """
    projected = PartialledRegression(trial, fit, trial.component_columns)
    place = np.array([p[0] for p in projected.place])
    bread, right = np.array([b[0, 0] for b in projected.bread]), projected.right(trial.left(fit))[place]
    n = float(trial.products.count.sum())
    gains = -n * np.log1p(-np.minimum(right**2 * bread / n, 1.0 - 1e-9))
    order = [int(j) for j in np.argsort(-gains, kind="stable") if gains[j] >= NEAR * gains.max()]
    own = np.concatenate([trial.columns(), trial.component_columns[order[0]]])
    colour = autocorrelation_of(trial.left(trial.products.fit(own, trial.mean, trial.precision)), trial.folds)
    made = projected.P[:, :, place[order]] * (bread * right)[order]
    apart = np.concatenate([made[:, :, :1], made[:, :, :1] - made[:, :, 1:]], axis=2)
    inflation = inflation_along(apart, projected.weight, trial.folds, colour)
    lost = [0.0, *(nats(gains[order[0]] - gains[j], x) for j, x in zip(order[1:], inflation[1:], strict=True))]
    return order, np.array(lost), float(inflation[0])


def weights_of(lost: Float[np.ndarray, " j"], costs: Sequence[int]) -> Float[np.ndarray, " j"]:
    """Posterior probabilities of terms, of which each factor halves the prior one."""
    log = -lost - np.log(2.0) * np.array(costs)
    weights = np.exp(log - log.max())
    return weights / weights.sum()


def sized(state: SelectionState, found: Sequence[Found]) -> tuple[FoundTerm, ...]:
    """All terms fitted together, beside the parameters of the model."""
    whole = with_components(state, (), [f.column.component for f in found], state.folds)
    fit = whole.fit()
    covariance = uncertainty(whole, fit, autocorrelation_of(whole.left(fit), whole.folds))
    deviation = np.sqrt(np.diag(covariance))[len(fit.columns) - len(found) :]
    if state.responses.jackknife_blocks is not None:  # no smaller than the estimates without each part scatter
        between = np.sqrt(np.diag(block_jackknife_covariance(whole, fit)[1]))
        deviation = np.maximum(deviation, between[len(between) - len(found) :])
    begin, told = len(fit.columns) - len(found), []
    for number, one in enumerate(found):
        at, scale = begin + number, one.column.scale
        coefficient = one.column.component.label.split(" over ")[0]
        told.append(
            FoundTerm(
                coefficient=coefficient,
                term=one.column.term,
                size=(float(fit.step[at]) / scale, float(deviation[number]) / scale),
                share=one.share,
                gain=nats(one.gain, one.inflation),
                weight=one.weight,
                others=one.others,
                least=SWING[coefficient] / max(one.column.spread, 1e-12),
            )
        )
    return tuple(told)
