"""Fits and posteriors with process noise, against the truth, finite differences and quadrature on a grid."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from linear_cards import FIRST_ORDER, card_of, disturbed_first_order
from scipy import stats

from bayes_aero.dynamics.flight import Dynamics, aircraft_dynamics
from bayes_aero.dynamics.innovations import filter_segments
from bayes_aero.dynamics.kalman import NoisePoint, innovations_density, log_likelihood
from bayes_aero.dynamics.linear import linear_dynamics
from bayes_aero.dynamics.segments import segments, simulate
from bayes_aero.dynamics.system import System, advance
from bayes_aero.flight.card import read_card
from bayes_aero.flight.reading import read_record
from bayes_aero.flight.record import FlightRecord
from bayes_aero.inference import prediction_error
from bayes_aero.inference.ensemble import EnsembleLength
from bayes_aero.inference.nuts import (
    SPREAD,
    NutsLength,
    PosteriorLength,
    WarmUp,
    innovations_posterior,
    sample_innovations,
)
from bayes_aero.inference.optimise import (
    APPROXIMATE_SCORING,
    MAX_ITERATIONS,
    SCORING,
    Evaluation,
    bfgs_update,
    bounded_step,
    minimise,
)
from bayes_aero.inference.prediction_error import PredictionErrorStatus, covariance_of, fit_prediction_error
from bayes_aero.inference.results import PosteriorStatus
from bayes_aero.model.joined_channels import join
from bayes_aero.model.model import Model
from bayes_aero.parameter import Parameter, Prior
from bayes_aero.physics.aircraft import FLIGHT

# Parameters, process noise and measurement noise of a simulated disturbed flight, jointly, against the truth
BOOK = Path(__file__).resolve().parents[3] / "shared" / "book"
TRUTH = {"Zw": -1.4249, "Zde": -6.2632, "Mw": -0.05, "Mq": -3.7067, "Mde": -12.78}  # as the unstable card, made stable
F, R = np.array([0.8, 0.06]), np.array([0.15, 0.01, 0.4]) ** 2  # w, q; w, q, az
DT, N = 0.05, 1200


@pytest.fixture(scope="module")
def flown():
    """One manoeuvre of a minute in disturbed air; az at every second sample, a gap in q."""
    card = read_card("unstable")
    dynamics = linear_dynamics(card)
    values = dynamics.fixed | TRUTH
    rng, t = np.random.default_rng(11), DT * np.arange(N)
    de = 0.06 * np.sign(np.sin(2.0 * np.pi * t / 7.0)) + 0.03 * np.sign(np.sin(2.0 * np.pi * t / 2.3))
    system = dynamics.system({name: jnp.asarray(x) for name, x in values.items()}, card.aircraft)
    ahead, x, rows = eqx.filter_jit(advance), np.zeros(2), []
    for k in range(N):
        az = values["Zw"] * x[0] + values["Zq"] * x[1] + values["Zde"] * de[k]
        rows.append([*x, az])
        now, then = ({"elevator": jnp.asarray(de[min(k + i, N - 1)]), "1": jnp.asarray(1.0)} for i in (0, 1))
        x = np.asarray(ahead(system, jnp.asarray(x), now, then, DT, 1)) + np.sqrt(DT) * F * rng.standard_normal(2)
    z = np.array(rows) + np.sqrt(R) * rng.standard_normal((N, 3))
    channels = {"w": z[:, 0], "q": z[:, 1], "az": z[:, 2], "elevator": de}
    record = FlightRecord.from_arrays("disturbed", t, channels, "simulated")
    return segments(join([record], card, ()), dynamics, fixed=card.fly.initial_state)


def test_the_truth_is_recovered_and_without_process_noise_the_fit_is_worse(flown):
    """Every parameter within 3.5 standard errors; process and measurement noise within 3.5 of their own."""
    found = fit_prediction_error(flown, np.full(2, 0.2), 4.0 * R[[0, 1, 2]], priors=False)
    assert found.status is PredictionErrorStatus.CONVERGED
    order = [found.outputs.index(name) for name in ("w", "q", "az")]
    sd = np.sqrt(np.diag(found.covariance))
    for name, estimate, error in zip(found.names, found.estimate, found.sd, strict=True):
        assert abs(estimate - TRUTH[name]) < 3.5 * error, name
        assert error < 0.2 * abs(TRUTH[name]) or name == "Mw"
    k = len(found.names)
    assert np.all(np.abs(np.log(found.F / F)) < 3.5 * sd[k : k + 2])
    assert np.all(np.abs(np.log(found.R[order] / R)) < 3.5 * sd[k + 2 :][order])
    used = np.asarray(found.found.used)[0]
    e = np.asarray(found.found.innovation / np.sqrt(found.found.variance))[0]
    for c in range(3):
        white = e[used[:, c], c]
        assert abs(np.corrcoef(white[1:], white[:-1])[0, 1]) < 4.0 / np.sqrt(len(white))
    # F of 0 is held; the likelihood of a disturbed flight is far lower without it.
    still = fit_prediction_error(flown, np.zeros(2), 20.0 * R, priors=False)
    free = fit_prediction_error(flown, F, R, priors=False)
    np.testing.assert_array_equal(still.F, 0.0)
    assert free.log_likelihood - still.log_likelihood > 100.0


def test_the_gradient_is_that_of_finite_differences(flown):
    point = np.array([*(0.9 * TRUTH[n] for n in flown.dynamics.names), *np.log(F), *np.log(R)])
    problem = prediction_error._Problem.of(flown.nameless, None, {}, F > 0.0, True)
    gradient = problem.evaluate(point).gradient
    for i, g in enumerate(gradient):
        h = 1e-5 * max(1.0, abs(point[i])) * (np.arange(len(point)) == i)
        difference = (problem.cost(point + h) - problem.cost(point - h)) / (2.0 * h.sum())
        assert g == pytest.approx(difference, rel=1e-4, abs=1e-3), i


@pytest.mark.skipif(not BOOK.is_dir(), reason="needs ../shared/book")
def test_without_process_noise_it_is_output_error():
    """Of the HFB-320's flight."""
    card = read_card("hfb320")
    flights = join([read_record(BOOK / "hfb320_1_10.asc", card.channels)], card, FLIGHT)
    dynamics = aircraft_dynamics(Model.from_card(card), flights, card.fly.outputs or ())
    whole = segments(flights, dynamics, outputs=card.fly.outputs, fixed=card.fly.initial_state).nameless
    theta = jnp.asarray([p.start for p in dynamics.free])
    residual = np.asarray(simulate(whole, theta, jnp.zeros((1, 4))).residual)
    R = jnp.asarray(residual.reshape(-1, 7).var(axis=0))
    found = filter_segments(whole, theta, jnp.zeros(4), jnp.zeros(4), R)
    np.testing.assert_allclose(found.innovation, residual, rtol=1e-8, atol=1e-8)


