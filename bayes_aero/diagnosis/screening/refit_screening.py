"""A candidate judged under the colour that is left once it is in.

With the candidate out, slow structure that it explains passes for slow noise, under which anything goes: one manoeuvre
has few independent swings to tell the two apart. With it in, the noise looks faster than it is, more so for the best of
many candidates. The noise-only replicates make the same choice and pay the same price.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from bayes_aero.diagnosis.screening.autocorrelation import (
    Autocorrelation,
    Middle,
    SharedNoise,
    autocorrelation_of,
    autocorrelations_of,
    unbiased,
)
from bayes_aero.diagnosis.screening.partialled_regression import PartialledRegression, equivalent
from bayes_aero.diagnosis.screening.screening import (
    CandidateScore,
    columns_of,
    log_bayes,
    without_active,
)
from bayes_aero.diagnosis.screening.selection_state import SelectionState


class RefitScore:
    """One candidate's score, log Bayes factor and p-value under its own colour."""

    def __init__(self, state: SelectionState, standing: CandidateScore, noise: SharedNoise) -> None:
        wider = state.products.fit(columns_of(state, standing), state.mean, state.precision)
        self.state = state
        self.fit = state.products.fit(state.columns(), state.mean, state.precision, held=wider.variance)
        blocks = [b[1] for b in state.blocks if b[0] not in state.active]
        self.projected = PartialledRegression(state, self.fit, blocks)
        self.noise = noise
        found = autocorrelation_of(state.left(wider), state.folds)
        noises = self._noises(found, noise.correction)
        self.colour = unbiased(found, self._left(noises, self._leaders(noises)))
        own = next(j for j, columns in enumerate(blocks) if tuple(columns) == standing.columns)
        (estimate,), (covariance,) = self._judged(own, state.left(self.fit)[None], [self.colour])
        self.score = equivalent(estimate, covariance)
        at = np.array(standing.columns, int)
        self.log_bayes = log_bayes(estimate, covariance, state.mean[at], state.precision[at] / state.variance_inflation)

    def p_value(self) -> float:
        """Share of noise-only replicates whose most explaining candidate scores at least as high."""
        noises = self._noises(self.colour, self.noise.replicates)
        leaders = self._leaders(noises)
        colours, scores = self._left(noises, leaders), np.zeros(len(noises))
        for j in {j for j, _ in leaders}:
            at = [k for k, (leader, _) in enumerate(leaders) if leader == j]
            judged = self._judged(j, noises[at], [colours[k] for k in at])
            scores[at] = [equivalent(*pair) for pair in zip(*judged, strict=True)]
        return float((1 + np.sum(scores >= self.score)) / (1 + len(scores)))

    def _noises(self, colour: Autocorrelation, white: Float[np.ndarray, "t f r c"]) -> Float[np.ndarray, "r m c"]:
        """Noise records of a colour, the active columns taken out."""
        drawn = colour.coloured(white, self.state.folds, len(self.state.residual))
        return without_active(self.state, self.fit, drawn)

    def _leaders(self, noises: Float[np.ndarray, "r m c"]) -> list[tuple[int, Float[np.ndarray, " _"]]]:
        """The candidate that explains most of each noise record, and its estimate."""
        right = self.projected.right(noises)
        pairs = list(zip(self.projected.place, self.projected.bread, strict=True))
        gains = np.array([np.einsum("ri,ij,rj->r", right[:, p], B, right[:, p], optimize=True) for p, B in pairs])
        best = np.argmax(gains, axis=0)
        return [(int(j), pairs[j][1] @ r[pairs[j][0]]) for j, r in zip(best, right, strict=True)]

    def _left(
        self, noises: Float[np.ndarray, "r m c"], leaders: Sequence[tuple[int, Float[np.ndarray, " _"]]]
    ) -> list[Autocorrelation]:
        """The colour of each noise record once its leader is taken out."""
        P, place = self.projected.P, self.projected.place
        left = [noise - P[:, :, place[j]] @ estimate for noise, (j, estimate) in zip(noises, leaders, strict=True)]
        return autocorrelations_of(np.array(left), self.state.folds)

    def _judged(
        self, j: int, residuals: Float[np.ndarray, "r m c"], colours: Sequence[Autocorrelation]
    ) -> tuple[Float[np.ndarray, "r w"], Float[np.ndarray, "r w w"]]:
        """Estimate and covariance of one block in each of r records."""
        bread, P = self.projected.bread[j], self.projected.P[:, :, self.projected.place[j]]
        middle = Middle(P, self.fit.variance, self.state.folds, [np.arange(P.shape[2])])
        right = np.tensordot(residuals * self.projected.weight, P, 2)
        return right @ bread, bread @ middle.under_each(colours, [0])[1][0] @ bread
