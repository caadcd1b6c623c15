"""The next test points: manoeuvres that decide what the records leave open, in the least time.

Every standard manoeuvre is flown by the present model with several amplitudes and airspeeds. Of those inside the
envelope the next is the one that adds most information on all open questions per second. The information on two
effects is half the square of the standard deviations by which they differ, which is the expected log Bayes factor;
it counts until a question is decided.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, permutations
from typing import Any, NamedTuple, cast

import numpy as np
from jaxtyping import Float

from bayes_aero.diagnosis.result import TestPoint
from bayes_aero.diagnosis.screening import Autocorrelation, autocorrelation_of
from bayes_aero.diagnosis.selection_state import ENOUGH, SelectionState, inverse, linearised, manoeuvres
from bayes_aero.dynamics.pilot import ANYWHERE, EXCITED_CHANNELS, fly_standard
from bayes_aero.dynamics.trim import Condition
from bayes_aero.effect import Effect, Stage
from bayes_aero.errors import InputError
from bayes_aero.model.model import Model
from bayes_aero.model.records import Flights, plain_marks
from bayes_aero.physics.aircraft import Axis, Envelope, altitude_of_density, excursion
from bayes_aero.residuals.base import flight_path
from bayes_aero.residuals.equation_error import EquationError

AMPLITUDES, FASTER = (0.5, 1.0, 1.5), (1.0, 1.15)  # of the standard inputs, and of the records' first airspeed
MOST, LEAST_NATS = 4, 0.5  # test points, and nats from which another is worth flying
NOT_BY_HAND = ("multisine",)  # manoeuvres that need a computer at the controls


@dataclass(frozen=True)
class Ambiguity:
    """Which of several effects is there."""

    effects: tuple[str, ...]
    signals: Signals  # as in `Information.deviations`
    foreign: tuple[str, ...] = ()  # columns of effects that other questions ask for and that the model does not have
    enough: float = ENOUGH

    def pairs(self, information: Information) -> list[float]:
        deviations = information.without(self.foreign).deviations(self.signals)
        return [float(min(deviations[a, b], deviations[b, a])) for a, b in combinations(self.effects, 2)]

    def deviations(self, information: Information) -> float:
        return min(self.pairs(information))

    def nats(self, information: Information) -> float:
        """The mean of all pairs, each until it is decided."""
        return float(np.mean([0.5 * min(d, self.enough) ** 2 for d in self.pairs(information)]))


@dataclass(frozen=True)
class TestPoints:
    """Test points in the order of flying."""

    __test__ = False

    questions: tuple[Ambiguity, ...]
    present: tuple[float, ...]  # deviations of the records alone, by question
    points: tuple[TestPoint, ...]
    refused: Mapping[str, str]  # manoeuvres that never stay inside the envelope, or whose input was not recorded


class Variant(NamedTuple):
    """One manoeuvre as it could be flown, and what it says; that of several adds up."""

    manoeuvre: str
    flown: Standard
    information: Any


def next_test_points(
    state: SelectionState,
    sets: Mapping[frozenset[str], Mapping[str, float]],
    envelope: Envelope,
    theta: np.ndarray | None = None,
) -> TestPoints:
    """Choose them for ambiguity sets, at the sizes at which the effects of each are told apart, inside an envelope."""
    names, responses = sorted(frozenset().union(*sets)), cast("EquationError", state.responses)
    state = replace(state, responses=replace(responses, path=flight_path(responses.flights)))  # it tells sensors apart
    effects, noise = {e.name: e for e in state.full.model.effects}, noise_of(state)
    chosen = [effects[name] for name in names]
    variants = variants_of(state if theta is None else replace(state, theta=theta), names, envelope)
    records, questions = on_record(state, chosen, noise), []
    present = information_of(records, noise)
    for members, sizes in sets.items():
        inside = [e for e in chosen if e.name in members]
        foreign = tuple(p.name for e in chosen if e.name not in {*members, *state.active} for p in e.parameters)
        question = Ambiguity(tuple(e.name for e in inside), signals_of(records, inside, sizes), foreign)
        # The diagnosis has not told them apart by what the records say: as much as decides must come beside that.
        questions.append(replace(question, enough=float(np.hypot(ENOUGH, question.deviations(present)))))

    def expected(information: Information) -> tuple[float, ...]:
        return tuple(q.deviations(information) for q in questions)

    points = best_points(
        possible_points(state, variants, chosen, noise, envelope),
        present,
        nats=lambda information: sum(q.nats(information) for q in questions),
        expected=expected,
        decided=lambda information: all(q.deviations(information) >= q.enough for q in questions),
    )
    return TestPoints(tuple(questions), expected(present), points, refused_points(variants, envelope))


def variants_of(state: SelectionState, effects: Sequence[str], envelope: Envelope) -> list[Standard]:
    pairs = [{"amplitude": amplitude, "faster": faster} for faster in FASTER for amplitude in AMPLITUDES]
    return [standard(state, effects, **pair, envelope=envelope) for pair in pairs]


def possible_points(
    state: SelectionState, variants: list[Standard], chosen: Sequence[Effect], noise: ResidualNoise, envelope: Envelope
) -> list[Variant]:
    """Every manoeuvre that may be proposed, and its information on the model and the `chosen` candidates."""
    possible = []
    for flown, name in [(variant, name) for variant in variants for name in variant.flown]:
        if envelope.programmed_inputs or name not in NOT_BY_HAND:
            there = on_record(state, chosen, noise, flown, name)
            possible.append(Variant(name, flown, information_of(there, noise, flown.seconds[name])))
    return possible


def refused_points(variants: Sequence[Standard], envelope: Envelope) -> dict[str, str]:
    flown = {name for variant in variants for name in variant.flown}
    refused = {name: why for variant in variants for name, why in variant.refused.items() if name not in flown}
    if not envelope.programmed_inputs:
        refused |= dict.fromkeys(NOT_BY_HAND, "a computer must give its inputs: [envelope] programmed_inputs")
    return refused


def best_points(
    possible: Sequence[Variant],
    information: Any,
    *,
    nats: Callable[[Any], float],
    expected: Callable[[Any], tuple[float, ...]],
    decided: Callable[[Any], bool],
) -> tuple[TestPoint, ...]:
    """One after another, the manoeuvre with most information a second, until all is decided or little is to be had."""
    points: list[TestPoint] = []
    while len(points) < MOST and not decided(information):
        present = nats(information)
        gains = [nats(information + variant.information) - present for variant in possible]
        worth = [k for k, gain in enumerate(gains) if gain >= LEAST_NATS]
        if not worth:
            break
        best = max(worth, key=lambda k: gains[k] / possible[k].flown.seconds[possible[k].manoeuvre])
        name, flown, more = possible[best]
        information, seconds = information + more, flown.seconds[name]
        begin, rate = (flown.amplitude, flown.airspeed, flown.altitude), gains[best] / seconds
        points.append(TestPoint(name, *begin, seconds, flown.excursion[name], expected(information), rate))
    return tuple(points)


# --- What a record says of parameters: the information matrix, and what coloured noise makes of it.
# The outputs' noise is that which the present model leaves. What belongs to one record alone (offsets of the flight
# path, functions without a name) is projected out, so that the matrices of several records add up. Source: Klein and
# Morelli, *Aircraft System Identification*, 2006, ch. 9 (design of inputs from the information matrix); for coloured
# noise ch. 6, as in `inference.covariance`.

Signals = Mapping[str, Mapping[str, float]]
"""For each effect of a set: the size of each of its columns, by label."""


class ResidualNoise(NamedTuple):
    """Residuals of the present model: variance and colour by output, growth of each with 1 - X."""

    outputs: tuple[str, ...]
    variance: Float[np.ndarray, " c"]
    colour: Autocorrelation
    growth: Float[np.ndarray, " c"]

    def of(self, outputs: Sequence[str]) -> ResidualNoise:
        at = [c for c, name in enumerate(self.outputs) if name in outputs]
        colour = Autocorrelation(self.colour.phi[at], self.colour.sigma[at])
        return ResidualNoise(tuple(self.outputs[c] for c in at), self.variance[at], colour, self.growth[at])


def noise_of(state: SelectionState) -> ResidualNoise:
    """Residuals of the coefficients and, where it was recorded, of the flight path at the present parameters."""
    responses, parts = state.responses, manoeuvres(state.responses.manoeuvre)
    residual, apart = responses.residuals(state.theta, responses.outputs).copy(), responses.separated(state.theta)
    growth = np.zeros(residual.shape[1])
    for c, name in enumerate(responses.outputs):
        if name in state.outputs and np.any(apart > 0.0):
            there = state.noise_growth[:, state.outputs.index(name)]
            growth[c] = max(0.0, float((there - 1.0) @ apart / (apart @ apart)))
        if name not in state.full.model.coefficients:
            for part in parts:
                residual[part, c] -= residual[part, c].mean()
    residual /= 1.0 + growth * apart[:, None]
    return ResidualNoise(responses.outputs, np.mean(residual**2, axis=0), autocorrelation_of(residual, parts), growth)


@dataclass(frozen=True)
class Information:
    """Of one record or several, by the labels of their columns."""

    labels: tuple[str, ...]
    matrix: Float[np.ndarray, "k k"]  # information of white noise of the same variance
    score_variance: Float[np.ndarray, "k k"]  # of its score under the noise's colour
    prior: Float[np.ndarray, " k"]  # the priors' precision

    def __add__(self, other: Information) -> Information:
        """Of both records; a column that one of them lacks carries no information there."""
        labels = tuple(dict.fromkeys((*self.labels, *other.labels)))
        k = len(labels)
        matrix, score, prior = np.zeros((k, k)), np.zeros((k, k)), np.zeros(k)
        for record in (other, self):
            at = [labels.index(label) for label in record.labels]
            matrix[np.ix_(at, at)] += record.matrix
            score[np.ix_(at, at)] += record.score_variance
            prior[at] = record.prior
        return Information(labels, matrix, score, prior)

    def without(self, labels: Sequence[str]) -> Information:
        at = [k for k, label in enumerate(self.labels) if label not in labels]
        matrix, score = (x[np.ix_(at, at)] for x in (self.matrix, self.score_variance))
        return Information(tuple(self.labels[k] for k in at), matrix, score, self.prior[at])

    def deviations(self, signals: Signals) -> dict[tuple[str, str], float]:
        """By how many standard deviations the first of each pair differs from its best imitation by the other."""
        place = {label: k for k, label in enumerate(self.labels)}
        members = {place[label] for sizes in signals.values() for label in sizes}
        apart = {}
        for effect, other in permutations(signals, 2):
            at = [*(k for k in place.values() if k not in members), *(place[label] for label in signals[other])]
            imitated = inverse(self.matrix[np.ix_(at, at)] + np.diag(self.prior[at])) @ self.matrix[at]
            ratios = []
            for label, size in signals[effect].items():
                signal = np.zeros(len(place))
                signal[place[label]] = size
                left = signal.copy()
                left[at] -= imitated @ signal
                spread = float(left @ self.score_variance @ left)
                ratios.append(float(signal @ self.matrix @ left) / np.sqrt(spread) if spread > 0.0 else 0.0)
            apart[effect, other] = min(ratios)
        return apart


def columns_by_label(state: SelectionState, effect: Effect) -> dict[str, int]:
    """Columns of an effect by label; of one without slope at neutral, that of its least scanned value."""
    begin = len(state.theta) + state.nuisance
    scans = [(abs(s.value), begin + k, s) for k, s in enumerate(state.scans) if s.effect == effect.name]
    if scans:
        _, column, scan = min(scans, key=lambda row: row[0])
        return {scan.parameter: column}
    names = [name for name in state.full.parameters_of(effect.name) if name in state.full.model.names]
    return dict(zip(names, map(int, state.full.columns(names)), strict=True))


def signals_of(state: SelectionState, chosen: Sequence[Effect], sizes: Mapping[str, float]) -> Signals:
    """The size of each column of `chosen`: of its parameter in `sizes`, the least worth modelling, or a scanned one."""
    signals = {}
    for effect in chosen:
        scans = [s for s in state.scans if s.effect == effect.name]
        if scans:
            least = min(scans, key=lambda s: abs(s.value))
            present = state.theta[state.full.columns([least.parameter])[0]]
            signals[effect.name] = {least.parameter: float(least.value - present)}
        else:
            by_parameter = {p: least for p, (least, _) in effect.sizes.items()} | dict(sizes)
            signals[effect.name] = {label: by_parameter[label] for label in columns_by_label(state, effect)}
    return signals


# --- The standard manoeuvres, flown by a model that is identified so far, as records of the same channels.

BEGINNING = 2.0  # s of the record whose means are the flight condition


@dataclass(frozen=True)
class Standard:
    """The standard manoeuvres as a state's model flies them."""

    model: Model
    theta: Mapping[str, float]  # values flown
    flown: Mapping[str, Flights]
    seconds: Mapping[str, float]  # until the response to the last input is recorded
    excursion: Mapping[str, Mapping[str, tuple[float, float]]]  # of the envelope's quantities: least, greatest; SI
    refused: Mapping[str, str]  # which manoeuvre could not be flown, and why
    airspeed: float  # m/s, of the level flight in which all begin
    altitude: float  # m
    amplitude: float  # by which every input is multiplied


