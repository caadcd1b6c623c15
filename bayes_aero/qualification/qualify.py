"""How probably a finished model passes its tolerances.

A flight departs from the simulation with the estimates because its parameters differ from them, because the model has
errors that no parameter removes, and because of gusts. Each of these is drawn at random; a flight passes a tolerance if
it stays inside the band about the simulation from start to end.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float
from scipy.optimize import nnls

from bayes_aero import qualification
from bayes_aero.diagnosis.design import Information, best_points, noise_of, possible_points, refused_points, variants_of
from bayes_aero.diagnosis.selection_state import CandidateModel, linearised
from bayes_aero.diagnosis.trajectories import CandidateFit, FlightNoise, label, left_out, masked, posterior_draws
from bayes_aero.dynamics.pilot import through_gusts
from bayes_aero.dynamics.segments import SegmentTrajectories, prepare
from bayes_aero.errors import InputError
from bayes_aero.inference.covariance import ORDER, autoregression, filtered_noise
from bayes_aero.inference.output_error import OutputErrorResult, SeparatedFlow, fit_output_error, trajectories
from bayes_aero.inference.pooled import Hierarchy, from_prior_units, pool, prior_unit, to_prior_units
from bayes_aero.inference.prediction_error import disturbed
from bayes_aero.inference.results import OutputErrorStatus
from bayes_aero.model.model import Model
from bayes_aero.model.records import Flights
from bayes_aero.physics.aircraft import Envelope, required_of
from bayes_aero.processes import compiled_at, side_by_side
from bayes_aero.progress import Progress, quiet
from bayes_aero.qualification import FlightKind
from bayes_aero.residuals.equation_error import EquationError

Vector = Float[np.ndarray, " k"]
Drawn = Float[np.ndarray, "m n c"]  # of m draws, n samples and c outputs
CENTRAL = (0.025, 0.975)
DRAWS = 40  # for the mean square that parameters or gusts explain
FAR = 1e30  # of a flight that left the envelope


def errors(flown: SegmentTrajectories, theta: Vector) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Recorded minus simulated, SI; separated share of the flow; whether each manoeuvre stays inside the envelope."""
    still = jnp.zeros((len(flown.index), len(flown.dynamics.start)))
    simulated = trajectories(flown, jnp.asarray(theta), still)
    X = simulated.trajectory.outputs.get("X")
    separated = np.zeros(flown.index.shape) if X is None else np.clip(1.0 - np.asarray(X), 0.0, 1.0)
    sound = np.all(np.asarray(simulated.trajectory.inside) | ~flown.inside, axis=1)
    return np.asarray(simulated.residual), separated, sound


def spread(alone: SegmentTrajectories, theta: Vector, draws: Float[np.ndarray, "m k"]) -> Drawn:
    """Flights of one manoeuvre with drawn parameters minus the simulation at `theta`, SI; infinite once outside."""
    still = jnp.zeros((1, len(alone.dynamics.start)))

    def residual(drawn: Vector) -> Float[np.ndarray, "n c"]:
        flight = trajectories(alone, jnp.asarray(drawn), still)
        sound, made = np.asarray(flight.trajectory.inside[0])[:, None], np.asarray(flight.residual[0])
        return np.where(sound & np.isfinite(made), made, -np.inf)

    centre = residual(theta)
    return np.stack([centre - away for away in side_by_side(residual, draws)])


def gust_spread(
    alone: SegmentTrajectories, draws: Float[np.ndarray, "m k"], gusts: Mapping[str, float], rng: np.random.Generator
) -> Drawn:
    """What gusts add to flights with drawn parameters, SI, begun in gusts of their own distribution; else calm air."""
    gusty = disturbed(alone)
    free, of_gusts = gusty.dynamics.free, gusty.dynamics.disturbance_parameters
    calm = {p.name: 0.0 if p.neutral == 0.0 else p.start for p in free if p.name in of_gusts}
    n, s = alone.index.shape[1], len(gusty.dynamics.states)

    def added(job: tuple[Vector, np.ndarray]) -> Float[np.ndarray, "n c"]:
        values = calm | dict(zip(alone.dynamics.names, job[0], strict=True)) | dict(gusts)
        return np.asarray(_added(gusty.nameless, jnp.asarray([values[p.name] for p in free]), jnp.asarray(job[1])))

    return np.stack(side_by_side(added, ((d, rng.standard_normal((n + 1, s))) for d in draws)))


