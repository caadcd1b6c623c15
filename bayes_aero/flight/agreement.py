"""Whether the sensors of records agree along the flight path: the answer as plain data."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any


class Agreement(StrEnum):
    """The answer in a word."""

    AGREE = "agree"
    EXPLAINED = "disagree_explained"
    UNEXPLAINED = "disagree_unexplained"
    NOT_CHECKED = "not_checked"


@dataclass(frozen=True)
class Departure:
    """A channel of a record that leaves the flight path: from `begin` to `end` (s) by `rms`, where noise permits
    `permitted` (both in the channel's SI unit, root mean square)."""

    record: str
    channel: str
    begin: float
    end: float
    rms: float
    permitted: float


@dataclass(frozen=True)
class PathCheck:
    """One record: where it departs, and the root mean square left of each channel with what is permitted. `turbulence`
    (m/s) is the standard deviation of gusts that was permitted, `gusts` the one that the record shows; `assumed` are
    channels that were not recorded and taken as zero."""

    record: str
    departures: tuple[Departure, ...]
    rms: Mapping[str, tuple[float, float]]
    turbulence: float
    gusts: float
    assumed: tuple[str, ...] = ()


@dataclass(frozen=True)
class OpenError:
    """An error of a sensor that the flight path cannot decide on, SI.

    `asked`: it would explain much of what is left, but parts of the record that were left out do not confirm it.
    `joint`: other errors that were added together with it, and the correlation of both estimates, where one of them is
    larger than sensors have: none of them holds by itself, and none is corrected.
    """

    name: str  # of the effect, which has one parameter
    unit: str  # of that parameter
    mean: float  # what the record says of it, were it the only error
    sd: float  # standard error of that
    among: float  # standard error with every other error of a sensor possible, as far as such errors usually go
    asked: bool
    imitators: tuple[str, ...]  # other errors that together do the same along this flight path
    share: float  # of what it does, that they do
    joint: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Consistency:
    """The flight path of each record as recorded, and with known errors of sensors taken out.

    `errors` of sensors and winds found along it: claim, whether minor, parameters, and `joint`, others with the
    correlation of the estimates, of which none holds without the other.
    """

    why_not: str = ""  # nothing was checked; empty where it was
    unchecked: tuple[str, ...] = ()  # channels that could not be checked, for they were not recorded
    recorded: tuple[PathCheck, ...] = ()  # a check of each record as it is
    corrected: tuple[PathCheck, ...] = ()  # the same with `errors` taken out; empty where none were sought or found
    errors: Mapping[str, Mapping[str, Any]] | None = None
    unsought: str = ""  # why no known error could be sought though the sensors disagree; empty where it could
    open: tuple[OpenError, ...] = ()  # errors of sensors that the flight path cannot decide on

    @property
    def agreement(self) -> Agreement:
        """Agree, disagree with or without an explanation, or not checked."""
        if self.why_not:
            return Agreement.NOT_CHECKED
        if not any(check.departures for check in self.recorded):
            return Agreement.AGREE
        explained = self.corrected and not any(check.departures for check in self.corrected)
        return Agreement.EXPLAINED if explained else Agreement.UNEXPLAINED

    @property
    def disagrees(self) -> bool:
        """Whether the sensors disagree, explained or not."""
        return self.agreement in (Agreement.EXPLAINED, Agreement.UNEXPLAINED)

    @property
    def departures(self) -> tuple[Departure, ...]:
        """Where records depart from their flight path; if errors explain that in part, where they still do."""
        left = tuple(d for check in self.corrected for d in check.departures)
        return left or tuple(d for check in self.recorded for d in check.departures)
