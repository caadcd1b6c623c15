"""Candidates: every effect of the catalogue that the card's model lacks and the record can test; thresholds; folds."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise
from statistics import NormalDist
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from bayes_aero.effect import NEUTRAL_FLOW, Effect, Kind, Stage, Untestable, sized
from bayes_aero.effects import CATALOGUE
from bayes_aero.errors import InputError
from bayes_aero.flight.channel import STANDARD_CHANNELS
from bayes_aero.flight.health import noise_alone
from bayes_aero.model.model import Model
from bayes_aero.model.records import Flights
from bayes_aero.parameter import Prior, Role, departure, per_length
from bayes_aero.physics.filters import FILTER_STEP
from bayes_aero.residuals.base import ResidualModel
from bayes_aero.units import number

Vector = Float[np.ndarray, " k"]
Square = Float[np.ndarray, "k k"]
Rows = Float[np.ndarray, "m c"]
Columns = Int[np.ndarray, " k"]
Marks = Int[np.ndarray, " m"]


# --- Every threshold of a diagnosis, each with its reason. What is called our choice has no other.

ENOUGH = 3.0  # deviations by which effects must differ for a manoeuvre to separate them


@dataclass(frozen=True)
class DiagnosisSettings:
    """Thresholds of screening, selection, hold-out tests and the search for structure without a name. They were chosen
    on simulated flights; the rates of error that follow from them are in `benchmarks/README.md`."""

    max_effects: int = 8  # effects that each stage may add
    process_noise: bool | None = None  # compare the model with innovations; None: in gusts
    gains: bool = True  # fit the causes again to left-out data
    anyway: bool = False  # seek effects also where sensors contradict each other by more than a simulation may be off

    # Screening: every candidate's score against noise-only replicates.
    replicates: int = 200  # noise-only replicates behind every p-value: it is 0.005 at the least
    correction_replicates: int = 40  # replicates that measure the bias of the estimated autocorrelation
    least_score: float = 2.5  # a candidate below it is not beyond chance among dozens

    # Forward selection.
    false_alarm_rate: float = 0.01  # family-wise, of each selection: a diagnosis holds several selections
    refit_false_alarm_rate: float = 0.02  # of leaders that are fitted first and judged by the block jackknife
    block_false_alarm_rate: float = 0.05  # of flight-path errors among blocks, of a lag, of offsets between manoeuvres
    candidates_tried: int = 8  # leaders considered in one selection
    candidates_refitted: int = 3  # leaders that are fitted and judged by the block jackknife
    least_share: float = 0.04  # of a coefficient's remaining variance: imperfect regressors imitate less
    least_share_white: float = 0.01  # the same of innovations; our choice, of which silent flights in gusts need none
    least_share_correlated: float = 0.3  # of its gain that an effect must keep when noise of coefficients may correlate
    exchange_margin: float = 0.02  # of a candidate's gain by which another must exceed it to take its place
    decisive: float = 3.0  # nats by which one of two extensions must be the better

    # Rivals and credibility of a cause.
    ambiguous: float = 3.0  # nats within which another effect explains the residuals as well
    least_rival_score: float = 2.0  # score that an effect needs on its own to be a rival
    most_names: int = 5  # of an ambiguity set: beyond it the record does not attribute what it shows
    least_excitation: float = 0.1  # least over largest spread of an effect's sensitivities among manoeuvres; our choice
    correlated: float = 0.9  # correlation of two estimates beyond which one follows the other
    near_one: float = 0.15  # within which the factor of a sum or difference of two parameters is reported as one

    # Hold-out tests.
    hold_out: float = 1.645  # standard errors by which the hold-out log score must fall: one-sided, 5 %
    hold_out_first_order: float = 5.0  # the same to first order, from which nothing is fitted again to see it
    hold_out_steps: int = 4  # Gauss-Newton steps of each fit to the other parts
    parts: int = 6  # of a single manoeuvre, each predicted from the others
    gap: float = 2.0  # s left out between neighbouring parts of one manoeuvre
    shortest_part: float = 3.0  # times the gap
    unidentified: float = 10.0  # times the joint standard error from which a manoeuvre does not identify a cause

    # Block jackknife.
    block: float = 15.0  # s; our choice: gusts hang together over some 5 s, and a minute must have several blocks
    fewest_blocks: int = 6  # of a short record

    # Structure without a name.
    knots: int = 6  # of the smooth function of a channel
    manoeuvre_parts: int = 4  # of each manoeuvre: a sinusoid must predict the parts that it was not fitted to
    unnamed_replicates: int = 100  # noise-only replicates
    unnamed_false_alarm_rate: float = 0.015  # of each family: functions of a channel, periods, terms
    unnamed_tried: int = 5  # leaders whose hold-out gain is measured
    unnamed_most: int = 3  # functions taken one after another
    terms_most: int = 6  # of one coefficient; our choice
    unnamed_share: float = 0.1  # of the remaining variance: less is not worth a verdict
    periodic_share: float = 0.25  # the same of a sinusoid: noise alone draws a fifth of the variance into one
    single_share: float = 0.3  # the same on a single manoeuvre: its parts share their slow noise and confirm little
    stand_in: float = 1.2  # times what a named cause gains that a function must reach to take its place

    # Parameters that change during the records.
    change_false_alarm_rate: float = 0.005  # with the families of functions below the 5 % of a whole diagnosis
    change_share: float = 0.25  # of the remaining variance: noise alone draws as much into it as into a sinusoid
    change_least: float = 6.0  # s at either end of a manoeuvre in which no change is sought; our choice
    change_begins: int = 1000  # moments tried
    change_parts: int = 8  # of each manoeuvre: a change must predict the parts that it was not fitted to
    change_interval: float = 1.92  # nats within which other moments explain as much: 95 % of one parameter

    # Sensor errors that the flight path cannot separate.
    imitated: float = 0.95  # share of what an error does from which others do it as well; our choice
    imitators: int = 3  # errors that imitate one together
    open_share: float = 0.5  # of what an output leaves that an unconfirmed error must explain to be reported

    def degrades(self, gain: float, se: float, among: int = 1) -> bool:
        """Whether a gain in hold-out log density (nats, with its standard error) is a loss beyond the margin within
        which two models are as good, and beyond noise; of `among` such gains one is so by chance in 5 %."""
        chance = NormalDist().cdf(-self.hold_out) / among
        return bool(gain < -max(self.ambiguous, -NormalDist().inv_cdf(chance) * se))

    def degraded(self, gains: Mapping[str, tuple[float, float]]) -> dict[str, tuple[float, float]]:
        return {name: gain for name, gain in gains.items() if self.degrades(*gain, among=len(gains))}


DEFAULT = DiagnosisSettings()


# --- Candidates: every effect of the catalogue that the card's model lacks and the record can test.

MOVES = 1e-6  # of what an effect makes, a change that is no rounding
FAR = 1e9  # stands for a neutral value at infinity
DERIVED = ("alpha_dot", "p_dot", "q_dot", "r_dot")


@dataclass(frozen=True)
class CandidateModel:
    """The card's model and every testable candidate in one model, all parameters free but those fixed off neutral."""

    model: Model
    base: tuple[str, ...]
    candidates: tuple[Effect, ...]
    not_testable: Mapping[str, str]
    priors: Mapping[str, Prior] = field(default_factory=dict)  # in place of the parameters' own
    settings: DiagnosisSettings = DEFAULT

    @property
    def neutral(self) -> dict[str, float]:
        return {p.name: finite(p.neutral) for p in self.model.parameters}

    @property
    def neutral_vector(self) -> Vector:
        return self.vector({})

    def vector(self, values: Mapping[str, float]) -> Vector:
        """Every free parameter at its value, or at neutral where it has none."""
        everything = self.neutral | dict(values)
        return np.array([everything[name] for name in self.model.names], float)

    def at_neutral(self, theta: Vector, effects: Sequence[str]) -> Vector:
        names = {p for effect in effects for p in self.parameters_of(effect)}
        return np.where([name in names for name in self.model.names], self.neutral_vector, theta)

    def card_only(self, theta: Vector) -> Vector:
        """`theta` with every effect at neutral that is not on the card."""
        return self.at_neutral(theta, [e.name for e in self.model.effects if e.name not in self.base])

    def prior(self, index: Sequence[int] | Int[np.ndarray, " j"], theta: Vector) -> tuple[np.ndarray, np.ndarray]:
        """Mean and precision of the step from `theta` for parameters `index`, their priors taken as normal."""
        free = self.model.free
        pairs = [self.priors.get(free[i].name, free[i].prior).normal for i in index]
        mean, deviation = np.array(pairs).reshape(-1, 2).T
        return mean - theta[np.asarray(index, int)], deviation**-2.0

    @property
    def lag(self) -> Effect | None:
        lags = (e for e in self.candidates if e.stage is Stage.LAG)
        return next((e for e in lags if any(p.role is Role.LAG for p in e.parameters)), None)

    def columns(self, names: Sequence[str]) -> np.ndarray:
        return np.array([self.model.places[name] for name in names], int)

    def own_columns(self, *effects: str) -> np.ndarray:
        return self.columns([name for effect in effects for name in self.parameters_of(effect)])

    def parameters_of(self, effect: str) -> tuple[str, ...]:
        return tuple(p.name for e in self.model.effects if e.name == effect for p in e.parameters)


