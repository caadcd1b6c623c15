"""Linear state-space models in dimensional derivatives: short period, lateral motion, or any other rows of a card.

Channels are total values, not deviations from trim, so each row has a constant where it needs one.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from bayes_aero.dynamics.aircraft import HELD, RigidBody
from bayes_aero.dynamics.flight import AircraftDynamics, Dynamics, Values
from bayes_aero.dynamics.system import OfPlain, Row, System
from bayes_aero.dynamics.trim import CONTROLS, SURFACES, Condition, rigid_trim
from bayes_aero.effects import CATALOGUE
from bayes_aero.errors import InputError
from bayes_aero.flight.card import Card, channel_units
from bayes_aero.flight.card_tables import ONE, LinearCard
from bayes_aero.model.records import Flights
from bayes_aero.parameter import Limits, Parameter, Prior, Sign
from bayes_aero.physics.aircraft import GRAVITY, Aircraft, Axis
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


# --- Modes of motion about steady flight with fixed controls: eigenvalues of the linearised equations of motion.
# Source: Etkin and Reid, *Dynamics of Flight*, 3rd ed. 1996, ch. 6.

LATERAL = ("beta", "p", "r", "phi")
SPEEDS, HEAVES = ("airspeed", "u"), ("alpha", "w")  # u and w of cards with velocities in body axes, m/s
LONGITUDINAL = (*SPEEDS, *HEAVES, "q", "theta")
WITHOUT_FORCE = ("psi", "altitude")  # no force depends on psi, and hardly any on altitude

SHORT_PERIOD, PHUGOID, DUTCH_ROLL, ROLL, SPIRAL, OTHER = (
    "short period", "phugoid", "Dutch roll", "roll", "spiral", "other",
)  # fmt: skip


@dataclass(frozen=True)
class MotionMode:
    """A mode by name, with its eigenvalue (1/s), the one of positive imaginary part of a pair."""

    name: str
    eigenvalue: complex


@dataclass(frozen=True)
class Steady:
    """Straight level flight about which motion is linearised: airspeed m/s, altitude m, alpha rad. Alpha is used for
    cards without the longitudinal axis, which have no trim."""

    airspeed: float
    altitude: float
    alpha: float = 0.0


def modes(dynamics: Dynamics, values: Mapping[str, Any], aircraft: Aircraft, steady: Steady) -> tuple[MotionMode, ...]:
    """Modes of motion about steady flight with fixed controls, longitudinal ones first, the faster ones first.
    `aircraft` is that of the card; `steady` has no effect on a linear system."""
    if isinstance(dynamics, LinearDynamics):
        system, states = dynamics.system(values, aircraft), dynamics.states
        u = {name: jnp.zeros(()) for name in (*dynamics.inputs, *dynamics.rows.by_manoeuvre)}
        A = jax.jacfwd(lambda x: system.motion(x, u)[0])(jnp.zeros(len(states)))
        return named_modes(np.asarray(A), states, steady.airspeed)
    if not isinstance(dynamics, AircraftDynamics):
        raise InputError("a flight path of recorded accelerations has no modes of motion; fly a model of the aircraft")
    held = set(dynamics.held) - {"altitude", "psi"}
    if held:
        raise InputError(f"the card holds {', '.join(sorted(held))} to the record; leave [fly] held out for modes")
    model, axes = dynamics.model, set(dynamics.model.axes)
    values = {name: jnp.asarray(x, float) for name, x in values.items()}
    actual = model.actual_aircraft(values, aircraft)
    own = HELD[Axis.LONGITUDINAL] if Axis.LONGITUDINAL not in axes else ()
    wider = model if own else replace(model, axes=tuple(Axis))
    u = dict.fromkeys((*CONTROLS, "aileron", "rudder", *SURFACES), 0.0)
    if own:  # prescribed as in level flight
        x, alpha = {}, steady.alpha
        u |= dict.fromkeys(("q", "alpha_dot", "p_dot", "q_dot", "r_dot", "thrust", "thrust_left", "thrust_right"), 0.0)
        u |= {"airspeed": steady.airspeed, "alpha": alpha, "theta": alpha, "altitude": steady.altitude}
        u |= {"force_x": GRAVITY * math.sin(alpha), "force_z": -GRAVITY * math.cos(alpha)}
    else:
        trim = rigid_trim(wider, values, actual, Condition(steady.airspeed, steady.altitude))
        x, half = trim.state, 0.5 * trim.thrust
        u |= {n: trim.controls[n] for n in u if n in trim.controls} | {"altitude": trim.state["altitude"]}
        u |= {"thrust": trim.thrust, "thrust_left": half, "thrust_right": half}
    # arrays: one program for every trim
    x, u = ({name: jnp.asarray(value, float) for name, value in given.items()} for given in (x, u))
    body = RigidBody(wider, values, actual, altitude=False, held=own, heading=False, euler=True)
    gusts = {d.state for d in wider.disturbances}
    states = tuple(n for n in body.start if n not in gusts)
    A = _linearised(body, states, x, u)
    kept = [k for k, n in enumerate(states) if Axis.LATERAL in axes or n not in LATERAL]
    return named_modes(np.asarray(A)[np.ix_(kept, kept)], [states[k] for k in kept], steady.airspeed)


def named_modes(A: Float[np.ndarray, "s s"], states: Sequence[str], airspeed: float) -> tuple[MotionMode, ...]:
    """Eigenvalues of the derivative `A` of the rates of `states` by them, SI, by the names of the modes. Velocities are
    scaled to angles by the airspeed, m/s. A mode whose motion no name fits is called "other"."""
    if not np.all(np.isfinite(A)):
        raise InputError("the equations of motion are not finite about steady flight; check the card's constants")
    kept = [k for k, n in enumerate(states) if n not in WITHOUT_FORCE]
    own = [states[k] for k in kept]
    eigenvalues, vectors = np.linalg.eig(np.asarray(A, float)[np.ix_(kept, kept)])
    scale = np.array([1.0 / airspeed if n in ("airspeed", "u", "w") else 1.0 for n in own])
    named = []
    for value, vector in zip(eigenvalues, vectors.T, strict=True):
        if value.imag >= 0.0:
            named.append((complex(value), dict(zip(own, np.abs(vector) * scale, strict=True))))
    named.sort(key=lambda pair: -abs(pair[0]))
    lateral = [one for one in named if _share(one[1], LATERAL) > 0.5]
    rest = [one for one in named if _share(one[1], LATERAL) <= 0.5]
    return (*_longitudinal(rest), *_lateral(lateral, own))


Eigenmotions = list[tuple[complex, dict[str, float]]]


def _share(motion: Mapping[str, float], names: Sequence[str]) -> float:
    """Share of `names` in the squared motion."""
    return sum(motion.get(n, 0.0) ** 2 for n in names) / sum(x**2 for x in motion.values())


def _longitudinal(found: Eigenmotions) -> list[MotionMode]:
    """The faster oscillation is the short period, the slower one the phugoid. A single one is the short period if alpha
    varies more than speed."""
    oscillations = [k for k, (value, _) in enumerate(found) if value.imag > 0.0]
    both = dict(zip(oscillations, (SHORT_PERIOD, PHUGOID), strict=False)) if len(oscillations) > 1 else {}
    named = []
    for k, (value, motion) in enumerate(found):
        name = SHORT_PERIOD if _share(motion, HEAVES) >= _share(motion, SPEEDS) else PHUGOID
        longitudinal = _share(motion, LONGITUDINAL) > 0.5
        aperiodic = "" if value.imag > 0.0 else ", aperiodic"
        named.append(MotionMode(both.get(k, f"{name}{aperiodic}" if longitudinal else OTHER), value))
    return named


def _lateral(found: Eigenmotions, states: Sequence[str]) -> list[MotionMode]:
    """The oscillation with most sideslip is the Dutch roll; the fastest aperiodic mode is the roll mode. Without
    sideslip there is neither a Dutch roll nor a spiral, without bank no spiral."""
    oscillations = sorted((one for one in found if one[0].imag > 0.0), key=lambda one: -_share(one[1], ("beta",)))
    aperiodic = [one for one in found if one[0].imag == 0.0]
    names = (DUTCH_ROLL, "lateral phugoid") if "beta" in states else ()
    named = [MotionMode(names[k] if k < len(names) else OTHER, value) for k, (value, _) in enumerate(oscillations)]
    first = min(aperiodic, key=lambda one: -_share(one[1], ("p",))) if "beta" not in states and aperiodic else None
    roll = first or (aperiodic[0] if aperiodic else None)
    spiral = aperiodic[-1] if {"beta", "phi"} <= set(states) and len(aperiodic) > 1 else None
    for one in aperiodic:
        name = ROLL if one is roll and "p" in states else SPIRAL if one is spiral else OTHER
        named.append(MotionMode(name, one[0]))
    return named


@eqx.filter_jit
def _linearised(
    body: RigidBody, moving: tuple[str, ...], x: Mapping[str, Any], u: Mapping[str, Any]
) -> Float[Array, "s s"]:
    """Derivative of the rates of the `moving` states by them, altitude and controls held."""
    start = body.complete_start(jnp.stack([jnp.asarray(x.get(name, 0.0), float) for name in body.start]), dict(u))
    places = jnp.array([body.start.index(n) for n in moving])

    def rates(part):
        return body.motion(body.state_at_start(start.at[places].set(part)), dict(u))[0][places]

    return jax.jacfwd(rates)(start[places])
