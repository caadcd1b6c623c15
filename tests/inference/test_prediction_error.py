"""Process noise: one-step predictions, fits and posteriors, against truth, differences, closed forms and quadrature."""

from dataclasses import dataclass, replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import linear_cards as cards
import numpy as np
import pytest
from scipy import stats
from scipy.linalg import expm
from scipy.optimize import lsq_linear
from scipy.signal import lfilter
from scipy.stats import binom, norm

from bayes_aero.dynamics.flight import Dynamics, linear_dynamics
from bayes_aero.dynamics.kalman import Filtered, filter_segments, innovations_density, prediction_errors
from bayes_aero.dynamics.segments import segments
from bayes_aero.dynamics.system import System
from bayes_aero.flight.record import FlightRecord
from bayes_aero.inference import optimise, prediction_error
from bayes_aero.inference.prediction_error import fit_prediction_error, innovations_posterior, one_step, standardised
from bayes_aero.inference.results import Calibration, PosteriorStatus
from bayes_aero.model.observations import join
from bayes_aero.parameter import Parameter, Prior

TRUTH = cards.SHORT_PERIOD_TRUTH

# One-step predictions: their transform in closed form, shares of a simulated truth, and what correlation does
DT, N = 0.04, 1500
F = np.array([0.004, 0.02])  # alpha, q
NOISE = {"alpha": 0.002, "q": 0.003, "az": 0.15}
R = np.square([*NOISE.values()])
HEAVY = np.random.default_rng(0).standard_t(3.0, (1, 3000, 1)) / np.sqrt(3.0)  # unit variance; 0.60 inside 50 %


def innovations(z: np.ndarray) -> Filtered:
    """Of a filter that predicts all with variance 1; NaN: not measured."""
    w, n, _ = z.shape
    state, matrix = np.zeros((w, n, 1)), np.zeros((w, n, 1, 1))
    used = np.isfinite(z)
    return Filtered(state, matrix, state, matrix, matrix, np.where(used, z, 0.0), np.ones_like(z), used)


def judged(z: np.ndarray):
    return one_step(innovations(z), z, [f"y{c}" for c in range(z.shape[2])])


def white(seed: int, *shape: int) -> np.ndarray:
    return np.random.default_rng(seed).standard_normal(shape)


def disturbed_short_period():
    """A minute of the short period in white process noise, each sample exact: matrix exponentials, no integration."""
    rng, truth = np.random.default_rng(4), TRUTH
    u = sum(cards.multistep(N, DT, begin, 0.6, 0.03) for begin in (1.0, 16.0, 31.0, 46.0))
    A, B = cards.short_period_matrices(truth)
    both = expm(DT * np.block([[-A, np.diag(F**2)], [np.zeros((2, 2)), A.T]]))  # Van Loan 1978
    added = np.linalg.cholesky(both[2:, 2:].T @ both[:2, 2:])
    x, states = np.zeros(2), []
    for k in range(N):
        states.append(x)
        ends = np.array([[u[k], 1.0], [u[min(k + 1, N - 1)], 1.0]])
        x = cards.first_order_hold(A, B, x, ends, DT)[1] + added @ rng.standard_normal(2)
    alpha, q = np.array(states).T
    az = truth["az0"] + 90.0 * (truth["Zalpha"] * alpha + truth["Zde"] * u)
    return cards.record_of({"alpha": alpha, "q": q, "elevator": u, "az": az}, noise=NOISE, rng=rng)


def flown_of(record):
    card = cards.card_of(cards.SHORT_PERIOD)
    return segments(join([record], card, ()), linear_dynamics(card))


@pytest.fixture(scope="module")
def flown():
    return flown_of(disturbed_short_period())


@eqx.filter_jit
def filtered_errors(flown, theta, deviation, F, R):
    """What a filter makes of a record, and its errors of one step."""
    made = filter_segments(flown, theta, deviation, F, R)
    return made, prediction_errors(flown, theta, made)


def predicted(flown, noise: float):
    """By the filter that has the truth, told `noise` times the variance of the measurement noise."""
    theta, variance = jnp.asarray([TRUTH[name] for name in flown.dynamics.names]), jnp.asarray(noise * R)
    return filtered_errors(flown.nameless, theta, jnp.sqrt(variance[:2]), jnp.asarray(F), variance)


