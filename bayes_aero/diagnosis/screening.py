"""Which candidate explains what the model leaves, and how often noise alone would look as good.

Candidates are ranked by how much of the residual they explain. Whether that is more than chance is judged by the
estimate over a deviation that knows the residual's colour, and the largest such score in noise-only replicates.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float, Int
from scipy.special import chdtrc, ndtr, ndtri, stdtr

from bayes_aero.diagnosis.selection_state import DiagnosisSettings, RegressionFit, SelectionState, inverse, partialled
from bayes_aero.inference.covariance import (
    ORDER,
    autoregression,
    cluster_covariance,
    jackknife_covariance,
    nats,
    shaped_products,
    stationary_coefficients,
    stationary_series,
    variance_inflation,
)

Records = Float[np.ndarray, "r m c"]
White = Float[np.ndarray, "t f r c"]
Vector = Float[np.ndarray, " k"]
Square = Float[np.ndarray, "k k"]
Rows = Float[np.ndarray, "m c"]
Columns = Int[np.ndarray, " k"]
Marks = Int[np.ndarray, " m"]

# --- The colour of residuals: an autoregression per output, the uncertainty it leaves, and noise records made from it.


@dataclass(frozen=True)
class Autocorrelation:
    """r[t] = sum phi_i r[t-i] + e[t], per output; `sigma` (c,) is the deviation of e, `phi` (c, ORDER)."""

    phi: Float[np.ndarray, "c p"]
    sigma: Float[np.ndarray, " c"]

    def coloured(self, white: White, folds: Sequence[slice], m: int) -> Records:
        """The noise records that this colour makes of `white_noise`."""
        out = np.zeros((white.shape[2], m, len(self.sigma)))
        if not len(out):
            return out
        noise = stationary_series(self.phi.T[:, None, None, :], self.sigma * white)
        for k, fold in enumerate(folds):
            out[:, fold] = np.moveaxis(noise[: fold.stop - fold.start, k], 0, 1)
        return out

    def meat(self, S: Float[np.ndarray, "m c k"], variance: Float[np.ndarray, " c"], folds: Sequence[slice]) -> Square:
        """sum_ij S_i' R^-1 Rvv(i-j) R^-1 S_j under this colour: the middle of the corrected covariance."""
        # S filtered backwards by the autoregression gives it as a plain product. Source: as `inference.covariance`.
        return Middle(S, variance, folds, [np.arange(S.shape[2])]).under_each([self], [0])[1][0][0]


def white_noise(count: int, folds: Sequence[slice], outputs: int, rng: np.random.Generator) -> White:
    """Of unit deviation, behind `count` noise records: the folds side by side, for one loop over time."""
    longest = max(fold.stop - fold.start for fold in folds)
    white = np.zeros((longest, len(folds), count, outputs))
    for k, fold in enumerate(folds):
        drawn = rng.standard_normal((count, fold.stop - fold.start, outputs))
        white[: drawn.shape[1], k] = np.moveaxis(drawn, 1, 0)
    return white


class SharedNoise:
    """`white_noise` of one seed, drawn once: behind what corrects autocorrelations, then behind what p-values count."""

    def __init__(self, seed: int, folds: Sequence[slice], outputs: int, settings: DiagnosisSettings) -> None:
        rng = np.random.default_rng(seed)
        self.correction = white_noise(settings.correction_replicates, folds, outputs, rng)
        self._rest = lambda: white_noise(settings.replicates, folds, outputs, rng)

    @cached_property
    def replicates(self) -> White:
        return self._rest()