def test_the_noise_of_a_smoothed_channel_is_no_less_than_that_of_its_last_digit(flown):
    """Smoothed, a channel has less noise from sample to sample than a state alone; its likelihood asks for none."""
    step, channels = 0.05, {name: np.asarray(x) for name, x in flown.flights.channels.items()}
    smooth = np.convolve(np.pad(channels["w"], 5, mode="edge"), np.full(11, 1.0 / 11.0), mode="valid")
    record = FlightRecord.from_arrays(
        "rounded",
        DT * np.arange(N),
        {name: channels[name] for name in ("q", "az", "elevator")} | {"w": step * np.round(smooth / step)},
    )
    own = segments(join([record], read_card("unstable"), ()), flown.dynamics, fixed=dict(flown.fixed))
    found = fit_prediction_error(own, np.full(2, 0.2), 4.0 * R[[0, 1, 2]], priors=False)
    assert found.status is PredictionErrorStatus.CONVERGED
    assert found.R[found.outputs.index("w")] == pytest.approx(step**2 / 12.0)
    assert np.all(found.R[[found.outputs.index(name) for name in ("q", "az")]] > 0.1 * R[1:])


class Overshooting:
    """A quadratic cost with `times` the curvature that its information has."""

    def __init__(self, times: float):
        rng = np.random.default_rng(5)
        factor = rng.standard_normal((6, 6))
        self.information, self.times, self.moving = factor @ factor.T + np.eye(6), times, np.full(6, True)
        self.bounds, self.step_limit = np.tile([-np.inf, np.inf], (6, 1)), np.full(6, np.inf)

    def cost(self, point):
        return 0.5 * self.times * float(point @ self.information @ point)

    def evaluate(self, point):
        return Evaluation(self.cost(point), self.times * self.information @ point, self.information)


@pytest.mark.parametrize("times", [0.5, 1.0, 1.97])
def test_steps_that_go_too_far_are_shortened(times):
    """Newton's steps from 30 would take log(1e6) / log(1 / 0.97^2) = 227 steps by an information half of what it is."""
    problem = Overshooting(times)
    _, here, converged, steps = minimise(problem, np.full(6, 30.0), problem.evaluate, 1e-3)
    assert converged
    assert steps < MAX_ITERATIONS / 2
    assert here.cost < 0.01


