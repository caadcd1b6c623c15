"""Output error: fit of parameters and initial states to measured trajectories.

Gauss-Newton with Levenberg and Marquardt's damping on exact forward sensitivities; diagonal R re-estimated each step
(cost det R). Source: Jategaonkar, *Flight Vehicle System Identification*, 2nd ed. 2015, ch. 4.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float
from scipy.optimize import minimize_scalar

from bayes_aero.dynamics.flight import EffectDynamics, biased_dynamics
from bayes_aero.dynamics.segments import SegmentTrajectories, Simulated, simulate
from bayes_aero.inference.optimise import (
    MAX_TRIALS,
    Evaluation,
    Rule,
    at_bounds,
    minimise,
    newton_gain,
    truncated_step,
)
from bayes_aero.inference.output_error_result import (
    NormalEquations,
    NormalPriors,
    OutputErrorResult,
    OutputErrorStatus,
    Point,
    reduced_equations,
    result_at,
)
from bayes_aero.inference.prediction_error import PredictionErrorResult, fit_prediction_error
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
    """Names of all recorded outputs, and `trajectories` with them of each segment that has samples."""
    # One program serves any number of segments and any choice of outputs.
    shown = tuple(n for n in flown.dynamics.outputs if n in flown.flights.channels)
    wide = replace(flown, outputs=shown)
    rows = map(int, np.flatnonzero(flown.inside.any(axis=1)))
    return shown, {row: trajectories(wide.part([row]), theta, departure[row : row + 1]) for row in rows}


class _Trajectories:
    """Minus the log posterior density of the parameters as a `Problem`, with initial states at their optimum; the last
    point is kept."""

    def __init__(self, equations: NormalEquations, point: Point, bounds: Float[np.ndarray, "k 2"], moving: np.ndarray):
        self.equations, self.point, self.tried = equations, point, point
        self.bounds, self.moving, self.step_limit = bounds, moving, np.full(len(bounds), np.inf)

    def cost(self, point: Float[np.ndarray, " k"]) -> float:
        """The cost at a point."""
        if point is self.point.theta:
            return self.point.cost
        departure = self.point.departure + self.states.step(point - self.point.theta)
        self.tried = self.equations.evaluate(point, departure)
        return self.tried.cost

    def evaluate(self, point: Float[np.ndarray, " k"]) -> Evaluation:
        """Cost, gradient and information at the point that was tried last."""
        if point is not self.point.theta:
            self.point = self.tried
        if not math.isfinite(self.point.cost):
            return Evaluation(self.point.cost, np.zeros(len(point)), np.eye(len(point)))
        A, g, self.states = reduced_equations(self.point, self.equations.prior)
        return Evaluation(self.point.cost, -g, A, self.states.gain)


RULE = Rule(
    step=truncated_step,
    gain=newton_gain,
    trials=lambda d: ((1.0, max(MIN_DAMPING * 4.0 ** (k - 1), d * 4.0**k) if k else d) for k in range(MAX_TRIALS)),
    after=lambda d, ratio: d / 10.0 if ratio > 0.75 else d if ratio > 0.3 else max(MIN_DAMPING, 2.0 * d),
    first=FIRST_DAMPING,
    ratio=MIN_GAIN_RATIO,
    least_gain=0.0,
)


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
    """Fit all segments together from one start."""
    # `departure`: corrections of the measured initial states to start from, SI. `held`: parameters that are not
    # estimated, and their values. `prior_weight`: factor on all priors; 0 leaves them out, those of the initial states
    # too. `without`: parameters without a prior. `biases`: outputs with a constant error in each manoeuvre, and its
    # prior: further parameters (`bias_output_1` and so on). `stopped`: called before each step; True ends the fit
    # there, not converged.
    if biases:
        modelled = len(flown.dynamics.free)
        flown = replace(flown, dynamics=biased_dynamics(flown.dynamics, flown.flights, biases))
        if start is not None and len(start) == modelled:
            start = np.append(start, [p.prior.normal[0] for p in flown.dynamics.free[modelled:]])
    free, held, prior = flown.dynamics.free, held or {}, NormalPriors.of(flown, prior_weight, without)
    begin = [p.start for p in free] if start is None else np.asarray(start, float)
    theta = np.array([held.get(p.name, x) for p, x in zip(free, begin, strict=True)])
    held_mask = np.array([p.name in held for p in free], bool)
    bounds = np.where(held_mask[:, None], theta[:, None], np.array([p.bounds for p in free], float).reshape(-1, 2))
    prior = replace(prior, mean=np.where(held_mask, theta, prior.mean))  # held parameters add nothing to the cost
    departure = np.zeros((len(flown.index), len(flown.dynamics.start))) if departure is None else departure
    equations = NormalEquations(flown, prior)
    problem = _Trajectories(equations, equations.evaluate(np.clip(theta, *bounds.T), departure), bounds, ~held_mask)
    tolerance = max(TOLERANCE, COLOURED_TOLERANCE * (prior_weight - 1.0))
    rule = RULE._replace(last=1e-2 * max(1.0, prior_weight), max_steps=max_iterations)
    begin = problem.point.theta
    theta, at, converged, count = minimise(problem, begin, problem.evaluate, tolerance, rule, stopped=stopped)
    point, moving = problem.point, problem.moving
    if converged:
        A, g, limits = at.information[np.ix_(moving, moving)], -at.gradient[moving], (bounds - theta[:, None])[moving]
        if newton_gain(A, g, limits) + at.gain < TOLERANCE:  # the last step is short: residuals are linear along it
            step = np.zeros(len(free))
            step[moving] = truncated_step(A, g, limits, 0.0)
            point = equations.extrapolate(point, step, problem.states.step(step))
    active = held_mask | at_bounds(problem, theta, at.gradient)
    return result_at(flown, point, prior, converged=converged, iterations=count, active=active, held=held_mask)


def fit_cascade(
    stages: Sequence[SegmentTrajectories],
    starts: Sequence[Float[np.ndarray, " k"]],
    *,
    held: Mapping[str, float] | None = None,
    prior_weight: float = 1.0,
    without: Collection[str] = (),
) -> OutputErrorResult:
    """Fit the short windows of the first stage from every start, then each later stage from the best fit so far."""
    # Short windows keep the simulation near the record where the aircraft is unstable or the start is poor, but hide
    # slow errors of the model. The last stage should therefore be whole manoeuvres.
    options = {"held": held, "prior_weight": prior_weight, "without": without}
    first = [fit_output_error(stages[0], start=s, max_iterations=MAX_EARLY_ITERATIONS, **options) for s in starts]
    best = min(first, key=lambda found: (found.status is OutputErrorStatus.LEFT_ENVELOPE, found.cost))
    for number, stage in enumerate(stages[1:], start=2):
        max_iterations = MAX_ITERATIONS if number == len(stages) else MAX_EARLY_ITERATIONS
        best = fit_output_error(stage, start=best.estimate, max_iterations=max_iterations, **options)
    return best


# --- A fit with all disturbances of a flight: gusts, and process noise of the states for what gusts do not explain.

GUSTS = ("vertical_gust", "longitudinal_gust")
FIRST_F = 0.3  # process noise at the start of a fit, in standard deviations of output error's residuals a second
FIRST_F_GUSTS = 0.03  # the same in gusts: from a larger value, process noise of the states takes the place of a gust
FIRST_R = 0.1  # measurement noise at the start, as a share of the variance of output error's residuals
MIN_SHARE = 0.1  # of these starting values, below which a fit never starts


def disturbed(flown: SegmentTrajectories) -> SegmentTrajectories:
    """The same segments in gusts; linear systems have no gusts."""
    # Where the model has buffet, the noise of the sensors does not grow as the flow separates.
    dynamics = flown.dynamics
    if not isinstance(dynamics, EffectDynamics):
        return flown
    dynamics = dynamics.for_filter()
    if not dynamics.meets_gusts:
        return replace(flown, dynamics=dynamics)
    gusts = (*GUSTS, *(("lateral_gust",) if "beta" in dynamics.states and "beta" in flown.outputs else ()))
    absent = [name for name in gusts if name not in {e.name for e in dynamics.model.acting}]
    model = dynamics.model.extended(*absent)
    steady = np.ones_like(flown.noise_growth) if model.has_buffet else flown.noise_growth
    return replace(flown, dynamics=replace(dynamics, model=model), noise_growth=steady)


def fit_disturbed(
    flown: SegmentTrajectories,
    estimate: Float[np.ndarray, " k"],
    R: Float[np.ndarray, " c"],
    *,
    priors: bool = True,
    exact: bool = True,
    similar: PredictionErrorResult | None = None,
) -> tuple[SegmentTrajectories, PredictionErrorResult]:
    """Fit with process noise, from the estimates of output error (k,) and the variances R of its residuals (c,), SI."""
    # States that a sensor measures have process noise of their own; gusts have theirs; other states have none. Gusts
    # and noise start from a fit of a `similar` model, one effect off. Returns the segments in gusts, and the fit.
    gusty, outputs = disturbed(flown), flown.outputs
    names, states = gusty.dynamics.names, gusty.dynamics.states
    estimates = dict(zip(flown.dynamics.names, estimate, strict=True))
    start = np.array([estimates.get(p.name, p.start) for p in gusty.dynamics.free])
    sd = np.sqrt(R)
    first = FIRST_F if names == flown.dynamics.names else FIRST_F_GUSTS
    F = np.array([first * sd[outputs.index(n)] if n in outputs else 0.0 for n in states])
    R = FIRST_R * R
    if similar is not None:  # none so small that the likelihood is flat
        estimates = dict(zip(similar.names, map(float, similar.estimate), strict=True))
        estimates = {n: x for n, x in estimates.items() if n in gusty.dynamics.disturbance_parameters}
        start = np.array(
            [max(estimates[n], MIN_SHARE * x) if n in estimates else x for n, x in zip(names, start, strict=True)]
        )
        noise, R = dict(zip(similar.states, similar.F, strict=True)), similar.R
        F = np.array([max(float(noise.get(n, x)), MIN_SHARE * x) for n, x in zip(states, F, strict=True)])
    return gusty, fit_prediction_error(gusty, F, R, start=start, priors=priors, exact=exact)


# --- Growth of the residuals of simulated outputs with flow separation, by buffet and by errors of the stall model.
# With constant noise the small residuals of minutes of attached flow would give a few seconds of stall the largest
# weight.

MAX_GROWTH = 30.0  # noise added at full separation, in units of the noise of attached flow; our choice
MIN_X_RANGE = 0.05  # range of X over a record below which the growth is not estimated


@dataclass(frozen=True)
class SeparatedFlow:
    """Residuals of each output, and the separated share of the flow, 1 - X, between 0 and 1."""

    residual: Float[np.ndarray, "w n c"]
    separated: Float[np.ndarray, "w n"]
    inside: Bool[np.ndarray, "w n"]

    @classmethod
    def of(cls, fit: OutputErrorResult) -> SeparatedFlow | None:
        """Of a fit; None where the flow does not separate, or the simulation leaves the envelope."""
        if fit.status is OutputErrorStatus.LEFT_ENVELOPE or not np.isfinite(fit.cost):
            return None
        flown = fit.flown
        shown, found = one_by_one(flown, jnp.asarray(fit.estimate), jnp.asarray(fit.departure))
        if not all("X" in one.trajectory.outputs for one in found.values()):
            return None
        residual, separated = np.zeros((*flown.inside.shape, len(flown.outputs))), np.zeros(flown.inside.shape)
        at = [shown.index(name) for name in flown.outputs]
        for row, one in found.items():
            residual[row] = np.asarray(one.residual[0])[:, at]
            separated[row] = np.clip(1.0 - np.asarray(one.trajectory.outputs["X"][0]), 0.0, 1.0)
        if np.ptp(separated[flown.inside]) < MIN_X_RANGE:
            return None
        return cls(residual, separated, flown.inside)

    def growths(self, without: int | None = None) -> Float[np.ndarray, " c"]:
        """b of every output, (c,), from all segments or from all but one."""
        used = self.inside.copy()
        if without is not None:
            used[without] = False
        separated = self.separated[used]

        def growth(residual: np.ndarray) -> float:
            """Maximum-likelihood b >= 0 of normal residuals with standard deviation proportional to 1 + b (1 - X)."""
            # Autocorrelation of the residuals increases the error of b, but does not bias it.

            def cost(b: float) -> float:
                size = 1.0 + b * separated
                return 0.5 * np.log(np.mean((residual / size) ** 2)) + np.mean(np.log(size))

            if not residual.any():  # no error, or no output
                return 0.0
            found: Any = minimize_scalar(cost, bounds=(0.0, MAX_GROWTH), method="bounded")  # it has no types of its own
            return float(found.x) if found.fun < cost(0.0) else 0.0

        return np.array([growth(x) for x in self.residual[used].T])

    def noise_growth(self, without: int | None = None) -> Float[np.ndarray, "w n c"]:
        """1 + b (1 - X), (w, n, c)."""
        return 1.0 + self.growths(without) * self.separated[:, :, None]
