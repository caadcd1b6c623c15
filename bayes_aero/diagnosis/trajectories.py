"""The simulation before and after the extension: fitted to trajectories, flown on what it was not fitted to.

Every manoeuvre is left out in turn. A single one is cut in two halves, each flown by the fit to the other. What the
extended model misses grows as the flow separates, and counts for less there (see `SeparatedFlow`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from threading import Event
from types import MappingProxyType
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from bayes_aero.diagnosis import result
from bayes_aero.diagnosis.consistency import sensor_noise
from bayes_aero.diagnosis.selection import Extension, LeftOut, backward_elimination, large, normal_draws
from bayes_aero.diagnosis.selection_state import DEFAULT, CandidateModel, DiagnosisSettings, by_manoeuvre, finite
from bayes_aero.dynamics import flight
from bayes_aero.dynamics.kalman import neighbour_correlation, prediction_errors, smooth
from bayes_aero.dynamics.segments import SegmentTrajectories, segments
from bayes_aero.dynamics.trim import Steady, modes
from bayes_aero.effect import Effect, Stage
from bayes_aero.errors import InputError
from bayes_aero.flight.card import Card
from bayes_aero.flight.health import channels_of
from bayes_aero.flight.record import FlightRecord
from bayes_aero.inference import output_error, prediction_error
from bayes_aero.inference.covariance import corrected_covariance, means, median_inflation, variance_inflation
from bayes_aero.inference.optimise import solve
from bayes_aero.inference.results import CONFLICT_LIMIT, MleResult, MleStatus, OutputErrorStatus, Posterior
from bayes_aero.model.model import Model
from bayes_aero.model.records import Flights
from bayes_aero.parameter import Prior, departure
from bayes_aero.physics.aircraft import altitude_of_density
from bayes_aero.processes import blas_threads, compiled_at, cores, side_by_side
from bayes_aero.progress import Progress, quiet

Vector = Float[np.ndarray, " k"]
DRAWS = 40  # of the posterior, for the probability of staying inside the tolerances


def label(flown: SegmentTrajectories, row: int) -> str:
    whole = len(flown.flights.lengths) > 1 or len(flown.index) == 1
    half = "" if whole else ", first half" if row == 0 else ", second half"
    return flown.flights.names[int(flown.manoeuvre[row])] + half


def simulated(
    estimate: Vector,
    flown: SegmentTrajectories,
    model: str,
    split: str,
    departure: Float[np.ndarray, "w s"],
    tolerances: Mapping[str, float],
    draws: Float[np.ndarray, "m k"] | None = None,
) -> list[result.SimulatedManoeuvre]:
    """Every segment of `flown` that counts, with these parameters; with `draws` the chance to stay inside."""
    (shown, every), paths = output_error.one_by_one(flown, estimate, departure), []
    for row, trajectory in every.items():
        keep = flown.inside[row]
        measured, residual = np.asarray(trajectory.measured[0])[keep], np.asarray(trajectory.residual[0])[keep]
        chance = {} if draws is None else _probabilities(replace(flown, outputs=shown).part([row]), draws, tolerances)
        errors = {}
        for name, z, e in zip(shown, measured.T, residual.T, strict=True):
            tolerance, size, rms = tolerances.get(name), np.abs(e), float(np.sqrt(np.mean(e**2)))
            within = None if tolerance is None else float(np.mean(size <= tolerance))
            errors[name] = result.Error(
                rms, float(size.max()), result.theil_parts(z, z - e), tolerance, within, chance.get(name)
            )
        histories = ({n: x[:, c] for c, n in enumerate(shown)} for x in (measured, measured - residual))
        inside = bool(np.asarray(trajectory.trajectory.inside[0])[keep].all())
        time = flown.flights.time[flown.index[row][keep]]
        paths.append(result.SimulatedManoeuvre(label(flown, row), model, split, inside, errors, time, *histories))
    return paths


def posterior_draws(
    fit: output_error.OutputErrorResult, variance_inflation: float, seed: int, count: int = DRAWS
) -> Float[np.ndarray, "m k"]:
    moving = np.flatnonzero(fit.sd > 0.0)
    covariance = variance_inflation * fit.covariance[np.ix_(moving, moving)]
    return normal_draws(fit.estimate, moving, covariance, fit.parameters, seed, count)


def _probabilities(
    alone: SegmentTrajectories, draws: Float[np.ndarray, "m k"], tolerances: Mapping[str, float]
) -> dict[str, float]:
    """Share of draws whose whole trajectory, of one segment, stays inside each tolerance and the envelope."""
    # Draw by draw: a simulation of all of them together would have to be compiled, and takes half as long only.
    still = np.zeros((1, len(alone.dynamics.start)))

    def largest(theta):
        trajectory = output_error.trajectories(alone, theta, still)
        inside = np.all(np.asarray(trajectory.trajectory.inside) | ~alone.inside)
        size = np.max(np.abs(np.asarray(trajectory.residual[0])), axis=0)
        return np.where(inside & np.isfinite(size), size, np.inf)

    sizes = dict(zip(alone.outputs, np.stack(side_by_side(largest, draws)).T, strict=True))
    return {n: float(np.mean(size <= tolerances[n])) for n, size in sizes.items() if n in tolerances}


def fly_given(
    flights: Flights, model: Model, values: Mapping[str, float], tolerances: Mapping[str, float]
) -> tuple[result.SimulatedManoeuvre, ...]:
    """Every manoeuvre from its measured initial state, with `values` (SI) of parameters; nothing is fitted."""
    dynamics = flight.aircraft_dynamics(model, flights)
    theta = np.array([values.get(p.name, p.start) for p in dynamics.free])
    whole = segments(flights, dynamics, substeps=dynamics.substeps(theta, flights))
    still = np.zeros((len(whole.index), len(dynamics.start)))
    with np.errstate(over="ignore", invalid="ignore"):  # coefficients that fit may still fly anywhere
        return tuple(simulated(theta, whole, "given", "given", still, tolerances))


# --- The same parameters by a filter that estimates gusts, process noise and measurement noise with them.


@blas_threads(0)
def with_process_noise(
    flown: result.TrajectoryFit,
) -> tuple[result.ProcessNoise, Callable[[int, Progress, str], dict[str, Posterior]]]:
    """Fit again in gusts and with noise of every state that is compared; also what samples its posterior."""
    fit = flown.fit
    gusty, filtered = prediction_error.fit_disturbed(fit.flown, fit.estimate, fit.R, priors=flown.setting.priors)

    def sample(seed: int, progress: Progress, engine: str) -> dict[str, Posterior]:
        with blas_threads(0):
            options = {"seed": seed, "engines": (engine,), "progress": progress}
            return prediction_error.sample_innovations(gusty, filtered, fit.R, **options)

    inside = fit.flown.inside
    of_noise = int(inside.sum()) * float(np.sum(np.log(2.0 * np.pi * fit.R) + 1.0))
    still = -0.5 * of_noise - float(np.log(fit.flown.noise_growth[inside]).sum())
    pairs = zip(map(float, filtered.estimate), map(float, filtered.sd), strict=True)
    estimates = dict(zip(filtered.names, pairs, strict=True))
    parameters = set(fit.flown.dynamics.names) - gusty.dynamics.disturbance_parameters
    converged, predicted = filtered.status is prediction_error.PredictionErrorStatus.CONVERGED, None
    if converged:
        errors = np.asarray(prediction_errors(gusty.nameless, jnp.asarray(filtered.estimate), filtered.found))
        predicted = prediction_error.one_step(filtered.found, errors, filtered.outputs)
    theirs = [i for i, name in enumerate(filtered.names) if name in parameters]
    noise = result.ProcessNoise(
        status=filtered.status.value,
        converged=converged,
        gain=filtered.log_likelihood - still,
        estimates={name: value for name, value in estimates.items() if name in parameters},
        F={n: float(x) for n, x in zip(filtered.states, filtered.F, strict=True) if n in fit.flown.dynamics.start},
        noise_sd=dict(zip(filtered.outputs, map(float, np.sqrt(filtered.R)), strict=True)),
        autocorrelation=dict(zip(filtered.outputs, map(float, neighbour_correlation(filtered.found)), strict=True)),
        gusts={name: value for name, value in estimates.items() if name not in parameters},
        histories=_histories(gusty, filtered),
        one_step=predicted,
        covariance=filtered.covariance[np.ix_(theirs, theirs)],
    )
    return noise, sample


_smoothed = compiled_at(0)(jax.vmap(smooth))


def _histories(
    gusty: SegmentTrajectories, filtered: prediction_error.PredictionErrorResult
) -> tuple[result.GustHistory, ...]:
    """By manoeuvre, by the smoother; only gusts of an intensity that is distinguishable from zero."""
    dynamics, values = gusty.dynamics, dict(zip(filtered.names, filtered.estimate, strict=True))
    model = getattr(dynamics, "model", None)  # of linear cards none
    processes = () if model is None else model.disturbances
    least = {name: result.MIN_INTENSITY * sd for name, sd in zip(filtered.names, filtered.sd, strict=True)}
    sure = [d for d in processes if values.get(d.intensity, 0.0) > least.get(d.intensity, 0.0)]
    met = {d.state: dynamics.states.index(d.state) for d in sure}
    if not met:
        return ()
    (x, P), flights, histories = (np.asarray(y) for y in _smoothed(filtered.found)), gusty.flights, []
    for number in np.unique(gusty.manoeuvre):
        parts = [(k, gusty.inside[k]) for k in np.flatnonzero(gusty.manoeuvre == number)]
        time = np.concatenate([np.asarray(flights.time)[gusty.index[k][real]] for k, real in parts])
        mean, variance = (np.concatenate([y[k, real] for k, real in parts]) for y in (x, P))
        gusts = {name: (mean[:, i], np.sqrt(np.maximum(variance[:, i, i], 0.0))) for name, i in met.items()}
        histories.append(result.GustHistory(flights.names[number], time - time[0], gusts))
    return tuple(histories)


# --- Models fitted to all segments of flight but one, and flown on that one.


@dataclass(frozen=True)
class FlightNoise:
    """What a first fit tells of residuals: their variance inflation, how they grow in the stall."""

    variance_inflation: float
    parts: output_error.SeparatedFlow | None

    @classmethod
    def of(cls, fit: output_error.OutputErrorResult) -> FlightNoise:
        return cls(trajectory_variance_inflation(fit), output_error.SeparatedFlow.of(fit))

    def on(self, flown: SegmentTrajectories, without: int | None = None) -> SegmentTrajectories:
        """The same segments with their noise_growth; its size is read from all of them, or from all but one."""
        return flown if self.parts is None else replace(flown, noise_growth=self.parts.noise_growth(without))

    def growth_by_output(self, outputs: Sequence[str]) -> dict[str, float]:
        growths = np.zeros(len(outputs)) if self.parts is None else self.parts.growths()
        return {name: 1.0 + float(b) for name, b in zip(outputs, growths, strict=True)}


@dataclass(frozen=True)
class CandidateFit:
    """A model fitted to all segments."""

    name: str
    fit: output_error.OutputErrorResult
    own: frozenset[str] = frozenset()  # parameters of its causes
    held: Mapping[str, float] = field(default_factory=dict)  # parameters that are never fitted
    weighed: bool = True  # samples count by the noise_growth of what is missed

    def silent(self, segment: int, unidentified: float) -> dict[str, float]:
        """Joint values of causes' parameters whose standard error without this segment is `unidentified` times more."""
        if not self.own:
            return {}
        others = masked(self.fit.flown, segment, keep=False)
        part = output_error.fit_output_error(
            others, start=self.fit.estimate, departure=self.fit.departure, max_iterations=0
        )
        rows = zip(self.fit.names, self.fit.estimate, part.crb, self.fit.crb, strict=True)
        with np.errstate(invalid="ignore"):
            return {n: float(x) for n, x, alone, all_ in rows if n in self.own and not alone < unidentified * all_}


