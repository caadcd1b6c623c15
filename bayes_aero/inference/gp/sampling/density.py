"""Log marginal likelihood and log posterior of the hyperparameters, exactly, from the reduced statistics.

log p(y | theta) = -1/2 y'K^-1 y - 1/2 log|K| - n/2 log 2 pi, and the MAP objective adds log q(theta). (Eq. 7 of
the seed paper prints a logarithm around the whole sum by mistake.) The textbook gradient
1/2 tr[(a a' - K^-1) dK/dtheta], a = K^-1 y, is assembled in two steps: the n x n step has hand-written derivatives
(`reduced.py` on the host through LAPACK; `device_stats` here in JAX, a custom VJP, for any device), the
(d + 2) x (d + 2) step is small enough for autodiff. Nothing differentiates through an n x n Cholesky.
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

__all__ = ["LogDensity", "device_stats", "log_density", "log_likelihood_device", "small_likelihood"]


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


@jax.custom_vjp
def device_stats(
    u: Float[Array, " u"], x: Float[Array, "n d"], fy: Float[Array, "n m"]
) -> tuple[Float[Array, ""], Float[Array, "m m"]]:
    """`reduced_stats` in JAX, traceable, on whatever device the arrays live; differentiable in u only."""
    return _device_forward(u, x, fy)[0]


def _device_forward(u, x, fy):
    d = x.shape[1]
    x, g = x / jnp.exp(u[:d]), jnp.exp(u[d])
    half = 0.5 * jnp.sum(x * x, axis=1)
    se = jnp.exp(jnp.clip(x @ x.T - half[:, None] - half, -300.0, 0.0))
    eye = jnp.eye(x.shape[0])
    se = jnp.where(eye > 0, 1.0, se)
    lower = jnp.linalg.cholesky(se + g * eye)
    v = jax.scipy.linalg.cho_solve((lower, True), fy)
    logdet = 2.0 * jnp.sum(jnp.log(jnp.diagonal(lower)))
    return (logdet, fy.T @ v), (x, g, se, lower, v)


def _device_fwd(u, x, fy):
    """Statistics, and as residuals only their derivatives: nothing n x n outlives the forward pass."""
    out, (x, g, se, lower, v) = _device_forward(u, x, fy)
    xv = x.T[:, :, None] * v  # (d, n, m)
    se_v, se_xv = se @ v, jnp.einsum("ij,kjm->kim", se, xv)
    cross = jnp.einsum("kia,ib->kab", x.T[:, :, None] * xv, se_v)
    by_length = 2.0 * jnp.einsum("kia,kib->kab", xv, se_xv) - cross - jnp.swapaxes(cross, 1, 2)
    d_gram = jnp.concatenate([by_length, -g * (v.T @ v)[None]])
    inverse = jax.scipy.linalg.cho_solve((lower, True), jnp.eye(x.shape[0]))
    weight = inverse * se
    traces = 2.0 * ((x * x).T @ weight.sum(axis=1) - jnp.sum(x * (weight @ x), axis=0))
    d_logdet = jnp.append(traces, g * jnp.trace(inverse))
    return out, (d_logdet, d_gram)


def _device_bwd(residuals, cotangent):
    d_logdet, d_gram = residuals
    by_logdet, by_gram = cotangent
    return by_logdet * d_logdet + jnp.einsum("kab,ab->k", d_gram, by_gram), None, None


device_stats.defvjp(_device_fwd, _device_bwd)


def log_likelihood_device(
    theta: Float[Array, " p"], x: Float[Array, "n d"], fy: Float[Array, "n m"]
) -> Float[Array, ""]:
    """log p(y | theta) in JAX with the custom VJP: for exact NUTS on small n, and for an accelerator."""
    d = x.shape[1]
    u = jnp.append(theta[length_slice(d)], 2.0 * (theta[-1] - theta[d + 1]))
    logdet, gram = device_stats(u, x, fy)
    return small_likelihood(theta, logdet, 0.5 * (gram + gram.T), x.shape[0])
