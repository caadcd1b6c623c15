"""Simulated manoeuvres beside the recorded ones, and models fitted to all segments of flight but one."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from functools import cached_property
from threading import Event

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from bayes_aero.diagnosis.accuracy import LeftOut, backward_elimination, normal_draws
from bayes_aero.diagnosis.candidate_set import DEFAULT, CandidateModel, DiagnosisSettings, finite, lag_of
from bayes_aero.diagnosis.result import (
    Confirmation,
    Error,
    GustHistory,
    LagTest,
    ProcessNoise,
    SimulatedManoeuvre,
    TrajectoryFit,
    theil_parts,
)
from bayes_aero.diagnosis.selection import Extension, large
from bayes_aero.dynamics.flight import aircraft_dynamics, with_biases_of
from bayes_aero.dynamics.innovations import neighbour_correlation, prediction_errors
from bayes_aero.dynamics.kalman import smooth
from bayes_aero.dynamics.segments import SegmentTrajectories, segments
from bayes_aero.effect import Effect, Stage
from bayes_aero.inference.covariance import corrected_covariance, means, median_inflation, variance_inflation
from bayes_aero.inference.optimise import solve
from bayes_aero.inference.output_error import (
    NormalEquations,
    OutputErrorResult,
    Point,
    SeparatedFlow,
    fit_output_error,
    one_by_one,
    segment_equations,
    trajectories,
)
from bayes_aero.inference.prediction_error import (
    PredictionErrorResult,
    PredictionErrorStatus,
    fit_disturbed,
    one_step,
    sample_innovations,
)
from bayes_aero.inference.results import OutputErrorStatus, Posterior
from bayes_aero.model.model import Model
from bayes_aero.model.records import Flights
from bayes_aero.parameter import departure
from bayes_aero.processes import blas_threads, cores
from bayes_aero.progress import Progress

DRAWS = 40  # of the posterior, for the probability of staying inside the tolerances
GIVEN = "given"


def label(flown: SegmentTrajectories, row: int) -> str:
    """The manoeuvre's name; of the halves of a single one, which."""
    name = flown.flights.names[int(flown.manoeuvre[row])]
    if len(flown.flights.lengths) > 1 or len(flown.index) == 1:
        return name
    return f"{name}, {'first' if row == 0 else 'second'} half"


def simulated(
    estimate: Float[np.ndarray, " k"],
    flown: SegmentTrajectories,
    model: str,
    split: str,
    departure: Float[np.ndarray, "w s"],
    tolerances: Mapping[str, float],
    draws: Float[np.ndarray, "m k"] | None = None,
) -> list[SimulatedManoeuvre]:
    """Every segment of `flown` that counts, with these parameters; with `draws` the chance to stay inside."""
    shown, every = one_by_one(flown, jnp.asarray(estimate), jnp.asarray(departure))
    paths = []
    for row, trajectory in every.items():
        keep = flown.inside[row]
        measured, residual = np.asarray(trajectory.measured[0])[keep], np.asarray(trajectory.residual[0])[keep]
        chance = {} if draws is None else _probabilities(replace(flown, outputs=shown).part([row]), draws, tolerances)
        errors = {}
        for name, z, e in zip(shown, measured.T, residual.T, strict=True):
            tolerance, size = tolerances.get(name), np.abs(e)
            within = None if tolerance is None else float(np.mean(size <= tolerance))
            rms, parts = float(np.sqrt(np.mean(e**2))), theil_parts(z, z - e)
            errors[name] = Error(rms, float(size.max()), parts, tolerance, within, chance.get(name))
        paths.append(
            SimulatedManoeuvre(
                manoeuvre=label(flown, row),
                model=model,
                split=split,
                inside=bool(np.asarray(trajectory.trajectory.inside[0])[keep].all()),
                errors=errors,
                time=flown.flights.time[flown.index[row][keep]],
                measured={name: measured[:, c] for c, name in enumerate(shown)},
                simulated={name: measured[:, c] - residual[:, c] for c, name in enumerate(shown)},
            )
        )
    return paths


def posterior_draws(
    fit: OutputErrorResult, variance_inflation: float, seed: int, count: int = DRAWS
) -> Float[np.ndarray, "m k"]:
    """Parameters drawn from the posterior, within their bounds."""
    moving = np.flatnonzero(fit.sd > 0.0)
    covariance = variance_inflation * fit.covariance[np.ix_(moving, moving)]
    return normal_draws(fit.estimate, moving, covariance, fit.parameters, seed, count)