def test_filters_are_calibrated_only_with_the_true_noise(flown):
    """Within exact binomial bounds of 99.9 %, for every output, level, and all together."""

    def scored(noise):
        made, errors = predicted(flown, noise)
        return one_step(made, np.asarray(errors), flown.outputs)

    score = scored(1.0)
    assert score.status == "calibrated"
    assert score.together.count == 3 * N
    for one in (*score.outputs.values(), score.together):
        assert abs(one.ratio[0] - 1.0) < 3.5 * one.ratio[1]
        for share, level in zip(one.shares, prediction_error.LEVELS, strict=True):
            low, high = binom.interval(0.999, one.count, level)
            assert low <= round(share.share * one.count) <= high
            assert share.sd == pytest.approx(np.sqrt(level * (1.0 - level) / one.count), rel=0.6)
    score = scored(0.5)
    assert score.status == "not_calibrated"
    for one in (*score.outputs.values(), score.together):
        assert one.calibration is Calibration.TOO_NARROW
        assert one.ratio[0] > 1.1
        for share in one.shares:
            assert share.share * one.count < binom.interval(0.999, one.count, share.level)[0]
    score = scored(4.0)
    assert score.status == "not_calibrated"
    assert {one.calibration for one in score.outputs.values()} <= {Calibration.TOO_WIDE, Calibration.COLOURED}
    assert score.together.calibration is Calibration.TOO_WIDE


def test_errors_of_an_output_do_not_know_the_other_outputs_of_their_sample(flown):
    """Its innovation does: the first output's are equal, the last one's are smaller than its error."""
    made, errors = predicted(flown, 1.0)
    innovation, errors = (np.asarray(x)[0, :N] for x in (made.innovation, errors))
    assert errors[:, 0] == pytest.approx(innovation[:, 0], abs=1e-12)
    assert np.std(innovation[:, -1]) < 0.99 * np.std(errors[:, -1])


@pytest.mark.parametrize(("z", "calibration"), [
    (HEAVY, Calibration.NOT_NORMAL), (0.0 * white(4, 1, 300, 1), Calibration.TOO_WIDE),
    (50.0 * white(4, 1, 300, 1), Calibration.TOO_NARROW),
], ids=["heavy tails", "nothing", "much"])  # fmt: skip
def test_what_is_not_calibrated_is_said_with_numbers(z, calibration):
    output = judged(z).outputs["y0"]
    assert output.calibration is calibration
    assert np.all(np.isfinite([(share.share, share.sd, share.p) for share in output.shares]))
    if z is HEAVY:
        score, value, _, high = output.quantiles[-1]
        assert value > high > score


@pytest.mark.verify
@pytest.mark.parametrize("rho", [0.0, 0.2])
def test_calibrated_predictions_are_seldom_said_not_to_be(rho):
    """At most one in twenty: an exact binomial bound on 200 records of three outputs; and so for quantiles."""
    said = left = 0
    for seed in range(200):
        series = [lfilter([np.sqrt(1.0 - rho**2)], [1.0, -rho], white(3 * seed + c, 1100))[100:] for c in range(3)]
        z = np.stack(series, axis=1)[None]
        found = judged(z)
        said += found.status == "not_calibrated"
        _, value, low, high = found.outputs["y0"].quantiles.T
        left += bool(np.any((value < low) | (value > high)))
    assert said <= binom.ppf(0.999, 200, 0.05)
    assert rho or left <= binom.ppf(0.999, 200, 0.05)


def test_a_standard_error_counts_samples_that_repeat_others():
    """Each innovation four times: the information, and the standard error, of a quarter of the samples."""
    found = []
    for seed in range(40):
        repeated = judged(np.repeat(white(seed, 1, 400, 1), 4, axis=1)).outputs["y0"]
        assert repeated.calibration is not Calibration.CALIBRATED
        found.append([share.sd for share in repeated.shares])
    expected = [np.sqrt(level * (1.0 - level) / 400) for level in prediction_error.LEVELS]
    assert np.mean(np.square(found), axis=0) == pytest.approx(np.square(expected), rel=0.3)
    # Two sensors of one signal know no more than one.
    score = judged(np.repeat(white(1, 1, 800, 1), 2, axis=2))
    for one, both in zip(score.outputs["y0"].shares, score.together.shares, strict=True):
        assert both.share == one.share
        assert both.sd == pytest.approx(one.sd, rel=0.3)


