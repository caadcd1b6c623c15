"""Dynamics of an aircraft model: states, inputs, outputs and sensor errors for any parameter values."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from bayes_aero.arrays import AnyArray, namespace
from bayes_aero.dynamics.aircraft import ANGLES, LATERAL, MIN_LAG, FlightPath, Longitudinal, RigidBody, held_states
from bayes_aero.dynamics.system import LinearSystem, System
from bayes_aero.effect import MARKS, Stage
from bayes_aero.effects import CATALOGUE
from bayes_aero.errors import InputError
from bayes_aero.flight.card import ONE, Card, LinearCard, channel_units
from bayes_aero.flight.channel import STANDARD_CHANNELS
from bayes_aero.flight.health.kinematics import dead_heading
from bayes_aero.model.model import Model, as_on_card
from bayes_aero.model.observations import response_scales
from bayes_aero.model.records import Flights
from bayes_aero.parameter import Parameter, Prior, Role
from bayes_aero.physics import kinematics
from bayes_aero.physics.aircraft import FORCES, NO_AIRCRAFT, RIGID, Aircraft, Axis, needed_channels
from bayes_aero.physics.filters import differentiate_joined, smooth_joined
from bayes_aero.units import si_unit

Values = Mapping[str, Any]
Channels = Mapping[str, AnyArray]
OUTPUTS = ("airspeed", "alpha", "theta", "q", "altitude", "ax", "az")
ON_REQUEST = ("p_dot", "q_dot", "r_dot")  # mostly differentiated rates, without information of their own
MAX_SUBSTEPS = 8  # integration steps a sample
DERIVED = ("alpha_dot", "q_dot", "X", "mach", "density")  # computed by the simulation
SIDE = ("p", "r", "beta", "phi")  # the lateral force follows from these where no accelerometer measures it
ENGINES = ("thrust", "thrust_left", "thrust_right")
PATH_FORCES = ("force_x", "force_y", "force_z")  # specific force at the centre of gravity


@dataclass(frozen=True, kw_only=True)
class Dynamics(ABC):
    """A parametrised system. Hashable and without arrays, so that it is static under `jax.jit`. A record without one
    of the `inputs` cannot be simulated; `outputs` are simulated and can be compared with the record. `biased` outputs
    have a constant error for each manoeuvre with these priors, estimated together with the initial states: parameters
    bias_output_number."""

    lengths: tuple[int, ...] = (1,)  # samples of the manoeuvres
    biased: tuple[tuple[str, Prior], ...] = ()
    unmeasured: ClassVar[tuple[str, ...]] = ()  # outputs without a sensor on which the noise of others may depend

    @property
    @abstractmethod
    def unbiased_parameters(self) -> tuple[Parameter, ...]: ...

    @property
    @abstractmethod
    def states(self) -> tuple[str, ...]: ...

    @property
    @abstractmethod
    def inputs(self) -> tuple[str, ...]: ...

    @property
    @abstractmethod
    def outputs(self) -> tuple[str, ...]: ...

    @abstractmethod
    def unbiased_values(self, theta: Any) -> dict[str, Any]:
        """Parameter values by name without the biases, from the vector of the free ones."""

    @abstractmethod
    def system(self, values: Values, aircraft: Aircraft) -> System:
        """The system at these parameter values."""

    @abstractmethod
    def drives(self, values: Values, channels: Channels, flights: Flights) -> dict[str, AnyArray]:
        """Inputs of the simulation from the corrected channels, manoeuvres end to end."""

    @property
    def disturbance_parameters(self) -> frozenset[str]:
        """Names of the free parameters that belong to disturbances."""
        return frozenset()

    @property
    def start(self) -> tuple[str, ...]:
        """Channels that give the initial state of a manoeuvre; see `System.start`."""
        return self.states

    @property
    def units(self) -> Mapping[str, str]:
        """SI units of states that are channels of the card; the units of standard channels are known."""
        return {}

    @cached_property
    def free(self) -> tuple[Parameter, ...]:
        """The free parameters, in the order of every parameter vector."""
        unit = lambda output: STANDARD_CHANNELS[output].unit if output in STANDARD_CHANNELS else "SI"  # noqa: E731
        biases = [
            Parameter(name, unit(output), 0.0, 0.0, f"bias of recorded {output}, manoeuvre {k + 1}", prior)
            for output, prior in self.biased
            for k, name in enumerate(of_each(f"bias_{output}", len(self.lengths)))
        ]
        return (*self.unbiased_parameters, *biases)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the free parameters."""
        return tuple(p.name for p in self.free)

    def values(self, theta: Any) -> dict[str, Any]:
        """All parameter values by name, from the vector of the free ones."""
        k = len(self.unbiased_parameters)
        return self.unbiased_values(theta[:k]) | {name: theta[i] for i, name in enumerate(self.names) if i >= k}

    def corrected(self, values: Values, channels: Channels, aircraft: Aircraft) -> Channels:  # noqa: ARG002
        """The record corrected for biases and the model's sensor errors; it gives the measured initial state, too."""
        biases = {n: along_each(values, f"bias_{n}", self.lengths) for n, _ in self.biased}
        return {**channels, **{n: channels[n] - bias for n, bias in biases.items()}} if biases else channels

    def scales(self, values: Values, flights: Flights) -> Channels:  # noqa: ARG002
        """Derivatives of the corrected outputs by the recorded ones."""
        return {}

    def delays(self, outputs: Sequence[str]) -> Mapping[str, str]:  # noqa: ARG002
        """Parameters that delay these outputs, by output."""
        return {}

    def substeps(self, theta: Any, flights: Flights) -> int:
        """Integration steps a sample that follow the system's fast states, at most `MAX_SUBSTEPS`."""
        return self.substeps_at(self.values(np.asarray(theta)), flights)

    def substeps_at(self, values: Values, flights: Flights) -> int:
        """The same at these values, without compiled programs."""
        step = self.slowest_step(values, flights)
        return int(np.clip(np.ceil(float(np.max(flights.channels["dt"])) / step), 1, MAX_SUBSTEPS))

    def slowest_step(self, values: Values, flights: Flights) -> float:  # noqa: ARG002
        """Longest integration step in s that follows the system's fast states."""
        return np.inf


