"""Maximum likelihood of the 14 parameters: ours and SciPy's, from the card's start.

Ours minimises (n/2) log det R and so finds the residual covariance R, too. The peers have no such cost and are given
the R of the optimum as weights: least squares then have the same optimum. All are judged by (n/2) log det R.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable

import numpy as np
from contender import Problem, stall

Run = Callable[[int], np.ndarray]


def ours(problem: Problem, _: int, __: argparse.Namespace) -> Run:
    """The fit alone."""
    from bayes_aero.inference.mle import descend

    model, observations = stall(problem)
    return lambda _: descend(model, observations, problem.start).theta


def ours_with_bounds(problem: Problem, _: int, __: argparse.Namespace) -> Run:
    """As a user calls it: with Cramer-Rao bounds and those corrected for colour."""
    from bayes_aero.inference.mle import fit_mle

    model, observations = stall(problem)
    return lambda _: fit_mle(model, observations, extra_starts=0).estimate


def residual_of(problem: Problem) -> Callable[[np.ndarray], np.ndarray]:
    """Weighted residuals (3 n,)."""
    reference, weight = problem.reference, 1.0 / np.sqrt(problem.R)[:, None]
    return lambda theta: (weight * (reference.measured - reference(theta))).ravel()


def scipy_with(**how: str) -> Callable[[Problem, int, argparse.Namespace], Run]:
    """scipy.optimize.least_squares with its defaults otherwise."""

    def prepared(problem: Problem, _: int, __: argparse.Namespace) -> Run:
        from scipy.optimize import least_squares

        residual = residual_of(problem)
        return lambda _: least_squares(residual, problem.start, x_scale="jac", **how).x

    return prepared


def judge(problem: Problem, _: int, warm: list[tuple[float, np.ndarray]]) -> dict[str, float]:
    """The cost reached, nats."""
    reference, theta = problem.reference, warm[-1][1]
    R = np.mean((reference.measured - reference(theta)) ** 2, axis=1)
    return {"cost": float(0.5 * reference.measured.shape[1] * np.sum(np.log(R)))}


CONTENDERS = {
    "bayes_aero": ours,
    "bayes_aero, with both bounds": ours_with_bounds,
    "scipy least_squares, trf": scipy_with(method="trf"),
    "scipy least_squares, lm": scipy_with(method="lm"),
}
