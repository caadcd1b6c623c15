"""Maximum likelihood by Gauss-Newton with the output-error cost det R, and Cramer-Rao bounds.

Source: Jategaonkar, *Flight Vehicle System Identification*, 2nd ed. 2015, ch. 4: white residuals, diagonal noise
covariance R re-estimated in every iteration, so the cost is det R and the information is sum S' R^-1 S.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from bayes_aero.arrays import AnyArray
from bayes_aero.dynamics.trim import conditions, steady_flow
from bayes_aero.flight.card import Card
from bayes_aero.flight.health import noise_of
from bayes_aero.flight.record import FlightRecord
from bayes_aero.inference import results
from bayes_aero.inference.covariance import robust_covariance
from bayes_aero.inference.optimise import (
    Evaluation,
    Problem,
    Rule,
    Square,
    Vector,
    at_bounds,
    minimise,
    newton_gain,
    truncated_step,
)
from bayes_aero.model.model import Model
from bayes_aero.model.observations import Observations, observe
from bayes_aero.model.records import Forming
from bayes_aero.parameter import Parameter, Role
from bayes_aero.physics.aircraft import Aircraft
from bayes_aero.processes import Compiled, compiled_at

MAX_ITERATIONS = 100
TOLERANCE = 1e-7  # expected gain in log-likelihood of one more step: 5e-4 Cramer-Rao standard errors
SINGULAR = 1e-11  # smallest eigenvalue of the information scaled to unit diagonal
MAX_SEPARATE_FITS = 24  # manoeuvres that are also fitted one by one
MIN_X_RANGE = 0.05  # range of the separation point over a record below which the stall is not identified


@dataclass(frozen=True)
class Descent:
    """Where Gauss-Newton ended from one start."""

    point: GaussNewtonPoint
    converged: bool
    active: np.ndarray  # whether a parameter is at a bound

    @property
    def theta(self) -> Vector:
        return self.point.theta

    def outcome(self, data: Data) -> str:
        """Degenerate where the separation point does not vary in the fit, or its break angle is at a bound."""
        breaks = [p.role is Role.BREAK_ANGLE for p in data.model.free]
        degenerate = not np.isfinite(self.point.cost)
        if any(breaks) and not degenerate:
            X = np.asarray(evaluate(data, self.theta)[2])
            degenerate = bool(np.any(self.active & breaks) or np.ptp(X) < MIN_X_RANGE)
        return "degenerate" if degenerate else "converged" if self.converged else "not converged"


class _Coefficients(Problem):
    """The cost of a model's coefficients, from the end of full steps; the last point is kept."""

    def __init__(self, data: Data, start: Vector) -> None:
        super().__init__(np.array([p.bounds for p in data.model.free], float).reshape(-1, 2))
        self.data = data
        self.point = self.tried = self._steps(np.clip(start, *self.bounds.T), MAX_ITERATIONS)

    def _steps(self, theta: Vector, most: int) -> GaussNewtonPoint:
        return full_steps(self.data, theta, self.bounds[:, 0], self.bounds[:, 1], TOLERANCE, most)

    def cost(self, point: Vector) -> float:
        self.tried = self.point if point is self.point.theta else self._steps(point, 0)
        return self.tried.cost

    def evaluate(self, point: Vector) -> Evaluation:  # noqa: ARG002 - it is the one tried last
        self.point = self.tried
        return Evaluation(self.point.cost, -self.point.gradient, self.point.information)


SHARES_AND_DAMPINGS = (*((share, 0.0) for share in (1.0, 0.5, 0.25, 0.125)), *((1.0, 10.0**k) for k in range(-3, 6)))
RULE = Rule(truncated_step, newton_gain, lambda _: SHARES_AND_DAMPINGS, last=1e-5, max_steps=MAX_ITERATIONS)


def descend(model: Model, observations: Observations, start: Vector) -> Descent:
    """Gauss-Newton from one start: full step, halved steps, then Levenberg-Marquardt; bounds by an active set."""
    # Full steps run compiled as long as they lower the cost and stay inside the bounds; the remaining steps run here.
    problem = _Coefficients(data_of(model, observations), start)
    first = problem.point
    theta, at, converged, steps = minimise(problem, first.theta, TOLERANCE, RULE, steps=first.steps)
    regular = np.all(np.isfinite(problem.point.information))
    end = problem.point._replace(steps=steps, cost=problem.point.cost if regular else np.inf)
    return Descent(end, converged, at_bounds(problem, theta, at.gradient))


