"""Parameters of the effects that are in, fitted to the residuals of any folds by Gauss-Newton."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Int

from bayes_aero.diagnosis.screening.regression import Fit, Products
from bayes_aero.diagnosis.screening.selection_state import SelectionState, moved

REFITS = 8
ENOUGH = 0.05  # of the deviance


def refitted(state: SelectionState) -> tuple[SelectionState, Fit]:
    """The state at the optimum of all active parameters, and the fit there."""
    state = moved(state, optimum(state, range(len(state.folds))))
    return state, state.fit()


def optimum(state: SelectionState, folds: Sequence[int], most: int = REFITS) -> Float[np.ndarray, " k"]:
    """Gauss-Newton on all active parameters, fitted to the chosen folds, each step kept inside the bounds.

    A step that does not lower the deviance is shortened. The last step is one that would gain less than `ENOUGH`.
    """
    bounds = np.array([p.bounds for p in state.full.model.free])
    columns = state.columns()
    at = columns[columns < len(state.theta)]

    def stepped(share: float) -> Float[np.ndarray, " k"]:
        after = theta.copy()
        after[at] = np.clip(theta[at] + share * fit.step[: len(at)], bounds[at, 0] + 1e-9, bounds[at, 1] - 1e-9)
        return after

    theta, (fit, value) = state.theta, _fit_at(state, state.theta, at, folds, (state.residual, state.S[:, :, at]))
    for number in range(most):
        if number:
            fit, value = local_fit(state, theta, at, folds)
        if value - fit.deviance < ENOUGH:
            return stepped(1.0)
        for share in (1.0, 0.5, 0.2, 0.05):
            trial = stepped(share)
            lower = _deviance_at(state, trial, at, folds)  # of many trials, few are steps and need derivatives
            if lower < value:
                break
        else:
            break
        theta = trial
        if value - lower < ENOUGH:
            break
    return theta


def _deviance_at(
    state: SelectionState, theta: Float[np.ndarray, " k"], at: Int[np.ndarray, " a"], folds: Sequence[int]
) -> float:
    """The deviance of `local_fit` without its regression, from the residuals alone."""
    keep = [state.responses.outputs.index(name) for name in state.outputs]
    residual = np.asarray(state.responses.evaluate(theta)[0])[:, keep]
    none = np.arange(0)
    mean, precision = state.full.prior(at, theta)
    prior = state.variance_inflation * float(np.sum(precision * mean**2))
    return _fit_at(state, theta, none, folds, (residual, state.S[:, :, none]))[1] + prior


def local_fit(
    state: SelectionState,
    theta: Float[np.ndarray, " k"],
    at: Int[np.ndarray, " a"],
    folds: Sequence[int],
    held: Float[np.ndarray, " c"] | None = None,
) -> tuple[Fit, float]:
    """Regression on the columns `at` at `theta`, and the deviance there; with variances it finds, or `held` ones."""
    keep = [state.responses.outputs.index(name) for name in state.outputs]
    residual, S = state.responses.linearise(theta, at)
    return _fit_at(state, theta, at, folds, (residual[:, keep], np.where(np.isfinite(S), S, 0.0)[:, keep]), held)


def _fit_at(
    state: SelectionState,
    theta: Float[np.ndarray, " k"],
    at: Int[np.ndarray, " a"],
    folds: Sequence[int],
    linear: tuple[Float[np.ndarray, "m c"], Float[np.ndarray, "m c a"]],
    held: Float[np.ndarray, " c"] | None = None,
) -> tuple[Fit, float]:
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
