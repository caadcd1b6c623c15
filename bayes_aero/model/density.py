"""Posterior log-density of a model on observations: log-likelihood plus log-prior, for all samplers."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from bayes_aero.model.log_density import LogDensity
from bayes_aero.model.model import Model
from bayes_aero.model.noise import Colour, Noise
from bayes_aero.model.observations import Observations
from bayes_aero.parameter import Parameter


class Density(LogDensity):
    """Posterior log-density of the free model parameters and the noise parameters.

    Vectors `x` hold model parameters first, then noise (`parameters` gives the order). The observations are array
    leaves, so that data sets of one size share compiled programs.
    """

    observations: Observations = eqx.field(converter=lambda given: given.nameless)
    model: Model = eqx.field(static=True)
    noise: Noise = eqx.field(static=True)
    bias: Float[Array, " p"] | None = (
        None  # what recording noise adds to the free model parameters: coefficients follow x + bias
    )

    @classmethod
    def of(
        cls, observations: Observations, model: Model, noise: Noise, bias: Float[np.ndarray, " p"] | None = None
    ) -> Density:
        """The density of a record under `noise`; coloured noise uses one sample in `FILTER_STEP`.

        Cm is formed from a smoothed and differentiated rate. The smoothing correlates neighbouring samples in a way
        that no short autoregression describes. With every sample the autoregression would fit the smoothness, and the
        likelihood would weigh only changes from sample to sample, in which filtered and unfiltered signals differ. One
        sample in `FILTER_STEP` keeps the band that the filter passes, in which the coloured model holds.
        """
        known = None if bias is None else jnp.asarray(bias)
        own = replace(noise, coefficients=observations.coefficients)
        return cls(observations if noise.colour is Colour.WHITE else observations.thinned(), model, own, known)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Free model parameters, then noise parameters."""
        return (*self.model.free, *self.noise.parameters)

    @property
    def noise_label(self) -> str:
        """The noise model's name."""
        return self.noise.colour.value

    def values(self, x: Float[Array, " k"]) -> dict[str, Any]:
        """Values of all parameters, fixed ones too, by name, with the bias that recording noise gives them."""
        if self.bias is not None:
            own = len(self.bias)
            x = jnp.concatenate([x[:own] + self.bias, x[own:]])
        return dict(self.model.fixed) | {name: x[i] for i, name in enumerate(self.names)}

    def predict(self, x: Float[Array, " k"]) -> Float[Array, "n c"]:
        """Modelled coefficients."""
        return self._stacked(self._flow(x))

    def pointwise(self, x: Float[Array, " k"]) -> Float[Array, "n c"]:
        """Log-likelihood of every sample and coefficient, given the samples before it in its manoeuvre."""
        return jnp.stack(self._by_coefficient(x, self.noise.log_density), axis=-1)

    def standardised(self, x: Float[Array, " k"]) -> Float[Array, "n c"]:
        """One-step-ahead innovations over their standard deviation: white, unit variance if the model holds."""
        return jnp.stack([z for z, _ in self._by_coefficient(x, self.noise.innovation)], axis=-1)

    def replicate(self, x: Float[Array, " k"], white: Float[Array, "n c"]) -> Float[Array, "n c"]:
        """Coefficients that the model with its noise would have produced from standard normal `white`."""
        known = self._flow(x)
        return self._stacked(known) + self.noise.simulate(self.values(x), white, known["X"], self.observations.start)

    def log_likelihood(self, x: Float[Array, " k"]) -> Float[Array, ""]:
        """Sum of `pointwise`, taken before the coefficients are put side by side: almost twice as fast."""
        return sum((jnp.sum(one) for one in self._by_coefficient(x, self.noise.log_density)), start=jnp.zeros(()))

    def _by_coefficient(self, x: Float[Array, " k"], function: Callable[..., Any]) -> list[Any]:
        """A function of the noise model for the residuals of each coefficient."""
        o, known, values = self.observations, self._flow(x), self.values(x)
        residuals = {name: o.measured[:, c] - known[name] for c, name in enumerate(self.model.coefficients)}
        return [function(name, values, residual, known["X"], o.start) for name, residual in residuals.items()]

    def _flow(self, x: Float[Array, " k"]) -> Mapping[str, Array]:
        """The coefficients and the separation point."""
        return self.model.flow(self.values(x), self.observations.signals, self.observations.aircraft)

    def _stacked(self, known: Mapping[str, Array]) -> Float[Array, "n c"]:
        return jnp.stack([known[name] for name in self.model.coefficients], axis=-1)