def test_what_counts_in_a_score_and_what_is_too_few():
    """Every second sample, a short segment, and an output that was never measured."""
    z = white(2, 2, 500, 2)
    z[:, ::2, 0] = z[:, :, 1] = np.nan
    z[1, 100:] = np.nan
    found = judged(z)
    assert set(found.outputs) == {"y0"}
    kept = z[np.isfinite(z)]
    assert found.outputs["y0"].count == len(kept) == 300
    assert found.outputs["y0"].shares[1].share == np.mean(np.abs(kept) < norm.ppf(0.95))
    assert np.isnan(standardised(innovations(z))[0, 0, 0])
    found = judged(3.0 * white(3, 1, 20, 1))
    assert found.status == "undecided"
    assert found.outputs["y0"].quantiles.shape[1] == 4


# Parameters, process noise and measurement noise of a simulated disturbed flight, jointly, against the truth


def fitted_to(flown, F, R):
    start = np.array([0.8 * TRUTH[name] for name in flown.dynamics.names])
    return fit_prediction_error(flown, F, R, start=start, priors=False)


def test_the_truth_is_recovered_and_without_process_noise_the_fit_is_worse(flown):
    """Every parameter within 3.5 standard errors; process and measurement noise within 3.5 of their own."""
    found = fitted_to(flown, np.full(2, 0.03), 4.0 * R)
    assert found.status is prediction_error.PredictionErrorStatus.CONVERGED
    assert found.outputs == ("alpha", "q", "az")
    sd = np.sqrt(np.diag(found.covariance))
    for name, estimate, error in zip(found.names, found.estimate, found.sd, strict=True):
        assert abs(estimate - TRUTH[name]) < 3.5 * error, name
        assert error < 0.2 * abs(TRUTH[name]) or name in ("Z0", "M0", "Zde"), name
    k = len(found.names)
    assert np.all(np.abs(np.log(found.F / F)) < 3.5 * sd[k : k + 2])
    assert np.all(np.abs(np.log(found.R / R)) < 3.5 * sd[k + 2 :])
    used = np.asarray(found.found.used)[0]
    e = np.asarray(found.found.innovation / np.sqrt(found.found.variance))[0]
    for c in range(3):
        white = e[used[:, c], c]
        assert abs(np.corrcoef(white[1:], white[:-1])[0, 1]) < 4.0 / np.sqrt(len(white))
    # F of 0 is held; the likelihood of a disturbed flight is far lower without it.
    still = fitted_to(flown, np.zeros(2), 20.0 * R)
    np.testing.assert_array_equal(still.F, 0.0)
    assert found.log_likelihood - still.log_likelihood > 100.0


def test_the_gradient_is_that_of_finite_differences(flown):
    point = np.array([*(0.9 * TRUTH[n] for n in flown.dynamics.names), *np.log(F), *np.log(R)])
    problem = prediction_error._Innovations(flown, F > 0.0, True)
    gradient = problem.evaluate(point).gradient
    for i, g in enumerate(gradient):
        h = 1e-5 * max(1.0, abs(point[i])) * (np.arange(len(point)) == i)
        difference = (problem.cost(point + h) - problem.cost(point - h)) / (2.0 * h.sum())
        assert g == pytest.approx(difference, rel=1e-4, abs=1e-3), i


def test_the_derivative_by_the_noise_along_a_path_is_exact_in_a_linear_system(flown):
    point = np.array([*(0.9 * TRUTH[n] for n in flown.dynamics.names), *np.log(F), *np.log(R)])
    problem, k = prediction_error._Innovations(flown, F > 0.0, True), len(flown.dynamics.names)
    along, exact = problem.evaluate_held_gains(point).gradient, problem.evaluate(point).gradient
    np.testing.assert_allclose(along[k:], exact[k:], rtol=1e-6)
    # Of the motion the derivatives of the gains are missing: less than a tenth of the largest, in standard errors.
    sd = 1.0 / np.sqrt(np.diag(problem.evaluate(point).information))[:k]
    assert np.all(np.abs(sd * (along - exact)[:k]) < 0.1 * np.max(np.abs(sd * exact[:k])))


