"""Parameters fitted to the residuals of any folds by Gauss-Newton; regressions with other columns projected out."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Int
from scipy.special import chdtrc, ndtr, ndtri, stdtr

from bayes_aero.diagnosis.screening.autocorrelation import Autocorrelation, Middle, autocorrelation_of
from bayes_aero.diagnosis.screening.regression import TINY, Products, RegressionFit, inverse
from bayes_aero.diagnosis.screening.selection_state import SelectionState, moved
from bayes_aero.inference.covariance import ORDER, cluster_covariance, variance_inflation

REFITS = 8
ENOUGH = 0.05  # of the deviance


def refitted(state: SelectionState) -> tuple[SelectionState, RegressionFit]:
    """The state at the optimum of all active parameters, and the fit there."""
    state = moved(state, optimum(state, range(len(state.folds))))
    return state, state.fit()


def optimum(state: SelectionState, folds: Sequence[int], most: int = REFITS) -> Float[np.ndarray, " k"]:
    """Gauss-Newton on all active parameters, fitted to the chosen folds, each step kept inside the bounds."""
    bounds = np.array([p.bounds for p in state.full.model.free])
    columns = state.columns()
    at = columns[columns < len(state.theta)]

    def stepped(share: float) -> Float[np.ndarray, " k"]:
        after = theta.copy()
        after[at] = np.clip(theta[at] + share * fit.step[: len(at)], bounds[at, 0] + 1e-9, bounds[at, 1] - 1e-9)
        return after

    def deviance_at(theta: Float[np.ndarray, " k"]) -> float:
        """The deviance of `local_fit` without its regression, from the residuals alone."""
        residual = np.asarray(state.responses.evaluate(theta)[0])[:, state.kept_outputs]
        none = np.arange(0)
        mean, precision = state.full.prior(at, theta)
        prior = state.variance_inflation * float(np.sum(precision * mean**2))
        return _fit_at(state, theta, none, folds, (residual, state.S[:, :, none]))[1] + prior

    theta, (fit, value) = state.theta, _fit_at(state, state.theta, at, folds, (state.residual, state.S[:, :, at]))
    # A step that does not lower the deviance is shortened. The last step is one that would gain less than `ENOUGH`.
    for number in range(most):
        if number:
            fit, value = local_fit(state, theta, at, folds)
        if value - fit.deviance < ENOUGH:
            return stepped(1.0)
        for share in (1.0, 0.5, 0.2, 0.05):
            trial = stepped(share)
            lower = deviance_at(trial)  # of many trials, few are steps and need derivatives
            if lower < value:
                break
        else:
            break
        theta = trial
        if value - lower < ENOUGH:
            break
    return theta


def local_fit(
    state: SelectionState,
    theta: Float[np.ndarray, " k"],
    at: Int[np.ndarray, " a"],
    folds: Sequence[int],
    held: Float[np.ndarray, " c"] | None = None,
) -> tuple[RegressionFit, float]:
    """Regression on the columns `at` at `theta`, and the deviance there; with variances it finds, or `held` ones."""
    residual, S = (x[:, state.kept_outputs] for x in state.responses.linearise(theta, at))
    return _fit_at(state, theta, at, folds, (residual, np.where(np.isfinite(S), S, 0.0)), held)


def _fit_at(
    state: SelectionState,
    theta: Float[np.ndarray, " k"],
    at: Int[np.ndarray, " a"],
    folds: Sequence[int],
    linear: tuple[Float[np.ndarray, "m c"], Float[np.ndarray, "m c a"]],
    held: Float[np.ndarray, " c"] | None = None,
) -> tuple[RegressionFit, float]:
    """The same from residuals at `theta` and sensitivities to the columns `at` (`linear`)."""
    residual, S = linear
    beside = state.columns()
    beside = beside[beside >= len(state.theta)]  # offsets, and components that are in
    S = np.concatenate([S, state.S[:, :, beside]], axis=2)
    products = Products.of(
        residual / state.noise_growth, S / state.noise_growth[:, :, None], [state.folds[f] for f in folds]
    )
    mean, precision = state.full.prior(at, theta)
    precision = state.variance_inflation * precision
    mean, precision = np.append(mean, state.mean[beside]), np.append(precision, state.precision[beside])
    free = np.arange(S.shape[2])
    only = products.fit(free[len(at) :], mean, precision)  # parameters as they are; offsets and variances adapt
    return products.fit(free, mean, precision, held), only.deviance + float(
        np.sum(precision[: len(at)] * mean[: len(at)] ** 2)
    )


# --- Candidates with the model projected out: what each would explain, how sure that is, and how far two are apart.


class PartialledRegression:
    """Candidate columns with the active ones projected out, under the variances of the present fit."""

    def __init__(self, state: SelectionState, fit: RegressionFit, blocks: Sequence[np.ndarray]) -> None:
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
        whole = self.middle.under_each([colour], range(len(self.place)))[1]
        estimates = [bread @ right[place] for bread, place in zip(self.bread, self.place, strict=True)]
        return estimates, [bread @ meat[0] @ bread for bread, meat in zip(self.bread, whole, strict=True)]

    def deviance(
        self, residual: Float[np.ndarray, "m c"], block: int | None = None, estimate: np.ndarray | float = 0.0
    ) -> float:
        """n log det of the whole covariance of what a block leaves at its first-order estimate."""
        # It stays the same when an output is exchanged for its sum with a share of another; the product of the
        # variances does not.
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
        """Covariance of each block's estimate from how far the stretches disagree about it, whatever the colour."""
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
        """Variance inflation along the difference of what each block and block `own` explain (1 for `own`)."""
        explained = [self.P[:, :, place] @ estimate for place, estimate in zip(self.place, estimates, strict=True)]
        D = np.stack([part - explained[own] for part in explained], axis=2)
        return inflation_along(D, self.weight, self.folds, colour, residual - explained[own], stretch)