class Middle:
    """`Autocorrelation.meat` of many sets of columns, each by itself, made ready once for many colours."""

    # The columns of each fold and output, divided by the output's variance, are rows, the last block first.

    def __init__(
        self, S: Float[np.ndarray, "m c k"], variance: np.ndarray, folds: Sequence[slice], places: Sequence[np.ndarray]
    ) -> None:
        self.width, self.places = S.shape[2], places
        pieces = [(S[fold, c], c) for fold in folds for c in range(S.shape[1])]
        used = [np.flatnonzero(np.any(part != 0.0, axis=0)) for part, _ in pieces]  # columns not all zero
        self.pieces = [(c, at, (part[::-1, at] / variance[c]).T) for (part, c), at in zip(pieces, used, strict=True)]

    def under_each(
        self, colours: Sequence[Autocorrelation], wide: Sequence[int]
    ) -> tuple[np.ndarray, list[np.ndarray]]:
        """Under each of r colours, the diagonal over all columns (r, k), and the whole (r, w, w) of sets `wide`."""
        diagonal = np.zeros((len(colours), self.width))
        whole = [np.zeros((len(colours), len(at), len(at))) for at in (self.places[j] for j in wide)]
        phi, sigma = (np.stack([getattr(colour, name) for colour in colours]) for name in ("phi", "sigma"))
        for c, used, rows in self.pieces:
            inside = [np.isin(self.places[j], used) for j in wide]
            sets = [np.searchsorted(used, self.places[j][here]) for j, here in zip(wide, inside, strict=True)]
            pairs = [np.stack([at.repeat(len(at)), np.tile(at, len(at))], axis=1) for at in sets]
            pairs = np.concatenate([np.arange(len(rows))[:, None].repeat(2, axis=1), *pairs])
            products = sigma[:, c, None] ** 2 * shaped_products(phi[:, c], rows, pairs)
            own, *blocks = np.split(products, np.cumsum([len(rows), *(len(at) ** 2 for at in sets)]), axis=1)
            diagonal[:, used] += own
            for total, here, block in zip(whole, inside, blocks, strict=False):
                total[:, np.outer(here, here)] += block
        return diagonal, whole


def autocorrelation_of(residual: Rows, folds: Sequence[slice]) -> Autocorrelation:
    """Least-squares autoregression of each output's residual within folds, its roots kept inside `MAX_ROOT`."""
    return autocorrelations_of(residual[None], folds)[0]


def autocorrelations_of(residuals: Records, folds: Sequence[slice]) -> list[Autocorrelation]:
    outputs = np.moveaxis(residuals, 2, 0)
    each = [autoregression([np.ascontiguousarray(x[:, fold]) for fold in folds]) for x in outputs]
    phi, sigma = (np.stack(parts, axis=1) for parts in zip(*each, strict=True))
    return [Autocorrelation(p, s) for p, s in zip(phi, sigma, strict=True)]


def unbiased(colour: Autocorrelation, again: Sequence[Autocorrelation]) -> Autocorrelation:
    """The colour corrected for what re-estimation on simulated noise does to it (Kilian 1998): it looks faster."""
    # Coefficients are shifted by their mean bias, their roots drawn inside `MAX_ROOT`; sigma is divided by its mean
    # ratio.
    shift = colour.phi - np.mean([c.phi for c in again], axis=0)
    phi = stationary_coefficients(colour.phi + shift)
    ratio = np.mean([c.sigma for c in again], axis=0) / colour.sigma
    return Autocorrelation(phi, colour.sigma / ratio)


def lag1_within(residual: Float[np.ndarray, " n"], manoeuvre: Int[np.ndarray, " n"]) -> float:
    parts = [r - r.mean() for r in (residual[manoeuvre == k] for k in range(int(manoeuvre[-1]) + 1))]
    return float(sum(np.sum(r[1:] * r[:-1]) for r in parts) / sum(np.sum(r**2) for r in parts))


# --- Candidates with the model projected out: what each would explain, how sure that is, and how far two are apart.