def finite(neutral: float) -> float:
    return neutral if math.isfinite(neutral) else FAR


def candidate_model(
    model: Model, flights: Flights, extra: Sequence[Effect] = (), settings: DiagnosisSettings = DEFAULT
) -> CandidateModel:
    """`model` extended by the catalogue and by `extra` effects; one that the card fixes at neutral is a candidate."""
    fixed = dict(model.fixed)
    absent = [e for e in model.effects if e.parameters and e.absent_in(fixed)]
    active = [e for e in model.effects if e not in absent]
    changed = {p.name: p for p in model.parameters}
    owned = {p.name for e in active for p in e.parameters}
    have, noise = set(flights.channels) | set(DERIVED), noise_channels(flights)
    candidates, idle, not_testable = [], [], {}
    others = (sized(e, model.lengths) for e in (*CATALOGUE.values(), *extra) if e not in model.effects)
    for effect in (*absent, *others):
        missing = [c for c in effect.channels if c not in have]
        still = [c for c in effect.channels if c in flights.channels and not moves(flights.channels[c], flights)]
        if still and not missing and effect.together and _makes(effect, flights, {}):
            still = []
        lacking, waiting = [name for name in effect.uses if name not in owned], False
        proposed = effect.candidate and effect.acts_on(model.axes)
        if effect.kind is Kind.NOISE or not (proposed or effect in absent):
            continue
        if missing:
            not_testable[effect.name] = Untestable.of(Untestable.NOT_RECORDED, missing)
        elif still and effect.stage > Stage.AIRCRAFT:
            offset = any(moves(flights.channels[c], replace(flights, lengths=(flights.n,))) for c in still)
            why = "channel {} differs only between manoeuvres, as an offset does" if offset else Untestable.STILL
            not_testable[effect.name] = Untestable.of(why, still)
            waiting = True
        elif noisy := _rests_on(noise, effect, flights):
            not_testable[effect.name] = Untestable.of(Untestable.NOISE_ALONE, noisy)
            waiting = True
        elif lacking:
            not_testable[effect.name] = Untestable.of(Untestable.LACKING, lacking)
        elif {p.name for p in effect.parameters} & owned:
            not_testable[effect.name] = "the model already has its parameters"
        elif effect.parameters:
            candidates.append(effect)
        if waiting and not lacking and effect.parameters and effect not in absent:
            idle.append(effect)  # it stays in the compiled model, so that records do not differ by it
    # Effects without parameters are nothing until an effect that they rest on wakes them (Kirchhoff's lift, X).
    asleep = (e for e in CATALOGUE.values() if not e.parameters and e not in active and e.acts_on(model.axes))
    dormant = [e for e in asleep if all(name in owned for name in e.uses)]
    everything = (*active, *dormant, *candidates, *idle)
    parameters = tuple(changed.get(p.name, per_length(p, model.lengths)) for e in everything for p in e.parameters)
    held = {p.name for e in (*candidates, *idle) for p in e.parameters}
    kept = tuple((k, v) for k, v in fixed.items() if k not in held)
    whole = replace(model, effects=everything, parameters=parameters, fixed=kept)
    return CandidateModel(whole, tuple(e.name for e in active), tuple(candidates), not_testable, settings=settings)


