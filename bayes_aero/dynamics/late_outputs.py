"""Outputs that a recorder shows late, for a filter that knows the state of this instant alone."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import jax
from jaxtyping import Array, Float

from bayes_aero.dynamics.system import Row, System


class LateOutputs(System):
    """A system whose outputs named in `delays` (s) are those of before: y(t - delay) to the first order.

    Good while the delay is short against the motion: of a sinusoid of 1 rad/s and a delay of .1 s it misses .5 %.
    """

    plain: System
    delays: Mapping[str, Any]

    @property
    def states(self) -> tuple[str, ...]:
        """As they are."""
        return self.plain.states

    @property
    def envelope(self) -> Mapping[str, tuple[float, float]]:
        """As it is."""
        return self.plain.envelope

    @property
    def shown(self) -> tuple[str, ...]:
        """Those that are on time."""
        return tuple(name for name in self.plain.shown if name not in self.delays)

    def motion(self, x: Float[Array, " s"], u: Row) -> tuple[Float[Array, " s"], dict[str, Any]]:
        """As it is, with late outputs."""
        rate, now = self.plain.motion(x, u)
        state = dict(zip(self.states, x, strict=True))

        def late(x):
            found = dict(zip(self.states, x, strict=True)) | self.plain.motion(x, u)[1]
            return {name: found[name] for name in self.delays}

        slope = jax.jvp(late, (x,), (rate,))[1]
        return rate, now | {n: (state | now)[n] - delay * slope[n] for n, delay in self.delays.items()}

    def settled(self, x: Float[Array, " s"], u: Row) -> Float[Array, " s"]:
        """As it is."""
        return self.plain.settled(x, u)

    def noise_density(self, x: Float[Array, " s"], u: Row) -> Float[Array, " s"]:
        """As it is."""
        return self.plain.noise_density(x, u)

    def decay(self, x: Float[Array, " s"], u: Row) -> Float[Array, " s"]:
        """As it is."""
        return self.plain.decay(x, u)

    def start_covariance(self, x: Float[Array, " s"], u: Row, deviation: Float[Array, " s"]) -> Float[Array, "s s"]:
        """As it is."""
        return self.plain.start_covariance(x, u, deviation)
