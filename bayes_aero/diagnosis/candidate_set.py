"""Candidates: every effect of the catalogue that the card's model lacks and the record can test; thresholds; folds."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from statistics import NormalDist
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from bayes_aero.effect import NEUTRAL_FLOW, Effect, Kind, Stage, Untestable, sized
from bayes_aero.effects import CATALOGUE
from bayes_aero.errors import InputError
from bayes_aero.flight.channel import STANDARD_CHANNELS
from bayes_aero.flight.health import noise_alone
from bayes_aero.model.model import Model
from bayes_aero.model.records import Flights
from bayes_aero.parameter import Prior, Role, per_length
from bayes_aero.units import number

# --- Every threshold of a diagnosis, each with its reason. What is called our choice has no other.

ENOUGH = 3.0  # deviations by which effects must differ for a manoeuvre to separate them


@dataclass(frozen=True)
class DiagnosisSettings:
    """Thresholds of screening, selection, hold-out tests and the search for structure without a name. They were chosen
    on simulated flights; the rates of error that follow from them are in `benchmarks/README.md`."""

    max_effects: int = 8  # effects that each stage may add

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
    def neutral_vector(self) -> Float[np.ndarray, " k"]:
        """Neutral value of every free parameter, finite."""
        return self.vector({})

    def vector(self, values: Mapping[str, float]) -> Float[np.ndarray, " k"]:
        """Every free parameter at its value, or at neutral where it has none."""
        everything = self.neutral | dict(values)
        return np.array([everything[name] for name in self.model.names], float)

    def at_neutral(self, theta: Float[np.ndarray, " k"], effects: Sequence[str]) -> Float[np.ndarray, " k"]:
        """`theta` with the free parameters of these effects at neutral."""
        names = {p for effect in effects for p in self.parameters_of(effect)}
        return np.where([name in names for name in self.model.names], self.neutral_vector, theta)

    def card_only(self, theta: Float[np.ndarray, " k"]) -> Float[np.ndarray, " k"]:
        """`theta` with every effect at neutral that is not on the card."""
        return self.at_neutral(theta, [e.name for e in self.model.effects if e.name not in self.base])

    def prior(
        self, index: Sequence[int] | Int[np.ndarray, " j"], theta: Float[np.ndarray, " k"]
    ) -> tuple[np.ndarray, np.ndarray]:
        """Mean and precision of the step from `theta` for parameters `index`, their priors taken as normal."""
        free = self.model.free
        pairs = [self.priors.get(free[i].name, free[i].prior).normal for i in index]
        mean, deviation = np.array(pairs).reshape(-1, 2).T
        return mean - theta[np.asarray(index, int)], deviation**-2.0

    def columns(self, names: Sequence[str]) -> np.ndarray:
        return np.array([self.model.places[name] for name in names], int)

    def own_columns(self, *effects: str) -> np.ndarray:
        """Index of each parameter that these effects own."""
        return self.columns([name for effect in effects for name in self.parameters_of(effect)])

    def parameters_of(self, effect: str) -> tuple[str, ...]:
        return tuple(p.name for e in self.model.effects if e.name == effect for p in e.parameters)


def finite(neutral: float) -> float:
    return neutral if math.isfinite(neutral) else FAR


def lag_of(full: CandidateModel) -> Effect | None:
    """The candidate that lets the separation point lag and can be flown."""
    lags = (e for e in full.candidates if e.stage is Stage.LAG)
    return next((e for e in lags if any(p.role is Role.LAG for p in e.parameters)), None)


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
        if still and not missing and effect.together and _varies(_made(effect, flights, {}), flights):
            still = []
        lacking, waiting = [name for name in effect.uses if name not in owned], False
        proposed = effect.candidate and effect.acts_on(model.axes)
        if effect.kind is Kind.NOISE or not (proposed or effect in absent):
            continue
        if missing:
            not_testable[effect.name] = Untestable.of(Untestable.NOT_RECORDED, missing)
        elif still and effect.stage > Stage.AIRCRAFT:
            label = any(_moves(np.asarray(flights.channels[c])) for c in still)
            why = "channel {} differs only between manoeuvres, as an offset does" if label else Untestable.STILL
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
    dormant = [
        e
        for e in CATALOGUE.values()
        if not e.parameters and e not in active and e.acts_on(model.axes) and all(name in owned for name in e.uses)
    ]
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
    return any(_moves(part, least) for part in by_manoeuvre(np.asarray(x), flights))


def _moves(x: np.ndarray, least: float = 1e-9) -> bool:
    return bool(np.ptp(x) > least * max(1.0, float(np.abs(x).max())))


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
    there = _varies(_made(effect, flights, {}), flights)
    return noisy if there and not _varies(_made(effect, flights, calm), flights) else ()


def _made(effect: Effect, flights: Flights, instead: Mapping[str, np.ndarray]) -> list[np.ndarray]:
    """What an effect of its least size makes of the record, with some channels replaced."""
    values = {p.name: p.start + effect.sizes.get(p.name, (0.0, 0.0))[0] for p in effect.parameters}
    signals: dict[str, Any] = {name: np.asarray(x) for name, x in flights.channels.items()} | dict(instead)
    flow = NEUTRAL_FLOW | ({"incidence": signals["alpha"]} if "alpha" in signals else {})
    return [np.asarray(x) for x in effect.increments(values, signals, flights.aircraft, flow).values()]


def _varies(made: Sequence[np.ndarray], flights: Flights) -> bool:
    """Whether any of these moves within a manoeuvre: T/(qbar S) does where only the airspeed changes."""
    return any(
        np.ptp(part) > MOVES * np.max(np.abs(x)) for x in made if np.ndim(x) for part in by_manoeuvre(x, flights)
    )


# --- The parts of the records that are predicted from the others: manoeuvres, or parts of a single one.
# Fits to coefficients leave out these folds: the parameters again (`LeftOut.refitted`), or to first order from inner
# products (`Products.without`). Trajectories leave out segments, which are flown from their measured state
# (`flights.holdout_fits`); Gaussian processes are validated on samples, at random as published, too
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


def manoeuvres(manoeuvre: Int[np.ndarray, " m"]) -> tuple[slice, ...]:
    edges = np.flatnonzero(np.diff(manoeuvre, prepend=-1, append=-1))
    return tuple(slice(int(a), int(b)) for a, b in pairwise(edges))


def folds_of(
    manoeuvre: Int[np.ndarray, " m"], seconds: float, settings: DiagnosisSettings = DEFAULT
) -> tuple[slice, ...]:
    """Manoeuvres as folds, or contiguous parts of a single one with a gap between them."""
    if manoeuvre[-1] > 0:
        return manoeuvres(manoeuvre)
    if why := too_short(len(manoeuvre) * seconds, settings):
        raise InputError(why)
    parts = min(settings.parts, int(len(manoeuvre) * seconds / (settings.shortest_part * settings.gap)))
    cuts = np.linspace(0, len(manoeuvre), parts + 1).astype(int)
    gap = max(1, round(settings.gap / seconds / 2))
    return tuple(
        slice(int(a) + (gap if a else 0), int(b) - (gap if b < len(manoeuvre) else 0)) for a, b in pairwise(cuts)
    )
