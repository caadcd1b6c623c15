"""The simulation before and after the extension: fitted to trajectories, flown on what it was not fitted to.

Every manoeuvre is left out in turn. A single one is cut in two halves, each flown by the fit to the other. What the
extended model misses grows as the flow separates, and counts for less there (see `SeparatedFlow`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from functools import partial

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from bayes_aero.diagnosis.candidate_set import manoeuvres
from bayes_aero.diagnosis.consistency import sensor_noise
from bayes_aero.diagnosis.flights import (
    CandidateFit,
    FlightNoise,
    confirmed,
    eliminate,
    holdout_fits,
    label,
    left_out,
    left_out_of,
    open_lag,
    simulated,
    with_lag,
)
from bayes_aero.diagnosis.result import (
    FITTED,
    HALF,
    START,
    Diagnosis,
    Disagreement,
    FlownMode,
    LagTest,
    Motion,
    OutputMiss,
    ProcessNoise,
    Setting,
    Tested,
    Trajectories,
    TrajectoryEstimates,
    TrajectoryFit,
    verdict_of,
)
from bayes_aero.dynamics.flight import (
    AircraftDynamics,
    Dynamics,
    PathDynamics,
    aircraft_dynamics,
    biased_dynamics,
    unbiased,
)
from bayes_aero.dynamics.segments import SegmentTrajectories, segments
from bayes_aero.dynamics.trim import Steady, modes
from bayes_aero.effect import Effect, Stage
from bayes_aero.errors import InputError
from bayes_aero.flight.card import Card
from bayes_aero.flight.health import channels_of
from bayes_aero.flight.record import FlightRecord
from bayes_aero.inference.output_error import (
    OutputErrorResult,
    fit_cascade,
    fit_output_error,
    initial_state_sd,
    trajectories,
)
from bayes_aero.inference.results import CONFLICT_LIMIT, MleResult, MleStatus, OutputErrorStatus
from bayes_aero.model.model import Model
from bayes_aero.model.records import Flights
from bayes_aero.parameter import Prior
from bayes_aero.physics.aircraft import altitude_of_density
from bayes_aero.processes import blas_threads
from bayes_aero.progress import Progress

WINDOW = 12.0  # s, of the first fits
FIRST_INFLATION = 30.0  # variance inflation that is assumed until it is measured
LEFT = ("altitude",)  # reported, not fitted: it adds wind and pressure errors to what attitude and alpha tell already


@blas_threads(0)
def compare_trajectories(
    flights: Flights,
    diagnosis: Diagnosis,
    tolerances: Mapping[str, float],
    *,
    biases: Mapping[str, Prior] | None = None,
    seed: int = 0,
    progress: Progress | None = None,
) -> Trajectories:
    """Fit the card's model and the extended one to the trajectories, jointly and with each manoeuvre left out.
    `biases`: outputs recorded with a constant error in each manoeuvre, which are fitted, too."""

    def tell(text: str, share: float) -> None:
        if progress:
            progress(f"trajectories: {text}", share)

    settings, causes = diagnosis.aerodynamics.state.full.settings, [c.name for c in diagnosis.causes if c.confirmed]
    added = [e for e in diagnosis.aerodynamics.state.full.model.effects if e.name in causes]
    contenders, lag, noise = _contenders(diagnosis, added, flights, biases, tell)
    best = extended = contenders["extended"]
    tell("left out", 0.5)
    count, inflation = len(extended.fit.flown.index), noise.variance_inflation
    silent = {name: {k: c.silent(k, settings.unidentified) for k in range(count)} for name, c in contenders.items()}
    fits: dict[str, list[OutputErrorResult]] = {name: [] for name in contenders}
    for number, (name, fit) in enumerate(left_out(tuple(contenders.values()), silent, noise), start=1):
        fits[name].append(fit)
        tell("left out", 0.5 + 0.3 * number / (count * len(contenders)))
    if lag is not None and "lagged" in contenders:
        unseen = [holdout_fits(contenders[name], fits[name], {}) for name in ("extended", "lagged")]
        without, within = (left_out_of(paths, extended.fit.flown, inflation) for paths in unseen)
        lag = confirmed(lag, without, within, settings.hold_out)
        best = contenders["lagged"] if lag.kept else extended
    tell("causes that hold-out flights need", 0.8)
    flies = eliminate(best, fits[best.name], added, silent[best.name], noise, settings)
    tell("errors", 0.9)
    paths, shown = [], {"card": (contenders["card"], fits["card"]), "extended": (flies.contender, flies.fits)}
    for name, (c, _) in shown.items():
        paths += simulated(c.fit.estimate, c.fit.flown, name, "fitted", c.fit.departure, tolerances)
    for name, (c, without) in shown.items():
        paths += [replace(p, model=name) for p in holdout_fits(c, without, tolerances, inflation, seed)]
    fit, gone = flies.contender.fit, flies.gone
    sd = np.sqrt(inflation * np.diag(fit.covariance))
    return Trajectories(
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


def _estimates(fit: OutputErrorResult, gone: Collection[str] = ()) -> TrajectoryEstimates:
    """Of a fit, without the parameters that are `gone`."""
    values = {n: float(x) for n, x in zip(fit.names, fit.estimate, strict=True) if n not in gone}
    units = {p.name: p.unit for p in fit.parameters if p.name in values}
    held = tuple(n for n in fit.held_by_prior if n in values)
    return TrajectoryEstimates(values, units, fit.status, fit.at_bound, held)


def _contenders(
    diagnosis: Diagnosis, added: Sequence[Effect], flights: Flights, biases: Mapping[str, Prior] | None, tell: Progress
) -> tuple[dict[str, CandidateFit], LagTest | None, FlightNoise]:
    """The extended model fitted to all flights, the one with a lag where that gains, and the card's."""
    whole = diagnosis.aerodynamics.state.full
    base = [e for e in whole.model.effects if e.name in whole.base or not e.parameters]
    values, model = dict(zip(whole.model.names, diagnosis.theta, strict=True)), _extended(whole.model, [*base, *added])
    tell("extended model", 0.0)
    side = partial(_side, flights, biases)
    stages, start = side(model, values)
    joint = fit_cascade(stages, [start], prior_weight=FIRST_INFLATION)
    noise = FlightNoise.of(joint)
    options = {"departure": joint.departure, "prior_weight": noise.variance_inflation}
    joint = fit_output_error(noise.on(stages[-1]), start=joint.estimate, **options)
    extended = CandidateFit("extended", joint, frozenset(p.name for e in added for p in e.parameters))
    contenders, lag, effect = [extended], None, open_lag(whole, diagnosis.aerodynamics, model)
    if effect is not None:
        tell("separation lag", 0.2)
        wider = _extended(whole.model, [*base, *added, effect])
        lagged, lag = with_lag(wider, effect, extended, noise, flights, whole.settings)
        contenders += [lagged] if lag.gains else []
    tell("card's model", 0.3)
    contenders.append(_card(diagnosis, _extended(whole.model, base), stages, added, extended, noise, side))
    return {c.name: c for c in contenders}, lag, noise


