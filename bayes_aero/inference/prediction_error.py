"""Prediction error: parameters, process noise and measurement noise, jointly, by the likelihood of the innovations.

The extended Kalman filter's gain varies with time, so that the initial state, missing samples and several sensor rates
are counted for what they are. Fisher scoring on 1/2 sum (log S + e^2 / S) and the priors: an exact gradient, and the
information without derivatives of the gains by the motion. Source: Åström 1980, Automatica 16, 551 (prediction-error
likelihood); Mehra 1971, AIAA J. 9, 28 (in flight test).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int
from scipy.special import betainc
from scipy.stats import beta, norm

from bayes_aero.dynamics.flight import EffectDynamics
from bayes_aero.dynamics.kalman import (
    Filtered,
    disturbances_along,
    filter_segments,
    innovations_density,
    linearise,
    log_likelihood,
    neighbour_correlation,
    scores_along,
)
from bayes_aero.dynamics.segments import SegmentTrajectories, rows_by_core
from bayes_aero.flight.health import quantum
from bayes_aero.inference.covariance import covariance_of, standard_error_of_sum
from bayes_aero.inference.optimise import APPROXIMATE_SCORING, SCORING, Evaluation, Problem, Rule, Vector, minimise
from bayes_aero.inference.output_error import initial_state_sd
from bayes_aero.inference.results import COLOURED_INNOVATIONS, Calibration, OneStep, Posterior, Predicted, Share
from bayes_aero.inference.sampling import EnsembleLength, NutsLength, find_mode, inside, sample_ensemble, sample_nuts
from bayes_aero.model.observations import LogDensity
from bayes_aero.parameter import Parameter, Prior
from bayes_aero.processes import compiled_at, side_by_side
from bayes_aero.progress import Progress, quiet
from bayes_aero.residuals.base import DIRECTIONS_PER_CALL

TOLERANCE = 1e-3  # of the log likelihood
FAR, NEAR = 10.0, 5.0  # nats: below the first the exact gradient is needed, below the second changes of it as well
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
    estimate: Vector
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
        return np.sqrt(np.diag(self.covariance))[: len(self.names)]


def _filter(flown, point, start_deviation, k, s):
    return filter_segments(flown, point[:k], start_deviation, jnp.exp(point[k : k + s]), jnp.exp(point[k + s :]))


@compiled_at(1)
def _filter_segments(flown, point, start_deviation, k, s):
    filtered = _filter(flown, point, start_deviation, k, s)
    return -jnp.sum(jax.vmap(log_likelihood)(filtered)), filtered


@compiled_at(1)
def _gradient(flown, point, start_deviation, k, s):
    """Minus the log likelihood, and its gradient."""
    return jax.value_and_grad(lambda x: -log_likelihood(_filter(flown, x, start_deviation, k, s)))(point)


@compiled_at(1)
def _held_gains(flown, path, point, start_deviation, k, s, directions):
    """Approximate gradient and information along a filtered `path`, in directions (d, j) and (o, j) of the point."""
    # In the first, of the motion, the gains are held; the others are those of disturbances and noise.
    means, others = directions
    lin = linearise(flown, point[:k], path.predicted, path.state, means[:, :k])

    def noise_at(point):
        return disturbances_along(
            flown, point[:k], path.state, start_deviation, jnp.exp(point[k : k + s]), jnp.exp(point[k + s :])
        )

    along = lambda t: jax.jvp(noise_at, (point,), (t,))  # noqa: E731
    noise, slopes = jax.vmap(along, out_axes=(None, -1))(others)
    return scores_along(path, lin, noise, slopes, jnp.asarray(flown.dt))


def start_deviation(flown: SegmentTrajectories) -> Float[np.ndarray, " s"]:
    """Standard deviations of the measured initial state, SI; zero where it is fixed."""
    return initial_state_sd(flown.dynamics) * (flown.fixed is None)


def fit_prediction_error(
    flown: SegmentTrajectories,
    F: Float[np.ndarray, " s"],
    R: Float[np.ndarray, " c"],
    *,
    start: Vector | None = None,
    priors: bool = True,
    held: Collection[str] = (),
) -> PredictionErrorResult:
    """Fit all segments together from the noise `F` (s,) and `R` (c,), SI; `held` parameters stay at their `start`."""
    F, free, dynamics = np.asarray(F, float), flown.dynamics.free, flown.dynamics
    problem, k, s = _Innovations(flown, F > 0.0, priors, held), len(free), len(F)
    theta = np.array([p.start for p in free]) if start is None else np.asarray(start, float)
    logs = np.log(np.maximum(np.concatenate([F, R]), MIN_NOISE))
    point = np.concatenate([theta, np.maximum(logs, problem.bounds[k:, 0])])
    steps, at = 0, Evaluation(math.nan, np.zeros(0), np.zeros((0, 0)))
    for tolerance, rule, evaluate in problem.stages():
        point, at, converged, more = minimise(problem, point, tolerance, rule, evaluate=evaluate)
        steps += more
    information = problem.evaluate_held_gains(point).information if math.isfinite(at.cost) else at.information
    status = PredictionErrorStatus.CONVERGED if converged else PredictionErrorStatus.NOT_CONVERGED
    return PredictionErrorResult(
        names=dynamics.names,
        states=dynamics.states,
        outputs=flown.outputs,
        estimate=point[:k],
        F=np.where(F > 0.0, np.exp(point[k : k + s]), 0.0),
        R=np.exp(point[k + s :]),
        covariance=covariance_of(information, problem.moving),
        log_likelihood=problem.prior_cost(point) - at.cost,
        cost=at.cost,
        found=problem.path(point),
        status=status if math.isfinite(at.cost) else PredictionErrorStatus.DIVERGED,
        iterations=steps,
    )


class _Innovations(Problem):
    """Minus the log posterior density of j = k + s + c variables: parameters (k), log F (s), log R (c)."""

    def __init__(
        self, flown: SegmentTrajectories, disturbed: np.ndarray, priors: bool, held: Collection[str] = ()
    ) -> None:
        free, channels = flown.dynamics.free, flown.flights.channels
        k, s, rest = len(free), len(disturbed), len(disturbed) + len(flown.outputs)
        rows = [np.flatnonzero(flown.flights.manoeuvre == number) for number in np.unique(flown.manoeuvre)]
        finest = (min(quantum(np.asarray(channels[n])[part]) for part in rows) for n in flown.outputs)
        least = [*[MIN_NOISE] * s, *(max(MIN_NOISE, step**2 / ROUNDING_DIVISOR) for step in finest)]
        bounds = np.array([*(p.bounds for p in free), *((np.log(x), np.inf) for x in least)])
        super().__init__(
            bounds, np.array([*(p.name not in held for p in free), *disturbed, *[True] * len(flown.outputs)])
        )
        self.step_limit[k:] = LOG_STEP_LIMIT
        self.mean, self.precision = np.zeros(k + rest), np.zeros(k + rest)
        if priors:
            normals = np.array([p.prior.normal for p in free]).reshape(-1, 2)
            self.mean[:k], self.precision[:k] = normals[:, 0], np.where(self.moving[:k], normals[:, 1] ** -2.0, 0.0)
        self.sizes = jnp.asarray(start_deviation(flown)), k, s
        of_noise = [p.name in flown.dynamics.disturbance_parameters for p in free]
        other = np.array([*of_noise, *[True] * rest])
        self._kinds = [np.flatnonzero(self.moving & mark) for mark in (~other, other)]
        # A few numbers of directions, so that fits with one parameter more share compiled programs.
        size = -(-len(self._kinds[0]) // DIRECTIONS_PER_CALL) * DIRECTIONS_PER_CALL
        self._directions = [np.zeros((max(size, 1), k + rest)), np.zeros((len(self._kinds[1]), k + rest))]
        for directions, kind in zip(self._directions, self._kinds, strict=True):
            directions[np.arange(len(kind)), kind] = 1.0
        self._parts = list[SegmentTrajectories]()
        for number, rows in enumerate(rows_by_core(len(flown.index))):
            part, first = flown.part(rows), number * len(rows)
            new = first + np.arange(len(rows)) < len(flown.index)  # a repeated segment counts nothing
            self._parts.append(jax.device_put(replace(part, inside=part.inside & new[:, None]).nameless))
        self._count, self._compiled = len(flown.index), set[Any]()
        self._last: tuple[bytes, float, list[Filtered]] | None = None
        self._information: np.ndarray | None = None

    def stages(self) -> list[tuple[float, Rule, Callable[[Vector], Evaluation]]]:
        """Tolerance, rule and evaluation of each stage of a fit."""
        return [
            (FAR, APPROXIMATE_SCORING, self.evaluate_held_gains),
            (NEAR, SCORING._replace(quasi_newton=False), self.evaluate),
            (TOLERANCE, SCORING, self.evaluate_gradient),
        ]

    def prior_cost(self, point: Vector) -> float:
        return 0.5 * float(self.precision @ (point - self.mean) ** 2)

    def cost(self, point: Vector) -> float:
        return self.parts_at(point)[0] + self.prior_cost(point)

    def parts_at(self, point: Vector) -> tuple[float, list[Filtered]]:
        """Minus the log likelihood, and the filtered segments by part; those of the last point are stored."""
        if self._last is None or self._last[0] != point.tobytes():
            made = self._each(_filter_segments, point)
            self._last = point.tobytes(), float(sum(float(cost) for cost, _ in made)), [found for _, found in made]
        return self._last[1:]

    def path(self, point: Vector) -> Filtered:
        """All filtered segments."""
        found = self.parts_at(point)[1]
        return jax.tree.map(lambda *x: np.concatenate([np.asarray(y) for y in x])[: self._count], *found)

    def evaluate(self, point: Vector) -> Evaluation:
        """Cost and exact gradient; the expected information without the derivatives of the gains by the motion."""
        self._information = self.evaluate_held_gains(point).information
        return self.evaluate_gradient(point)

    def evaluate_gradient(self, point: Vector) -> Evaluation:
        """Cost and exact gradient, with the information of the last point where it was computed."""
        if self._information is None:
            return self.evaluate(point)
        cost, gradient = (sum(map(np.asarray, x)) for x in zip(*self._each(_gradient, point), strict=True))
        return Evaluation(*self._with_priors(point, cost, gradient), self._information)

    def evaluate_held_gains(self, point: Vector) -> Evaluation:
        """Cost, gradient and expected information, both without the derivatives of the gains by the motion."""
        cost, paths = self.parts_at(point)
        each = self._each(_held_gains, point, paths, self._directions)
        size, (means, others), j = len(self._directions[0]), self._kinds, len(point)
        made, chosen = np.append(np.arange(len(means)), size + np.arange(len(others))), np.append(means, others)
        gradient, information = np.zeros(j), np.diag(self.precision)
        for g, A in each:
            gradient[chosen] += np.asarray(g)[made]
            information[np.ix_(chosen, chosen)] += np.asarray(A)[np.ix_(made, made)]
        return Evaluation(*self._with_priors(point, cost, gradient), information)

    def _each(self, program: Any, point: Vector, paths: Sequence[Filtered] = (), *more: Any) -> list[Any]:
        """A program for every part, one by one where it is not compiled yet."""

        def of(number: int) -> Any:
            path = (paths[number],) if paths else ()
            return jax.block_until_ready(program(self._parts[number], *path, jnp.asarray(point), *self.sizes, *more))

        every = range(len(self._parts))
        made = side_by_side(of, every) if program in self._compiled else list(map(of, every))
        self._compiled.add(program)
        return made

    def _with_priors(self, point: Vector, cost: Any, gradient: Any) -> tuple[float, Vector]:
        return float(cost) + self.prior_cost(point), gradient + self.precision * (point - self.mean)


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
    if not isinstance(dynamics, EffectDynamics) or dynamics.biased:
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
    estimate: Vector,
    R: Float[np.ndarray, " c"],
    *,
    priors: bool = True,
    similar: PredictionErrorResult | None = None,
    held: Collection[str] = (),
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
    return gusty, fit_prediction_error(gusty, F, R, start=start, priors=priors, held=held)


# --- The posterior of a flight fitted with process noise: parameters, process noise and measurement noise, jointly.
# The density is that of the fit, with the parameters' priors instead of their normal approximations, and weak lognormal
# priors of the noise, so that the posterior is proper where a process noise is not distinguishable from zero. A noise
# or gust of hardly any size has a posterior that is flat in its logarithm below what the record can tell, and falls off
# steeply above. Samplers therefore work on the logarithm of small and on the size of large ones (`knee`).

ENGINES = ("emcee", "nuts")  # the faster one first
KNEE_OF_INTENSITY = 0.05  # of the prior's width, see `Parameter.knee`; those of noises are of the median
SPREAD = 2.0  # standard deviation of the logarithm of a process or measurement noise: a factor of 50 either way, 95 %


class InnovationsDensity(LogDensity):
    """Parameters: the dynamics' free ones, F_state (process noise), sigma_output (measurement noise)."""

    flown: SegmentTrajectories
    deviation: tuple[float, ...] = eqx.field(static=True)  # of the measured initial state
    # Medians of the priors: process noise by state (0 where there is none), standard deviations of the measurement
    # noise by output; SI.
    process: tuple[float, ...] = eqx.field(static=True)
    measurement: tuple[float, ...] = eqx.field(static=True)
    noise_label = "white, of states and measurements"  # pyright: ignore[reportAssignmentType]

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        dynamics, motion = self.flown.dynamics, []
        for p in dynamics.free:
            intensity = p.name in dynamics.disturbance_parameters and p.prior.family == "halfnormal"
            motion.append(p.changed(knee=KNEE_OF_INTENSITY * p.prior.scale) if intensity else p)  # it may reach zero
        for kind, text, names, medians, knee in (
            ("F", "process noise of {}, in its unit per square root of a second", dynamics.states, self.process, 0.5),
            ("sigma", "standard deviation of the noise of {}", self.flown.outputs, self.measurement, 0.03),
        ):
            for name, x in zip(names, medians, strict=True):
                if x > 0.0:
                    prior = Prior("lognormal", x, SPREAD, "weak, about output error's residuals; our choice")
                    label = f"{kind}_{name}", "SI", 0.0, x, text.format(name)
                    motion.append(Parameter(*label, prior, (0.0, np.inf), knee=knee * x))
        return tuple(motion)

    @property
    def disturbed(self) -> Int[np.ndarray, " f"]:
        return np.flatnonzero(np.array(self.process) > 0.0)

    def log_likelihood(self, x: Float[Array, " k"]) -> Float[Array, ""]:
        k, c = len(self.flown.dynamics.free), len(self.flown.outputs)
        F = jnp.zeros(len(self.process)).at[self.disturbed].set(x[k:-c])
        total = innovations_density(self.flown, x[:k], jnp.asarray(self.deviation), F, x[-c:] ** 2)
        return jnp.where(jnp.isfinite(total), total, -jnp.inf)

    def start(self, fit: PredictionErrorResult) -> Float[np.ndarray, " k"]:
        least = np.exp(-2.0 * SPREAD)  # times the median: a process noise of the fit may vanish, a lognormal does not
        F = np.maximum(fit.F, least * np.array(self.process))[self.disturbed]
        free = zip(fit.estimate, self.flown.dynamics.free, strict=True)
        return np.array([*(inside(value, p.bounds) for value, p in free), *F, *np.sqrt(fit.R)])


