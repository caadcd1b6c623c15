"""Data drawn from the kernel itself, so that the truth is known."""

import numpy as np
import pytest

from bayes_aero.inference.gp.kernel import ReducedData


def draw_from_kernel(rng, n, theta, d):
    """Inputs (n, d) and one draw of the output from the GP whose scaled log hyperparameters are theta."""
    e = np.exp(theta)
    x = rng.normal(size=(n, d))
    k = e[0] ** 2 + (x * e[1 : d + 1] ** 2) @ x.T
    distance = (((x[:, None] - x) / e[d + 2 : 2 * d + 2]) ** 2).sum(axis=-1)
    k += e[d + 1] ** 2 * np.exp(-0.5 * distance)
    return x, np.linalg.cholesky(k + e[-1] ** 2 * np.eye(n)) @ rng.normal(size=n)


@pytest.fixture
def problem():
    """A maker of small random problems: (data, theta) for a seed, a size and a number of inputs."""

    def make(seed, n=60, d=3):
        rng = np.random.default_rng(seed)
        theta = rng.uniform(-0.7, 0.7, size=2 * d + 3)
        theta[-1] -= 1.5
        x, y = draw_from_kernel(rng, n, theta, d)
        return ReducedData.of(x, y), theta

    return make
