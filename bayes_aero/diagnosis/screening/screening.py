"""Which candidate explains what the model leaves, and how often noise alone would look as good.

Candidates are ranked by how much of the residual they explain. Whether that is more than chance is judged by the
estimate over a deviation that knows the residual's colour, and the largest such score in noise-only replicates.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from bayes_aero.diagnosis.screening.autocorrelation import (
    Autocorrelation,
    Middle,
    SharedNoise,
    autocorrelation_of,
    autocorrelations_of,
    unbiased,
)
from bayes_aero.diagnosis.screening.parameter_fit import PartialledRegression, equivalent, score
from bayes_aero.diagnosis.screening.regression import RegressionFit, inverse, partialled
from bayes_aero.diagnosis.screening.selection_state import SelectionState
from bayes_aero.inference.covariance import jackknife_covariance, nats, variance_inflation


@dataclass(frozen=True)
class CandidateScore:
    """One candidate against the present model."""

    effect: str
    columns: tuple[int, ...]
    value: float | None
    gain: float  # the deviance it takes away
    score: float  # its estimate in standard deviations that know the colour; of several parameters the equivalent
    variance_inflation: float  # of its parameters, the largest
    log_bayes: float  # log Bayes factor of estimate and deviation under the effect's prior
    step: tuple[float, ...]
    sd: tuple[float, ...]
    together: float = math.nan  # what it would take away if the outputs' noise were allowed to correlate
    # Along the difference between what it explains and what the addition explains that was taken out (see `screen`).
    variance_inflation_apart: float = math.nan

    def nats(self, other: CandidateScore) -> float:
        """Log likelihood by which this addition, which was taken out, explains more than `other`."""
        # What tells the two from each other is the residual along the difference d of what they explain. Its variance
        # is d'Sd where white residuals would leave s2 d'd: the log likelihood ratio is the white one over that of both.
        return nats(self.gain - other.gain, other.variance_inflation_apart)


@dataclass(frozen=True)
class ScreeningResult:
    """Scores of the candidates, the most explaining first, and the largest score of each noise-only replicate."""

    candidate_scores: tuple[CandidateScore, ...]
    colour: Autocorrelation
    nulls: Float[np.ndarray, " r"]

    def p_value(self, score: float) -> float:
        """Share of noise-only replicates in which some candidate scores at least as high."""
        return float((1 + np.sum(self.nulls >= score)) / (1 + len(self.nulls)))

    def threshold(self, level: float) -> float:
        """The score above which the p-value is at most `level`; not a number without replicates, or with too few."""
        above = int(level * (1 + len(self.nulls)))
        return float(np.sort(self.nulls)[-above]) if 0 < above <= len(self.nulls) else math.nan

    def of(self, effect: str) -> CandidateScore | None:
        """The best standing of one effect."""
        return next((s for s in self.candidate_scores if s.effect == effect), None)


def screen(
    state: SelectionState,
    fit: RegressionFit,
    *,
    seed: int,
    nulls: bool = True,
    without: str | None = None,
    noise: SharedNoise | None = None,
) -> ScreeningResult:
    """Fit every candidate, all active parameters free; draw noise-only replicates (`nulls`) under the present model.

    `without` takes one addition out first, to first order: it is then a candidate like the others, and each of
    them is told `apart` from it. `noise` is that of the seed, where others are judged by it, too.
    """
    if without is not None:
        state = state.without([without])
        fit = state.fit()
    residual, blocks = state.left(fit), [b for b in state.blocks if b[0] not in state.active]
    if not blocks:
        return ScreeningResult((), autocorrelation_of(residual, state.folds), np.zeros(0))
    projected = PartialledRegression(state, fit, [b[1] for b in blocks])
    noise = SharedNoise(seed, state.folds, residual.shape[1], state.settings) if noise is None else noise
    colour = autocorrelation_of(residual, state.folds)
    # Re-estimation from noise whose active columns were fitted shows how much faster the noise then looks.
    drawn = without_active(state, fit, colour.coloured(noise.correction, state.folds, len(residual)))
    colour = unbiased(colour, autocorrelations_of(drawn, state.folds))
    estimates, covariances = projected.scores(residual, colour)
    stretch = state.responses.stretch
    freedom = 0 if stretch is None else int(stretch.max())
    if stretch is not None:
        pairs = zip(estimates, covariances, projected.between(residual, estimates, stretch), strict=True)
        covariances = [C if equivalent(b, C) < equivalent(b, W) else W for b, C, W in pairs]
    gains = _gains(state, fit, [b[1] for b in blocks])
    before = projected.deviance(residual)
    away = max((j for j, block in enumerate(blocks) if block[0] == without), key=lambda j: gains[0][j], default=None)
    apart = None if away is None else projected.apart(residual, estimates, away, colour, stretch)
    found = []
    for j, (effect, own, value) in enumerate(blocks):
        variance = np.maximum(np.diag(covariances[j]), 0.0)
        inflation = variance_inflation(variance, np.diag(projected.bread[j]))
        step = gains[1][j][: len(own)]
        possible, prior = _possible(state, effect, value, step), state.precision[own] / state.variance_inflation
        found.append(
            CandidateScore(
                effect=effect,
                columns=tuple(int(i) for i in own),
                value=value,
                gain=float(gains[0][j]) if possible else 0.0,
                score=score(estimates[j], covariances[j], freedom) if possible else 0.0,
                variance_inflation=float(np.max(inflation)),
                log_bayes=log_bayes(estimates[j], covariances[j], state.mean[own], prior),
                step=tuple(float(x) for x in step),
                sd=tuple(float(x) for x in np.sqrt(variance)),
                together=before - projected.deviance(residual, j, estimates[j]),
                variance_inflation_apart=math.nan if apart is None else float(apart[j]),
            )
        )
    largest = null_scores(state, fit, projected, colour, noise) if nulls else np.zeros(0)
    return ScreeningResult(tuple(sorted(found, key=lambda s: -s.gain)), colour, largest)


def _possible(state: SelectionState, effect: str, value: float | None, step: Float[np.ndarray, " w"]) -> bool:
    """Whether a candidate moves to the side of the present value on which it was tried, if it was."""
    if value is None:
        return True
    parameter = next(s.parameter for s in state.scans if s.effect == effect)
    return bool(step[0] * (value - state.theta[state.full.columns([parameter])[0]]) > 0.0)


def null_scores(
    state: SelectionState,
    fit: RegressionFit,
    projected: PartialledRegression,
    colour: Autocorrelation,
    noise: SharedNoise,
) -> Float[np.ndarray, " r"]:
    """The largest score of any candidate in each noise-only replicate of this colour."""
    noises = without_active(state, fit, colour.coloured(noise.replicates, state.folds, len(state.residual)))
    return projected.largest(noises, autocorrelations_of(noises, state.folds))


def explained_shares(
    state: SelectionState, fit: RegressionFit, colour: Autocorrelation, seed: int, count: int
) -> Float[np.ndarray, " r"]:
    """Largest share of one output's variance that any block, acting on one output, explains in each noise record."""
    projected = PartialledRegression(state, fit, [block[1] for block in state.blocks])
    output = [int(np.argmax(np.abs(state.S[:, :, block[1]]).sum(axis=(0, 2)))) for block in state.blocks]
    drawn = colour.simulate(count, state.folds, len(state.residual), np.random.default_rng(seed))
    noises = without_active(state, fit, drawn)
    total, right = np.sum(noises**2, axis=1) / fit.variance, projected.right(noises)
    shares = [
        np.einsum("ri,ij,rj->r", right[:, place], bread, right[:, place], optimize=True) / total[:, c]
        for place, bread, c in zip(projected.place, projected.bread, output, strict=True)
    ]
    return np.max(shares, axis=0)