class PartialledRegression:
    """Candidate columns with the active ones projected out, under the variances of the present fit."""

    def __init__(self, state: SelectionState, fit: RegressionFit, blocks: Sequence[np.ndarray]) -> None:
        self.state, self.fit, self.weight, wanted = state, fit, 1.0 / fit.variance, np.unique(np.concatenate(blocks))
        self.place = [np.searchsorted(wanted, block) for block in blocks]
        A, B = (np.where(state.inside[:, None, None], state.scaled[:, :, at], 0.0) for at in (wanted, fit.columns))
        cross = np.einsum("mcb,c,mcj->bj", B, self.weight, A, optimize=True)
        self.P = A - np.einsum("mcb,bj->mcj", B, inverse(fit.normal) @ cross, optimize=True)
        self.information = np.einsum("mci,c,mcj->ij", self.P, self.weight, self.P, optimize=True)
        self.bread = [inverse(self.information[np.ix_(place, place)]) for place in self.place]
        self.middle = Middle(self.P, fit.variance, state.folds, self.place)

    def right(self, residual: Float[np.ndarray, "*r m c"]) -> Float[np.ndarray, "*r w"]:
        return np.tensordot(residual * self.weight, self.P, 2)

    def estimates(self, residual: Rows) -> list[np.ndarray]:
        right = self.right(residual)
        return [bread @ right[place] for bread, place in zip(self.bread, self.place, strict=True)]

    def gains(self, right: Float[np.ndarray, "r w"]) -> Float[np.ndarray, "j r"]:
        """What each block takes away of the weighted squares of r records."""
        pairs = zip(self.place, self.bread, strict=True)
        return np.array([np.einsum("ri,ij,rj->r", right[:, p], B, right[:, p], optimize=True) for p, B in pairs])

    def scores(self, residual: Rows, colour: Autocorrelation, stretch: Marks) -> tuple[list[np.ndarray], ...]:
        """Estimates and covariances, by colour, or by how far stretches disagree where that is less sure."""
        whole, estimates = self.middle.under_each([colour], range(len(self.place)))[1], self.estimates(residual)
        covariances = [bread @ meat @ bread for bread, (meat,) in zip(self.bread, whole, strict=True)]
        for j, (place, bread, estimate) in enumerate(zip(self.place, self.bread, estimates, strict=True)):
            if stretch.max():
                P = self.P[:, :, place]
                rows = np.einsum("mci,c,mc->mi", P, self.weight, residual - P @ estimate, optimize=True)
                between = bread @ cluster_covariance(rows, stretch) @ bread
                if not equivalent(estimate, covariances[j]) < equivalent(estimate, between):
                    covariances[j] = between
        return estimates, covariances

    def deviance(self, residual: Rows, block: int = 0, estimate: np.ndarray | None = None) -> float:
        """n log det of the whole covariance of what a block leaves at its first-order estimate."""
        # It stays the same when an output is exchanged for its sum with a share of another; the product of the
        # variances does not.
        left = residual if estimate is None else residual - self.P[:, :, self.place[block]] @ estimate
        left = left[self.state.inside]
        return float(len(left) * np.linalg.slogdet(left.T @ left / len(left))[1])

    def nulls(self, colour: Autocorrelation, white: White) -> Float[np.ndarray, " r"]:
        """The largest score that any block reaches in each noise-only record of this colour."""
        noises = noise_records(self.state, self.fit, colour, white)
        alone = np.array([place[0] for place in self.place if len(place) == 1], int)
        wide = [j for j, place in enumerate(self.place) if len(place) > 1]
        right = self.right(noises)
        diagonal, whole = self.middle.under_each(autocorrelations_of(noises, self.state.folds), wide)
        # Of a single parameter the information cancels.
        scores = np.abs(right[:, alone]) / np.sqrt(np.maximum(diagonal[:, alone], 1e-300))
        best = np.max(scores, axis=1, initial=0.0)
        for j, meats in zip(wide, whole, strict=True):
            bread, rhs = self.bread[j], right[:, self.place[j]]
            each = [equivalent(bread @ r, bread @ meat @ bread) for r, meat in zip(rhs, meats, strict=True)]
            best = np.maximum(best, each)
        return best

    def apart(
        self, residual: Rows, estimates: Sequence[np.ndarray], away: int, colour: Autocorrelation, blocks: Marks
    ) -> Float[np.ndarray, " j"]:
        """Variance inflation along the difference of what each block and block `away` explain (1 for `away`)."""
        pairs = zip(self.place, estimates, strict=True)
        explained = np.stack([self.P[:, :, place] @ estimate for place, estimate in pairs], axis=2)
        D, left = explained - explained[:, :, [away]], (residual - explained[:, :, away], blocks)
        return inflation_along(D, self.weight, self.state.folds, colour, left)


def inflation_along(
    D: Float[np.ndarray, "m c j"],
    weight: Float[np.ndarray, " c"],
    folds: Sequence[slice],
    colour: Autocorrelation,
    left_in_blocks: tuple[Rows, Marks] | None = None,
) -> Float[np.ndarray, " j"]:
    """Variance inflation along j directions: by colour, or by how far blocks of what is left disagree where more."""
    variance = Middle(D, 1.0 / weight, folds, []).under_each([colour], [])[0][0]
    if left_in_blocks is not None and left_in_blocks[1].max():
        rows = np.einsum("mcj,c,mc->mj", D, weight, left_in_blocks[0], optimize=True)
        variance = np.maximum(variance, np.diag(cluster_covariance(rows, left_in_blocks[1])))
    return variance_inflation(variance, np.einsum("mcj,c,mcj->j", D, weight, D, optimize=True))


def as_normal(score: float, freedom: int) -> float:
    """Student's score as the normal one of the same tail probability; itself without degrees of freedom."""
    return score if not freedom else -float(ndtri(max(stdtr(freedom, -score), 1e-300)))