@compiled_at(0)
def _added(gusty: SegmentTrajectories, theta: Float[Array, " k"], white: Float[Array, "m s"]) -> Float[Array, "n c"]:
    prepared = prepare(gusty, theta)
    states = prepared.initial_states
    covariance = prepared.initial_covariance(states, jnp.zeros(states.shape[1]))[0]
    size, vectors = jnp.linalg.eigh(covariance)
    begin = states[0] + vectors @ (jnp.sqrt(jnp.maximum(size, 0.0)) * white[0])
    inputs = {name: x[0] for name, x in prepared.drives.items()}

    def fly(start, noise):
        return through_gusts(prepared.system, start, inputs, gusty.dt[0], noise, gusty.outputs, gusty.substeps)

    made, sound = jax.vmap(fly)(jnp.stack([begin, states[0]]), jnp.stack([white[1:], jnp.zeros_like(white[1:])]))
    return jnp.where(jnp.all(sound, axis=0)[:, None], (made[0] - made[1]) / prepared.scale[0], jnp.inf)


# --- Errors of a simulation that parameters do not explain, as random histories: an autoregression and white noise.
# A simulation begins in the measured state, so slow errors begin at zero and grow over their memory. Their mean square
# over a flight and their autocorrelation are those that flights showed, and they grow as the flow separates as those
# did. The size differs from flight to flight, and few flights show few sizes: it is drawn, too.
# What of an error repeats when a manoeuvre is flown again (a wrong model repeats, turbulence does not) is not known.
# The share of its mean square that repeats is drawn, uniform between none and all.

BLOCK_SECONDS = 0.2  # s of a mean: the autoregression holds for some 5 samples a second
SHORTEST = 4 * ORDER  # means in a manoeuvre that an autoregression needs
SIZES = 3  # independent values of the size in a manoeuvre's errors, which follow from few directions; our choice


