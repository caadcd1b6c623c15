"""Maximum likelihood by Gauss-Newton with the output-error cost det R, and Cramer-Rao bounds.

Source: Jategaonkar, *Flight Vehicle System Identification*, 2nd ed. 2015, ch. 4: white residuals, diagonal noise
covariance R re-estimated in every iteration, so the cost is det R and the information is sum S' R^-1 S.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import chain

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from bayes_aero.inference.likelihood.mle_result import MleResult, MleStatus
from bayes_aero.inference.likelihood.restraints import active_bounds, prior_conflicts
from bayes_aero.inference.likelihood.sensitivity import data_of, evaluate, full_steps
from bayes_aero.inference.scores import score
from bayes_aero.inference.variance.robust_bounds import robust_covariance
from bayes_aero.model.model import Model
from bayes_aero.model.observations import Observations
from bayes_aero.parameter import Role

MAX_ITERATIONS = 100
TOLERANCE = 1e-7  # expected gain in log-likelihood of one more step: 5e-4 Cramer-Rao standard errors
SINGULAR = 1e-11  # smallest eigenvalue of the information scaled to unit diagonal
MAX_SEPARATE_FITS = 24  # manoeuvres that are also fitted one by one
MIN_X_RANGE = 0.05  # range of the separation point over a record below which the stall is not identified


@dataclass(frozen=True)
class _Descent:
    theta: Float[np.ndarray, " k"]
    cost: float
    converged: bool
    iterations: int
    active: np.ndarray


def solve(A: np.ndarray, g: np.ndarray, damping: float) -> np.ndarray:
    """(A + damping diag A)^-1 g with unit-diagonal scaling; least squares where A is singular."""
    size, tiny = np.diag(A), np.finfo(float).tiny
    # A diagonal element lost to rounding (unstable flight) is replaced by the largest, so that its row stays finite.
    scale = np.sqrt(np.where(size > 0.0, np.maximum(size, tiny), np.max(size, initial=tiny)))
    scaled = A / np.outer(scale, scale) + damping * np.eye(len(g))
    return np.linalg.lstsq(scaled, g / scale, rcond=1e-14)[0] / scale


def descend(model: Model, observations: Observations, start: Float[np.ndarray, " k"]) -> _Descent:
    """Gauss-Newton from one start: full step, halved steps, then Levenberg-Marquardt; bounds by an active set.

    Full steps run compiled as long as they lower the cost and stay inside the bounds; the remaining steps run here.
    """
    data = data_of(model, observations)
    lower, upper = (np.array([p.bounds[i] for p in model.free]) for i in (0, 1))
    point = full_steps(data, np.clip(start, lower, upper), lower, upper, TOLERANCE, MAX_ITERATIONS)
    active = np.zeros(len(start), bool)
    for iteration in range(point.steps + 1, MAX_ITERATIONS + 1):
        theta, A, g = point.theta, point.information, point.gradient
        if not (np.isfinite(point.cost) and np.all(np.isfinite(A))):
            return _Descent(theta, np.inf, False, iteration, active)
        active = ((theta <= lower) & (g < 0.0)) | ((theta >= upper) & (g > 0.0))
        free = np.flatnonzero(~active)
        newton = solve(A[np.ix_(free, free)], g[free], 0.0)
        gain = 0.5 * newton @ g[free]
        if gain < TOLERANCE:
            return _Descent(theta, point.cost, True, iteration, active)
        steps = (newton * size for size in (1.0, 0.5, 0.25, 0.125))
        damped = (solve(A[np.ix_(free, free)], g[free], 10.0**k) for k in range(-3, 6))
        for step in chain(steps, damped):
            trial = theta.copy()
            trial[free] = np.clip(theta[free] + step, lower[free], upper[free])
            found = full_steps(data, trial, lower, upper, TOLERANCE, 0)
            if found.cost < point.cost:
                break
        else:
            return _Descent(theta, point.cost, bool(gain < 1e-5), iteration, active)
        point = found
    return _Descent(point.theta, point.cost, False, MAX_ITERATIONS, active)


def _starts(model: Model, count: int, seed: int) -> list[np.ndarray]:
    """The card's start, then draws from the priors inside the bounds."""
    rng = np.random.default_rng(seed)
    starts = [np.array([p.start for p in model.free])]
    for _ in range(count):
        draw = [float(p.prior.sample(rng, 1)[0]) for p in model.free]
        starts.append(np.array([np.clip(x, *p.bounds) for x, p in zip(draw, model.free, strict=True)]))
    return starts


