"""The extended Kalman filter and its derivatives against another library, differences and closed forms."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from bayes_aero.dynamics import kalman
from bayes_aero.dynamics.system import LinearSystem, System, advance, advance_linearised, integrate, later

# The extended Kalman filter against another library, finite differences and closed forms
DT, N = 0.04, 400
F = np.array([0.3, 0.05])
R = np.array([0.02, 0.004, 0.1]) ** 2
MATRIX = np.array([[-1.4, 40.0, -6.0, 0.1], [-0.1, -3.7, -12.0, 0.0], [-1.4, -1.5, -6.0, 0.2]])
NAMES = ("w", "q", "az")
START, P0 = np.array([0.5, 0.02]), np.diag([0.2, 0.01]) ** 2


@pytest.fixture(scope="module")
def system():
    return LinearSystem(jnp.asarray(MATRIX), ("w", "q"), ("de",), ("az",))


@pytest.fixture(scope="module")
def discrete(system):
    """An input, the transition matrix, and what the input adds in every step: by advancing unit states."""
    de, ahead = 0.05 * np.sign(np.sin(2.0 * np.pi * np.arange(N) * DT / 3.0)), eqx.filter_jit(advance)

    def step(x, k):
        now, then = ({"de": jnp.asarray(de[min(at, N - 1)])} for at in (k, k + 1))
        return np.asarray(ahead(system, jnp.asarray(x), now, then, DT, 1))

    added = np.array([step(np.zeros(2), k) for k in range(N)])
    return de, np.array([step(e, 0) - added[0] for e in np.eye(2)]).T, added


@pytest.fixture(scope="module")
def record(discrete):
    """A disturbed flight with noise, an output at a fifth of the rate, and a gap."""
    rng, (de, transition, added) = np.random.default_rng(7), discrete
    x, rows = START + np.sqrt(np.diag(P0)) * rng.standard_normal(2), []
    for u, step in zip(de, added, strict=True):
        rows.append([*x, MATRIX[2] @ [*x, u, 1.0]])
        x = transition @ x + step + np.sqrt(DT) * F * rng.standard_normal(2)
    z = np.array(rows) + np.sqrt(R) * rng.standard_normal((N, 3))
    z[np.arange(N) % 5 != 0, 2] = np.nan
    z[120:160, 0] = np.nan
    return z


@eqx.filter_jit
def filtered(system, de, z, P0, F, start=START):
    inputs, variance = {"de": jnp.asarray(de)}, jnp.tile(jnp.asarray(R), (N, 1))
    given = jnp.asarray(start), jnp.asarray(P0), inputs, later(inputs), jnp.asarray(z), variance, jnp.ones((N, 3)), DT
    return kalman.kalman_filter(system, kalman.FilterInputs(*given), jnp.asarray(F), NAMES)


def test_a_filter_that_has_diverged_has_no_likelihood_and_its_outputs_are_not_missing(system, discrete, record):
    lost = filtered(system, discrete[0], record, P0, F, np.array([np.inf, 0.02]))
    np.testing.assert_array_equal(lost.used, np.isfinite(record))
    assert not np.isfinite(kalman.log_likelihood(lost))


def test_a_linear_system_agrees_with_statsmodels(system, discrete, record):
    """Likelihood, predictions, estimates and smoothed states to 1e-8, missing samples included."""
    mlemodel = pytest.importorskip("statsmodels.tsa.statespace.kalman_smoother")
    (de, transition, added), z = discrete, record
    # test_gusts holds the noise of a step against Van Loan's integral.
    noise = np.asarray(kalman.discrete_noise(jnp.asarray(transition), jnp.asarray(F**2), DT))
    other = mlemodel.KalmanSmoother(k_endog=3, k_states=2)
    other.bind(z)
    other["design"] = np.concatenate([np.eye(2), MATRIX[2:, :2]])
    shift = MATRIX[2, 2] * de + MATRIX[2, 3]
    other["obs_intercept"] = np.stack([np.zeros(N), np.zeros(N), shift])
    other["obs_cov"], other["transition"], other["selection"] = np.diag(R), transition, np.eye(2)
    other["state_intercept"], other["state_cov"] = added.T, noise
    other.initialize_known(START, P0)
    theirs, ours = other.smooth(), filtered(system, de, z, P0, F)
    assert float(kalman.log_likelihood(ours)) == pytest.approx(theirs.llf, rel=1e-8)
    np.testing.assert_allclose(ours.predicted, theirs.predicted_state.T[:-1], rtol=1e-8, atol=1e-8)
    np.testing.assert_allclose(ours.state, theirs.filtered_state.T, rtol=1e-8, atol=1e-8)
    np.testing.assert_allclose(ours.covariance, np.moveaxis(theirs.filtered_state_cov, 2, 0), rtol=1e-8, atol=1e-12)
    x, P = eqx.filter_jit(kalman.smooth)(ours)
    np.testing.assert_allclose(x, theirs.smoothed_state.T, rtol=1e-7, atol=1e-8)
    np.testing.assert_allclose(P, np.moveaxis(theirs.smoothed_state_cov, 2, 0), rtol=1e-7, atol=1e-10)


def test_innovations_without_process_noise_are_those_of_output_error(system, discrete, record):
    """They are the residuals of the simulation, their variance that of the measurement."""
    de, z = discrete[0], record
    found = filtered(system, de, z, np.zeros((2, 2)), np.zeros(2))
    flown = eqx.filter_jit(integrate)(system, jnp.asarray(START), {"de": jnp.asarray(de)}, DT)
    residual = z - np.stack([flown.outputs[name] for name in NAMES], axis=1)
    used = np.asarray(found.used)
    np.testing.assert_allclose(np.asarray(found.innovation)[used], residual[used], rtol=1e-8, atol=1e-10)
    np.testing.assert_allclose(found.variance[used], np.tile(R, (N, 1))[used], rtol=1e-12)


def test_gains_are_those_of_the_whole_sample_and_ask_no_library():
    """P C' S^-1, and the inverse of the unit factor of S: numpy's."""
    rng, there = np.random.default_rng(3), np.arange(7) != 2
    root, C, variance = rng.normal(size=(5, 5)), rng.normal(size=(7, 5)), rng.uniform(0.1, 2.0, 7)
    P, seen = root @ root.T, C[there]
    gain, innovate = jax.jit(kalman.gains)(P, C, variance, there)
    S = seen @ P @ seen.T + np.diag(variance[there])
    factor = np.linalg.cholesky(S)
    np.testing.assert_allclose(gain[:, there], np.linalg.solve(S, seen @ P).T, atol=1e-12)
    np.testing.assert_array_equal(gain[:, ~there], 0.0)
    np.testing.assert_allclose(innovate[np.ix_(there, there)], np.linalg.inv(factor / np.diag(factor)), atol=1e-12)
    # Two calls of LAPACK for a thousand matrices each, in one program, wait for each other on two cores.
    many = (jnp.broadcast_to(x, (1000, *np.shape(x))) for x in (P, C, variance, there))
    assert "custom_call" not in jax.jit(jax.vmap(kalman.gains)).lower(*many).as_text()


def test_a_transition_by_one_jacobian_is_off_by_the_third_power_of_the_step():
    """Of a pendulum that swings far, with a moment, against JAX's derivative of Runge and Kutta's step."""

    class Pendulum(System):
        @property
        def states(self):
            return ("angle", "rate")

        def motion(self, x, u):
            return jnp.stack([x[1], u["moment"] - 9.0 * jnp.sin(x[0]) - x[1] * jnp.abs(x[1])]), {}

    x, now = jnp.array([1.0, 2.0]), {"moment": jnp.asarray(0.5)}

    def apart(dt, substeps):
        then = {"moment": jnp.asarray(0.5 + 5.0 * dt)}
        ahead, transition = advance_linearised(Pendulum(), x, now, then, dt, substeps)
        wanted, slope = kalman.value_and_slope(lambda x: advance(Pendulum(), x, now, then, dt, substeps), x)
        np.testing.assert_allclose(ahead, wanted, rtol=1e-12)
        return float(np.abs(transition - slope).max())

    errors = [apart(dt, 1) for dt in (0.08, 0.04, 0.02)]
    assert 0.0 < errors[0] < 1e-2
    np.testing.assert_allclose(np.divide(errors[:-1], errors[1:]), 8.0, rtol=0.2)
    assert apart(0.08, 2) == pytest.approx(errors[0] / 4.0, rel=0.2)
