"""What is flown and how it is measured, for any parameter values: the bridge from a model to its trajectories."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from bayes_aero.dynamics.longitudinal import LATERAL, LEAST_LAG, Longitudinal
from bayes_aero.dynamics.output_channels import FLIGHT
from bayes_aero.dynamics.system import System
from bayes_aero.effect import Stage
from bayes_aero.errors import InputError
from bayes_aero.flight.aircraft import NO_AIRCRAFT, Aircraft
from bayes_aero.model.joined_channels import Flights, response_scales
from bayes_aero.model.joined_records import Recorded
from bayes_aero.model.model import Model
from bayes_aero.parameter import Parameter, Role
from bayes_aero.physics.filters import differentiate, smooth

Values = Mapping[str, Any]
OUTPUTS = ("airspeed", "alpha", "theta", "q", "altitude", "ax", "az")
ON_REQUEST = ("q_dot",)  # mostly differentiated pitch rate, which says nothing new
FINEST = 8  # integration steps a sample
SIDE = ("p", "r", "beta", "phi")  # of these the lateral force follows where no accelerometer gives it
DERIVED = ("alpha_dot", "q_dot", "X", "mach", "density")  # the simulation makes them itself


class Dynamics(ABC):
    """A parametrised system. Hashable and without arrays, so that it is static under `jax.jit`."""

    @property
    @abstractmethod
    def free(self) -> tuple[Parameter, ...]:
        """The free parameters, in the order of every parameter vector."""

    @property
    def of_disturbances(self) -> frozenset[str]:
        """Names of the free parameters that belong to disturbances."""
        return frozenset()

    @property
    @abstractmethod
    def states(self) -> tuple[str, ...]:
        """Names of the states."""

    @property
    def units(self) -> Mapping[str, str]:
        """SI units of states that are channels of the card's own; the program knows those of the others."""
        return {}

    @property
    @abstractmethod
    def inputs(self) -> tuple[str, ...]:
        """Channels that it needs beside its states; a record without one of them cannot be flown."""

    @property
    @abstractmethod
    def outputs(self) -> tuple[str, ...]:
        """What it can be compared with: names of channels."""

    @property
    def unmeasured(self) -> tuple[str, ...]:
        """Outputs that no sensor shows and on which the noise of the others may depend."""
        return ()

    @abstractmethod
    def system(self, values: Values, aircraft: Aircraft) -> System:
        """The system at these parameter values."""

    @abstractmethod
    def drives(self, values: Values, channels: Mapping[str, Array], flights: Flights) -> dict[str, Array]:
        """Inputs of the simulation from the true channels, manoeuvres end to end."""

    def corrected(self, values: Values, channels: Mapping[str, Array], aircraft: Aircraft) -> Mapping[str, Array]:  # noqa: ARG002
        """The recorded channels made true."""
        return channels

    def scales(self, values: Values, flights: Flights) -> Mapping[str, Array]:  # noqa: ARG002
        """How much a unit of each recorded output has become by the correction."""
        return {}

    def delays(self, outputs: Sequence[str]) -> Mapping[str, str]:  # noqa: ARG002
        """Parameters that delay these outputs, by output."""
        return {}

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the free parameters."""
        return tuple(p.name for p in self.free)

    @abstractmethod
    def values(self, theta: Any) -> dict[str, Any]:
        """All parameter values by name, from the vector of the free ones."""

    def substeps(self, theta: Any, flights: Flights) -> int:
        """Integration steps a sample that follow the system's fast states, at most `FINEST`."""
        step = self.slowest_step(self.values(jnp.asarray(theta)), flights)
        return int(np.clip(np.ceil(float(np.max(flights.channels["dt"])) / step), 1, FINEST))

    def slowest_step(self, values: Values, flights: Flights) -> float:  # noqa: ARG002
        """Longest integration step in s that follows the system's fast states."""
        return np.inf


@dataclass(frozen=True)
class EffectDynamics(Dynamics):
    """Dynamics under a model of effects: errors of sensors are taken out of the record, gusts are disturbances."""

    model: Model

    @property
    def of_disturbances(self) -> frozenset[str]:
        """Those of gusts."""
        return frozenset(p.name for e in self.model.acting if e.disturbance is not None for p in e.parameters)

    def corrected(self, values: Values, channels: Mapping[str, Array], aircraft: Aircraft) -> Mapping[str, Array]:
        """By the model's effects that act on channels."""
        return self.model.corrected(values, channels, aircraft)

    def scales(self, values: Values, flights: Flights) -> Mapping[str, Array]:
        """By the same effects."""
        if not any(e.stage is Stage.CHANNEL for e in self.model.acting):
            return {}
        return response_scales(self.model, values, flights.channels, flights.aircraft, self.outputs)

    def delays(self, outputs: Sequence[str]) -> Mapping[str, str]:
        """By the same effects."""
        return {
            e.channels[0]: p.name
            for e in self.model.acting
            for p in e.parameters
            if p.role is Role.DELAY and e.channels[0] in outputs
        }


