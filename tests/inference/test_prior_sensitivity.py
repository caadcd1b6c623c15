"""Sensitivity to priors where the answer is known: a normal mean with a vague, an informative and a deciding prior."""

import jax.numpy as jnp
import numpy as np
import pytest

from bayes_aero.inference.posterior.assembly import Drawn, assemble
from bayes_aero.inference.posterior.prior_sensitivity import Dependence, prior_sensitivity
from bayes_aero.model.log_density import LogDensity
from bayes_aero.parameter import Parameter, Prior


class Mean(LogDensity):
    """Twenty-five measurements of unit deviation about 1; the prior's mean is 0."""

    width: float

    @property
    def parameters(self):
        return (Parameter("m", "1", 0.0, 0.0, "a mean", Prior("normal", 0.0, self.width)),)

    @property
    def noise_label(self):
        return "white"

    def log_likelihood(self, x):
        return -0.5 * 25.0 * jnp.square(x[0] - 1.0)


@pytest.mark.parametrize(
    ("width", "says"),
    [(100.0, Dependence.DATA), (0.2, Dependence.BOTH), (0.005, Dependence.PRIOR)],
)
def test_a_prior_is_told_by_its_width(width, says):
    """Draws from the closed form: precision 25 + width^-2, mean 25 over it."""
    precision = 25.0 + width**-2.0
    draws = 25.0 / precision + np.random.default_rng(1).standard_normal((4, 1000, 1)) / np.sqrt(precision)
    density = Mean(width)
    posterior = assemble(density, Drawn("closed form", draws), seed=0, seconds=0.0)
    row = prior_sensitivity(density, posterior).loc["m"]
    assert row["says"] == says.value