def test_the_noise_of_a_smoothed_channel_is_no_less_than_that_of_its_last_digit(flown):
    """Smoothed, a channel has less noise from sample to sample than a state alone; its likelihood asks for none."""
    step, channels = 7e-4, {name: np.asarray(x) for name, x in flown.flights.channels.items()}
    smooth = np.convolve(np.pad(channels["alpha"], 5, mode="edge"), np.full(11, 1.0 / 11.0), mode="valid")
    rounded = {name: channels[name] for name in ("q", "az", "elevator")} | {"alpha": step * np.round(smooth / step)}
    found = fitted_to(flown_of(cards.record_of(rounded)), np.full(2, 0.03), 4.0 * R)
    assert found.status is prediction_error.PredictionErrorStatus.CONVERGED
    assert found.R[found.outputs.index("alpha")] == pytest.approx(step**2 / 12.0)
    assert np.all(found.R[1:] > 0.1 * R[1:])


class Quadratic(optimise.Problem):
    """A quadratic cost, and an information that is not its curvature."""

    def __init__(self, curvature, information):
        super().__init__(np.tile([-np.inf, np.inf], (6, 1)))
        self.curvature, self.information = curvature, information

    def cost(self, point):
        return 0.5 * float(point @ self.curvature @ point)

    def evaluate(self, point):
        return optimise.Evaluation(self.cost(point), self.curvature @ point, self.information)


@pytest.mark.parametrize("times", [0.5, 1.97])
def test_steps_that_go_too_far_are_shortened(times):
    """Newton's steps from 30 would take log(1e6) / log(1 / 0.97^2) = 227 steps by an information half of what it is."""
    factor = np.random.default_rng(5).standard_normal((6, 6))
    information = factor @ factor.T + np.eye(6)
    problem = Quadratic(times * information, information)
    _, here, converged, steps = optimise.minimise(problem, np.full(6, 30.0), 1e-3)
    assert converged
    assert steps < optimise.MAX_ITERATIONS / 2
    assert here.cost < 0.01


def test_bounded_steps_are_those_of_scipy():
    rng = np.random.default_rng(2)
    for _ in range(20):
        factor = rng.standard_normal((8, 8)) * np.logspace(0.0, 4.0, 8)
        A, g = factor.T @ factor, rng.standard_normal(8) * np.logspace(0.0, 8.0, 8)
        newton = np.linalg.solve(A, g)
        room = np.sort(newton[:, None] * rng.uniform(-1.5, 1.5, (8, 2)), axis=1) + np.array([-1e-9, 1e-9])
        theirs = lsq_linear(factor, np.linalg.solve(factor.T, g), room.T, method="bvls", tol=1e-14)
        size = np.sqrt(np.diag(A))
        step = optimise.bounded_step(A, g, room, 0.0)
        np.testing.assert_allclose(size * step, size * theirs.x, rtol=1e-6, atol=1e-6 * np.abs(size * theirs.x).max())
        assert theirs.active_mask.any()


def test_gradients_mend_an_information_that_is_not_the_curvature():
    """Off by factors of .2 to 5; steps by the information alone crawl along the flat direction."""
    bowl = Quadratic(np.diag([5.0, 0.05, 0.2, 3.0, 1.0, 1.0]), np.eye(6))
    rules = (optimise.SCORING, optimise.APPROXIMATE_SCORING)
    ended = [optimise.minimise(bowl, np.full(6, 10.0), 1e-6, rule) for rule in rules]
    assert ended[0][1].cost < 1e-5
    assert 2 * ended[0][3] < ended[1][3]


# The posterior with process noise: its density and gradient, and both samplers against quadrature on a grid
SCALAR_DT, SCALAR_N, ZALPHA, SCALAR_F, SIGMA = 0.05, 160, -0.8, 0.03, 0.01


@pytest.fixture(scope="module")
def scalar():
    """One state, disturbed, measured with noise; the samples of a gap are missing."""
    channels = cards.disturbed_first_order(SCALAR_N, SCALAR_DT, ZALPHA, SCALAR_F, SIGMA)
    z, de = channels["alpha"], channels["elevator"]
    z[60:70] = np.nan
    card = cards.card_of(cards.FIRST_ORDER)
    record = FlightRecord.from_arrays("disturbed", SCALAR_DT * np.arange(SCALAR_N), channels, "simulated")
    flown = segments(join([record], card, ()), linear_dynamics(card), fixed={"alpha": 0.0}, held=True)
    return flown, z, de