def of_each(name: str, manoeuvres: int) -> list[str]:
    """Names of a parameter that has a value for each manoeuvre, in their order."""
    return [f"{name}_{k + 1}" for k in range(manoeuvres)]


def along_each(values: Values, name: str, lengths: Sequence[int]) -> AnyArray:
    """The values of such a parameter at every sample of manoeuvres of these lengths, (n,)."""
    sizes = [values[n] for n in of_each(name, len(lengths))]
    return namespace(*sizes).stack(sizes)[np.repeat(np.arange(len(lengths)), lengths)]


def biased_dynamics(dynamics: Dynamics, flights: Flights, priors: Mapping[str, Prior]) -> Dynamics:
    """The dynamics with a bias of each named output for each manoeuvre, with these priors (SI)."""
    for name in priors:
        if name not in dynamics.outputs or name not in flights.channels:
            possible = ", ".join(n for n in dynamics.outputs if n in flights.channels)
            raise InputError(
                f"{name} cannot have a bias: it was not recorded or is not simulated; there are {possible}"
            )
    return replace(dynamics, biased=tuple(priors.items()), lengths=flights.lengths) if priors else dynamics


def unbiased(dynamics: Dynamics) -> Dynamics:
    """The dynamics without the biases of outputs."""
    return replace(dynamics, biased=())


@dataclass(frozen=True)
class EffectDynamics(Dynamics):
    """Dynamics of a model of effects: sensor errors are corrected in the record, gusts are disturbances."""

    model: Model

    @property
    def meets_gusts(self) -> bool:
        return True

    def for_filter(self) -> EffectDynamics:
        return self

    @property
    def disturbance_parameters(self) -> frozenset[str]:
        return frozenset(p.name for e in self.model.acting if e.disturbance is not None for p in e.parameters)

    def corrected(self, values: Values, channels: Channels, aircraft: Aircraft) -> Channels:
        return self.model.corrected(values, super().corrected(values, channels, aircraft), aircraft)

    def scales(self, values: Values, flights: Flights) -> Channels:
        if not any(e.stage is Stage.CHANNEL for e in self.model.acting):
            return {}
        return response_scales(self.model, values, flights.channels, flights.aircraft, self.outputs)

    def delays(self, outputs: Sequence[str]) -> Mapping[str, str]:
        late = [(e.channels[0], p) for e in self.model.acting for p in e.parameters if p.role is Role.DELAY]
        return {channel: p.name for channel, p in late if channel in outputs}


