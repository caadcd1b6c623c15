"""Drifting parameters: each is its value at the start of a manoeuvre plus a random walk, which is a state of the
filter.

The value at time t is theta + d(t) with d(0) = 0 and dd = sigma dW; sigma is the filter's process noise of that state,
unit of the parameter per square root of a second. Parameters of sensor errors act through the derivatives of the
corrected channels, which is exact where the channels are linear in them. Source: Ljung, *System Identification*, 2nd
ed. 1999, ch. 11.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from bayes_aero.dynamics.flight import AircraftDynamics, Dynamics, Values
from bayes_aero.dynamics.output_biases import WrappedDynamics, unbiased
from bayes_aero.dynamics.system import Row, System
from bayes_aero.effect import Stage
from bayes_aero.errors import InputError
from bayes_aero.flight.aircraft import Aircraft
from bayes_aero.model.joined_channels import Flights

PREFIX = "drift "  # of the states' names; no channel has a space in its name
# Prefixes of inputs that hold the derivative of a corrected channel by a parameter: of an output, of an input.
OUTPUT_SLOPE, INPUT_SLOPE = "output slope ", "input slope "
MAX_DRIFTING = 4  # each enlarges the filter, and one record cannot distinguish many; our choice


class DriftingSystem(System):
    """A system whose `drifting` parameters are `values` plus the last states."""

    plain: Dynamics = eqx.field(static=True)
    drifting: tuple[str, ...] = eqx.field(static=True)
    values: dict[str, Any]
    aircraft: Aircraft

    @property
    def states(self) -> tuple[str, ...]:
        """Those of the system, then the drifts."""
        return (*self.plain.states, *(PREFIX + name for name in self.drifting))

    @property
    def envelope(self) -> Mapping[str, tuple[float, float]]:
        """That of the system."""
        return self._at(jnp.zeros(len(self.drifting))).envelope

    @property
    def state_outputs(self) -> tuple[str, ...]:
        """None: the sensor of a state may drift, too."""
        return ()

    def motion(self, x: Float[Array, " s"], u: Row) -> tuple[Float[Array, " s"], dict[str, Any]]:
        """That of the system with the parameters of this instant; the rates of the drifts are zero."""
        own, system, errors, drives = self._now(x, u)
        rate, outputs = system.motion(own, drives)
        outputs |= {name: y for name, y in zip(system.states, own, strict=True) if name in system.state_outputs}
        outputs |= {name: outputs[name] - error for name, error in errors.items() if name in outputs}
        return self._filled(rate), outputs

    def complete_start(self, x: Float[Array, " s"], u: Row) -> Float[Array, " s"]:
        """That of the system; the drifts are unchanged."""
        own, system, _, drives = self._now(x, u)
        return x.at[: len(own)].set(system.complete_start(own, drives))

    def noise_density(self, x: Float[Array, " s"], u: Row) -> Float[Array, " s"]:
        """That of the system; the filter adds the noise of the drifts."""
        own, system, _, drives = self._now(x, u)
        return self._filled(system.noise_density(own, drives))

    def decay(self, x: Float[Array, " s"], u: Row) -> Float[Array, " s"]:
        """That of the system; a random walk has none."""
        own, system, _, drives = self._now(x, u)
        return self._filled(system.decay(own, drives))

    def start_covariance(self, x: Float[Array, " s"], u: Row, deviation: Float[Array, " s"]) -> Float[Array, "s s"]:
        """That of the system; drifts are zero at the start."""
        own, system, _, drives = self._now(x, u)
        s = len(own)
        return jnp.zeros((len(x), len(x))).at[:s, :s].set(system.start_covariance(own, drives, deviation[:s]))

    def _now(self, x: Array, u: Row) -> tuple[Array, System, dict[str, Any], dict[str, Any]]:
        """The state of the system without drifts, the system, the drifts of the outputs' sensors, and the inputs."""
        s = len(self.plain.states)
        drift = dict(zip(self.drifting, x[s:], strict=True))
        errors: dict[str, Any] = {}
        drives = {name: y for name, y in u.items() if not name.startswith((OUTPUT_SLOPE, INPUT_SLOPE))}
        for kind, changed in ((OUTPUT_SLOPE, errors), (INPUT_SLOPE, drives)):
            for name in (name for name in u if name.startswith(kind)):
                parameter, channel = name.removeprefix(kind).split(" ", 1)
                changed[channel] = changed.get(channel, 0.0) + u[name] * drift[parameter]
        return x[:s], self._at(x[s:]), errors, drives

    def _at(self, drift: Array) -> System:
        now = {name: self.values[name] + d for name, d in zip(self.drifting, drift, strict=True)}
        return self.plain.system(self.values | now, self.aircraft)

    def _filled(self, own: Array) -> Array:
        return jnp.concatenate([own, jnp.zeros(len(self.drifting))])