def without_active(
    state: SelectionState, fit: RegressionFit, residual: Float[np.ndarray, "*r m c"]
) -> Float[np.ndarray, "*r m c"]:
    """What is left of noise records when the active columns are fitted to them."""
    B = state.scaled[:, :, fit.columns]
    step = np.tensordot(residual, B / fit.variance[:, None], 2) @ inverse(fit.normal)
    return residual - np.tensordot(step, B, (-1, 2))


def _gains(state: SelectionState, fit: RegressionFit, blocks: Sequence[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Deviance that each block takes away, and its steps; short blocks are filled up with the column of zeros."""
    columns, dummy, width = state.columns(), state.S.shape[2] - 1, max(len(own) for own in blocks)
    rows = np.array([np.concatenate([columns, own, np.full(width - len(own), dummy)]) for own in blocks], int)
    step, _, _, deviance = state.products.fit_many(rows, state.mean, state.precision)
    return fit.deviance - deviance, step[:, len(columns) :]


def log_bayes(estimate: np.ndarray, covariance: np.ndarray, mean: np.ndarray, precision: np.ndarray) -> float:
    """log N(estimate; mean, covariance + prior) - log N(estimate; 0, covariance)."""

    def log_normal(x: np.ndarray, covariance: np.ndarray) -> float:
        size = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
        _, determinant = np.linalg.slogdet(covariance / np.outer(size, size) + 1e-11 * np.eye(len(x)))
        return -0.5 * (x @ inverse(covariance) @ x + determinant) - np.sum(np.log(size))

    wide = covariance + np.diag(1.0 / np.maximum(precision, 1e-30))
    return float(log_normal(estimate - mean, wide) - log_normal(estimate, covariance))


def uncertainty(
    state: SelectionState, fit: RegressionFit, colour: Autocorrelation | None = None
) -> Float[np.ndarray, "k k"]:
    """Covariance of the active columns' estimates that coloured residuals leave (default colour: that of the fit)."""
    colour = colour or autocorrelation_of(state.left(fit), state.folds)
    bread = inverse(fit.normal)
    return bread @ colour.meat(state.scaled[:, :, fit.columns], fit.variance, state.folds) @ bread


def block_jackknife_covariance(
    state: SelectionState, fit: RegressionFit
) -> tuple[Int[np.ndarray, " k"], Float[np.ndarray, "k k"]]:
    """Active columns but those with which windows begin, and the covariance of their estimates from how far these move
    when a part of the flights is left out (see `jackknife_covariance`)."""
    stretch = state.responses.jackknife_blocks
    assert stretch is not None
    columns, weight = fit.columns[~np.isin(fit.columns, state.begins)], 1.0 / fit.variance
    left = state.left(fit)
    parts = []  # information of each stretch on these columns, its beginning free, and what it adds to the right side
    for k in range(int(stretch.max()) + 1):
        here = (stretch == k) & state.inside
        S, begin = state.scaled[here][:, :, columns], state.scaled[here][:, :, state.begins]
        S = partialled(S, begin[:, :, np.any(begin != 0.0, axis=(0, 1))], weight)
        right = np.einsum("mci,c,mc->i", S, weight, left[here])
        parts.append((np.einsum("mci,c,mcj->ij", S, weight, S), right))
    whole = sum(information for information, _ in parts) + np.diag(state.precision[columns])
    moves = np.array([inverse(whole - information) @ right for information, right in parts])
    return columns, jackknife_covariance(moves)


# --- A candidate judged under the colour that is left once it is in.
# With the candidate out, slow structure that it explains passes for slow noise, under which anything goes: one
# manoeuvre has few independent swings to tell the two apart. With it in, the noise looks faster than it is, more so
# for the best of many candidates. The noise-only replicates make the same choice and pay the same price.


class RefitScore:
    """One candidate's score, log Bayes factor and p-value under its own colour."""

    def __init__(self, state: SelectionState, standing: CandidateScore, noise: SharedNoise) -> None:
        wider = state.fit_columns(state.wider(standing.columns))
        self.state = state
        self.fit = state.fit_columns(state.columns(), held=wider.variance)
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