def _slope(flights: Flights) -> Callable[[Array], Array]:
    """Time derivative of a channel of these flights, smoothed."""
    ends = [flights.channels[name] for name in ("dt", "first", "last")]
    return lambda x: differentiate_joined(smooth_joined(x, *ends[1:]), *ends)


def _at_centre(channels: Channels, flights: Flights) -> list[Array]:
    """How the accelerometers differ from the specific force at the centre of gravity, by their place; (n,) an axis."""
    rates = [channels[name] for name in kinematics.RATES]
    turning = kinematics.Rotation(*rates, *map(_slope(flights), rates))
    return list(kinematics.lever_arm(turning, flights.aircraft.accelerometer))


@dataclass(frozen=True)
class AircraftDynamics(EffectDynamics):
    """An aircraft under a model of effects: six degrees of freedom with the lateral axis, three without."""

    altitude: bool = True  # whether it is a state
    further: tuple[str, ...] = ()  # outputs of `ON_REQUEST`
    held: tuple[str, ...] = ()  # states that are prescribed, too
    heading: bool = False  # see `RigidBody`
    euler: bool = False
    unmeasured = ("X",)

    @property
    def unbiased_parameters(self) -> tuple[Parameter, ...]:
        return self.model.free

    def unbiased_values(self, theta: Any) -> dict[str, Any]:
        return self.model.values(theta)

    @property
    def rigid(self) -> bool:
        return bool(self.held) or Axis.LATERAL in self.model.axes

    @cached_property
    def _pattern(self) -> RigidBody:
        return self.system({}, NO_AIRCRAFT)

    @property
    def states(self) -> tuple[str, ...]:
        return self._pattern.states

    @property
    def start(self) -> tuple[str, ...]:
        return self._pattern.start

    @cached_property
    def prescribed(self) -> tuple[str, ...]:
        return held_states(self.model.axes, self.held) if self.rigid else ()

    @property
    def meets_gusts(self) -> bool:
        return not {"airspeed", "alpha"} & set(self.prescribed)

    def for_filter(self) -> AircraftDynamics:
        return replace(self, euler=self.rigid)

    @property
    def inputs(self) -> tuple[str, ...]:
        """Channels that the effects read and the simulation does not compute, and held states of a rigid body."""
        made = {*self.start, *DERIVED, *LATERAL, "dt", "start", "elapsed", "first", "last"}
        read = (c for e in self.model.acting if e.stage > Stage.INFLOW for c in e.channels if c not in made)
        return tuple(dict.fromkeys((*read, *self.prescribed)))

    @property
    def outputs(self) -> tuple[str, ...]:
        if not self.rigid:
            return (*(name for name in OUTPUTS if name != "altitude" or self.altitude), *self.further)
        simulated = (n for n in (*RIGID, *ANGLES, "altitude") if n in self.start)
        forces = {name for axis in self.model.axes for name in FORCES[axis]}
        return (*simulated, *(n for n in ("ax", "ay", "az") if n in forces), *self.further)

    def system(self, values: Values, aircraft: Aircraft) -> RigidBody:
        actual = self.model.actual_aircraft(values, aircraft) if values else aircraft
        if not self.rigid:
            return Longitudinal(self.model, dict(values), actual, self.altitude)
        return RigidBody(self.model, dict(values), actual, self.altitude, self.prescribed, self.heading, self.euler)

    def drives(self, values: Values, channels: Channels, flights: Flights) -> dict[str, AnyArray]:  # noqa: ARG002
        """What effects read, held states with their rates, forces of axes without a model; without `ay` the rate of
        sideslip, which gives the lateral force."""
        held, read = (self.prescribed, ENGINES) if self.rigid else ((*LATERAL, "psi"), (*LATERAL, "thrust"))
        slope, axes = _slope(flights), self.model.axes
        drives = {name: channels[name] for name in (*self.inputs, *read, "density") if name in channels}
        drives |= {f"{n}_dot": slope(channels[n]) for n in (*kinematics.RATES, "alpha") if n in held and n in channels}
        if Axis.LONGITUDINAL not in axes:
            arm = _at_centre(channels, flights)
            drives |= {"force_x": channels["ax"] - arm[0], "force_z": channels["az"] - arm[2]}
        if Axis.LATERAL not in axes:
            drives |= {"ay": channels["ay"]} if "ay" in channels else {}
            if "ay" not in channels and all(name in channels for name in SIDE):
                drives["beta_dot"] = slope(channels["beta"])
        if {"mach", "airspeed"} <= set(channels):
            drives["sound"] = channels["airspeed"] / channels["mach"]
        return drives | {f"near_{n}": channels[n] for n in ("phi", "psi") if n in channels and n not in held}

    def slowest_step(self, values: Values, flights: Flights) -> float:
        """Half the time constant of the separation point's lag at the highest airspeed."""
        if not self._pattern.lagged:
            return np.inf
        lag = max(float(self.model.lag(values)), MIN_LAG)
        return 0.5 * lag * float(flights.aircraft.chord) / float(flights.channels["airspeed"].max())