def _card(
    diagnosis: Diagnosis,
    bare: Model,
    stages: list[SegmentTrajectories],
    added: Sequence[Effect],
    extended: CandidateFit,
    noise: FlightNoise,
    side: Callable[[Model, Mapping[str, float]], Side],
) -> CandidateFit:
    """The card's model, the causes at neutral; from its own start and from what the extended one shares with it."""
    base, neutral = diagnosis.aerodynamics.base, diagnosis.aerodynamics.state.full.neutral
    before = dict(zip(base.full.model.names, base.theta, strict=True))
    held = {name: neutral[name] for name in extended.own if name in extended.fit.names}
    first = {p.name: p.start for p in stages[-1].dynamics.free} | before | held
    start = np.array([first[name] for name in stages[-1].dynamics.names])
    if any(e.stage is Stage.LAG for e in added):  # a state that the card's model does not have
        (stages, start), held = side(bare, before), {}
    fitted = dict(zip(extended.fit.names, extended.fit.estimate, strict=True))
    shared = np.array([fitted[name] for name in stages[-1].dynamics.names])
    starts = [start, shared]  # a model with something missing may have several optima
    fit = fit_cascade(stages, starts, held=held, prior_weight=noise.variance_inflation)
    return CandidateFit("card", fit, held=held, weighed=False)  # what it misses is not confined to the stall


Side = tuple[list[SegmentTrajectories], Float[np.ndarray, " k"]]
"""One model, cut for its fits (windows, then whole manoeuvres or the halves of a single one), and where it starts."""