def masked(flown: SegmentTrajectories, segment: int, *, keep: bool) -> SegmentTrajectories:
    """Only one of the segments counts, or all others; the shapes stay, so nothing compiles anew."""
    counts = (np.arange(len(flown.index)) == segment) == keep
    return eqx.tree_at(lambda f: f.inside, flown, flown.inside & counts[:, None])


def left_out(
    contenders: Sequence[CandidateFit], silent: Mapping[str, Mapping[int, Mapping[str, float]]], noise: FlightNoise
) -> Iterator[tuple[str, output_error.OutputErrorResult]]:
    """Every contender (by its name) and segment: the fit to all other segments, its `silent` parameters held."""
    count = len(contenders[0].fit.flown.index)
    jobs = [(c, k) for c in contenders for k in range(count)]
    stopped = Event()

    def refit(job: tuple[CandidateFit, int]) -> tuple[str, output_error.OutputErrorResult]:
        contender, k = job
        fit, held = contender.fit, {**contender.held, **silent[contender.name][k]}
        weighed = noise.on(fit.flown, without=k) if contender.weighed else fit.flown
        options = {"prior_weight": noise.variance_inflation, "stopped": stopped.is_set}
        rest = masked(weighed, k, keep=False)
        return contender.name, output_error.fit_output_error(rest, start=fit.estimate, held=held, **options)

    # Two fits keep as many cores busy as one with twice the segments, so several are made at once.
    with ThreadPoolExecutor(max(1, cores() // max(1, count - 1))) as pool:
        try:
            yield from pool.map(refit, jobs)
        except BaseException:  # Ctrl-C does not wait for whole fits
            stopped.set()
            raise


def holdout_fits(
    contender: CandidateFit,
    fits: Sequence[output_error.OutputErrorResult],
    tolerances: Mapping[str, float],
    variance_inflation: float = 1.0,
    seed: int = 0,
) -> list[result.SimulatedManoeuvre]:
    """Every segment flown from its measured initial state by the fit without it, in order, and by draws of it."""
    flown, still, paths = contender.fit.flown, np.zeros_like(contender.fit.departure), []
    for k, fit in enumerate(fits):
        drawn = bool(tolerances) and fit.status is not OutputErrorStatus.LEFT_ENVELOPE
        draws = posterior_draws(fit, variance_inflation, seed) if drawn else None
        alone = masked(flown, k, keep=True)
        paths += simulated(fit.estimate, alone, contender.name, "hold_out", still, tolerances, draws)
    return paths


def left_out_of(paths: Sequence[result.SimulatedManoeuvre], flown: SegmentTrajectories, inflation: float) -> LeftOut:
    left = [np.stack([p.measured[n] - p.simulated[n] for n in flown.outputs], axis=1) for p in paths]
    scaled = [x / s for x, s in zip(left, flown.growth, strict=True)]
    return _left_out(scaled, flown, inflation, flyable=all(p.inside for p in paths))


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
    lag, stages = full.lag, {e.stage for e in model.acting}
    if lag is None or Stage.LAG in stages or Stage.SEPARATION not in stages or not extension.steps:
        return None
    scores = [s.score for s in extension.steps[-1].screening.candidate_scores if s.effect == lag.name]
    return lag if max(scores, default=0.0) >= full.settings.least_rival_score else None


def with_lag(
    model: Model, effect: Effect, extended: CandidateFit, noise: FlightNoise, settings: DiagnosisSettings = DEFAULT
) -> tuple[CandidateFit, result.LagTest]:
    """The extended model with the lag, fitted to all; hysteresis left at none is held: the lag stands for it."""
    hysteresis = [e for e in model.effects if e.stage is Stage.INCIDENCE and "incidence" in e.example.increments]
    neutral = {name: x for e in hysteresis for name, x in e.neutral_values.items()}
    # Hysteresis not below none: beside a lag it would be a lead that cancels it, and mean nothing.
    least = {p.name: max(neutral.get(p.name, -np.inf), p.bounds[0]) for p in model.parameters}
    bounded = [replace(p, bounds=(least[p.name], p.bounds[1])) for p in model.parameters]
    flown, earlier = extended.fit.flown, extended.fit.flown.dynamics
    dynamics = flight.aircraft_dynamics(replace(model, parameters=tuple(bounded)), flown.flights)
    dynamics = replace(dynamics, biased=earlier.biased, lengths=earlier.lengths)
    fitted = dict(zip(extended.fit.names, map(float, extended.fit.estimate), strict=True))
    start = np.array([fitted.get(p.name, p.start) for p in dynamics.free])
    whole = replace(flown, dynamics=dynamics, substeps=dynamics.substeps(start, flown.flights))
    inflation = noise.variance_inflation
    fit = output_error.fit_output_error(whole, start=start, prior_weight=inflation)
    values = dict(zip(fit.names, fit.estimate, strict=True))
    none = {n: x for n, x in neutral.items() if n in fit.at_bound and values[n] == x}
    if none:
        again = {"start": fit.estimate, "departure": fit.departure, "held": none}
        fit = output_error.fit_output_error(whole, **again, prior_weight=inflation)
    gain = -np.inf
    if fit.status in SETTLED and extended.fit.status in SETTLED:
        gain = (extended.fit.cost - fit.cost) / inflation
    sd = np.sqrt(inflation * np.diag(fit.covariance))
    estimates = {n: (float(x), float(s)) for n, x, s in zip(fit.names, fit.estimate, sd, strict=True)}
    away = {p.name: p.away(*estimates[p.name]) for p in effect.parameters if p.name in effect.sizes}
    slight = bool(np.isfinite(gain) and not large(effect, away, settings.least_score))
    lag = result.LagTest(effect.name, float(gain), instead=tuple(none), slight=slight, decisive=settings.decisive)
    return CandidateFit("lagged", fit, extended.own | {p.name for p in effect.parameters}, none), lag


def confirmed(
    lag: result.LagTest, without: LeftOut, lagged: LeftOut, hold_out: float = DEFAULT.hold_out
) -> result.LagTest:
    """Kept if hold-out prediction degrades without the lag, as for any cause; both predict the same manoeuvres."""
    gain, sd = lagged.gain(without)
    return replace(lag, unseen=(gain, sd), kept=bool(lagged.flyable and gain > hold_out * sd))


# --- Which causes flight misses: those without which unseen manoeuvres are flown as well are taken out.
# Coefficients confirm a cause where they follow from it directly. Flown, what it gets wrong adds up over a minute,
# and what is superfluous harms there first.


class Elimination(NamedTuple):
    """The contender with what flight misses, its fits to all segments but one each, and by what each is missed."""

    contender: CandidateFit
    fits: Sequence[output_error.OutputErrorResult]
    confirmation: result.Confirmation
    gone: frozenset[str] = frozenset()  # parameters of causes that were taken out, held at neutral


def eliminate(
    contender: CandidateFit,
    fits: Sequence[output_error.OutputErrorResult],
    causes: Sequence[Effect],
    silent: Mapping[int, Mapping[str, float]],
    noise: FlightNoise,
    settings: DiagnosisSettings = DEFAULT,
) -> Elimination:
    """Test each of `causes` on hold-out flights; one with `silent` parameters is not tested and stays."""
    fit, inflation = contender.fit, noise.variance_inflation
    unheard = {name for held in silent.values() for name in held}
    neutral = {e.name: e.neutral_values for e in causes if not unheard & set(e.neutral_values)}
    made = {tuple(neutral): fits}

    def absent(effects: Sequence[str]) -> dict[str, float]:
        return {name: x for e, values in neutral.items() if e not in effects for name, x in values.items()}

    def without(effects: Sequence[str]) -> CandidateFit:
        held = {name: finite(x) for name, x in absent(effects).items()}
        return replace(contender, held={**contender.held, **held})

    def refitted(effects: Sequence[str]) -> LeftOut:
        key, less = tuple(effects), without(effects)
        if key not in made:
            made[key] = [fit for _, fit in left_out([less], {less.name: silent}, noise)]
        return left_out_of(holdout_fits(less, made[key], {}), fit.flown, inflation)

    if not refitted(tuple(neutral)).flyable:  # what cannot be flown is no measure of anything
        return Elimination(contender, fits, result.Confirmation((), {}))
    near = _first_order(contender, silent, inflation)
    confirmation = backward_elimination(tuple(neutral), lambda e: near(absent(e)), refitted, settings)
    less = without(confirmation.kept)
    gone = frozenset(less.held) - frozenset(contender.held)
    if not gone:
        return Elimination(contender, fits, confirmation)
    again = output_error.fit_output_error(fit.flown, start=fit.estimate, held=less.held, prior_weight=inflation)
    return Elimination(replace(less, fit=again), made[confirmation.kept], confirmation, gone)


def _first_order(
    contender: CandidateFit, silent: Mapping[int, Mapping[str, float]], inflation: float
) -> Callable[[Mapping[str, float]], LeftOut]:
    """Segments by fits to the others that are linear in the parameters; those at a bound stay there."""
    fit = contender.fit
    equations, still = output_error.NormalEquations(fit.flown, fit.priors), np.zeros_like(fit.departure)
    # At the optimum, with the fitted initial states, and with the measured ones.
    fitted, measured = (equations.evaluate(fit.estimate, begin) for begin in (fit.departure, still))
    A, g, _ = output_error.segment_equations(fitted, fit.priors)

    def without(absent: Mapping[str, float]) -> LeftOut:
        left = []
        for k, inside in enumerate(fit.flown.inside):
            others = np.arange(len(A)) != k
            information = A[others].sum(axis=0) + np.diag(fit.priors.precision)
            gradient = g[others].sum(axis=0) - fit.priors.precision * (fit.estimate - fit.priors.mean)
            stated = {**silent[k], **contender.held, **absent}
            away = {n: -departure(x, stated[n]) for n, x in zip(fit.names, fit.estimate, strict=True) if n in stated}
            step = np.array([away.get(n, 0.0) for n in fit.names])
            moving = np.array([n not in stated and n not in fit.at_bound for n in fit.names])
            step[moving] = solve(information[np.ix_(moving, moving)], (gradient - information @ step)[moving], 0.0)
            columns = measured.columns[k]
            left.append((columns[..., 0] - columns[..., 1 : 1 + len(step)] @ step)[inside])
        return _left_out(left, fit.flown, inflation)

    return without


THINNING = 5  # samples averaged for the autocorrelation of the residuals


def trajectory_variance_inflation(fit: output_error.OutputErrorResult) -> float:
    """Median variance inflation of the parameters, from Morelli and Klein's covariance of thinned means."""
    columns = means(fit.columns, THINNING)
    k, residual, S = len(fit.estimate), columns[..., 0], columns[..., 1:]
    if fit.priors.fixed:
        S = S[..., :k]
    w, m, c, wide = S.shape
    inside = fit.flown.inside[:, : m * THINNING].reshape(w, m, THINNING).all(axis=2)
    whole = np.pad(S[..., :k], ((0, 0), (0, 0), (0, 0), (0, w * (wide - k))))
    for row in range(w):  # every segment has its own initial state
        begin = k + row * (wide - k)
        whole[row, :, :, begin : begin + wide - k] = S[row, :, :, k:]
    keep = inside.ravel()
    flat, r = whole.reshape(w * m, c, -1)[keep], residual.reshape(w * m, c)[keep]
    segment = np.repeat(np.arange(w), m)[keep]
    start = np.diff(segment, prepend=-1) != 0
    information = np.einsum("nci,c,ncj->ij", flat, 1.0 / fit.R, flat, optimize=True)
    used = np.diag(information) > 0.0
    scale = np.outer(*[np.sqrt(np.diag(information)[used])] * 2)
    D = np.linalg.pinv(information[np.ix_(used, used)] / scale, rcond=1e-10, hermitian=True) / scale
    corrected = corrected_covariance(D, flat[:, :, used], fit.R, r, segment, start)
    parameters = int(np.sum(used[:k]))
    return median_inflation(THINNING * variance_inflation(np.diag(corrected), np.diag(D))[:parameters])


FIRST_INFLATION = 30.0  # variance inflation that is assumed until it is measured
LEFT = ("altitude",)  # reported, not fitted: it adds wind and pressure errors to what attitude and alpha tell already


@blas_threads(0)
def compare_trajectories(
    flights: Flights,
    diagnosis: result.Diagnosis,
    tolerances: Mapping[str, float],
    *,
    biases: Mapping[str, Prior] = MappingProxyType({}),
    seed: int = 0,
    progress: Progress = quiet,
) -> result.Trajectories:
    """Fit the card's model and the extended one to the trajectories, jointly and with each manoeuvre left out.
    `biases`: outputs recorded with a constant error in each manoeuvre, which are fitted, too."""
    settings, causes = diagnosis.aerodynamics.state.full.settings, [c.name for c in diagnosis.causes if c.confirmed]
    added = [e for e in diagnosis.aerodynamics.state.full.model.effects if e.name in causes]
    contenders, lag, noise = _contenders(diagnosis, added, flights, biases, progress)
    best = extended = contenders["extended"]
    progress("trajectories: left out", 0.5)
    count, inflation = len(extended.fit.flown.index), noise.variance_inflation
    silent = {name: {k: c.silent(k, settings.unidentified) for k in range(count)} for name, c in contenders.items()}
    fits: dict[str, list[output_error.OutputErrorResult]] = {name: [] for name in contenders}
    for number, (name, fit) in enumerate(left_out(tuple(contenders.values()), silent, noise), start=1):
        fits[name].append(fit)
        progress("trajectories: left out", 0.5 + 0.3 * number / (count * len(contenders)))
    if lag is not None and "lagged" in contenders:
        unseen = [holdout_fits(contenders[name], fits[name], {}) for name in ("extended", "lagged")]
        without, within = (left_out_of(paths, extended.fit.flown, inflation) for paths in unseen)
        lag = confirmed(lag, without, within, settings.hold_out)
        best = contenders["lagged"] if lag.kept else extended
    progress("trajectories: causes that hold-out flights need", 0.8)
    flies = eliminate(best, fits[best.name], added, silent[best.name], noise, settings)
    progress("trajectories: errors", 0.9)
    paths, shown = [], {"card": (contenders["card"], fits["card"]), "extended": (flies.contender, flies.fits)}
    for name, (c, _) in shown.items():
        paths += simulated(c.fit.estimate, c.fit.flown, name, "fitted", c.fit.departure, tolerances)
    for name, (c, without) in shown.items():
        paths += [replace(p, model=name) for p in holdout_fits(c, without, tolerances, inflation, seed)]
    fit, gone = flies.contender.fit, flies.gone
    sd = np.sqrt(inflation * np.diag(fit.covariance))
    return result.Trajectories(
        paths=tuple(paths),
        card=_estimates(contenders["card"].fit),
        extended=_estimates(fit, gone),
        deviation={n: float(x) for n, x in zip(fit.names, sd, strict=True) if n not in gone},
        variance_inflation=inflation,
        held={label(fit.flown, k): tuple(n for n in names if n not in gone) for k, names in silent[best.name].items()},
        fitted=fit.flown.outputs,
        outputs=tuple(n for n in fit.flown.dynamics.outputs if n in flights.channels),
        noise_growth=noise.growth_by_output(fit.flown.outputs),
        lag=lag,
        asked=flies.confirmation,
    )


def _estimates(fit: output_error.OutputErrorResult, gone: Collection[str] = ()) -> result.TrajectoryEstimates:
    values = {n: float(x) for n, x in zip(fit.names, fit.estimate, strict=True) if n not in gone}
    units = {p.name: p.unit for p in fit.parameters if p.name in values}
    held = tuple(n for n in fit.held_by_prior if n in values)
    return result.TrajectoryEstimates(values, units, fit.status, fit.at_bound, held)


def _contenders(
    diagnosis: result.Diagnosis, added: Sequence[Effect], flights: Flights, biases: Mapping[str, Prior], tell: Progress
) -> tuple[dict[str, CandidateFit], result.LagTest | None, FlightNoise]:
    """The extended model fitted to all flights, the one with a lag where that gains, and the card's."""
    card, state, whole = diagnosis.aerodynamics.base, diagnosis.aerodynamics.state, diagnosis.aerodynamics.state.full
    base = [e for e in whole.model.effects if e.name in whole.base or not e.parameters]
    values, model = dict(zip(whole.model.names, state.theta, strict=True)), _extended(whole.model, [*base, *added])
    tell("trajectories: extended model", 0.0)
    stages, start = _side(flights, biases, model, values)
    joint = output_error.fit_cascade(stages, [start], prior_weight=FIRST_INFLATION)
    noise = FlightNoise.of(joint)
    options = {"departure": joint.departure, "prior_weight": noise.variance_inflation}
    joint = output_error.fit_output_error(noise.on(stages[-1]), start=joint.estimate, **options)
    extended = CandidateFit("extended", joint, frozenset(p.name for e in added for p in e.parameters))
    contenders, lag, effect = [extended], None, open_lag(whole, diagnosis.aerodynamics, model)
    if effect is not None:
        tell("trajectories: separation lag", 0.2)
        wider = _extended(whole.model, [*base, *added, effect])
        lagged, lag = with_lag(wider, effect, extended, noise, whole.settings)
        contenders += [lagged] if lag.gains else []
    tell("trajectories: card's model", 0.3)
    # The causes at neutral; from its own start and from what the extended model shares with it.
    before = dict(zip(card.full.model.names, card.theta, strict=True))
    held = {name: whole.neutral[name] for name in extended.own if name in joint.names}
    first = {p.name: p.start for p in stages[-1].dynamics.free} | before | held
    start = np.array([first[name] for name in stages[-1].dynamics.names])
    if any(e.stage is Stage.LAG for e in added):  # a state that the card's model does not have
        (stages, start), held = _side(flights, biases, _extended(whole.model, base), before), {}
    fitted = dict(zip(joint.names, joint.estimate, strict=True))
    shared = np.array([fitted[name] for name in stages[-1].dynamics.names])
    # A model with something missing may have several optima; what it misses is not confined to the stall.
    fit = output_error.fit_cascade(stages, [start, shared], held=held, prior_weight=noise.variance_inflation)
    contenders.append(CandidateFit("card", fit, held=held, weighed=False))
    return {c.name: c for c in contenders}, lag, noise


def _side(
    flights: Flights, biases: Mapping[str, Prior], model: Model, values: Mapping[str, float]
) -> tuple[list[SegmentTrajectories], Vector]:
    """One model, cut for its fits (windows, then whole manoeuvres or the halves of a single one), and its start."""
    dynamics = flight.biased_dynamics(flight.aircraft_dynamics(model, flights), flights, biases)
    start = np.array([values.get(p.name, p.start) for p in dynamics.free])
    outputs = tuple(n for n in dynamics.outputs if n in flights.channels and n not in LEFT)
    half = 0.5 * flights.lengths[0] * float(flights.channels["dt"][0]) if len(flights.lengths) == 1 else None
    options = {"outputs": outputs, "substeps": dynamics.substeps(start, flights)}
    return [segments(flights, dynamics, window=w, **options) for w in (result.WINDOW, half)], start


def _extended(whole: Model, effects: Sequence) -> Model:
    """The chosen effects with the parameters and fixed values that they have in the model of all candidates."""
    names = {p.name for e in effects for p in e.parameters}
    parameters = {p.name: p for p in whole.parameters}
    model = Model.of(effects, {k: v for k, v in whole.fixed if k in names}, whole.axes)
    return replace(model, parameters=tuple(parameters[p.name] for p in model.parameters))


@blas_threads(0)
def fit_trajectories(
    flights: Flights,
    dynamics: flight.Dynamics,
    units: Mapping[str, str],
    *,
    starts: Sequence[Vector] = (),
    tolerances: Mapping[str, float] = MappingProxyType({}),
    setting: result.Setting = result.Setting(),
    progress: Progress = quiet,
) -> result.TrajectoryFit:
    """Fit windows from the parameters' own start and every one of `starts`, then whole manoeuvres."""
    # Colour, and growth as the flow separates, of what is missed weigh the last fit's priors and samples.
    by_effects = isinstance(flight.unbiased(dynamics), flight.AircraftDynamics)
    dynamics = flight.biased_dynamics(dynamics, flights, setting.biases)
    first = np.array([p.start for p in dynamics.free])
    starts = [np.append(s, first[len(s) :]) for s in starts]
    shown = tuple(name for name in dynamics.outputs if name in flights.channels)
    compared = setting.outputs or tuple(n for n in shown if not (by_effects and n in LEFT))
    options = {"outputs": compared, "substeps": dynamics.substeps(first, flights), "held": setting.held}
    short = segments(flights, dynamics, window=setting.window, **options)
    whole = segments(flights, dynamics, fixed=setting.initial, **options)
    stages = [whole] if len(short.index) == len(whole.index) else [short, whole]
    progress("windows, then whole manoeuvres", 0.0)
    without = () if setting.priors else flight.unbiased(dynamics).names
    fit = output_error.fit_cascade(stages, [first, *starts], prior_weight=FIRST_INFLATION, without=without)
    if len(stages) == 1 and fit.status is OutputErrorStatus.NOT_CONVERGED:  # a first stage stops early
        again = {"departure": fit.departure, "prior_weight": FIRST_INFLATION, "without": without}
        fit = output_error.fit_output_error(whole, start=fit.estimate, **again)
    inflation, noise_growth = math.nan, {}
    if math.isfinite(fit.cost) and fit.status is not OutputErrorStatus.LEFT_ENVELOPE:
        progress("autocorrelation of the residuals", 0.7)
        noise = FlightNoise.of(fit)
        inflation, noise_growth = noise.variance_inflation, noise.growth_by_output(whole.outputs)
        whole, weight = noise.on(whole), inflation if setting.priors else 0.0
        fit = output_error.fit_output_error(whole, start=fit.estimate, departure=fit.departure, prior_weight=weight)
    progress("errors of the trajectories", 0.9)
    with np.errstate(over="ignore", invalid="ignore"):  # a first guess may fly anywhere
        paths = simulated(first, whole, result.START, result.START, np.zeros_like(fit.departure), tolerances)
        paths += simulated(fit.estimate, whole, result.FITTED, result.FITTED, fit.departure, tolerances)
    wide, theta, initial = replace(fit.flown, outputs=shown), fit.estimate, {}
    for row, away in enumerate(fit.departure):  # one by one as the paths, for which it is compiled already
        begin = output_error.trajectories(wide.part([row]), theta, away[None]).begin
        pairs = zip(map(float, np.asarray(begin)[0]), map(float, away), strict=True)
        initial[label(fit.flown, row)] = dict(zip(fit.flown.dynamics.start, pairs, strict=True))
    begins = zip(dynamics.start, map(float, output_error.initial_state_sd(dynamics)), strict=True)
    prior_sd = dict(begins) if setting.priors and setting.initial is None else {}
    return result.TrajectoryFit(
        fit, first, tuple(paths), initial, inflation, shown, dict(units), noise_growth, setting,
        by_effects=by_effects, of_path=isinstance(dynamics, flight.PathDynamics), departure_sd=prior_sd,
    )  # fmt: skip


# --- What a diagnosis by trajectories alone has tested: does the simulation miss more than measurement noise?
# Of structure without a name only terms of the library are sought along trajectories. Causes that improve the fit
# explain what the card's model gets wrong only as far as nothing is left beside the noise of the sensors, an
# absolute scale.


def beyond_noise(flown: result.Trajectories | None, records: Sequence[FlightRecord], card: Card) -> result.Tested:
    """What the extended model misses of each fitted output (root mean squares, SI), and the noise; empty: not flown."""
    if flown is None:
        return result.Tested({})
    noises, lengths = [sensor_noise(channels_of(record, card), card)[0] for record in records], [r.n for r in records]

    def rms(output: str, split: str) -> float:
        paths = [p for p in flown.paths if (p.model, p.split) == ("extended", split)]
        squares, samples = [p.errors[output].rms ** 2 for p in paths], [len(p.time) for p in paths]
        return float(np.sqrt(np.average(squares, weights=samples))) if paths else float("nan")

    misses = {}
    for name in flown.fitted:
        noise = float(np.sqrt(np.average([n.get(name, 0.0) ** 2 for n in noises], weights=lengths)))
        misses[name] = result.OutputMiss(noise, rms(name, "fitted"), rms(name, "hold_out"))
    return result.Tested(misses)


# --- The same parameters from the coefficients and from trajectories: where the two fits of one record disagree.

WORTH = 0.03  # of an estimate, a difference that matters to a simulation; our choice


def still_apart(disagreements: Sequence[result.Disagreement], fit: result.ProcessNoise | None) -> tuple[str, ...]:
    """Parameters of `disagreements` of which the fit with process noise disagrees with the coefficients as well."""
    other = {} if fit is None else fit.estimates
    return tuple(d.name for d in disagreements if d.name in other and not _agree(d.coefficients, other[d.name]))


def fit_disagreements(coefficients: MleResult, flown: result.TrajectoryFit) -> tuple[result.Disagreement, ...]:
    """Parameters, none at a bound, about which the fits differ beyond chance and by more than `WORTH`."""
    if coefficients.status not in (MleStatus.CONVERGED, MleStatus.AT_BOUND) or not flown.converged:
        return ()
    fit, disagreements = flown.fit, []
    bound = {*coefficients.at_bound, *fit.at_bound, *fit.held_by_prior}
    pairs = zip(map(float, coefficients.estimate), map(float, coefficients.crb_corrected), strict=True)
    by_coefficients = dict(zip(coefficients.names, pairs, strict=True))
    for parameter, x, sd in zip(fit.parameters, map(float, fit.estimate), map(float, fit.sd_corrected), strict=True):
        if parameter.name not in bound and parameter.name in by_coefficients:
            other = by_coefficients[parameter.name]
            both = float(np.hypot(sd, other[1]))
            if np.isfinite(both) and both > 0.0 and not _agree(other, (x, sd)):
                apart = abs(x - other[0]) / both
                disagreements.append(result.Disagreement(parameter.name, parameter.unit, other, (x, sd), apart))
    return tuple(sorted(disagreements, key=lambda d: -d.apart))


def _agree(estimate: tuple[float, float], other: tuple[float, float]) -> bool:
    """Whether two estimates, each with its standard error, differ by no more than chance or `WORTH`."""
    (x, sd), (y, its) = estimate, other
    return abs(x - y) <= max(CONFLICT_LIMIT * float(np.hypot(sd, its)), WORTH * max(abs(x), abs(y)))


# --- Modes of motion of a fitted model with standard errors.
# Errors are of first order: central differences of the eigenvalues, each about its own trim, over a tenth of the
# standard error of every parameter, with the covariance that allows for coloured residuals, or that of the fit with
# process noise.

STEP = 0.1  # standard errors
KNOWN = 2.0  # standard errors from which a real part differs from zero; our choice
BEGIN = 1.0  # s at a manoeuvre's beginning, before it is disturbed


def steady_of(flights: Flights) -> Steady:
    """The steady flight from which the manoeuvres begin: medians over them of the first second."""

    def begin(name: str, otherwise: float) -> float:
        if name not in flights.channels:
            return otherwise
        parts = zip(by_manoeuvre(np.asarray(flights.channels[name], float), flights), times, strict=True)
        return float(np.median([np.median(x[time <= time[0] + BEGIN]) for x, time in parts]))

    times = by_manoeuvre(flights.time, flights)
    density = begin("density", math.nan)
    altitude = altitude_of_density(density) if density > 0.0 else begin("altitude", 0.0)
    return Steady(begin("airspeed", 1.0), altitude, begin("alpha", 0.0))


def flown_modes(
    fit: output_error.OutputErrorResult, steady: Steady, filtered: result.ProcessNoise | None = None
) -> tuple[result.FlownMode, ...]:
    """The modes of a model whose fit converged, about `steady` flight; with the estimates of `filtered` in place of
    those of `fit`. Raises `InputError` where there is no such flight, or the model has no motion of its own."""
    dynamics, aircraft = flight.unbiased(fit.flown.dynamics), fit.flown.flights.aircraft
    count = len(dynamics.free)
    theta, covariance = np.asarray(fit.estimate[:count]), np.asarray(fit.corrected)[:count, :count]
    unknown = [k for k, p in enumerate(fit.parameters[:count]) if p.name in fit.undetermined]
    if filtered is not None:
        order, unknown = [list(filtered.estimates).index(name) for name in dynamics.names], []
        theta = np.array([filtered.estimates[name][0] for name in dynamics.names])
        matrix = filtered.covariance
        covariance = np.zeros((count, count)) if matrix is None else matrix[np.ix_(order, order)]
    about_trim = modes(dynamics, dynamics.values(theta), aircraft, steady)
    slopes, scale = np.zeros((len(about_trim), 2, count)), np.sqrt(np.diag(covariance))
    scale[unknown] = np.maximum(np.abs(theta[unknown]), 1e-2)  # only whether it matters
    for k in np.flatnonzero(scale):
        step = STEP * scale[k] * np.eye(count)[k]
        try:
            ends = [modes(dynamics, dynamics.values(x), aircraft, steady) for x in (theta + step, theta - step)]
        except InputError:
            slopes[:, :, k] = math.nan
            continue
        for mode, slope in zip(about_trim, slopes, strict=True):
            plus, minus = (min((m.eigenvalue for m in x), key=lambda y: abs(y - mode.eigenvalue)) for x in ends)
            change = (plus - minus) / (2.0 * step[k])
            slope[:, k] = change.real, change.imag
    moved = np.any(np.abs(slopes[:, :, unknown]) > 1e-9, axis=(1, 2))
    return tuple(
        flown_mode(mode.name, mode.eigenvalue, np.full((2, 2), np.inf) if lost else J @ covariance @ J.T)
        for mode, J, lost in zip(about_trim, slopes, moved, strict=True)
    )


def flown_mode(name: str, eigenvalue: complex, covariance: Float[np.ndarray, "2 2"]) -> result.FlownMode:
    def root(variance: float) -> float:
        return math.sqrt(max(variance, 0.0)) if math.isfinite(variance) else math.inf

    sd_real, sd_imaginary = (root(float(x)) for x in np.diag(covariance))
    s, w = eigenvalue.real, eigenvalue.imag

    def with_error(value: float, slope: tuple[float, float]) -> tuple[float, float]:
        along = np.array(slope)
        kept = along != 0.0  # infinite errors of what it does not depend on
        part = covariance[np.ix_(kept, kept)]
        return value, root(float(along[kept] @ part @ along[kept])) if np.all(np.isfinite(part)) else math.inf

    quantities = {}
    if w > 0.0:
        size = abs(eigenvalue)
        quantities["period"] = with_error(2.0 * math.pi / w, (0.0, -2.0 * math.pi / w**2))
        quantities["damping_ratio"] = with_error(-s / size, (-(w**2) / size**3, s * w / size**3))
    if abs(s) > KNOWN * sd_real and s != 0.0:
        if w == 0.0 and s < 0.0:
            quantities["time_constant"] = with_error(-1.0 / s, (1.0 / s**2, 0.0))
        half, side = math.log(2.0), "half" if s < 0.0 else "double"
        quantities[f"time_to_{side}"] = with_error(half / abs(s), (-math.copysign(half, s) / s**2, 0.0))
    return result.FlownMode(name, eigenvalue, (sd_real, sd_imaginary), quantities)


def motion_of(flown: result.TrajectoryFit, beside: result.ProcessNoise | None = None) -> result.Motion | None:
    """Modes with standard errors; None without a model of the aircraft, and where the fit did not converge."""
    if flown.of_path or not flown.converged:
        return None
    steady, eigenmodes, why_not = steady_of(flown.fit.flown.flights), (), ""
    filtered = beside if beside is not None and beside.preferred else None
    try:
        eigenmodes = flown_modes(flown.fit, steady, filtered)
    except InputError as reason:
        why_not = str(reason)
    about = (steady.airspeed, steady.altitude) if flown.by_effects else (math.nan, math.nan)  # of linear cards
    return result.Motion(*about, eigenmodes, why_not, filtered is not None)
