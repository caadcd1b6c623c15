"""Log marginal likelihood and log posterior of the hyperparameters, exactly, from the reduced statistics.

log p(y | theta) = -1/2 y'K^-1 y - 1/2 log|K| - n/2 log 2 pi, and the MAP objective adds log q(theta). (Eq. 7 of
the seed paper prints a logarithm around the whole sum by mistake.) The textbook gradient
1/2 tr[(a a' - K^-1) dK/dtheta], a = K^-1 y, is assembled in two steps: the n x n step has hand-written derivatives
(`reduced.py`, through LAPACK), the (d + 2) x (d + 2) step is small enough for autodiff. Nothing differentiates through
an n x n Cholesky.
"""

from functools import lru_cache, partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from bayes_aero.inference.gp.kernel import length_slice, noise_to_signal
from bayes_aero.inference.gp.priors import Priors
from bayes_aero.inference.gp.reduced import ReducedData, ReducedStats, reduced_stats, stats_and_gradient

__all__ = ["LogDensity", "log_density", "small_likelihood"]


def small_likelihood(
    theta: Float[Array, " p"], logdet: Float[Array, ""], gram: Float[Array, "m m"], n
) -> Float[Array, ""]:
    """log p(y | theta) given the statistics at theta's own (l, g); exact, O(d^3)."""
    d = (theta.shape[0] - 3) // 2
    log_sf = theta[d + 1]
    root = jnp.exp(theta[: d + 1] - log_sf)  # D^1/2
    inner = jnp.eye(d + 1) + root[:, None] * gram[: d + 1, : d + 1] * root
    lower = jnp.linalg.cholesky(inner)
    t = jax.scipy.linalg.solve_triangular(lower, root * gram[: d + 1, d + 1], lower=True)
    quadratic = (gram[d + 1, d + 1] - t @ t) * jnp.exp(-2.0 * log_sf)
    log_k = n * 2.0 * log_sf + logdet + 2.0 * jnp.sum(jnp.log(jnp.diagonal(lower)))
    return -0.5 * (quadratic + log_k + n * jnp.log(2.0 * jnp.pi))


def small_posterior(theta, logdet, gram, n, priors: Priors) -> Float[Array, ""]:
    """log q(theta) + log p(y | theta), given the statistics."""
    return small_likelihood(theta, logdet, gram, n) + priors.log_density(theta)


@lru_cache(maxsize=16)
def compiled_posterior(priors: Priors):
    """`small_posterior` and its derivatives by theta, logdet and gram, compiled once for all n."""
    return jax.jit(jax.value_and_grad(partial(small_posterior, priors=priors), argnums=(0, 1, 2)))


class LogDensity(NamedTuple):
    """Log posterior density, its gradient (p,), and whether K was positive definite (else both are NaN)."""

    value: float
    gradient: Float[np.ndarray, " p"]
    ok: bool
    stats: ReducedStats


def log_density(
    theta: Float[np.ndarray, " p"], data: ReducedData, priors: Priors, *, gradient: bool = True
) -> LogDensity:
    """log q(theta) + log p(y | theta) at all n points, with the analytic gradient in theta (log, scaled units)."""
    d, u = data.x.shape[1], noise_to_signal(theta)
    if gradient:
        stats, du = stats_and_gradient(u, data)
    else:
        stats, du = reduced_stats(u, data), None
    if not stats.ok:
        return LogDensity(np.nan, np.full(theta.size, np.nan), False, stats)
    value, (by_theta, by_logdet, by_gram) = compiled_posterior(priors)(theta, stats.logdet, stats.gram, data.n)
    total = np.array(by_theta)
    if du is None:
        total[:] = np.nan
    else:
        by_u = float(by_logdet) * du.logdet + np.tensordot(du.gram, np.asarray(by_gram), 2)
        total[length_slice(d)] += by_u[:d]
        total[d + 1] -= 2.0 * by_u[d]
        total[-1] += 2.0 * by_u[d]
    return LogDensity(float(value), total, bool(np.isfinite(value)), stats)
