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
from scipy import stats

from bayes_aero.criticism.colour import Colour, Middle, colour_of, colours_of, unbiased
from bayes_aero.criticism.regression import TINY, Fit, inverse
from bayes_aero.criticism.state import State

REPLICATES = 200  # noise-only replicates behind every p-value
CORRECTION = 40  # replicates that measure the bias of the colour's estimate


@dataclass(frozen=True)
class Standing:
    """One candidate against the present model.

    `gain` is the deviance it takes away, `together` what it would take away if the outputs' noise were allowed to
    correlate; `score` its estimate in standard deviations that know the colour (for several
    parameters the equivalent of one); `inflation` the variance over what white residuals would leave; `log_bayes` the
    log Bayes factor of estimate and deviation under the effect's prior. `apart` is the inflation along the difference
    between what it explains and what the addition explains that was taken out (see `poll`).
    """

    effect: str
    columns: tuple[int, ...]
    value: float | None
    gain: float
    score: float
    inflation: float
    log_bayes: float
    step: tuple[float, ...]
    sd: tuple[float, ...]
    together: float = math.nan
    apart: float = math.nan

    def nats(self, other: Standing) -> float:
        """Log likelihood by which this addition, which was taken out, explains more than `other`.

        What tells the two from each other is the residual along the difference d of what they explain. Its variance
        is d'Sd where white residuals would leave s2 d'd: the log likelihood ratio is the white one over that inflation.
        """
        return (self.gain - other.gain) / other.cost_apart

    @property
    def cost_apart(self) -> float:
        """Deviance that a nat costs where this is weighed against the addition that was taken out."""
        return 2.0 * max(self.apart, 1.0)


@dataclass(frozen=True)
class Poll:
    """Standings, the most explaining first, and the largest score of each noise-only replicate."""

    standings: tuple[Standing, ...]
    colour: Colour
    nulls: Float[np.ndarray, " r"]

    def p_value(self, score: float) -> float:
        """Share of noise-only replicates in which some candidate scores at least as high."""
        return float((1 + np.sum(self.nulls >= score)) / (1 + len(self.nulls)))

    def of(self, effect: str) -> Standing | None:
        """The best standing of one effect."""
        return next((s for s in self.standings if s.effect == effect), None)


