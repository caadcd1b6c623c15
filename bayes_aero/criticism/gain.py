"""What an extension gains on data that it was not fitted to."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

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
        self.variance = np.ones_like(state.residual)  # between folds nothing is predicted
        self.inside = np.zeros(len(state.residual), bool)
        for number, fold in enumerate(state.folds):
            others = [f for f in range(len(state.folds)) if f != number]
            theta = optimum(state, others, UNSEEN_STEPS)
            residual = np.asarray(state.responses.evaluate(theta)[0])[:, keep]
            scaled = residual / state.swell
            used = np.concatenate([scaled[state.folds[f]] for f in others])
            self.residual[fold] = residual[fold]
            self.variance[fold] = np.mean(used**2, axis=0) * state.swell[fold] ** 2
            self.inside[fold] = True

    def density(self) -> Float[np.ndarray, " m"]:
        """Log predictive density of every block, all outputs together; white, from the other folds' variance."""
        found = -0.5 * (self.residual**2 / self.variance + np.log(2.0 * np.pi * self.variance)).sum(axis=1)
        return found[self.inside]

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


def r2_of(scores: Mapping[str, Scores]) -> dict[str, float]:
    """R2 by coefficient."""
    return {name: s.r2 for name, s in scores.items()}
