"""The flight path of recorded accelerations and rates: kinematics without aerodynamics.

States are the quantities that other sensors measure: airspeed, alpha, theta, and as far as recorded beta, phi, psi and
altitude; and gusts. Inputs are the accelerometers and gyros. Sensor errors are effects that correct the record. Source:
Klein and Morelli, *Aircraft System Identification*, 2006, ch. 10; Mulder et al. 1999, Prog. Aerosp. Sci. 35, 591
(flight-path reconstruction).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from bayes_aero.dynamics.aircraft import FLOW, InGusts
from bayes_aero.dynamics.flight import EffectDynamics, Values
from bayes_aero.dynamics.system import Row, System
from bayes_aero.effect import Stage
from bayes_aero.effects import CATALOGUE
from bayes_aero.flight.card import Card
from bayes_aero.flight.health.kinematics import dead_heading
from bayes_aero.model.model import Model
from bayes_aero.model.records import Flights
from bayes_aero.parameter import Parameter
from bayes_aero.physics import kinematics
from bayes_aero.physics.aircraft import NO_AIRCRAFT, Aircraft, Axis
from bayes_aero.physics.filters import differentiate_joined, smooth_joined

INERTIAL = frozenset(("ax", "ay", "az", "p", "q", "r"))
JUMP = 0.2  # rad from sample to sample: faster than any aircraft turns
FORCES = ("force_x", "force_y", "force_z")  # specific force at the centre of gravity


class FlightPath(InGusts):
    """Motion from accelerometers and gyros; `named` are its states without gusts."""

    named: tuple[str, ...] = eqx.field(static=True)

    @property
    def states(self) -> tuple[str, ...]:
        return (*self.named, *(d.state for d in self.model.disturbances))

    def flow_signals(self, x: Float[Array, " s"], u: Row) -> dict[str, Any]:
        s = dict(u) | dict(zip(self.states, x, strict=True))
        return s | self.model.inflow(self.values, s, self.aircraft)

    def motion(self, x: Float[Array, " s"], u: Row) -> tuple[Float[Array, " s"], dict[str, Any]]:
        state = dict(zip(self.states, x, strict=True))
        s, flow = dict(u) | state, self.flow_signals(x, u)
        force = (u["force_x"], u["force_y"], u["force_z"])
        rates = kinematics.motion_of_path(s, force)
        rates["psi"] = kinematics.euler_rates((s["p"], s["q"], s["r"]), s["phi"], s["theta"])[2]
        decay, _ = self.mean_gust_rates(state, flow)
        return jnp.stack([*(rates[name] for name in self.named), *decay]), state | {
            n: flow[n] for n in FLOW if n in state
        }


@dataclass(frozen=True)
class PathDynamics(EffectDynamics):
    """The flight path under a model of sensor errors and of gusts."""

    named: tuple[str, ...]
    lengths: tuple[int, ...]  # samples of the manoeuvres
    own: tuple[str, ...] = ()  # parameters with a value for each, of effects that act sample by sample

    @cached_property
    def free(self) -> tuple[Parameter, ...]:
        """Common parameters, then those of each manoeuvre."""
        several = len(self.lengths) > 1
        common = [p for p in self.model.free if not (several and p.name in self.own)]
        each = [p for p in self.model.free if several and p.name in self.own]
        by_manoeuvre = [replace(p, name=_name(p.name, k)) for p in each for k in range(len(self.lengths))]
        return (*common, *by_manoeuvre)

    @property
    def states(self) -> tuple[str, ...]:
        return FlightPath(self.model, {}, NO_AIRCRAFT, self.named).states

    @property
    def inputs(self) -> tuple[str, ...]:
        return ("ax", "az", "q")

    @property
    def outputs(self) -> tuple[str, ...]:
        return self.named

    def values(self, theta: Any) -> dict[str, Any]:
        """Values by name; a parameter of each manoeuvre as a value for each sample, (n,)."""
        found = dict(self.model.fixed) | {name: theta[i] for i, name in enumerate(self.names)}
        count = len(self.lengths)
        for name in (n for n in self.own if _name(n, 0) in found):
            sizes = jnp.stack([found.pop(_name(name, k)) for k in range(count)])
            found[name] = sizes[np.repeat(np.arange(count), self.lengths)]
        return found

    def system(self, values: Values, aircraft: Aircraft) -> System:
        kept = {n: values[n] for n in self.disturbance_parameters | {d.intensity for d in self.model.disturbances}}
        return FlightPath(self.model, kept, aircraft, self.named)

    def corrected(self, values: Values, channels: Mapping[str, Array], aircraft: Aircraft) -> Mapping[str, Array]:
        """Errors of accelerometers and gyros first: a vane away from the centre of gravity senses the true rates."""
        for part in self._in_order:
            channels = part.corrected(values, channels, aircraft)
        return channels

    @cached_property
    def _in_order(self) -> list[Model]:
        inertial = [e for e in self.model.effects if set(e.channels) <= INERTIAL]
        rest = [e for e in self.model.effects if e not in inertial]
        return [Model.of(part, axes=tuple(Axis)) for part in (inertial, rest)]

    def drives(self, values: Values, channels: Mapping[str, Array], flights: Flights) -> dict[str, Array]:  # noqa: ARG002
        """Specific force at the centre of gravity, rates, and prescribed quantities of the path."""
        true = kinematics.as_symmetric(channels)
        ends = [channels[name] for name in ("dt", "first", "last")]
        slope = lambda x: differentiate_joined(smooth_joined(x, *ends[1:]), *ends)  # noqa: E731
        p, q, r = (true[name] for name in kinematics.RATES)
        turning = kinematics.Rotation(p, q, r, *(slope(x) for x in (p, q, r)))
        arm = kinematics.lever_arm(turning, flights.aircraft.accelerometer)
        force = {n: true[a] - x for n, a, x in zip(FORCES, ("ax", "ay", "az"), arm, strict=True)}
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


def _name(parameter: str, manoeuvre: int) -> str:
    return f"{parameter}_{manoeuvre + 1}"


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
SHOWN_BY = dict.fromkeys(  # for errors of lateral sensors, the state that depends on them
    ("sideslip_vane_position", "sideslip_vane_height", "sideslip_scale", "sideslip_bias", "sideslip_delay",
     "accel_y_bias", "yaw_rate_bias"), "beta"
) | {"bank_angle_bias": "phi", "roll_rate_bias": "phi"}  # fmt: skip
MARKS = {"dt", "start", "first", "last", "elapsed"}


def path_dynamics(flights: Flights, card: Card) -> tuple[Flights, PathDynamics]:
    """The flights, their heading without jumps, and their flight path with the possible errors of their sensors.
    Effects of the card keep the card's parameters: `vane_position` fixed stays fixed."""
    states = path_states(flights)
    recorded = {*flights.recorded, *MARKS}
    shown = [name for name in (*COMMON, *OWN) if SHOWN_BY.get(name, states[0]) in states]
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
    own = tuple(p.name for name in OWN if name in chosen for p in CATALOGUE[name].parameters)
    if "psi" in states:
        turned = flights.channels | {"psi": jnp.asarray(heading(flights))}
        flights = replace(flights, channels=turned)
    return flights, PathDynamics(model, states, flights.lengths, own)