def test_bounded_steps_are_optimal_and_corrected_curvatures_stay_positive():
    rng = np.random.default_rng(2)
    for _ in range(20):
        factor = rng.standard_normal((8, 8)) * np.logspace(0.0, 4.0, 8)
        A, g = factor.T @ factor, rng.standard_normal(8) * np.logspace(0.0, 8.0, 8)
        newton = np.linalg.solve(A, g)
        room = np.sort(newton[:, None] * rng.uniform(-1.5, 1.5, (8, 2)), axis=1) + np.array([-1e-9, 1e-9])
        step = bounded_step(A, g, room, 0.0)
        left, tolerance = (g - A @ step) / np.sqrt(np.diag(A)), 1e-6 * np.linalg.norm(g / np.sqrt(np.diag(A)))
        low, high = np.isclose(step, room[:, 0], rtol=1e-9), np.isclose(step, room[:, 1], rtol=1e-9)
        assert np.all((step > room[:, 0] - 1e-9 * abs(room[:, 0])) & (step < room[:, 1] + 1e-9 * abs(room[:, 1])))
        assert np.all(np.abs(left[~low & ~high]) < tolerance)
        assert np.all(left[low & ~high] < tolerance)
        assert np.all(left[high & ~low] > -tolerance)
        assert low.any() or high.any()
    rng = np.random.default_rng(5)
    for _ in range(20):
        factor, step = rng.standard_normal((6, 6)), rng.standard_normal(6)
        A = factor @ factor.T + np.eye(6)
        change = A @ step + 0.3 * rng.standard_normal(6) * np.linalg.norm(A @ step)
        B = bfgs_update(A, step, change)
        if step @ change > 0.2 * step @ A @ step:
            np.testing.assert_allclose(B @ step, change, rtol=1e-9, atol=1e-9 * float(np.linalg.norm(change)))
        assert np.min(np.linalg.eigvalsh(bfgs_update(A, step, -change))) > 0.0


class Bowl(Overshooting):
    """A quadratic cost with a curvature of its own and an information of one."""

    def __init__(self, curvature: list[float]):
        super().__init__(1.0)
        self.curvature, self.information = np.diag([*curvature, 1.0, 1.0]), np.eye(6)

    def cost(self, point):
        return 0.5 * float(point @ self.curvature @ point)

    def evaluate(self, point):
        return Evaluation(self.cost(point), self.curvature @ point, self.information)


def test_gradients_mend_an_information_that_is_not_the_curvature():
    """Off by factors of .2 to 5; steps by the information alone crawl along the flat direction."""
    bowl = Bowl([5.0, 0.05, 0.2, 3.0])
    rules = {False: SCORING, True: APPROXIMATE_SCORING}
    steps = {key: minimise(bowl, np.full(6, 10.0), bowl.evaluate, 1e-6, rule)[3] for key, rule in rules.items()}
    assert minimise(bowl, np.full(6, 10.0), bowl.evaluate, 1e-6)[1].cost < 1e-5
    assert 2 * steps[False] < steps[True]


def test_the_covariance_knows_lengths_beside_angles():
    """Scales from 1e-6 to 1e6: a pseudo-inverse of the information itself drops the large errors."""
    rng = np.random.default_rng(8)
    factor, scale = rng.standard_normal((5, 5)), np.logspace(-6.0, 6.0, 5)
    correlated = factor @ factor.T + np.eye(5)
    information = np.zeros((6, 6))
    information[:5, :5] = correlated / np.outer(scale, scale)
    found = covariance_of(information, np.array([True] * 6))
    np.testing.assert_allclose(found[:5, :5], np.linalg.inv(correlated) * np.outer(scale, scale), rtol=1e-9)
    assert not found[5].any()


# The posterior with process noise: its density and gradient, and both samplers against quadrature on a grid
SCALAR_DT, SCALAR_N, ZALPHA, SCALAR_F, SIGMA = 0.05, 160, -0.8, 0.03, 0.01


@pytest.fixture(scope="module")
def scalar():
    """One state, disturbed, measured with noise; the samples of a gap are missing."""
    channels = disturbed_first_order(SCALAR_N, SCALAR_DT, ZALPHA, SCALAR_F, SIGMA)
    z, de = channels["alpha"], channels["elevator"]
    z[60:70] = np.nan
    card = card_of(FIRST_ORDER)
    record = FlightRecord.from_arrays("disturbed", SCALAR_DT * np.arange(SCALAR_N), channels, "simulated")
    flown = segments(join([record], card, ()), linear_dynamics(card), fixed={"alpha": 0.0}, held=True)
    return flown, z, de


