"""Prediction error: parameters, process noise and measurement noise, jointly, by the likelihood of the innovations.

The extended Kalman filter's gain varies with time, so that the initial state, missing samples and several sensor rates
are counted for what they are. Fisher scoring on 1/2 sum (log S + e^2 / S) and the priors, with exact sensitivities of
innovations and variances. Source: Åström 1980, Automatica 16, 551 (prediction-error likelihood); Mehra 1971,
AIAA J. 9, 28 (in flight test).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from enum import Enum

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from bayes_aero.dynamics.innovations import (
    disturbances_along,
    filter_segments,
    linear_innovations,
    linearise,
    noise_derivatives,
)
from bayes_aero.dynamics.kalman import Filtered, log_likelihood
from bayes_aero.dynamics.segments import SegmentTrajectories
from bayes_aero.flight.health import quantum
from bayes_aero.inference.optimise import APPROXIMATE_SCORING, Evaluation, minimise
from bayes_aero.inference.output_error_result import initial_state_sd

TOLERANCE, HELD_GAINS_TOLERANCE = 1e-3, 0.3  # of the log likelihood, with exact gradients and with the gains held
MIN_NOISE = 1e-12  # of F and R
LOG_STEP_LIMIT = 2.0  # of log F and log R, in one step
ROUNDING_DIVISOR = 12.0  # the variance of rounding is the squared resolution over this


class PredictionErrorStatus(Enum):
    """How a fit ended."""

    CONVERGED = "converged"
    NOT_CONVERGED = "not converged"
    DIVERGED = "the filter diverged"


@dataclass(frozen=True)
class PredictionErrorResult:
    """Estimates with standard errors: parameters (k,), process noise F (s,) and standard deviations of the measurement
    noise (c,); `covariance` (k + s + c) is of parameters, log F and log R, R the variances. `cost` is minus the log
    posterior density, but for a constant."""

    names: tuple[str, ...]
    states: tuple[str, ...]
    outputs: tuple[str, ...]
    estimate: Float[np.ndarray, " k"]
    F: Float[np.ndarray, " s"]
    R: Float[np.ndarray, " c"]
    covariance: Float[np.ndarray, "j j"]
    log_likelihood: float
    cost: float
    found: Filtered
    status: PredictionErrorStatus
    iterations: int

    @property
    def sd(self) -> Float[np.ndarray, " k"]:
        """Standard errors of the parameters."""
        return np.sqrt(np.diag(self.covariance))[: len(self.names)]


def _filter(flown, point, start_deviation, k, s):
    return filter_segments(flown, point[:k], start_deviation, jnp.exp(point[k : k + s]), jnp.exp(point[k + s :]))


@eqx.filter_jit
def _filter_segments(flown, point, start_deviation, k, s):
    """Minus the log likelihood, and the filtered segments."""
    filtered = _filter(flown, point, start_deviation, k, s)
    return -jnp.sum(jax.vmap(log_likelihood)(filtered)), filtered


@eqx.filter_jit
def _evaluate(flown, point, start_deviation, k, s):
    """Cost, gradient and expected information."""

    def at(point):
        filtered = _filter(flown, point, start_deviation, k, s)
        return (filtered.innovation, filtered.variance), filtered

    directions = jnp.eye(len(point))
    (e, S), (de, dS), filtered = jax.vmap(
        lambda t: jax.jvp(at, (point,), (t,), has_aux=True), out_axes=(None, -1, None)
    )(directions)
    return _scores(e, S, de, dS, filtered.used)


@eqx.filter_jit
def _evaluate_held_gains(flown, path, point, start_deviation, k, s, means):
    """Cost, approximate gradient and information along a filtered `path`, for a fraction of the time."""
    # The gains are held while the parameters `means` (indices) vary. The parameters of disturbances and noise vary in
    # the filter linearised along the path.
    unit = jnp.eye(len(point))
    means, others = np.array(means, int), np.setdiff1d(np.arange(len(point)), means)
    lin = linearise(flown, point[:k], path.predicted, path.state, unit[means, :k])

    def noise_at(point):
        return disturbances_along(
            flown, point[:k], path.state, start_deviation, jnp.exp(point[k : k + s]), jnp.exp(point[k + s :])
        )

    noise, slopes = jax.vmap(lambda t: jax.jvp(noise_at, (point,), (t,)), out_axes=(None, -1))(unit[others])
    dt = jnp.asarray(flown.dt)
    both, S = linear_innovations(lin, noise, dt)
    de_others, dS_others = noise_derivatives(lin, noise, slopes, dt)
    de = jnp.zeros((*S.shape, len(point))).at[..., means].set(both[..., 1:]).at[..., others].set(de_others)
    dS = jnp.zeros_like(de).at[..., others].set(dS_others)
    return _scores(both[..., 0], S, de, dS, path.used)


def _scores(e, S, de, dS, used):
    """Cost, gradient and expected information from innovations, their variances, and the derivatives of both."""
    weight = jnp.where(used, 1.0 / S, 0.0)
    cost = 0.5 * jnp.sum(jnp.where(used, jnp.log(2.0 * jnp.pi * S) + e**2 / S, 0.0))
    gradient = jnp.einsum("wncj,wnc->j", de, e * weight)
    gradient += 0.5 * jnp.einsum("wncj,wnc->j", dS, weight * (1.0 - e**2 * weight))
    information = jnp.einsum("wnci,wnc,wncj->ij", de, weight, de)
    information += 0.5 * jnp.einsum("wnci,wnc,wncj->ij", dS, weight**2, dS)
    return cost, gradient, information


def fit_prediction_error(
    flown: SegmentTrajectories,
    F: Float[np.ndarray, " s"],
    R: Float[np.ndarray, " c"],
    *,
    start: Float[np.ndarray, " k"] | None = None,
    priors: bool = True,
    exact: bool = True,
) -> PredictionErrorResult:
    """Fit all segments together. The first steps hold the filter's gains while the parameters of the motion vary; the
    last are exact, or left out (`exact` False: consistent estimates). `F` (s,) and `R` (c,) are the noise to start
    from, SI."""
    F = np.asarray(F, float)
    problem = _Problem.of(flown.nameless, F > 0.0, priors)
    free = flown.dynamics.free
    theta = np.array([p.start for p in free]) if start is None else np.asarray(start, float)
    point = np.concatenate([theta, np.log(np.maximum(F, MIN_NOISE)), np.log(np.maximum(R, MIN_NOISE))])
    point[problem.k :] = np.maximum(point[problem.k :], problem.bounds[problem.k :, 0])
    point, current, converged, first_steps = minimise(
        problem, point, problem.evaluate_held_gains, HELD_GAINS_TOLERANCE, APPROXIMATE_SCORING
    )
    steps = 0
    if exact:
        point, current, converged, steps = minimise(problem, point, problem.evaluate, TOLERANCE)
    status = PredictionErrorStatus.CONVERGED if converged else PredictionErrorStatus.NOT_CONVERGED
    if not math.isfinite(current.cost):
        status = PredictionErrorStatus.DIVERGED
    k, s = problem.k, problem.s
    return PredictionErrorResult(
        tuple(p.name for p in free),
        flown.dynamics.states,
        flown.outputs,
        point[:k],
        np.where(F > 0.0, np.exp(point[k : k + s]), 0.0),
        np.exp(point[k + s :]),
        covariance_of(current.information, problem.moving),
        problem.prior_cost(point) - current.cost,
        current.cost,
        problem.path(point)[1],
        status,
        first_steps + steps,
    )


@dataclass(frozen=True)
class _Problem:
    """Minus the log posterior density of j = k + s + c variables: parameters (k), log F (s), log R (c)."""

    flown: SegmentTrajectories
    deviation: Float[Array, " s"]
    moving: Bool[np.ndarray, " j"]
    mean: Float[np.ndarray, " j"]
    precision: Float[np.ndarray, " j"]
    bounds: Float[np.ndarray, "j 2"]
    step_limit: Float[np.ndarray, " j"]
    _last: dict[bytes, tuple[float, Filtered]] = field(default_factory=dict)

    @classmethod
    def of(cls, flown: SegmentTrajectories, disturbed: Bool[np.ndarray, " s"], priors: bool) -> _Problem:
        """Estimate all parameters, the process noise of the `disturbed` states, and R."""
        free, k = flown.dynamics.free, len(flown.dynamics.free)
        deviation = np.zeros(len(disturbed)) if flown.fixed is not None else initial_state_sd(flown.dynamics)
        moving = np.array([*([True] * k), *disturbed, *([True] * len(flown.outputs))])
        mean, precision = np.zeros(len(moving)), np.zeros(len(moving))
        if priors:
            normals = np.array([p.prior.normal for p in free]).reshape(-1, 2)
            mean[:k], precision[:k] = normals[:, 0], normals[:, 1] ** -2.0
        channels, manoeuvre = flown.flights.channels, flown.flights.manoeuvre
        by_manoeuvre = [np.flatnonzero(manoeuvre == number) for number in np.unique(flown.manoeuvre)]
        steps = [min(quantum(np.asarray(channels[n])[rows]) for rows in by_manoeuvre) for n in flown.outputs]  # finest
        smallest = [*[MIN_NOISE] * len(disturbed), *(max(MIN_NOISE, step**2 / ROUNDING_DIVISOR) for step in steps)]
        bounds = np.array([*(p.bounds for p in free), *((np.log(x), np.inf) for x in smallest)])
        limit = np.where(np.arange(len(moving)) < k, np.inf, LOG_STEP_LIMIT)
        return cls(flown, jnp.asarray(deviation), moving, mean, precision, bounds, limit)

    @property
    def k(self) -> int:
        """Number of parameters."""
        return len(self.flown.dynamics.free)

    @property
    def s(self) -> int:
        """Number of states."""
        return len(self.flown.dynamics.states)

    def prior_cost(self, point: Float[np.ndarray, " j"]) -> float:
        """Minus the log of the priors, but for a constant."""
        return 0.5 * float(self.precision @ (point - self.mean) ** 2)

    def cost(self, point: Float[np.ndarray, " j"]) -> float:
        """Minus the log posterior density."""
        return self.path(point)[0] + self.prior_cost(point)

    def path(self, point: Float[np.ndarray, " j"]) -> tuple[float, Filtered]:
        """Minus the log likelihood, and the filtered segments; those of the last point are stored."""
        key = point.tobytes()
        if key not in self._last:
            cost, found = _filter_segments(self.flown, jnp.asarray(point), self.deviation, self.k, self.s)
            self._last.clear()
            self._last[key] = float(cost), found
        return self._last[key]

    def evaluate(self, point: Float[np.ndarray, " j"], held: tuple[Array, ...] | None = None) -> Evaluation:
        """Cost, gradient and expected information; `held`: those of the likelihood, where they are known."""
        likelihood = held or _evaluate(self.flown, jnp.asarray(point), self.deviation, self.k, self.s)
        cost, gradient, information = (np.asarray(x) for x in likelihood)
        gradient, information = gradient + self.precision * (point - self.mean), information + np.diag(self.precision)
        return Evaluation(float(cost) + self.prior_cost(point), gradient, information)

    def evaluate_held_gains(self, point: Float[np.ndarray, " j"]) -> Evaluation:
        """Cost, gradient and information without the derivatives of the gains by the parameters of the motion."""
        dynamics = self.flown.dynamics
        names = dynamics.disturbance_parameters
        means = tuple(i for i, p in enumerate(dynamics.free) if p.name not in names)
        path = self.path(point)[1]
        likelihood = _evaluate_held_gains(self.flown, path, jnp.asarray(point), self.deviation, self.k, self.s, means)
        return self.evaluate(point, likelihood)


def covariance_of(information: Float[np.ndarray, "j j"], moving: Bool[np.ndarray, " j"]) -> Float[np.ndarray, "j j"]:
    """Inverse of the information of the estimated variables; zero for held ones and those without information."""
    # The pseudo-inverse is taken of the matrix scaled to unit diagonal. In SI units it would drop a length in metres
    # beside angles in radians.
    informed = moving & (np.diag(information) > 0.0)
    block = information[np.ix_(informed, informed)]
    scale = np.sqrt(np.outer(np.diag(block), np.diag(block)))
    covariance = np.zeros_like(information)
    covariance[np.ix_(informed, informed)] = np.linalg.pinv(block / scale, hermitian=True) / scale
    return covariance
