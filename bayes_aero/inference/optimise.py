"""The bounded search of all likelihoods: damped steps from cost, gradient and information.

Newton's steps with the damping of Levenberg and Marquardt. The engines differ in how a step is kept within the bounds,
in the dampings that are tried and in when a step is accepted: that is their `Rule`. Source: Nocedal and Wright,
*Numerical Optimization*, 2nd ed. 2006, ch. 4, 16 and 18.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from scipy.optimize import lsq_linear

MAX_ITERATIONS, MAX_TRIALS = 60, 12  # steps; dampings tried in one step
POWELL_RATIO = 0.2  # least curvature along a step after an update, relative to that before
SINGULAR = 1e-14  # of the largest eigenvalue
TINY = 1e-300

Vector = Float[np.ndarray, " k"]
Square = Float[np.ndarray, "k k"]
Limits = Float[np.ndarray, "k 2"]


class Evaluation(NamedTuple):
    """At a point; `gain` is what the best step of eliminated variables is expected to lower the cost by."""

    cost: float
    gradient: Vector
    information: Square  # the expected one
    gain: float = 0.0


class Problem:
    """A cost to be minimised over k variables; its `cost` is asked at a point before its `evaluate`.

    `moving` ones are estimated, within `bounds`; in one step each changes by its `step_limit` at most.
    """

    cost: Callable[[Vector], float]
    evaluate: Callable[[Vector], Evaluation]

    def __init__(self, bounds: Limits, moving: Bool[np.ndarray, " k"] | None = None) -> None:
        self.bounds, self.step_limit = bounds, np.full(len(bounds), np.inf)
        self.moving = np.ones(len(bounds), bool) if moving is None else moving


class Rule(NamedTuple):
    """How a search steps."""

    step: Callable[[np.ndarray, np.ndarray, np.ndarray, float, float], np.ndarray]
    """From curvature, minus gradient, limits, damping and share."""
    gain: Callable[[np.ndarray, np.ndarray, np.ndarray], float]  # expected of an undamped step, from the first three
    trials: Callable[[float], Iterable[tuple[float, float]]]  # shares and dampings to try, from the last damping
    after: Callable[[float, float], float] = lambda *_: 0.0
    """The next damping, from that of an accepted step and its ratio of actual to expected gain."""
    first: float = 0.0  # damping
    ratio: float = -math.inf  # least ratio of actual to expected gain of a step that is accepted
    last: float = -math.inf  # expected gain below which a search that finds no better point has converged
    least_gain: float = -math.inf  # a smaller one is that of an indefinite information, and ends no search
    max_steps: int = MAX_ITERATIONS
    quasi_newton: bool = False  # the curvature is corrected with the change of the gradient
    approximate: bool = False  # a step whose actual gain is below the tolerance ends the search


def minimise(
    problem: Problem,
    point: Vector,
    tolerance: float,
    rule: Rule | None = None,
    *,
    evaluate: Callable[[np.ndarray], Evaluation] | None = None,
    steps: int = 0,
    stopped: Callable[[], bool] | None = None,
) -> tuple[Vector, Evaluation, bool, int]:
    """The last point, its evaluation, whether a step is expected to gain less than `tolerance`, and count of steps."""
    # `evaluate` (of the problem) is called at accepted points, after their cost; `rule` is by default `SCORING`.
    rule = rule or SCORING
    evaluate, cost, damping = evaluate or problem.evaluate, problem.cost(point), rule.first
    current = evaluate(point)
    moving, converged, curvature = problem.moving, False, current.information
    while steps < rule.max_steps and math.isfinite(current.cost) and np.all(np.isfinite(curvature)):
        if stopped and stopped():
            break
        steps += 1
        A, g = curvature[np.ix_(moving, moving)], -current.gradient[moving]
        limits = np.clip((problem.bounds - point[:, None]).T, -problem.step_limit, problem.step_limit).T[moving]
        expected = rule.gain(A, g, limits) + current.gain
        if rule.least_gain <= expected < tolerance:
            converged = True
            break
        for share, damping in rule.trials(damping):  # noqa: B020
            step = rule.step(A, g, limits, damping, share)
            trial = point.copy()
            trial[moving] = np.clip(point[moving] + step, *problem.bounds[moving].T)
            trial_cost = problem.cost(trial)  # that of an approximate evaluation is off by some nats
            ratio = (cost - trial_cost) / max(expected_gain(A, g, step) + current.gain, TINY)
            if math.isfinite(trial_cost) and trial_cost < cost and ratio > rule.ratio:
                break
        else:
            converged = rule.least_gain <= expected < rule.last
            break
        gain, change, gradient, point, cost = cost - trial_cost, trial - point, current.gradient, trial, trial_cost
        damping = rule.after(damping, ratio)
        current = evaluate(point)
        if rule.approximate and gain < tolerance:
            converged = True
            break
        quasi = rule.quasi_newton
        curvature = bfgs_update(curvature, change, current.gradient - gradient) if quasi else current.information
    return point, current._replace(cost=cost if math.isfinite(current.cost) else current.cost), converged, steps


def at_bounds(problem: Problem, point: Vector, gradient: Vector) -> Bool[np.ndarray, " k"]:
    """Variables at a bound that lower the cost beyond it."""
    lower, upper = problem.bounds.T
    return ((point <= lower) & (gradient > 0.0)) | ((point >= upper) & (gradient < 0.0))


def solve(A: np.ndarray, g: np.ndarray, damping: float) -> np.ndarray:
    """(A + damping diag A)^-1 g with unit-diagonal scaling; least squares where A is singular."""
    size, tiny = np.diag(A), np.finfo(float).tiny
    # A diagonal element lost to rounding (unstable flight) is replaced by the largest, so that its row stays finite.
    scale = np.sqrt(np.where(size > 0.0, np.maximum(size, tiny), np.max(size, initial=tiny)))
    scaled = A / np.outer(scale, scale) + damping * np.eye(len(g))
    return np.linalg.lstsq(scaled, g / scale, rcond=1e-14)[0] / scale


def expected_gain(A: Square, g: Vector, step: Vector) -> float:
    """Decrease of a cost with gradient -g and curvature A along a step."""
    return float(g @ step - 0.5 * step @ A @ step)


def held_at_bounds(g: Vector, limits: Limits) -> Bool[np.ndarray, " k"]:
    """Variables at a bound that Newton's step would cross."""
    return (limits[:, 0] >= 0.0) & (g < 0.0) | (limits[:, 1] <= 0.0) & (g > 0.0)