@pytest.fixture(scope="module")
def fitted(scalar):
    return fit_prediction_error(scalar[0], np.array([0.02]), np.array([2e-4]))


def scalar_likelihood(z, de, a, f, sigma):
    """A Kalman filter of one state with exact transitions, for arrays of parameters."""
    phi, driven = np.exp(a * SCALAR_DT), (np.exp(2.0 * a * SCALAR_DT) - 1.0) / (2.0 * a) * f**2
    x, P, total = np.zeros_like(a), np.zeros_like(a), np.zeros_like(a)
    for measured, u in zip(z, de, strict=True):
        if np.isfinite(measured):
            S, e = P + sigma**2, measured - x
            total -= 0.5 * (np.log(2.0 * np.pi * S) + e**2 / S)
            x, P = x + P / S * e, P * sigma**2 / S
        x, P = phi * x - (phi - 1.0) / a * u, phi**2 * P + driven
    return total


def test_the_density_is_that_of_the_fit_and_short_chains_say_so(scalar, fitted):
    """Likelihood to 1e-8 of the fit's; priors by SciPy's distributions."""
    R = np.array([3e-4])
    density = innovations_posterior(scalar[0], R)
    x = density.start(fitted)
    assert density.names == ("Zalpha", "F_alpha", "sigma_alpha")
    np.testing.assert_allclose(x, [*fitted.estimate, *fitted.F, *np.sqrt(fitted.R)], rtol=1e-12)
    assert float(density.log_likelihood(jnp.asarray(x))) == pytest.approx(fitted.log_likelihood, rel=1e-8)
    priors = stats.norm.logpdf(x[0], -1.0, 1.0)
    for value, median in zip(x[1:], (0.3 * R[0] ** 0.5, (0.1 * R[0]) ** 0.5), strict=True):
        priors += stats.lognorm.logpdf(value, SPREAD, scale=median)
    u = density.unconstrain(jnp.asarray(x))
    knee = np.array([0.5 * 0.3 * R[0] ** 0.5, 0.03 * (0.1 * R[0]) ** 0.5])
    slope = knee * (1.0 - np.exp(-x[1:] / knee))  # of knee log(1 + exp(u)) by u
    whole = fitted.log_likelihood + priors + np.log(slope).sum()
    assert float(density(u)) == pytest.approx(whole, rel=1e-8)
    # A fit without process noise is no point of a lognormal.
    density = innovations_posterior(scalar[0], np.array([3e-4]))
    x = density.start(replace(fitted, F=np.zeros(1)))
    assert x[1] == pytest.approx(0.3 * 3e-4**0.5 * np.exp(-2.0 * SPREAD))
    assert np.isfinite(float(density(density.unconstrain(jnp.asarray(x)))))
    # One ensemble of a hundred steps misses the effective sample size.
    length = PosteriorLength(NutsLength(2, WarmUp(200), 1), EnsembleLength(1, 100))
    found = sample_innovations(scalar[0], fitted, np.array([3e-4]), seed=1, length=length)["emcee"]
    assert found.tree.attrs["steps"] == 100
    assert min(m.ess for m in found.marginals.values()) < 400.0
    assert found.status is PosteriorStatus.NOT_CONVERGED


@pytest.mark.recovery
def test_both_samplers_find_the_posterior_by_quadrature(scalar, fitted):
    """Means within Monte Carlo error, deviations within a tenth; so the samplers agree with each other."""
    flown, z, de = scalar
    R = np.array([3e-4])
    axes = [
        np.linspace(-2.2, 0.4, 60) + 1e-4,
        *(np.log(y) + np.linspace(-1.6, 1.2, 60) for y in (fitted.F[0], fitted.R[0] ** 0.5)),
    ]
    a, f, s = np.meshgrid(*axes, indexing="ij")
    log = scalar_likelihood(z, de, a, np.exp(f), np.exp(s)) + stats.norm.logpdf(a, -1.0, 1.0)
    log += stats.norm.logpdf(f, np.log(0.3 * R[0] ** 0.5), SPREAD)
    log += stats.norm.logpdf(s, np.log((0.1 * R[0]) ** 0.5), SPREAD)
    weight = np.exp(log - log.max())
    weight /= weight.sum()
    posteriors = sample_innovations(flown, fitted, R, seed=3)
    assert set(posteriors) == {"nuts", "emcee"}
    for posterior in posteriors.values():
        assert posterior.status is PosteriorStatus.CONVERGED
        for name, grid in {"Zalpha": a, "F_alpha": np.exp(f), "sigma_alpha": np.exp(s)}.items():
            found = posterior.marginals[name]
            mean = np.sum(weight * grid)
            sd = np.sqrt(np.sum(weight * (grid - mean) ** 2))
            assert abs(found.mean - mean) < 4.0 * sd / np.sqrt(found.ess_bulk), (posterior.engine, name)
            assert found.sd == pytest.approx(sd, rel=0.1), (posterior.engine, name)


