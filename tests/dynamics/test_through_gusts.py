"""A system in random gusts against the stationary covariance of the linear system."""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.linalg import solve_continuous_lyapunov

from bayes_aero.dynamics.simulated.in_gusts import through_gusts
from bayes_aero.dynamics.system import System

RATE, GAIN, LAG, SIGMA = 2.0, 3.0, 0.8, 1.5  # 1/s, 1/s, 1/s, m/s
DT, N, COUNT = 0.02, 400, 4000


class Driven(System):
    """x' = -RATE x + GAIN g, with a gust g of standard deviation `sigma` and decay rate LAG."""

    sigma: float = eqx.field(default=SIGMA)

    @property
    def states(self):
        return ("x", "g")

    def motion(self, x, u):  # noqa: ARG002
        return jnp.stack([-RATE * x[0] + GAIN * x[1], -LAG * x[1]]), {"x": x[0], "g": x[1]}

    def noise_density(self, x, u):  # noqa: ARG002
        return jnp.stack([jnp.zeros_like(x[0]), 2.0 * LAG * self.sigma**2 + 0.0 * x[0]])

    def decay(self, x, u):  # noqa: ARG002
        return jnp.array([0.0, LAG])


def flights(sigma):
    white = jnp.asarray(np.random.default_rng(7).standard_normal((COUNT, N, 2)))
    inputs = {"u": jnp.zeros(N)}
    fly = jax.jit(jax.vmap(lambda w: through_gusts(Driven(sigma), jnp.zeros(2), inputs, DT, w, ("x", "g"))))
    found, inside = fly(white)
    assert bool(inside.all())
    return np.asarray(found)


def test_the_spread_is_that_of_the_linear_system():
    A = np.array([[-RATE, GAIN], [0.0, -LAG]])
    exact = solve_continuous_lyapunov(A, -np.diag([0.0, 2.0 * LAG * SIGMA**2]))
    assert exact[1, 1] == pytest.approx(SIGMA**2)
    assert exact[0, 0] == pytest.approx(GAIN**2 * SIGMA**2 / (RATE * (RATE + LAG)))
    found = np.cov(flights(SIGMA)[:, -1].T)
    four = 4.0 * np.sqrt(2.0 / COUNT)  # standard errors of a variance; the step of 0.02 s adds 1 %
    assert np.diag(found) == pytest.approx(np.diag(exact), rel=four + 0.01)
    assert found[0, 1] == pytest.approx(exact[0, 1], rel=four + 0.01)


def test_the_gust_itself_grows_exactly():
    """Its variance from calm air is sigma^2 (1 - exp(-2 a t)), whatever the step."""
    gust = flights(SIGMA)[:, :, 1]
    for k in (1, 20, 100):
        exact = SIGMA**2 * (1.0 - np.exp(-2.0 * LAG * DT * k))
        assert np.var(gust[:, k]) == pytest.approx(exact, rel=4.0 * np.sqrt(2.0 / COUNT))


def test_calm_air_moves_nothing():
    assert not flights(0.0).any()
