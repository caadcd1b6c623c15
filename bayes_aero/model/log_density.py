"""A log-density: likelihood and priors of named parameters, on the scale of the data and on the whole real line."""

from __future__ import annotations

from abc import abstractmethod

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from bayes_aero.parameter import Parameter, from_unbounded, to_unbounded


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
