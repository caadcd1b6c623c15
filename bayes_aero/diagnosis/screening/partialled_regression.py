"""Candidates with the model projected out: what each would explain, how sure that is, and how far two are apart."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Int
from scipy.special import chdtrc, ndtr, ndtri, stdtr

from bayes_aero.diagnosis.screening.autocorrelation import Autocorrelation, Middle
from bayes_aero.diagnosis.screening.regression import TINY, Fit, inverse
from bayes_aero.diagnosis.screening.selection_state import SelectionState
from bayes_aero.inference.variance.block_jackknife import cluster_covariance
from bayes_aero.inference.variance.variance_inflation import variance_inflation


class PartialledRegression:
    """Candidate columns with the active ones projected out, under the variances of the present fit."""

    def __init__(self, state: SelectionState, fit: Fit, blocks: Sequence[np.ndarray]) -> None:
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

    def scores(
        self, residual: Float[np.ndarray, "m c"], colour: Autocorrelation
    ) -> tuple[list[np.ndarray], list[np.ndarray]]:
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

    def largest(
        self, noises: Float[np.ndarray, "r m c"], colours: Sequence[Autocorrelation]
    ) -> Float[np.ndarray, " r"]:
        """The largest score that any block reaches in each of r records."""
        alone = np.array([place[0] for place in self.place if len(place) == 1], int)
        wide = [j for j, place in enumerate(self.place) if len(place) > 1]
        right = self.right(noises)
        diagonal, whole = self.middle.under_each(colours, wide)
        # Of a single parameter the information cancels.
        scores = np.abs(right[:, alone]) / np.sqrt(np.maximum(diagonal[:, alone], TINY))
        best = np.max(scores, axis=1, initial=0.0)
        for j, meats in zip(wide, whole, strict=True):
            bread, own = self.bread[j], right[:, self.place[j]]
            each = [equivalent(bread @ r, bread @ meat @ bread) for r, meat in zip(own, meats, strict=True)]
            best = np.maximum(best, each)
        return best

    def between(
        self, residual: Float[np.ndarray, "m c"], estimates: Sequence[np.ndarray], stretch: Int[np.ndarray, " m"]
    ) -> list[np.ndarray]:
        """Covariance of each block's estimate from how far the stretches disagree about it, whatever the colour within.

        See `cluster_covariance`; the estimate itself is taken out.
        """
        found = []
        for place, bread, estimate in zip(self.place, self.bread, estimates, strict=True):
            P = self.P[:, :, place]
            rows = np.einsum("mci,c,mc->mi", P, self.weight, residual - P @ estimate, optimize=True)
            found.append(bread @ cluster_covariance(rows, stretch) @ bread)
        return found

    def apart(
        self,
        residual: Float[np.ndarray, "m c"],
        estimates: Sequence[np.ndarray],
        own: int,
        colour: Autocorrelation,
        stretch: Int[np.ndarray, " m"] | None,
    ) -> Float[np.ndarray, " j"]:
        """Variance inflation along the difference of what each block and block `own` explain (1 for `own`).

        Under the colour, or by how far the stretches disagree where that is more.
        """
        explained = [self.P[:, :, place] @ estimate for place, estimate in zip(self.place, estimates, strict=True)]
        D = np.stack([part - explained[own] for part in explained], axis=2)
        rows = None
        if stretch is not None:
            rows = np.einsum("mcj,c,mc->mj", D, self.weight, residual - explained[own], optimize=True)
        disagreement = None if rows is None or stretch is None else np.diag(cluster_covariance(rows, stretch))
        return inflation_along(D, self.weight, self.folds, colour, disagreement)


def inflation_along(
    D: Float[np.ndarray, "m c j"],
    weight: Float[np.ndarray, " c"],
    folds: Sequence[slice],
    colour: Autocorrelation,
    least: Float[np.ndarray, " j"] | None = None,
) -> Float[np.ndarray, " j"]:
    """Variance inflation along each of j directions under a colour; variances are no less than `least`."""
    variance, _ = Middle(D, 1.0 / weight, folds, []).under(colour, [])
    white = np.einsum("mcj,c,mcj->j", D, weight, D, optimize=True)
    return variance_inflation(variance if least is None else np.maximum(variance, least), white)


def score(estimate: np.ndarray, covariance: np.ndarray, freedom: int) -> float:
    score = equivalent(estimate, covariance)
    return as_normal(score, freedom) if freedom else score


def as_normal(score: float, freedom: int) -> float:
    """Student's score as the normal one of the same tail probability."""
    return -float(ndtri(max(stdtr(freedom, -score), 1e-300)))


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