class PosteriorLength(NamedTuple):
    """Chains of both samplers for densities that take milliseconds: two each, one for each core of a small machine."""

    # The mode gives the scale well: only a step size is adapted.
    nuts: NutsLength = NutsLength(chains=2, warmup=200, max_blocks=5, acceptance=0.8, metric=False)
    emcee: EnsembleLength = EnsembleLength(ensembles=2, max_steps=600)


def sample_innovations(
    flown: SegmentTrajectories,
    fit: PredictionErrorResult,
    R: Float[np.ndarray, " c"],
    *,
    seed: int = 0,
    length: PosteriorLength = PosteriorLength(),
    engines: Sequence[str] = ENGINES,
    progress: Progress = quiet,
) -> dict[str, Posterior]:
    """The posterior by these `engines`, from the `fit` (with priors) of `fit_disturbed`."""
    density = innovations_posterior(flown, R)
    mode = find_mode(density, density.start(fit))
    options: Any = {"seed": seed, "progress": progress, "predictive": False}
    samplers = {
        "emcee": lambda: sample_ensemble(density, mode, length=length.emcee, **options),
        "nuts": lambda: sample_nuts(density, mode, length=length.nuts, **options),
    }
    return {engine: samplers[engine]() for engine in engines}


def innovations_posterior(flown: SegmentTrajectories, R: Float[np.ndarray, " c"]) -> InnovationsDensity:
    """The density; `R` (c,) are variances of output error's residuals. A fixed initial state has no deviation."""
    # Medians of the noise are `FIRST_F` and `FIRST_R` as at the start of the fit; states without a sensor have none.
    dynamics, deviation = flown.dynamics, start_deviation(flown)
    sd = dict(zip(flown.outputs, map(float, np.sqrt(R)), strict=True))
    process = tuple(FIRST_F * sd[name] if name in sd else 0.0 for name in dynamics.states)
    measurement = tuple(float(np.sqrt(FIRST_R)) * sd[name] for name in flown.outputs)
    return InnovationsDensity(flown.nameless, tuple(map(float, deviation)), process, measurement)


