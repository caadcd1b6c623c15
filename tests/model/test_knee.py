"""The coordinate of samplers with a knee: a bijection with the stated slope, logarithm below and parameter above."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from bayes_aero.parameter import Parameter, Prior, from_unbounded, to_unbounded


def parameter(knee, upper):
    return Parameter("b", "1", 0.0, 2.5, "of a test", Prior("normal", 2.0, 1.0), (2.0, upper), knee=knee)


@pytest.mark.parametrize("upper", [5.0, np.inf])
@pytest.mark.parametrize("knee", [1e-3, 0.2, np.inf])
def test_it_is_a_bijection_with_the_stated_slope(knee, upper):
    p = parameter(knee, upper)
    x = jnp.asarray([2.0 + 1e-6, 2.01, 2.5, 4.9])
    u = to_unbounded(p, x)
    back, log_slope = from_unbounded(p, u)
    np.testing.assert_allclose(back - 2.0, x - 2.0, rtol=1e-9)
    slope = jax.vmap(jax.grad(lambda u: from_unbounded(p, u)[0]))(u)
    np.testing.assert_allclose(log_slope, jnp.log(slope), rtol=1e-9)


def test_small_values_are_logarithms_and_large_ones_the_parameter():
    p = parameter(0.1, np.inf)
    np.testing.assert_allclose(to_unbounded(p, jnp.asarray(2.0 + 1e-7)), np.log(1e-6), atol=1e-6)
    np.testing.assert_allclose(to_unbounded(p, jnp.asarray(4.0)), 2.0 / 0.1, rtol=1e-6)


def test_a_wide_knee_is_the_logit():
    x = jnp.asarray([2.1, 3.0, 4.5])
    np.testing.assert_allclose(
        to_unbounded(parameter(3.0 - 1e-12, 5.0), x), to_unbounded(parameter(9.0, 5.0), x), rtol=1e-9
    )
