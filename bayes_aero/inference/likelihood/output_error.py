"""Output error: fit of parameters and initial states to measured trajectories.

Gauss-Newton with Levenberg and Marquardt's damping on exact forward sensitivities; diagonal R re-estimated each step
(cost det R). Source: Jategaonkar, *Flight Vehicle System Identification*, 2nd ed. 2015, ch. 4.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace

import equinox as eqx
import numpy as np
from jaxtyping import Array, Float

from bayes_aero.dynamics.output_biases import biased_dynamics
from bayes_aero.dynamics.segments import SegmentTrajectories, Simulated, simulate
from bayes_aero.inference.likelihood.mle import solve
from bayes_aero.inference.likelihood.normal_equations import TINY, NormalEquations, Priors, reduced_equations
from bayes_aero.inference.likelihood.output_error_result import OutputErrorResult, OutputErrorStatus, result_at
from bayes_aero.parameter import Prior

MAX_ITERATIONS, MAX_EARLY_ITERATIONS = 60, 12  # of the last stage of a cascade, and of those before
TOLERANCE = 1e-3  # expected gain in log-likelihood of the last step: 0.05 standard errors
COLOURED_TOLERANCE = 1e-3  # the same per unit of variance inflation: as small relative to the corrected standard error
FIRST_DAMPING, MIN_DAMPING = 1e-2, 1e-4  # relative to the information's diagonal; long steps end in other minima
MIN_GAIN_RATIO = 0.05  # least ratio of actual to expected gain of a step


_simulate = eqx.filter_jit(simulate)


def trajectories(flown: SegmentTrajectories, theta: Float[Array, " k"], departure: Float[Array, "w s"]) -> Simulated:
    """`segments.simulate`, compiled."""
    return _simulate(flown.nameless, theta, departure)


def one_by_one(
    flown: SegmentTrajectories, theta: Float[Array, " k"], departure: Float[Array, "w s"]
) -> tuple[tuple[str, ...], dict[int, Simulated]]:
    """Names of all recorded outputs, and `trajectories` with them of each segment that has samples.

    One program serves any number of segments and any choice of outputs.
    """
    shown = tuple(n for n in flown.dynamics.outputs if n in flown.flights.channels)
    wide = replace(flown, outputs=shown)
    rows = map(int, np.flatnonzero(flown.inside.any(axis=1)))
    return shown, {row: trajectories(wide.part([row]), theta, departure[row : row + 1]) for row in rows}


def fit_output_error(
    flown: SegmentTrajectories,
    *,
    start: Float[np.ndarray, " k"] | None = None,
    departure: Float[np.ndarray, "w s"] | None = None,
    held: Mapping[str, float] | None = None,
    prior_weight: float = 1.0,
    without: Collection[str] = (),
    max_iterations: int = MAX_ITERATIONS,
    biases: Mapping[str, Prior] | None = None,
    stopped: Callable[[], bool] | None = None,
) -> OutputErrorResult:
    """Fit all segments together from one start.

    Args:
        flown: segments of flights.
        start: parameters, (k,); default: the starting values of the model.
        departure: corrections of the measured initial states to start from, (w, s), SI; default: none.
        held: parameters that are not estimated, and their values.
        prior_weight: factor on all priors; 0 leaves them out, those of the initial states too.
        without: parameters without a prior.
        max_iterations: largest number of steps.
        biases: outputs with a constant error in each manoeuvre, and the priors of these errors. The errors are further
            parameters (`bias_output_1` and so on) after those of the model.
        stopped: called before each step; True ends the fit there, not converged.
    """
    if biases:
        own = len(flown.dynamics.free)
        flown = replace(flown, dynamics=biased_dynamics(flown.dynamics, flown.flights, biases))
        if start is not None and len(start) == own:
            start = np.append(start, [p.prior.normal[0] for p in flown.dynamics.free[own:]])
    free, held = flown.dynamics.free, held or {}
    lower, upper = (np.array([p.bounds[i] for p in free], float) for i in (0, 1))
    prior = Priors.of(flown, prior_weight, without)
    theta = np.array([p.start for p in free]) if start is None else np.asarray(start, float)
    theta = np.array([held.get(p.name, x) for p, x in zip(free, theta, strict=True)])
    held_mask = np.array([p.name in held for p in free], bool)
    lower, upper = np.where(held_mask, theta, lower), np.where(held_mask, theta, upper)
    prior = replace(prior, mean=np.where(held_mask, theta, prior.mean))  # held parameters add nothing to the cost
    w, s = flown.index.shape[0], len(flown.dynamics.start)
    equations = NormalEquations(flown, prior)
    point = equations.evaluate(np.clip(theta, lower, upper), np.zeros((w, s)) if departure is None else departure)
    damping, converged, active = FIRST_DAMPING, False, np.zeros(len(free), bool)
    count = 0
    while count < max_iterations and math.isfinite(point.cost) and not (stopped and stopped()):
        count += 1
        A, g, states = reduced_equations(point, prior)
        active = held_mask | ((point.theta <= lower) & (g < 0.0)) | ((point.theta >= upper) & (g > 0.0))
        moving = np.flatnonzero(~active)
        newton = solve(A[np.ix_(moving, moving)], g[moving], 0.0)
        gain = 0.5 * float(newton @ g[moving]) + states.gain
        if 0.0 <= gain < max(TOLERANCE, COLOURED_TOLERANCE * (prior_weight - 1.0)):
            converged = True
            if gain < TOLERANCE:
                step = np.zeros(len(free))
                step[moving] = newton
                step = np.clip(point.theta + step, lower, upper) - point.theta
                point = equations.extrapolate(point, step, states.step(step))
            break
        accepted = None
        for _ in range(12):
            step = np.zeros(len(free))
            step[moving] = solve(A[np.ix_(moving, moving)], g[moving], damping)
            step = np.clip(point.theta + step, lower, upper) - point.theta
            new = equations.evaluate(point.theta + step, point.departure + states.step(step))
            expected = step @ g - 0.5 * step @ A @ step + states.gain
            ratio = (point.cost - new.cost) / max(expected, TINY)
            if new.cost < point.cost and ratio > MIN_GAIN_RATIO:
                accepted = new
                break
            damping = max(MIN_DAMPING, 4.0 * damping)
        if accepted is None:
            converged = bool(0.0 <= gain < 1e-2 * max(1.0, prior_weight))
            break
        damping = damping / 10.0 if ratio > 0.75 else damping if ratio > 0.3 else max(MIN_DAMPING, 2.0 * damping)
        point = accepted
    return result_at(flown, point, prior, converged=converged, iterations=count, active=active, held=held_mask)


def fit_cascade(
    stages: Sequence[SegmentTrajectories],
    starts: Sequence[Float[np.ndarray, " k"]],
    *,
    held: Mapping[str, float] | None = None,
    prior_weight: float = 1.0,
    without: Collection[str] = (),
    biases: Mapping[str, Prior] | None = None,
) -> OutputErrorResult:
    """Fit the short windows of the first stage from every start, then each later stage from the best fit so far.

    Short windows keep the simulation near the record where the aircraft is unstable or the start is poor, but hide slow
    errors of the model. The last stage should therefore be whole manoeuvres.
    """
    options = {"held": held, "prior_weight": prior_weight, "without": without, "biases": biases}
    first = [fit_output_error(stages[0], start=s, max_iterations=MAX_EARLY_ITERATIONS, **options) for s in starts]
    best = min(first, key=lambda found: (found.status is OutputErrorStatus.LEFT_ENVELOPE, found.cost))
    for number, stage in enumerate(stages[1:], start=2):
        max_iterations = MAX_ITERATIONS if number == len(stages) else MAX_EARLY_ITERATIONS
        best = fit_output_error(stage, start=best.estimate, max_iterations=max_iterations, **options)
    return best
