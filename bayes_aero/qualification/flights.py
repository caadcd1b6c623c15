"""Flights of one manoeuvre that might have been: with other parameters, and through gusts."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from bayes_aero.diagnosis.candidate_set import CandidateModel
from bayes_aero.diagnosis.design import Information, best_points, noise_of, possible_points, refused_points, variants_of
from bayes_aero.diagnosis.flights import CandidateFit, FlightNoise, left_out, masked, posterior_draws
from bayes_aero.diagnosis.selection_state import linearised
from bayes_aero.dynamics.pilot import through_gusts
from bayes_aero.dynamics.segments import SegmentTrajectories, prepare
from bayes_aero.errors import InputError
from bayes_aero.inference.output_error import OutputErrorResult, fit_output_error, trajectories
from bayes_aero.inference.pooled import Hierarchy, from_prior_units, pool, prior_unit, to_prior_units
from bayes_aero.inference.prediction_error import disturbed
from bayes_aero.inference.results import OutputErrorStatus
from bayes_aero.model.model import Model
from bayes_aero.model.records import Flights
from bayes_aero.physics.aircraft import Envelope, required_of
from bayes_aero.processes import cores
from bayes_aero.progress import Progress
from bayes_aero.qualification.result import FAILS_TO, PASSES_FROM, FlightKind, Further, OpenTolerance
from bayes_aero.residuals.equation_error import EquationError


def errors(
    flown: SegmentTrajectories, theta: Float[np.ndarray, " k"]
) -> tuple[Float[np.ndarray, "w n c"], Float[np.ndarray, "w n"], Bool[np.ndarray, " w"]]:
    """Recorded minus simulated, SI; separated share of the flow; whether each manoeuvre stays inside the envelope."""
    still = jnp.zeros((len(flown.index), len(flown.dynamics.start)))
    simulated = trajectories(flown, jnp.asarray(theta), still)
    X = simulated.trajectory.outputs.get("X")
    separated = np.zeros(flown.index.shape) if X is None else np.clip(1.0 - np.asarray(X), 0.0, 1.0)
    sound = np.all(np.asarray(simulated.trajectory.inside) | ~flown.inside, axis=1)
    return np.asarray(simulated.residual), separated, sound


def spread(
    alone: SegmentTrajectories, theta: Float[np.ndarray, " k"], draws: Float[np.ndarray, "m k"]
) -> Float[np.ndarray, "m n c"]:
    """Flights of one manoeuvre with drawn parameters minus the simulation at `theta`, SI; infinite once outside."""
    still = jnp.zeros((1, len(alone.dynamics.start)))

    def residual(one: Float[np.ndarray, " k"]) -> Float[np.ndarray, "n c"]:
        found = trajectories(alone, jnp.asarray(one), still)
        sound = np.asarray(found.trajectory.inside[0])[:, None]
        made = np.asarray(found.residual[0])
        return np.where(sound & np.isfinite(made), made, -np.inf)

    centre = residual(theta)
    with ThreadPoolExecutor(cores()) as pool:
        return np.stack([centre - one for one in pool.map(residual, draws)])


def gust_spread(
    alone: SegmentTrajectories, draws: Float[np.ndarray, "m k"], gusts: Mapping[str, float], rng: np.random.Generator
) -> Float[np.ndarray, "m n c"]:
    """What gusts add to flights with drawn parameters, SI, begun in gusts of their own distribution; else calm air."""
    gusty = disturbed(alone)
    free = gusty.dynamics.free
    calm = {p.name: p.start for p in free if p.name in gusty.dynamics.disturbance_parameters}
    calm |= {p.name: 0.0 for p in free if p.name in calm and p.neutral == 0.0}
    n, s = alone.index.shape[1], len(gusty.dynamics.states)

    def one(job: tuple[Float[np.ndarray, " k"], np.ndarray]) -> Float[np.ndarray, "n c"]:
        values = calm | dict(zip(alone.dynamics.names, job[0], strict=True)) | dict(gusts)
        theta = jnp.asarray([values[p.name] for p in free])
        return np.asarray(_added(gusty.nameless, theta, jnp.asarray(job[1])))

    with ThreadPoolExecutor(cores()) as pool:
        return np.stack(list(pool.map(one, ((d, rng.standard_normal((n + 1, s))) for d in draws))))


@eqx.filter_jit
def _added(gusty: SegmentTrajectories, theta: Float[Array, " k"], white: Float[Array, "m s"]) -> Float[Array, "n c"]:
    prepared = prepare(gusty, theta)
    states = prepared.initial_states
    covariance = prepared.initial_covariance(states, jnp.zeros(states.shape[1]))[0]
    size, vectors = jnp.linalg.eigh(covariance)
    begin = states[0] + vectors @ (jnp.sqrt(jnp.maximum(size, 0.0)) * white[0])
    inputs = {name: x[0] for name, x in prepared.drives.items()}

    def fly(start, noise):
        system = prepared.system
        return through_gusts(system, start, inputs, gusty.dt[0], noise, gusty.outputs, gusty.substeps)

    made, sound = jax.vmap(fly)(jnp.stack([begin, states[0]]), jnp.stack([white[1:], jnp.zeros_like(white[1:])]))
    return jnp.where(jnp.all(sound, axis=0)[:, None], (made[0] - made[1]) / prepared.scale[0], jnp.inf)


# --- Flights that would decide tolerances: what more records make of the parameters, and so of the probability to
# pass.
# A record narrows the distribution of the parameters. A flight departs from the simulation in proportion to their
# errors, so that its part by the parameters shrinks with them, and errors of the structure and gusts stay. A
# tolerance that stays undecided with known parameters is decided by no record: the model must become better. It is
# assumed that the estimates do not move.

KEPT = 1e-10  # of the largest eigenvalue of a scaled covariance: directions below it are known


@dataclass(frozen=True)
class OpenTest:
    """An undecided test: what drawn parameters and all else add to each of m flights at n samples, SI."""

    kind: FlightKind
    manoeuvre: str
    output: str
    tolerance: float
    by_parameters: Float[np.ndarray, "m n"]
    by_all_else: Float[np.ndarray, "m n"]


@dataclass(frozen=True)
class _Linear:
    """An open test whose part by the parameters is linear in their errors, as far as `slope` (k, n) says."""

    test: OpenTest
    slope: Float[np.ndarray, "k n"]
    worst: int

    @classmethod
    def of(cls, test: OpenTest, errors: Float[np.ndarray, "m k"]) -> _Linear:
        sound = np.all(np.isfinite(test.by_parameters), axis=1)
        slope = np.linalg.lstsq(errors[sound], test.by_parameters[sound], rcond=None)[0]
        total = np.nan_to_num(test.by_parameters + test.by_all_else, nan=np.inf)
        return cls(test, slope, int(np.argmax(np.quantile(np.abs(total), PASSES_FROM, axis=0))))

    def probability(self, errors: Float[np.ndarray, "m k"], shrunk: Float[np.ndarray, "m k"]) -> float:
        flights = self.test.by_parameters + (shrunk - errors) @ self.slope + self.test.by_all_else
        return float(np.mean(np.all(np.abs(np.nan_to_num(flights, nan=np.inf)) <= self.test.tolerance, axis=1)))

    def deviation(self, covariance: Float[np.ndarray, "k k"]) -> float:
        g = self.slope[:, self.worst]
        return float(np.sqrt(max(g @ covariance @ g, 0.0)))


def further_flights(
    tests: Sequence[OpenTest],
    names: Sequence[str],
    errors: Float[np.ndarray, "m k"],
    flights: Flights,
    model: Model,
    values: dict[str, float],
    envelope: Envelope,
) -> Further:
    """Test points for the undecided tolerances, inside the envelope; `errors` of the drawn parameters `names`."""
    scale = np.std(errors, axis=0)
    moving = np.flatnonzero(scale > 0.0)
    names, errors = [names[int(k)] for k in moving], errors[:, moving] / scale[moving]
    open_ = [_Linear.of(test, errors) for test in tests]
    known = [one.probability(errors, np.zeros_like(errors)) for one in open_]
    useful = [one for one, chance in zip(open_, known, strict=True) if _decided(chance)]
    first = np.cov(errors, rowvar=False).reshape(len(names), len(names))
    points, refused = (), {}

    def nats(information: Float[np.ndarray, "k k"]) -> float:
        after = _after(first, information)
        moved = [one for one in useful if one.deviation(first) > 0.0]
        return float(np.sum(np.log([one.deviation(first) / max(one.deviation(after), 1e-300) for one in moved])))

    if useful:
        missing = [n for n in required_of(model.axes) if n not in flights.channels]
        if missing:
            raise InputError(f"test points are judged by coefficients, and {missing[0]} was not recorded")
        full = CandidateModel(model, tuple(e.name for e in model.effects if e.parameters), (), {})
        estimate = np.array([values[name] for name in model.names])
        state = linearised(full, EquationError.of(flights, model), model.coefficients, estimate)
        variants = variants_of(state, (), envelope)
        possible = [
            replace(one, information=_precision(one.information, names, scale[moving]))
            for one in possible_points(state, variants, (), noise_of(state), envelope)
        ]
        refused = refused_points(variants, envelope)
        points = best_points(
            possible,
            np.zeros_like(first),
            nats=nats,
            expected=lambda information: tuple(
                one.probability(errors, _shrunk(errors, first, information)) for one in open_
            ),
            decided=lambda information: all(
                _decided(one.probability(errors, _shrunk(errors, first, information))) for one in useful
            ),
        )
    questions = tuple(
        OpenTolerance(t.kind, t.manoeuvre, t.output, one.probability(errors, errors), chance)
        for t, one, chance in zip(tests, open_, known, strict=True)
    )
    return Further(questions, tuple(points), refused)


def _decided(chance: float) -> bool:
    return not FAILS_TO < chance < PASSES_FROM


def _after(first: Float[np.ndarray, "k k"], information: Float[np.ndarray, "k k"]) -> Float[np.ndarray, "k k"]:
    return first - first @ information @ np.linalg.solve(np.eye(len(first)) + first @ information, first)


def _shrunk(errors: np.ndarray, first: np.ndarray, information: np.ndarray) -> Float[np.ndarray, "m k"]:
    return errors @ np.linalg.pinv(_root(first)) @ _root(_after(first, information))


def _root(covariance: Float[np.ndarray, "k k"]) -> Float[np.ndarray, "k k"]:
    size, vectors = np.linalg.eigh(0.5 * (covariance + covariance.T))
    size = np.where(size > KEPT * max(size[-1], 0.0), size, 0.0)
    return (vectors * np.sqrt(size)) @ vectors.T


def _precision(
    information: Information, names: Sequence[str], scale: Float[np.ndarray, " k"]
) -> Float[np.ndarray, "k k"]:
    """Of a record by itself on scaled parameters, under coloured noise: I M^-1 I."""
    at = [k for k, label in enumerate(information.labels) if label in names]
    place = [list(names).index(information.labels[k]) for k in at]
    unit = np.outer(scale[place], scale[place])
    matrix, score = information.matrix[np.ix_(at, at)] * unit, information.score_variance[np.ix_(at, at)] * unit
    whole = np.zeros((len(names), len(names)))
    whole[np.ix_(place, place)] = matrix @ np.linalg.pinv(score, rcond=KEPT, hermitian=True) @ matrix
    return whole


# --- The same model fitted to all manoeuvres but one, and to each by itself: hold-out errors, and the next flight.

USABLE = (OutputErrorStatus.CONVERGED, OutputErrorStatus.AT_BOUND)
DRAWS = 40  # of the posterior of a fit without a manoeuvre
NEGLIGIBLE = 1e-8  # eigenvalue of an information matrix over its largest


@dataclass(frozen=True)
class HoldOut:
    """Errors (w, n, c) of manoeuvres that were not fitted, and the mean squares (c,) that parameters explain, SI."""

    errors: Float[np.ndarray, "w n c"]
    explained: Float[np.ndarray, " c"]


def fits_without(fit: OutputErrorResult, noise: FlightNoise) -> list[OutputErrorResult]:
    """For each manoeuvre the fit to all others."""
    candidate = CandidateFit("qualified", fit)
    silent = {candidate.name: {k: {} for k in range(len(fit.flown.index))}}
    return [fit_without for _, fit_without in left_out([candidate], silent, noise)]


def hold_out(
    wide: SegmentTrajectories, fits: Sequence[OutputErrorResult], inflation: float, seed: int
) -> HoldOut | None:
    """Errors of every manoeuvre by the fit without it; None where one of these fits cannot fly it."""
    errors_by_manoeuvre, explained, counts = [], [], []
    for k, fit in enumerate(fits):
        alone = wide.part([k])
        error, _, sound = errors(alone, fit.estimate)
        if not sound[0]:
            return None
        draws = posterior_draws(fit, inflation, seed, DRAWS)
        apart = spread(alone, fit.estimate, draws)[:, alone.inside[0]]
        errors_by_manoeuvre.append(error[0])
        explained.append(mean_square(apart))
        counts.append(float(alone.inside.sum()))
    return HoldOut(np.stack(errors_by_manoeuvre), np.average(explained, axis=0, weights=counts))


def mean_square(apart: Float[np.ndarray, "m n c"]) -> Float[np.ndarray, " c"]:
    """Of the flights that stay in the envelope; infinite where none does."""
    sound = np.all(np.isfinite(apart), axis=(1, 2))
    return np.mean(apart[sound] ** 2, axis=(0, 1)) if sound.any() else np.full(apart.shape[2], math.inf)


def alone_fits(fit: OutputErrorResult, without: Sequence[OutputErrorResult], inflation: float):
    """Every manoeuvre fitted by itself; of two, the fit without the other."""
    count = len(fit.flown.index)
    if count == 2:
        return [without[1], without[0]]
    options = {"start": fit.estimate, "prior_weight": inflation}
    return [fit_output_error(masked(fit.flown, k, keep=True), **options) for k in range(count)]


def next_parameters(
    alone: Sequence[OutputErrorResult], inflation: float, count: int, seed: int, progress: Progress | None = None
) -> Float[np.ndarray, "m k"] | None:
    """Draws of the parameters of a flight not yet flown, by partial pooling; None with fewer than two usable fits."""
    usable = [fit for fit in alone if fit.status in USABLE]
    if len(usable) < 2:
        return None
    y, information = zip(*(_of_data(fit, inflation) for fit in usable), strict=True)
    parameters = usable[0].parameters
    drawn, _ = pool(
        Hierarchy.of([p.name for p in parameters], np.stack(y), np.stack(information)), seed=seed, progress=progress
    )
    following = drawn.following.reshape(-1, len(parameters))
    kept = np.random.default_rng([seed, 11]).choice(len(following), count, replace=len(following) < count)
    drawn_parameters = [from_prior_units(p.prior, following[kept, i]) for i, p in enumerate(parameters)]
    lower, upper = (np.array([p.bounds[i] for p in parameters], float) for i in (0, 1))
    return np.clip(np.stack(drawn_parameters, axis=1), lower, upper)


def _of_data(fit: OutputErrorResult, inflation: float) -> tuple[Float[np.ndarray, " k"], Float[np.ndarray, "k k"]]:
    """The maximum of the likelihood and its information in units of the priors; none of parameters at a bound."""
    parameters = fit.parameters
    unit = np.array([float(prior_unit(p.prior, x)) for p, x in zip(parameters, fit.estimate, strict=True)])
    mean = np.array([p.prior.normal[0] for p in parameters])
    free = np.array([p.name not in fit.at_bound for p in parameters], float)
    information = fit.information * np.outer(unit * free, unit * free) / inflation
    pulled = fit.priors.precision * unit**2 / inflation * (fit.estimate - mean) / unit * free
    y = np.array([float(to_prior_units(p.prior, x)) for p, x in zip(parameters, fit.estimate, strict=True)])
    return y + np.linalg.pinv(information, rcond=NEGLIGIBLE, hermitian=True) @ pulled, information
