"""Standard errors against closed forms, priors and bounds against data, parameters that a record cannot separate."""

import jax.numpy as jnp
import numpy as np
import pandas as pd
import pytest
from calling import holds
from scipy.linalg import toeplitz
from scipy.signal import lfilter
from scipy.stats import norm, t
from statsmodels.tsa.arima_process import ArmaProcess

from bayes_aero.inference import covariance as errors
from bayes_aero.inference.frequency import cramer_rao, solve
from bayes_aero.inference.mle import active_bounds, prior_conflicts
from bayes_aero.inference.results import inseparable
from bayes_aero.inference.sampling import SENSITIVITY_LIMIT, Drawn, assemble, prior_sensitivity
from bayes_aero.model.observations import LogDensity
from bayes_aero.parameter import Parameter, Prior
from bayes_aero.report.pages import estimates

# Corrected bounds against variances that are known in closed form
BLOCK = 0.2


def slope(x, residual):
    """What corrected variances of the slope of one output on `x` are made of."""
    n, R = len(x), np.mean(residual**2, axis=0)
    return np.array([[R[0] / np.sum(x**2)]]), x[:, None, None], R, residual, np.zeros(n, int), np.arange(n) == 0


def by_correlogram(x, residual):
    return errors.corrected_covariance(*slope(x, residual))[0, 0]


def by_blocks(x, residual):
    return errors.robust_covariance(*slope(x, residual), BLOCK)[0][0, 0]


@pytest.mark.parametrize(("variance", "tolerance"), [(by_correlogram, 0.2), (by_blocks, 0.15)])
@pytest.mark.parametrize("rho", [0.0, 0.9])
def test_the_mean_of_a_first_order_autoregression(rho, variance, tolerance):
    """The variance of a sample mean of n samples tends to (1 + rho)/(1 - rho)/n."""
    rng, n, found = np.random.default_rng(5), 3000, []
    for _ in range(40):
        noise = np.asarray(lfilter([np.sqrt(1.0 - rho**2)], [1.0, -rho], rng.standard_normal(n + 200)))[200:]
        found.append(variance(np.ones(n), (noise - noise.mean())[:, None]))
    assert np.mean(found) == pytest.approx((1.0 + rho) / (1.0 - rho) / n, rel=tolerance)


def test_noise_that_grows_and_few_blocks_widen_the_variance():
    """Var = sum x^2 sigma(x)^2 / (sum x^2)^2, here three times what one variance for all samples gives."""
    rng, n = np.random.default_rng(6), 4000
    x = rng.standard_normal(n)
    noise = x * rng.standard_normal(n)
    exact = np.sum(x**4) / np.sum(x**2) ** 2
    found = by_blocks(x, (noise - x @ noise / (x @ x) * x)[:, None])
    assert found == pytest.approx(exact, rel=0.2)
    assert found > 2.5 * np.mean(noise**2) / np.sum(x**2)
    noise = np.random.default_rng(8).standard_normal((500, 1))
    assert errors.robust_covariance(*slope(np.ones(500), noise), 0.04)[1] == 100
    # 12 blocks for one parameter: over many records the variance is s^2/n times that of t with 11 degrees over
    # 1.96^2, and HC3 adds the leverage of each block: sum e^2/(1 - 1/n)^2/n^2 = s^2/(n - 1).
    rng, n, found = np.random.default_rng(7), 12, []
    for _ in range(2000):
        noise = rng.standard_normal(n)
        found.append(by_blocks(np.ones(n), (noise - noise.mean())[:, None]))
    widen = (t.ppf(0.975, n - 1) / norm.ppf(0.975)) ** 2
    assert np.mean(found) == pytest.approx(widen / (n - 1), rel=0.05)


# Blocks of one sample: the textbook's standard error of a mean
def test_jackknife_and_clusters_have_the_covariance_of_a_mean():
    """S/n with S = sum (x - mean)(x - mean)'/(n - 1)."""
    x = np.random.default_rng(5).standard_normal((12, 3)) @ [[1.0, 0.5, 0.0], [0.0, 2.0, 1.0], [0.0, 0.0, 3.0]]
    n, expected = len(x), np.cov(x.T) / len(x)
    without = np.array([np.delete(x, i, axis=0).mean(axis=0) for i in range(n)])
    np.testing.assert_allclose(errors.jackknife_covariance(without - x.mean(axis=0)), expected, rtol=1e-12)
    np.testing.assert_allclose(errors.cluster_covariance((x - x.mean(axis=0)) / n, np.arange(n)), expected, rtol=1e-12)
    # Two copies of each sample say no more than one.
    x = np.random.default_rng(6).standard_normal((8, 2))
    once = errors.cluster_covariance(x, np.arange(8))
    np.testing.assert_allclose(errors.cluster_covariance(np.repeat(x, 2, axis=0) / 2, np.repeat(np.arange(8), 2)), once)