def largest_p_value(estimate: np.ndarray, covariance: np.ndarray, freedom: int, among: int) -> float:
    """p-value of the largest of `among` estimates (Bonferroni), its covariance from `freedom` + 1 blocks."""
    return min(1.0, 2.0 * among * float(ndtr(-as_normal(equivalent(estimate, covariance), freedom))))


def equivalent(estimate: np.ndarray, covariance: np.ndarray) -> float:
    """Wald statistic as the standard score of one parameter with the same tail probability."""
    if len(estimate) == 1:
        return abs(float(estimate[0])) / math.sqrt(max(float(covariance[0, 0]), 1e-300))
    wald = float(estimate @ inverse(covariance) @ estimate)
    tail = float(chdtrc(len(estimate), wald))
    return -float(ndtri(max(tail, 1e-304) / 2.0)) if tail < 1.0 else 0.0


def noise_growth_of(state: SelectionState) -> Rows:
    """Growth of each coefficient's noise with separation, 1 + b (1 - X), b >= 0; flight-path outputs have none."""
    growth, names = np.ones_like(state.residual), state.responses.model.coefficients
    coefficients = [c for c, name in enumerate(state.outputs) if name in names]
    apart = state.responses.separated(state.theta) if coefficients else np.zeros(1)
    if np.ptp(apart) < 0.05:
        return growth
    residual = state.left() * state.noise_growth
    colour = autocorrelation_of(residual, state.folds)
    for c in coefficients:  # b by least squares of |innovation| on 1 - X
        size = []
        for r in (residual[fold, c] for fold in state.folds):
            past = np.stack([r[ORDER - i : len(r) - i] for i in range(1, ORDER + 1)])
            size.append(np.abs(r[ORDER:] - colour.phi[c] @ past))
        x, innovation = np.concatenate([apart[fold][ORDER:] for fold in state.folds]), np.concatenate(size)
        slope, level = np.polyfit(x, np.minimum(innovation, 10 * np.median(innovation)), 1)
        if level > 0.0:
            growth[:, c] = 1.0 + max(0.0, slope / level) * apart
    return growth


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
        return chance_of(score, self.nulls)

    def threshold(self, level: float) -> float:
        """The score above which the p-value is at most `level`; not a number without replicates, or with too few."""
        above = int(level * (1 + len(self.nulls)))
        return float(np.sort(self.nulls)[-above]) if 0 < above <= len(self.nulls) else math.nan

    def of(self, effect: str) -> CandidateScore | None:
        return next((s for s in self.candidate_scores if s.effect == effect), None)


def screen(
    state: SelectionState, *, nulls: bool = False, without: str | None = None, noise: SharedNoise | None = None
) -> ScreeningResult:
    """Fit every candidate beside all active parameters; draw noise-only replicates (`nulls`) under the present model.
    `without` takes one addition out first: it is then a candidate, and the others are told `apart` from it."""
    state = state.wide if without is None else state.wide.without([without])
    fit, residual, blocks = state.best, state.left(), [b for b in state.blocks if b[0] not in state.active]
    colour, stretch = autocorrelation_of(residual, state.folds), state.responses.stretch
    if not blocks:
        return ScreeningResult((), colour, np.zeros(0))
    projected = PartialledRegression(state, fit, [b[1] for b in blocks])
    noise = SharedNoise(0, state.folds, residual.shape[1], state.settings) if noise is None else noise
    # Re-estimation from noise whose active columns were fitted shows how much faster the noise then looks.
    drawn = noise_records(state, fit, colour, noise.correction)
    colour = unbiased(colour, autocorrelations_of(drawn, state.folds))
    estimates, covariances = projected.scores(residual, colour, stretch)
    # The deviance that each block takes away, and its steps; short blocks are filled up with the column of zeros.
    columns, dummy, width = state.columns(), state.S.shape[2] - 1, max(len(block[1]) for block in blocks)
    rows = [np.concatenate([columns, at, np.full(width - len(at), dummy)]) for _, at, _ in blocks]
    steps, _, _, deviances = state.products.fit_many(np.array(rows, int), state.mean, state.precision)
    gains, steps, before = fit.deviance - deviances, steps[:, len(columns) :], projected.deviance(residual)
    scanned, apart = {s.effect: state.theta[state.full.columns([s.parameter])[0]] for s in reversed(state.scans)}, None
    if without is not None and without in {b[0] for b in blocks}:
        away = max((j for j, block in enumerate(blocks) if block[0] == without), key=lambda j: gains[j])
        apart = projected.apart(residual, estimates, away, colour, stretch)
    scores = []
    for j, (effect, at, value) in enumerate(blocks):
        variance = np.maximum(np.diag(covariances[j]), 0.0)
        step, prior = steps[j][: len(at)], state.precision[at] / state.variance_inflation
        possible = value is None or bool(step[0] * (value - scanned[effect]) > 0.0)  # to the side on which it was tried
        score = as_normal(equivalent(estimates[j], covariances[j]), state.responses.freedom)
        scores.append(
            CandidateScore(
                effect=effect,
                columns=tuple(int(i) for i in at),
                value=value,
                gain=float(gains[j]) if possible else 0.0,
                score=score if possible else 0.0,
                variance_inflation=float(np.max(variance_inflation(variance, np.diag(projected.bread[j])))),
                log_bayes=log_bayes(estimates[j], covariances[j], state.mean[at], prior),
                step=tuple(float(x) for x in step),
                sd=tuple(float(x) for x in np.sqrt(variance)),
                together=before - projected.deviance(residual, j, estimates[j]),
                variance_inflation_apart=math.nan if apart is None else float(apart[j]),
            )
        )
    largest = projected.nulls(colour, noise.replicates) if nulls else np.zeros(0)
    return ScreeningResult(tuple(sorted(scores, key=lambda s: -s.gain)), colour, largest)