# --- Whether a filter's one-step predictions are calibrated: shares of innovations inside predictive intervals.
# Each innovation is predicted from the samples before it and from the outputs before it in its own sample. Where model
# and noise are right, innovations over their predicted standard deviations are independent and standard normal, and
# their probability integral transforms are uniform. Where process noise and measurement noise were fitted to the same
# record, the mean square of the scaled innovations is near 1, and the shares test the shape of the distribution.
# Sources: Dawid 1984, J. R. Stat. Soc. A 147, 278; Diebold, Gunther and Tay 1998, Int. Econ. Rev. 39, 863.

LEVELS = (0.5, 0.9, 0.95, 0.99)  # of central predictive intervals
SIGNIFICANCE = 0.05  # rate of false alarms for calibrated predictions, all outputs and levels together
MIN_INDEPENDENT = 30  # independent innovations below which calibration is undecided; our choice
NORMAL_SCORES = np.arange(-3.0, 3.01, 0.25)  # at which quantiles are compared
MIN_BEYOND = 2.0  # least number of innovations beyond a quantile
TINY = 1e-12


def one_step(filtered: Filtered, errors: Float[np.ndarray, "w n c"], outputs: Sequence[str]) -> OneStep:
    """One-step predictions of w filtered segments, from errors (w, n, c), of outputs with two innovations or more."""
    z, correlation = standardised(filtered), neighbour_correlation(filtered)
    columns = [c for c in range(len(outputs)) if np.isfinite(z[..., c]).sum() > 1]
    tests = len(LEVELS) * (len(columns) + (len(columns) > 1))
    by_output = {}
    for c in columns:
        rms = float(np.sqrt(np.nanmean(np.square(np.asarray(errors)[..., c]))))
        coloured = bool(abs(correlation[c]) > COLOURED_INNOVATIONS)
        by_output[outputs[c]] = _assess(z[..., [c]], rms, coloured, tests)
    return OneStep(by_output, _assess(z[..., columns], None, False, tests))