def noise_channels(flights: Flights) -> tuple[str, ...]:
    """Recorded channels that are white noise about a constant: the sideslip of a flight without any."""
    channels = {n: np.asarray(x) for n, x in flights.channels.items() if n in STANDARD_CHANNELS and n != "time"}
    return tuple(n for n, x in channels.items() if noise_alone(x, *by_manoeuvre(x, flights)))


def moves(x: Any, flights: Flights, least: float = 1e-9) -> bool:
    """Whether a channel (n,) moves within a manoeuvre: what differs only between them is no more than an offset."""
    parts = by_manoeuvre(np.asarray(x), flights)
    return any(np.ptp(part) > least * max(1.0, float(np.abs(part).max())) for part in parts)


def by_manoeuvre(x: np.ndarray, flights: Flights) -> list[np.ndarray]:
    return np.split(x, np.cumsum(flights.lengths)[:-1])


def _rests_on(noise: Sequence[str], effect: Effect, flights: Flights) -> tuple[str, ...]:
    """The noise alone that an effect makes what it makes of; empty where something else moves it, or nothing does."""
    # A scale of a sideslip that nobody flew would be fitted to the noise of the vane. A bias needs no movement.
    noisy = tuple(n for n in effect.channels if n in noise)
    of_others = bool(effect.uses) or Stage.CHANNEL < effect.stage < Stage.ATTACHED  # what others make, it needs
    if not noisy or of_others or not set(effect.channels) <= set(flights.channels):
        return ()
    parts = {n: by_manoeuvre(np.asarray(flights.channels[n], float), flights) for n in noisy}
    calm = {n: np.concatenate([np.full_like(x, x.mean()) for x in each]) for n, each in parts.items()}
    return noisy if _makes(effect, flights, {}) and not _makes(effect, flights, calm) else ()


def _makes(effect: Effect, flights: Flights, instead: Mapping[str, np.ndarray]) -> bool:
    """Whether an effect of its least size, some channels replaced, makes what moves within a manoeuvre."""
    # T/(qbar S) does where only the airspeed changes.
    values = {p.name: p.start + effect.sizes.get(p.name, (0.0, 0.0))[0] for p in effect.parameters}
    signals: dict[str, Any] = {name: np.asarray(x) for name, x in flights.channels.items()} | dict(instead)
    flow = NEUTRAL_FLOW | ({"incidence": signals["alpha"]} if "alpha" in signals else {})
    made = [np.asarray(x) for x in effect.increments(values, signals, flights.aircraft, flow).values()]
    parts = ((x, part) for x in made if np.ndim(x) for part in by_manoeuvre(x, flights))
    return any(np.ptp(part) > MOVES * np.max(np.abs(x)) for x, part in parts)


# --- The parts of the records that are predicted from the others: manoeuvres, or parts of a single one.
# Fits to coefficients leave out these folds: the parameters again (`LeftOut.refitted`), or to first order from inner
# products (`Products.without`). Trajectories leave out segments, which are flown from their measured state
# (`trajectories.holdout_fits`); Gaussian processes are validated on samples, at random as published, too
# (`inference.gp`).


def too_short(seconds: float, settings: DiagnosisSettings = DEFAULT) -> str:
    """Why a single manoeuvre of so many seconds (of whole blocks) has no folds; empty where it has."""
    shortest = settings.shortest_part * settings.gap
    if int(seconds / shortest) >= 2:
        return ""
    return (
        f"a single manoeuvre of {number(seconds)} s is too short to be predicted from its own parts; "
        f"give one of {2.0 * shortest + 1.0:.0f} s at least, or a second one"  # whole blocks are less than the record
    )