class Projected:
    """Candidate columns with the active ones projected out, under the variances of the present fit."""

    def __init__(self, state: State, fit: Fit, blocks: Sequence[np.ndarray]) -> None:
        self.wanted = np.unique(np.concatenate(blocks))
        self.place = [np.searchsorted(self.wanted, block) for block in blocks]
        S, base, weight = state.scaled, fit.columns, 1.0 / fit.variance
        self.inside = state.inside
        A, B = (np.where(self.inside[:, None, None], S[:, :, own], 0.0) for own in (self.wanted, base))
        cross = np.einsum("mcb,c,mcj->bj", B, weight, A, optimize=True)
        self.P = A - np.einsum("mcb,bj->mcj", B, inverse(fit.normal) @ cross, optimize=True)
        self.information = np.einsum("mci,c,mcj->ij", self.P, weight, self.P, optimize=True)
        self.bread = [inverse(self.information[np.ix_(place, place)]) for place in self.place]
        self.weight = weight
        self.folds = state.folds
        self.middle = Middle(self.P, fit.variance, state.folds, self.place)

    def right(self, residual: Float[np.ndarray, "*r m c"]) -> Float[np.ndarray, "*r w"]:
        """Right sides of the normal equations of any number of records."""
        return np.tensordot(residual * self.weight, self.P, 2)

    def scores(self, residual: Float[np.ndarray, "m c"], colour: Colour) -> tuple[list[np.ndarray], list[np.ndarray]]:
        """First-order estimate and its covariance for each block."""
        right = self.right(residual)
        _, whole = self.middle.under(colour, range(len(self.place)))
        estimates = [bread @ right[place] for bread, place in zip(self.bread, self.place, strict=True)]
        return estimates, [bread @ meat @ bread for bread, meat in zip(self.bread, whole, strict=True)]

    def deviance(
        self, residual: Float[np.ndarray, "m c"], block: int | None = None, estimate: np.ndarray | float = 0.0
    ) -> float:
        """n log det of the whole covariance of what a block leaves at its first-order estimate.

        It stays the same when an output is exchanged for its sum with a share of another; the product of the
        variances does not.
        """
        left = residual if block is None else residual - self.P[:, :, self.place[block]] @ estimate
        left = left[self.inside]
        return float(len(left) * np.linalg.slogdet(left.T @ left / len(left))[1])

    def largest(self, noises: Float[np.ndarray, "r m c"], colours: Sequence[Colour]) -> Float[np.ndarray, " r"]:
        """The largest score that any block reaches in each of r records."""
        alone = np.array([place[0] for place in self.place if len(place) == 1], int)
        wide = [j for j, place in enumerate(self.place) if len(place) > 1]
        found = []
        for right, colour in zip(self.right(noises), colours, strict=True):
            diagonal, whole = self.middle.under(colour, wide)
            # Of a single parameter the information cancels.
            best = float(np.max(np.abs(right[alone]) / np.sqrt(np.maximum(diagonal[alone], TINY)), initial=0.0))
            for j, meat in zip(wide, whole, strict=True):
                bread = self.bread[j]
                best = max(best, equivalent(bread @ right[self.place[j]], bread @ meat @ bread))
            found.append(best)
        return np.array(found)

    def between(
        self, residual: Float[np.ndarray, "m c"], estimates: Sequence[np.ndarray], stretch: Int[np.ndarray, " m"]
    ) -> list[np.ndarray]:
        """Covariance of each block's estimate from how far the stretches disagree about it, whatever the colour within.

        Cluster-robust (Liang and Zeger 1986, Biometrika 73, 13), with the estimate itself taken out.
        """
        found = []
        for place, bread, estimate in zip(self.place, self.bread, estimates, strict=True):
            P = self.P[:, :, place]
            rows = np.einsum("mci,c,mc->mi", P, self.weight, residual - P @ estimate, optimize=True)
            found.append(bread @ disagreement(rows, stretch) @ bread)
        return found

    def apart(
        self,
        residual: Float[np.ndarray, "m c"],
        estimates: Sequence[np.ndarray],
        own: int,
        colour: Colour,
        stretch: Int[np.ndarray, " m"] | None,
    ) -> Float[np.ndarray, " j"]:
        """Inflation of the variance along the difference of what each block and block `own` explain (1 for `own`).

        Under the colour, or by how far the stretches disagree where that is more.
        """
        explained = [self.P[:, :, place] @ estimate for place, estimate in zip(self.place, estimates, strict=True)]
        D = np.stack([part - explained[own] for part in explained], axis=2)
        variance, _ = Middle(D, 1.0 / self.weight, self.folds, []).under(colour, [])
        if stretch is not None:
            rows = np.einsum("mcj,c,mc->mj", D, self.weight, residual - explained[own], optimize=True)
            variance = np.maximum(variance, np.diag(disagreement(rows, stretch)))
        white = np.einsum("mcj,c,mcj->j", D, self.weight, D, optimize=True)
        return np.where(white > 0.0, variance / np.maximum(white, TINY), 1.0)


def disagreement(rows: Float[np.ndarray, "m k"], stretch: Int[np.ndarray, " m"]) -> Float[np.ndarray, "k k"]:
    """Sum over stretches of the outer products of what each contributes to the normal equations."""
    count = int(stretch.max()) + 1
    sums = np.zeros((count, rows.shape[1]))
    np.add.at(sums, stretch, rows)
    return sums.T @ sums * count / (count - 1.0)


def _score(estimate: np.ndarray, covariance: np.ndarray, freedom: int) -> float:
    score = equivalent(estimate, covariance)
    return as_normal(score, freedom) if freedom else score


def as_normal(score: float, freedom: int) -> float:
    """Student's score as the normal one of the same tail probability."""
    return float(stats.norm.isf(max(stats.t.sf(score, freedom), 1e-300)))


