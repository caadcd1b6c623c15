"""Innovations of the linearised filter, and their derivatives by process and measurement noise.

Products of small matrices along a path whose motion is linearised already (`linearised.py`). Source: Jazwinski,
*Stochastic Processes and Filtering Theory*, 1970, ch. 8.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from bayes_aero.dynamics.filtering.kalman import discrete_noise, discrete_noise_slopes
from bayes_aero.dynamics.filtering.linearised import Linearised
from bayes_aero.dynamics.segments import SegmentTrajectories, prepare


class Disturbances(NamedTuple):
    """Noise of linearised segments.

    Spectral densities by state (w, n, s), variances of the outputs (w, n, c), covariance of the initial state
    (w, s, s), and decay (w, n, s), 1/s, of states that are random processes.
    """

    density: Float[Array, "w n s"]
    variance: Float[Array, "w n c"]
    begin: Float[Array, "w s s"]
    decay: Float[Array, "w n s"]


def disturbances_along(
    flown: SegmentTrajectories,
    theta: Float[Array, " k"],
    path: Float[Array, "w n s"],
    start_deviation: Float[Array, " s"],
    F: Float[Array, " s"],
    R: Float[Array, " c"],
) -> Disturbances:
    """The noise of `filter_segments` at the states of `path`."""
    prepared = prepare(flown, theta)
    each = jax.vmap(jax.vmap(lambda x, u: (prepared.sensed.noise_density(x, u), prepared.sensed.decay(x, u))))
    density, decay = each(path, prepared.drives)
    noise = prepared.noise_variance(R, flown.noise_growth)
    begin = prepared.initial_covariance(prepared.initial_states, start_deviation)
    return Disturbances(F**2 + density, noise, begin, decay)


def linear_innovations(
    lin: Linearised, noise: Disturbances, dt: Float[Array, " w"]
) -> tuple[Float[Array, "w n c m"], Float[Array, "w n c"]]:
    """Innovations (w, n, c, 1 + d) and their variances (w, n, c), each output given those before it in its sample.

    The first column has the innovations, the others their derivatives in the d directions at constant gains; all in
    units of the recorded channels. Missing samples have innovation 0 and variance 1.
    """
    found, S = jax.vmap(_one_segment)(lin, noise, dt)
    e, slopes = found[..., :1], found[..., 1:]
    slopes = slopes - e * lin.scale_drive / lin.scale[..., None]
    used = jnp.isfinite(lin.residual)
    S = jnp.where(used, S / lin.scale**2, 1.0)
    return jnp.concatenate([e, slopes], axis=-1) / lin.scale[..., None], S


def _one_segment(lin: Linearised, noise: Disturbances, dt: Any):
    s = lin.before.shape[-1]
    identity = jnp.eye(s)

    def one_sample(carry, row):
        mean, P = carry  # (s, 1 + d): the predicted state and its derivatives
        before, after, ahead, Phi, drive, residual, C, direct, density, variance, decay = row
        used_now = jnp.isfinite(residual)
        deviation = mean.at[:, 0].add(-before)
        e = jnp.concatenate([jnp.where(used_now, residual, 0.0)[:, None], -direct], axis=1) - C @ deviation

        def one(carry, output):
            correction, P = carry
            h, y, r, used = output
            y, Ph = y - h @ correction, P @ h
            S = h @ Ph + r
            K = jnp.where(used, Ph / S, 0.0)
            carry = correction + jnp.outer(K, y), P - jnp.outer(K, Ph)
            return carry, (jnp.where(used, y, 0.0), jnp.where(used, S, 1.0))

        (correction, P), (found, S) = jax.lax.scan(one, (jnp.zeros_like(mean), P), (C, e, variance, used_now))
        autonomous, decayed = decay > 0.0, jnp.exp(-decay * dt)
        Phi = jnp.where((identity > 0.0) & autonomous, jnp.diag(decayed), Phi)
        ahead = jnp.where(autonomous, decayed * after, ahead)
        mean = Phi @ (mean + correction).at[:, 0].add(-after)
        mean = mean + jnp.concatenate([ahead[:, None], drive], axis=1)
        P = Phi @ P @ Phi.T + discrete_noise(Phi, density, dt)
        return (mean, 0.5 * (P + P.T)), (found, S)

    begin = jnp.concatenate([lin.begin[:, None], lin.begin_drive], axis=1)
    rows = (lin.before, lin.after, lin.ahead, lin.transition, lin.drive, lin.residual, lin.matrix, lin.direct)
    rows = (*rows, noise.density, noise.variance, noise.decay)
    return jax.lax.scan(one_sample, (begin, noise.begin), rows)[1]


def noise_derivatives(
    lin: Linearised, noise: Disturbances, slopes: Disturbances, dt: Float[Array, " w"]
) -> tuple[Float[Array, "w n c m"], Float[Array, "w n c m"]]:
    """Derivatives of innovations and of their variances by parameters of the noise, in units of the recorded channels.

    `slopes` are the derivatives of `noise` in m directions, the last axis. The path and the motion along it are held.
    """
    de, dS = jax.vmap(_slopes_of_segment)(lin, noise, slopes, dt)
    used = jnp.isfinite(lin.residual)[..., None]
    unit = lin.scale[..., None]
    return jnp.where(used, de / unit, 0.0), jnp.where(used, dS / unit**2, 0.0)


def _slopes_of_segment(lin: Linearised, noise: Disturbances, slopes: Disturbances, dt: Any):
    """The derivative of `_one_segment` in closed form; directions are the last axis of every product.

    Forward differentiation has separate small products for each direction and takes twice as long.
    """
    s, m = lin.before.shape[-1], slopes.begin.shape[-1]

    def one_sample(carry, row):
        mean, P, dmean, dP = carry
        before, after, ahead, Phi, residual, C, (density, variance, decay), towards = row
        used_now = jnp.isfinite(residual)
        e = jnp.where(used_now, residual, 0.0) - C @ (mean - before)

        def one(carry, output):
            correction, P, dmean, dP = carry
            h, y, r, used, dr = output
            y, dy = y - h @ correction, -(h @ dmean)
            Ph, dPh = P @ h, jnp.sum(dP * h[:, None], axis=1)
            S, dS = h @ Ph + r, h @ dPh + dr
            K = jnp.where(used, Ph / S, 0.0)
            dK = jnp.where(used, (dPh - K[:, None] * dS) / S, 0.0)
            dP = dP - dK[:, None] * Ph[:, None] - K[:, None, None] * dPh
            after = (correction + K * y, P - jnp.outer(K, Ph), dmean + dK * y + K[:, None] * dy, dP)
            return after, (dy, dS)

        rows = (C, e, variance, used_now, towards.variance)
        (correction, P, dmean, dP), found = jax.lax.scan(one, (jnp.zeros(s), P, dmean, dP), rows, unroll=True)
        autonomous, decayed = decay > 0.0, jnp.exp(-decay * dt)
        dkept = jnp.where(autonomous, -dt * decayed, 0.0)[:, None] * towards.decay
        Phi = jnp.where((jnp.eye(s) > 0.0) & autonomous, jnp.diag(decayed), Phi)
        ahead = jnp.where(autonomous, decayed * after, ahead)
        estimate = mean + correction
        dmean = Phi @ dmean + dkept * estimate[:, None]
        turned = P @ Phi.T
        dP = (Phi @ dP.reshape(s, s * m)).reshape(s, s, m)
        dP = jnp.moveaxis(dP, 1, 0).reshape(s, s * m)
        dP = (Phi @ dP).reshape(s, s, m)  # its first two axes are the other way round, and it is symmetric
        side = dkept[:, None] * turned[:, :, None]
        dP = dP + side + jnp.moveaxis(side, 0, 1) + discrete_noise_slopes(Phi, dkept, density, towards.density, dt)
        P = Phi @ turned + discrete_noise(Phi, density, dt)
        return (Phi @ (estimate - after) + ahead, 0.5 * (P + P.T), dmean, dP), found

    begin = (lin.begin, noise.begin, jnp.zeros((s, m)), slopes.begin)
    rows = (lin.before, lin.after, lin.ahead, lin.transition, lin.residual, lin.matrix)
    rows = (*rows, (noise.density, noise.variance, noise.decay), slopes._replace(begin=jnp.zeros(len(lin.before))))
    return jax.lax.scan(one_sample, begin, rows)[1]