def standard(
    state: SelectionState,
    effects: Sequence[str],
    *,
    amplitude: float = 1.0,
    faster: float = 1.0,
    envelope: Envelope = ANYWHERE,
) -> Standard:
    """Fly the standard manoeuvres with what is in and `effects`, without the errors of sensors."""
    rigid = Axis.LATERAL in state.full.model.axes
    if rigid and Axis.LONGITUDINAL not in state.full.model.axes:
        raise InputError(
            "test points are flown from level flight, for which the card has no lift and drag; "
            'add "longitudinal" to [model] axes'
        )
    small = narrowed(state, effects)
    true = state.full.at_neutral(state.theta, [e.name for e in small.effects if e.stage is Stage.CHANNEL])
    theta = {n: x for n, x in zip(state.full.model.names, true, strict=True) if n in small.names}
    values, flights = dict(small.fixed) | theta, state.responses.flights
    begin = round(BEGINNING * 5 / state.responses.seconds)
    mean = {name: float(np.mean(np.asarray(x)[:begin])) for name, x in flights.channels.items()}
    # Where no altitude was recorded, that of standard air of the record's density.
    altitude = mean["altitude"] if "altitude" in mean else altitude_of_density(mean["density"])
    start = {"airspeed": mean["airspeed"] * faster, "altitude": altitude}
    dt = float(np.median(np.asarray(flights.channels["dt"])))
    aircraft = small.actual_aircraft(values, flights.aircraft)
    made, seconds, refused = fly_standard(
        small, values, aircraft, Condition(**start), dt=dt, amplitude=amplitude, envelope=envelope
    )
    moved = {n: c for n, c in EXCITED_CHANNELS.items() if rigid or c != "aileron"}
    unseen = {n: moved[n] for n in made if n in moved and moved[n] not in flights.recorded}
    flown = {}
    for name, channels in ((n, channels) for n, channels in made.items() if n not in unseen):
        n = len(channels["alpha"])  # a channel that the simulator does not make keeps its mean
        full = {c: channels.get(c, np.full(n, float(np.mean(flights.channels[c])))) for c in flights.recorded}
        signals = full | plain_marks(n, dt)
        flown[name] = Flights(signals, flights.aircraft, np.zeros(n, int), np.arange(n) * dt, (n,), ("standard",))
    excursions = {n: excursion(made[n]) for n in flown}
    refused |= {n: f"{channel} was not recorded" for n, channel in unseen.items()}
    return Standard(small, theta, flown, seconds, excursions, refused, **start, amplitude=amplitude)


