"""Output error: parameters and initial states such that the simulated trajectory follows the measured one.

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
from bayes_aero.inference.likelihood.normal_equations import TINY, NormalEquations, Priors, reduced
from bayes_aero.inference.likelihood.output_error_result import OutputErrorResult, OutputErrorStatus, result_of
from bayes_aero.parameter import Prior

MAX_ITERATIONS, EARLY = 60, 12  # of the last stage of a cascade, and of those before
LAST = 1e-3  # expected gain in log-likelihood of a step that is taken without a look, the last: 0.05 of a deviation
SLACK = 1e-3  # the same per sample's weight, where residuals are coloured: as much of a deviation that knows the colour
BEGIN_DAMPING, LEAST_DAMPING = 1e-2, 1e-4  # relative to the information's diagonal: far steps end in other basins
WORTH = 0.05  # least share of the expected gain that a step must bring


_simulate = eqx.filter_jit(simulate)


def trajectories(flown: SegmentTrajectories, theta: Float[Array, " k"], departure: Float[Array, "w s"]) -> Simulated:
    """`segments.simulate`, compiled."""
    return _simulate(flown.nameless, theta, departure)


def fit_output_error(
    flown: SegmentTrajectories,
    *,
    start: Float[np.ndarray, " k"] | None = None,
    departure: Float[np.ndarray, "w s"] | None = None,
    held: Mapping[str, float] | None = None,
    prior_weight: float = 1.0,
    without: Collection[str] = (),
    most: int = MAX_ITERATIONS,
    biases: Mapping[str, Prior] | None = None,
    stopped: Callable[[], bool] | None = None,
) -> OutputErrorResult:
    """Fit all segments together from one start (default: the parameters' own); parameters `held` keep their value.

    A `prior_weight` of 0 leaves out all priors, those of initial states too; parameters `without` one are named.
    `biases` names outputs that were recorded with a constant error of each manoeuvre's own, and their priors; these
    errors are then parameters too (`bias_output_1` and so on), after those of `start`. `stopped` is asked before each
    step whether to end there, not converged.
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
    rest = np.array([p.name in held for p in free], bool)
    lower, upper = np.where(rest, theta, lower), np.where(rest, theta, upper)
    prior = replace(prior, mean=np.where(rest, theta, prior.mean))  # what is held has no say in the cost
    w, s = flown.index.shape[0], len(flown.dynamics.start)
    look = NormalEquations(flown, prior)
    here = look(np.clip(theta, lower, upper), np.zeros((w, s)) if departure is None else departure)
    damping, converged, active = BEGIN_DAMPING, False, np.zeros(len(free), bool)
    count = 0
    while count < most and math.isfinite(here.cost) and not (stopped and stopped()):
        count += 1
        A, g, local = reduced(here, prior)
        active = rest | ((here.theta <= lower) & (g < 0.0)) | ((here.theta >= upper) & (g > 0.0))
        moving = np.flatnonzero(~active)
        newton = solve(A[np.ix_(moving, moving)], g[moving], 0.0)
        gain = 0.5 * float(newton @ g[moving]) + local.gain
        if 0.0 <= gain < max(LAST, SLACK * (prior_weight - 1.0)):
            converged = True
            if gain < LAST:
                step = np.zeros(len(free))
                step[moving] = newton
                step = np.clip(here.theta + step, lower, upper) - here.theta
                here = look.ahead(here, step, local.step(step))
            break
        better = None
        for _ in range(12):
            step = np.zeros(len(free))
            step[moving] = solve(A[np.ix_(moving, moving)], g[moving], damping)
            step = np.clip(here.theta + step, lower, upper) - here.theta
            new = look(here.theta + step, here.departure + local.step(step))
            expected = step @ g - 0.5 * step @ A @ step + local.gain
            kept = (here.cost - new.cost) / max(expected, TINY)
            if new.cost < here.cost and kept > WORTH:
                better = new
                break
            damping = max(LEAST_DAMPING, 4.0 * damping)
        if better is None:
            converged = bool(0.0 <= gain < 1e-2 * max(1.0, prior_weight))
            break
        damping = damping / 10.0 if kept > 0.75 else damping if kept > 0.3 else max(LEAST_DAMPING, 2.0 * damping)
        here = better
    return result_of(flown, here, prior, converged=converged, iterations=count, active=active, rest=rest)


def fit_cascade(
    stages: Sequence[SegmentTrajectories],
    starts: Sequence[Float[np.ndarray, " k"]],
    *,
    held: Mapping[str, float] | None = None,
    prior_weight: float = 1.0,
    without: Collection[str] = (),
    biases: Mapping[str, Prior] | None = None,
) -> OutputErrorResult:
    """Fit the first stage's short windows from every start, then each later stage from the best so far.

    Windows keep an unstable or poorly started simulation on its path, but hide slow errors of the model; so the last
    stage should be whole manoeuvres.
    """
    options = {"held": held, "prior_weight": prior_weight, "without": without, "biases": biases}
    first = [fit_output_error(stages[0], start=s, most=EARLY, **options) for s in starts]
    best = min(first, key=lambda found: (found.status is OutputErrorStatus.LEFT_ENVELOPE, found.cost))
    for number, stage in enumerate(stages[1:], start=2):
        most = MAX_ITERATIONS if number == len(stages) else EARLY
        best = fit_output_error(stage, start=best.estimate, most=most, **options)
    return best