def newton_gain(A: Square, g: Vector, limits: Limits) -> float:
    """Expected gain of Newton's step of the variables that are not held at a bound."""
    inner = ~held_at_bounds(g, limits)
    return 0.5 * float(solve(A[np.ix_(inner, inner)], g[inner], 0.0) @ g[inner])


def truncated_step(A: Square, g: Vector, limits: Limits, damping: float, share: float = 1.0) -> Vector:
    """A share of Newton's damped step truncated at `limits`; variables at a bound that they would cross are held."""
    inner = ~held_at_bounds(g, limits)
    step = np.zeros(len(g))
    step[inner] = share * solve(A[np.ix_(inner, inner)], g[inner], damping)
    return np.clip(step, *limits.T)


def bounded_step(A: Square, g: Vector, limits: Limits, damping: float, _share: float = 1.0) -> Vector:
    """The step d that minimises 1/2 d (A + damping diag A) d - g d within `limits`; Newton's if that is inside."""
    # Newton's step truncated at the limits is another one: a variable without information (a noise that is zero) would
    # change all the others.
    scale = np.sqrt(np.where(np.diag(A) > 0.0, np.diag(A), 1.0))
    values, vectors = np.linalg.eigh(A / np.outer(scale, scale) + damping * np.eye(len(g)))
    determined = values > SINGULAR * np.max(values, initial=0.0)
    root = np.sqrt(values[determined])
    left, right = root[:, None] * vectors[:, determined].T, vectors[:, determined].T @ (g / scale) / root
    return lsq_linear(left, right, (limits * scale[:, None]).T, method="bvls", tol=1e-12).x / scale


def bfgs_update(A: Square, step: Vector, change: Vector) -> Square:
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


# --- Fisher scoring.
# Where the noise model is wrong, the expected information is not the curvature of the cost, and its steps may be too
# long again and again. Two remedies: the damping follows the ratio of actual to expected gain, and BFGS updates
# correct the curvature with the change of the gradient.

FIRST_DAMPING, MIN_DAMPING = 1e-3, 1e-8
POOR_RATIO, POOR_DAMPING = 0.25, 0.1  # ratio of actual to expected gain below which a step was too long; damping then
SCORING = Rule(
    step=bounded_step,
    gain=lambda A, g, limits: expected_gain(A, g, bounded_step(A, g, limits, 0.0)),
    trials=lambda damping: ((1.0, damping * 10.0**k) for k in range(MAX_TRIALS)),
    after=lambda d, ratio: max(10.0 * d, POOR_DAMPING) if ratio < POOR_RATIO else max(MIN_DAMPING, 0.1 * d),
    first=FIRST_DAMPING,
    quasi_newton=True,
)
APPROXIMATE_SCORING = SCORING._replace(step=truncated_step, quasi_newton=False, approximate=True)
"""An approximate gradient cannot correct the curvature. Newton's steps are truncated at their limits: a noise variance
that falls together with all other variables, far from the minimum, may end at zero, where the cost is flat."""