def narrowed(state: SelectionState, chosen: Sequence[str]) -> Model:
    """The card's effects, those that are in, those chosen, and those without parameters: less to compile."""
    kept = {*state.full.base, *state.active, *chosen}
    effects = tuple(e for e in state.full.model.effects if e.name in kept or not e.parameters)
    names = {p.name for e in effects for p in e.parameters}
    fixed = tuple((k, x) for k, x in state.full.model.fixed if k in names)
    parameters = tuple(p for p in state.full.model.parameters if p.name in names)
    return replace(state.full.model, effects=effects, parameters=parameters, fixed=fixed)


def on_record(
    state: SelectionState, chosen: Sequence[Effect], noise: ResidualNoise, flown: Standard | None = None, name: str = ""
) -> SelectionState:
    """The problem of `state` on its records, or on one manoeuvre of `flown`, with `chosen` effects as candidates."""
    full, responses, theta, outputs = state.full, state.responses, state.theta, noise.outputs
    if flown is not None:
        model, flights = flown.model, flown.flown[name]
        path = tuple(n for n in noise.outputs if n not in model.coefficients)
        responses = replace(EquationError.of(flights, model), path=path)  # the same outputs everywhere: compiled once
        full, theta = replace(full, model=model), np.array([flown.theta[n] for n in model.names])
        # With wings level nothing of sideslip and bank.
        outputs = noise.of((*model.coefficients, *flight_path(flights))).outputs
    active = tuple(e for e in state.active if e not in {c.name for c in chosen})
    there = linearised(replace(full, candidates=tuple(chosen)), responses, outputs, theta, active, like=state)
    return replace(there, noise_growth=1.0 + noise.of(outputs).growth * responses.separated(theta)[:, None])