def fit_mle(
    model: Model, observations: Observations, *, extra_starts: int = 6, start: Vector | None = None, seed: int = 0
) -> results.MleResult:
    """Maximum-likelihood estimate of the model's free parameters."""
    # Starts from `start` (default: the card's) and from `extra_starts` draws of the priors, inside the bounds. The
    # result is the optimum with the smallest det R among those in which the separation point varies.
    rng, data = np.random.default_rng(seed), data_of(model, observations)
    starts = [np.array([p.start for p in model.free]) if start is None else np.asarray(start, float)]
    for _ in range(extra_starts):
        starts.append(np.array([np.clip(float(p.prior.sample(rng, 1)[0]), *p.bounds) for p in model.free]))
    runs = [(run, run.outcome(data)) for run in (descend(model, observations, s) for s in starts)]
    regular = [run for run, outcome in runs if outcome != "degenerate"]
    usable = [run for run, outcome in runs if outcome == "converged"] or regular or [run for run, _ in runs]
    table = tuple((run.point.cost, outcome) for run, outcome in runs)
    return _result(data, observations, min(usable, key=lambda run: run.point.cost), bool(regular), table)


def scaled_inverse(A: Square) -> tuple[Square, Vector]:
    """Inverse of an information or covariance, NaN where singular; eigenvalues of A scaled to unit diagonal."""
    scale = np.sqrt(np.maximum(np.diag(A), np.finfo(float).tiny))
    scaled = A / np.outer(scale, scale)
    eigenvalues = np.linalg.eigvalsh(scaled)
    if not np.all(eigenvalues > SINGULAR):
        return np.full_like(A, np.nan), eigenvalues
    return np.linalg.inv(scaled) / np.outer(scale, scale), eigenvalues


def _result(
    data: Data, observations: Observations, best: Descent, regular: bool, table: tuple[tuple[float, str], ...]
) -> results.MleResult:
    model, theta, R, A = data.model, best.theta, best.point.R, best.point.information
    residual, S, X = map(np.asarray, evaluate(data, theta))
    measured = np.asarray(observations.measured)
    inverse, eigenvalues = scaled_inverse(A)
    start = np.asarray(observations.start)
    corrected, blocks = robust_covariance(inverse, S, R, residual, observations.manoeuvre, start, observations.dt)
    sd = np.sqrt(np.diag(corrected))
    status = (
        results.MleStatus.STALL_NOT_IDENTIFIED if not regular
        else results.MleStatus.SINGULAR if not eigenvalues[0] > SINGULAR
        else results.MleStatus.NOT_CONVERGED if not best.converged
        else results.MleStatus.AT_BOUND if best.active.any() else results.MleStatus.CONVERGED
    )  # fmt: skip
    inside, by_coefficient = ~start[1:], dict(zip(observations.coefficients, residual.T, strict=True))
    return results.MleResult(
        parameters=model.free,
        estimate=theta,
        covariance=inverse,
        corrected=corrected,
        R=R,
        status=status,
        iterations=best.point.steps,
        at_bound=tuple(n for n, a in zip(model.names, best.active, strict=True) if a),
        eigenvalues=eigenvalues,
        separation=(float(X.min()), float(X.max())),
        fit={n: results.score(z, z - r) for (n, r), z in zip(by_coefficient.items(), measured.T, strict=True)},
        lag1={n: float(np.sum(r[1:][inside] * r[:-1][inside]) / np.sum(r**2)) for n, r in by_coefficient.items()},
        starts=table,
        blocks=blocks,
        active_bounds=active_bounds(model.free, theta, best.point.gradient, inverse, sd, best.active),
        conflicts=prior_conflicts(model.free, theta, sd) if best.converged else (),
    )


def fit_each_manoeuvre(model: Model, observations: Observations, *, seed: int = 0) -> dict[str, results.MleResult]:
    """Fits of single manoeuvres by name; none where there is only one, or more than `MAX_SEPARATE_FITS`."""
    count = len(observations.names)
    manoeuvres = range(count) if 1 < count <= MAX_SEPARATE_FITS else range(0)
    return {observations.names[i]: fit_mle(model, observations.only(i), seed=seed) for i in manoeuvres}


# --- Bias of the estimates by noise of the recorded signals, and estimates without it.
# The model's inputs are recorded with noise. Least squares on noisy regressors is not consistent, and its residuals
# do not show it: near the stall the noise of the vane biases tau2 and Cmq towards zero by half a standard error.

PAIRS = 5  # of records with the same noise added and subtracted, so that the linear part cancels


