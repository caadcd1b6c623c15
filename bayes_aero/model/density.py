"""Posterior log-density of a model on observations: log-likelihood plus log-prior, for all samplers."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from bayes_aero.model.model import Model
from bayes_aero.model.noise import Colour, Noise
from bayes_aero.model.observations import Observations
from bayes_aero.parameter import Parameter, from_unbounded, to_unbounded

# --- A log-density: likelihood and priors of named parameters, on the scale of the data and on the whole real line.


class LogDensity(eqx.Module):
    """Log-density for samplers: vectors `x` are in SI, `u` is the same point mapped onto the whole real line."""

    @property
    @abstractmethod
    def parameters(self) -> tuple[Parameter, ...]:
        """All parameters, in the order of `x`."""

    @property
    @abstractmethod
    def noise_label(self) -> str:
        """The assumed noise, in a word."""

    @abstractmethod
    def log_likelihood(self, x: Float[Array, " k"]) -> Float[Array, ""]:
        """Log-density of the data at `x`."""

    @property
    def names(self) -> tuple[str, ...]:
        """Names in the order of `x`."""
        return tuple(p.name for p in self.parameters)

    @property
    def size(self) -> int:
        """Number of parameters."""
        return len(self.parameters)

    def log_prior(self, x: Float[Array, " k"]) -> Float[Array, ""]:
        """Log of the product of the parameters' priors. Truncation by bounds is not normalised: a constant."""
        return sum((p.prior.log_density(x[i]) for i, p in enumerate(self.parameters)), start=jnp.zeros(()))

    def __call__(self, u: Float[Array, " k"]) -> Float[Array, ""]:
        """Log-density of `u`: likelihood, prior, and the Jacobian of the map from `u` to `x`."""
        x, log_slope = self._bounded(u)
        return self.log_likelihood(x) + self.log_prior(x) + jnp.sum(log_slope)

    def constrain(self, u: Float[Array, " k"]) -> Float[Array, " k"]:
        """`x` of `u`."""
        return self._bounded(u)[0]

    def unconstrain(self, x: Float[Array, " k"]) -> Float[Array, " k"]:
        """`u` of `x`."""
        return jnp.stack([to_unbounded(p, x[i]) for i, p in enumerate(self.parameters)])

    def sample_prior(self, rng: np.random.Generator, size: int) -> Float[np.ndarray, "size k"]:
        """`size` draws of `x` from the prior, inside the bounds."""
        columns = []
        for p in self.parameters:
            draws = np.empty(0)
            while draws.size < size:
                more = p.prior.sample(rng, 4 * size)
                draws = np.concatenate([draws, more[(more > p.bounds[0]) & (more < p.bounds[1])]])
            columns.append(draws[:size])
        return np.stack(columns, axis=1)

    def _bounded(self, u: Float[Array, " k"]) -> tuple[Float[Array, " k"], Float[Array, " k"]]:
        pairs = [from_unbounded(p, u[i]) for i, p in enumerate(self.parameters)]
        return jnp.stack([x for x, _ in pairs]), jnp.stack([slope for _, slope in pairs])


class Density(LogDensity):
    """Posterior log-density of the free model parameters and the noise parameters."""

    # Vectors `x` hold model parameters first, then noise (`parameters` gives the order). The observations are array
    # leaves, so that data sets of one size share compiled programs.
    observations: Observations = eqx.field(converter=lambda given: given.nameless)
    model: Model = eqx.field(static=True)
    noise: Noise = eqx.field(static=True)
    bias: Float[Array, " p"] | None = None  # of the free model parameters: coefficients follow x + bias

    @classmethod
    def of(
        cls, observations: Observations, model: Model, noise: Noise, bias: Float[np.ndarray, " p"] | None = None
    ) -> Density:
        """The density of a record under `noise`; coloured noise uses one sample in `FILTER_STEP`."""
        # Cm is formed from a smoothed and differentiated rate. The smoothing correlates neighbouring samples in a way
        # that no short autoregression describes. With every sample the autoregression would fit the smoothness, and the
        # likelihood would weigh only changes from sample to sample, in which filtered and unfiltered signals differ.
        # One sample in `FILTER_STEP` keeps the band that the filter passes, in which the coloured model holds.
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
