"""Linear state-space models in dimensional derivatives: short period, lateral motion, or any other rows of a card.

Channels are total values, not deviations from trim, so each row has a constant where it needs one.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from bayes_aero.dynamics.flight import Dynamics, Values
from bayes_aero.dynamics.system import OfPlain, Row, System
from bayes_aero.effects import CATALOGUE
from bayes_aero.errors import InputError
from bayes_aero.flight.aircraft import Aircraft
from bayes_aero.flight.card.card import Card, channel_units
from bayes_aero.flight.card.tables import ONE, LinearCard
from bayes_aero.model.observations import Flights
from bayes_aero.parameter import Limits, Parameter, Prior, Sign
from bayes_aero.units import si_unit

FLAT_SD = 1000.0  # SI: larger than any derivative of an aircraft, also az per alpha of a fighter
ALIKE = {  # the effect whose sign and limits a derivative of a rate has: inertia and dynamic pressure are positive
    ("p", "aileron"): "aileron_roll", ("p", "p"): "roll_damping", ("p", "beta"): "sideslip_roll",
    ("q", "elevator"): "elevator_moment", ("q", "q"): "pitch_damping",
    ("r", "rudder"): "rudder_yaw", ("r", "r"): "yaw_damping", ("r", "beta"): "sideslip_yaw",
}  # fmt: skip
PART_OF = {"aileron_right": ("aileron", 1.0), "aileron_left": ("aileron", -1.0)}
"""Half of right less left is the aileron."""
FLAT = Prior("normal", 0.0, FLAT_SD, "flat in effect; our choice")


class LinearSystem(System):
    """Rates of the states, then further outputs: `matrix` (rows, columns) times states, inputs and one. The row of an
    output that is also a state is added to the state."""

    matrix: Float[Array, "r c"]
    named: tuple[str, ...] = eqx.field(static=True)
    inputs_read: tuple[str, ...] = eqx.field(static=True)
    read: tuple[str, ...] = eqx.field(static=True)

    @property
    def states(self) -> tuple[str, ...]:
        return self.named

    @property
    def state_outputs(self) -> tuple[str, ...]:
        """States without a row of their own among the outputs."""
        return tuple(name for name in self.named if name not in self.read)

    def motion(self, x: Float[Array, " s"], u: Row) -> tuple[Float[Array, " s"], dict[str, Any]]:
        """Rates and outputs by one product; for so few elements a sum compiles better than a matrix product."""
        one = jnp.ones_like(x[0])
        column = jnp.concatenate([x, jnp.stack([*(u[name] for name in self.inputs_read), one])])
        rows = jnp.sum(self.matrix * column[None, :], axis=1)
        s = len(self.named)
        states = dict(zip(self.named, x, strict=True))
        read = {name: row + states.get(name, 0.0) for name, row in zip(self.read, rows[s:], strict=True)}
        return rows[:s], states | read


@dataclass(frozen=True)
class LinearDynamics(Dynamics):
    """A card's linear rows with their parameters; `fixed` parameters keep their value, the others are free. A constant
    that differs between manoeuvres has a parameter for each of them and is an input of the system."""

    rows: LinearCard
    parameters: tuple[Parameter, ...]
    named: tuple[tuple[str, str], ...] = ()
    lengths: tuple[int, ...] = (1,)  # samples of the manoeuvres

    @property
    def units(self) -> Mapping[str, str]:
        return dict(self.named)

    @property
    def fixed(self) -> dict[str, float]:
        return dict(self.rows.fixed)

    @property
    def free(self) -> tuple[Parameter, ...]:
        free = [p for p in self.parameters if p.name not in self.fixed]
        many = {name: self.names_of(name) for name in self.rows.by_manoeuvre}
        return tuple(replace(p, name=name) for p in free for name in many.get(p.name, [p.name]))

    @property
    def flat(self) -> tuple[str, ...]:
        """Free parameters of which the card states no prior."""
        return tuple(p.name for p in self.free if p.prior == FLAT)

    @property
    def states(self) -> tuple[str, ...]:
        return self.rows.states

    @property
    def inputs(self) -> tuple[str, ...]:
        return self.rows.inputs

    @property
    def outputs(self) -> tuple[str, ...]:
        return tuple(dict.fromkeys((*self.rows.states, *self.rows.outputs)))

    def values(self, theta: Any) -> dict[str, Any]:
        return self.fixed | {name: theta[i] for i, name in enumerate(self.names)}

    def system(self, values: Values, aircraft: Aircraft) -> System:  # noqa: ARG002
        """The system with its matrix; several terms of one channel in a row are added."""
        own = self.rows.by_manoeuvre
        inputs_read = (*self.inputs, *own)
        columns = (*self.states, *inputs_read, ONE)
        terms = [(i, t) for i, (_, row) in enumerate(self.rows.rows) for t in row]
        across = [columns.index(t.parameter if t.parameter in own else t.channel) for _, t in terms]
        sizes = [t.factor * (1.0 if t.parameter in own else values[t.parameter]) for _, t in terms]
        entries = jnp.stack([jnp.asarray(size, float) for size in sizes])
        places = jnp.array([i for i, _ in terms]), jnp.array(across)
        matrix = jnp.zeros((len(self.rows.rows), len(columns))).at[places].add(entries)
        return LinearSystem(matrix, self.states, inputs_read, self.rows.outputs)

    def drives(self, values: Values, channels: Mapping[str, Array], flights: Flights) -> dict[str, Array]:  # noqa: ARG002
        """Recorded inputs, and a constant, which gives the number of samples where there are no inputs."""
        which = np.repeat(np.arange(len(self.lengths)), self.lengths)
        own = {name: jnp.stack([values[n] for n in self.names_of(name)])[which] for name in self.rows.by_manoeuvre}
        return {name: channels[name] for name in self.inputs} | own | {ONE: jnp.ones_like(channels["dt"])}

    def delays(self, outputs: Sequence[str]) -> Mapping[str, str]:
        return {output: parameter for output, parameter in self.rows.delays if output in outputs}

    def names_of(self, name: str) -> list[str]:
        """Parameters of a constant that differs between manoeuvres, in the order of these."""
        return [f"{name}_{k + 1}" for k in range(len(self.lengths))]


def linear_dynamics(card: Card, lengths: tuple[int, ...] = (1,)) -> LinearDynamics:
    """The linear system of a card, with its starting values, bounds and priors. `lengths` are the samples of the
    manoeuvres, for constants that differ between them."""
    if card.linear is None:
        raise InputError(f"card {card.name} has no section [linear]; add it, or use its [model]")
    units = channel_units(card)
    parameters = []
    for name in card.linear.parameters:
        unit, text = _meaning(name, card.linear, units)
        parameter = replace(Parameter(name, unit, 0.0, 0.0, text, FLAT), **_sign_or_limits(name, card.linear))
        change = card.changes.get(name)
        given = {} if change is None else {key: value for key, value in vars(change).items() if value is not None}
        try:
            parameters.append(parameter.changed(**given))
        except InputError as error:
            raise InputError(f"card {card.name}: {error}") from None
    named = tuple((name, units[name]) for name in card.linear.states)
    return LinearDynamics(card.linear, tuple(parameters), named, lengths)


def _sign_or_limits(name: str, rows: LinearCard) -> dict[str, Sign | Limits]:
    """The sign or the limits that a parameter has as its dimensionless counterpart."""
    for state, terms in zip(rows.states, rows.rates, strict=True):
        for term in terms:
            channel, half = PART_OF.get(term.channel, (term.channel, 1.0))
            if term.parameter == name and (state, channel) in ALIKE:
                like = CATALOGUE[ALIKE[state, channel]].parameters[0]
                side = 1 if half * term.factor > 0.0 else -1
                if like.sign is not None:
                    return {"sign": replace(like.sign, side=side * like.sign.side, channel=term.channel)}
                if like.limits is not None and side > 0:
                    return {"limits": like.limits}
    return {}


def _meaning(name: str, rows: LinearCard, units: Mapping[str, str]) -> tuple[str, str]:
    """Unit and description of a parameter, from its first term."""
    for output, parameter in rows.delays:
        if parameter == name:
            return "s", f"delay of recorded {output}"
    for index, (row, terms) in enumerate(rows.rows):
        for term in terms:
            if term.parameter == name:
                rate = index < len(rows.states)
                unit = f"({units[row]}){'/s' if rate else ''}/({units[term.channel]})"
                per = "constant part" if term.channel == ONE else f"per {term.channel}"
                unit = si_unit(unit.replace("/(1)", "").replace("(1)", "1")).replace("**", "^")
                return unit, f"{'rate of ' if rate else ''}{row}, {per}"
    raise KeyError(name)


# --- Delayed outputs of recorders, for a filter that has only the present state.


class LateOutputs(System):
    """A system with outputs delayed by `delays` (s): y(t - delay) to first order. The delay must be short against the
    motion: for a sinusoid of 1 rad/s and a delay of 0.1 s the error is 0.5 %."""

    plain: System
    delays: Mapping[str, Any]

    states: ClassVar[Any] = OfPlain()
    envelope: ClassVar[Any] = OfPlain()
    complete_start: ClassVar[Any] = OfPlain()
    noise_density: ClassVar[Any] = OfPlain()
    decay: ClassVar[Any] = OfPlain()
    start_covariance: ClassVar[Any] = OfPlain()

    @property
    def state_outputs(self) -> tuple[str, ...]:
        return tuple(name for name in self.plain.state_outputs if name not in self.delays)

    def motion(self, x: Float[Array, " s"], u: Row) -> tuple[Float[Array, " s"], dict[str, Any]]:
        rate, now = self.plain.motion(x, u)
        state = dict(zip(self.states, x, strict=True))

        def late(x):
            found = dict(zip(self.states, x, strict=True)) | self.plain.motion(x, u)[1]
            return {name: found[name] for name in self.delays}

        slope = jax.jvp(late, (x,), (rate,))[1]
        return rate, now | {n: (state | now)[n] - delay * slope[n] for n, delay in self.delays.items()}
