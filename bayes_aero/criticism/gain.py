"""What an extension gains on data that it was not fitted to."""

from __future__ import annotations

from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from bayes_aero.criticism.finding import Gain
from bayes_aero.criticism.state import State, moved, optimum
from bayes_aero.inference.scores import Scores, score
from bayes_aero.physics.coefficients import NAMES

STRETCH = 10.0  # s, over which log densities are summed for their standard error
UNSEEN_STEPS = 4  # Gauss-Newton steps of each fit to the other folds


def split_name(state: State) -> str:
    """How data were left out."""
    return "manoeuvre" if len(state.responses.flights.lengths) > 1 else "block"


class LeftOut:
    """Residuals of every fold at parameters fitted to the other folds, for one list of effects."""

    def __init__(self, state: State) -> None:
        keep = [state.responses.outputs.index(name) for name in state.outputs]
        self.residual = np.zeros_like(state.residual)
        self.swell = state.swell
        self.inside = np.zeros(len(state.residual), bool)
        for number, fold in enumerate(state.folds):
            theta = optimum(state, [f for f in range(len(state.folds)) if f != number], UNSEEN_STEPS)
            self.residual[fold] = np.asarray(state.responses.evaluate(jnp.asarray(theta))[0])[fold][:, keep]
            self.inside[fold] = True
        offsets = state.S[:, :, state.offsets]
        if offsets.shape[2]:  # where a flight-path integral began is the left-out fold's own to find
            self.residual -= offsets @ (
                np.einsum("mco,mc->o", offsets, self.residual) / np.sum(offsets**2, axis=(0, 1))
            )

    def density(self) -> Float[np.ndarray, " m"]:
        """Log predictive density of every block, all outputs together.

        Independent and normal, with the variance that the left-out residuals themselves have: the variance of the
        fitted ones would punish a model for the other manoeuvre's stall, whatever its mean.
        """
        scaled = self.residual[self.inside] / self.swell[self.inside]
        variance = np.mean(scaled**2, axis=0) * self.swell[self.inside] ** 2
        return -0.5 * (self.residual[self.inside] ** 2 / variance + np.log(2.0 * np.pi * variance)).sum(axis=1)

    def scores(self, measured: Float[np.ndarray, "m c"]) -> dict[str, Scores]:
        """Scores of each coefficient over everything left out, against what was recorded (blocks of about 5 Hz)."""
        z, e = measured[self.inside], self.residual[self.inside]
        return {name: score(z[:, c], z[:, c] - e[:, c]) for c, name in enumerate(NAMES)}


def measured_blocks(state: State) -> Float[np.ndarray, "m c"]:
    """Coefficients as the card reconstructs them from the record, averaged over blocks."""
    neutral = np.array([state.field.neutral[name] for name in state.field.model.names])
    at_base = state.theta.copy()
    for effect in state.field.model.effects:
        if effect.name not in state.field.base:
            for p in effect.parameters:
                i = state.field.columns([p.name])[0]
                at_base[i] = neutral[i]
    return np.asarray(state.responses.block(state.responses.evaluate(at_base)[1]["measured"]))


def gains(base: LeftOut, extended: Sequence[LeftOut], state: State, measured: Float[np.ndarray, "m c"]) -> list[Gain]:
    """The gain of each extension over the one before it; scores before are those of `base`."""
    found, before = [], base
    per = max(1, round(STRETCH / state.responses.seconds))
    for after in extended:
        difference = (after.density() - before.density()) / state.temper
        sums = np.array([part.sum() for part in np.array_split(difference, max(2, len(difference) // per))])
        se = float(np.sqrt(len(sums)) * sums.std(ddof=1))
        found.append(Gain(float(sums.sum()), se, split_name(state), base.scores(measured), after.scores(measured)))
        before = after
    return found


def truncated(state: State, effects: Sequence[str]) -> State:
    """The state with only the first additions in, the others' parameters at neutral."""
    theta = state.theta.copy()
    for effect in state.active:
        if effect not in effects:
            for name in state.field.parameters_of(effect):
                theta[state.field.columns([name])[0]] = state.field.neutral[name]
    return moved(state, theta, tuple(effects))
