"""Parameters that scatter from manoeuvre to manoeuvre around the aircraft's: partial pooling by NUTS.

All is in units of the parameters' priors: an aircraft's value is a standard normal one. A manoeuvre is its normal
approximation, an estimate y with information F F', which may be singular. Given the scatter, the parameters of the
aircraft and of the manoeuvres are normal: they are integrated out, and NUTS samples the scatter alone.

Source: Gelman et al., *Bayesian Data Analysis*, 3rd ed. 2013, ch. 5; half-normal scatter: Gelman, Bayesian Analysis 1
(2006) 515.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from bayes_aero.inference.posterior.laplace import find_mode
from bayes_aero.inference.posterior.nuts import NutsLength, sample_nuts
from bayes_aero.inference.posterior.posterior import Posterior
from bayes_aero.model.log_density import LogDensity
from bayes_aero.parameter import Parameter, Prior
from bayes_aero.progress import Progress

SCATTER = 0.5  # of a prior's deviation: 95 % sure that flights of one aircraft differ less than aircraft do; our choice


class Hierarchy(LogDensity):
    """Density of the scatter of k parameters between m manoeuvres; `x` are its standard deviations.

    Attributes:
        scattering: the scatter of each parameter, with its prior.
        estimate: of each manoeuvre, shape (m, k).
        factor: F of each information matrix F F', shape (m, k, k).
    """

    scattering: tuple[Parameter, ...] = eqx.field(static=True)
    estimate: Float[Array, "m k"]
    factor: Float[Array, "m k k"]

    @classmethod
    def of(
        cls, names: Sequence[str], estimate: Float[np.ndarray, "m k"], information: Float[np.ndarray, "m k k"]
    ) -> Hierarchy:
        """The density of estimates with their information matrices, in units of the priors."""
        prior = Prior("halfnormal", 0.0, SCATTER)
        text = "standard deviation between manoeuvres, in units of the prior's"
        scattering = tuple(Parameter(name, "1", 0.0, SCATTER, text, prior, (0.0, np.inf)) for name in names)
        size, vectors = np.linalg.eigh(information)
        factor = vectors * np.sqrt(np.maximum(size, 0.0))[:, None, :]
        return cls(scattering, jnp.asarray(estimate), jnp.asarray(factor))

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The scatter of each parameter."""
        return self.scattering

    @property
    def noise_label(self) -> str:
        """How the manoeuvres enter."""
        return "normal approximation"

    def log_likelihood(self, x: Float[Array, " k"]) -> Float[Array, ""]:
        """Log-density of the estimates at the scatter `x`, up to a constant; all other parameters are integrated out.

        A manoeuvre's estimate has the precision P = (inv(F F') + T)^-1 = F (I + F' T F)^-1 F' about the aircraft's
        parameters, with T = diag x^2. This form needs no inverse of F F' and does not cancel.
        """
        left, log_det = jax.vmap(self._whitened, in_axes=(0, None))(self.factor, x)
        weighed = jnp.einsum("mij,mj->mi", left, self.estimate)
        precision = jnp.eye(self.size) + jnp.einsum("mij,mik->jk", left, left)
        lower = jnp.linalg.cholesky(precision)
        mean = jax.scipy.linalg.solve_triangular(lower, jnp.einsum("mij,mi->j", left, weighed), lower=True)
        determinants = jnp.sum(log_det) + jnp.sum(jnp.log(jnp.diag(lower)))
        return 0.5 * (jnp.sum(mean**2) - jnp.sum(weighed**2)) - determinants

    def _whitened(self, factor: Float[Array, "k k"], x: Float[Array, " k"]) -> tuple[Float[Array, "k k"], Array]:
        """W with W' W = P, and half the log-determinant of I + F' T F."""
        scaled = x[:, None] * factor
        lower = jnp.linalg.cholesky(jnp.eye(self.size) + scaled.T @ scaled)
        return jax.scipy.linalg.solve_triangular(lower, factor.T, lower=True), jnp.sum(jnp.log(jnp.diag(lower)))


class Pooled(NamedTuple):
    """Draws in units of the priors: aircraft, scatter, following flight (chain, draw, k), manoeuvres (.., m, k)."""

    aircraft: Float[np.ndarray, "chain draw k"]
    scatter: Float[np.ndarray, "chain draw k"]
    following: Float[np.ndarray, "chain draw k"]
    manoeuvres: Float[np.ndarray, "chain draw m k"]


def pool(
    density: Hierarchy, *, seed: int = 0, length: NutsLength = NutsLength(), progress: Progress | None = None
) -> tuple[Pooled, Posterior]:
    """Sample the scatter by NUTS, and all else from its normal distribution given the scatter.

    Args:
        density: estimates of the manoeuvres.
        seed: of chains and draws.
        length: of the chains.
        progress: called after each block of draws.

    Returns:
        The draws, and the posterior of the scatter with R-hat, effective sample sizes and a status.
    """
    mode = find_mode(density, np.full(density.size, SCATTER))
    sampled = sample_nuts(density, mode, seed=seed, length=length, progress=progress, predictive=False)
    posterior = sampled.tree["posterior"].to_dataset()
    scatter = np.stack([np.asarray(posterior[name]) for name in density.names], axis=-1)
    return given_scatter(density, scatter, np.random.default_rng([seed, 5])), sampled


def given_scatter(density: Hierarchy, scatter: Float[np.ndarray, "chain draw k"], rng: np.random.Generator) -> Pooled:
    """A draw of the aircraft, of each manoeuvre and of the next flight for each draw of the scatter."""
    estimate, factor = np.asarray(density.estimate), np.asarray(density.factor)
    one = np.eye(density.size)
    precision, weighed = np.broadcast_to(one, (*scatter.shape, density.size)).copy(), np.zeros(scatter.shape)
    for y, F in zip(estimate, factor, strict=True):
        scaled = scatter[..., :, None] * F
        P = F @ np.linalg.solve(one + np.swapaxes(scaled, -1, -2) @ scaled, np.broadcast_to(F.T, scaled.shape))
        precision += P
        weighed += P @ y
    aircraft = _normal(precision, weighed, rng)
    manoeuvres = []
    for y, F in zip(estimate, factor, strict=True):
        scaled = scatter[..., :, None] * F
        pulled = np.einsum("...ij,...j->...i", scaled, (y - aircraft) @ F)
        offset = _normal(one + scaled @ np.swapaxes(scaled, -1, -2), pulled, rng)
        manoeuvres.append(aircraft + scatter * offset)
    following = aircraft + scatter * rng.standard_normal(scatter.shape)
    return Pooled(aircraft, scatter, following, np.stack(manoeuvres, axis=-2))


def _normal(
    precision: Float[np.ndarray, "*s k k"], weighed: Float[np.ndarray, "*s k"], rng: np.random.Generator
) -> Float[np.ndarray, "*s k"]:
    """Draws of normal distributions with these precisions and precision-weighted means."""
    upper = np.swapaxes(np.linalg.cholesky(precision), -1, -2)
    mean = np.linalg.solve(precision, weighed[..., None])
    return (mean + np.linalg.solve(upper, rng.standard_normal((*weighed.shape, 1))))[..., 0]