@dataclass(frozen=True)
class DriftingDynamics(WrappedDynamics):
    """Dynamics with drifting free parameters; `of_record` are the drifting parameters of sensor errors."""

    drifting: tuple[str, ...]
    of_record: tuple[str, ...] = ()

    @property
    def states(self) -> tuple[str, ...]:
        """Those of the dynamics, then the drifts."""
        return (*self.plain.states, *(PREFIX + name for name in self.drifting))

    @property
    def start(self) -> tuple[str, ...]:
        """The states."""
        return self.states

    def system(self, values: Values, aircraft: Aircraft) -> System:
        """The system, rebuilt at each instant."""
        return DriftingSystem(self.plain, self.drifting, dict(values), aircraft)

    def drives(self, values: Values, channels: Mapping[str, Array], flights: Flights) -> dict[str, Array]:
        """Those of the dynamics, and the derivatives of the corrected channels by the parameters `of_record`."""
        found = self.plain.drives(values, channels, flights)
        for parameter in self.of_record:

            def true(x: Any, parameter: str = parameter) -> tuple[dict[str, Array], dict[str, Array]]:
                changed = dict(values) | {parameter: x}
                corrected = self.plain.corrected(changed, flights.channels, flights.aircraft)
                outputs = {name: corrected[name] for name in self.outputs if name in flights.channels}
                return outputs, self.plain.drives(changed, corrected, flights)

            x = jnp.asarray(values[parameter], float)
            _, slopes = jax.jvp(true, (x,), (jnp.ones_like(x),))
            for kind, slope in zip((OUTPUT_SLOPE, INPUT_SLOPE), slopes, strict=True):
                found |= {f"{kind}{parameter} {channel}": y for channel, y in slope.items()}
        return found


def drifting(dynamics: Dynamics, names: Sequence[str], fixed: Collection[str] = ()) -> DriftingDynamics:
    """The dynamics with these parameters drifting.

    Args:
        dynamics: of effects or linear.
        names: free parameters, none twice.
        fixed: parameters that the card fixes, for the error message.

    Raises:
        InputError: a parameter is unknown, fixed or one of a disturbance, or there are too many.
    """
    refuse(dynamics, names, fixed)
    inner = unbiased(dynamics)
    acting = inner.model.acting if isinstance(inner, AircraftDynamics) else ()
    recording = {p.name for e in acting if e.stage is Stage.CHANNEL for p in e.parameters}
    return DriftingDynamics(dynamics, tuple(names), tuple(name for name in names if name in recording))


def refuse(dynamics: Dynamics, names: Sequence[str], fixed: Collection[str] = ()) -> None:
    """Raise `InputError` for parameters that cannot drift; see `drifting`."""
    free = [name for name in unbiased(dynamics).names if name not in dynamics.disturbance_parameters]
    if not names or len(names) > MAX_DRIFTING:
        raise InputError(f"{len(names)} parameters are named to drift; name one to {MAX_DRIFTING}, separated by commas")
    for name in names:
        if name in fixed:
            raise InputError(f"the parameter {name} cannot drift: the card fixes it; take it out of the card's fixed")
        if name in dynamics.disturbance_parameters:
            raise InputError(f"the parameter {name} cannot drift: it belongs to a disturbance; name another one")
        if name not in free:
            close = get_close_matches(name, free, n=1)
            hint = f"did you mean {close[0]}?" if close else f"there are {', '.join(free)}"
            raise InputError(f"the parameter {name} cannot drift: the card's model has no such parameter; {hint}")