@pytest.fixture(scope="module")
def fitted(scalar):
    return fit_prediction_error(scalar[0], np.array([0.02]), np.array([2e-4]))


def scalar_filter(z, de, a, f, sigma):
    """Errors and variances of a Kalman filter of one known state with exact transitions, for arrays of parameters."""
    phi, driven = np.exp(a * SCALAR_DT), (np.exp(2.0 * a * SCALAR_DT) - 1.0) / (2.0 * a) * f**2
    x, P, errors = np.zeros_like(a), np.zeros_like(a), []
    for measured, u in zip(z, de, strict=True):
        S, e = P + sigma**2, measured - x
        errors.append((e, S))
        if np.isfinite(measured):
            x, P = x + P / S * e, P * sigma**2 / S
        x, P = phi * x - (phi - 1.0) / a * u, phi**2 * P + driven
    return errors


def test_the_information_of_the_noise_is_that_of_a_scalar_filter_by_hand(scalar, fitted):
    """At the estimate: sum of e' e' / S + 1/2 (S' / S)^2 by log F and log R, with central differences by hand."""
    (_, z, de), h = scalar, 1e-4
    f, sigma = fitted.F * np.exp([h, -h, 0.0, 0.0]), np.sqrt(fitted.R) * np.exp(np.array([0.0, 0.0, h, -h]) / 2.0)
    a = np.full(4, fitted.estimate[0])
    rows = [(e, S) for e, S in scalar_filter(z, de, a, f, sigma) if np.isfinite(e[0])]
    e, S = np.moveaxis(np.array(rows), 1, 0)
    slope, size = (((x[:, ::2] - x[:, 1::2]) / (2.0 * h)) for x in (e, S))
    S = S.mean(axis=1)[:, None]
    wanted = (slope / S).T @ slope + 0.5 * (size / S).T @ (size / S)
    np.testing.assert_allclose(np.linalg.inv(fitted.covariance)[-2:, -2:], wanted, rtol=1e-4)


def test_the_transform_is_that_of_a_scalar_filter_by_hand(scalar):
    flown, z, de = scalar
    given = (jnp.array([x]) for x in (ZALPHA, 0.0, SCALAR_F, SIGMA**2))
    made, away = (jax.tree.map(np.asarray, x) for x in filtered_errors(flown.nameless, *given))
    e, S = np.array(scalar_filter(z, de, np.array(ZALPHA), SCALAR_F, SIGMA)).T
    np.testing.assert_allclose(norm.cdf(standardised(made))[0, : len(e), 0], norm.cdf(e / np.sqrt(S)), atol=1e-5)
    np.testing.assert_allclose(away[0, : len(e), 0], e, atol=1e-7)
    score = one_step(made, away, flown.outputs)
    assert score.outputs["alpha"].rms == pytest.approx(np.sqrt(np.nanmean(e**2)), rel=1e-6)


def test_the_density_is_that_of_the_fit(scalar, fitted):
    """Likelihood to 1e-8 of the fit's; priors by SciPy's distributions."""
    R = np.array([3e-4])
    density = innovations_posterior(scalar[0], R)
    whole = eqx.filter_jit(lambda u: (density(u), density.log_likelihood(density.constrain(u))))
    x = density.start(fitted)
    assert density.names == ("Zalpha", "F_alpha", "sigma_alpha")
    np.testing.assert_allclose(x, [*fitted.estimate, *fitted.F, *np.sqrt(fitted.R)], rtol=1e-12)
    value, log_likelihood = whole(density.unconstrain(jnp.asarray(x)))
    assert float(log_likelihood) == pytest.approx(fitted.log_likelihood, rel=1e-8)
    priors = stats.norm.logpdf(x[0], -1.0, 1.0)
    for at, median in zip(x[1:], (0.3 * R[0] ** 0.5, (0.1 * R[0]) ** 0.5), strict=True):
        priors += stats.lognorm.logpdf(at, prediction_error.SPREAD, scale=median)
    knee = np.array([0.5 * 0.3 * R[0] ** 0.5, 0.03 * (0.1 * R[0]) ** 0.5])
    slope = knee * (1.0 - np.exp(-x[1:] / knee))  # of knee log(1 + exp(u)) by u
    assert float(value) == pytest.approx(fitted.log_likelihood + priors + np.log(slope).sum(), rel=1e-8)
    # A fit without process noise is no point of a lognormal.
    x = density.start(replace(fitted, F=np.zeros(1)))
    assert x[1] == pytest.approx(0.3 * 3e-4**0.5 * np.exp(-2.0 * prediction_error.SPREAD))
    assert np.isfinite(float(whole(density.unconstrain(jnp.asarray(x)))[0]))


