"""Maximum likelihood by Gauss-Newton with the output-error cost det R, and Cramer-Rao bounds.

Source: Jategaonkar, *Flight Vehicle System Identification*, 2nd ed. 2015, ch. 4: white residuals, diagonal noise
covariance R re-estimated in every iteration, so the cost is det R and the information is sum S' R^-1 S.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from bayes_aero.flight.card import Card
from bayes_aero.flight.health.finding import noise_of
from bayes_aero.flight.record import FlightRecord
from bayes_aero.inference.covariance import robust_covariance
from bayes_aero.inference.results import MleResult, MleStatus, active_bounds, prior_conflicts
from bayes_aero.inference.scores import score
from bayes_aero.model.model import Model
from bayes_aero.model.observations import Forming, Observations, observe
from bayes_aero.parameter import Role
from bayes_aero.physics.aircraft import Aircraft

MAX_ITERATIONS = 100
TOLERANCE = 1e-7  # expected gain in log-likelihood of one more step: 5e-4 Cramer-Rao standard errors
SINGULAR = 1e-11  # smallest eigenvalue of the information scaled to unit diagonal
MAX_SEPARATE_FITS = 24  # manoeuvres that are also fitted one by one
MIN_X_RANGE = 0.05  # range of the separation point over a record below which the stall is not identified


@dataclass(frozen=True)
class _Descent:
    point: GaussNewtonPoint
    converged: bool
    iterations: int
    active: np.ndarray  # whether a parameter is at a bound

    @property
    def theta(self) -> Float[np.ndarray, " k"]:
        """The estimate."""
        return self.point.theta

    @property
    def cost(self) -> float:
        """Infinite where the fit is not defined."""
        regular = np.isfinite(self.point.cost) and np.all(np.isfinite(self.point.information))
        return self.point.cost if regular else np.inf

    def regular(self, data: Data) -> bool:
        """Whether the separation point varies in the fit, and its break angle is not at a bound."""
        if not np.isfinite(self.cost):
            return False
        breaks = [p.role is Role.BREAK_ANGLE for p in data.model.free]
        if not any(breaks):
            return True
        X = np.asarray(evaluate(data, jnp.asarray(self.theta))[2])
        return not bool(np.any(self.active & breaks) or np.ptp(X) < MIN_X_RANGE)


def solve(A: np.ndarray, g: np.ndarray, damping: float) -> np.ndarray:
    """(A + damping diag A)^-1 g with unit-diagonal scaling; least squares where A is singular."""
    size, tiny = np.diag(A), np.finfo(float).tiny
    # A diagonal element lost to rounding (unstable flight) is replaced by the largest, so that its row stays finite.
    scale = np.sqrt(np.where(size > 0.0, np.maximum(size, tiny), np.max(size, initial=tiny)))
    scaled = A / np.outer(scale, scale) + damping * np.eye(len(g))
    return np.linalg.lstsq(scaled, g / scale, rcond=1e-14)[0] / scale


def descend(model: Model, observations: Observations, start: Float[np.ndarray, " k"]) -> _Descent:
    """Gauss-Newton from one start: full step, halved steps, then Levenberg-Marquardt; bounds by an active set."""
    # Full steps run compiled as long as they lower the cost and stay inside the bounds; the remaining steps run here.
    data = data_of(model, observations)
    lower, upper = (np.array([p.bounds[i] for p in model.free]) for i in (0, 1))
    point = full_steps(data, np.clip(start, lower, upper), lower, upper, TOLERANCE, MAX_ITERATIONS)
    active = np.zeros(len(start), bool)
    for iteration in range(point.steps + 1, MAX_ITERATIONS + 1):
        theta, A, g = point.theta, point.information, point.gradient
        if not (np.isfinite(point.cost) and np.all(np.isfinite(A))):
            return _Descent(point, False, iteration, active)
        active = ((theta <= lower) & (g < 0.0)) | ((theta >= upper) & (g > 0.0))
        free = np.flatnonzero(~active)
        newton = solve(A[np.ix_(free, free)], g[free], 0.0)
        gain = 0.5 * newton @ g[free]
        if gain < TOLERANCE:
            return _Descent(point, True, iteration, active)
        steps = (newton * size for size in (1.0, 0.5, 0.25, 0.125))
        damped = (solve(A[np.ix_(free, free)], g[free], 10.0**k) for k in range(-3, 6))
        for step in chain(steps, damped):
            trial = theta.copy()
            trial[free] = np.clip(theta[free] + step, lower[free], upper[free])
            found = full_steps(data, trial, lower, upper, TOLERANCE, 0)
            if found.cost < point.cost:
                break
        else:
            return _Descent(point, bool(gain < 1e-5), iteration, active)
        point = found
    return _Descent(point, False, MAX_ITERATIONS, active)


def fit_mle(
    model: Model,
    observations: Observations,
    *,
    extra_starts: int = 6,
    start: Float[np.ndarray, " k"] | None = None,
    seed: int = 0,
) -> MleResult:
    """Maximum-likelihood estimate of the model's free parameters."""
    # Starts from `start` (default: the card's) and from `extra_starts` draws of the priors, inside the bounds. The
    # result is the optimum with the smallest det R among those in which the separation point varies.
    rng, data = np.random.default_rng(seed), data_of(model, observations)
    starts = [np.array([p.start for p in model.free]) if start is None else np.asarray(start, float)]
    for _ in range(extra_starts):
        draw = [float(p.prior.sample(rng, 1)[0]) for p in model.free]
        starts.append(np.array([np.clip(x, *p.bounds) for x, p in zip(draw, model.free, strict=True)]))
    runs = [descend(model, observations, s) for s in starts]
    regular = [run.regular(data) for run in runs]
    usable = [run for run, good in zip(runs, regular, strict=True) if good and run.converged]
    usable = usable or [run for run, good in zip(runs, regular, strict=True) if good] or runs
    table = tuple(
        (run.cost, "degenerate" if not good else "converged" if run.converged else "not converged")
        for run, good in zip(runs, regular, strict=True)
    )
    return _result(data, observations, min(usable, key=lambda run: run.cost), any(regular), table)


