"""Constant errors of recorded outputs, one for each manoeuvre: classic companions of output error's initial states.

`WrappedDynamics` is what dynamics with an addition share.
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
    """Other dynamics with something added; all that is not added is theirs."""

    plain: Dynamics

    @property
    def free(self) -> tuple[Parameter, ...]:
        """Theirs."""
        return self.plain.free

    @property
    def of_disturbances(self) -> frozenset[str]:
        """Theirs."""
        return self.plain.of_disturbances

    @property
    def states(self) -> tuple[str, ...]:
        """Theirs."""
        return self.plain.states

    @property
    def start(self) -> tuple[str, ...]:
        """Theirs."""
        return self.plain.start

    @property
    def units(self) -> Mapping[str, str]:
        """Theirs."""
        return self.plain.units

    @property
    def inputs(self) -> tuple[str, ...]:
        """Theirs."""
        return self.plain.inputs

    @property
    def outputs(self) -> tuple[str, ...]:
        """Theirs."""
        return self.plain.outputs

    @property
    def unmeasured(self) -> tuple[str, ...]:
        """Theirs."""
        return self.plain.unmeasured

    def values(self, theta: Any) -> dict[str, Any]:
        """Theirs."""
        return self.plain.values(theta)

    def system(self, values: Values, aircraft: Aircraft) -> System:
        """Theirs."""
        return self.plain.system(values, aircraft)

    def drives(self, values: Values, channels: Mapping[str, Array], flights: Flights) -> dict[str, Array]:
        """Theirs."""
        return self.plain.drives(values, channels, flights)

    def corrected(self, values: Values, channels: Mapping[str, Array], aircraft: Aircraft) -> Mapping[str, Array]:
        """As they correct them."""
        return self.plain.corrected(values, channels, aircraft)

    def scales(self, values: Values, flights: Flights) -> Mapping[str, Array]:
        """Theirs."""
        return self.plain.scales(values, flights)

    def delays(self, outputs: Sequence[str]) -> Mapping[str, str]:
        """Theirs."""
        return self.plain.delays(outputs)

    def slowest_step(self, values: Values, flights: Flights) -> float:
        """Theirs."""
        return self.plain.slowest_step(values, flights)


@dataclass(frozen=True)
class BiasedDynamics(WrappedDynamics):
    """Dynamics whose named outputs are recorded with a bias of each manoeuvre's own; parameters bias_output_number."""

    biased: tuple[tuple[str, Prior], ...]
    lengths: tuple[int, ...]  # samples of the manoeuvres

    @property
    def manoeuvres(self) -> int:
        """How many there are."""
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
        """Of the dynamics, and the biases."""
        k = len(self.plain.free)
        return self.plain.values(theta[:k]) | {name: theta[i] for i, name in enumerate(self.names) if i >= k}

    def corrected(self, values: Values, channels: Mapping[str, Array], aircraft: Aircraft) -> Mapping[str, Array]:
        """The record without its biases, made true: the measured initial state, too, is read from that."""
        freed = dict(channels)
        for name, _ in self.biased:
            sizes = jnp.stack([values[_name(name, k)] for k in range(self.manoeuvres)])
            freed[name] = channels[name] - sizes[np.repeat(np.arange(self.manoeuvres), self.lengths)]
        return self.plain.corrected(values, freed, aircraft)


def biased_dynamics(dynamics: Dynamics, flights: Flights, priors: Mapping[str, Prior]) -> Dynamics:
    """The dynamics with a bias of each named output for each manoeuvre, under these priors (SI); without any, as is."""
    for name in priors:
        if name not in dynamics.outputs or name not in flights.channels:
            there = ", ".join(n for n in dynamics.outputs if n in flights.channels)
            raise InputError(f"{name} cannot have a bias: it was not recorded or is not simulated; there are {there}")
    return BiasedDynamics(dynamics, tuple(priors.items()), flights.lengths) if priors else dynamics


def unbiased(dynamics: Dynamics) -> Dynamics:
    """What is recorded with biases, or the dynamics themselves."""
    return dynamics.plain if isinstance(dynamics, BiasedDynamics) else dynamics


def with_biases_of(other: Dynamics, plain: Dynamics) -> Dynamics:
    """`plain` recorded with the biases of `other`, if that has any."""
    return replace(other, plain=plain) if isinstance(other, BiasedDynamics) else plain


def _name(output: str, manoeuvre: int) -> str:
    return f"bias_{output}_{manoeuvre + 1}"


def _unit(output: str) -> str:
    return STANDARD_CHANNELS[output].unit if output in STANDARD_CHANNELS else "SI"