def inflation_along(
    D: Float[np.ndarray, "m c j"],
    weight: Float[np.ndarray, " c"],
    folds: Sequence[slice],
    colour: Autocorrelation,
    left: Float[np.ndarray, "m c"] | None = None,
    stretch: Int[np.ndarray, " m"] | None = None,
) -> Float[np.ndarray, " j"]:
    """Variance inflation along j directions under a colour, or by how far stretches of what is `left` disagree."""
    variance = Middle(D, 1.0 / weight, folds, []).under_each([colour], [])[0][0]
    if stretch is not None and left is not None:
        rows = np.einsum("mcj,c,mc->mj", D, weight, left, optimize=True)
        # where that is more
        variance = np.maximum(variance, np.diag(cluster_covariance(rows, stretch)))
    return variance_inflation(variance, np.einsum("mcj,c,mcj->j", D, weight, D, optimize=True))


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


# --- Noise of coefficients that grows as the flow separates.


def noise_growth_of(state: SelectionState, fit: RegressionFit) -> Float[np.ndarray, "m c"]:
    """Growth of each coefficient's noise with separation, 1 + b (1 - X), b >= 0; flight-path outputs have none."""
    coefficients = state.responses.model.coefficients
    if not set(state.outputs) & set(coefficients):
        return np.ones_like(state.residual)
    _, known = state.responses.evaluate(state.theta)
    apart = 1.0 - np.asarray(state.responses.block(known["X"]))
    residual = state.left(fit) * state.noise_growth
    colour = autocorrelation_of(residual, state.folds)
    noise_growth = np.ones_like(residual)  # b by least squares of |innovation| on 1 - X
    for c, name in enumerate(state.outputs):
        if name not in coefficients or np.ptp(apart) < 0.05:
            continue
        size, x = [], []
        for fold in state.folds:
            r = residual[fold, c]
            past = np.stack([r[ORDER - i : len(r) - i] for i in range(1, ORDER + 1)])
            size.append(np.abs(r[ORDER:] - colour.phi[c] @ past))
            x.append(apart[fold][ORDER:])
        innovation = np.concatenate(size)
        slope, level = np.polyfit(np.concatenate(x), np.minimum(innovation, 10 * np.median(innovation)), 1)
        if level > 0.0:
            noise_growth[:, c] = 1.0 + max(0.0, slope / level) * apart
    return noise_growth
