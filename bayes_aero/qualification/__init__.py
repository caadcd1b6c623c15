"""What a qualification finds, as plain data, SI and radians."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum

import numpy as np
from jaxtyping import Float

from bayes_aero.diagnosis.result import TestPoint
from bayes_aero.flight.health import Consistency, HealthFinding

PASSES_FROM, FAILS_TO = 0.95, 0.05  # probabilities from which a tolerance passes, and to which it fails; our choice


class ToleranceVerdict(Enum):
    """Of a tolerance; the value is the word for the user."""

    PASSES = "passes"
    UNDECIDED = "undecided"
    FAILS = "fails"


class FlightKind(Enum):
    """What is flown: a fitted manoeuvre again, a manoeuvre that was not fitted, or a fitted one on the next flight."""

    AGAIN = "again"
    TEST = "test"
    NEXT = "next flight"


@dataclass(frozen=True)
class Chance:
    """A probability by Monte Carlo, with its standard error."""

    value: float
    error: float

    @classmethod
    def of(cls, passed: int, count: int) -> Chance:
        """From `passed` of `count` draws; the standard error is the posterior's under Jeffreys' prior, never zero."""
        near = (passed + 0.5) / (count + 1.0)
        return cls(passed / count, float(np.sqrt(near * (1.0 - near) / (count + 2.0))))

    @property
    def verdict(self) -> ToleranceVerdict:
        """Decided where the probability lies beyond a threshold by two Monte Carlo standard errors."""
        if self.value - 2.0 * self.error >= PASSES_FROM:
            return ToleranceVerdict.PASSES
        return ToleranceVerdict.FAILS if self.value + 2.0 * self.error <= FAILS_TO else ToleranceVerdict.UNDECIDED


@dataclass(frozen=True)
class RecordBeside:
    """The model with its estimates beside the record: largest error (SI), and the share of time inside the band."""

    largest: float
    within: float

    @property
    def passed(self) -> bool:
        return self.within == 1.0


@dataclass(frozen=True)
class Test:
    """One output of one manoeuvre."""

    __test__ = False  # not one of pytest's

    kind: FlightKind
    manoeuvre: str  # whose inputs and initial state
    output: str
    tolerance: float  # half the width of its band, SI
    chances: Mapping[str, Chance]
    """Probability of the whole manoeuvre inside the band by what is counted: `parameters` alone, then `structure` with
    them, then `gusts` with both, where gusts are counted."""
    within: float  # expected share of the time inside, all counted
    recorded: RecordBeside | None = None  # None for the next flight

    @property
    def chance(self) -> Chance:
        return [*self.chances.values()][-1]


@dataclass(frozen=True)
class Outside:
    """How far a manoeuvre leaves the flown region, the convex hull of all fitted samples."""

    manoeuvre: str
    motion: str  # recorded or simulated
    channels: tuple[str, ...]  # of the hull
    share: float  # of the samples farther outside than `qualify.NOTABLE`
    distance: float  # of the farthest sample, in units of half the flown range of each channel (`Region.scale`)
    time: float  # of that sample, s from the start
    excess: Mapping[str, float]  # by channel, from the nearest point of the hull to that sample, SI


@dataclass(frozen=True)
class Strip:
    """One manoeuvre over time in s (n,): recorded, simulated, and the central 95 % of flights by output, (n,)."""

    kind: FlightKind
    manoeuvre: str
    time: Float[np.ndarray, " n"]
    measured: Mapping[str, np.ndarray]
    simulated: Mapping[str, np.ndarray]
    low: Mapping[str, np.ndarray]
    high: Mapping[str, np.ndarray]


@dataclass(frozen=True)
class OpenTolerance:
    """An undecided test: the probability to pass now, and if the parameters were known exactly."""

    kind: FlightKind
    manoeuvre: str
    output: str
    present: float
    known: float

    @property
    def decidable(self) -> bool:
        return not FAILS_TO < self.known < PASSES_FROM


@dataclass(frozen=True)
class Further:
    """Test points for undecided tests, in the order of flying: `expected` of a point are probabilities to pass."""

    tests: tuple[OpenTolerance, ...]
    points: tuple[TestPoint, ...] = ()
    refused: Mapping[str, str] = field(default_factory=dict)  # manoeuvres that cannot be proposed, with the reason
    why_not: str = ""  # why there are no points at all


@dataclass(frozen=True)
class Qualification:
    """All tests of a model."""

    tests: tuple[Test, ...]
    outside: tuple[Outside, ...]
    channels: tuple[str, ...]  # of the flown region
    unjudged: tuple[str, ...]  # channels of the region that were not recorded
    strips: tuple[Strip, ...]
    tolerances: Mapping[str, tuple[float, str]]  # half width in SI and source, by output
    draws: int  # Monte Carlo draws a test
    origins: Mapping[str, str] = field(default_factory=dict)
    """Where parameters, structure, gusts and the scatter between manoeuvres come from, a sentence each."""
    notes: tuple[str, ...] = ()
    further: Further | None = None  # flights that would decide what is undecided; None where nothing is
    health: tuple[HealthFinding, ...] = ()  # faults of the channels of all records, fitted and new
    consistency: Consistency | None = None  # whether their sensors agree; None: not asked

    def of(self, output: str) -> tuple[Test, ...]:
        return tuple(test for test in self.tests if test.output == output)

    def verdict(self, output: str) -> ToleranceVerdict:
        """Of a tolerance: it fails where one of its tests does, and passes where all do, those on record, too."""
        tests = self.of(output)
        if any(test.chance.verdict is ToleranceVerdict.FAILS for test in tests):
            return ToleranceVerdict.FAILS
        recorded = all(test.recorded is None or test.recorded.passed for test in tests)
        sure = all(test.chance.verdict is ToleranceVerdict.PASSES for test in tests)
        return ToleranceVerdict.PASSES if recorded and sure else ToleranceVerdict.UNDECIDED

    @property
    def whole(self) -> ToleranceVerdict:
        """Of the model: it fails where one tolerance does, and passes where all do."""
        verdicts = {self.verdict(output) for output in self.tolerances}
        worst_first = (ToleranceVerdict.FAILS, ToleranceVerdict.UNDECIDED, ToleranceVerdict.PASSES)
        return next(verdict for verdict in worst_first if verdict in verdicts)