def information_of(state: SelectionState, noise: ResidualNoise, seconds: float | None = None) -> Information:
    """Of a record, or its first `seconds`, all outputs together: on the parameters in, and on every candidate."""
    noise, chosen = noise.of(state.outputs), state.full.candidates
    blocks = None if seconds is None else round(seconds / state.responses.seconds)
    candidates = {label: column for e in chosen for label, column in columns_by_label(state, e).items()}
    base = list(map(int, state.columns([n for n in state.active if n not in {e.name for e in chosen}])))
    parameters = {state.full.model.names[k]: k for k in base if k < len(state.theta)}
    labels = tuple(dict.fromkeys((*sorted(parameters), *candidates)))
    columns, alone = [(parameters | candidates)[label] for label in labels], [k for k in base if k >= len(state.theta)]
    whole, weight = state.scaled[:blocks], 1.0 / noise.variance
    S = plain = whole[:, :, columns]
    if alone:
        N = whole[:, :, alone]
        normal = np.einsum("mci,c,mcj->ij", N, weight, N, optimize=True) + np.diag(state.precision[alone])
        S = S - N @ (inverse(normal) @ np.einsum("mci,c,mcj->ij", N, weight, S, optimize=True))
    matrix = np.einsum("mci,c,mcj->ij", S, weight, plain, optimize=True)
    score = noise.colour.meat(S, noise.variance, manoeuvres(state.responses.manoeuvre[:blocks]))
    return Information(labels, 0.5 * (matrix + matrix.T), score, state.precision[columns])