@dataclass(frozen=True)
class Structure:
    """Errors of c outputs that parameters do not explain."""

    phi: Float[np.ndarray, "c p"]  # autoregression of means over `BLOCK_SECONDS`
    innovation: Float[np.ndarray, " c"]  # standard deviation of its innovations in attached flow, SI
    fast: Float[np.ndarray, " c"]  # standard deviation of the white rest, SI
    growth: Float[np.ndarray, " c"]  # how many times the errors grow in fully separated flow, less one
    sizes: int  # how many independent values of their size the errors amount to
    left: Float[np.ndarray, " c"]  # share of the mean square of slow errors that nothing else explains

    @classmethod
    def of(
        cls,
        errors: Float[np.ndarray, "w n c"],
        separated: Float[np.ndarray, "w n"],
        inside: Bool[np.ndarray, "w n"],
        dt: Float[np.ndarray, " w"],
        explained: Float[np.ndarray, " c"],
    ) -> Structure:
        """Of errors (recorded minus simulated, SI), less the mean squares that parameters and gusts explain."""
        growth = SeparatedFlow(errors, separated, inside).growths() if np.ptp(separated[inside]) > 0.0 else 0.0
        growth = growth + np.zeros(errors.shape[2])
        sized = errors / (1.0 + growth * separated[:, :, None])
        parts = [_means(error[real], step) for error, real, step in zip(sized, inside, dt, strict=True)]
        fast = np.sqrt(np.mean(np.concatenate([rest for _, rest in parts]) ** 2, axis=0))
        slow = np.mean(np.concatenate([means for means, _ in parts]) ** 2, axis=0)
        long = [means.T for means, _ in parts if len(means) >= SHORTEST]
        phi = autoregression(long)[0] if long else np.zeros((len(slow), ORDER))
        white = np.mean((fast * (1.0 + growth * separated[inside][:, None])) ** 2, axis=0)
        total = np.maximum(np.mean(errors[inside] ** 2, axis=0) - white, 1e-300)
        left = np.maximum(1.0 - explained / total, 0.0)
        gained = np.array([_mean_square_from_zero(row, [len(means) for means, _ in parts]) for row in phi])
        return cls(phi, np.sqrt(slow * left / gained), fast, growth, SIZES * len(errors), left)

    def draws(
        self,
        count: int,
        separated: Float[np.ndarray, " n"],
        dt: float,
        rng: np.random.Generator,
        recorded: Float[np.ndarray, "n c"] | None = None,
    ) -> Float[np.ndarray, "m n c"]:
        """`count` histories of the errors of one manoeuvre, SI; of its `recorded` errors as recorded a part repeats."""
        n, c = len(separated), len(self.innovation)
        block = _block(dt)
        size = np.sqrt(self.sizes / rng.chisquare(self.sizes, (c, count)))
        white = self.innovation[:, None] * size * rng.standard_normal((-(-n // block) + 1, c, count))
        series = filtered_noise(np.broadcast_to(self.phi.T[:, :, None], (ORDER, c, count)), white)
        at = np.arange(n) / block
        low = at.astype(int)
        share = (at - low)[:, None, None]
        slow = series[low] * (1.0 - share) + series[low + 1] * share
        grown = 1.0 + self.growth * separated[:, None]
        histories = np.moveaxis(slow, 2, 0) * grown
        if recorded is not None:
            again = rng.uniform(size=(count, 1, c))
            repeated = (recorded - _means(recorded, dt)[1]) * np.sqrt(self.left)
            histories = np.sqrt(again) * repeated + np.sqrt(1.0 - again) * histories
        return histories + self.fast * rng.standard_normal(histories.shape) * grown


def _block(dt: float) -> int:
    return max(1, round(BLOCK_SECONDS / dt))


def _means(error: Float[np.ndarray, "n c"], dt: float) -> tuple[Float[np.ndarray, "t c"], Float[np.ndarray, "n c"]]:
    """Means over blocks, and the error without the lines that join them."""
    block = _block(dt)
    blocks = max(1, len(error) // block)
    means = np.stack([part.mean(axis=0) for part in np.array_split(error[: blocks * block], blocks)])
    at, centre = np.arange(len(error)), block * np.arange(blocks) + 0.5 * (block - 1)
    return means, error - np.stack([np.interp(at, centre, column) for column in means.T], axis=1)


def _mean_square_from_zero(phi: Float[np.ndarray, " p"], lengths: Sequence[int]) -> float:
    A, P, variances = np.vstack([phi, np.eye(ORDER - 1, ORDER)]), np.zeros((ORDER, ORDER)), []
    for _ in range(max(lengths)):
        P = A @ P @ A.T
        P[0, 0] += 1.0
        variances.append(P[0, 0])
    return float(np.cumsum(variances)[np.array(lengths) - 1].sum() / sum(lengths))


@dataclass(frozen=True)
class Uncertain:
    """What is not known of a model."""

    estimate: Vector  # its parameters, SI
    draws: Float[np.ndarray, "m k"]  # of their posterior
    following: Float[np.ndarray, "m k"] | None = None
    """Of the next flight's; None where their scatter between manoeuvres is not known. They are used where they do not
    make flights differ by more than flights left out did."""
    hold_out: tuple[Float[np.ndarray, "w n c"], Float[np.ndarray, " c"]] | None = None
    """Errors of manoeuvres that were not fitted, and the mean squares of them that parameters explain, SI; None: errors
    of the fitted ones stand for them."""
    fitted: bool = True  # to these trajectories, whose errors then do not hold those of the parameters
    gusts: Mapping[str, float] = field(default_factory=dict)  # intensities and lengths by parameter; empty in calm air
    met: bool = True  # whether the records met these gusts, so that their errors hold them


@dataclass(frozen=True)
class OpenTest:
    """An undecided test: what drawn parameters and all else add to each of m flights at n samples, SI."""

    kind: FlightKind
    manoeuvre: str
    output: str
    tolerance: float
    by_parameters: Float[np.ndarray, "m n"]
    by_all_else: Float[np.ndarray, "m n"]

    def slope(self, errors: Float[np.ndarray, "m k"]) -> Float[np.ndarray, "k n"]:
        """By which the part by the parameters follows their errors."""
        sound = np.all(np.isfinite(self.by_parameters), axis=1)
        return np.linalg.lstsq(errors[sound], self.by_parameters[sound], rcond=None)[0]

    @property
    def worst(self) -> int:
        total = np.nan_to_num(self.by_parameters + self.by_all_else, nan=np.inf)
        return int(np.argmax(np.quantile(np.abs(total), qualification.PASSES_FROM, axis=0)))

    def probability(self, change: Float[np.ndarray, "m n"] | float = 0.0) -> float:
        flights = np.nan_to_num(self.by_parameters + change + self.by_all_else, nan=np.inf)
        return float(np.mean(np.all(np.abs(flights) <= self.tolerance, axis=1)))


class QualifiedFlights(NamedTuple):
    """`scattered`: whether the next flight has the scatter of the parameters; `undecided`: left open by them."""

    tests: tuple[qualification.Test, ...]
    strips: tuple[qualification.Strip, ...]
    scattered: bool | None
    undecided: tuple[OpenTest, ...]


# A manoeuvre as it is flown: its row of the segments, parameters, and errors that parameters do not explain.
_Case = tuple[FlightKind, SegmentTrajectories, int, Float[np.ndarray, "m k"], Structure]


def qualify(
    flown: SegmentTrajectories,
    tests: SegmentTrajectories | None,
    unknown: Uncertain,
    bands: Mapping[str, float],
    *,
    seed: int = 0,
    progress: Progress = quiet,
) -> QualifiedFlights:
    """Every test of every manoeuvre, fitted (`flown`) or not (`tests`); `bands`: half widths by output, SI."""
    cases, judged, strips = _cases(flown, tests, unknown, seed), list[qualification.Test](), list[qualification.Strip]()
    undecided, scattered = list[OpenTest](), None
    for number, case in enumerate(cases):
        progress("flights", number / len(cases))
        results, strip, still = _judged(case, unknown, bands, np.random.default_rng([seed, 3, number]))
        judged += results
        strips.append(strip)
        undecided += still if case[3] is unknown.draws else []
        if case[0] is FlightKind.NEXT:
            scattered = case[3] is unknown.following
    return QualifiedFlights(tuple(judged), tuple(strips), scattered, tuple(undecided))


def _cases(flown: SegmentTrajectories, tests: SegmentTrajectories | None, unknown: Uncertain, seed: int) -> list[_Case]:
    """What is flown, with the errors that flights of its kind showed, less what parameters and gusts explain."""
    fitted, separated, sound = errors(flown, unknown.estimate)
    for row in np.flatnonzero(~sound):
        raise InputError(
            f"the simulation of {label(flown, int(row))} with the estimates leaves the flight envelope, so there is "
            "nothing to qualify; fit the model to trajectories with fly first"
        )
    nothing = np.zeros(len(flown.outputs))
    rng = np.random.default_rng([seed, 2])

    def explained(draws: Float[np.ndarray, "m k"], *, gusts: bool = False) -> Float[np.ndarray, " c"]:
        parts = []
        for row, real in enumerate(flown.inside):
            alone, few = flown.part([row]), draws[:DRAWS]
            apart = gust_spread(alone, few, unknown.gusts, rng) if gusts else spread(alone, unknown.estimate, few)
            parts.append(mean_square(apart[:, real]))
        return np.average(parts, axis=0, weights=flown.inside.sum(axis=1))

    by_gusts = explained(unknown.draws, gusts=True) if unknown.gusts and unknown.met else nothing
    by_parameters = nothing if unknown.fitted else explained(unknown.draws)
    unseen, explained_unseen = unknown.hold_out or (fitted, by_parameters)

    def structure(error: Float[np.ndarray, "w n c"], explained: Float[np.ndarray, " c"]) -> Structure:
        shown, least = (np.mean(x[flown.inside] ** 2, axis=0) for x in (error, fitted))
        most = np.maximum(shown - np.maximum(least - by_parameters - by_gusts, 0.0), 0.0)
        taken = np.minimum(explained + by_gusts, most)
        return Structure.of(error, separated, flown.inside, np.asarray(flown.dt), taken)

    again = structure(fitted, by_parameters)
    cases: list[_Case] = [(FlightKind.AGAIN, flown, k, unknown.draws, again) for k in range(len(flown.index))]
    left_out = structure(unseen, explained_unseen)
    if tests is not None:
        cases += [(FlightKind.TEST, tests, k, unknown.draws, left_out) for k in range(len(tests.index))]
    if unknown.following is None and unknown.hold_out is None:
        return cases
    draws, ahead = unknown.draws, left_out
    if unknown.following is not None:
        scatter = explained(unknown.following)
        shown = np.mean(unseen[flown.inside] ** 2, axis=0)
        if np.median(scatter / np.maximum(shown, 1e-300)) <= 1.0 or unknown.hold_out is None:
            draws, ahead = unknown.following, structure(unseen, scatter)
    cases += [(FlightKind.NEXT, flown, k, draws, ahead) for k in range(len(flown.index))]
    return cases


def _judged(
    case: _Case, unknown: Uncertain, bands: Mapping[str, float], rng: np.random.Generator
) -> tuple[list[qualification.Test], qualification.Strip, list[OpenTest]]:
    """Probabilities with more and more counted, the band of flights with all of it, and what is undecided."""
    kind, flown, row, draws, structure = case
    alone = flown.part([row])
    (error,), (separated,), sound = errors(alone, unknown.estimate)
    name, keep, outputs, dt = label(flown, row), alone.inside[0], alone.outputs, float(alone.dt[0])
    if not sound[0]:
        raise InputError(
            f"the simulation of {name} with the estimates leaves the flight envelope, so there is nothing to compare; "
            "leave this record out"
        )
    flights = by_parameters = spread(alone, unknown.estimate, draws)
    chances, limits = {}, np.array([bands[n] for n in outputs])
    for counted in ("parameters", "structure", *(("gusts",) if unknown.gusts else ())):
        if counted == "structure":
            recorded = error if kind is FlightKind.AGAIN else None
            flights = flights + structure.draws(len(flights), separated, dt, rng, recorded)
        if counted == "gusts":
            flights = flights + gust_spread(alone, draws, unknown.gusts, rng)
        inside = np.abs(np.nan_to_num(flights[:, keep], nan=np.inf)) <= limits
        passed = np.all(inside, axis=1).sum(axis=0)
        chances[counted] = [qualification.Chance.of(int(k), len(flights)) for k in passed]
    size, tests, still = np.abs(error[keep]), [], []
    with np.errstate(invalid="ignore"):  # draws that diverge
        rest = np.nan_to_num(flights - by_parameters, nan=np.inf)
    for c, output in enumerate(outputs):
        beside = qualification.RecordBeside(float(size[:, c].max()), float(np.mean(size[:, c] <= limits[c])))
        by = {counted: each[c] for counted, each in chances.items()}
        shown = None if kind is FlightKind.NEXT else beside
        tests.append(qualification.Test(kind, name, output, bands[output], by, float(inside[:, :, c].mean()), shown))
        if tests[-1].chance.verdict is qualification.ToleranceVerdict.UNDECIDED:
            still.append(OpenTest(kind, name, output, bands[output], by_parameters[:, keep, c], rest[:, keep, c]))
    record, index = alone.flights, alone.index[0][keep]
    measured = {n: np.asarray(record.channels[n])[index] for n in outputs}
    simulated = {n: measured[n] - error[keep, c] for c, n in enumerate(outputs)}
    ends = np.quantile(np.nan_to_num(flights[:, keep], posinf=FAR, neginf=-FAR), CENTRAL, axis=0)
    low, high = ({n: simulated[n] + x[:, c] for c, n in enumerate(outputs)} for x in ends)
    strip = qualification.Strip(kind, name, np.asarray(record.time)[index], measured, simulated, low, high)
    return tests, strip, still


# --- Flights that would decide tolerances: what more records make of the parameters, and so of the probability to
# pass. A record narrows the distribution of the parameters. A flight departs from the simulation in proportion to their
# errors, so that its part by the parameters shrinks with them, and errors of the structure and gusts stay. A tolerance
# that stays undecided with known parameters is decided by no record: the model must become better. It is assumed that
# the estimates do not move.

KEPT = 1e-10  # of the largest eigenvalue of a scaled covariance: directions below it are known


def further_flights(
    tests: Sequence[OpenTest],
    names: Sequence[str],
    errors: Float[np.ndarray, "m k"],
    flights: Flights,
    model: Model,
    values: Mapping[str, float],
    envelope: Envelope,
) -> qualification.Further:
    """Test points for the undecided tolerances, inside the envelope; `errors` of the drawn parameters `names`."""
    scale = np.std(errors, axis=0)
    moving = np.flatnonzero(scale > 0.0)
    names, errors = [names[int(k)] for k in moving], errors[:, moving] / scale[moving]
    slopes = [test.slope(errors) for test in tests]
    present = [test.probability(-errors @ slope) for test, slope in zip(tests, slopes, strict=True)]
    useful = [k for k, chance in enumerate(present) if not qualification.FAILS_TO < chance < qualification.PASSES_FROM]
    first = np.cov(errors, rowvar=False).reshape(len(names), len(names))
    worst = np.array([slopes[k][:, tests[k].worst] for k in useful]).reshape(-1, len(names))
    worst = worst[np.einsum("ti,ij,tj->t", worst, first, worst) > 0.0]

    def nats(information: Float[np.ndarray, "k k"]) -> float:
        before, after = (np.einsum("ti,ij,tj->t", worst, C, worst) for C in (first, _after(first, information)))
        return 0.5 * float(np.sum(np.log(before / np.maximum(after, 1e-300))))

    def expected(information: Float[np.ndarray, "k k"]) -> tuple[float, ...]:
        change = shrunk(errors, first, information) - errors
        return tuple(test.probability(change @ slope) for test, slope in zip(tests, slopes, strict=True))

    def decided(information: Float[np.ndarray, "k k"]) -> bool:
        chances = expected(information)
        return all(not qualification.FAILS_TO < chances[k] < qualification.PASSES_FROM for k in useful)

    points, refused = (), {}
    if useful:
        missing = [n for n in required_of(model.axes) if n not in flights.channels]
        if missing:
            raise InputError(f"test points are judged by coefficients, and {missing[0]} was not recorded")
        full = CandidateModel(model, tuple(e.name for e in model.effects if e.parameters), (), {})
        state = linearised(full, EquationError.of(flights, model), model.coefficients, full.vector(values))
        variants = variants_of(state, (), envelope)
        flown = possible_points(state, variants, (), noise_of(state), envelope)
        possible = [x._replace(information=precision_of(x.information, names, scale[moving])) for x in flown]
        refused = refused_points(variants, envelope)
        points = best_points(possible, np.zeros_like(first), nats=nats, expected=expected, decided=decided)
    pairs = zip(tests, present, strict=True)
    about = [(t.kind, t.manoeuvre, t.output, t.probability(), chance) for t, chance in pairs]
    return qualification.Further(tuple(qualification.OpenTolerance(*x) for x in about), tuple(points), refused)


def _after(first: Float[np.ndarray, "k k"], information: Float[np.ndarray, "k k"]) -> Float[np.ndarray, "k k"]:
    return first - first @ information @ np.linalg.solve(np.eye(len(first)) + first @ information, first)


def shrunk(errors: np.ndarray, first: np.ndarray, information: np.ndarray) -> Float[np.ndarray, "m k"]:
    """Errors of covariance `first` as they are once this information is added."""

    def root(covariance: np.ndarray) -> np.ndarray:
        size, vectors = np.linalg.eigh(0.5 * (covariance + covariance.T))
        return (vectors * np.sqrt(np.where(size > KEPT * max(size[-1], 0.0), size, 0.0))) @ vectors.T

    return errors @ np.linalg.pinv(root(first)) @ root(_after(first, information))


def precision_of(information: Information, names: Sequence[str], scale: Vector) -> Float[np.ndarray, "j j"]:
    """Of a record by itself on scaled parameters, under coloured noise: I M^-1 I."""
    at = [k for k, label in enumerate(information.labels) if label in names]
    place = [list(names).index(information.labels[k]) for k in at]
    unit = np.outer(scale[place], scale[place])
    matrix, score = (x[np.ix_(at, at)] * unit for x in (information.matrix, information.score_variance))
    whole = np.zeros((len(names), len(names)))
    whole[np.ix_(place, place)] = matrix @ np.linalg.pinv(score, rcond=KEPT, hermitian=True) @ matrix
    return whole


# --- The same model fitted to all manoeuvres but one, and to each by itself: hold-out errors, and the next flight.

USABLE = (OutputErrorStatus.CONVERGED, OutputErrorStatus.AT_BOUND)
NEGLIGIBLE = 1e-8  # eigenvalue of an information matrix over its largest


def fits_without(fit: OutputErrorResult, noise: FlightNoise) -> list[OutputErrorResult]:
    candidate = CandidateFit("qualified", fit)
    silent = {candidate.name: {k: {} for k in range(len(fit.flown.index))}}
    return [fit_without for _, fit_without in left_out([candidate], silent, noise)]


def hold_out(
    wide: SegmentTrajectories, fits: list[OutputErrorResult], inflation: float, seed: int
) -> tuple[np.ndarray, np.ndarray] | None:
    """Errors of every manoeuvre by the fit without it; None where one of these fits cannot fly it."""
    unseen, explained = [], []
    for k, fit in enumerate(fits):
        alone = wide.part([k])
        error, _, sound = errors(alone, fit.estimate)
        if not sound[0]:
            return None
        draws = posterior_draws(fit, inflation, seed, DRAWS)
        unseen.append(error[0])
        explained.append(mean_square(spread(alone, fit.estimate, draws)[:, alone.inside[0]]))
    return np.stack(unseen), np.average(explained, axis=0, weights=wide.inside.sum(axis=1))


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
    alone: Sequence[OutputErrorResult], inflation: float, count: int, seed: int, progress: Progress = quiet
) -> Float[np.ndarray, "m k"] | None:
    """Draws of the parameters of a flight not yet flown, by partial pooling; None with fewer than two usable fits."""
    usable = [fit for fit in alone if fit.status in USABLE]
    if len(usable) < 2:
        return None
    parameters, y, informations = usable[0].parameters, [], []
    for fit in usable:  # the maximum of its likelihood and its information in units of the priors; none at a bound
        unit = np.array([float(prior_unit(p.prior, x)) for p, x in zip(parameters, fit.estimate, strict=True)])
        mean = np.array([p.prior.normal[0] for p in parameters])
        free = np.array([p.name not in fit.at_bound for p in parameters], float)
        information = fit.information * np.outer(unit * free, unit * free) / inflation
        pulled = fit.priors.precision * unit**2 / inflation * (fit.estimate - mean) / unit * free
        at = np.array([float(to_prior_units(p.prior, x)) for p, x in zip(parameters, fit.estimate, strict=True)])
        y.append(at + np.linalg.pinv(information, rcond=NEGLIGIBLE, hermitian=True) @ pulled)
        informations.append(information)
    hierarchy = Hierarchy.of([p.name for p in parameters], np.stack(y), np.stack(informations))
    following = pool(hierarchy, seed=seed, progress=progress)[0].following.reshape(-1, len(parameters))
    kept = np.random.default_rng([seed, 11]).choice(len(following), count, replace=len(following) < count)
    drawn = np.stack([from_prior_units(p.prior, following[kept, i]) for i, p in enumerate(parameters)], axis=1)
    return np.clip(drawn, *np.array([p.bounds for p in parameters], float).T)


# --- The flown region: the convex hull of flown samples, and how far another motion lies outside.
# The nearest point of a hull to a sample is the point of least norm of the hull that is moved by the sample, and
# that is a least-squares problem with weights that are not negative. It needs no facets, of which a hull in six
# dimensions has very many, and holds for hulls without volume.
# Source: Lawson and Hanson, *Solving Least Squares Problems*, 1974, ch. 23 (least distance programming).

CHANNELS = ("alpha", "beta", "mach", "p", "q", "r")
LEAST = {
    "alpha": math.radians(1.0), "beta": math.radians(1.0), "mach": 0.01, "airspeed": 3.0,
    "p": math.radians(1.0), "q": math.radians(1.0), "r": math.radians(1.0),
}  # fmt: skip
"""Least scale of a channel: a hull with little spread does not make every sample an extrapolation. Our choice."""
MOST_FLOWN, MOST_ASKED = 20_000, 200  # samples of the region, and of a motion that is compared with it
ROUNDING = 1e-6  # of the scale
NOTABLE = 0.1  # of the scale: a smaller distance is the noise of the samples that span the hull; our choice


def nearest(points: Float[np.ndarray, "n k"], sample: Float[np.ndarray, " k"]) -> Float[np.ndarray, " k"]:
    moved = (points - sample).T
    size = max(1.0, float(np.min(np.linalg.norm(moved, axis=0))))  # far samples, too, are solved to rounding
    weights, _ = nnls(np.vstack([moved / size, np.ones(moved.shape[1])]), np.append(np.zeros(len(moved)), 1.0))
    return sample + moved @ weights / weights.sum()


@dataclass(frozen=True)
class Region:
    """Flown samples (n, k) of channels, SI; distances are counted in `scale`, half of what was flown of a channel."""

    channels: tuple[str, ...]
    points: Float[np.ndarray, "n k"]
    scale: Float[np.ndarray, " k"]

    @classmethod
    def of(cls, flown: Mapping[str, Float[np.ndarray, " n"]]) -> Region:
        """The region of the channels (n,) that are of `CHANNELS`; airspeed where there is no Mach number."""
        channels = [n if n in flown or n != "mach" else "airspeed" for n in CHANNELS]
        names = tuple(n for n in channels if n in flown)
        if not names:
            return cls((), np.zeros((0, 0)), np.zeros(0))
        points = np.stack([np.asarray(flown[n], float) for n in names], axis=1)
        return cls(names, points, np.maximum(0.5 * np.ptp(points, axis=0), [LEAST[n] for n in names]))

    def offsets(self, motion: Mapping[str, Float[np.ndarray, " m"]]) -> Float[np.ndarray, "m k"]:
        """From the nearest point of the hull to every sample, in units of `scale`; zero inside."""
        samples = np.stack([np.asarray(motion[n], float) for n in self.channels], axis=1) / self.scale
        points = self.points
        if len(points) > MOST_FLOWN:  # evenly thinned, with the extremes of every channel
            kept = np.linspace(0, len(points) - 1, MOST_FLOWN).astype(int)
            points = points[np.unique([*kept, *np.argmin(points, axis=0), *np.argmax(points, axis=0)])]
        points = np.unique(points / self.scale, axis=0)
        offsets = np.array([sample - nearest(points, sample) for sample in samples])
        return np.where(np.linalg.norm(offsets, axis=1, keepdims=True) > ROUNDING, offsets, 0.0)

    def outside(
        self, manoeuvre: str, kind: str, time: Float[np.ndarray, " m"], motion: Mapping[str, Float[np.ndarray, " m"]]
    ) -> qualification.Outside | None:
        """How far a motion leaves the region, SI; None where it does not by more than `NOTABLE`."""
        kept = np.unique(np.linspace(0, len(time) - 1, min(len(time), MOST_ASKED)).astype(int))
        offsets = self.offsets({n: np.asarray(motion[n])[kept] for n in self.channels})
        distance = np.linalg.norm(offsets, axis=1)
        if distance.max() <= NOTABLE:
            return None
        worst = int(np.argmax(distance))
        excess = dict(zip(self.channels, map(float, offsets[worst] * self.scale), strict=True))
        share, when = float(np.mean(distance > NOTABLE)), float(time[kept[worst]] - time[0])
        return qualification.Outside(manoeuvre, kind, self.channels, share, float(distance[worst]), when, excess)