def _result(
    data: Data, observations: Observations, best: _Descent, regular: bool, table: tuple[tuple[float, str], ...]
) -> MleResult:
    model, theta, R, A = data.model, best.theta, best.point.R, best.point.information
    residual, S, X = map(np.asarray, evaluate(data, jnp.asarray(theta)))
    measured = np.asarray(observations.measured)
    scale = np.sqrt(np.maximum(np.diag(A), np.finfo(float).tiny))
    eigenvalues = np.linalg.eigvalsh(A / np.outer(scale, scale))
    singular = not eigenvalues[0] > SINGULAR
    inverse = np.full_like(A, np.nan)
    if not singular:
        inverse = np.linalg.inv(A / np.outer(scale, scale)) / np.outer(scale, scale)
    start = np.asarray(observations.start)
    corrected, blocks = robust_covariance(inverse, S, R, residual, observations.manoeuvre, start, observations.dt)
    sd = np.sqrt(np.diag(corrected))
    if not regular:
        status = MleStatus.STALL_NOT_IDENTIFIED
    elif singular:
        status = MleStatus.SINGULAR
    elif not best.converged:
        status = MleStatus.NOT_CONVERGED
    else:
        status = MleStatus.AT_BOUND if best.active.any() else MleStatus.CONVERGED
    inside, by_coefficient = ~start[1:], dict(zip(observations.coefficients, residual.T, strict=True))
    return MleResult(
        parameters=model.free,
        estimate=theta,
        covariance=inverse,
        corrected=corrected,
        R=R,
        status=status,
        iterations=best.iterations,
        at_bound=tuple(n for n, a in zip(model.names, best.active, strict=True) if a),
        eigenvalues=eigenvalues,
        separation=(float(X.min()), float(X.max())),
        fit={n: score(z, z - r) for (n, r), z in zip(by_coefficient.items(), measured.T, strict=True)},
        lag1={n: float(np.sum(r[1:][inside] * r[:-1][inside]) / np.sum(r**2)) for n, r in by_coefficient.items()},
        starts=table,
        blocks=blocks,
        active_bounds=active_bounds(model.free, theta, best.point.gradient, inverse, sd, best.active),
        conflicts=prior_conflicts(model.free, theta, sd) if best.converged else (),
    )


def fit_each_manoeuvre(model: Model, observations: Observations, *, seed: int = 0) -> dict[str, MleResult]:
    """Fits of single manoeuvres by name; none where there is only one, or more than `MAX_SEPARATE_FITS`."""
    count = len(observations.names)
    manoeuvres = range(count) if 1 < count <= MAX_SEPARATE_FITS else range(0)
    return {observations.names[i]: fit_mle(model, observations.only(i), seed=seed) for i in manoeuvres}


