"""Fisher scoring with Levenberg and Marquardt's damping, each step within the room that its parameters have.

The expected information is not the curvature where the model of the noise is not right, and a step by it may go too far
again and again: damping follows the share of the foreseen gain that a step has gained, and what the gradient changes by
corrects the curvature (BFGS). Source: Nocedal and Wright, *Numerical Optimization*, 2nd ed. 2006, ch. 4, 16 and 18.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float
from scipy.optimize import lsq_linear

from bayes_aero.inference.likelihood.mle import solve

MAX_ITERATIONS, TRIALS = 60, 12  # steps; dampings of one step
FIRST, LEAST = 1e-3, 1e-8  # damping of the first step, and of any
POOR, DAMPED = 0.25, 0.1  # share of the foreseen gain below which a step was too long; damping of the next, at least
LEAST_BEND = 0.2  # of the curvature along a step that a correction leaves at least; Powell's
SINGULAR = 1e-14  # of the largest eigenvalue


class Seen(NamedTuple):
    """Cost, gradient (j,) and expected information (j, j) at a point."""

    cost: float
    gradient: Float[np.ndarray, " j"]
    information: Float[np.ndarray, "j j"]


@runtime_checkable
class Problem(Protocol):
    """What is made least."""

    @property
    def moving(self) -> Bool[np.ndarray, " j"]:
        """Which parameters vary."""
        ...

    @property
    def bounds(self) -> Float[np.ndarray, "j 2"]:
        """Least and largest value of each."""
        ...

    @property
    def most(self) -> Float[np.ndarray, " j"]:
        """How far each may go in a step."""
        ...

    def cost(self, point: Float[np.ndarray, " j"]) -> float:
        """The cost at a point."""
        ...


def scored(
    problem: Problem,
    point: Float[np.ndarray, " j"],
    look: Callable[[np.ndarray], Seen],
    last: float,
    *,
    near: bool = False,
) -> tuple[Float[np.ndarray, " j"], Seen, bool, int]:
    """Go on until a step would gain less than `last`.

    The gradient of a `near` look is not that of the cost: it corrects no curvature, and a step that gains less than
    `last` is the last one, too. Its steps are cut off at their room: far from the least cost, a noise that falls while
    all else follows it may end at zero, where the cost is flat.

    Returns:
        the last point, what is seen there, whether it ended so, and the steps.
    """
    here, cost, damping, steps = look(point), problem.cost(point), FIRST, 0
    moving, converged, curvature = problem.moving, False, here.information
    while steps < MAX_ITERATIONS and math.isfinite(here.cost) and np.all(np.isfinite(curvature)):
        steps += 1
        A, g = curvature[np.ix_(moving, moving)], -here.gradient[moving]
        room = np.clip((problem.bounds - point[:, None]).T, -problem.most, problem.most).T[moving]
        if gain(A, g, boxed_step(A, g, room, 0.0)) < last:
            converged = True
            break
        for _ in range(TRIALS):
            step = cut_step(A, g, room, damping) if near else boxed_step(A, g, room, damping)
            new = point.copy()
            new[moving] = np.clip(point[moving] + step, *problem.bounds[moving].T)
            lower = problem.cost(new)  # not the one that a near look sees, which is off by some nats
            if math.isfinite(lower) and lower < cost:
                break
            damping *= 10.0
        else:
            break
        gained, away, before, point, cost = cost - lower, new - point, here, new, lower
        too_long = gained < POOR * gain(A, g, step)
        damping = max(10.0 * damping, DAMPED) if too_long else max(LEAST, 0.1 * damping)
        here = look(point)
        if near and gained < last:
            converged = True
            break
        curvature = here.information if near else bent(curvature, away, here.gradient - before.gradient)
    return point, here._replace(cost=cost if math.isfinite(here.cost) else here.cost), converged, steps


def bent(
    A: Float[np.ndarray, "j j"], step: Float[np.ndarray, " j"], change: Float[np.ndarray, " j"]
) -> Float[np.ndarray, "j j"]:
    """The curvature A once the gradient has a `change` along a step, kept positive by Powell's damping."""
    along = A @ step
    expected, seen = float(step @ along), float(step @ change)
    if not (expected > 0.0 and np.all(np.isfinite(change))):
        return A
    if seen < LEAST_BEND * expected:
        share = (1.0 - LEAST_BEND) * expected / (expected - seen)
        change = share * change + (1.0 - share) * along
        seen = float(step @ change)
    return A - np.outer(along, along) / expected + np.outer(change, change) / seen


def boxed_step(
    A: Float[np.ndarray, "j j"], g: Float[np.ndarray, " j"], room: Float[np.ndarray, "j 2"], damping: float
) -> Float[np.ndarray, " j"]:
    """The step of least 1/2 d (A + damping diag A) d - g d in its room: Newton's, if that is inside.

    Newton's cut off at the room is another: a direction without information (a noise that is zero) would move the rest.
    """
    scale = np.sqrt(np.where(np.diag(A) > 0.0, np.diag(A), 1.0))
    size, towards = np.linalg.eigh(A / np.outer(scale, scale) + damping * np.eye(len(g)))
    determined = size > SINGULAR * np.max(size, initial=0.0)
    root = np.sqrt(size[determined])
    left, right = root[:, None] * towards[:, determined].T, towards[:, determined].T @ (g / scale) / root
    return lsq_linear(left, right, (room * scale[:, None]).T, method="bvls", tol=1e-12).x / scale


def cut_step(
    A: Float[np.ndarray, "j j"], g: Float[np.ndarray, " j"], room: Float[np.ndarray, "j 2"], damping: float
) -> Float[np.ndarray, " j"]:
    """Newton's step, damped, of what is not at its bound and would leave it; cut off at its room."""
    inner = ~((room[:, 0] >= 0.0) & (g < 0.0) | (room[:, 1] <= 0.0) & (g > 0.0))
    step = np.zeros(len(g))
    step[inner] = solve(A[np.ix_(inner, inner)], g[inner], damping)
    return np.clip(step, *room.T)


def covariance_of(information: Float[np.ndarray, "j j"], moving: Bool[np.ndarray, " j"]) -> Float[np.ndarray, "j j"]:
    """The inverse of the information of what moves; zero for what does not, or of which there is no information.

    The pseudo-inverse is taken in units of the diagonal. In SI it would drop a length in metres beside angles.
    """
    known = moving & (np.diag(information) > 0.0)
    block = information[np.ix_(known, known)]
    units = np.sqrt(np.outer(np.diag(block), np.diag(block)))
    found = np.zeros_like(information)
    found[np.ix_(known, known)] = np.linalg.pinv(block / units, hermitian=True) / units
    return found


def gain(A: Float[np.ndarray, "j j"], g: Float[np.ndarray, " j"], step: Float[np.ndarray, " j"]) -> float:
    """What a step gains where the cost has the curvature A."""
    return float(g @ step - 0.5 * step @ A @ step)