def standardised(filtered: Filtered) -> Float[np.ndarray, "w n c"]:
    """Innovations over their predicted standard deviations, NaN where nothing was measured."""
    z = np.asarray(filtered.innovation) / np.sqrt(np.asarray(filtered.variance))
    return np.where(np.asarray(filtered.used), z, np.nan)


def _assess(z: Float[np.ndarray, "w n c"], rms: float | None, coloured: bool, tests: int) -> Predicted:
    used, u = np.isfinite(z), norm.cdf(z)
    n, squares = int(used.sum()), np.where(used, np.square(z), 0.0)
    mean = squares.sum() / n
    centred = np.where(used, squares - mean, 0.0)
    inflation = _inflation(centred, used) or 1.0
    ratio = float(np.sqrt(mean))
    ratio_sd = float(np.sqrt(inflation * np.sum(centred**2)) / n) / max(2.0 * ratio, TINY)
    shares, independent = [], n / inflation
    for level in LEVELS:
        inside = used & (np.abs(u - 0.5) <= 0.5 * level)
        share = float(inside.sum() / n)
        inflation = _inflation(np.where(used, inside - share, 0.0), used) or inflation
        spread = max(share * (1.0 - share), level * (1.0 - level))
        # Two-sided binomial p-value of independent innovations; by the beta distribution, for they are no whole number.
        alone = n / inflation
        missed, chance = (1.0 - share) * alone, 1.0 - level
        at_most = float(betainc(max(alone - missed, TINY), missed + 1.0, level))
        at_least = float(betainc(max(missed, TINY), alone - missed + 1.0, chance))
        p = min(1.0, 2.0 * min(at_most, at_least))
        shares.append(Share(level, share, float(np.sqrt(inflation * spread / n)), p))
        independent = min(independent, alone)
    differences = [s.share - s.level for s in shares if s.p < SIGNIFICANCE / tests]
    calibration = (
        Calibration.COLOURED if coloured and not differences
        else Calibration.UNDECIDED if independent < MIN_INDEPENDENT
        else Calibration.CALIBRATED if not differences
        else Calibration.TOO_NARROW if max(differences) < 0.0
        else Calibration.TOO_WIDE if min(differences) > 0.0 else Calibration.NOT_NORMAL
    )  # fmt: skip
    # Quantiles: order statistics of as many uniform values as there are independent innovations (Bonferroni).
    scores, rows = NORMAL_SCORES[n * norm.sf(np.abs(NORMAL_SCORES)) >= MIN_BEYOND], []
    tail, q_of = 0.5 * SIGNIFICANCE / max(len(scores), 1), norm.cdf(scores)
    for normal_score, value, q in zip(scores, np.quantile(z[used], q_of), q_of, strict=True):
        below = used & (z <= value)
        alone = n / (_inflation(np.where(used, below - below.sum() / n, 0.0), used) or 1.0)
        band = beta.ppf([tail, 1.0 - tail], q * (alone + 1.0), (1.0 - q) * (alone + 1.0))
        rows.append([normal_score, value, *norm.ppf(band)])
    return Predicted(n, rms, (ratio, ratio_sd), tuple(shares), calibration, np.array(rows).reshape(-1, 4))


def _inflation(centred: Float[np.ndarray, "w n c"], used: Bool[np.ndarray, "w n c"]) -> float | None:
    """Variance inflation of the sum of `centred` (zero: not measured) by all correlation, >= 1; None if it is zero."""
    white = float(np.sum(centred**2))
    if white <= TINY:
        return None
    lengths = [int(np.max(np.flatnonzero(some), initial=-1)) + 1 for some in np.any(used, axis=2)]
    series = np.concatenate([one[:length].sum(axis=1) for one, length in zip(centred, lengths, strict=True)])
    return max(1.0, standard_error_of_sum(series, [length for length in lengths if length]) ** 2 / white)