def aircraft_dynamics(
    model: Model, flights: Flights, outputs: Sequence[str] = (), held: Sequence[str] | None = None
) -> AircraftDynamics:
    """The dynamics of a model for these flights, with `outputs` of `ON_REQUEST`; `held`: default, by the card."""
    held = flights.held if held is None else tuple(held)
    prescribed = held_states(model.axes, held)
    rigid = bool(held) or Axis.LATERAL in model.axes
    turning = [n for n in ON_REQUEST if n.removesuffix("_dot") not in prescribed] if rigid else ["q_dot"]
    further = tuple(n for n in turning if n in outputs)
    altitude, heading = (n in flights.channels and not (rigid and n in prescribed) for n in ("altitude", "psi"))
    dynamics = AircraftDynamics(model, altitude, further, held, heading and rigid)
    have = {*flights.channels, "alpha_dot", "X", *(f"{n}_dot" for n in ("p", "r") if n in flights.channels)}
    have |= {"density", "mach"} if "altitude" in have else set()
    read = [c for e in model.acting if e.disturbance is None for c in e.channels]
    missing = [name for name in (*needed_channels(model.axes), *read) if name not in have]
    if missing:
        other = ", or altitude" if missing[0] in ("density", "mach") else ""
        raise InputError(
            f"record {flights.names[0]} has no channel {missing[0]}{other}, without which the aircraft cannot be "
            "flown; map it on the card, or give its value under [constants]"
        )
    if model.disturbances and {"airspeed", "alpha"} & set(prescribed if rigid else ()):
        raise InputError("airspeed and alpha cannot be held to the record in gusts; leave one of the two out")
    for effect in model.acting:
        if effect.stage is Stage.LAG and not any(p.role is Role.LAG for p in effect.parameters):
            raise InputError(
                f"effect {effect.name} is a lag of the separation point that cannot be flown: none of its parameters "
                "has the role lag"
            )
    return dynamics


def taken_as_zero(flights: Flights) -> list[str]:
    """Lateral channels that were not recorded and are taken as zero in the simulation."""
    missing = [name for name in SIDE if name not in flights.channels]
    slips = "beta" in flights.channels  # without sideslip no lateral force enters the longitudinal motion
    return [*missing, "ay"] if missing and slips and "ay" not in flights.channels else missing


# --- The flight path of recorded accelerations and rates: kinematics without aerodynamics.
# States are what other sensors measure: airspeed, alpha, theta, as far as recorded beta, phi, psi, altitude; and gusts.
# Inputs are the accelerometers and gyros. Sensor errors are effects that correct the record. Source: Klein and Morelli,
# *Aircraft System Identification*, 2006, ch. 10; Mulder et al. 1999, Prog. Aerosp. Sci. 35, 591.