def equivalent(estimate: np.ndarray, covariance: np.ndarray) -> float:
    """Wald statistic as the standard score of one parameter with the same tail probability."""
    if len(estimate) == 1:
        return abs(float(estimate[0])) / math.sqrt(max(float(covariance[0, 0]), 1e-300))
    wald = float(estimate @ inverse(covariance) @ estimate)
    tail = stats.chi2.logsf(wald, len(estimate))
    return float(stats.norm.isf(math.exp(max(tail, -700.0)) / 2.0)) if tail < 0.0 else 0.0


def poll(state: State, fit: Fit, *, seed: int, replicates: int = REPLICATES, without: str | None = None) -> Poll:
    """Fit every candidate with all active parameters free; draw noise-only replicates under the present model.

    `without` takes one addition out first, to first order: it then stands for election like the others, and each of
    them is told `apart` from it.
    """
    products, mean, columns = state.products, state.mean, state.columns()
    residual = state.left(fit)
    active = tuple(e for e in state.active if e != without)
    if without is not None:
        names = state.field.parameters_of(without)
        own = state.field.columns(names)
        neutral = np.array([state.field.neutral[name] for name in names])
        products = products.shifted(own, neutral - state.theta[own])
        mean = mean.copy()
        mean[own] += state.theta[own] - neutral
        columns = state.columns(active)
        shifted = products.fit(columns, mean, state.precision)
        residual = residual + state.scaled[:, :, own] @ (state.theta[own] - neutral)
        residual = residual - state.scaled[:, :, columns] @ shifted.step + state.scaled[:, :, fit.columns] @ fit.step
        fit = shifted
    blocks = [b for b in state.blocks if b[0] not in active]
    if not blocks:
        return Poll((), colour_of(residual, state.folds), np.zeros(0))
    projected = Projected(state, fit, [b[1] for b in blocks])
    colour = colour_of(residual, state.folds)
    rng = np.random.default_rng(seed)
    m = len(residual)
    # Re-estimation from noise whose active columns were fitted shows how much faster the noise then looks.
    drawn = colour.simulate(CORRECTION, state.folds, m, rng)
    colour = unbiased(colour, colours_of(without_active(state, fit, drawn), state.folds))
    estimates, covariances = projected.scores(residual, colour)
    stretch = state.responses.stretch
    freedom = 0 if stretch is None else int(stretch.max())
    if stretch is not None:
        wider = projected.between(residual, estimates, stretch)
        pairs = zip(estimates, covariances, wider, strict=True)
        covariances = [C if equivalent(b, C) < equivalent(b, W) else W for b, C, W in pairs]
    gains = _gains(state, products, mean, columns, [b[1] for b in blocks], fit)
    before = projected.deviance(residual)
    away = _most(blocks, gains[0], without)
    apart = None if away is None else projected.apart(residual, estimates, away, colour, stretch)
    found = []
    for j, (effect, own, value) in enumerate(blocks):
        variance = np.maximum(np.diag(covariances[j]), 0.0)
        white = np.diag(projected.bread[j])
        step = gains[1][j][: len(own)]
        possible = value is None or step[0] * (value - _present(state, effect)) > 0.0
        found.append(
            Standing(
                effect=effect,
                columns=tuple(int(i) for i in own),
                value=value,
                gain=float(gains[0][j]) if possible else 0.0,
                score=_score(estimates[j], covariances[j], freedom) if possible else 0.0,
                inflation=float(np.max(variance / white)),
                log_bayes=log_bayes(estimates[j], covariances[j], mean[own], state.precision[own] / state.temper),
                step=tuple(float(x) for x in step),
                sd=tuple(float(x) for x in np.sqrt(variance)),
                together=before - projected.deviance(residual, j, estimates[j]),
                apart=math.nan if apart is None else float(apart[j]),
            )
        )
    noises = without_active(state, fit, colour.simulate(replicates, state.folds, m, rng))
    nulls = projected.largest(noises, colours_of(noises, state.folds))
    return Poll(tuple(sorted(found, key=lambda s: -s.gain)), colour, nulls)


