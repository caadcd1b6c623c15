"""Linear state-space models in dimensional derivatives: short period, lateral motion, or any other rows of a card.

Channels are total values, not deviations from trim, so each row has a constant where it needs one.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from bayes_aero.dynamics.flight import Dynamics, Values
from bayes_aero.dynamics.system import Row, System
from bayes_aero.errors import InputError
from bayes_aero.flight.aircraft import Aircraft
from bayes_aero.flight.card.card import Card
from bayes_aero.flight.card.linear_table import ONE, LinearCard
from bayes_aero.flight.channel_units import channel_units
from bayes_aero.model.joined_channels import Flights
from bayes_aero.parameter import Parameter, Prior
from bayes_aero.units import si_unit

WIDE = 1000.0  # SI: beyond any derivative of an aircraft, az per alpha of a fighter too


class LinearSystem(System):
    """Rates of the states, then outputs that are no states: `matrix` (rows, columns) times states, inputs and one."""

    matrix: Float[Array, "r c"]
    named: tuple[str, ...] = eqx.field(static=True)
    driven: tuple[str, ...] = eqx.field(static=True)
    read: tuple[str, ...] = eqx.field(static=True)

    @property
    def states(self) -> tuple[str, ...]:
        """As the card lists them."""
        return self.named

    def motion(self, x: Float[Array, " s"], u: Row) -> tuple[Float[Array, " s"], dict[str, Any]]:
        """One product; of so few elements, a sum compiles better than a call of the matrix library."""
        one = jnp.ones_like(x[0])
        column = jnp.concatenate([x, jnp.stack([*(u[name] for name in self.driven), one])])
        rows = jnp.sum(self.matrix * column[None, :], axis=1)
        s = len(self.named)
        outputs = dict(zip(self.named, x, strict=True)) | dict(zip(self.read, rows[s:], strict=True))
        return rows[:s], outputs


@dataclass(frozen=True)
class LinearDynamics(Dynamics):
    """A card's linear rows with their parameters; `fixed` parameters keep their value, the rest are free."""

    rows: LinearCard
    parameters: tuple[Parameter, ...]
    named: tuple[tuple[str, str], ...] = ()

    @property
    def units(self) -> Mapping[str, str]:
        """Of all its states."""
        return dict(self.named)

    @property
    def fixed(self) -> dict[str, float]:
        """Values of the parameters that are not estimated."""
        return dict(self.rows.fixed)

    @property
    def free(self) -> tuple[Parameter, ...]:
        """In the order in which the card first writes them."""
        return tuple(p for p in self.parameters if p.name not in self.fixed)

    @property
    def states(self) -> tuple[str, ...]:
        """As the card lists them."""
        return self.rows.states

    @property
    def inputs(self) -> tuple[str, ...]:
        """Every other channel that a row multiplies."""
        return self.rows.inputs

    @property
    def outputs(self) -> tuple[str, ...]:
        """States, and what the card adds."""
        return (*self.rows.states, *self.rows.outputs)

    def values(self, theta: Any) -> dict[str, Any]:
        """The fixed ones and the free ones."""
        return self.fixed | {name: theta[i] for i, name in enumerate(self.names)}

    def system(self, values: Values, aircraft: Aircraft) -> System:  # noqa: ARG002
        """The matrix filled in; where one channel has several terms in a row they add."""
        columns = (*self.states, *self.inputs, ONE)
        terms = [(i, columns.index(t.channel), t) for i, (_, row) in enumerate(self.rows.rows) for t in row]
        rows, across = ([place[k] for place in terms] for k in (0, 1))
        entries = jnp.stack([jnp.asarray(t.factor * values[t.parameter], float) for _, _, t in terms])
        matrix = jnp.zeros((len(self.outputs), len(columns))).at[jnp.array(rows), jnp.array(across)].add(entries)
        return LinearSystem(matrix, self.states, self.inputs, self.rows.outputs)

    def drives(self, values: Values, channels: Mapping[str, Array], flights: Flights) -> dict[str, Array]:  # noqa: ARG002
        """Its inputs as recorded, and a constant: a system without inputs, too, must know how many samples to fly."""
        return {name: channels[name] for name in self.inputs} | {ONE: jnp.ones_like(channels["dt"])}


def linear_dynamics(card: Card) -> LinearDynamics:
    """The linear system that a card states, its starts, bounds and priors in place."""
    if card.linear is None:
        raise InputError(f"card {card.name} has no section [linear]; add it, or use its [model]")
    units = channel_units(card)
    parameters = []
    for name in card.linear.parameters:
        unit, text = _meaning(name, card.linear, units)
        parameter = Parameter(name, unit, 0.0, 0.0, text, Prior("normal", 0.0, WIDE, "flat in effect; our choice"))
        change = card.changes.get(name)
        given = {} if change is None else {key: value for key, value in vars(change).items() if value is not None}
        try:
            parameters.append(parameter.changed(**given))
        except InputError as error:
            raise InputError(f"card {card.name}: {error}") from None
    return LinearDynamics(card.linear, tuple(parameters), tuple((name, units[name]) for name in card.linear.states))


def _meaning(name: str, rows: LinearCard, units: Mapping[str, str]) -> tuple[str, str]:
    """Unit of a parameter and what it does, by the first term that has it."""
    for index, (row, terms) in enumerate(rows.rows):
        for term in terms:
            if term.parameter == name:
                rate = index < len(rows.states)
                unit = f"({units[row]}){'/s' if rate else ''}/({units[term.channel]})"
                per = "constant part" if term.channel == ONE else f"per {term.channel}"
                return _tidy(unit), f"{'rate of ' if rate else ''}{row}, {per}"
    raise KeyError(name)


def _tidy(unit: str) -> str:
    return si_unit(unit.replace("/(1)", "").replace("(1)", "1")).replace("**", "^")