INERTIAL = frozenset(("ax", "ay", "az", "p", "q", "r"))
JUMP = 0.2  # rad from sample to sample: faster than any aircraft turns


@dataclass(frozen=True)
class PathDynamics(EffectDynamics):
    """The flight path under a model of sensor errors and of gusts."""

    named: tuple[str, ...]
    own: tuple[str, ...] = ()  # parameters with a value for each manoeuvre, of effects that act sample by sample

    @cached_property
    def unbiased_parameters(self) -> tuple[Parameter, ...]:
        own = self.own if len(self.lengths) > 1 else ()
        each = [p for p in self.model.free if p.name in own]
        by_manoeuvre = [replace(p, name=name) for p in each for name in of_each(p.name, len(self.lengths))]
        return (*(p for p in self.model.free if p.name not in own), *by_manoeuvre)

    def unbiased_values(self, theta: Any) -> dict[str, Any]:
        values = dict(self.model.fixed) | {p.name: theta[i] for i, p in enumerate(self.unbiased_parameters)}
        return values | {n: along_each(values, n, self.lengths) for n in self.own if f"{n}_1" in values}

    @property
    def states(self) -> tuple[str, ...]:
        return FlightPath(self.model, {}, NO_AIRCRAFT, self.named).states

    @property
    def inputs(self) -> tuple[str, ...]:
        return ("ax", "az", "q")

    @property
    def outputs(self) -> tuple[str, ...]:
        return self.named

    def system(self, values: Values, aircraft: Aircraft) -> System:
        kept = {n: values[n] for n in self.disturbance_parameters | {d.intensity for d in self.model.disturbances}}
        return FlightPath(self.model, kept, aircraft, self.named)

    def corrected(self, values: Values, channels: Channels, aircraft: Aircraft) -> Channels:
        """Errors of accelerometers and gyros first: a vane away from the centre of gravity senses the true rates."""
        channels = Dynamics.corrected(self, values, channels, aircraft)
        for part in self._in_order:
            channels = part.corrected(values, channels, aircraft)
        return channels

    @cached_property
    def _in_order(self) -> list[Model]:
        inertial = [e for e in self.model.effects if set(e.channels) <= INERTIAL]
        rest = [e for e in self.model.effects if e not in inertial]
        return [Model.of(part, axes=tuple(Axis)) for part in (inertial, rest)]

    def drives(self, values: Values, channels: Channels, flights: Flights) -> dict[str, AnyArray]:  # noqa: ARG002
        """Specific force at the centre of gravity, rates, and prescribed quantities of the path."""
        true = kinematics.as_symmetric(channels)
        arm = _at_centre(true, flights)
        force = {n: true[a] - x for n, a, x in zip(PATH_FORCES, ("ax", "ay", "az"), arm, strict=True)}
        made = {*self.named, "ay", *kinematics.RATES}
        given = (*kinematics.RATES, *(name for name in kinematics.STRAIGHT if name not in made))
        return force | {name: true[name] for name in given}


def path_states(flights: Flights) -> tuple[str, ...]:
    """Recorded quantities of the flight path; none where it cannot be integrated."""
    outputs = kinematics.path_outputs({name: np.asarray(x) for name, x in flights.channels.items()})
    return (*outputs, *(("psi",) if "phi" in outputs and heading(flights) is not None else ()))


def heading(flights: Flights) -> Float[np.ndarray, " n"] | None:
    """The heading without jumps of a half or full turn; None where not recorded, jumping, or at rest in a turn."""
    if "psi" not in flights.channels:
        return None
    ends = np.cumsum(flights.lengths)[:-1]
    turned = [np.unwrap(part, period=np.pi) for part in np.split(np.asarray(flights.channels["psi"]), ends)]
    if any(np.max(np.abs(np.diff(part))) > JUMP for part in turned):
        return None
    if {"phi", "theta", "q", "r"} <= set(flights.channels):
        seen = {"time": flights.time} | {name: flights.channels[name] for name in ("phi", "theta", "q", "r")}
        views = zip(*(np.split(np.asarray(x), ends) for x in seen.values()), turned, strict=True)
        if any(dead_heading(dict(zip((*seen, "psi"), view, strict=True))) for view in views):
            return None
    return np.concatenate(turned)