# Noise records begin in the stationary distribution: every covariance is that of the autoregression
ROOTS = {"fast": (0.6, -0.3, 0.1), "slow": (0.99, 0.9, -0.5), "pair": (0.8 + 0.4j, 0.8 - 0.4j, 0.2)}


@pytest.mark.parametrize(("name", "n"), [*((name, 30) for name in ROOTS), ("slow", 2)])
def test_the_covariance_of_every_two_samples_is_the_autoregressions(name, n):
    """Also of a record that is shorter than the order."""
    phi = -np.real(np.poly(ROOTS[name]))[1:]
    response = errors.stationary_series(phi[:, None], np.eye(n))  # of each unit innovation, side by side
    autocovariance = ArmaProcess(np.concatenate([[1.0], -phi])).acovf(n)
    np.testing.assert_allclose(response @ response.T, toeplitz(autocovariance), rtol=1e-7)


def linear_fit(S, own):
    """Of one output with variance 1: one parameter, and initial states without a prior."""
    n, S, own = len(S), np.reshape(S, (1, -1, 1, 1)), np.reshape(own, (1, len(S), 1, -1))
    states = np.linalg.pinv(own[0, :, 0]) @ S[0, :, 0]
    S = S - own @ states
    D = 1.0 / np.sum(S**2, axis=(0, 1))
    return errors.LinearFit(D, S, own, np.zeros(own.shape[3]), np.ones(1), np.ones((1, n), bool))


@pytest.mark.parametrize("rho", [0.0, 0.7])
def test_corrected_intervals_of_a_mean_hold_95_percent(rho):
    """Of 400 first-order autoregressions; by the autocovariance alone they hold less, however long the record."""
    rng, n, inside = np.random.default_rng(14), 200, []
    fit = linear_fit(np.ones(n), np.zeros((n, 0)))
    for _ in range(400):
        noise = np.asarray(lfilter([1.0], [1.0, -rho], rng.standard_normal(n + 100)))[100:]
        residual = (noise - noise.mean())[None, :, None]
        plain = errors.segments_corrected(fit.D, fit.S, fit.R, residual, fit.inside)[0, 0]
        sd = np.sqrt(np.array([1.0, errors.calibration(fit, residual, 0.2)[0]]) * plain)
        inside.append(abs(noise.mean()) < 1.96 * sd)
    plain, calibrated = np.mean(inside, axis=0)
    assert rho == 0.0 or plain < 0.92
    assert calibrated == pytest.approx(0.95, abs=3.0 * np.sqrt(0.95 * 0.05 / 400))


def test_what_a_fit_takes_out_of_a_random_walk_is_in_its_corrected_variance():
    """The slope of a random walk of intensity 1 over T has the variance 6 / (5 T); 6 % of it shows in the residuals."""
    rng, n, dt, plain, calibrated, slopes = np.random.default_rng(15), 100, 0.2, [], [], []
    fit = linear_fit(dt * (np.arange(n) + 0.5), np.ones((n, 1)))  # a state that keeps every disturbance
    for _ in range(150):
        walk = np.cumsum(np.sqrt(dt) * rng.standard_normal(n))[None, :, None]
        slopes.append(np.sum(fit.weights[..., 0] * walk))
        residual = fit.residual(walk)
        plain.append(errors.segments_corrected(fit.D, fit.S, fit.R, residual, fit.inside)[0, 0])
        calibrated.append(plain[-1] * errors.calibration(fit, residual, dt)[0])
    exact = 6.0 / (5.0 * n * dt)
    assert np.mean(np.square(slopes)) == pytest.approx(exact, rel=0.35)  # three standard errors
    assert np.mean(plain) < 0.1 * exact
    assert 0.6 * exact < np.mean(calibrated) < 1.7 * exact


def test_the_covariance_knows_lengths_beside_angles():
    """Scales from 1e-6 to 1e6: a pseudo-inverse of the information itself drops the large errors."""
    rng = np.random.default_rng(8)
    factor, scale = rng.standard_normal((5, 5)), np.logspace(-6.0, 6.0, 5)
    correlated = factor @ factor.T + np.eye(5)
    information = np.zeros((6, 6))
    information[:5, :5] = correlated / np.outer(scale, scale)
    found = errors.covariance_of(information, np.array([True] * 6))
    np.testing.assert_allclose(found[:5, :5], np.linalg.inv(correlated) * np.outer(scale, scale), rtol=1e-9)
    assert not found[5].any()