def null_shares(state: SelectionState, colour: Autocorrelation, variance: np.ndarray, seed: int) -> np.ndarray:
    """Largest share of one output's variance that any block of one output explains in each record of such noise."""
    # Both are what is left with the component in whose share is judged: with it out, structure would pass for slow
    # noise, and noise of the other outputs for a share of it.
    fit, count = state.fit(held=variance), state.settings.unnamed_replicates
    projected = PartialledRegression(state, fit, [block[1] for block in state.blocks])
    output = [int(np.argmax(np.abs(state.S[:, :, block[1]]).sum(axis=(0, 2)))) for block in state.blocks]
    white = white_noise(count, state.folds, len(colour.sigma), np.random.default_rng(seed))
    noises = noise_records(state, fit, colour, white)
    total = np.sum(noises**2, axis=1) / fit.variance
    return np.max(projected.gains(projected.right(noises)) / total[:, output].T, axis=0)


def noise_records(state: SelectionState, fit: RegressionFit, colour: Autocorrelation, white: White) -> Records:
    """What is left of noise records of a colour, made of `white_noise`, when the active columns are fitted to them."""
    residual = colour.coloured(white, state.folds, len(state.residual))
    B = state.scaled[:, :, fit.columns]
    step = np.tensordot(residual, B / fit.variance[:, None], 2) @ inverse(fit.normal)
    return residual - np.tensordot(step, B, (-1, 2))


def chance_of(score: float, nulls: Float[np.ndarray, " r"]) -> float:
    return float((1 + np.sum(nulls >= score)) / (1 + len(nulls)))


def log_bayes(estimate: np.ndarray, covariance: np.ndarray, mean: np.ndarray, precision: np.ndarray) -> float:
    """log N(estimate; mean, covariance + prior) - log N(estimate; 0, covariance)."""

    def log_normal(x: np.ndarray, covariance: np.ndarray) -> float:
        size = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
        _, determinant = np.linalg.slogdet(covariance / np.outer(size, size) + 1e-11 * np.eye(len(x)))
        return -0.5 * (x @ inverse(covariance) @ x + determinant) - np.sum(np.log(size))

    wide = covariance + np.diag(1.0 / np.maximum(precision, 1e-30))
    return float(log_normal(estimate - mean, wide) - log_normal(estimate, covariance))


def uncertainty(state: SelectionState, colour: Autocorrelation | None = None) -> Square:
    """Covariance of the active columns' estimates that coloured residuals leave (default colour: that of the fit)."""
    fit, colour = state.best, colour or autocorrelation_of(state.left(), state.folds)
    bread = inverse(fit.normal)
    return bread @ colour.meat(state.scaled[:, :, fit.columns], fit.variance, state.folds) @ bread