def manoeuvres(manoeuvre: Marks) -> tuple[slice, ...]:
    edges = np.flatnonzero(np.diff(manoeuvre, prepend=-1, append=-1))
    return tuple(slice(int(a), int(b)) for a, b in pairwise(edges))


def folds_of(manoeuvre: Marks, seconds: float, settings: DiagnosisSettings = DEFAULT) -> tuple[slice, ...]:
    """Manoeuvres as folds, or contiguous parts of a single one with a gap between them."""
    if manoeuvre[-1] > 0:
        return manoeuvres(manoeuvre)
    if why := too_short(len(manoeuvre) * seconds, settings):
        raise InputError(why)
    parts = min(settings.parts, int(len(manoeuvre) * seconds / (settings.shortest_part * settings.gap)))
    cuts, gap = np.linspace(0, len(manoeuvre), parts + 1).astype(int), max(1, round(settings.gap / seconds / 2))
    begins, ends = [0, *(cuts[1:-1] + gap)], [*(cuts[1:-1] - gap), len(manoeuvre)]
    return tuple(slice(int(a), int(b)) for a, b in zip(begins, ends, strict=True))


# --- Regression of residuals on sensitivities from inner products alone, so that thousands of fits cost seconds.
# Estimation is the published one: independent residuals, one variance per output, re-estimated (cost det R). Its
# uncertainty is not: `screening.uncertainty` gives the covariance that coloured residuals leave it.

ROUNDS = 5  # alternations between parameters and variances


@dataclass(frozen=True)
class RegressionFit:
    """k active columns, c outputs: the step from the linearisation point and the outputs' variances."""

    columns: Columns
    step: Vector
    normal: Square
    variance: Float[np.ndarray, " c"]
    deviance: float  # sum over outputs of n log(variance), plus the prior's quadratic form

    def places(self, columns: Sequence | np.ndarray) -> list[int]:
        return [int(np.flatnonzero(self.columns == column)[0]) for column in columns]


