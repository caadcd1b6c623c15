"""Output error: fit of parameters and initial states to measured trajectories.

Gauss-Newton with Levenberg and Marquardt's damping on exact forward sensitivities; diagonal R re-estimated each step
(cost det R). Source: Jategaonkar, *Flight Vehicle System Identification*, 2nd ed. 2015, ch. 4.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float
from scipy.optimize import minimize_scalar

from bayes_aero.arrays import AnyArray
from bayes_aero.dynamics.aircraft import POINTS
from bayes_aero.dynamics.flight import Dynamics, biased_dynamics
from bayes_aero.dynamics.segments import SegmentTrajectories, Simulated, rows_by_core, simulate
from bayes_aero.inference.covariance import BLOCK, LinearFit, calibration, covariance_of, means, segments_corrected
from bayes_aero.inference.optimise import (
    MAX_TRIALS,
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
from bayes_aero.inference.results import Inseparable, OutputErrorStatus, inseparable
from bayes_aero.parameter import Parameter, Prior
from bayes_aero.processes import Compiled, compiled_at, side_by_side

OfStates = Float[np.ndarray, "w s"]

# --- Normal equations of a step: inner products of residuals and sensitivities, with the priors.
# Each segment has its own initial state, which is eliminated from the equations of that segment.

INITIAL_STATE_SD = {"airspeed": 1.0, "alpha": 0.01, "theta": 0.01, "q": 0.01, "altitude": 3.0} | dict.fromkeys(
    POINTS, 0.1
)
"""Standard deviation of the measured initial state, SI: the accuracy of flight-test sensors; our choice."""
SD_BY_UNIT = {"m/s": 1.0, "m": 3.0}  # of states with another name, by unit: else 0.05
TINY, MAX_GRAM = 1e-300, 1e100  # least variance; inner products beyond which the motion is not unique
REGULARISATION = 1e-12  # added to a diagonal, relative: above rounding, below the information of any record
ENVELOPE_PENALTY = 1e6  # cost of a trajectory that is wholly outside the envelope: worse than any inside


def initial_state_sd(dynamics: Dynamics) -> Float[np.ndarray, " s"]:
    """Standard deviations of the measured initial state, SI."""
    units = dynamics.units
    return np.array([INITIAL_STATE_SD.get(n, SD_BY_UNIT.get(units.get(n, ""), 0.05)) for n in dynamics.start])


@dataclass(frozen=True)
class NormalPriors:
    """Normal priors; the precisions are times `weight`, the variance inflation of coloured residuals (0: none)."""

    mean: Float[np.ndarray, " k"]  # of theta
    precision: Float[np.ndarray, " k"]
    states: Float[np.ndarray, " s"]  # precision of the corrections of the initial states
    weight: float = 1.0
    fixed: bool = False  # the initial states are not corrected

    @classmethod
    def of(cls, flown: SegmentTrajectories, weight: float, without: Collection[str] = ()) -> NormalPriors:
        """Normal approximations of all priors, times `weight`; the parameters `without` have no prior."""
        pairs = np.array([p.prior.normal for p in flown.dynamics.free]).reshape(-1, 2)
        deviations = initial_state_sd(flown.dynamics)
        with_prior = np.array([p.name not in without for p in flown.dynamics.free], float)
        precisions = weight * with_prior * pairs[:, 1] ** -2.0, weight * deviations**-2.0
        return cls(pairs[:, 0], *precisions, weight, flown.fixed is not None)


@Compiled
def _inner_products(flown: SegmentTrajectories, theta: Float[AnyArray, " k"], departure: Float[AnyArray, "w s"]):
    """Gram matrices, samples inside the envelope, and columns; forward sensitivities, all directions at once."""
    k, s = theta.shape[0], departure.shape[1]

    def residual(theta, shared):
        simulated = simulate(flown, theta, departure + shared)
        return simulated.residual, simulated.trajectory.inside

    point = (theta, jnp.zeros(s))
    towards = (jnp.concatenate([jnp.eye(k), jnp.zeros((s, k))]), jnp.concatenate([jnp.zeros((k, s)), jnp.eye(s)]))
    r, slope, inside = jax.vmap(lambda t: jax.jvp(residual, point, t, has_aux=True), out_axes=(None, -1, None))(towards)
    columns = jnp.concatenate([r[..., None], -slope], axis=-1) / flown.noise_growth[..., None]  # w n c j
    return jnp.einsum("wnci,wncj->wcij", columns, columns), jnp.sum(inside & flown.inside, axis=1), columns


class NormalEquations:
    """Normal equations of one set of segments, evaluated at many points; the segments are divided among the cores."""

    # A part without samples is not simulated.
    def __init__(self, flown: SegmentTrajectories, prior: NormalPriors):
        self.prior = prior
        self.count = flown.inside.sum(axis=1).astype(float)
        self.noise_growth = float(np.log(flown.noise_growth[flown.inside]).sum())
        self._rows = rows_by_core(len(flown.index))
        self._parts = {
            number: jax.device_put(flown.nameless.part(rows))
            for number, rows in enumerate(self._rows)
            if flown.inside[rows].any()
        }

    def evaluate(self, theta: Vector, departure: OfStates) -> Point:
        def products(number: int) -> tuple[np.ndarray, ...]:
            if number not in self._parts:
                return ()
            begin = departure[self._rows[number]]
            return tuple(np.asarray(x) for x in _inner_products(self._parts[number], theta, begin))

        evaluated = side_by_side(products, range(len(self._rows)))
        zeros = tuple(np.zeros_like(x) for x in next(filter(None, evaluated)))
        every_part = zip(*(part or zeros for part in evaluated), strict=True)
        gram, within, columns = (np.concatenate(x)[: len(departure)] for x in every_part)
        return self._point(theta, departure, gram, columns, float(within.sum() / self.count.sum()))

    def extrapolate(self, point: Point, step: Vector, of_states: OfStates) -> Point:
        """Normal equations after a short step of parameters and initial states, with residuals linear in the step."""
        all_steps = np.concatenate([np.tile(step, (len(of_states), 1)), of_states], axis=1)
        transform = np.tile(np.eye(1 + all_steps.shape[1]), (len(of_states), 1, 1))
        transform[:, 1:, 0] = -all_steps
        gram = np.einsum("wia,wcij,wjb->wcab", transform, point.gram, transform, optimize=True)
        columns = point.columns.copy()
        columns[..., 0] -= np.einsum("wncj,wj->wnc", point.columns[..., 1:], all_steps)
        return self._point(point.theta + step, point.departure + of_states, gram, columns, point.inside)

    def _point(self, theta: Vector, departure: OfStates, gram: np.ndarray, columns: np.ndarray, inside: float) -> Point:
        prior, total = self.prior, self.count.sum()
        if not np.all(np.abs(gram) < MAX_GRAM):
            return Point(theta, departure, gram, columns, 0.0, np.ones(gram.shape[1]), math.inf)
        R = np.maximum(gram[:, :, 0, 0].sum(axis=0) / total, TINY)
        cost = 0.5 * total * float(np.sum(np.log(R))) + self.noise_growth
        of_theta, of_states = prior.precision @ (theta - prior.mean) ** 2, np.sum(departure**2 @ prior.states)
        cost += 0.5 * float(of_theta) + 0.5 * float(of_states)
        return Point(theta, departure, gram, columns, inside, R, cost + ENVELOPE_PENALTY * (1.0 - inside))


class Point(NamedTuple):
    """Normal equations at one point, of w segments, c outputs, k parameters, s initial states; j = 1 + k + s."""

    theta: Vector
    departure: OfStates  # corrections of the initial states
    gram: Float[np.ndarray, "w c j j"]  # inner products of residuals and sensitivities: the residual comes first
    columns: Float[np.ndarray, "w n c j"]  # these, over the noise growth
    inside: float  # share of the samples inside the envelope
    R: Float[np.ndarray, " c"]
    cost: float


class EliminatedStates(NamedTuple):
    """Eliminated initial states of the segments, as functions of the step of theta."""

    inverse: Float[np.ndarray, "w s s"]
    cross: Float[np.ndarray, "w s k"]
    gradient: OfStates
    gain: float

    def step(self, theta: Vector) -> OfStates:
        return np.einsum("wij,wj->wi", self.inverse, self.gradient - self.cross @ theta)


def reduced_equations(point: Point, prior: NormalPriors) -> tuple[Square, Vector, EliminatedStates]:
    """Information and gradient of theta with the initial states eliminated, including the priors."""
    A, g, states = segment_equations(point, prior)
    A = A.sum(axis=0) + np.diag(prior.precision)
    return A, g.sum(axis=0) - prior.precision * (point.theta - prior.mean), states


def segment_equations(
    point: Point, prior: NormalPriors
) -> tuple[Float[np.ndarray, "w k k"], Float[np.ndarray, "w k"], EliminatedStates]:
    """Information and gradient of theta by segment with the initial states eliminated, without the priors of theta."""
    k = len(point.theta)
    N = np.einsum("wcij,c->wij", point.gram, 1.0 / point.R)
    if prior.fixed:
        w, s = point.departure.shape
        states = EliminatedStates(np.zeros((w, s, s)), np.zeros((w, s, k)), np.zeros((w, s)), 0.0)
        return N[:, 1 : k + 1, 1 : k + 1], N[:, 1 : k + 1, 0], states
    of_states = N[:, k + 1 :, k + 1 :] + np.diag(prior.states)
    cross, gradient = N[:, k + 1 :, 1 : k + 1], N[:, k + 1 :, 0] - prior.states * point.departure
    # Cholesky factors keep the digits of A - cross' own^-1 cross where a trial is unstable.
    identity = np.eye(of_states.shape[-1])
    of_states = of_states + identity * (of_states == 0.0)  # a state without information and prior is not corrected
    try:
        L = np.linalg.cholesky(of_states)
    except np.linalg.LinAlgError:  # rounding makes the matrix of an unstable flight indefinite
        L = np.linalg.cholesky(of_states + REGULARISATION * of_states * identity)
    Y, y = np.linalg.solve(L, cross), np.linalg.solve(L, gradient[:, :, None])[:, :, 0]
    A = N[:, 1 : k + 1, 1 : k + 1] - np.einsum("wia,wib->wab", Y, Y)
    g = N[:, 1 : k + 1, 0] - np.einsum("wia,wi->wa", Y, y)
    inverse = np.linalg.inv(L)
    inverse = np.swapaxes(inverse, 1, 2) @ inverse
    return A, g, EliminatedStates(inverse, cross, gradient, 0.5 * float(np.sum(y**2)))


# --- The result of an output-error fit: estimates, standard errors for white and coloured residuals, a status.

INDEFINITE = -1e-14  # eigenvalues of a scaled information matrix below this are not rounding errors
SINGULAR = 1e-13  # least eigenvalue of a regular scaled information matrix
MIN_COMPONENT = 1e-3  # least component of a singular direction from which a parameter is undetermined
PRIOR_RATIO = 0.9  # posterior over prior standard deviation from which a parameter is held by its prior


@dataclass(frozen=True)
class OutputErrorResult:
    """An output-error fit: estimates of k parameters and of the initial state of each segment, in SI and radians.

    `covariance` (k, k) is that of Cramer and Rao with priors, `information` (k, k) that of the data alone. `rms` is by
    segment and output, in the recorded unit. `columns` are residual and sensitivities (parameters, then initial state),
    both divided by the noise growth `flown.noise_growth`; `R` is the residual variance in attached flow.
    """

    flown: SegmentTrajectories
    parameters: tuple[Parameter, ...]
    estimate: Vector
    departure: OfStates
    R: Float[np.ndarray, " c"]
    cost: float
    covariance: Square
    information: Square
    priors: NormalPriors
    rms: Float[np.ndarray, "w c"]
    status: OutputErrorStatus
    iterations: int
    at_bound: tuple[str, ...]
    columns: Float[np.ndarray, "w n c j"]
    eliminated: Float[np.ndarray, "w s k"]  # minus the derivative of the optimal initial states by theta
    undetermined: tuple[str, ...] = ()  # parameters without prior that the record does not determine

    @property
    def det_R(self) -> float:
        """Determinant of the diagonal residual covariance of the outputs, SI: the cost of published programs."""
        count = self.flown.inside.sum(axis=1)
        return float(np.prod(np.sum(count[:, None] * self.rms**2, axis=0) / count.sum()))

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters."""
        return tuple(p.name for p in self.parameters)

    @property
    def sd(self) -> Vector:
        """Standard errors with priors, for white residuals, (k,); infinite where undetermined."""
        return self._deviations(self.covariance)

    @property
    def sd_corrected(self) -> Vector:
        """Standard errors with priors, corrected for autocorrelated residuals, (k,); infinite where undetermined."""
        return self._deviations(self.corrected)

    def _deviations(self, covariance: Square) -> Vector:
        return np.where([name in self.undetermined for name in self.names], np.inf, np.sqrt(np.diag(covariance)))

    @property
    def crb(self) -> Vector:
        """Cramer-Rao standard errors of the data alone, for white residuals, (k,); infinite where undetermined."""
        informed = np.flatnonzero(np.diag(self.information) > 0.0)
        bounds = np.full(len(self.estimate), np.inf)
        values, vectors, scale = scaled_eigen(self.information, informed)
        if len(values) and values[0] > SINGULAR:
            bounds[informed] = np.sqrt(np.diag((vectors / values) @ vectors.T)) / scale
        return bounds

    @cached_property
    def corrected(self) -> Float[np.ndarray, "k k"]:
        """Covariance with the residuals' autocorrelation and the priors, shape (k, k); segments are independent.

        With D = `covariance` it is D (M + P) D: M the scores' covariance under the residuals' autocovariance, P that
        of the priors. Sources: Maine and Iliff, NASA RP-1077 (1981); Morelli and Klein, J. Aircraft 1997. M is scaled
        by `calibration`: for what the fit took out of the residuals, and for 1.96 standard errors to hold 95 %.
        """
        if not math.isfinite(self.cost):
            return self.covariance
        k, inside = len(self.estimate), self.flown.inside[:, : int(self.flown.inside.sum(axis=1).max())]
        columns = self.columns[:, : inside.shape[1]]
        S, of_states, residual = columns[..., 1 : k + 1], columns[..., k + 1 :], columns[..., 0]
        S = S - np.einsum("wncs,wsk->wnck", of_states, self.eliminated)  # at optimal initial states
        D, weight = self.covariance, self.priors.weight
        of_priors = np.diag(self.priors.precision)
        of_priors = of_priors + np.einsum("wsa,s,wsb->ab", self.eliminated, self.priors.states, self.eliminated)
        spread = segments_corrected(D, S, self.R, residual, inside)
        dt = float(np.median(self.flown.dt))
        size = min(max(1, round(BLOCK / dt)), inside.shape[1])
        precision = np.where(self.priors.fixed, np.inf, self.priors.states)
        fit = LinearFit(D, means(S, size), means(of_states, size), precision, self.R / size, means(inside, size) > 0.0)
        wider = np.sqrt(calibration(fit, means(residual, size), size * dt))
        return weight * D @ of_priors @ D + spread * np.outer(wider, wider)

    @property
    def inseparable(self) -> tuple[Inseparable, ...]:
        """Sets of parameters that the record, with the priors, cannot separate."""
        units = tuple(p.unit for p in self.parameters)
        return inseparable(self.names, units, self.estimate, self.covariance, self.sd_corrected)

    @property
    def held_by_prior(self) -> tuple[str, ...]:
        """Parameters on which the record has little information, so that the prior decides."""
        with np.errstate(divide="ignore"):
            prior = self.priors.precision**-0.5
        return tuple(n for n, sd, wide in zip(self.names, self.sd, prior, strict=True) if sd > PRIOR_RATIO * wide)