class _Pendulum(System):
    """Turns, and is damped by the square of its rate; a sensor feels both."""

    values: dict[str, Any]

    @property
    def states(self):
        return ("w", "q")

    def motion(self, x, u):
        angle, rate = x
        stiff, damped = self.values["stiff"], self.values["damped"]
        turn = -stiff * jnp.sin(angle) - damped * rate * jnp.abs(rate) + u["elevator"]
        return jnp.stack([rate, turn]), {"w": angle, "q": rate, "az": jnp.cos(angle) * rate**2 + turn}

    def noise_density(self, x, u):  # noqa: ARG002
        return jnp.stack([jnp.zeros(()), (0.1 * x[0]) ** 2 * self.values["damped"]])


@dataclass(frozen=True)
class _PendulumDynamics(Dynamics):
    states = ("w", "q")
    inputs = ("elevator",)
    outputs = ("w", "q", "az")

    @property
    def free(self):
        wide = Prior("normal", 1.0, 3.0)
        return tuple(Parameter(name, "1", 0.0, 1.0, "of a pendulum", wide) for name in ("stiff", "damped"))

    def values(self, theta):
        return {"stiff": theta[0], "damped": theta[1]}

    def system(self, values, aircraft):  # noqa: ARG002
        return _Pendulum(values)

    def drives(self, values, channels, flights):  # noqa: ARG002
        return {"elevator": channels["elevator"]}


@pytest.fixture(scope="module")
def pendulum():
    """Two flights of unlike length with large angles; an output at half the rate."""
    rng, card = np.random.default_rng(2), card_of(FIRST_ORDER.replace("alpha", "w"))
    parts = []
    for n in (40, 30):
        t = 0.1 * np.arange(n)
        channels = {"w": np.sin(2.0 * t), "q": 2.0 * np.cos(2.0 * t), "az": np.sin(t), "elevator": np.sin(t)}
        noisy = {name: y + 0.1 * rng.standard_normal(n) for name, y in channels.items()}
        noisy["az"][::2] = np.nan
        parts.append(FlightRecord.from_arrays(f"flight{n}", t, noisy, "simulated"))
    return segments(join(parts, card, ()), _PendulumDynamics())


@eqx.filter_jit
def both(flown, x):
    point = NoisePoint(x[:2], x[2:4], x[4:])
    lean = innovations_density(flown, point, jnp.array([0.1, 0.2]))
    found = filter_segments(flown, x[:2], jnp.array([0.1, 0.2]), x[2:4], x[4:])
    return lean, jnp.sum(jax.vmap(log_likelihood)(found))


def test_the_lean_likelihood_is_the_filter_s_and_its_gradient_that_of_differences(pendulum):
    rng = np.random.default_rng(1)
    for _ in range(3):
        x = jnp.asarray([4.0, 0.3, 0.05, 0.2, 0.01, 0.01, 0.02] * rng.uniform(0.5, 1.5, 7))
        lean, whole = both(pendulum.nameless, x)
        assert float(lean) == pytest.approx(float(whole), rel=1e-10)
    # Of a motion and outputs that bend, and of noise that depends on state and parameters.
    flown = pendulum.nameless
    value = eqx.filter_jit(lambda x: innovations_density(flown, NoisePoint(x[:2], x[2:4], x[4:]), jnp.ones(2)))
    x = np.array([4.0, 0.3, 0.05, 0.2, 0.01, 0.01, 0.02])
    gradient = jax.jit(jax.grad(value))(jnp.asarray(x))
    for i in range(len(x)):
        h = 1e-5 * x[i] * (np.arange(len(x)) == i)
        difference = (value(jnp.asarray(x + h)) - value(jnp.asarray(x - h))) / (2.0 * h.sum())
        assert float(gradient[i]) == pytest.approx(float(difference), rel=1e-6, abs=1e-4), i
