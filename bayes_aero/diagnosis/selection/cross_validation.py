"""What an extension gains on data that it was not fitted to."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from bayes_aero.diagnosis.result import Gain
from bayes_aero.diagnosis.screening.selection_state import SelectionState, moved, optimum
from bayes_aero.inference.scores import Scores, score
from bayes_aero.inference.variance.coloured_bounds import LAG_SHARE, autocovariance
from bayes_aero.physics.coefficients import NAMES


def split_name(state: SelectionState) -> str:
    """How data were left out."""
    return "manoeuvre" if len(state.responses.flights.lengths) > 1 else "block"


@dataclass(frozen=True)
class LeftOut:
    """Residuals of every fold at parameters fitted to the other folds; `inside` marks blocks that belong to a fold."""

    residual: Float[np.ndarray, "m c"]
    noise_growth: Float[np.ndarray, "m c"]
    inside: Bool[np.ndarray, " m"]

    @classmethod
    def refitted(cls, state: SelectionState) -> LeftOut:
        """With the effects that are in, every fit brought to its own optimum."""
        keep = [state.responses.outputs.index(name) for name in state.outputs]
        residual = np.zeros_like(state.residual)
        for number, fold in enumerate(state.folds):
            theta = optimum(state, [f for f in range(len(state.folds)) if f != number], state.settings.hold_out_steps)
            residual[fold] = np.asarray(state.responses.evaluate(jnp.asarray(theta))[0])[fold][:, keep]
        return cls._of(state, residual)

    @classmethod
    def first_order(cls, state: SelectionState, effects: Sequence[str]) -> LeftOut:
        """With only `effects` of those that are in, from the sensitivities where the state stands: a hundredth of
        the time of `refitted`."""
        own = [state.full.columns(state.full.parameters_of(e)) for e in state.active if e not in effects]
        gone = np.concatenate([np.zeros(0, int), *own])
        neutral = np.array([state.full.neutral[name] for name in state.full.model.names])
        away = neutral[gone] - state.theta[gone]
        products, columns = state.products.shifted(gone, away), state.columns(effects)
        parameters = ~np.isin(columns, state.offsets)
        residual = state.residual - state.S[:, :, gone] @ away
        for number, fold in enumerate(state.folds):
            others = products.over([f for f in range(len(state.folds)) if f != number])
            step = others.fit(columns, state.mean, state.precision).step
            residual[fold] -= state.S[fold][:, :, columns[parameters]] @ step[parameters]
        return cls._of(state, residual)

    @classmethod
    def _of(cls, state: SelectionState, residual: Float[np.ndarray, "m c"]) -> LeftOut:
        inside = np.zeros(len(residual), bool)
        for fold in state.folds:
            inside[fold] = True
        residual = np.where(inside[:, None], residual, 0.0)
        offsets = state.S[:, :, state.offsets]
        if offsets.shape[2]:  # where a flight-path integral began is the left-out fold's own to find
            residual -= offsets @ (np.einsum("mco,mc->o", offsets, residual) / np.sum(offsets**2, axis=(0, 1)))
        return cls(residual, state.noise_growth, inside)

    def density(self) -> Float[np.ndarray, " m"]:
        """Log predictive density of every block, all outputs together."""
        return self.densities().sum(axis=1)

    def densities(self) -> Float[np.ndarray, "m c"]:
        """Log predictive density of every block by output.

        Independent and normal, with the variance that the left-out residuals themselves have: the variance of the
        fitted ones would punish a model for the other manoeuvre's stall, whatever its mean.
        """
        scaled = self.residual[self.inside] / self.noise_growth[self.inside]
        variance = np.mean(scaled**2, axis=0) * self.noise_growth[self.inside] ** 2
        return -0.5 * (self.residual[self.inside] ** 2 / variance + np.log(2.0 * np.pi * variance))

    def scores(self, measured: Float[np.ndarray, "m c"]) -> dict[str, Scores]:
        """Scores of each coefficient over everything left out, against what was recorded (blocks of about 5 Hz)."""
        z, e = measured[self.inside], self.residual[self.inside]
        return {name: score(z[:, c], z[:, c] - e[:, c]) for c, name in enumerate(NAMES)}


def measured_blocks(state: SelectionState) -> Float[np.ndarray, "m c"]:
    """Coefficients as the card reconstructs them from the record, averaged over blocks."""
    neutral = np.array([state.full.neutral[name] for name in state.full.model.names])
    at_base = state.theta.copy()
    for effect in state.full.model.effects:
        if effect.name not in state.full.base:
            for p in effect.parameters:
                i = state.full.columns([p.name])[0]
                at_base[i] = neutral[i]
    return np.asarray(state.responses.block(state.responses.evaluate(at_base)[1]["measured"]))


def holdout_gain(before: LeftOut, after: LeftOut, state: SelectionState) -> tuple[float, float]:
    """Log density of unseen data that `after` has beyond `before`, the colour's cost counted, and its deviation."""
    difference = (after.density() - before.density()) / state.variance_inflation
    lengths = [fold.stop - fold.start for fold in state.folds]
    if len(state.responses.flights.lengths) == 1:  # blocks of one flight, one after the other: their colour runs on
        lengths = [sum(lengths)]
    return float(difference.sum()), deviation_of_sum(difference, lengths)


def deviation_of_sum(values: Float[np.ndarray, " m"], lengths: Sequence[int]) -> float:
    """Standard deviation of the sum of a coloured series of constant mean, its stretches taken as independent.

    From the autocovariance up to `LAG_SHARE` of each stretch, tapered by Parzen's window as in the corrected
    Cramer-Rao bounds: short of the truth where the colour is nearly as long as that.
    """
    away = (values - values.mean())[:, None]
    parts = np.split(away, np.cumsum(lengths)[:-1])
    variance = sum(len(part) * autocovariance(part, max(1, int(LAG_SHARE * len(part)))).sum() for part in parts)
    return float(np.sqrt(variance * len(values) / (len(values) - 1)))


def gain(
    base: LeftOut, before: LeftOut, after: LeftOut, state: SelectionState, measured: Float[np.ndarray, "m c"]
) -> Gain:
    """The gain of `after` over the extension before it; scores before are those of `base`."""
    return Gain(*holdout_gain(before, after, state), split_name(state), base.scores(measured), after.scores(measured))


def truncated(state: SelectionState, effects: Sequence[str]) -> SelectionState:
    """The state with only the first additions in, the others' parameters at neutral."""
    theta = state.theta.copy()
    for effect in state.active:
        if effect not in effects:
            for name in state.full.parameters_of(effect):
                theta[state.full.columns([name])[0]] = state.full.neutral[name]
    return moved(state, theta, tuple(effects))