def block_jackknife_covariance(state: SelectionState, fit: RegressionFit) -> tuple[Columns, Square]:
    """Active columns but those with which windows begin, and the covariance of their estimates by the jackknife."""
    columns, weight = fit.columns[~np.isin(fit.columns, state.begins)], 1.0 / fit.variance
    left, blocks, parts = state.left(fit), state.responses.parts, []
    for k in range(int(blocks.max()) + 1):  # information of each, its beginning free, and the right side
        here = (blocks == k) & state.inside
        S, begin = state.scaled[here][:, :, columns], state.scaled[here][:, :, state.begins]
        S = partialled(S, begin[:, :, np.any(begin != 0.0, axis=(0, 1))], weight)
        parts.append((np.einsum("mci,c,mcj->ij", S, weight, S), np.einsum("mci,c,mc->i", S, weight, left[here])))
    whole = sum(information for information, _ in parts) + np.diag(state.precision[columns])
    return columns, jackknife_covariance(np.array([inverse(whole - N) @ right for N, right in parts]))


def jackknife_errors(state: SelectionState, blocks: Marks) -> Vector:
    """Least standard error of each of the active columns, by the jackknife; zero where all is one block."""
    errors = np.zeros(len(state.best.columns))
    if blocks.max():
        columns, covariance = block_jackknife_covariance(state, state.best)
        errors[np.isin(state.best.columns, columns)] = np.sqrt(np.diag(covariance))
    return errors


def jackknife_p_value(state: SelectionState, fit: RegressionFit, columns: Columns, size: Vector, among: int) -> float:
    """p-value of an addition of this `size` by how far it moves without each part, Bonferroni over `among`."""
    fitted, covariance = block_jackknife_covariance(state, fit)
    at = [int(np.flatnonzero(fitted == c)[0]) for c in columns]
    return largest_p_value(size, covariance[np.ix_(at, at)], int(state.responses.parts.max()), among)


# --- A candidate judged under the colour that is left once it is in.
# With the candidate out, slow structure that it explains passes for slow noise, under which anything goes: one
# manoeuvre has few independent swings to tell the two apart. With it in, the noise looks faster than it is, more so
# for the best of many candidates. The noise-only replicates make the same choice and pay the same price.


def refit_p_value(state: SelectionState, standing: CandidateScore, noise: SharedNoise) -> float:
    """How often noise alone scores as high, each record under its own colour; 1 where the score itself is too small."""
    wider = state.fit(state.wider(standing.columns))
    fit, blocks = state.fit(held=wider.variance), [b[1] for b in state.blocks if b[0] not in state.active]
    projected = PartialledRegression(state, fit, blocks)

    def leaders(noises: Records) -> tuple[np.ndarray, list[Autocorrelation]]:
        """The candidate that explains most of each noise record, and the colours of what it leaves."""
        right = projected.right(noises)
        best, left = np.argmax(projected.gains(right), axis=0), []
        for j, noise, r in zip(best, noises, right, strict=True):
            place = projected.place[j]
            left.append(noise - projected.P[:, :, place] @ (projected.bread[j] @ r[place]))
        return best, autocorrelations_of(np.array(left), state.folds)

    def judged(j: int, residuals: np.ndarray, colours: Sequence[Autocorrelation]) -> list[tuple]:
        """Estimates of a candidate in r records and their covariances."""
        bread, P = projected.bread[j], projected.P[:, :, projected.place[j]]
        middle = Middle(P, fit.variance, state.folds, [np.arange(P.shape[2])])
        estimates = np.tensordot(residuals * projected.weight, P, 2) @ bread
        return list(zip(estimates, bread @ middle.under_each(colours, [0])[1][0] @ bread, strict=True))

    first = autocorrelation_of(state.left(wider), state.folds)
    colour = unbiased(first, leaders(noise_records(state, fit, first, noise.correction))[1])
    index, at = next(j for j, c in enumerate(blocks) if tuple(c) == standing.columns), np.array(standing.columns, int)
    ((estimate, covariance),) = judged(index, state.left(fit)[None], [colour])
    score, prior = equivalent(estimate, covariance), state.precision[at] / state.variance_inflation
    if score < state.settings.least_score or log_bayes(estimate, covariance, state.mean[at], prior) <= 0.0:
        return 1.0
    noises = noise_records(state, fit, colour, noise.replicates)
    (best, colours), scores = leaders(noises), np.zeros(len(noises))
    for j in np.unique(best):
        at = np.flatnonzero(best == j)
        scores[at] = [equivalent(*pair) for pair in judged(j, noises[at], [colours[k] for k in at])]
    return chance_of(score, scores)