# --- Sensor errors that a flight-path reconstruction estimates: those of the catalogue that the recorded channels
# show.

COMMON = (  # errors of an installation, equal in all manoeuvres
    "vane_position", "alpha_scale", "alpha_bias", "alpha_delay", "sideslip_vane_position", "sideslip_vane_height",
    "sideslip_scale", "sideslip_bias", "sideslip_delay", "airspeed_scale", "airspeed_bias", "pitot_pressure_bias",
    "pitch_attitude_bias", "bank_angle_bias",
)  # fmt: skip
OWN = (  # errors that drift from one manoeuvre to the next, and the wind
    "accel_x_bias", "accel_y_bias", "accel_z_bias", "roll_rate_bias", "pitch_rate_bias", "yaw_rate_bias",
    "vertical_wind",
)  # fmt: skip
SHOWN_BY = {"beta": "beta", "ay": "beta", "r": "beta", "phi": "phi", "p": "phi"}  # state that shows errors of a channel


def path_dynamics(flights: Flights, card: Card) -> tuple[Flights, PathDynamics]:
    """The flights, their heading without jumps, and their flight path with the possible errors of their sensors."""
    states, recorded = path_states(flights), {*flights.recorded, *MARKS}
    shown = [name for name in (*COMMON, *OWN) if SHOWN_BY.get(CATALOGUE[name].channels[0], states[0]) in states]
    chosen = [name for name in shown if set(CATALOGUE[name].channels) <= recorded]
    model = Model.of(chosen, axes=tuple(Axis))  # the path depends on all axes
    if card.linear is None:
        stated = Model.from_card(card)
        errors = [e for e in stated.effects if e.stage is Stage.CHANNEL]
        names = {p.name for e in errors for p in e.parameters}
        stated_parameters = {p.name: p for p in stated.parameters if p.name in names}
        fixed = {name: value for name, value in stated.fixed if name in names}
        model = Model.of((*errors, *(e for e in model.effects if e not in errors)), fixed, model.axes)
        model = replace(model, parameters=tuple(stated_parameters.get(p.name, p) for p in model.parameters))
    of_sensors = tuple(p.name for name in OWN if name in chosen for p in CATALOGUE[name].parameters)
    if "psi" in states:
        turned = flights.channels | {"psi": np.asarray(heading(flights))}
        flights = replace(flights, channels=turned)
    return flights, PathDynamics(model, states, of_sensors, lengths=flights.lengths)


# --- Linear state-space models in dimensional derivatives: short period, lateral motion, or any other rows of a card.
# Channels are total values, not deviations from trim, so each row has a constant where it needs one.

FLAT_SD = 1000.0  # SI: larger than any derivative of an aircraft, also az per alpha of a fighter
ALIKE = {  # the effect whose sign and limits a derivative of a rate has: inertia and dynamic pressure are positive
    ("p", "aileron"): "aileron_roll", ("p", "p"): "roll_damping", ("p", "beta"): "sideslip_roll",
    ("q", "elevator"): "elevator_moment", ("q", "q"): "pitch_damping",
    ("r", "rudder"): "rudder_yaw", ("r", "r"): "yaw_damping", ("r", "beta"): "sideslip_yaw",
}  # fmt: skip
PART_OF = {"aileron_right": ("aileron", 1.0), "aileron_left": ("aileron", -1.0)}
"""Half of right less left is the aileron."""
FLAT = Prior("normal", 0.0, FLAT_SD, "flat in effect; our choice")


