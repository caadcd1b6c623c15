"""What a search for missing effects has found, whichever way the model meets the record."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from bayes_aero.diagnosis.candidate_set import CandidateModel
from bayes_aero.diagnosis.result import ParameterChange, UnexplainedStructure
from bayes_aero.diagnosis.selection.forward_selection import Extension
from bayes_aero.diagnosis.selection.noise import NoiseReport
from bayes_aero.diagnosis.terms.result import FoundTerm
from bayes_aero.flight.card.card import Card
from bayes_aero.flight.record import FlightRecord
from bayes_aero.physics.coefficient_names import required_of


@dataclass(frozen=True)
class SearchResult:
    """Extensions by stage, the model's own last; structure without a name; noise.

    `testable_now`: whether hold-out data can be asked at once; trajectories ask them when they are compared.
    """

    full: CandidateModel
    stages: tuple[tuple[str, Extension], ...]
    unknown: tuple[UnexplainedStructure, ...]
    noise: NoiseReport
    notes: tuple[str, ...] = ()
    failures: tuple[str, ...] = ()  # parts that failed unexpectedly
    testable_now: bool = True
    changes: tuple[ParameterChange, ...] = ()
    terms: tuple[FoundTerm, ...] = ()
    forms: Mapping[str, tuple[str, float]] = field(default_factory=dict)  # as good as a cause; see `Forms.rivals`

    @property
    def model(self) -> Extension:
        """The extension of the model itself."""
        return self.stages[-1][1]

    @property
    def sensors(self) -> Extension | None:
        """The extension of the flight path, by errors of sensors."""
        return self.stages[0][1] if len(self.stages) > 1 else None

    @property
    def not_testable(self) -> Mapping[str, str]:
        """Why effects could not be tested: a lag is tested where the search has tried it and added it."""
        added = {name for _, one in self.stages for name in one.state.active}
        return {name: why for name, why in self.full.not_testable.items() if name not in added}

    @property
    def by_stage(self) -> Mapping[str, Extension]:
        """The extensions by name of the stage."""
        return dict(self.stages)


def lacking(records: Sequence[FlightRecord], card: Card) -> tuple[str, ...]:
    """Channels that coefficients need and some record does not have: trajectories are compared then."""
    given = {*card.sums, *card.constants, *card.derived, *card.tables}
    return tuple(n for n in required_of(card.axes) if n not in given and any(not record.has(n) for record in records))