def test_an_output_that_the_model_reproduces_exactly_leaves_its_neighbours_their_bounds():
    """A simulated record without noise: the bound of the other output is s/sqrt(S'S), as if it were alone."""
    rng = np.random.default_rng(3)
    S = np.zeros((40, 2, 2))
    S[:, 0, 0], S[:, 1, 1] = rng.normal(size=40), rng.normal(size=40)
    residual = np.stack([2.0 * S[:, 0, 0] + rng.normal(size=40), np.zeros(40)], axis=1)
    found = solve(residual, S)
    R, covariance = cramer_rao(S, found.R)
    assert found.step == pytest.approx([S[:, 0, 0] @ residual[:, 0] / (S[:, 0, 0] @ S[:, 0, 0]), 0.0], rel=1e-12)
    assert covariance[0, 0] == pytest.approx(R[0] / (S[:, 0, 0] @ S[:, 0, 0]), rel=1e-9)
    assert np.all(np.isfinite(covariance))


# Priors against the data, and bounds that push, against linear fits that can be done by hand
def parameter(name, prior=None, bounds=(-np.inf, np.inf)):
    return Parameter(name, "1/rad", 0.0, 2.9, name, prior or Prior("normal", 0.0, 100.0), bounds)


def test_a_prior_that_the_record_contradicts_is_named_and_how_far_the_posterior_leans():
    prior = Prior("normal", 2.5, 0.02, "wind tunnel")
    given = [parameter("CLa", prior), parameter("Cmq")], np.array([3.55, -8.0]), np.array([0.03, 1])
    (conflict,) = conflicts = prior_conflicts(*given)
    assert conflict.distance == pytest.approx(1.05 / np.hypot(0.02, 0.03))
    (said,) = estimates.conflict_sentences(conflicts)
    holds(said, "CLa", "wind tunnel", "29.1 combined standard errors away")
    rows = {"prior": {"CLa": 0.8, "e": 0.2, "CD0": 0.01}, "likelihood": {"CLa": 0.7, "e": 0.3, "CD0": 0.2}}
    rows["leans"] = {name: size >= SENSITIVITY_LIMIT for name, size in rows["prior"].items()}
    (said,) = estimates.leaning_sentences(pd.DataFrame(rows), conflicts)
    holds(said, "CLa 0.80 to the prior", "also move e")
    assert estimates.leaning_sentences(pd.DataFrame(rows), ()) == ()


@pytest.mark.parametrize(("prior", "estimate", "error"), [
    (Prior("normal", 2.5, 0.02), 2.55, 0.03),
    (Prior("lognormal", 20.0, 0.7), 80.0, 0.5),  # four times the median is two deviations of the logarithm, not 4.3
])  # fmt: skip
def test_a_prior_that_agrees_is_not(prior, estimate, error):
    assert prior_conflicts([parameter("CLa", prior)], np.array([estimate]), np.array([error])) == ()


def test_lifting_the_bound_of_a_linear_fit_gives_the_free_fit():
    rng = np.random.default_rng(3)
    X = rng.standard_normal((200, 2)) @ np.array([[1.0, 0.8], [0.0, 0.6]])
    y = X @ [3.6, 7.0] + 0.1 * rng.standard_normal(200)
    A = X.T @ X / 0.01
    free = np.linalg.solve(X.T @ X, X.T @ y)
    held = np.array([3.2, X[:, 1] @ (y - 3.2 * X[:, 0]) / (X[:, 1] @ X[:, 1])])
    gradient = X.T @ (y - X @ held) / 0.01
    sd = np.sqrt(np.diag(np.linalg.inv(A)))
    bounded = [parameter("CLa", bounds=(2.5, 3.2)), parameter("CLaM")]
    (bound,) = active_bounds(bounded, held, gradient, np.linalg.inv(A), sd, np.array([True, False]))
    assert (bound.name, bound.bound, bound.lower) == ("CLa", 3.2, False)
    assert bound.unbounded == pytest.approx(free[0], rel=1e-9)
    assert bound.shifts["CLaM"] == pytest.approx((free[1] - held[1]) / sd[1], rel=1e-9)
    (said,) = estimates.bound_sentences([bound])
    holds(said, "upper bound, 3.2", "CLaM")


# Sensitivity to priors where the answer is known: a normal mean with a vague, an informative and a deciding prior
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