def _probabilities(
    alone: SegmentTrajectories, draws: Float[np.ndarray, "m k"], tolerances: Mapping[str, float]
) -> dict[str, float]:
    """Share of draws whose whole trajectory, of one segment, stays inside each tolerance and the envelope."""
    # Draw by draw: a simulation of all of them together would have to be compiled, and takes half as long only.
    still = jnp.zeros((1, len(alone.dynamics.start)))

    def largest(theta):
        trajectory = trajectories(alone, jnp.asarray(theta), still)
        inside = np.all(np.asarray(trajectory.trajectory.inside) | ~alone.inside)
        size = np.max(np.abs(np.asarray(trajectory.residual[0])), axis=0)
        return np.where(inside & np.isfinite(size), size, np.inf)

    with ThreadPoolExecutor(cores()) as pool:
        sizes = np.stack(list(pool.map(largest, draws)))
    toleranced = [(c, name) for c, name in enumerate(alone.outputs) if name in tolerances]
    return {name: float(np.mean(sizes[:, c] <= tolerances[name])) for c, name in toleranced}


def fly_given(
    flights: Flights, model: Model, values: Mapping[str, float], tolerances: Mapping[str, float]
) -> tuple[SimulatedManoeuvre, ...]:
    """Every manoeuvre from its measured initial state, with `values` (SI) of parameters; nothing is fitted."""
    dynamics = aircraft_dynamics(model, flights)
    theta = np.array([values.get(p.name, p.start) for p in dynamics.free])
    whole = segments(flights, dynamics, substeps=dynamics.substeps(theta, flights))
    still = np.zeros((len(whole.index), len(dynamics.start)))
    with np.errstate(over="ignore", invalid="ignore"):  # coefficients that fit may still fly anywhere
        return tuple(simulated(theta, whole, GIVEN, GIVEN, still, tolerances))


# --- The same parameters by a filter that estimates gusts, process noise and measurement noise with them.


@blas_threads(0)
def with_process_noise(
    flown: TrajectoryFit,
) -> tuple[ProcessNoise, Callable[[int, Progress | None, str], dict[str, Posterior]]]:
    """Fit again in gusts and with noise of every state that is compared; also what samples its posterior."""
    fit = flown.fit
    gusty, filtered = fit_disturbed(fit.flown, fit.estimate, fit.R, priors=flown.setting.priors)

    def sample(seed: int, progress: Progress | None, engine: str) -> dict[str, Posterior]:
        with blas_threads(0):
            return sample_innovations(gusty, filtered, fit.R, seed=seed, engines=(engine,), progress=progress)

    inside = fit.flown.inside
    of_noise = int(inside.sum()) * float(np.sum(np.log(2.0 * np.pi * fit.R) + 1.0))
    still = -0.5 * of_noise - float(np.log(fit.flown.noise_growth[inside]).sum())
    estimates = {
        n: (float(x), float(s)) for n, x, s in zip(filtered.names, filtered.estimate, filtered.sd, strict=True)
    }
    own = set(fit.flown.dynamics.names) - gusty.dynamics.disturbance_parameters
    converged, predicted = filtered.status is PredictionErrorStatus.CONVERGED, None
    if converged:
        errors = np.asarray(prediction_errors(gusty.nameless, jnp.asarray(filtered.estimate), filtered.found))
        predicted = one_step(filtered.found, errors, filtered.outputs)
    theirs = [i for i, name in enumerate(filtered.names) if name in own]
    noise = ProcessNoise(
        filtered.status.value,
        converged,
        filtered.log_likelihood - still,
        {name: value for name, value in estimates.items() if name in own},
        {n: float(x) for n, x in zip(filtered.states, filtered.F, strict=True) if n in fit.flown.dynamics.start},
        dict(zip(filtered.outputs, map(float, np.sqrt(filtered.R)), strict=True)),
        dict(zip(filtered.outputs, map(float, neighbour_correlation(filtered.found)), strict=True)),
        {name: value for name, value in estimates.items() if name not in own},
        _histories(gusty, filtered),
        predicted,
        filtered.covariance[np.ix_(theirs, theirs)],
    )
    return noise, sample


_smoothed = eqx.filter_jit(jax.vmap(smooth))


