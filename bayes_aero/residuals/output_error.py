"""Output error: recorded minus simulated channels, in windows with an initial state each.

It is less sensitive than equation error, because a trajectory integrates the error of a coefficient.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from bayes_aero.dynamics.flight import AircraftDynamics
from bayes_aero.dynamics.segments import SegmentTrajectories, segments, simulate
from bayes_aero.model.joined_channels import Flights
from bayes_aero.model.model import Model
from bayes_aero.physics.filters import FILTER_STEP
from bayes_aero.residuals.base import DIRECTIONS_PER_CALL, WINDOW, ResidualModel


class OutputError(ResidualModel, eqx.Module):
    """Residuals of simulated windows, averaged over blocks of `FILTER_STEP` samples: m of them."""

    flights: Flights
    windows: SegmentTrajectories
    place: Int[np.ndarray, " m"]  # indices of the complete blocks
    model: Model = eqx.field(static=True)

    @classmethod
    def of(cls, flights: Flights, dynamics: AircraftDynamics, substeps: int = 1) -> OutputError:
        """Every manoeuvre in windows."""
        names = tuple(n for n in dynamics.outputs if n in flights.channels)
        cut = segments(flights, dynamics, outputs=names, window=WINDOW, substeps=substeps)
        whole = cut.index.shape[1] // FILTER_STEP * FILTER_STEP
        index, inside, noise_growth = (x[:, :whole] for x in (cut.index, cut.inside, cut.noise_growth))
        cut = replace(cut, index=index, inside=inside, noise_growth=noise_growth)
        place = np.flatnonzero(cut.inside.reshape(-1, FILTER_STEP).all(axis=1))
        return cls(flights=flights, windows=cut, place=place, model=dynamics.model)

    @property
    def flown(self) -> SegmentTrajectories:
        """The windows of the present flights."""
        return eqx.tree_at(lambda f: f.flights, self.windows, self.flights)

    @property
    def nameless(self):
        """The same without names of the flights and of their windows."""
        return replace(self, flights=self.flights.nameless, windows=self.windows.nameless)

    @property
    def outputs(self) -> tuple[str, ...]:
        """Names of the channels that are compared."""
        return self.windows.outputs

    @property
    def manoeuvre(self) -> Int[np.ndarray, " m"]:
        """Which manoeuvre each block belongs to."""
        return self.flights.manoeuvre[self.windows.index[:, ::FILTER_STEP].ravel()[self.place]]

    @property
    def stretch(self) -> Int[np.ndarray, " m"]:
        """The window of each block; in a window the effects of disturbances accumulate from its start."""
        return np.repeat(np.arange(len(self.windows.index)), self.windows.index.shape[1] // FILTER_STEP)[self.place]

    @property
    def seconds(self) -> float:
        """Length of a block, s."""
        return FILTER_STEP * float(np.median(self.windows.dt))

    def _mean(self, x: Float[Array, "w n ..."]) -> Float[Array, "m ..."]:
        parts = x.reshape(-1, FILTER_STEP, *x.shape[2:]).mean(axis=1)
        return parts[self.place]

    def block(self, x: Float[Array, "n ..."] | Float[np.ndarray, "n ..."]) -> Float[Array, "m ..."]:
        """Means over blocks."""
        return self._mean(jnp.asarray(x)[self.windows.index])

    def evaluate(
        self, theta: Float[Array, " k"] | Float[np.ndarray, " k"]
    ) -> tuple[Float[Array, "m c"], Mapping[str, Array]]:
        """Residuals of the windows from their measured initial states."""
        return _residual(self.nameless, jnp.asarray(theta), jnp.zeros(len(self.windows.dynamics.start))), {}

    def slopes(
        self, theta: Float[np.ndarray, " k"], directions: Float[np.ndarray, "d k"]
    ) -> tuple[Float[np.ndarray, "m c"], Float[np.ndarray, "d m c"]]:
        """Residuals and minus their derivatives in these directions."""
        rest = np.zeros((len(directions), len(self.windows.dynamics.start)))
        residual, slope = _slopes(self.nameless, *map(jnp.asarray, (theta, directions, rest)))
        return np.asarray(residual), -np.asarray(slope)

    def offsets(self, theta: Float[np.ndarray, " k"], outputs: Sequence[str]) -> Float[np.ndarray, "m c o"]:
        """Sensitivities to the initial state of each window."""
        keep = [self.outputs.index(name) for name in outputs]
        states, rest = len(self.windows.dynamics.start), np.zeros((DIRECTIONS_PER_CALL, len(theta)))
        directions = np.eye(-(-states // DIRECTIONS_PER_CALL) * DIRECTIONS_PER_CALL, states)
        parts = np.split(directions, len(directions) // DIRECTIONS_PER_CALL)  # by the program of `slopes`
        found = [_slopes(self.nameless, *map(jnp.asarray, (theta, rest, part)))[1] for part in parts]
        slope = -np.concatenate(found)[:states][:, :, keep]  # s m c
        window = self.stretch
        s, m, c = slope.shape
        S = np.zeros((m, c, len(self.windows.index) * s))
        for w in range(len(self.windows.index)):
            mine = window == w
            S[mine, :, w * s : (w + 1) * s] = np.moveaxis(slope[:, mine], 0, 2)
        return S

    def residual(self, theta: Any, shared: Any) -> Float[Array, "m c"]:
        """Residuals at these parameters with the initial state of every window changed by `shared` (s,)."""
        found = simulate(self.flown, theta, jnp.zeros((len(self.windows.index), 1)) + shared)
        return self._mean(found.residual)

    def states(self, theta: Any) -> Float[Array, "w n s"]:
        """States of the simulated windows from their measured initial states."""
        departure = jnp.zeros((len(self.windows.index), len(self.windows.dynamics.start)))
        return simulate(self.flown, theta, departure).trajectory.states


_residual = eqx.filter_jit(lambda responses, theta, shared: responses.residual(theta, shared))


@eqx.filter_jit
def _slopes(responses: OutputError, theta, directions, initial_directions):
    """Derivatives by parameters and initial states together, so that one program serves both."""
    point = (theta, jnp.zeros(initial_directions.shape[1]))
    one = lambda *d: jax.jvp(responses.residual, point, d)  # noqa: E731
    return jax.vmap(one, out_axes=(None, 0))(directions, initial_directions)
