"""Constant errors of recorded outputs, one for each manoeuvre, estimated together with the initial states.

`WrappedDynamics` is the base of dynamics that extend others.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from bayes_aero.dynamics.flight import Dynamics, Values
from bayes_aero.dynamics.system import System
from bayes_aero.errors import InputError
from bayes_aero.flight.aircraft import Aircraft
from bayes_aero.flight.channel import STANDARD_CHANNELS
from bayes_aero.model.joined_channels import Flights
from bayes_aero.parameter import Parameter, Prior


@dataclass(frozen=True)
class WrappedDynamics(Dynamics):
    """Extension of other dynamics, `plain`; everything that a subclass does not define is that of `plain`."""

    plain: Dynamics

    @property
    def free(self) -> tuple[Parameter, ...]:
        """Those of `plain`."""
        return self.plain.free

    @property
    def disturbance_parameters(self) -> frozenset[str]:
        """Those of `plain`."""
        return self.plain.disturbance_parameters

    @property
    def states(self) -> tuple[str, ...]:
        """Those of `plain`."""
        return self.plain.states

    @property
    def start(self) -> tuple[str, ...]:
        """Those of `plain`."""
        return self.plain.start

    @property
    def units(self) -> Mapping[str, str]:
        """Those of `plain`."""
        return self.plain.units

    @property
    def inputs(self) -> tuple[str, ...]:
        """Those of `plain`."""
        return self.plain.inputs

    @property
    def outputs(self) -> tuple[str, ...]:
        """Those of `plain`."""
        return self.plain.outputs

    @property
    def unmeasured(self) -> tuple[str, ...]:
        """Those of `plain`."""
        return self.plain.unmeasured

    def values(self, theta: Any) -> dict[str, Any]:
        """Those of `plain`."""
        return self.plain.values(theta)

    def system(self, values: Values, aircraft: Aircraft) -> System:
        """Those of `plain`."""
        return self.plain.system(values, aircraft)

    def drives(self, values: Values, channels: Mapping[str, Array], flights: Flights) -> dict[str, Array]:
        """Those of `plain`."""
        return self.plain.drives(values, channels, flights)

    def corrected(self, values: Values, channels: Mapping[str, Array], aircraft: Aircraft) -> Mapping[str, Array]:
        """Those of `plain`."""
        return self.plain.corrected(values, channels, aircraft)

    def scales(self, values: Values, flights: Flights) -> Mapping[str, Array]:
        """Those of `plain`."""
        return self.plain.scales(values, flights)

    def delays(self, outputs: Sequence[str]) -> Mapping[str, str]:
        """Those of `plain`."""
        return self.plain.delays(outputs)

    def slowest_step(self, values: Values, flights: Flights) -> float:
        """Those of `plain`."""
        return self.plain.slowest_step(values, flights)


@dataclass(frozen=True)
class BiasedDynamics(WrappedDynamics):
    """Dynamics with biased recorded outputs, a bias for each manoeuvre; parameters bias_output_number."""

    biased: tuple[tuple[str, Prior], ...]
    lengths: tuple[int, ...]  # samples of the manoeuvres

    @property
    def manoeuvres(self) -> int:
        """Number of manoeuvres."""
        return len(self.lengths)

    @property
    def free(self) -> tuple[Parameter, ...]:
        """Those of the dynamics, then the biases, output by output."""
        biases = [
            Parameter(_name(output, k), _unit(output), 0.0, 0.0, f"bias of recorded {output}, manoeuvre {k + 1}", prior)
            for output, prior in self.biased
            for k in range(self.manoeuvres)
        ]
        return (*self.plain.free, *biases)

    def values(self, theta: Any) -> dict[str, Any]:
        """Values of the dynamics, and the biases."""
        k = len(self.plain.free)
        return self.plain.values(theta[:k]) | {name: theta[i] for i, name in enumerate(self.names) if i >= k}

    def corrected(self, values: Values, channels: Mapping[str, Array], aircraft: Aircraft) -> Mapping[str, Array]:
        """The corrected record without its biases, from which the measured initial state is also taken."""
        unbiased = dict(channels)
        for name, _ in self.biased:
            sizes = jnp.stack([values[_name(name, k)] for k in range(self.manoeuvres)])
            unbiased[name] = channels[name] - sizes[np.repeat(np.arange(self.manoeuvres), self.lengths)]
        return self.plain.corrected(values, unbiased, aircraft)


def biased_dynamics(dynamics: Dynamics, flights: Flights, priors: Mapping[str, Prior]) -> Dynamics:
    """The dynamics with a bias of each named output for each manoeuvre, with these priors (SI).

    Raises:
        InputError: an output was not recorded or is not simulated.
    """
    for name in priors:
        if name not in dynamics.outputs or name not in flights.channels:
            possible = ", ".join(n for n in dynamics.outputs if n in flights.channels)
            raise InputError(
                f"{name} cannot have a bias: it was not recorded or is not simulated; there are {possible}"
            )
    return BiasedDynamics(dynamics, tuple(priors.items()), flights.lengths) if priors else dynamics


def unbiased(dynamics: Dynamics) -> Dynamics:
    """The dynamics without the biases of outputs."""
    return dynamics.plain if isinstance(dynamics, BiasedDynamics) else dynamics


def with_biases_of(other: Dynamics, plain: Dynamics) -> Dynamics:
    """`plain` with the biases of `other`, if it has any."""
    return replace(other, plain=plain) if isinstance(other, BiasedDynamics) else plain


def _name(output: str, manoeuvre: int) -> str:
    return f"bias_{output}_{manoeuvre + 1}"


def _unit(output: str) -> str:
    return STANDARD_CHANNELS[output].unit if output in STANDARD_CHANNELS else "SI"
