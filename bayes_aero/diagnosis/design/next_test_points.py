"""The next test points: manoeuvres that decide what the records leave open, in the least time.

Every standard manoeuvre is flown by the present model with several amplitudes and airspeeds. Of those inside the
envelope the next is the one that adds most information on all open questions per second. The information on two
effects is half the square of the standard deviations by which they differ, which is the expected log Bayes factor;
it counts until a question is decided.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any

import numpy as np

from bayes_aero.diagnosis.design.information import Information, Noise, Signals, noise_of, signals_of
from bayes_aero.diagnosis.design.standard import Linearised, Standard, of_records, on_record, standard
from bayes_aero.diagnosis.screening.selection_state import SelectionState
from bayes_aero.diagnosis.settings import ENOUGH
from bayes_aero.effect import Effect
from bayes_aero.errors import InputError
from bayes_aero.flight.envelope import Envelope

AMPLITUDES, FASTER = (0.5, 1.0, 1.5), (1.0, 1.15)  # of the standard inputs, and of the records' first airspeed
MOST, LITTLE = 4, 0.5  # test points, and nats from which another is worth flying
NOT_BY_HAND = ("multisine",)  # manoeuvres that need a computer at the controls


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

    `expected` by question, from the records, the earlier points and this one: standard deviations by which the closest
    rivals differ, or the probability to pass a tolerance; `rate`: nats a second.
    """

    __test__ = False  # no test of pytest's

    manoeuvre: str
    amplitude: float
    airspeed: float  # m/s, of the level flight in which it begins
    altitude: float  # m
    seconds: float
    excursion: Mapping[str, tuple[float, float]]
    expected: tuple[float, ...]
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
        return self.points[-1].expected if self.points else self.present


@dataclass(frozen=True)
class Variant:
    """One manoeuvre as it could be flown, and what it says; that of several adds up."""

    manoeuvre: str
    flown: Standard
    told: Any

    @property
    def seconds(self) -> float:
        """Length of its record."""
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
    flown = state if theta is None else replace(state, theta=theta)
    variants = variants_of(flown, names, envelope)
    noise = noise_of(state)
    records = of_records(state, chosen, noise)
    questions = tuple(_ambiguity(records, members, sizes, state.active) for members, sizes in sets.items())
    possible = possible_points(state, variants, chosen, noise, envelope)
    present = records.information()
    points = best_points(
        possible,
        present,
        nats=lambda told: sum(q.information(told) for q in questions),
        expected=lambda told: tuple(q.deviations(told) for q in questions),
        decided=lambda told: all(q.deviations(told) >= q.enough for q in questions),
    )
    return TestPoints(
        questions, tuple(q.deviations(present) for q in questions), points, refused_points(variants, envelope)
    )


def candidates_of(state: SelectionState, effects: Sequence[str]) -> list[Effect]:
    """The effects of an ambiguity set; `InputError` if it is none."""
    chosen = [_candidate(state, name) for name in dict.fromkeys(effects)]
    if len(chosen) < 2:
        raise InputError("an ambiguity set has at least two effects")
    return chosen


def _candidate(state: SelectionState, name: str) -> Effect:
    found = next((e for e in state.full.model.effects if e.name == name and e.parameters), None)
    if found is None:
        raise InputError(f"effect {name} is none that this record can test; choose among the candidates of the state")
    return found


def worth_of(chosen: Sequence[Effect], sizes: Mapping[str, float]) -> dict[str, float]:
    """The size of each parameter at which effects are told apart: the least worth modelling, or that in `sizes`."""
    return {p: least for e in chosen for p, (least, _) in e.sizes.items()} | dict(sizes)


def variants_of(state: SelectionState, effects: Sequence[str], envelope: Envelope) -> list[Standard]:
    """The standard manoeuvres with every amplitude and airspeed, inside the envelope."""
    return [
        standard(state, effects, amplitude=amplitude, faster=faster, envelope=envelope)
        for faster in FASTER
        for amplitude in AMPLITUDES
    ]


def possible_points(
    state: SelectionState,
    variants: Sequence[Standard],
    chosen: Sequence[Effect],
    noise: Noise,
    envelope: Envelope,
) -> list[Variant]:
    """Every manoeuvre that may be proposed, and its information on the model and the `chosen` candidates."""
    found = []
    for one in variants:
        for name, flight in one.flown.items():
            if envelope.programmed_inputs or name not in NOT_BY_HAND:
                there = on_record(state, one.model, flight, one.theta, chosen, noise)
                found.append(Variant(name, one, there.information(one.seconds[name])))
    return found


def refused_points(variants: Sequence[Standard], envelope: Envelope) -> dict[str, str]:
    """Manoeuvres that no amplitude or airspeed makes possible, with the reason."""
    flown = {name for one in variants for name in one.flown}
    refused = {name: why for one in variants for name, why in one.refused.items() if name not in flown}
    if not envelope.programmed_inputs:
        refused |= dict.fromkeys(NOT_BY_HAND, "a computer must give its inputs: [envelope] programmed_inputs")
    return refused


def best_points(
    possible: Sequence[Variant],
    told: Any,
    *,
    nats: Callable[[Any], float],
    expected: Callable[[Any], tuple[float, ...]],
    decided: Callable[[Any], bool],
) -> tuple[TestPoint, ...]:
    """One after another, the manoeuvre with most information a second, until all is decided or little is to be had.

    Args:
        possible: what may be flown.
        told: by the present records; `Variant.told` is added to it.
        nats: information on all questions.
        expected: see `TestPoint`.
        decided: whether nothing is left to decide.
    """
    points: list[TestPoint] = []
    while len(points) < MOST and not decided(told):
        known = nats(told)
        gains = [nats(told + one.told) - known for one in possible]
        worth = [k for k, gain in enumerate(gains) if gain >= LITTLE]
        if not worth:
            break
        best = max(worth, key=lambda k: gains[k] / possible[k].seconds)
        one, told = possible[best], told + possible[best].told
        flown = one.flown
        points.append(
            TestPoint(
                one.manoeuvre,
                flown.amplitude,
                flown.airspeed,
                flown.altitude,
                one.seconds,
                flown.excursion[one.manoeuvre],
                expected(told),
                gains[best] / one.seconds,
            )
        )
    return tuple(points)


def _ambiguity(
    records: Linearised, members: frozenset[str], sizes: Mapping[str, float], active: Sequence[str]
) -> Ambiguity:
    own = [e for e in records.chosen if e.name in members]
    foreign = [p.name for e in records.chosen if e.name not in {*members, *active} for p in e.parameters]
    question = Ambiguity(
        tuple(e.name for e in own), signals_of(records.state, own, worth_of(own, sizes)), tuple(foreign)
    )
    # The diagnosis has not told them apart by what the records say: as much as decides must come beside that.
    return replace(question, enough=float(np.hypot(ENOUGH, question.deviations(records.information()))))