def noise_bias(
    estimate: Vector, draw: Callable[[], Any], refit: Callable[[Any, float], np.ndarray | None]
) -> Vector | None:
    """Mean change of an estimate by noise: `refit` adds a `draw` of it, times a sign. None where a fit fails."""
    moves = []
    for _ in range(PAIRS):
        noise = draw()
        for sign in (1.0, -1.0):
            moved = refit(noise, sign)
            if moved is None:
                return None
            moves.append(moved - estimate)
    return np.mean(moves, axis=0)


def without_noise_bias(
    mle: results.MleResult, records: Sequence[FlightRecord], card: Card, model: Model, *, seed: int = 0
) -> results.MleResult:
    """The fit `mle` to the matched coefficients of `records` without the bias by recording noise."""
    # White noise with the standard deviation of each channel's noise is added to the records, and the coefficients are
    # formed and fitted again. The bias is proportional to the variance of the noise, so the estimate changes by about
    # the bias that the recorded noise has caused. This holds to first order; the corrected covariance therefore
    # includes the squared bias. A fit that has not converged, with or without the added noise, is returned unchanged.
    # Source: simulation extrapolation (SIMEX), Cook and Stefanski, J. Am. Stat. Assoc. 89 (1994) 1314.
    if mle.status is not results.MleStatus.CONVERGED:
        return mle
    rng = np.random.default_rng(seed)
    sizes = [{name: noise_of(x) for name, x in record.channels.items()} for record in records]

    def draw() -> list[dict[str, np.ndarray]]:
        pairs = zip(records, sizes, strict=True)
        return [{n: sd * rng.standard_normal(r.n) for n, sd in noise.items() if sd > 0.0} for r, noise in pairs]

    def refit(noise: list[dict[str, np.ndarray]], sign: float) -> np.ndarray | None:
        noisier = [
            replace(record, channels={**record.channels, **{n: record[n] + sign * x for n, x in added.items()}})
            for record, added in zip(records, noise, strict=True)
        ]
        fit = descend(model, observe(noisier, card, model, Forming.MATCHED), mle.estimate)
        return fit.theta if fit.converged and not fit.active.any() else None

    bias = noise_bias(mle.estimate, draw, refit)
    if bias is None:
        return mle
    bounds = np.array([p.bounds for p in model.free]).T
    estimate = np.clip(mle.estimate - bias, *bounds)
    return replace(mle, estimate=estimate, bias=bias, corrected=mle.corrected + np.outer(bias, bias))


# --- Compiled functions of the maximum-likelihood fit: sensitivities of the model, and full Gauss-Newton steps.

ANDERSON_MEMORY = 3  # steps that Anderson acceleration looks back on


class Data(eqx.Module):
    """The observations of a fit with only the signals that the model reads, so that calls transfer little data."""

    signals: dict[str, AnyArray]
    measured: Float[AnyArray, "n c"]
    aircraft: Aircraft
    model: Model = eqx.field(static=True)


def data_of(model: Model, observations: Observations) -> Data:
    """The model with its part of the observations."""
    read = {"alpha", "dt", "start", *model.channels}
    signals = {name: signal for name, signal in observations.signals.items() if name in read}
    signals, measured = jax.device_put((signals, observations.measured))
    return Data(signals, measured, observations.aircraft, model)


class GaussNewtonPoint(NamedTuple):
    """The fit at `theta` after `steps` steps. The gradient is that of the log-likelihood at constant R."""

    theta: Vector
    cost: float  # (n/2) log det R: the concentrated negative log-likelihood without its constant
    R: Float[np.ndarray, " c"]
    information: Square  # sum S' R^-1 S
    gradient: Vector
    steps: int


def _sensitivities(data: Data, theta: Float[Array, " k"]):
    # One parameter at a time, so that JAX omits derivatives that are zero or constant; what the parameters share is
    # compiled once. Parameters come before samples, so that matrix products are contiguous.
    values = data.model.values(theta)

    def predict(name: str, x: Float[Array, ""]) -> tuple[list[Array], Array]:
        flow = data.model.flow(values | {name: x}, data.signals, data.aircraft)
        return [flow[coefficient] for coefficient in data.model.coefficients], flow["X"]

    columns = [jax.jvp(partial(predict, name), (values[name],), (jnp.ones(()),)) for name in data.model.names]
    predicted, X = columns[0][0]
    S = [jnp.stack([slope[i] for _, (slope, _) in columns]) for i in range(len(predicted))]
    return [data.measured[:, i] - y for i, y in enumerate(predicted)], S, X


