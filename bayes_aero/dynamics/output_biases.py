"""Constant errors of recorded outputs, one for each manoeuvre, estimated together with the initial states."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from bayes_aero.dynamics.flight import Dynamics, Values
from bayes_aero.dynamics.system import OfPlain
from bayes_aero.errors import InputError
from bayes_aero.flight.aircraft import Aircraft
from bayes_aero.flight.channel import STANDARD_CHANNELS
from bayes_aero.model.observations import Flights
from bayes_aero.parameter import Parameter, Prior


@dataclass(frozen=True)
class BiasedDynamics(Dynamics):
    """The dynamics `plain` with biased recorded outputs, a bias for each manoeuvre; parameters bias_output_number."""

    plain: Dynamics
    biased: tuple[tuple[str, Prior], ...]
    lengths: tuple[int, ...]  # samples of the manoeuvres

    disturbance_parameters: ClassVar[Any] = OfPlain()
    states: ClassVar[Any] = OfPlain()
    start: ClassVar[Any] = OfPlain()
    units: ClassVar[Any] = OfPlain()
    inputs: ClassVar[Any] = OfPlain()
    outputs: ClassVar[Any] = OfPlain()
    unmeasured: ClassVar[Any] = OfPlain()
    system: ClassVar[Any] = OfPlain()
    drives: ClassVar[Any] = OfPlain()
    scales: ClassVar[Any] = OfPlain()
    delays: ClassVar[Any] = OfPlain()
    slowest_step: ClassVar[Any] = OfPlain()

    @property
    def free(self) -> tuple[Parameter, ...]:
        """Those of the dynamics, then the biases, output by output."""
        unit = lambda output: STANDARD_CHANNELS[output].unit if output in STANDARD_CHANNELS else "SI"  # noqa: E731
        biases = [
            Parameter(_name(output, k), unit(output), 0.0, 0.0, f"bias of recorded {output}, manoeuvre {k + 1}", prior)
            for output, prior in self.biased
            for k in range(len(self.lengths))
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
            sizes = jnp.stack([values[_name(name, k)] for k in range(len(self.lengths))])
            unbiased[name] = channels[name] - sizes[np.repeat(np.arange(len(self.lengths)), self.lengths)]
        return self.plain.corrected(values, unbiased, aircraft)


def biased_dynamics(dynamics: Dynamics, flights: Flights, priors: Mapping[str, Prior]) -> Dynamics:
    """The dynamics with a bias of each named output for each manoeuvre, with these priors (SI)."""
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
