"""What an extension gains on data that it was not fitted to."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Protocol, TypeVar, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float

from bayes_aero.diagnosis.screening.parameter_fit import optimum
from bayes_aero.diagnosis.screening.regression import Products, inverse
from bayes_aero.diagnosis.screening.selection_state import SelectionState, moved
from bayes_aero.diagnosis.settings import DEFAULT, DiagnosisSettings
from bayes_aero.inference.scores import Scores, log_density, log_score_gain, log_score_gains, score


def split_name(state: SelectionState) -> str:
    """How data were left out."""
    return "manoeuvre" if len(state.responses.flights.lengths) > 1 else "block"


@dataclass(frozen=True)
class LeftOut:
    """Residuals of every fold at parameters fitted to the other folds; `inside` marks blocks that belong to a fold.

    `names` are the outputs, c of them.
    """

    residual: Float[np.ndarray, "m c"]
    noise_growth: Float[np.ndarray, "m c"]
    inside: Bool[np.ndarray, " m"]
    names: tuple[str, ...]

    @classmethod
    def refitted(cls, state: SelectionState) -> LeftOut:
        """With the effects that are in, every fit brought to its own optimum."""
        import jax.numpy as jnp  # not before: `check` does not load JAX

        residual = np.zeros_like(state.residual)
        keep = [state.responses.outputs.index(name) for name in state.outputs]
        for number, fold in enumerate(state.folds):
            others = [f for f in range(len(state.folds)) if f != number]
            theta = optimum(state, others, state.settings.hold_out_steps)
            residual[fold] = np.asarray(state.responses.evaluate(jnp.asarray(theta))[0])[:, keep][fold]
        return cls._of(state, residual)

    @classmethod
    def first_order(cls, state: SelectionState, effects: Sequence[str]) -> LeftOut:
        """With only `effects` of those that are in, from the sensitivities where the state stands: a hundredth of
        the time of `refitted`."""
        gone = state.full.own_columns(*(e for e in state.active if e not in effects))
        away = -state.departure[gone]
        products, columns = state.products.shifted(gone, away), state.columns(effects)
        parameters = ~np.isin(columns, state.offsets)
        residual = state.residual - state.S[:, :, gone] @ away
        for number, fold in enumerate(state.folds):
            step = products.without(number).fit(columns, state.mean, state.precision).step
            residual[fold] -= state.S[fold][:, :, columns[parameters]] @ step[parameters]
        return cls._of(state, residual)

    @classmethod
    def _of(cls, state: SelectionState, residual: Float[np.ndarray, "m c"]) -> LeftOut:
        residual = np.where(state.inside[:, None], residual, 0.0)
        offsets = state.S[:, :, state.offsets]
        if offsets.shape[2]:  # where a flight-path integral began is the left-out fold's own to find
            residual -= offsets @ (np.einsum("mco,mc->o", offsets, residual) / np.sum(offsets**2, axis=(0, 1)))
        return cls(residual, state.noise_growth, state.inside, state.outputs)

    def density(self) -> Float[np.ndarray, " m"]:
        """Log predictive density of every block, all outputs together."""
        return self.densities().sum(axis=1)

    def densities(self) -> Float[np.ndarray, "m c"]:
        """Log predictive density of every block by output.

        Independent and normal, with the variance that the left-out residuals themselves have: the variance of the
        fitted ones would punish a model for the other manoeuvre's stall, whatever its mean.
        """
        residual, noise_growth = self.residual[self.inside], self.noise_growth[self.inside]
        return log_density(residual, np.mean((residual / noise_growth) ** 2, axis=0) * noise_growth**2)

    def scores(self, measured: Float[np.ndarray, "m c"]) -> dict[str, Scores]:
        """Scores of each coefficient over everything left out, against what was recorded (blocks of about 5 Hz)."""
        z, e = measured[self.inside], self.residual[self.inside]
        return {name: score(z[:, c], z[:, c] - e[:, c]) for c, name in enumerate(self.names)}


def measured_blocks(state: SelectionState) -> Float[np.ndarray, "m c"]:
    """Coefficients as the card reconstructs them from the record, averaged over blocks."""
    card = state.full.card_only(state.theta)
    return np.asarray(state.responses.block(state.responses.evaluate(card)[1]["measured"]))


def holdout_gain(before: LeftOut, after: LeftOut, state: SelectionState) -> tuple[float, float]:
    """Log density of unseen data that `after` has beyond `before`, over the variance inflation, and its deviation."""
    return log_score_gain(before.density(), after.density(), state.variance_inflation, _lengths(state))


def output_gains(before: LeftOut, after: LeftOut, state: SelectionState) -> dict[str, tuple[float, float]]:
    """`holdout_gain` of each output by itself; empty along the flight path, where integrals wander: of its errors the
    coefficients say what they make worse."""
    if state.outputs != state.responses.model.coefficients and state.responses.jackknife_blocks is None:
        return {}
    return log_score_gains(
        state.outputs, before.densities(), after.densities(), state.variance_inflation, _lengths(state)
    )


def _lengths(state: SelectionState) -> list[int]:
    """Blocks of each part of the flights that is independent of the others."""
    lengths = [fold.stop - fold.start for fold in state.folds]
    if len(state.responses.flights.lengths) == 1:  # blocks of one flight, one after the other: their colour runs on
        lengths = [sum(lengths)]
    return lengths


def truncated(state: SelectionState, effects: Sequence[str]) -> SelectionState:
    """The state with only `effects` of its additions in, the others' parameters at neutral."""
    theta = state.full.at_neutral(state.theta, [e for e in state.active if e not in effects])
    return moved(state, theta, tuple(effects))