def _histories(gusty: SegmentTrajectories, filtered: PredictionErrorResult) -> tuple[GustHistory, ...]:
    """By manoeuvre, by the smoother; only gusts that have an intensity."""
    dynamics, values = gusty.dynamics, dict(zip(filtered.names, filtered.estimate, strict=True))
    model = getattr(dynamics, "model", None)  # of linear cards none
    processes = () if model is None else model.disturbances
    met = {d.state: dynamics.states.index(d.state) for d in processes if values.get(d.intensity, 0.0) > 0.0}
    if not met:
        return ()
    x, P = (np.asarray(y) for y in _smoothed(filtered.found))
    flights, histories = gusty.flights, []
    for number in np.unique(gusty.manoeuvre):
        parts = [(k, gusty.inside[k]) for k in np.flatnonzero(gusty.manoeuvre == number)]
        time = np.concatenate([np.asarray(flights.time)[gusty.index[k][real]] for k, real in parts])
        gusts = {}
        for name, i in met.items():
            variance = np.concatenate([P[k, real, i, i] for k, real in parts])
            gusts[name] = np.concatenate([x[k, real, i] for k, real in parts]), np.sqrt(np.maximum(variance, 0.0))
        histories.append(GustHistory(flights.names[number], time - time[0], gusts))
    return tuple(histories)


# --- Models fitted to all segments of flight but one, and flown on that one.


@dataclass(frozen=True)
class FlightNoise:
    """What a first fit tells of residuals: their variance inflation, how they grow in the stall."""

    variance_inflation: float
    parts: SeparatedFlow | None

    @classmethod
    def of(cls, fit: OutputErrorResult) -> FlightNoise:
        return cls(trajectory_variance_inflation(fit), SeparatedFlow.of(fit))

    def on(self, flown: SegmentTrajectories, without: int | None = None) -> SegmentTrajectories:
        """The same segments with their noise_growth; its size is read from all of them, or from all but one."""
        return flown if self.parts is None else replace(flown, noise_growth=self.parts.noise_growth(without))

    def growth_by_output(self, outputs: Sequence[str]) -> dict[str, float]:
        """By output, how many times more is missed in wholly separated flow than in attached flow."""
        growths = np.zeros(len(outputs)) if self.parts is None else self.parts.growths()
        return {name: 1.0 + float(b) for name, b in zip(outputs, growths, strict=True)}


@dataclass(frozen=True)
class CandidateFit:
    """A model fitted to all segments."""

    name: str
    fit: OutputErrorResult
    own: frozenset[str] = frozenset()  # parameters of its causes
    held: Mapping[str, float] = field(default_factory=dict)  # parameters that are never fitted
    weighed: bool = True  # samples count by the noise_growth of what is missed

    def silent(self, segment: int, unidentified: float) -> dict[str, float]:
        """Joint values of causes' parameters whose standard error without this segment is `unidentified` times more."""
        if not self.own:
            return {}
        others = masked(self.fit.flown, segment, keep=False)
        part = fit_output_error(others, start=self.fit.estimate, departure=self.fit.departure, max_iterations=0)
        rows = zip(self.fit.names, self.fit.estimate, part.crb, self.fit.crb, strict=True)
        with np.errstate(invalid="ignore"):
            return {n: float(x) for n, x, alone, all_ in rows if n in self.own and not alone < unidentified * all_}


def masked(flown: SegmentTrajectories, segment: int, *, keep: bool) -> SegmentTrajectories:
    """Only one of the segments counts, or all others; the shapes stay, so nothing compiles anew."""
    counts = (np.arange(len(flown.index)) == segment) == keep
    return eqx.tree_at(lambda f: f.inside, flown, flown.inside & counts[:, None])


