"""Delayed outputs of recorders, for a filter that has only the present state."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import jax
from jaxtyping import Array, Float

from bayes_aero.dynamics.system import Row, System


class LateOutputs(System):
    """A system with outputs delayed by `delays` (s): y(t - delay) to first order.

    The delay must be short against the motion: for a sinusoid of 1 rad/s and a delay of 0.1 s the error is 0.5 %.
    """

    plain: System
    delays: Mapping[str, Any]

    @property
    def states(self) -> tuple[str, ...]:
        """Those of `plain`."""
        return self.plain.states

    @property
    def envelope(self) -> Mapping[str, tuple[float, float]]:
        """That of `plain`."""
        return self.plain.envelope

    @property
    def state_outputs(self) -> tuple[str, ...]:
        """State outputs without a delay."""
        return tuple(name for name in self.plain.state_outputs if name not in self.delays)

    def motion(self, x: Float[Array, " s"], u: Row) -> tuple[Float[Array, " s"], dict[str, Any]]:
        """That of `plain`, with delayed outputs."""
        rate, now = self.plain.motion(x, u)
        state = dict(zip(self.states, x, strict=True))

        def late(x):
            found = dict(zip(self.states, x, strict=True)) | self.plain.motion(x, u)[1]
            return {name: found[name] for name in self.delays}

        slope = jax.jvp(late, (x,), (rate,))[1]
        return rate, now | {n: (state | now)[n] - delay * slope[n] for n, delay in self.delays.items()}

    def complete_start(self, x: Float[Array, " s"], u: Row) -> Float[Array, " s"]:
        """That of `plain`."""
        return self.plain.complete_start(x, u)

    def noise_density(self, x: Float[Array, " s"], u: Row) -> Float[Array, " s"]:
        """That of `plain`."""
        return self.plain.noise_density(x, u)

    def decay(self, x: Float[Array, " s"], u: Row) -> Float[Array, " s"]:
        """That of `plain`."""
        return self.plain.decay(x, u)

    def start_covariance(self, x: Float[Array, " s"], u: Row, deviation: Float[Array, " s"]) -> Float[Array, "s s"]:
        """That of `plain`."""
        return self.plain.start_covariance(x, u, deviation)