@dataclass(frozen=True)
class AircraftDynamics(EffectDynamics):
    """Longitudinal motion under a model of effects; `altitude` says whether the altitude is a state.

    `further` are outputs beside the usual ones, of `ON_REQUEST`.
    """

    model: Model
    altitude: bool = True
    further: tuple[str, ...] = ()

    @property
    def free(self) -> tuple[Parameter, ...]:
        """The model's."""
        return self.model.free

    @cached_property
    def _pattern(self) -> Longitudinal:
        return Longitudinal(self.model, {}, NO_AIRCRAFT, self.altitude)

    @property
    def states(self) -> tuple[str, ...]:
        """Flight states, gusts, and X where it lags."""
        return self._pattern.states

    @property
    def inputs(self) -> tuple[str, ...]:
        """What the effects ask for and the simulation does not make itself."""
        made = {*self.states, *DERIVED, *LATERAL, "dt", "start", "elapsed", "first", "last"}
        acting = [e for e in self.model.acting if e.stage > Stage.INFLOW]
        return tuple(dict.fromkeys(c for e in acting for c in e.channels if c not in made))

    @property
    def outputs(self) -> tuple[str, ...]:
        """Flight states and accelerations at the sensor, and what was asked for beside them."""
        return (*(name for name in OUTPUTS if name != "altitude" or self.altitude), *self.further)

    @property
    def unmeasured(self) -> tuple[str, ...]:
        """The separation point: noise grows as the flow separates."""
        return ("X",)

    def values(self, theta: Any) -> dict[str, Any]:
        """The model's."""
        return self.model.values(theta)

    def system(self, values: Values, aircraft: Aircraft) -> System:
        """The aircraft as it is at these values."""
        return Longitudinal(self.model, dict(values), self.model.actual_aircraft(values, aircraft), self.altitude)

    def drives(self, values: Values, channels: Mapping[str, Array], flights: Flights) -> dict[str, Array]:  # noqa: ARG002
        """Recorded channels that are no states; lateral accelerations; the speed of sound where Mach was recorded.

        Without `ay` also the rate of sideslip, if p, r and phi are known: the lateral force follows from these.
        """
        found = {name: channels[name] for name in (*self.inputs, *LATERAL, "thrust", "density") if name in channels}
        for name in ("p", "r"):
            if name in channels:
                found[f"{name}_dot"] = _slope(channels[name], flights)
        if "ay" not in channels and all(name in channels for name in SIDE):
            found["beta_dot"] = _slope(channels["beta"], flights)
        if "mach" in channels and "airspeed" in channels:
            found["sound"] = channels["airspeed"] / channels["mach"]
        return found

    def slowest_step(self, values: Values, flights: Flights) -> float:
        """Half the time constant of the separation point's lag at the highest airspeed."""
        if not self._pattern.lagged:
            return np.inf
        lag = max(float(self.model.lag(values)), LEAST_LAG)
        return 0.5 * lag * float(flights.aircraft.chord) / float(flights.channels["airspeed"].max())


def aircraft_dynamics(model: Model, flights: Flights, outputs: Sequence[str] = ()) -> AircraftDynamics:
    """The dynamics of a model for what these flights have recorded; raises `InputError` where they cannot be flown.

    `outputs` of `ON_REQUEST` are simulated beside the usual ones.
    """
    further = tuple(name for name in ON_REQUEST if name in outputs)
    dynamics = AircraftDynamics(model, altitude="altitude" in flights.channels, further=further)
    have = set(flights.channels) | {
        "alpha_dot",
        "X",
        *(f"{name}_dot" for name in ("p", "r") if name in flights.channels),
    }
    have |= {"density", "mach"} if "altitude" in have else set()
    asked = [c for e in model.acting if e.disturbance is None for c in e.channels]
    missing = [name for name in (*FLIGHT, "thrust", "density", *asked) if name not in have]
    if missing:
        other = ", or altitude" if missing[0] in ("density", "mach") else ""
        raise InputError(
            f"record {flights.names[0]} has no channel {missing[0]}{other}, without which the aircraft cannot be "
            "flown; map it on the card, or give its value under [constants]"
        )
    for effect in model.acting:
        if effect.stage is Stage.LAG and not any(p.role is Role.LAG for p in effect.parameters):
            raise InputError(
                f"effect {effect.name} is a lag of the separation point that cannot be flown: none of its parameters "
                "has the role lag"
            )
    return dynamics


def taken_as_zero(flights: Recorded) -> list[str]:
    """Lateral channels that were not recorded, so that the aircraft is flown without them."""
    missing = [name for name in SIDE if name not in flights.channels]
    slips = "beta" in flights.channels  # without sideslip no lateral force enters the longitudinal motion
    return [*missing, "ay"] if missing and slips and "ay" not in flights.channels else missing


def _slope(x: Array, flights: Flights) -> Array:
    """Derivative of the smoothed channel, manoeuvre by manoeuvre."""
    begin, parts = 0, []
    for length in flights.lengths:
        part = slice(begin, begin + length)
        parts.append(differentiate(smooth(x[part]), flights.channels["dt"][begin]))
        begin += length
    return jnp.concatenate(parts)