@pytest.mark.parametrize(("width", "says"), [(100.0, "likelihood"), (0.2, "prior likelihood"), (0.005, "prior")])
def test_a_prior_is_told_by_its_width(width, says):
    """Draws from the closed form: precision 25 + width^-2, mean 25 over it."""
    precision = 25.0 + width**-2.0
    draws = 25.0 / precision + np.random.default_rng(1).standard_normal((4, 1000, 1)) / np.sqrt(precision)
    density = Mean(width)
    posterior = assemble(density, Drawn("closed form", draws), seed=0, seconds=0.0)
    row = prior_sensitivity(density, posterior).loc["m"]
    assert [part for part in ("prior", "likelihood") if row[part] >= SENSITIVITY_LIMIT] == says.split()
    assert row["leans"] == ("prior" in says)


# Parameters that a record cannot separate: linear regressions whose near dependencies are known beforehand
NAMES, UNITS = ("CL0", "CLa", "Cmq", "Cmde"), ("1", "1/rad", "1/rad", "1/rad")


def asked(X, estimate, noise):
    covariance = noise**2 * np.linalg.inv(X.T @ X)
    return inseparable(NAMES, UNITS, np.array(estimate), covariance, np.sqrt(np.diag(covariance))), covariance


def columns(spread, n=400):
    """A constant, an angle about 5 deg that moves by `spread` rad, and two inputs of their own."""
    rng = np.random.default_rng(2)
    alpha = 0.087 + spread * rng.standard_normal(n)
    return np.column_stack([np.ones(n), alpha, rng.standard_normal((n, 2))])


def test_an_angle_that_hardly_moves_is_not_parted_from_the_constant_in_any_unit():
    X = columns(0.003)
    (found,), covariance = asked(X, [0.25, 4.9, -20.0, -1.2], 0.1)
    assert set(found.names) == {"CL0", "CLa"}
    for name, wider in zip(found.names, found.wider, strict=True):
        i = NAMES.index(name)
        shared = np.sum((X[:, 2:].T @ X[:, i]) ** 2 / np.sum(X[:, 2:] ** 2, axis=0))
        alone = 0.1 / np.sqrt(np.sum(X[:, i] ** 2) - shared)
        assert wider == pytest.approx(np.sqrt(covariance[i, i]) / alone, rel=0.02)
    (said,) = estimates.inseparable_sentences([found])
    holds(said, "cannot separate", "CLa 4.9 ± 1.7 1/rad")
    # The same dependency with one column in other units.
    (one,), _ = asked(X, [0.25, 4.9, -20.0, -1.2], 0.1)
    (other,), _ = asked(X * [1.0, 1e4, 1e-6, 1.0], [0.25, 4.9e-4, -20e6, -1.2], 0.1)
    assert one.names == other.names
    np.testing.assert_allclose(one.wider, other.wider, rtol=1e-5)
    sd = np.array([0.1, 0.0, 0.2, 0.1])
    assert inseparable(NAMES, UNITS, np.ones(4), np.diag(sd**2), sd) == ()
    assert inseparable(NAMES, UNITS, np.ones(4), np.full((4, 4), np.nan), sd) == ()


@pytest.mark.parametrize(("spread", "noise"), [(0.3, 0.1), (0.003, 0.001)])
def test_what_moves_or_is_known_well_enough_is_not_told(spread, noise):
    """A large movement parts them; and where all is known to a per cent, a correlation costs nothing."""
    assert asked(columns(spread), [0.25, 4.9, -20.0, -1.2], noise)[0] == ()


def test_two_dependencies_are_two_and_three_parameters_are_told_together():
    """Lift and moment have each a constant and a speed that hardly moves: four parameters, two pairs."""
    rng = np.random.default_rng(5)
    V = 1.0 + 0.003 * rng.standard_normal(400)
    lift, moment = np.column_stack([np.ones(400), V]), np.zeros((400, 2))
    X = np.concatenate([np.hstack([lift, moment]), np.hstack([moment, lift])])
    found, _ = asked(X, [0.2, 0.3, 0.1, 0.01], 0.02)
    assert {frozenset(one.names) for one in found} == {frozenset(NAMES[:2]), frozenset(NAMES[2:])}
    # The third input is the sum of the first two but for a thousandth.
    rng = np.random.default_rng(7)
    X = rng.standard_normal((400, 4))
    X[:, 2] = X[:, 0] + X[:, 1] + 1e-3 * rng.standard_normal(400)
    (found,), _ = asked(X, [0.2, 0.3, 0.1, 1.0], 0.02)
    assert set(found.names) == set(NAMES[:3])