@dataclass(frozen=True)
class LinearDynamics(Dynamics):
    """A card's linear rows with their parameters; `fixed` parameters keep their value, the others are free. A constant
    that differs between manoeuvres has a parameter for each of them and is an input of the system."""

    rows: LinearCard
    parameters: tuple[Parameter, ...]
    named: tuple[tuple[str, str], ...] = ()

    @property
    def units(self) -> Mapping[str, str]:
        return dict(self.named)

    @property
    def fixed(self) -> dict[str, float]:
        return dict(self.rows.fixed)

    @cached_property
    def unbiased_parameters(self) -> tuple[Parameter, ...]:
        free = [p for p in self.parameters if p.name not in self.fixed]
        many = {name: self.names_of(name) for name in self.rows.by_manoeuvre}
        return tuple(replace(p, name=name) for p in free for name in many.get(p.name, [p.name]))

    def unbiased_values(self, theta: Any) -> dict[str, Any]:
        return self.fixed | {p.name: theta[i] for i, p in enumerate(self.unbiased_parameters)}

    @property
    def flat(self) -> tuple[str, ...]:
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

    def system(self, values: Values, aircraft: Aircraft) -> LinearSystem:  # noqa: ARG002
        constants = self.rows.by_manoeuvre
        columns = (*self.states, *self.inputs, *constants, ONE)
        terms = [(i, t) for i, (_, row) in enumerate(self.rows.rows) for t in row]
        across = [columns.index(t.parameter if t.parameter in constants else t.channel) for _, t in terms]
        values = {**values, **dict.fromkeys(constants, 1.0)}
        sizes = [t.factor * values[t.parameter] for _, t in terms]
        placed = np.zeros((len(terms), len(self.rows.rows), len(columns)))
        placed[np.arange(len(terms)), [i for i, _ in terms], across] = 1.0
        lib = namespace(*sizes)
        matrix = jax.device_put(lib.tensordot(lib.stack(sizes), placed, 1))
        return LinearSystem(matrix, self.states, columns[len(self.states) : -1], self.rows.outputs)

    def drives(self, values: Values, channels: Channels, flights: Flights) -> dict[str, AnyArray]:  # noqa: ARG002
        """Recorded inputs, and a constant, which gives the number of samples where there are no inputs."""
        constants = {name: along_each(values, name, self.lengths) for name in self.rows.by_manoeuvre}
        return {name: channels[name] for name in self.inputs} | constants | {ONE: jnp.ones_like(channels["dt"])}

    def delays(self, outputs: Sequence[str]) -> Mapping[str, str]:
        return {output: parameter for output, parameter in self.rows.delays if output in outputs}

    def names_of(self, name: str) -> list[str]:
        return of_each(name, len(self.lengths))


def linear_dynamics(card: Card, lengths: tuple[int, ...] = (1,)) -> LinearDynamics:
    """The linear system of a card, with its starting values, bounds and priors. `lengths` are the samples of the
    manoeuvres, for constants that differ between them."""
    rows, units = card.linear, channel_units(card)
    if rows is None:
        raise InputError(f"card {card.name} has no section [linear]; add it, or use its [model]")
    stated = {name: Parameter(name, "s", 0.0, 0.0, f"delay of recorded {output}", FLAT) for output, name in rows.delays}
    for index, (row, terms) in enumerate(rows.rows):
        rate = index < len(rows.states)
        for term in terms:
            per = "constant part" if term.channel == ONE else f"per {term.channel}"
            unit = f"({units[row]}){'/s' if rate else ''}/({units[term.channel]})"
            unit = si_unit(unit.replace("/(1)", "").replace("(1)", "1")).replace("**", "^")
            new = Parameter(term.parameter, unit, 0.0, 0.0, f"{'rate of ' if rate else ''}{row}, {per}", FLAT)
            parameter = stated.setdefault(term.parameter, new)
            channel, half = PART_OF.get(term.channel, (term.channel, 1.0))
            if rate and (row, channel) in ALIKE and parameter.sign is None and parameter.limits is None:
                like = CATALOGUE[ALIKE[row, channel]].parameters[0]
                side = 1 if half * term.factor > 0.0 else -1
                if like.sign is not None:
                    sign = replace(like.sign, side=side * like.sign.side, channel=term.channel)
                    stated[term.parameter] = replace(parameter, sign=sign)
                elif side > 0:
                    stated[term.parameter] = replace(parameter, limits=like.limits)
    named = tuple((name, units[name]) for name in rows.states)
    parameters = tuple(as_on_card(stated[name], card) for name in rows.parameters)
    return LinearDynamics(rows, parameters, named, lengths=lengths)