def scaled_eigen(A: np.ndarray, kept: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Eigenvalues and vectors of the block `kept` (indices) of A scaled to unit diagonal, and the scale."""
    block = A[np.ix_(kept, kept)]
    scale = np.sqrt(np.diag(block))
    values, vectors = np.linalg.eigh(block / np.outer(scale, scale))
    return values, vectors, scale


def result_at(
    flown: SegmentTrajectories,
    point: Point,
    prior: NormalPriors,
    *,
    converged: bool,
    iterations: int,
    active: np.ndarray,
    held: np.ndarray,
) -> OutputErrorResult:
    """The result at a point; `held` parameters have no standard error, `active` ones are at a bound."""
    free, A = flown.dynamics.free, np.diag(prior.precision)
    eliminated = np.zeros((*point.departure.shape, len(point.theta)))
    if math.isfinite(point.cost):
        information, _, states = reduced_equations(point, prior)
        size = np.diag(information)  # a parameter without prior may have no information
        informed = np.flatnonzero((size > 0.0) | (prior.precision > 0.0))
        # Rounding may make the matrix of an unstable flight indefinite.
        if np.all(size[informed] > 0.0) and scaled_eigen(information, informed)[0][0] > INDEFINITE:
            A, eliminated = information, states.inverse @ states.cross
    at_bound = tuple(p.name for p, a in zip(free, active & ~held, strict=True) if a)
    status = (
        OutputErrorStatus.LEFT_ENVELOPE if point.inside < 1.0
        else OutputErrorStatus.NOT_CONVERGED if not converged
        else OutputErrorStatus.AT_BOUND if at_bound else OutputErrorStatus.CONVERGED
    )  # fmt: skip
    bare, size = ~held & (prior.precision == 0.0), np.diag(A)
    lost, informed = bare & (size <= 0.0), np.flatnonzero(bare & (size > 0.0))
    if len(informed):  # those in singular directions of an information matrix without priors
        values, vectors, _ = scaled_eigen(A, informed)
        lost[informed] = np.max(np.abs(vectors[:, values < SINGULAR]), axis=1, initial=0.0) > MIN_COMPONENT
    residual, count = point.columns[..., 0] * flown.noise_growth, flown.inside.sum(axis=1)
    return OutputErrorResult(
        flown=flown, parameters=free, estimate=point.theta, departure=point.departure, R=point.R, cost=point.cost,
        covariance=covariance_of(A, ~held & ~lost), information=A - np.diag(prior.precision), priors=prior,
        rms=np.sqrt(np.sum(residual**2, axis=1) / np.maximum(count, 1)[:, None]),
        status=status, iterations=iterations, at_bound=at_bound, columns=point.columns, eliminated=eliminated,
        undetermined=tuple(p.name for p, unknown in zip(free, lost, strict=True) if unknown),
    )  # fmt: skip


# --- The fit.

MAX_ITERATIONS, MAX_EARLY_ITERATIONS = 60, 12  # of the last stage of a cascade, and of those before
TOLERANCE = 1e-3  # expected gain in log-likelihood of the last step: 0.05 standard errors
COLOURED_TOLERANCE = 1e-3  # the same per unit of variance inflation: as small relative to the corrected standard error
FIRST_DAMPING, MIN_DAMPING = 1e-2, 1e-4  # relative to the information's diagonal; long steps end in other minima
MIN_GAIN_RATIO = 0.05  # least ratio of actual to expected gain of a step

_simulate = compiled_at(0)(simulate)


def trajectories(flown: SegmentTrajectories, theta: Any, departure: Any) -> Simulated:
    """`segments.simulate`, compiled, with parameters (k,) and corrections of the initial states (w, s)."""
    return _simulate(flown.nameless, np.asarray(theta), np.asarray(departure))


def one_by_one(flown: SegmentTrajectories, theta: Any, departure: Any) -> tuple[tuple[str, ...], dict[int, Simulated]]:
    """Names of all recorded outputs, and `trajectories` with them of each segment that has samples."""
    # One program serves any number of segments and any choice of outputs.
    shown = tuple(n for n in flown.dynamics.outputs if n in flown.flights.channels)
    wide = replace(flown, outputs=shown)
    rows = map(int, np.flatnonzero(flown.inside.any(axis=1)))
    return shown, {row: trajectories(wide.part([row]), theta, departure[row : row + 1]) for row in rows}


class _Trajectories(Problem):
    """Minus the log posterior density, initial states at their optimum; the last point is kept."""

    def __init__(self, equations: NormalEquations, point: Point, bounds: Float[np.ndarray, "k 2"], moving: np.ndarray):
        super().__init__(bounds, moving)
        self.equations, self.point, self.tried = equations, point, point

    def cost(self, point: Vector) -> float:
        if point is not self.point.theta:
            departure = self.point.departure + self.states.step(point - self.point.theta)
            self.tried = self.equations.evaluate(point, departure)
        return self.tried.cost

    def evaluate(self, point: Vector) -> Evaluation:
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


class FitOptions(NamedTuple):
    """Of a fit: a factor on all priors (0: none, nor of initial states), parameters without a prior, steps."""

    prior_weight: float = 1.0
    without: Collection[str] = ()
    max_iterations: int = MAX_ITERATIONS


def fit_output_error(
    flown: SegmentTrajectories,
    *,
    start: Vector | None = None,
    departure: OfStates | None = None,
    held: Mapping[str, float] | None = None,
    biases: Mapping[str, Prior] | None = None,
    stopped: Callable[[], bool] | None = None,
    **options: Any,
) -> OutputErrorResult:
    """Fit all segments together from one start, with the `options` of `FitOptions`."""
    # `departure`: corrections of the measured initial states to start from, SI. `held`: parameters that are not
    # estimated, and their values. `biases`: outputs with a constant error in each manoeuvre, and its prior, which are
    # further parameters (`bias_output_1`). `stopped`: called before each step; True ends the fit there, not converged.
    prior_weight, without, max_iterations = FitOptions(**options)
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
    theta, at, converged, count = minimise(problem, problem.point.theta, tolerance, rule, stopped=stopped)
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
    starts: Sequence[Vector],
    *,
    held: Mapping[str, float] | None = None,
    prior_weight: float = 1.0,
    without: Collection[str] = (),
) -> OutputErrorResult:
    """Fit the short windows of the first stage from every start, then each later stage from the best fit so far."""
    # Short windows keep the simulation near the record where the aircraft is unstable or the start is poor, but hide
    # slow errors of the model. The last stage should therefore be whole manoeuvres.
    best = None
    for number, stage in enumerate(stages, start=1):
        steps = MAX_ITERATIONS if 1 < number == len(stages) else MAX_EARLY_ITERATIONS
        options: Any = {"held": held, "prior_weight": prior_weight, "without": without, "max_iterations": steps}
        fits = [fit_output_error(stage, start=s, **options) for s in (starts if best is None else [best.estimate])]
        best = min(fits, key=lambda fit: (fit.status is OutputErrorStatus.LEFT_ENVELOPE, fit.cost))
    assert best is not None
    return best


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
        shown, simulated = one_by_one(flown, fit.estimate, fit.departure)
        if not all("X" in flight.trajectory.outputs for flight in simulated.values()):
            return None
        residual, separated = np.zeros((*flown.inside.shape, len(flown.outputs))), np.zeros(flown.inside.shape)
        at = [shown.index(name) for name in flown.outputs]
        for row, flight in simulated.items():
            residual[row] = np.asarray(flight.residual[0])[:, at]
            separated[row] = np.clip(1.0 - np.asarray(flight.trajectory.outputs["X"][0]), 0.0, 1.0)
        return None if np.ptp(separated[flown.inside]) < MIN_X_RANGE else cls(residual, separated, flown.inside)

    def growths(self, without: int | None = None) -> Float[np.ndarray, " c"]:
        """Maximum-likelihood b >= 0 of normal residuals with standard deviation proportional to 1 + b (1 - X)."""
        # Autocorrelation of the residuals increases the error of b, but does not bias it.
        used = self.inside & (np.arange(len(self.inside)) != without)[:, None]
        separated = self.separated[used]

        def cost(b: float, residual: np.ndarray) -> float:
            size = 1.0 + b * separated
            return 0.5 * np.log(np.mean((residual / size) ** 2)) + np.mean(np.log(size))

        growths = np.zeros(self.residual.shape[2])
        for c, residual in enumerate(self.residual[used].T):
            if residual.any():  # else no error, or no output
                best: Any = minimize_scalar(cost, bounds=(0.0, MAX_GROWTH), args=(residual,), method="bounded")
                growths[c] = best.x if best.fun < cost(0.0, residual) else 0.0
        return growths

    def noise_growth(self, without: int | None = None) -> Float[np.ndarray, "w n c"]:
        return 1.0 + self.growths(without) * self.separated[:, :, None]