def holdout_deviance_gain(state: SelectionState, wide: np.ndarray, narrow: np.ndarray | None = None) -> float:
    """Deviance that columns `wide` gain over `narrow` (default: the active ones) on folds that were left out."""
    narrow = state.columns() if narrow is None else narrow
    return holdout_deviance(state, narrow) - holdout_deviance(state, wide)


def holdout_deviance(state: SelectionState, columns: np.ndarray) -> float:
    """Deviance of folds that were left out, each with these columns fitted to the others.

    From inner products alone, for thousands of fits; `LeftOut` has the residuals.
    """
    used = np.unique(np.concatenate([columns, state.offsets]))
    products, mean, precision = state.products.only(used), state.mean[used], state.precision[used]
    columns, offsets = (np.searchsorted(used, own) for own in (columns, state.offsets))

    def deviance(fold: int) -> float:
        """n log(mean square) over outputs of the fold; offsets are its own."""
        step = products.without(fold).fit(columns, mean, precision).step
        parameters = ~np.isin(columns, offsets)
        left = products.over([fold]).shifted(columns[parameters], step[parameters])
        if len(offsets):
            return left.fit(offsets, np.zeros_like(mean), np.zeros_like(mean)).deviance
        n = float(left.count.sum())
        return float(n * np.sum(np.log(left.gram[0, :, 0, 0] / n)))

    return float(np.sum([deviance(fold) for fold in range(len(state.folds))]))


def addition_gain(state: SelectionState, wide: np.ndarray) -> float:
    """Deviance that additions `wide` gain over those that are in on folds that were left out: `holdout_deviance_gain`,
    or, where it is none and unlike manoeuvres may be why, `transferred_deviance_gain`."""
    gain = holdout_deviance_gain(state, wide)
    of_card = bool(
        np.any(state.columns(()) < len(state.theta))
    )  # sensors along the flight path have no such parameters
    if gain > 0.0 or not of_card or len(state.responses.flights.lengths) < 2:
        return gain
    return transferred_deviance_gain(state, wide)


def transferred_deviance_gain(state: SelectionState, wide: np.ndarray) -> float:
    """Deviance that additions `wide` gain over those that are in, if a fold knows of them what the other folds say,
    and fits the parameters of the card by itself.

    Unlike manoeuvres do not predict each other: a doublet says nothing of the stall, and what the card's parameters
    then miss of the stall covers what an addition gains. Here a fold is asked for the additions alone. Their estimate
    from the other folds, with its uncertainty, is the fold's prior, and they are integrated out.
    """
    card = state.columns(())
    used = np.unique(np.concatenate([wide, state.columns(), card]))
    products, mean, precision = state.products.only(used), state.mean[used], state.precision[used]
    everything, active, card = (np.searchsorted(used, columns) for columns in (wide, state.columns(), card))
    prior = mean, precision

    def deviance(fold: int, columns: np.ndarray) -> float:
        return integrated_deviance(products, fold, (columns, card), prior, state.variance_inflation)

    return float(np.sum([deviance(fold, active) - deviance(fold, everything) for fold in range(len(state.folds))]))


def integrated_deviance(
    products: Products,
    fold: int,
    columns: tuple[np.ndarray, np.ndarray],
    prior: tuple[np.ndarray, np.ndarray],
    inflation: float,
) -> float:
    """Deviance of a fold whose prior of the additions is their posterior from the other folds; they are integrated out.

    Args:
        products: of all folds.
        fold: its number.
        columns: all columns, and those of the card among them, which are fitted to the fold.
        prior: mean and precision of every column.
        inflation: how many times the white likelihood counts a sample; priors are multiplied by it, too.
    """
    everything, card = columns
    others = products.without(fold).fit(everything, *prior)
    at = np.flatnonzero(~np.isin(everything, card))
    told = 1.0 / np.diag(inverse(others.normal))[at]
    mean, precision = (x.copy() for x in prior)
    mean[everything[at]], precision[everything[at]] = others.step[at], told
    own = products.over([fold]).fit(everything, mean, precision)
    narrowed = 1.0 / np.diag(inverse(own.normal))[at] / told
    return own.deviance + inflation * float(np.sum(np.log(np.maximum(narrowed, 1.0))))