def explained_shares(state: State, fit: Fit, colour: Colour, seed: int, count: int) -> Float[np.ndarray, " r"]:
    """Largest share of one output's variance that any block explains in each of `count` noise records of this colour.

    Blocks must act on one output each, as components do.
    """
    projected = Projected(state, fit, [block[1] for block in state.blocks])
    output = [int(np.argmax(np.abs(state.S[:, :, block[1]]).sum(axis=(0, 2)))) for block in state.blocks]
    drawn = colour.simulate(count, state.folds, len(state.residual), np.random.default_rng(seed))
    noises = without_active(state, fit, drawn)
    total, right = np.sum(noises**2, axis=1) / fit.variance, projected.right(noises)
    shares = [
        np.einsum("ri,ij,rj->r", right[:, place], bread, right[:, place], optimize=True) / total[:, c]
        for place, bread, c in zip(projected.place, projected.bread, output, strict=True)
    ]
    return np.max(shares, axis=0)


def without_active(state: State, fit: Fit, residual: Float[np.ndarray, "*r m c"]) -> Float[np.ndarray, "*r m c"]:
    """What is left of noise records when the active columns are fitted to them."""
    B = state.scaled[:, :, fit.columns]
    step = np.tensordot(residual, B / fit.variance[:, None], 2) @ inverse(fit.normal)
    return residual - np.tensordot(step, B, (-1, 2))


def _most(blocks: Sequence[tuple], gains: Float[np.ndarray, " j"], effect: str | None) -> int | None:
    """The block of an effect that gains most; None where it has none."""
    own = [j for j, block in enumerate(blocks) if block[0] == effect]
    return max(own, key=lambda j: gains[j], default=None)


def _gains(
    state: State, products, mean: np.ndarray, columns: np.ndarray, blocks: Sequence[np.ndarray], fit: Fit
) -> tuple[np.ndarray, np.ndarray]:
    """Deviance that each block takes away, and its steps; short blocks are filled up with the column of zeros."""
    dummy = state.S.shape[2] - 1
    width = max(len(own) for own in blocks)
    rows = np.array([np.concatenate([columns, own, np.full(width - len(own), dummy)]) for own in blocks], int)
    step, _, _, deviance = products.fit_many(rows, mean, state.precision)
    return fit.deviance - deviance, step[:, len(columns) :]


def log_bayes(estimate: np.ndarray, covariance: np.ndarray, mean: np.ndarray, precision: np.ndarray) -> float:
    """log N(estimate; mean, covariance + prior) - log N(estimate; 0, covariance)."""
    wide = covariance + np.diag(1.0 / np.maximum(precision, 1e-30))
    return float(_log_normal(estimate - mean, wide) - _log_normal(estimate, covariance))


def _log_normal(x: np.ndarray, covariance: np.ndarray) -> float:
    size = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    _, determinant = np.linalg.slogdet(covariance / np.outer(size, size) + 1e-11 * np.eye(len(x)))
    return -0.5 * (x @ inverse(covariance) @ x + determinant) - np.sum(np.log(size))


def _present(state: State, effect: str) -> float:
    """Value of a scanned effect's parameter at the state."""
    scan = next(s for s in state.scans if s.effect == effect)
    return float(state.theta[state.field.columns([scan.parameter])[0]])


def uncertainty(state: State, fit: Fit, colour: Colour) -> Float[np.ndarray, "k k"]:
    """Covariance of the active columns' estimates that coloured residuals leave."""
    bread = inverse(fit.normal)
    return bread @ colour.meat(state.scaled[:, :, fit.columns], fit.variance, state.folds) @ bread


def between_stretches(state: State, fit: Fit) -> Float[np.ndarray, "k k"]:
    """Covariance of the active columns' estimates from how far the stretches disagree (see `Projected.between`)."""
    stretch = state.responses.stretch
    assert stretch is not None
    left = np.where(state.inside[:, None], state.left(fit), 0.0)
    rows = np.einsum("mci,c,mc->mi", state.scaled[:, :, fit.columns], 1.0 / fit.variance, left, optimize=True)
    bread = inverse(fit.normal)
    return bread @ disagreement(rows, stretch) @ bread


def columns_of(state: State, standing: Standing) -> Int[np.ndarray, " k"]:
    """Active columns and the candidate's."""
    return np.concatenate([state.columns(), np.array(standing.columns, int)])
