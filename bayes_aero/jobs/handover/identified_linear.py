"""The linear system of a card with the values that a finished result has found."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

from bayes_aero.dynamics.linear import LinearDynamics, linear_dynamics
from bayes_aero.export.identified import Identified
from bayes_aero.flight.card.card import Card
from bayes_aero.flight.card.linear_table import LinearCard
from bayes_aero.model.joined_channels import Flights


@dataclass(frozen=True)
class IdentifiedLinear:
    """A linear system with values of its parameters, SI and radians; `sources` say where these come from.

    `manoeuvres`: how many were fitted. Constants that differ between manoeuvres have a value for each of them.
    """

    card: Card
    values: Mapping[str, float]
    sources: tuple[str, ...]
    manoeuvres: int

    @property
    def name(self) -> str:
        """The card's."""
        return self.card.name

    @property
    def title(self) -> str:
        """The card's."""
        return self.card.title

    @property
    def rows(self) -> LinearCard:
        """The rows of the card."""
        assert self.card.linear is not None
        return self.card.linear

    @cached_property
    def fitted(self) -> LinearDynamics:
        """The system of all manoeuvres, of whatever length."""
        return linear_dynamics(self.card, (1,) * self.manoeuvres)

    @property
    def names(self) -> tuple[str, ...]:
        """The free parameters."""
        return self.fitted.names

    @property
    def bounds(self) -> dict[str, tuple[float, float]]:
        """By parameter."""
        return {p.name: p.bounds for p in self.fitted.free}

    def dynamics(self, flights: Flights) -> LinearDynamics:
        """What flies these manoeuvres."""
        return linear_dynamics(self.card, flights.lengths)


Finished = Identified | IdentifiedLinear