# --- Which additions unseen data confirm.
# An election asks only that a candidate gains at all on data left out, and adds one after the other. Taken together
# some are superfluous, and what is superfluous harms elsewhere: a delay that fits one manoeuvre's noise spoils the
# simulation of the next. So additions are taken out again one at a time, the least useful first, as long as unseen
# data do not miss them, or an output is predicted worse with them than without.


@dataclass(frozen=True)
class Confirmation:
    """`kept`: additions that unseen data miss. `missed`: the log density each is missed by, and its deviation.

    `harmed`: of those not kept, outputs that are predicted worse with the addition, with that gain of log density.
    """

    kept: tuple[str, ...]
    missed: Mapping[str, tuple[float, float]]
    harmed: Mapping[str, Mapping[str, tuple[float, float]]] = field(default_factory=dict)


T = TypeVar("T")


@runtime_checkable
class Predictions(Protocol[T]):
    """Unseen data as the model with some of its additions predicts them: T is what is left of them."""

    def first_order(self, effects: Sequence[str]) -> T:
        """To first order, in no time."""
        ...

    def refitted(self, effects: Sequence[str]) -> T:
        """Everything fitted again."""
        ...

    def holdout_gain(self, before: T, after: T) -> tuple[float, float]:
        """Log density that `after` has beyond `before`, over the variance inflation, and its deviation."""
        ...

    def output_gains(self, before: T, after: T, /) -> Mapping[str, tuple[float, float]]:
        """The same of each output."""
        ...


def backward_elimination(
    additions: Sequence[str], unseen: Predictions[T], settings: DiagnosisSettings = DEFAULT
) -> Confirmation:
    """Each addition in turn, least missed to first order first, is taken out and everything fitted again.

    What stays is missed by `settings.hold_out` standard errors of its log density (nats), and degrades no output
    (see `DiagnosisSettings.degrades`); where all that wait are missed by `settings.hold_out_first_order` of them to
    first order and degrade none, nothing is fitted again, and that is reported.
    """

    def degraded(without: T, whole: T) -> dict[str, tuple[float, float]]:
        return settings.degraded(unseen.output_gains(without, whole))

    plain = settings.hold_out_first_order
    kept, missed, waiting = list(additions), {}, list(additions)
    harmed: dict[str, Mapping[str, tuple[float, float]]] = {}
    whole: T | None = None
    while waiting:
        near, less = unseen.first_order(kept), {e: unseen.first_order(_less(kept, e)) for e in waiting}
        losses = {e: unseen.holdout_gain(less[e], near) for e in waiting}
        harmful = [e for e in waiting if degraded(less[e], near)]
        least = min(harmful or waiting, key=lambda e: losses[e][0] - plain * losses[e][1])
        if not harmful and losses[least][0] > plain * losses[least][1]:
            missed |= losses
            break
        if whole is None:
            whole = unseen.refitted(kept)
        without = unseen.refitted(_less(kept, least))
        missed[least] = unseen.holdout_gain(without, whole)
        worse = degraded(without, whole)
        if worse or not missed[least][0] > settings.hold_out * missed[least][1]:
            kept, whole = _less(kept, least), without
            harmed |= {least: worse} if worse else {}
        waiting.remove(least)
    return Confirmation(tuple(kept), {e: missed[e] for e in additions}, harmed)


@dataclass(frozen=True)
class _Recorded:
    """Outputs of a state, from sensitivities where the state stands or from fits of their own."""

    state: SelectionState

    def first_order(self, effects: Sequence[str]) -> LeftOut:
        return LeftOut.first_order(self.state, effects)

    def refitted(self, effects: Sequence[str]) -> LeftOut:
        return LeftOut.refitted(truncated(self.state, effects))

    def holdout_gain(self, before: LeftOut, after: LeftOut) -> tuple[float, float]:
        return holdout_gain(before, after, self.state)

    def output_gains(self, before: LeftOut, after: LeftOut) -> Mapping[str, tuple[float, float]]:
        return output_gains(before, after, self.state)


def confirmation(state: SelectionState) -> Confirmation:
    """What unseen data confirm of all additions of a state."""
    return backward_elimination(state.active, _Recorded(state), state.settings)


def _less(effects: Sequence[str], one: str) -> list[str]:
    return [e for e in effects if e != one]