def _side(flights: Flights, biases: Mapping[str, Prior] | None, model: Model, values: Mapping[str, float]) -> Side:
    dynamics = biased_dynamics(aircraft_dynamics(model, flights), flights, biases or {})
    start = np.array([values.get(p.name, p.start) for p in dynamics.free])
    outputs = tuple(n for n in dynamics.outputs if n in flights.channels and n not in LEFT)
    half = 0.5 * flights.lengths[0] * float(flights.channels["dt"][0]) if len(flights.lengths) == 1 else None
    finer = dynamics.substeps(start, flights)
    return [segments(flights, dynamics, outputs=outputs, window=w, substeps=finer) for w in (WINDOW, half)], start


def _extended(whole: Model, effects: Sequence) -> Model:
    """The chosen effects with the parameters and fixed values that they have in the model of all candidates."""
    names = {p.name for e in effects for p in e.parameters}
    parameters = {p.name: p for p in whole.parameters}
    model = Model.of(effects, {k: v for k, v in whole.fixed if k in names}, whole.axes)
    return replace(model, parameters=tuple(parameters[p.name] for p in model.parameters))


# --- One model fitted to trajectories: parameters, initial states, variance inflation, errors by flight.


@blas_threads(0)
def fit_trajectories(
    flights: Flights,
    dynamics: Dynamics,
    units: Mapping[str, str],
    *,
    starts: Sequence[Float[np.ndarray, " k"]] = (),
    window: float = WINDOW,
    tolerances: Mapping[str, float] | None = None,
    biases: Mapping[str, Prior] | None = None,
    setting: Setting | None = None,
    progress: Progress | None = None,
) -> TrajectoryFit:
    """Fit windows of `window` s from the parameters' own start and every one of `starts`, then whole manoeuvres.
    Colour, and growth as the flow separates, of what is missed are measured on the way; the last fit weighs its priors
    by the one and its samples by the other."""
    setting = setting or Setting()

    def tell(text: str, share: float) -> None:
        if progress:
            progress(text, share)

    by_effects = isinstance(unbiased(dynamics), AircraftDynamics)
    dynamics = biased_dynamics(dynamics, flights, biases or {})
    first = np.array([p.start for p in dynamics.free])
    starts = [np.append(s, first[len(s) :]) for s in starts]
    shown = tuple(name for name in dynamics.outputs if name in flights.channels)
    compared = tuple(n for n in shown if not (by_effects and n in LEFT))
    compared = compared if setting.outputs is None else setting.outputs
    options = {"outputs": compared, "substeps": dynamics.substeps(first, flights), "held": setting.held}
    short = segments(flights, dynamics, window=window, **options)
    whole = segments(flights, dynamics, fixed=setting.initial, **options)
    stages = [whole] if len(short.index) == len(whole.index) else [short, whole]
    tell("windows, then whole manoeuvres", 0.0)
    without = () if setting.priors else unbiased(dynamics).names
    fit = fit_cascade(stages, [first, *starts], prior_weight=FIRST_INFLATION, without=without)
    if len(stages) == 1 and fit.status is OutputErrorStatus.NOT_CONVERGED:  # a first stage stops early
        again = {"departure": fit.departure, "prior_weight": FIRST_INFLATION, "without": without}
        fit = fit_output_error(whole, start=fit.estimate, **again)
    inflation, noise_growth = math.nan, {}
    if math.isfinite(fit.cost) and fit.status is not OutputErrorStatus.LEFT_ENVELOPE:
        tell("autocorrelation of the residuals", 0.7)
        noise = FlightNoise.of(fit)
        inflation, noise_growth = noise.variance_inflation, noise.growth_by_output(whole.outputs)
        whole = noise.on(whole)
        weight = inflation if setting.priors else 0.0
        fit = fit_output_error(whole, start=fit.estimate, departure=fit.departure, prior_weight=weight)
    tell("errors of the trajectories", 0.9)
    bands, still = tolerances or {}, np.zeros_like(fit.departure)
    with np.errstate(over="ignore", invalid="ignore"):  # a first guess may fly anywhere
        paths = simulated(first, whole, START, START, still, bands)
        paths += simulated(fit.estimate, whole, FITTED, FITTED, fit.departure, bands)
    begins = zip(dynamics.start, map(float, initial_state_sd(dynamics)), strict=True)
    prior_sd = dict(begins) if setting.priors and setting.initial is None else {}
    return TrajectoryFit(
        fit, first, tuple(paths), _initial(fit, shown), inflation, shown, dict(units), window, noise_growth, setting,
        by_effects=by_effects,
        of_path=isinstance(dynamics, PathDynamics),
        departure_sd=prior_sd,
    )  # fmt: skip


