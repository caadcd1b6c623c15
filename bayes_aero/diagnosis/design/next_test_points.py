"""The next test points: manoeuvres that decide what the records leave open, in the least time.

Every standard manoeuvre is flown by the present model with several amplitudes and airspeeds. Of those inside the
envelope the next is the one that adds most information on all open questions per second. The information on two
effects is half the square of the standard deviations by which they differ, which is the expected log Bayes factor;
it counts until a question is decided.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from bayes_aero.diagnosis.design.information import Information, Signals, noise_of, signals_of
from bayes_aero.diagnosis.design.separating import NOT_BY_HAND, candidates_of, worth_of
from bayes_aero.diagnosis.design.standard import Linearised, Standard, flights_of, on_record, standard
from bayes_aero.diagnosis.screening.selection_state import SelectionState
from bayes_aero.diagnosis.settings import ENOUGH
from bayes_aero.flight.envelope import Envelope

AMPLITUDES, FASTER = (0.5, 1.0, 1.5), (1.0, 1.15)  # of the standard inputs, and of the records' first airspeed
MOST, LITTLE = 4, 0.5  # test points, and nats from which another is worth flying


@dataclass(frozen=True)
class Ambiguity:
    """Which of several effects is there: `signals` as in `Information.deviations`.

    `foreign`: columns of effects that other questions ask for and that the model does not have.
    """

    effects: tuple[str, ...]
    signals: Signals
    foreign: tuple[str, ...] = ()
    enough: float = ENOUGH

    @property
    def label(self) -> str:
        """In words."""
        return " or ".join(self.effects)

    def pairs(self, told: Information) -> list[float]:
        """Deviations of each pair, the lesser of both directions."""
        found = told.without(self.foreign).deviations(self.signals)
        return [float(min(found[a, b], found[b, a])) for a, b in combinations(self.effects, 2)]

    def deviations(self, told: Information) -> float:
        """By which the closest pair differs."""
        return min(self.pairs(told))

    def information(self, told: Information) -> float:
        """Nats, the mean of all pairs, each until it is decided."""
        return float(np.mean([0.5 * min(d, self.enough) ** 2 for d in self.pairs(told)]))


@dataclass(frozen=True)
class TestPoint:
    """A manoeuvre to be flown; `excursion`: least and greatest of the envelope's quantities, SI.

    `deviations` by question: expected from the records, the earlier points and this one; `rate`: nats a second.
    """

    __test__ = False  # no test of pytest's

    manoeuvre: str
    amplitude: float
    airspeed: float  # m/s, of the level flight in which it begins
    altitude: float  # m
    seconds: float
    excursion: Mapping[str, tuple[float, float]]
    deviations: tuple[float, ...]
    rate: float


@dataclass(frozen=True)
class TestPoints:
    """Test points in the order of flying; `present`: deviations of the records alone, by question.

    `refused`: manoeuvres that no amplitude or airspeed keeps inside the envelope, or whose input was not recorded.
    """

    __test__ = False

    questions: tuple[Ambiguity, ...]
    present: tuple[float, ...]
    points: tuple[TestPoint, ...]
    refused: Mapping[str, str]

    @property
    def expected(self) -> tuple[float, ...]:
        """Deviations by question when all points are flown."""
        return self.points[-1].deviations if self.points else self.present


@dataclass(frozen=True)
class _Variant:
    """One manoeuvre as it could be flown, and what it says."""

    manoeuvre: str
    flown: Standard
    told: Information

    @property
    def seconds(self) -> float:
        return self.flown.seconds[self.manoeuvre]


def next_test_points(
    state: SelectionState,
    sets: Mapping[frozenset[str], Mapping[str, float]],
    envelope: Envelope,
    theta: np.ndarray | None = None,
) -> TestPoints:
    """Choose them for ambiguity sets.

    Args:
        state: where the diagnosis ended.
        sets: the effects of each, and the sizes at which they are told apart, by parameter, SI.
        envelope: inside which manoeuvres are proposed.
        theta: parameters with which they are flown (default: those of `state`).

    Returns:
        The points, and what each is expected to say of each question.

    Raises:
        InputError: the model cannot be flown, or an effect of a set is none that the records can test.
    """
    names = sorted(frozenset().union(*sets))
    chosen = candidates_of(state, names)
    variants = [
        standard(
            state if theta is None else replace(state, theta=theta), names, amplitude=a, faster=f, envelope=envelope
        )
        for f in FASTER
        for a in AMPLITUDES
    ]
    noise = noise_of(state)
    own = dict(zip(state.full.model.names, map(float, state.theta), strict=True))
    records = on_record(state, variants[0].model, flights_of(state), own, chosen, noise)
    questions = tuple(_ambiguity(records, members, sizes, state.active) for members, sizes in sets.items())
    flown = [
        _Variant(
            name, one, on_record(state, one.model, flight, one.theta, chosen, noise).information(one.seconds[name])
        )
        for one in variants
        for name, flight in one.flown.items()
        if envelope.programmed_inputs or name not in NOT_BY_HAND
    ]
    present = records.information()
    refused = {n: why for one in variants for n, why in one.refused.items() if all(n not in v.flown for v in variants)}
    if not envelope.programmed_inputs:
        refused |= dict.fromkeys(NOT_BY_HAND, "a computer must give its inputs: [envelope] programmed_inputs")
    return TestPoints(
        questions, tuple(q.deviations(present) for q in questions), _chosen(flown, questions, present), refused
    )


def _ambiguity(
    records: Linearised, members: frozenset[str], sizes: Mapping[str, float], active: Sequence[str]
) -> Ambiguity:
    own = [e for e in records.chosen if e.name in members]
    foreign = [p.name for e in records.chosen if e.name not in {*members, *active} for p in e.parameters]
    return Ambiguity(tuple(e.name for e in own), signals_of(records.state, own, worth_of(own, sizes)), tuple(foreign))


def _chosen(flown: Sequence[_Variant], questions: Sequence[Ambiguity], told: Information) -> tuple[TestPoint, ...]:
    """One after another, the one with most information a second, until all is decided or little is to be had."""
    points: list[TestPoint] = []
    while len(points) < MOST:
        known = sum(q.information(told) for q in questions)
        gains = [sum(q.information(told + v.told) for q in questions) - known for v in flown]
        worth = [k for k, gain in enumerate(gains) if gain >= LITTLE]
        if not worth:
            break
        best = max(worth, key=lambda k: gains[k] / flown[k].seconds)
        one, told = flown[best], told + flown[best].told
        points.append(
            TestPoint(
                one.manoeuvre,
                one.flown.amplitude,
                one.flown.airspeed,
                one.flown.altitude,
                one.seconds,
                one.flown.excursion[one.manoeuvre],
                tuple(q.deviations(told) for q in questions),
                gains[best] / one.seconds,
            )
        )
    return tuple(points)
