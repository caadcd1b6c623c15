"""Fisher scoring with Levenberg-Marquardt damping, step limits and bounds.

Where the noise model is wrong, the expected information is not the curvature of the cost, and its steps may be too long
again and again. Two remedies: the damping follows the ratio of actual to expected gain, and BFGS updates correct the
curvature with the change of the gradient. Source: Nocedal and Wright, *Numerical Optimization*, 2nd ed. 2006, ch. 4, 16
and 18.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float
from scipy.optimize import lsq_linear

from bayes_aero.inference.likelihood.mle import solve

MAX_ITERATIONS, MAX_TRIALS = 60, 12  # steps; dampings tried in one step
FIRST_DAMPING, MIN_DAMPING = 1e-3, 1e-8
POOR_RATIO, POOR_DAMPING = 0.25, 0.1  # ratio of actual to expected gain below which a step was too long; damping then
POWELL_RATIO = 0.2  # least curvature along a step after an update, relative to that before
SINGULAR = 1e-14  # of the largest eigenvalue


class Evaluation(NamedTuple):
    """Cost, gradient (j,) and expected information (j, j) at a point."""

    cost: float
    gradient: Float[np.ndarray, " j"]
    information: Float[np.ndarray, "j j"]


@runtime_checkable
class Problem(Protocol):
    """A cost to be minimised over j variables."""

    @property
    def moving(self) -> Bool[np.ndarray, " j"]:
        """Which variables are estimated; the others are held."""
        ...

    @property
    def bounds(self) -> Float[np.ndarray, "j 2"]:
        """Lower and upper bound of each variable."""
        ...

    @property
    def step_limit(self) -> Float[np.ndarray, " j"]:
        """Largest change of each variable in one step."""
        ...

    def cost(self, point: Float[np.ndarray, " j"]) -> float:
        """The cost at a point."""
        ...


def minimise(
    problem: Problem,
    point: Float[np.ndarray, " j"],
    evaluate: Callable[[np.ndarray], Evaluation],
    tolerance: float,
    *,
    approximate: bool = False,
) -> tuple[Float[np.ndarray, " j"], Evaluation, bool, int]:
    """Minimise the cost until the expected gain of a step is below `tolerance`.

    An approximate gradient cannot correct the curvature, and a step with an actual gain below `tolerance` ends the
    search. Its Newton steps are truncated at their limits: a noise variance that falls together with all other
    variables, far from the minimum, may end at zero, where the cost is flat.

    Args:
        problem: cost, bounds and step limits.
        point: start, (j,).
        evaluate: cost, gradient and information at a point.
        tolerance: gain in cost.
        approximate: whether the gradient of `evaluate` is approximate.

    Returns:
        The last point, its evaluation, whether the search converged, and the number of steps.
    """
    current, cost, damping, steps = evaluate(point), problem.cost(point), FIRST_DAMPING, 0
    moving, converged, curvature = problem.moving, False, current.information
    while steps < MAX_ITERATIONS and math.isfinite(current.cost) and np.all(np.isfinite(curvature)):
        steps += 1
        A, g = curvature[np.ix_(moving, moving)], -current.gradient[moving]
        limits = np.clip((problem.bounds - point[:, None]).T, -problem.step_limit, problem.step_limit).T[moving]
        if expected_gain(A, g, bounded_step(A, g, limits, 0.0)) < tolerance:
            converged = True
            break
        for _ in range(MAX_TRIALS):
            step = (truncated_step if approximate else bounded_step)(A, g, limits, damping)
            trial = point.copy()
            trial[moving] = np.clip(point[moving] + step, *problem.bounds[moving].T)
            trial_cost = problem.cost(trial)  # that of an approximate evaluation is off by some nats
            if math.isfinite(trial_cost) and trial_cost < cost:
                break
            damping *= 10.0
        else:
            break
        gain, change, gradient, point, cost = cost - trial_cost, trial - point, current.gradient, trial, trial_cost
        too_long = gain < POOR_RATIO * expected_gain(A, g, step)
        damping = max(10.0 * damping, POOR_DAMPING) if too_long else max(MIN_DAMPING, 0.1 * damping)
        current = evaluate(point)
        if approximate and gain < tolerance:
            converged = True
            break
        curvature = current.information if approximate else bfgs_update(curvature, change, current.gradient - gradient)
    return point, current._replace(cost=cost if math.isfinite(current.cost) else current.cost), converged, steps


def bfgs_update(
    A: Float[np.ndarray, "j j"], step: Float[np.ndarray, " j"], change: Float[np.ndarray, " j"]
) -> Float[np.ndarray, "j j"]:
    """The curvature A updated with the `change` of the gradient along a step; Powell's damping keeps it positive."""
    product = A @ step
    expected, actual = float(step @ product), float(step @ change)
    if not (expected > 0.0 and np.all(np.isfinite(change))):
        return A
    if actual < POWELL_RATIO * expected:
        share = (1.0 - POWELL_RATIO) * expected / (expected - actual)
        change = share * change + (1.0 - share) * product
        actual = float(step @ change)
    return A - np.outer(product, product) / expected + np.outer(change, change) / actual


def bounded_step(
    A: Float[np.ndarray, "j j"], g: Float[np.ndarray, " j"], limits: Float[np.ndarray, "j 2"], damping: float
) -> Float[np.ndarray, " j"]:
    """The step d that minimises 1/2 d (A + damping diag A) d - g d within `limits`; Newton's if that is inside.

    Newton's step truncated at the limits is another one: a variable without information (a noise that is zero) would
    change all the others.
    """
    scale = np.sqrt(np.where(np.diag(A) > 0.0, np.diag(A), 1.0))
    values, vectors = np.linalg.eigh(A / np.outer(scale, scale) + damping * np.eye(len(g)))
    determined = values > SINGULAR * np.max(values, initial=0.0)
    root = np.sqrt(values[determined])
    left, right = root[:, None] * vectors[:, determined].T, vectors[:, determined].T @ (g / scale) / root
    return lsq_linear(left, right, (limits * scale[:, None]).T, method="bvls", tol=1e-12).x / scale


def truncated_step(
    A: Float[np.ndarray, "j j"], g: Float[np.ndarray, " j"], limits: Float[np.ndarray, "j 2"], damping: float
) -> Float[np.ndarray, " j"]:
    """Newton's damped step truncated at `limits`; variables at a bound that they would cross are held."""
    inner = ~((limits[:, 0] >= 0.0) & (g < 0.0) | (limits[:, 1] <= 0.0) & (g > 0.0))
    step = np.zeros(len(g))
    step[inner] = solve(A[np.ix_(inner, inner)], g[inner], damping)
    return np.clip(step, *limits.T)


def covariance_of(information: Float[np.ndarray, "j j"], moving: Bool[np.ndarray, " j"]) -> Float[np.ndarray, "j j"]:
    """Inverse of the information of the estimated variables; zero for held ones and those without information.

    The pseudo-inverse is taken of the matrix scaled to unit diagonal. In SI units it would drop a length in metres
    beside angles in radians.
    """
    known = moving & (np.diag(information) > 0.0)
    block = information[np.ix_(known, known)]
    scale = np.sqrt(np.outer(np.diag(block), np.diag(block)))
    covariance = np.zeros_like(information)
    covariance[np.ix_(known, known)] = np.linalg.pinv(block / scale, hermitian=True) / scale
    return covariance


def expected_gain(A: Float[np.ndarray, "j j"], g: Float[np.ndarray, " j"], step: Float[np.ndarray, " j"]) -> float:
    """Decrease of a cost with gradient -g and curvature A along a step."""
    return float(g @ step - 0.5 * step @ A @ step)