def _initial(fit: OutputErrorResult, shown: tuple[str, ...]) -> dict[str, dict[str, tuple[float, float]]]:
    wide, theta = replace(fit.flown, outputs=shown), jnp.asarray(fit.estimate)
    initial = {}
    for row, departure in enumerate(fit.departure):  # one by one as the paths, for which it is compiled already
        alone = trajectories(wide.part([row]), theta, jnp.asarray(departure[None]))
        begin = np.asarray(alone.begin)[0]
        named = zip(fit.flown.dynamics.start, begin, departure, strict=True)
        initial[label(fit.flown, row)] = {name: (float(at), float(away)) for name, at, away in named}
    return initial


# --- What a diagnosis by trajectories alone has tested: does the simulation miss more than measurement noise?
# Of structure without a name only terms of the library are sought along trajectories. Causes that improve the fit
# explain what the card's model gets wrong only as far as nothing is left beside the noise of the sensors, an
# absolute scale.


def with_tested(
    diagnosis: Diagnosis, flown: Trajectories | None, records: Sequence[FlightRecord], card: Card
) -> Diagnosis:
    """The diagnosis by trajectories, judged on hold-out flights; `flown` is its extended model, None if not flown."""
    tested = Tested({} if flown is None else beyond_noise(flown, records, card))
    return replace(diagnosis, tested=tested, verdict=verdict_of(diagnosis.causes, diagnosis.left, tested))


def beyond_noise(flown: Trajectories, records: Sequence[FlightRecord], card: Card) -> dict[str, OutputMiss]:
    """What the extended model misses of every fitted output (root mean squares, SI), and the noise that is allowed."""
    noises = [sensor_noise(channels_of(record, card), card)[0] for record in records]
    lengths = [record.n for record in records]

    def rms(output: str, split: str) -> float:
        paths = [p for p in flown.paths if (p.model, p.split) == ("extended", split)]
        squares, samples = [p.errors[output].rms ** 2 for p in paths], [len(p.time) for p in paths]
        return float(np.sqrt(np.average(squares, weights=samples))) if paths else float("nan")

    return {
        name: OutputMiss(
            noise=float(np.sqrt(np.average([n.get(name, 0.0) ** 2 for n in noises], weights=lengths))),
            fitted=rms(name, "fitted"),
            unseen=rms(name, "hold_out"),
        )
        for name in flown.fitted
    }


# --- The same parameters from the coefficients and from trajectories: where the two fits of one record disagree.

WORTH = 0.03  # of an estimate, a difference that matters to a simulation; our choice


def still_apart(disagreements: Sequence[Disagreement], fit: ProcessNoise | None) -> tuple[str, ...]:
    """Parameters of `disagreements` of which the fit with process noise disagrees with the coefficients as well."""
    other = {} if fit is None else fit.estimates
    return tuple(d.name for d in disagreements if d.name in other and not _agree(d.coefficients, other[d.name]))


def fit_disagreements(coefficients: MleResult, flown: TrajectoryFit) -> tuple[Disagreement, ...]:
    """Parameters, none at a bound, about which the fits differ beyond chance and by more than `WORTH`."""
    if coefficients.status not in (MleStatus.CONVERGED, MleStatus.AT_BOUND) or not flown.converged:
        return ()
    fit, disagreements = flown.fit, []
    bound = {*coefficients.at_bound, *fit.at_bound, *fit.held_by_prior}
    pairs = zip(coefficients.estimate, coefficients.crb_corrected, strict=True)
    by_coefficients = dict(zip(coefficients.names, pairs, strict=True))
    for parameter, x, sd in zip(fit.parameters, fit.estimate, fit.sd_corrected, strict=True):
        if parameter.name in bound or parameter.name not in by_coefficients:
            continue
        other, its = by_coefficients[parameter.name]
        both = float(np.hypot(sd, its))
        pairs = (float(other), float(its)), (float(x), float(sd))
        if np.isfinite(both) and both > 0.0 and not _agree(*pairs):
            apart = float(abs(x - other) / both)
            disagreements.append(Disagreement(parameter.name, parameter.unit, *pairs, apart))
    return tuple(sorted(disagreements, key=lambda d: -d.apart))


