"""The stand-in reproduces its data, its derivatives and a held-back point, and stays put outside."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from bayes_aero.inference.gp.emulator import ExactPoint, fit_emulator, outputs
from bayes_aero.inference.gp.kernel import noise_to_signal
from bayes_aero.inference.gp.reduced import stats_and_gradient


@pytest.fixture
def trained(problem):
    data, theta = problem(7, n=80, d=2)
    centre = noise_to_signal(theta)
    rng = np.random.default_rng(0)
    points = []
    for _ in range(60):
        u = centre + 0.15 * rng.normal(size=centre.size)
        points.append(ExactPoint(u, *stats_and_gradient(u, data)))
    return points, fit_emulator(points[:40], np.zeros(40))


def test_derivatives_of_the_outputs_are_finite_differences(problem):
    data, theta = problem(8, n=50, d=2)
    u = noise_to_signal(theta)

    def at(v):
        return outputs(ExactPoint(v, *stats_and_gradient(v, data)))

    numeric = [(at(u + s)[0] - at(u - s)[0]) / 2e-5 for s in 1e-5 * np.eye(u.size)]
    np.testing.assert_allclose(at(u)[1], numeric, rtol=1e-5, atol=1e-6)


def test_held_back_points_are_predicted(trained):
    points, emulator = trained
    for p in points[40:]:
        logdet, gram, _ = emulator(jnp.asarray(p.u))
        assert float(logdet) == pytest.approx(p.stats.logdet, abs=0.02)
        np.testing.assert_allclose(gram, p.stats.gram, rtol=1e-2, atol=1e-2 * np.max(p.stats.gram))


def test_outside_its_data_it_is_held_and_fenced(trained):
    points, emulator = trained
    far = jnp.asarray(points[0].u + 5.0)
    farther = emulator.centre + 3.0 * (far - emulator.centre)
    (a, _, near_penalty), (b, _, far_penalty) = emulator(far), emulator(farther)
    assert float(a) == pytest.approx(float(b), abs=1.0)
    assert float(far_penalty) < float(near_penalty) < -10
    assert np.all(np.isfinite(jax.grad(lambda u: emulator(u)[2])(far)))
    assert float(emulator(emulator.centre)[2]) == 0.0


def test_the_degree_falls_to_what_the_points_carry(trained):
    points, _ = trained
    few = fit_emulator(points[:8], np.zeros(8))  # 32 rows: quadratic in three variables has 10 terms, cubic 20
    corner = np.asarray(few.coefficients)[:4, :4]
    assert np.count_nonzero(few.coefficients) <= 10 * few.coefficients.shape[-1]
    assert np.all(np.isfinite(corner))


def test_improbable_points_neither_bend_it_nor_support_it(trained):
    points, emulator = trained
    junk = [p._replace(u=p.u + 3.0) for p in points[40:50]]
    again = fit_emulator([*points[:40], *junk], np.append(np.zeros(40), np.full(10, -1e4)))
    at = jnp.asarray(points[55].u)
    assert float(again(at)[0]) == pytest.approx(float(emulator(at)[0]), abs=0.05)
    assert float(again(jnp.asarray(junk[0].u))[2]) < -10


def test_values_without_derivatives_train_it_too(trained):
    points, _ = trained
    mixed = [*points[:20], *(p._replace(gradient=None) for p in points[20:50])]
    emulator = fit_emulator(mixed, np.zeros(50))
    for p in points[50:]:
        assert float(emulator(jnp.asarray(p.u))[0]) == pytest.approx(p.stats.logdet, abs=0.05)