def left_out(
    contenders: Sequence[CandidateFit], silent: Mapping[str, Mapping[int, Mapping[str, float]]], noise: FlightNoise
) -> Iterator[tuple[str, OutputErrorResult]]:
    """Every contender (by its name) and segment: the fit to all other segments, its `silent` parameters held."""
    count = len(contenders[0].fit.flown.index)
    jobs = [(c, k) for c in contenders for k in range(count)]
    stopped = Event()

    def one(job: tuple[CandidateFit, int]) -> tuple[str, OutputErrorResult]:
        contender, k = job
        fit, held = contender.fit, {**contender.held, **silent[contender.name][k]}
        weighed = noise.on(fit.flown, without=k) if contender.weighed else fit.flown
        options = {"prior_weight": noise.variance_inflation, "stopped": stopped.is_set}
        rest = masked(weighed, k, keep=False)
        return contender.name, fit_output_error(rest, start=fit.estimate, held=held, **options)

    # Two fits keep as many cores busy as one with twice the segments, so several are made at once.
    with ThreadPoolExecutor(max(1, cores() // max(1, count - 1))) as pool:
        try:
            yield from pool.map(one, jobs)
        except BaseException:  # Ctrl-C does not wait for whole fits
            stopped.set()
            raise


def holdout_fits(
    contender: CandidateFit,
    fits: Sequence[OutputErrorResult],
    tolerances: Mapping[str, float],
    variance_inflation: float = 1.0,
    seed: int = 0,
) -> list[SimulatedManoeuvre]:
    """Every segment flown from its measured initial state by the fit without it, in order, and by draws of it."""
    flown, still = contender.fit.flown, np.zeros_like(contender.fit.departure)
    paths = []
    for k, fit in enumerate(fits):
        drawn = bool(tolerances) and fit.status is not OutputErrorStatus.LEFT_ENVELOPE
        draws = posterior_draws(fit, variance_inflation, seed) if drawn else None
        alone = masked(flown, k, keep=True)
        paths += simulated(fit.estimate, alone, contender.name, "hold_out", still, tolerances, draws)
    return paths


def left_out_of(paths: Sequence[SimulatedManoeuvre], flown: SegmentTrajectories, variance_inflation: float) -> LeftOut:
    """What simulations, in order, miss of every segment of `flown`."""
    left = [np.stack([p.measured[n] - p.simulated[n] for n in flown.outputs], axis=1) for p in paths]
    scaled = [x / s for x, s in zip(left, flown.growth, strict=True)]
    return _left_out(scaled, flown, variance_inflation, flyable=all(p.inside for p in paths))


def _left_out(
    scaled: Sequence[Float[np.ndarray, "_ c"]], flown: SegmentTrajectories, inflation: float, *, flyable: bool = True
) -> LeftOut:
    residual, lengths = np.concatenate(scaled), [len(r) for r in scaled]
    everywhere = np.ones(len(residual), bool)
    return LeftOut(residual, np.ones_like(residual), everywhere, flown.outputs, lengths, inflation, flyable=flyable)


# --- A lag of the separation point that coefficients leave open, asked of trajectories.
# The coefficients follow from the measured angle of attack and its rate, so that a lag and a quasi-steady hysteresis
# draw nearly the same loops of a few seconds. Flown, they differ: hysteresis answers alpha-dot at once, so that lift
# depends on what it does itself, and a lag does not.

SETTLED = (OutputErrorStatus.CONVERGED, OutputErrorStatus.AT_BOUND)


def open_lag(full: CandidateModel, extension: Extension, model: Model) -> Effect | None:
    """The catalogue's lag, if the flow of the extended model separates without one and the lag scores as a rival."""
    lag, stages = lag_of(full), {e.stage for e in model.acting}
    if lag is None or Stage.LAG in stages or Stage.SEPARATION not in stages or not extension.steps:
        return None
    scores = [s.score for s in extension.steps[-1].screening.candidate_scores if s.effect == lag.name]
    return lag if max(scores, default=0.0) >= full.settings.least_rival_score else None


def with_lag(
    model: Model,
    effect: Effect,
    extended: CandidateFit,
    noise: FlightNoise,
    flights: Flights,
    settings: DiagnosisSettings = DEFAULT,
) -> tuple[CandidateFit, LagTest]:
    """The extended model with the lag, fitted to all; hysteresis left at none is held: the lag stands for it."""
    hysteresis = [e for e in model.effects if e.stage is Stage.INCIDENCE and "incidence" in e.example.increments]
    neutral = {name: x for e in hysteresis for name, x in e.neutral_values.items()}
    # Hysteresis not below none: beside a lag it would be a lead that cancels it, and mean nothing.
    bounded = [
        replace(p, bounds=(max(neutral[p.name], p.bounds[0]), p.bounds[1])) if p.name in neutral else p
        for p in model.parameters
    ]
    dynamics = aircraft_dynamics(replace(model, parameters=tuple(bounded)), flights)
    dynamics = with_biases_of(extended.fit.flown.dynamics, dynamics)
    fitted = dict(zip(extended.fit.names, map(float, extended.fit.estimate), strict=True))
    start = np.array([fitted.get(p.name, p.start) for p in dynamics.free])
    whole = replace(extended.fit.flown, dynamics=dynamics, substeps=dynamics.substeps(start, flights))
    inflation = noise.variance_inflation
    fit = fit_output_error(whole, start=start, prior_weight=inflation)
    values = dict(zip(fit.names, fit.estimate, strict=True))
    none = {n: x for n, x in neutral.items() if n in fit.at_bound and values[n] == x}
    if none:
        again = {"start": fit.estimate, "departure": fit.departure, "held": none}
        fit = fit_output_error(whole, **again, prior_weight=inflation)
    gain = -np.inf
    if fit.status in SETTLED and extended.fit.status in SETTLED:
        gain = (extended.fit.cost - fit.cost) / inflation
    sd = np.sqrt(inflation * np.diag(fit.covariance))
    estimates = {n: (float(x), float(s)) for n, x, s in zip(fit.names, fit.estimate, sd, strict=True)}
    away = {p.name: p.away(*estimates[p.name]) for p in effect.parameters if p.name in effect.sizes}
    slight = bool(np.isfinite(gain) and not large(effect, away, settings.least_score))
    lag = LagTest(effect.name, float(gain), instead=tuple(none), slight=slight, decisive=settings.decisive)
    return CandidateFit("lagged", fit, extended.own | {p.name for p in effect.parameters}, none), lag


def confirmed(lag: LagTest, without: LeftOut, lagged: LeftOut, hold_out: float = DEFAULT.hold_out) -> LagTest:
    """Kept if hold-out prediction degrades without the lag, as for any cause; both predict the same manoeuvres."""
    gain, sd = lagged.gain(without)
    return replace(lag, unseen=(gain, sd), kept=bool(lagged.flyable and gain > hold_out * sd))


# --- Which causes flight misses: those without which unseen manoeuvres are flown as well are taken out.
# Coefficients confirm a cause where they follow from it directly. Flown, what it gets wrong adds up over a minute,
# and what is superfluous harms there first.


@dataclass(frozen=True)
class Elimination:
    """The contender with what flight misses, its fits to all segments but one each, and by what each is missed."""

    contender: CandidateFit
    fits: Sequence[OutputErrorResult]
    confirmation: Confirmation
    gone: frozenset[str] = frozenset()  # parameters of causes that were taken out, held at neutral


def eliminate(
    contender: CandidateFit,
    fits: Sequence[OutputErrorResult],
    causes: Sequence[Effect],
    silent: Mapping[int, Mapping[str, float]],
    noise: FlightNoise,
    settings: DiagnosisSettings = DEFAULT,
) -> Elimination:
    """Test each of `causes` on hold-out flights; one with `silent` parameters is not tested and stays."""
    unheard = {name for held in silent.values() for name in held}
    neutral = {e.name: e.neutral_values for e in causes if not unheard & set(e.neutral_values)}
    flight = HeldOutFlights(contender, neutral, silent, noise, {tuple(neutral): fits})
    if not flight.refitted(tuple(neutral)).flyable:  # what cannot be flown is no measure of anything
        return Elimination(contender, fits, Confirmation((), {}))
    confirmation = backward_elimination(tuple(neutral), flight.first_order, flight.refitted, settings)
    less = flight.without(confirmation.kept)
    gone = frozenset(less.held) - frozenset(contender.held)
    if not gone:
        return Elimination(contender, fits, confirmation)
    fit = contender.fit
    again = fit_output_error(fit.flown, start=fit.estimate, held=less.held, prior_weight=noise.variance_inflation)
    return Elimination(replace(less, fit=again), flight.fits[confirmation.kept], confirmation, gone)


@dataclass(frozen=True)
class HeldOutFlights:
    """Segments as a contender with some of its causes flies them, unseen."""

    contender: CandidateFit
    neutral: Mapping[str, Mapping[str, float]]  # parameters of the causes that are asked, by cause
    silent: Mapping[int, Mapping[str, float]]
    noise: FlightNoise
    fits: dict[tuple[str, ...], Sequence[OutputErrorResult]]  # kept by the causes that are in

    def without(self, effects: Sequence[str]) -> CandidateFit:
        """The contender, of what is asked only `effects` in."""
        gone = {name: finite(x) for name, x in self._gone(effects).items()}
        return replace(self.contender, held={**self.contender.held, **gone})

    def _gone(self, effects: Sequence[str]) -> dict[str, float]:
        return {name: x for e, values in self.neutral.items() if e not in effects for name, x in values.items()}

    @cached_property
    def equations_at_optimum(self) -> tuple[Point, Point]:
        """The normal equations at the optimum: with the fitted initial states, and with the measured ones."""
        fit = self.contender.fit
        equations, measured = NormalEquations(fit.flown, fit.priors), np.zeros_like(fit.departure)
        return equations.evaluate(fit.estimate, fit.departure), equations.evaluate(fit.estimate, measured)

    def first_order(self, effects: Sequence[str]) -> LeftOut:
        """Residuals linear in the parameters where all segments are fitted; parameters at a bound stay there."""
        fit, (fitted, measured) = self.contender.fit, self.equations_at_optimum
        A, g, _ = segment_equations(fitted, fit.priors)
        columns = measured.columns
        left = []
        for k, inside in enumerate(fit.flown.inside):
            others = np.arange(len(A)) != k
            information = A[others].sum(axis=0) + np.diag(fit.priors.precision)
            gradient = g[others].sum(axis=0) - fit.priors.precision * (fit.estimate - fit.priors.mean)
            held = {**dict.fromkeys(fit.at_bound), **self.silent[k], **self.contender.held, **self._gone(effects)}
            stated = {n: x for n, x in held.items() if x is not None}
            away = {n: -departure(x, stated[n]) for n, x in zip(fit.names, fit.estimate, strict=True) if n in stated}
            step = np.array([away.get(n, 0.0) for n in fit.names])
            moving = np.array([n not in held for n in fit.names])
            step[moving] = solve(information[np.ix_(moving, moving)], (gradient - information @ step)[moving], 0.0)
            left.append((columns[k, ..., 0] - columns[k, ..., 1 : 1 + len(step)] @ step)[inside])
        return _left_out(left, fit.flown, self.noise.variance_inflation)

    def refitted(self, effects: Sequence[str]) -> LeftOut:
        """Every segment flown by a fit to the others."""
        key, less = tuple(effects), self.without(effects)
        if key not in self.fits:
            self.fits[key] = [fit for _, fit in left_out([less], {less.name: self.silent}, self.noise)]
        paths = holdout_fits(less, self.fits[key], {})
        return left_out_of(paths, self.contender.fit.flown, self.noise.variance_inflation)


# --- Variance inflation of a fit to trajectories.

THINNING = 5  # samples averaged for the autocorrelation of the residuals


def trajectory_variance_inflation(fit: OutputErrorResult) -> float:
    """Median variance inflation of the parameters, from Morelli and Klein's covariance of thinned means."""
    flown, k = fit.flown, len(fit.estimate)
    columns = means(fit.columns, THINNING)
    residual, S = columns[..., 0], columns[..., 1:]
    if fit.priors.fixed:
        S = S[..., :k]
    m = S.shape[1]
    inside = flown.inside[:, : m * THINNING].reshape(len(S), m, THINNING).all(axis=2)
    w, n, c, wide = S.shape
    whole = np.zeros((w, n, c, k + w * (wide - k)))
    whole[..., :k] = S[..., :k]
    for row in range(w):
        begin = k + row * (wide - k)
        whole[row, :, :, begin : begin + wide - k] = S[row, :, :, k:]
    keep = inside.ravel()
    flat, r = whole.reshape(w * n, c, -1)[keep], residual.reshape(w * n, c)[keep]
    start = np.concatenate([[True], np.diff(np.repeat(np.arange(w), n)[keep]) != 0])
    information = np.einsum("nci,c,ncj->ij", flat, 1.0 / fit.R, flat, optimize=True)
    used = np.diag(information) > 0.0
    scale = np.sqrt(np.diag(information)[used])
    D = np.linalg.pinv(information[np.ix_(used, used)] / np.outer(scale, scale), rcond=1e-10, hermitian=True)
    D = D / np.outer(scale, scale)
    corrected = corrected_covariance(D, flat[:, :, used], fit.R, r, np.repeat(np.arange(w), n)[keep], start)
    parameters = int(np.sum(used[:k]))
    return median_inflation(THINNING * variance_inflation(np.diag(corrected), np.diag(D))[:parameters])