def _agree(one: tuple[float, float], other: tuple[float, float]) -> bool:
    """Whether two estimates, each with its standard error, differ by no more than chance or `WORTH`."""
    (x, sd), (y, its) = one, other
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
        x, parts = np.asarray(flights.channels[name], float), []
        for part in manoeuvres(flights.manoeuvre):
            time = flights.time[part]
            parts.append(np.median(x[part][time <= time[0] + BEGIN]))
        return float(np.median(parts))

    density = begin("density", math.nan)
    altitude = altitude_of_density(density) if density > 0.0 else begin("altitude", 0.0)
    return Steady(begin("airspeed", 1.0), altitude, begin("alpha", 0.0))


def flown_modes(fit: OutputErrorResult, steady: Steady, filtered: ProcessNoise | None = None) -> tuple[FlownMode, ...]:
    """The modes of a model whose fit converged, about `steady` flight; with the estimates of `filtered` in place of
    those of `fit`. Raises `InputError` where there is no such flight, or the model has no motion of its own."""
    dynamics, aircraft = unbiased(fit.flown.dynamics), fit.flown.flights.aircraft
    count = len(dynamics.free)
    theta, covariance = np.asarray(fit.estimate[:count]), np.asarray(fit.corrected)[:count, :count]
    if filtered is not None:
        order = [list(filtered.estimates).index(name) for name in dynamics.names]
        theta = np.array([filtered.estimates[name][0] for name in dynamics.names])
        known = filtered.covariance
        covariance = np.zeros((count, count)) if known is None else known[np.ix_(order, order)]
    about_trim = modes(dynamics, dynamics.values(theta), aircraft, steady)
    slopes = np.zeros((len(about_trim), 2, count))
    scale = np.sqrt(np.diag(covariance))
    open_ones = () if filtered is not None else fit.undetermined
    unknown = [k for k, p in enumerate(fit.parameters[:count]) if p.name in open_ones]
    scale[unknown] = np.maximum(np.abs(theta[unknown]), 1e-2)  # only whether it matters
    for k in np.flatnonzero(scale):
        step = np.zeros(count)
        step[k] = STEP * scale[k]
        try:
            ends = [modes(dynamics, dynamics.values(theta + sign * step), aircraft, steady) for sign in (1.0, -1.0)]
        except InputError:
            slopes[:, :, k] = math.nan
            continue
        near = [
            [min((m.eigenvalue for m in end), key=lambda x: abs(x - mode.eigenvalue)) for end in ends]
            for mode in about_trim
        ]
        change = np.array([plus - minus for plus, minus in near]) / (2.0 * step[k])
        slopes[:, :, k] = np.stack([change.real, change.imag], axis=1)
    moved = np.any(np.abs(slopes[:, :, unknown]) > 1e-9, axis=(1, 2))
    return tuple(
        flown_mode(mode.name, mode.eigenvalue, np.full((2, 2), np.inf) if lost else J @ covariance @ J.T)
        for mode, J, lost in zip(about_trim, slopes, moved, strict=True)
    )


def flown_mode(name: str, eigenvalue: complex, covariance: Float[np.ndarray, "2 2"]) -> FlownMode:
    """A mode of this eigenvalue (1/s) whose real and imaginary part have this covariance (2, 2)."""

    def root(variance: float) -> float:
        """A standard error; infinite where nothing is known."""
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
        side = "half" if s < 0.0 else "double"
        quantities[f"time_to_{side}"] = with_error(HALF / abs(s), (-math.copysign(HALF, s) / s**2, 0.0))
    return FlownMode(name, eigenvalue, (sd_real, sd_imaginary), quantities)


# --- Modes of motion of a fit to trajectories.


def motion_of(flown: TrajectoryFit, beside: ProcessNoise | None = None) -> Motion | None:
    """Modes with standard errors; None without a model of the aircraft, and where the fit did not converge."""
    if flown.of_path or not flown.converged:
        return None
    steady = steady_of(flown.fit.flown.flights)
    modes_found, why_not = (), ""
    filtered = beside if beside is not None and beside.preferred else None
    try:
        modes_found = flown_modes(flown.fit, steady, filtered)
    except InputError as reason:
        why_not = str(reason)
    about = (steady.airspeed, steady.altitude) if flown.by_effects else (math.nan, math.nan)  # of linear cards
    return Motion(*about, modes_found, why_not, filtered is not None)