@pytest.mark.recovery
def test_both_samplers_find_the_posterior_by_quadrature(scalar, fitted):
    """Means within Monte Carlo error, deviations within a tenth; so the samplers agree with each other."""
    flown, z, de = scalar
    R = np.array([3e-4])
    about = (np.log(y) + np.linspace(-1.6, 1.2, 60) for y in (fitted.F[0], fitted.R[0] ** 0.5))
    a, f, s = np.meshgrid(np.linspace(-2.2, 0.4, 60) + 1e-4, *about, indexing="ij")
    log = stats.norm.logpdf(a, -1.0, 1.0)
    filtered = scalar_filter(z, de, a, np.exp(f), np.exp(s))
    log -= sum(
        0.5 * (np.log(S) + e**2 / S) for (e, S), measured in zip(filtered, z, strict=True) if np.isfinite(measured)
    )
    log += stats.norm.logpdf(f, np.log(0.3 * R[0] ** 0.5), prediction_error.SPREAD)
    log += stats.norm.logpdf(s, np.log((0.1 * R[0]) ** 0.5), prediction_error.SPREAD)
    weight = np.exp(log - log.max())
    weight /= weight.sum()
    posteriors = prediction_error.sample_innovations(flown, fitted, R, seed=3)
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
    def unbiased_parameters(self):
        wide = Prior("normal", 1.0, 3.0)
        return tuple(Parameter(name, "1", 0.0, 1.0, "of a pendulum", wide) for name in ("stiff", "damped"))

    def unbiased_values(self, theta):
        return {"stiff": theta[0], "damped": theta[1]}

    def system(self, values, aircraft):  # noqa: ARG002
        return _Pendulum(values)

    def drives(self, values, channels, flights):  # noqa: ARG002
        return {"elevator": channels["elevator"]}


@pytest.fixture(scope="module")
def pendulum():
    """Two flights of unlike length with large angles; an output at half the rate."""
    rng, card = np.random.default_rng(2), cards.card_of(cards.FIRST_ORDER.replace("alpha", "w"))
    parts = []
    for n in (40, 30):
        t = 0.1 * np.arange(n)
        channels = {"w": np.sin(2.0 * t), "q": 2.0 * np.cos(2.0 * t), "az": np.sin(t), "elevator": np.sin(t)}
        noisy = {name: y + 0.1 * rng.standard_normal(n) for name, y in channels.items()}
        noisy["az"][::2] = np.nan
        parts.append(FlightRecord.from_arrays(f"flight{n}", t, noisy, "simulated"))
    return segments(join(parts, card, ()), _PendulumDynamics())


def test_the_gradient_of_the_likelihood_is_that_of_differences(pendulum):
    """Of a motion and outputs that bend, and of noise that depends on state and parameters."""

    @eqx.filter_jit
    def evaluate(flown, x):
        deviation = jnp.array([0.1, 0.2])
        return jax.value_and_grad(lambda x: innovations_density(flown, x[:2], deviation, x[2:4], x[4:]))(x)

    x = np.array([4.0, 0.3, 0.05, 0.2, 0.01, 0.01, 0.02])
    at = lambda x: evaluate(pendulum.nameless, jnp.asarray(x))
    gradient = at(x)[1]
    for i in range(len(x)):
        h = 1e-5 * x[i] * (np.arange(len(x)) == i)
        difference = (at(x + h)[0] - at(x - h)[0]) / (2.0 * h.sum())
        assert float(gradient[i]) == pytest.approx(float(difference), rel=1e-6, abs=1e-4), i