def _degenerate(model: Model, observations: Observations, descent: _Descent) -> bool:
    """Whether the separation point is constant in the fit, or its break angle is at a bound."""
    if not np.isfinite(descent.cost):
        return True
    breaks = [p.role is Role.BREAK_ANGLE for p in model.free]
    if not any(breaks):
        return False
    X = np.asarray(evaluate(data_of(model, observations), jnp.asarray(descent.theta))[2])
    return bool(np.any(descent.active & breaks) or np.ptp(X) < MIN_X_RANGE)


def fit_mle(
    model: Model,
    observations: Observations,
    *,
    extra_starts: int = 6,
    start: Float[np.ndarray, " k"] | None = None,
    seed: int = 0,
) -> MleResult:
    """Maximum-likelihood estimate of the model's free parameters.

    Starts from `start` (default: the card's) and from `extra_starts` prior draws. The result is the optimum with the
    smallest det R among those in which the separation point varies.
    """
    starts = _starts(model, extra_starts, seed)
    if start is not None:
        starts[0] = np.asarray(start, float)
    runs = [descend(model, observations, s) for s in starts]
    regular = [not _degenerate(model, observations, run) for run in runs]
    usable = [run for run, good in zip(runs, regular, strict=True) if good and run.converged]
    usable = usable or [run for run, good in zip(runs, regular, strict=True) if good] or runs
    best = min(usable, key=lambda run: run.cost)
    table = tuple(
        (run.cost, "degenerate" if not good else "converged" if run.converged else "not converged")
        for run, good in zip(runs, regular, strict=True)
    )
    return _result(model, observations, best, any(regular), table)


def fit_each_manoeuvre(model: Model, observations: Observations, *, seed: int = 0) -> dict[str, MleResult]:
    """Fits of single manoeuvres by name; none where there is only one, or more than `MAX_SEPARATE_FITS`.

    Each length of a manoeuvre is compiled again, which takes some seconds.
    """
    count = len(observations.names)
    manoeuvres = range(count) if 1 < count <= MAX_SEPARATE_FITS else range(0)
    return {observations.names[i]: fit_mle(model, observations.only(i), seed=seed) for i in manoeuvres}


def _result(
    model: Model, observations: Observations, best: _Descent, regular: bool, table: Sequence[tuple[float, str]]
) -> MleResult:
    data = data_of(model, observations)
    point = full_steps(data, best.theta, best.theta, best.theta, TOLERANCE, 0)
    R, A = point.R, point.information
    residual, S, X = map(np.asarray, evaluate(data, jnp.asarray(best.theta)))
    measured = np.asarray(observations.measured)
    scale = np.sqrt(np.maximum(np.diag(A), np.finfo(float).tiny))
    eigenvalues = np.linalg.eigvalsh(A / np.outer(scale, scale))
    singular = not eigenvalues[0] > SINGULAR
    inverse = np.full_like(A, np.nan)
    if not singular:
        inverse = np.linalg.inv(A / np.outer(scale, scale)) / np.outer(scale, scale)
    corrected, blocks = robust_covariance(
        inverse, S, R, residual, observations.manoeuvre, np.asarray(observations.start), observations.dt
    )
    if not regular:
        status = MleStatus.STALL_NOT_IDENTIFIED
    elif singular:
        status = MleStatus.SINGULAR
    elif not best.converged:
        status = MleStatus.NOT_CONVERGED
    else:
        status = MleStatus.AT_BOUND if best.active.any() else MleStatus.CONVERGED
    inside = ~np.asarray(observations.start)[1:]
    lag1 = {
        name: float(np.sum(r[1:][inside] * r[:-1][inside]) / np.sum(r**2))
        for name, r in zip(observations.coefficients, residual.T, strict=True)
    }
    return MleResult(
        parameters=model.free,
        estimate=best.theta,
        covariance=inverse,
        corrected=corrected,
        R=R,
        status=status,
        iterations=best.iterations,
        at_bound=tuple(n for n, a in zip(model.names, best.active, strict=True) if a),
        eigenvalues=eigenvalues,
        separation=(float(X.min()), float(X.max())),
        fit={
            n: score(measured[:, i], measured[:, i] - residual[:, i]) for i, n in enumerate(observations.coefficients)
        },
        lag1=lag1,
        starts=tuple(table),
        blocks=blocks,
        active_bounds=active_bounds(
            model.free, best.theta, point.gradient, inverse, np.sqrt(np.diag(corrected)), best.active
        ),
        conflicts=prior_conflicts(model.free, best.theta, np.sqrt(np.diag(corrected))) if best.converged else (),
    )