@Compiled
def evaluate(data: Data, theta: Float[AnyArray, " k"]):
    """Residual (n, c), sensitivities (n, c, k) and separation point (n,); too large to transfer at every step."""
    residual, S, X = _sensitivities(data, theta)
    return jnp.stack(residual, axis=1), jnp.stack([s.T for s in S], axis=1), X


def full_steps(
    data: Data, start: Vector, lower: Vector, upper: Vector, tolerance: float, max_steps: int
) -> GaussNewtonPoint:
    """At most `max_steps` full Gauss-Newton steps from `start`, while each lowers the cost and stays in the bounds."""
    # Their last steps shrink by a constant factor, which Anderson acceleration estimates (Walker and Ni 2011, SIAM J.
    # Numer. Anal. 49, 1715).
    arguments = map(np.asarray, (start, lower, upper, tolerance, max_steps))  # none static: one compilation
    theta, cost, *rest, steps = map(np.asarray, _full_steps(data, *arguments))
    return GaussNewtonPoint(theta, float(cost), *rest, int(steps))  # pyright: ignore[reportCallIssue]


@Compiled
def _full_steps(data: Data, start: Any, lower: Any, upper: Any, tolerance: Any, max_steps: Any):
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


# --- Restraints on estimates: priors that the data contradict, and active bounds.


def prior_conflicts(
    parameters: Sequence[Parameter], estimate: Vector, deviation: Vector
) -> tuple[results.PriorConflict, ...]:
    """Priors that the `estimate` by likelihood alone contradicts, by its corrected standard error; strongest first."""
    conflicts = []
    for p, x, sd in zip(parameters, estimate, deviation, strict=True):
        if p.prior.family == "uniform" or not np.isfinite(sd):
            continue
        mean, wide = p.prior.normal
        difference, scatter = x - mean, sd
        if p.prior.family == "lognormal" and x > 0.0:  # on the scale on which it is normal
            difference = p.prior.location * np.log(x / p.prior.location)
            scatter = sd * p.prior.location / x
        distance = abs(difference) / np.hypot(scatter, wide)
        if distance > results.CONFLICT_LIMIT:
            both = (mean, wide), (float(x), float(sd))
            conflicts.append(results.PriorConflict(p.name, p.unit, *both, float(distance), p.prior.source))
    return tuple(sorted(conflicts, key=lambda c: -c.distance))


def active_bounds(
    parameters: Sequence[Parameter],
    estimate: Vector,
    gradient: Vector,
    inverse: Square,
    deviation: Vector,
    active: np.ndarray,
) -> tuple[results.ActiveBound, ...]:
    """Effect of each active bound on the estimates."""
    # `gradient` of the log-likelihood: zero except for the active parameters. `inverse` of the information, active
    # parameters included. `deviation`: corrected standard errors.
    bounds = []
    for i in map(int, np.flatnonzero(active)):
        step = inverse[:, i] * gradient[i]
        step = step if np.isfinite(step).all() else np.zeros_like(step)
        moves = {p.name: float(step[j] / deviation[j]) for j, p in enumerate(parameters) if j != i and deviation[j] > 0}
        far = [(n, x) for n, x in moves.items() if abs(x) > results.MIN_SHIFT]
        shifts = sorted(far, key=lambda item: -abs(item[1]))
        p, lower, free = parameters[i], bool(gradient[i] < 0.0), float(estimate[i] + step[i])
        bounds.append(results.ActiveBound(p.name, p.unit, p.bounds[0 if lower else 1], lower, free, dict(shifts)))
    return tuple(bounds)


# --- How far the published way of forming coefficients moves their parameters.
# As published, pitch acceleration and the other measured signals are smoothed, and the controls that the model answers
# to are not: what moves fast is then smaller in the measured coefficient than in the modelled one. With every signal
# filtered alike both sides are treated alike.

BEYOND = 2.0  # corrected deviations, from which a move is worth a word


