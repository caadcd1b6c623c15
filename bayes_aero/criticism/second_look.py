"""A candidate judged under the colour that is left once it is in.

With the candidate out, slow structure that it explains passes for slow noise, under which anything goes: one manoeuvre
has few independent swings to tell the two apart. With it in, the noise looks faster than it is, more so for the best of
many candidates. The noise-only replicates make the same choice and pay the same price.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from bayes_aero.criticism.colour import Colour, colour_of, unbiased
from bayes_aero.criticism.election import (
    CORRECTION,
    REPLICATES,
    Projected,
    Standing,
    columns_of,
    equivalent,
    log_bayes,
    without_active,
)
from bayes_aero.criticism.regression import inverse
from bayes_aero.criticism.state import State


class SecondLook:
    """One candidate's score, log Bayes factor and p-value under its own colour."""

    def __init__(self, state: State, standing: Standing, *, seed: int) -> None:
        wider = state.products.fit(columns_of(state, standing), state.mean, state.precision)
        self.state = state
        self.fit = state.products.fit(state.columns(), state.mean, state.precision, held=wider.variance)
        blocks = [b[1] for b in state.blocks if b[0] not in state.active]
        self.projected = Projected(state, self.fit, blocks)
        self.bread = [inverse(self.projected.information[np.ix_(p, p)]) for p in self.projected.place]
        self.rng = np.random.default_rng(seed)
        found = colour_of(state.left(wider), state.folds)
        drawn = found.simulate(CORRECTION, state.folds, len(state.residual), self.rng)
        noises = [without_active(state, self.fit, e) for e in drawn]
        self.colour = unbiased(found, [self._left(noise, *self._leader(noise)) for noise in noises])
        own = next(j for j, columns in enumerate(blocks) if tuple(columns) == standing.columns)
        estimate, covariance = self._judged(own, state.left(self.fit), self.colour)
        self.score = equivalent(estimate, covariance)
        at = np.array(standing.columns, int)
        self.log_bayes = log_bayes(estimate, covariance, state.mean[at], state.precision[at] / state.temper)

    def p_value(self) -> float:
        """Share of noise-only replicates whose most explaining candidate scores at least as high."""
        scores = []
        for e in self.colour.simulate(REPLICATES, self.state.folds, len(self.state.residual), self.rng):
            noise = without_active(self.state, self.fit, e)
            j, estimate = self._leader(noise)
            scores.append(equivalent(*self._judged(j, noise, self._left(noise, j, estimate))))
        return float((1 + np.sum(np.array(scores) >= self.score)) / (1 + len(scores)))

    def _right(self, residual: Float[np.ndarray, "m c"]) -> Float[np.ndarray, " w"]:
        return np.einsum("mcj,c,mc->j", self.projected.P, 1.0 / self.fit.variance, residual, optimize=True)

    def _leader(self, noise: Float[np.ndarray, "m c"]) -> tuple[int, Float[np.ndarray, " w"]]:
        """The candidate that explains most of a noise record, and its estimate."""
        right = self._right(noise)
        gains = [right[p] @ B @ right[p] for p, B in zip(self.projected.place, self.bread, strict=True)]
        j = int(np.argmax(gains))
        return j, self.bread[j] @ right[self.projected.place[j]]

    def _left(self, noise: Float[np.ndarray, "m c"], j: int, estimate: Float[np.ndarray, " w"]) -> Colour:
        left = noise - self.projected.P[:, :, self.projected.place[j]] @ estimate
        return colour_of(left, self.state.folds)

    def _judged(self, j: int, residual: Float[np.ndarray, "m c"], colour: Colour) -> tuple[np.ndarray, np.ndarray]:
        place = self.projected.place[j]
        bread = self.bread[j]
        meat = colour.meat(self.projected.P[:, :, place], self.fit.variance, self.state.folds)
        return bread @ self._right(residual)[place], bread @ meat @ bread