@dataclass(frozen=True)
class Products:
    """Inner products of [residual, sensitivities] by fold and output: (f, c, K+1, K+1), and samples per fold (f,)."""

    gram: Float[np.ndarray, "f c k k"]
    count: Int[np.ndarray, " f"]

    @classmethod
    def of(cls, residual: Rows, S: Float[np.ndarray, "m c k"], folds: Sequence[slice]) -> Products:
        """Each fold is a contiguous stretch of blocks."""
        used = np.flatnonzero(np.any(S != 0.0, axis=(0, 1)))  # the others' products are zero
        data = np.moveaxis(np.concatenate([residual[:, :, None], S[:, :, used]], axis=2), 1, 0)
        gram, at = np.zeros((len(folds), S.shape[1], S.shape[2] + 1, S.shape[2] + 1)), np.append(0, used + 1)
        gram[:, :, at[:, None], at] = [data[:, fold].transpose(0, 2, 1) @ data[:, fold] for fold in folds]
        return cls(gram, np.array([fold.stop - fold.start for fold in folds]))

    def over(self, folds: Sequence[int]) -> Products:
        chosen = list(folds)
        return Products(self.gram[chosen].sum(axis=0, keepdims=True), self.count[chosen].sum(keepdims=True))

    def without(self, fold: int) -> Products:
        return self.over([f for f in range(len(self.count)) if f != fold])

    def only(self, columns: Columns) -> Products:
        """These columns alone, numbered anew in their order."""
        at = np.append(0, np.asarray(columns) + 1)
        return Products(self.gram[:, :, at[:, None], at[None, :]], self.count)

    @cached_property
    def total(self) -> Float[np.ndarray, "c k k"]:
        return self.gram.sum(axis=0)

    def shifted(self, columns: Columns, by: Vector) -> Products:
        """The same after a step `by` in `columns`: the residual becomes residual - S by."""
        gram, at = self.gram.copy(), np.asarray(columns) + 1
        gram[..., 0, :] -= np.einsum("fckl,k->fcl", gram[..., at, :], by)
        gram[..., :, 0] -= np.einsum("fckl,l->fck", gram[..., :, at], by)
        return Products(gram, self.count)

    def fit_many(
        self,
        columns: Int[np.ndarray, "j k"],
        mean: Float[np.ndarray, " K"],
        precision: Float[np.ndarray, " K"],
        held: Float[np.ndarray, " c"] | None = None,
    ) -> tuple[np.ndarray, ...]:
        """Steps, information, variances and deviances of j sets of columns, each with the normal prior of its steps."""
        gram, n = self.total, float(self.count.sum())
        j, k = columns.shape
        full = np.concatenate([np.zeros((j, 1), int), columns + 1], axis=1)
        part = np.moveaxis(gram[:, full[:, :, None], full[:, None, :]], 0, 1)  # j c k+1 k+1
        squares, weights, centre = part[:, :, 0, 0] / n, precision[columns], mean[columns]
        ridge, prior = RIDGE * np.eye(k), np.eye(k) * weights[:, None, :]

        def stepped(information: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            """Steps and normal matrices for (s, j, k+1, k+1) products of samples divided by their deviations."""
            normal = information[..., 1:, 1:] + prior
            scale = 1.0 / np.sqrt(np.maximum(np.diagonal(normal, axis1=-2, axis2=-1), TINY))
            scaled = normal * scale[..., :, None] * scale[..., None, :] + ridge
            right = (information[..., 1:, 0] + weights * centre) * scale
            return scale * np.linalg.solve(scaled, right[..., None])[..., 0], normal

        def variance_of(step: np.ndarray) -> np.ndarray:
            """Mean squares (s, j, c) that steps of all outputs (s, j, 1, k), or one of each (s, j, c, k), leave."""
            v = np.concatenate([np.ones((*step.shape[:-1], 1)), -step], axis=-1)
            left = (v[..., None, :] @ (part @ v[..., None]))[..., 0, 0] / n
            return np.maximum(left, np.maximum(ROUNDING * squares, TINY))  # records without noise leave less

        if held is not None:
            variance, rounds = np.broadcast_to(held, (1, j, len(held))), 1
        else:
            # Where a form is wrong, the variances may settle with one output given up for another. So they begin as
            # what is there, and as what each output alone can be fitted to; all are settled side by side.
            begin = np.maximum(squares, TINY)
            alone = stepped(np.moveaxis(part / begin[:, :, None, None], 1, 0))[0]  # c j k
            variance, rounds = np.concatenate([begin[None], variance_of(np.moveaxis(alone, 0, 1)[None])]), ROUNDS
        for _ in range(rounds):
            step, normal = stepped(np.einsum("sjc,jckl->sjkl", 1.0 / variance, part))
            variance = variance_of(step[:, :, None, :]) if held is None else variance
        deviance = n * np.log(variance).sum(axis=2) + np.sum(weights * (step - centre) ** 2, axis=2)
        best = np.argmin(deviance, axis=0), np.arange(j)
        return step[best], normal[best], variance[best], deviance[best]

    def fit(
        self, columns: Columns, mean: np.ndarray, precision: np.ndarray, held: Float[np.ndarray, " c"] | None = None
    ) -> RegressionFit:
        step, normal, variance, deviance = self.fit_many(columns[None], mean, precision, held)
        return RegressionFit(columns, step[0], normal[0], variance[0], float(deviance[0]))


def partialled(X: np.ndarray, B: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """What weighted least squares on the columns `B` leaves of each of the columns `X`."""
    cross, gram = (np.einsum("mci,c,mcj->ij", B, weight, other, optimize=True) for other in (X, B))
    return X - B @ (inverse(gram) @ cross)


TINY = 1e-300
NOTHING = 1e-130  # least information that is inverted: a covariance of it, and its square, are still numbers
ROUNDING = 1e-14  # of a sum of squares, of what is left of it
RIDGE = 1e-11  # relative to the information's unit diagonal: keeps collinear columns finite, far below any noise


def inverse(matrix: Square) -> Square:
    """Inverse of a symmetric positive matrix whose scales differ by many orders."""
    scale = 1.0 / np.sqrt(np.maximum(np.diag(matrix), NOTHING))
    return np.linalg.inv(matrix * np.outer(scale, scale) + RIDGE * np.eye(len(matrix))) * np.outer(scale, scale)


# --- Where the criticism stands: parameters, which effects are in, and the problem linearised there.

WIDE = 10.0  # times the residual's deviation, the prior one of an offset of a manoeuvre
LARGEST = 1e100  # of a sensitivity: a simulation that has diverged says nothing, and its square has no number


@dataclass(frozen=True)
class Scan:
    """One value at which a candidate without a slope at neutral is tried."""

    effect: str
    parameter: str
    value: float


@dataclass(frozen=True)
class Component:
    """A function of a `channel` (or of time, or a term) in a `coefficient`, that is no effect of the catalogue."""

    coefficient: str
    channel: str
    basis: Float[np.ndarray, "m c w"]  # what it adds to each output
    periodic: bool = False  # a sinusoid, whose phases another manoeuvre does not know

    @property
    def label(self) -> str:
        return f"{self.coefficient} over {self.channel}"


@dataclass(frozen=True, eq=False)
class SelectionState:
    """Parameters `theta` (all of the full model's), residuals and sensitivities there, of the outputs of one stage."""

    # Columns beyond the parameters: what is free in every fit, such as where the flight path begins; one for every
    # scanned value of a candidate without a slope at neutral; a last one of zeros, which fills blocks of unequal width.
    full: CandidateModel
    responses: ResidualModel
    outputs: tuple[str, ...]
    theta: Vector
    residual: Rows
    S: Float[np.ndarray, "m c K"]
    noise_growth: Rows
    folds: tuple[slice, ...]
    products: Products
    mean: Float[np.ndarray, " K"]
    precision: Float[np.ndarray, " K"]
    active: tuple[str, ...]  # names of the effects that are in, beyond the card's
    scans: tuple[Scan, ...]
    nuisance: int = 0  # columns between the parameters and the scans
    variance_inflation: float = 1.0  # priors count so many times against the white likelihood
    apart: tuple[str, ...] = ()  # coefficients with a constant of their own in every manoeuvre, among the nuisance
    components: tuple[Component, ...] = ()  # candidates in place of effects
    chosen: tuple[Component, ...] = ()  # components that are in
    narrow: bool = False  # only the sensitivities to what is in were computed, a third of the time of all

    @property
    def settings(self) -> DiagnosisSettings:
        return self.full.settings

    @property
    def of_coefficients(self) -> bool:
        """Whether the outputs are the coefficients themselves, not what is flown with them or the flight path."""
        return self.outputs == self.responses.model.coefficients

    def least_share(self, share: float) -> float:
        """A least share of the variance of means over `FILTER_STEP` samples, as of these: noise averages out."""
        return share * self.responses.averaged / FILTER_STEP

    @property
    def least_of_effect(self) -> float:
        """Least share of the variance that an addition must explain."""
        return self.least_share(self.settings.least_share_white if self.responses.white else self.settings.least_share)

    @cached_property
    def wide(self) -> SelectionState:
        """The same with the sensitivities to every candidate."""
        if self.components or self.chosen or not self.narrow:
            return self
        return linearised(self.full, self.responses, self.outputs, self.theta, self.active, self.apart, self)

    @cached_property
    def added(self) -> Any:
        return self.responses.added(self.theta)

    @cached_property
    def lessened(self) -> dict[str, SelectionState]:  # without one of what is in, as far as they were asked for
        return {}

    @cached_property
    def kept_outputs(self) -> list[int]:
        return [self.responses.outputs.index(name) for name in self.outputs]

    @property
    def departure(self) -> Vector:
        away = [departure(x, p.neutral) for x, p in zip(self.theta, self.full.model.free, strict=True)]
        return np.where(self.theta == self.full.neutral_vector, 0.0, away)

    @cached_property
    def inside(self) -> Bool[np.ndarray, " m"]:
        """Blocks that belong to a fold: neither products nor fits have seen the others."""
        inside = np.zeros(len(self.S), bool)
        for fold in self.folds:
            inside[fold] = True
        return inside

    @property
    def offsets(self) -> Int[np.ndarray, " o"]:
        """Columns of what is free in every fit and no parameter."""
        return len(self.theta) + np.arange(self.nuisance)

    @property
    def begins(self) -> Int[np.ndarray, " o"]:
        """Those of `offsets` with which integrals, windows or simulations begin."""
        return self.offsets[: self.nuisance - len(self.apart) * len(self.responses.flights.lengths)]

    @property
    def component_columns(self) -> list[Int[np.ndarray, " w"]]:
        widths = [c.basis.shape[2] for c in (*self.chosen, *self.components)]
        begins = len(self.theta) + self.nuisance + len(self.scans) + np.cumsum([0, *widths])
        return [np.arange(a, b) for a, b in pairwise(begins)][len(self.chosen) :]

    @property
    def blocks(self) -> list[tuple[str, Int[np.ndarray, " w"], float | None]]:
        """Every way in which a candidate that reaches the outputs may enter: name, columns, and any scanned value."""
        if self.components:
            return [(c.label, at, None) for c, at in zip(self.components, self.component_columns, strict=True)]
        begin, scanned = len(self.theta) + self.nuisance, {scan.effect for scan in self.scans}
        blocks: list[tuple[str, np.ndarray, float | None]] = [
            (scan.effect, np.array([begin + number]), scan.value) for number, scan in enumerate(self.scans)
        ]
        names = (effect.name for effect in self.full.candidates if effect.name not in scanned)
        blocks += [(name, self.full.own_columns(name), None) for name in names]
        return [block for block in blocks if np.any(self.S[:, :, block[1]] != 0.0)]

    def columns(self, effects: Sequence[str] | None = None) -> Int[np.ndarray, " a"]:
        """Columns of the card's effects, of `effects` (default: those that are in), and the offsets."""
        names = (*self.full.base, *(self.active if effects is None else effects))
        at = self.full.columns([p for n in names for p in self.full.parameters_of(n) if p in self.full.model.names])
        begin = len(self.theta) + self.nuisance + len(self.scans)
        chosen = begin + np.arange(sum(c.basis.shape[2] for c in self.chosen))
        return np.concatenate([at[np.any(self.S[:, :, at] != 0.0, axis=(0, 1))], self.offsets, chosen])

    def wider(self, columns: Sequence[int] | np.ndarray) -> Columns:
        return np.concatenate([self.columns(), np.array(columns, int)])

    def fit(self, columns: Columns | None = None, held: np.ndarray | None = None) -> RegressionFit:
        """Regression on all folds with these columns (default: the active ones); with variances it finds, or `held`."""
        return self.products.fit(self.columns() if columns is None else columns, self.mean, self.precision, held)

    @cached_property
    def best(self) -> RegressionFit:
        return self.fit()

    def left(self, fit: RegressionFit | None = None) -> Rows:
        """Residuals that a fit (default: the best) leaves, divided by the noise_growth."""
        fit = self.best if fit is None else fit
        return (self.residual - self.S[:, :, fit.columns] @ fit.step) / self.noise_growth

    def with_components(
        self, components: Sequence[Component], chosen: Sequence[Component], folds: Sequence[slice] | None = None
    ) -> SelectionState:
        """The state in which components are the candidates in place of effects; those `chosen` are in."""
        folds, extra = self.folds if folds is None else folds, [c.basis for c in (*chosen, *components)]
        S = np.concatenate([self.S[:, :, :-1], *extra, self.S[:, :, -1:]], axis=2)
        zeros, flat = self.flat_prior(S.shape[2] - self.S.shape[2])
        precision = np.concatenate([self.precision[:-1], flat, [1.0]])
        mean = np.concatenate([self.mean[:-1], zeros, [0.0]])
        products = Products.of(self.residual / self.noise_growth, S / self.noise_growth[:, :, None], folds)
        return replace(
            self, S=S, mean=mean, precision=precision, products=products, folds=tuple(folds),
            components=tuple(components), chosen=tuple(chosen),
        )  # fmt: skip

    def flat_prior(self, count: int) -> tuple[np.ndarray, np.ndarray]:
        """Mean and precision of components, each as large as the residuals: ten times that size at most."""
        size = float(np.median(np.std(self.residual / self.noise_growth, axis=0)))
        return np.zeros(count), np.full(count, self.variance_inflation / (10 * size) ** 2)

    def share_of(self, columns: Columns) -> float:
        """Share of a coefficient's remaining variance that columns take away, at best over the coefficients."""
        return float(np.max(1.0 - self.fit(self.wider(columns)).variance / self.best.variance))

    def without(self, effects: Sequence[str]) -> SelectionState:
        """The state with some of its additions at neutral, to first order."""
        if not effects:
            return self
        columns = self.full.own_columns(*effects)
        away, theta, mean = self.departure[columns], self.theta.copy(), self.mean.copy()
        theta[columns], mean[columns] = self.full.neutral_vector[columns], mean[columns] + away
        residual = self.residual + self.S[:, :, columns] @ away
        active = tuple(e for e in self.active if e not in effects)
        products = self.products.shifted(columns, -away)
        return replace(self, theta=theta, mean=mean, residual=residual, products=products, active=active)

    @cached_property
    def scaled(self) -> Float[np.ndarray, "m c K"]:
        return self.S / self.noise_growth[:, :, None]


def linearised(
    full: CandidateModel,
    responses: ResidualModel,
    outputs: tuple[str, ...],
    theta: Vector,
    active: tuple[str, ...] = (),
    apart: tuple[str, ...] = (),
    like: SelectionState | None = None,
) -> SelectionState:
    """The state at `theta`, with a free offset in every manoeuvre of coefficients `apart` and noise as in `like`."""
    keep = [responses.outputs.index(name) for name in outputs]
    residual, S = (x[:, keep] for x in responses.linearise(theta))
    lacking, scanned = [e for e in full.candidates if e.name not in active], {}
    for scan in [Scan(e.name, p, value) for e in lacking for p, values in e.scan.items() for value in values]:
        there, at = theta.copy(), int(full.columns([scan.parameter])[0])
        there[at] = scan.value
        scanned[scan] = ((residual - responses.residuals(there, outputs)) / (scan.value - theta[at]))[:, :, None]
    same = like if like is not None and like.responses is responses and like.outputs == outputs else None
    growth = np.ones_like(residual) if same is None else same.noise_growth
    inflation = 1.0 if like is None else like.variance_inflation
    folds = folds_of(responses.manoeuvre, responses.seconds, full.settings)
    none = Products.of(residual, S[:, :, :0], folds)
    bare = SelectionState(
        full, responses, outputs, theta, residual, S, growth, folds, none, *full.prior(range(len(theta)), theta),
        active, tuple(scanned), 0, inflation, apart,
    )  # fmt: skip
    return _with_nuisances(bare, list(scanned.values()))


def _with_nuisances(state: SelectionState, tried: Sequence[np.ndarray] = ()) -> SelectionState:
    """A state of parameters alone with the columns beyond them, those `tried` of its scans given."""
    full, responses, residual, S = state.full, state.responses, state.residual, state.S
    constants = [constants_of_manoeuvres(full, responses.manoeuvre, state.outputs, S, name) for name in state.apart]
    offsets = responses.offsets(state.theta, state.outputs)
    S = np.concatenate([S, offsets, *constants, *tried, np.zeros((*residual.shape, 1))], axis=2)
    S = np.where(np.abs(S) < LARGEST, S, 0.0)
    of_scans = [int(full.columns([s.parameter])[0]) for s in state.scans]
    # Nearly flat: the constants add up to about zero, and the model's own constant stays what it is in the mean. A
    # deviation is ten times that which moves the outputs by the deviation of their residuals.
    free = np.zeros(offsets.shape[2])
    wide = np.concatenate([free, *(_flat(ones, residual) for ones in constants)])
    mean = np.concatenate([state.mean, np.zeros(len(wide)), state.mean[of_scans], [0.0]])
    precision = np.concatenate([state.precision, wide, state.precision[of_scans]])
    precision = np.append(state.variance_inflation * precision, 1.0)
    growth, folds = state.noise_growth, folds_of(responses.manoeuvre, responses.seconds, full.settings)
    products = Products.of(residual / growth, S / growth[:, :, None], folds)
    return replace(state, S=S, products=products, folds=folds, mean=mean, precision=precision, nuisance=len(wide))


def _flat(constants: Float[np.ndarray, "m c o"], residual: Rows) -> Float[np.ndarray, " o"]:
    """Precision of constants that move the outputs by `WIDE` times the deviation of their residuals."""
    rows = np.maximum(np.any(constants != 0.0, axis=1).sum(axis=0), 1)
    by_one = np.sum(constants**2, axis=0) / rows / np.maximum(np.var(residual, axis=0), TINY)[:, None]
    size = 1.0 / np.maximum(np.sqrt(np.sum(by_one, axis=0)), TINY)
    return 1.0 / np.square(np.maximum(WIDE * size, TINY))


def constants_of_manoeuvres(
    full: CandidateModel, manoeuvre: Marks, outputs: Sequence[str], S: np.ndarray, name: str
) -> Float[np.ndarray, "m c o"]:
    """Sensitivity to a coefficient's constant in every manoeuvre: of itself, or of flown outputs to the model's one."""
    if name in outputs:
        column = np.tile((np.array(outputs) == name)[:, None], (len(manoeuvre), 1, 1)).astype(float)
    else:
        column = np.where(np.abs(S) < LARGEST, S, 0.0)[:, :, full.columns([f"{name}0"])]
    return column * (manoeuvre[:, None, None] == np.arange(int(manoeuvre[-1]) + 1))


def moved(
    state: SelectionState, theta: Vector, active: tuple[str, ...] | None = None, apart: tuple[str, ...] | None = None
) -> SelectionState:
    """The `narrow` state at other parameters, with other effects in or coefficients `apart`; the same noise growth."""
    active, apart = state.active if active is None else active, state.apart if apart is None else apart
    full = state.full
    if np.array_equal(state.theta, theta) and (not state.narrow or set(active) <= set(state.active)):
        residual, S = state.residual, state.S[:, :, : len(theta)]  # not computed again
    else:
        names = [p for name in (*full.base, *active) for p in full.parameters_of(name) if p in full.model.places]
        at = full.columns(names)
        residual, slopes = (x[:, state.kept_outputs] for x in state.responses.linearise(theta, at))
        S = np.zeros((*residual.shape, len(theta)))
        S[:, :, at] = slopes
    mean, precision = full.prior(range(len(theta)), theta)
    bare = replace(
        state, theta=theta, residual=residual, S=S, mean=mean, precision=precision, active=active, apart=apart,
        scans=(), nuisance=0, components=(), chosen=(), narrow=True,
    )  # fmt: skip
    return _with_nuisances(bare)


REFITS = 8
LEAST_GAIN = 0.05  # of the deviance


def refitted(state: SelectionState) -> SelectionState:
    return moved(state, optimum(state, range(len(state.folds))))


def optimum(state: SelectionState, folds: Sequence[int], most: int = REFITS) -> Vector:
    """Gauss-Newton on all active parameters, fitted to the chosen folds, each step kept inside the bounds."""
    bounds, columns = np.array([p.bounds for p in state.full.model.free]), state.columns()
    at, none = columns[columns < len(state.theta)], np.arange(0)

    def stepped(share: float) -> Vector:
        after = theta.copy()
        after[at] = np.clip(theta[at] + share * fit.step[: len(at)], bounds[at, 0] + 1e-9, bounds[at, 1] - 1e-9)
        return after

    def deviance_at(theta: Vector) -> float:
        """The deviance of `local_fit` without its regression, from the residuals alone."""
        mean, precision = state.full.prior(at, theta)
        linear = state.responses.residuals(theta, state.outputs), state.S[:, :, none]
        prior = state.variance_inflation * float(np.sum(precision * mean**2))
        return local_fit(state, theta, none, folds, linear=linear)[1] + prior

    theta = state.theta
    fit, value = local_fit(state, theta, at, folds, linear=(state.residual, state.S[:, :, at]))
    # A step that does not lower the deviance is shortened. The last step is one that would gain less than `LEAST_GAIN`.
    for step in range(most):
        if step:
            fit, value = local_fit(state, theta, at, folds)
        if value - fit.deviance < LEAST_GAIN:
            return stepped(1.0)
        for share in (1.0, 0.5, 0.2, 0.05):
            trial = stepped(share)
            lower = deviance_at(trial)  # of many trials, few are steps and need derivatives
            if lower < value:
                break
        else:
            break
        theta = trial
        if value - lower < LEAST_GAIN:
            break
    return theta


def local_fit(
    state: SelectionState,
    theta: Vector,
    at: Int[np.ndarray, " a"],
    folds: Sequence[int],
    held: Float[np.ndarray, " c"] | None = None,
    linear: tuple[Rows, Float[np.ndarray, "m c a"]] | None = None,
) -> tuple[RegressionFit, float]:
    """Regression on the columns `at` at `theta`, and the deviance there; `linear`: residuals and slopes, if known."""
    if linear is None:
        residual, S = (x[:, state.kept_outputs] for x in state.responses.linearise(theta, at))
        linear = residual, np.where(np.isfinite(S), S, 0.0)
    beside, growth = state.columns(), state.noise_growth
    beside = beside[beside >= len(state.theta)]  # offsets, and components that are in
    S = np.concatenate([linear[1], state.S[:, :, beside]], axis=2)
    products = Products.of(linear[0] / growth, S / growth[:, :, None], [state.folds[f] for f in folds])
    mean, precision = state.full.prior(at, theta)
    prior = state.variance_inflation * float(np.sum(precision * mean**2))
    precision = np.append(state.variance_inflation * precision, state.precision[beside])
    mean, free = np.append(mean, state.mean[beside]), np.arange(S.shape[2])
    only = products.fit(free[len(at) :], mean, precision)  # parameters as they are; offsets and variances adapt
    return products.fit(free, mean, precision, held), only.deviance + prior