def filter_mismatch_notes(
    records: Sequence[FlightRecord], card: Card, model: Model, mle: results.MleResult
) -> tuple[str, ...]:
    """A sentence where estimates from published coefficients move once all signals are filtered alike."""
    sound = (results.MleStatus.CONVERGED, results.MleStatus.AT_BOUND)
    if mle.status not in sound:
        return ()
    alike = fit_mle(model, observe(records, card, model, Forming.MATCHED), start=mle.estimate, extra_starts=0)
    away = np.abs(alike.estimate - mle.estimate) / np.where(mle.crb_corrected > 0.0, mle.crb_corrected, np.inf)
    far = [i for i in np.argsort(-away) if away[i] > BEYOND]
    if alike.status not in sound or not far:
        return ()
    moves = "; ".join(
        f"{mle.names[i]} would be {alike.estimate[i]:.4g} {mle.units[i] if mle.units[i] != '1' else ''}".rstrip()
        + f" instead of {mle.estimate[i]:.4g} ({away[i]:.1f} corrected standard errors)"
        for i in far
    )
    return (
        "Coefficients are formed as published: measured accelerations are smoothed, control inputs of the model are "
        f"not, and alpha-dot is the derivative of the vane angle. With the same filter on all signals, {moves}. No "
        "interval here includes this difference; without --coefficients published both sides are filtered alike.",
    )


# --- The stall in two numbers with intervals: the highest steady lift coefficient, and the angle of it.
# Quasi-steady: CL(alpha) at alpha-dot = 0 and zero rates, all other signals at their median near the stall. The maximum
# is sought over the recorded angles; where it is at their edge, the record does not contain the stall.

POINTS = 241  # angles: less than 0.1 deg apart over 20 deg, and the maximum is found between them
CURVE_DRAWS = 400
QUANTILES = (0.025, 0.5, 0.975)
RATE_SHARES = (0.05, 0.95)  # quantiles of the recorded alpha-dot at which separation is shown beside the steady one


def stall_of(
    model: Model, draws: Float[np.ndarray, "m k"], signals: Mapping[str, Any], aircraft: Aircraft
) -> results.Stall:
    """The stall over draws of the free parameters (columns as `model.names`), within the angles that `signals` hold."""
    thin = draws[np.unique(np.linspace(0, len(draws) - 1, min(CURVE_DRAWS, len(draws))).astype(int))]
    flown = np.asarray(signals["alpha"])
    alpha = np.linspace(float(flown.min()), float(flown.max()), POINTS)
    low, high = np.quantile(np.asarray(signals["alpha_dot"]), RATE_SHARES)
    rates = np.array([min(low, 0.0), 0.0, max(high, 0.0)])
    reference = conditions(signals)
    given = jax.tree.map(jnp.asarray, (thin, alpha, rates, dict(reference)))
    flows = _flows(model, *given, aircraft)  # pyright: ignore[reportCallIssue]
    X, CL, CD = (np.asarray(flows[name]) for name in ("X", "CL", "CD"))  # (m, rates, angles)
    peak, place, edge = maxima(alpha, CL[:, 1])
    return results.Stall(
        alpha=alpha,
        CL=np.quantile(CL[:, 1], QUANTILES, axis=0),
        CD=np.quantile(CD[:, 1], QUANTILES, axis=0),
        rates=rates,
        X=np.moveaxis(np.quantile(X, QUANTILES, axis=0), 0, 1),
        CL_max=results.Interval.of(peak),
        alpha_max=results.Interval.of(place),
        at_edge=float(np.mean(edge)),
        reference=reference,
    )


def stall_of_run(run: results.Identification) -> results.Stall | None:
    """CLmax and its angle from the first posterior that converged; without one there is none."""
    for key, posterior in run.posteriors.items():
        if key != "white" and posterior.status is results.PosteriorStatus.CONVERGED:
            o = run.observations
            return stall_of(run.model, posterior.draws(run.model.names), o.signals, o.aircraft)
    return None


def maxima(x: Float[np.ndarray, " g"], y: Float[np.ndarray, "m g"]):
    """Maximum of every row, its position (by a parabola through three even points), and whether it is at an edge."""
    rows, i = np.arange(len(y)), np.argmax(y, axis=1)
    edge, j = (i == 0) | (i == len(x) - 1), np.clip(i, 1, len(x) - 2)
    before, here, after = y[rows, j - 1], y[rows, j], y[rows, j + 1]
    bend = before - 2.0 * here + after
    shift = np.divide(0.5 * (before - after), bend, out=np.zeros(len(y)), where=~edge & (bend < 0.0))
    peak = np.where(edge, y[rows, i], here - 0.25 * (before - after) * shift)
    return peak, np.where(edge, x[i], x[j] + shift * (x[1] - x[0])), edge


@compiled_at(0)
def _flows(model, thetas: Float[Array, "m k"], alpha: Float[Array, " g"], rates: Float[Array, " r"], held, aircraft):
    flows = jax.vmap(lambda theta, rate: steady_flow(model, theta, alpha, rate, held, aircraft), in_axes=(None, 0))
    return jax.lax.map(lambda theta: flows(theta, rates), thetas)