# --- Bias of the estimates by noise of the recorded signals, and estimates without it.
# The model's inputs are recorded with noise. Least squares on noisy regressors is not consistent, and its residuals
# do not show it: near the stall the noise of the vane biases tau2 and Cmq towards zero by half a standard error.

PAIRS = 5  # of records with the same noise added and subtracted, so that the linear part cancels


def without_noise_bias(
    mle: MleResult, records: Sequence[FlightRecord], card: Card, model: Model, *, seed: int = 0
) -> MleResult:
    """The fit `mle` to the matched coefficients of `records` without the bias by recording noise."""
    # White noise with the standard deviation of each channel's noise is added to the records, and the coefficients are
    # formed and fitted again. The bias is proportional to the variance of the noise, so the estimate changes by about
    # the bias that the recorded noise has caused. This holds to first order; the corrected covariance therefore
    # includes the squared bias. A fit that has not converged, with or without the added noise, is returned unchanged.
    # Source: simulation extrapolation (SIMEX), Cook and Stefanski, J. Am. Stat. Assoc. 89 (1994) 1314.
    if mle.status is not MleStatus.CONVERGED:
        return mle
    moves, rng = [], np.random.default_rng(seed)
    sizes = [{name: noise_of(x) for name, x in record.channels.items()} for record in records]
    for _ in range(PAIRS):
        noise = [
            {name: sd * rng.standard_normal(record.n) for name, sd in own.items() if sd > 0.0}
            for record, own in zip(records, sizes, strict=True)
        ]
        for sign in (1.0, -1.0):
            noisier = [
                replace(record, channels={**record.channels, **{n: record[n] + sign * x for n, x in own.items()}})
                for record, own in zip(records, noise, strict=True)
            ]
            found = descend(model, observe(noisier, card, model, Forming.MATCHED), mle.estimate)
            if not found.converged or found.active.any():
                return mle
            moves.append(found.theta - mle.estimate)
    bias = np.mean(moves, axis=0)
    bounds = np.array([p.bounds for p in model.free]).T
    estimate = np.clip(mle.estimate - bias, *bounds)
    return replace(mle, estimate=estimate, bias=bias, corrected=mle.corrected + np.outer(bias, bias))


# --- Compiled functions of the maximum-likelihood fit: sensitivities of the model, and full Gauss-Newton steps.

ANDERSON_MEMORY = 3  # steps that Anderson acceleration looks back on


class Data(eqx.Module):
    """The observations of a fit with only the signals that the model reads, so that calls transfer little data."""

    signals: dict[str, Array]
    measured: Float[Array, "n c"]
    aircraft: Aircraft
    model: Model = eqx.field(static=True)


def data_of(model: Model, observations: Observations) -> Data:
    """The model with its part of the observations."""
    read = {"alpha", "dt", "start", *model.channels}
    signals = {name: signal for name, signal in observations.signals.items() if name in read}
    return Data(signals, observations.measured, observations.aircraft, model)


class GaussNewtonPoint(NamedTuple):
    """The fit at `theta` after `steps` steps. The gradient is that of the log-likelihood at constant R."""

    theta: Float[np.ndarray, " k"]
    cost: float  # (n/2) log det R: the concentrated negative log-likelihood without its constant
    R: Float[np.ndarray, " c"]
    information: Float[np.ndarray, "k k"]  # sum S' R^-1 S
    gradient: Float[np.ndarray, " k"]
    steps: int


def _sensitivities(data: Data, theta: Float[Array, " k"]):
    """Per coefficient the residual (n,) and the sensitivities S (k, n); and the separation point (n,)."""
    # One parameter at a time, so that JAX omits derivatives that are zero or constant; what the parameters share is
    # compiled once. Parameters come before samples, so that matrix products are contiguous.
    values = data.model.values(theta)

    def predict(name: str, x: Float[Array, ""]) -> tuple[list[Array], Array]:
        known = data.model.flow(values | {name: x}, data.signals, data.aircraft)
        return [known[coefficient] for coefficient in data.model.coefficients], known["X"]

    columns = [jax.jvp(partial(predict, name), (values[name],), (jnp.ones(()),)) for name in data.model.names]
    predicted, X = columns[0][0]
    S = [jnp.stack([slope[i] for _, (slope, _) in columns]) for i in range(len(predicted))]
    return [data.measured[:, i] - y for i, y in enumerate(predicted)], S, X


