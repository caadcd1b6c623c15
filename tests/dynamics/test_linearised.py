"""Derivatives of the linearised filter against automatic differentiation and finite differences."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from bayes_aero.dynamics.filtering.linear_innovations import Disturbances, linear_innovations, noise_derivatives
from bayes_aero.dynamics.filtering.linearised import Linearised

W, N, S, C, M = 2, 40, 3, 4, 5  # segments, samples, states, outputs, directions
DT = jnp.array([0.04, 0.05])


@pytest.fixture(scope="module")
def drawn():
    """Segments with missing samples and a state that is a process of its own; noise, and directions of it."""
    rng = np.random.default_rng(20)
    normal = lambda *shape: jnp.asarray(rng.normal(size=shape))
    residual = jnp.where(jnp.asarray(rng.random((W, N, C)) < 0.2), jnp.nan, normal(W, N, C))
    lin = Linearised(
        0.1 * normal(W, N, S),
        0.1 * normal(W, N, S),
        0.1 * normal(W, N, S),
        0.9 * jnp.eye(S) + 0.05 * normal(W, N, S, S),
        jnp.zeros((W, N, S, 0)),
        residual,
        normal(W, N, C, S),
        jnp.zeros((W, N, C, 0)),
        0.1 * normal(W, S),
        jnp.zeros((W, S, 0)),
        1.0 + 0.1 * jnp.abs(normal(W, N, C)),
        jnp.zeros((W, N, C, 0)),
    )
    decay = jnp.zeros((W, N, S)).at[..., 2].set(0.5)
    noise = Disturbances(
        jnp.abs(normal(W, N, S)), 0.1 + jnp.abs(normal(W, N, C)), jnp.eye(S) + jnp.zeros((W, S, S)), decay
    )
    start = normal(W, S, S, M)
    slopes = Disturbances(
        normal(W, N, S, M),
        normal(W, N, C, M),
        start + jnp.swapaxes(start, 1, 2),
        jnp.zeros((W, N, S, M)).at[..., 2, :].set(normal(W, N, M)),
    )
    return lin, noise, slopes


def test_the_derivative_by_the_noise_is_that_of_forward_differentiation(drawn):
    lin, noise, slopes = drawn
    found = noise_derivatives(lin, noise, slopes, DT)
    for m in range(M):
        along = Disturbances(*(x[..., m] for x in slopes))
        _, (e, variance) = jax.jvp(lambda noise: linear_innovations(lin, noise, DT), (noise,), (along,))
        np.testing.assert_allclose(found[0][..., m], e[..., 0], atol=1e-11)
        np.testing.assert_allclose(found[1][..., m], variance, atol=1e-11)
