"""What a filter does not foresee of something added to a coefficient: to first order, its gains held.

A term theta phi(x) of a coefficient acts where the filter stands: on the outputs at the state before a sample's
correction, and on the motion from the state after it to the next sample, along which phi is taken as linear. Neither
holds noise of the innovation that it changes. The filter is linear in it, so that all terms of a library are columns of
one recurrence. Source: Jazwinski, *Stochastic Processes and Filtering Theory*, 1970, ch. 8 (the linearised filter).
"""

from __future__ import annotations

from functools import cached_property
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from bayes_aero.dynamics.filtering.linearised import (
    InputDerivatives,
    StateDerivatives,
    derivatives_by_input,
    input_innovations,
)
from bayes_aero.residuals.added_coefficients import AddedCoefficients, Made, channel_of
from bayes_aero.residuals.filter_error import FilterError

COLUMNS = 64  # at a time


class AddedToFilter(AddedCoefficients):
    """Innovations under inputs that are added to the coefficients, at fixed parameters `theta`, gains held."""

    def __init__(self, responses: FilterError, theta: Float[np.ndarray, " k"]) -> None:
        super().__init__(responses, theta)
        self.path, self.known = responses.path_at(theta)

    @cached_property
    def predicted(self) -> dict[str, np.ndarray]:
        """Signals where each sample's outputs are predicted, by the samples before."""
        return self.along(self.path.before)

    def signals(self) -> dict[str, np.ndarray]:
        """Signals of the flow, X and the marks along the predictions, each (n,)."""
        return self.predicted

    def slopes(self, coefficient: str, made: Made) -> Float[np.ndarray, "d m c"]:
        """Minus the derivatives of the whitened innovations; arguments as of `AddedCoefficients.slopes`."""
        responses = self.responses
        assert isinstance(responses, FilterError)
        direction = {name: jnp.asarray(float(name == channel_of(coefficient))) for name in self.zeros}
        own = _by_input(responses, self.theta, self.path.before, self.known, direction)
        series = np.stack([made(self.predicted), made(self.along(self.path.after))])  # 2 d n
        found = []
        for begin in range(0, series.shape[1], COLUMNS):
            part = series[:, begin : begin + COLUMNS]
            wide = np.zeros((2, COLUMNS, series.shape[2]))
            wide[:, : part.shape[1]] = part
            slope = _slopes(responses, self.theta, self.known, own, jnp.asarray(wide))
            found.append(-np.moveaxis(np.asarray(slope), -1, 0)[: part.shape[1]])
        return np.concatenate(found)


@eqx.filter_jit
def _by_input(responses: FilterError, theta: Any, before: Array, known: StateDerivatives, direction: dict[str, Array]):
    return derivatives_by_input(responses.flown, theta, before, known, direction)


@eqx.filter_jit
def _slopes(
    responses: FilterError, theta: Any, known: StateDerivatives, own: InputDerivatives, series: Float[Array, "2 d n"]
) -> Float[Array, "m c d"]:
    flown = responses.flown
    before, after = (jnp.moveaxis(x[:, flown.index], 0, -1) for x in series)  # w n d
    return responses.whitened(theta, input_innovations(flown, theta, known, own, responses.by, before, after))