@eqx.filter_jit
def evaluate(data: Data, theta: Float[Array, " k"]):
    """Residual (n, c), sensitivities (n, c, k) and separation point (n,); too large to transfer at every step."""
    residual, S, X = _sensitivities(data, theta)
    return jnp.stack(residual, axis=1), jnp.stack([s.T for s in S], axis=1), X


def full_steps(
    data: Data,
    start: Float[np.ndarray, " k"],
    lower: Float[np.ndarray, " k"],
    upper: Float[np.ndarray, " k"],
    tolerance: float,
    max_steps: int,
) -> GaussNewtonPoint:
    """At most `max_steps` full Gauss-Newton steps from `start`, while each lowers the cost and stays within the bounds.

    Gauss-Newton neglects the model's curvature, so its last steps shrink by a constant factor; Anderson acceleration
    (Walker and Ni 2011, SIAM J. Numer. Anal. 49, 1715) estimates that factor from the last steps. The loop ends where
    the expected gain in log-likelihood is below `tolerance`, or before the first step that does not lower the cost.
    With `max_steps` = 0 only `start` is evaluated.
    """
    arguments = map(jnp.asarray, (start, lower, upper, tolerance, max_steps))  # none static: one compilation
    theta, cost, R, information, gradient, steps = map(np.asarray, _full_steps(data, *arguments))
    return GaussNewtonPoint(theta, float(cost), R, information, gradient, int(steps))


@eqx.filter_jit
def _full_steps(data: Data, start: Array, lower: Array, upper: Array, tolerance: Array, max_steps: Array):
    n, k = data.measured.shape[0], start.shape[0]

    def newton(point):
        _, _, _, A, g, _ = point
        scale = jnp.sqrt(jnp.diag(A))
        factor = jnp.linalg.cholesky(A / jnp.outer(scale, scale))  # NaN where singular: the step is then refused
        step = jax.scipy.linalg.cho_solve((factor, True), g / scale) / scale
        return step, 0.5 * step @ g

    def evaluate_at(theta, steps):
        residual, S, _ = _sensitivities(data, theta)
        R = [jnp.mean(r**2) for r in residual]
        information = sum(s @ s.T / v for s, v in zip(S, R, strict=True))
        gradient = sum(s @ r / v for s, r, v in zip(S, residual, R, strict=True))
        R = jnp.stack(R)
        return theta, 0.5 * n * jnp.sum(jnp.log(R)), R, information, gradient, steps

    def accelerated(point, plain, step_memory, change_memory):
        """Anderson's step: that of the combination of the last points at which the next plain step vanishes."""
        weighed = change_memory @ point[3]
        gram = weighed @ change_memory.T
        ridge = jnp.finfo(gram.dtype).eps * jnp.trace(gram) + jnp.finfo(gram.dtype).tiny
        share = jnp.linalg.solve(gram + ridge * jnp.eye(ANDERSON_MEMORY), weighed @ plain)
        step = plain - share @ (step_memory + change_memory)
        return jnp.where(inside(point[0] + step), step, plain)

    def inside(theta):
        return jnp.all((theta > lower) & (theta < upper))

    def body(state):
        point, plain, step, step_memory, change_memory, _ = state
        trial = evaluate_at(point[0] + step, point[-1] + 1)
        first = point[-1] < 0
        accepted = first | (trial[1] < point[1])
        was_plain = jnp.all(step == plain)
        point = jax.tree.map(lambda new, old: jnp.where(accepted, new, old), trial, point)
        new, gain = newton(point)
        stored = accepted & ~first
        step_memory = jnp.where(stored, jnp.roll(step_memory, 1, axis=0).at[0].set(step), 0.0)
        change_memory = jnp.where(stored, jnp.roll(change_memory, 1, axis=0).at[0].set(new - plain), 0.0)
        step = accelerated(point, new, step_memory, change_memory)
        # An accelerated step without gain is discarded with the memory, and the plain step is tried.
        go_on = (accepted | ~was_plain) & inside(point[0] + step) & (gain >= tolerance) & (point[-1] < max_steps)
        return point, new, step, step_memory, change_memory, go_on

    # The loop evaluates the start as the result of a zero step, so that the sensitivities are compiled once.
    no_point = (jnp.asarray(start), jnp.inf, jnp.zeros(data.measured.shape[1]), jnp.eye(k), jnp.zeros(k), -1)
    nothing, empty = jnp.zeros(k), jnp.zeros((ANDERSON_MEMORY, k))
    begin = (no_point, nothing, nothing, empty, empty, True)
    return jax.lax.while_loop(lambda state: state[-1], body, begin)[0]
