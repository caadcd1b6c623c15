"""Partial pooling against closed forms, integration on a grid, and the full density of a simulated stall."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.stats import halfnorm, multivariate_normal, norm

from bayes_aero.errors import InputError
from bayes_aero.inference import pooled
from bayes_aero.inference.mle import data_of, evaluate, fit_mle
from bayes_aero.inference.results import MleStatus, PosteriorStatus
from bayes_aero.simulate.demo import TRUTH

Y = np.array([[0.4, -0.2], [1.1, 0.3], [0.2, 0.5]])
C = np.array([[[0.04, 0.01], [0.01, 0.09]], [[0.02, -0.01], [-0.01, 0.03]], [[0.5, 0.2], [0.2, 0.1]]])
ESTIMATES, ERRORS = np.array([[0.9], [0.1], [0.4], [1.3]]), np.array([0.1, 0.2, 0.3, 0.15])  # of one parameter
ALONE = pooled.Hierarchy.of(("a",), ESTIMATES, 1.0 / ERRORS[:, None, None] ** 2)


class Means(np.random.Generator):
    """A random generator whose normal numbers are their means: draws become expectations."""

    def __init__(self):
        super().__init__(np.random.PCG64(0))

    def standard_normal(self, size=None, *_, **__):
        return np.zeros(size)


def marginal(scatter, y=Y, covariance=C):
    """Log-density of all estimates together: their joint covariance contains the aircraft, which has a unit prior."""
    m, k = y.shape
    joint = np.kron(np.ones((m, m)), np.eye(k)) + np.kron(np.eye(m), np.diag(np.asarray(scatter) ** 2))
    for i in range(m):
        joint[i * k : (i + 1) * k, i * k : (i + 1) * k] += covariance[i]
    return multivariate_normal(np.zeros(m * k), joint).logpdf(y.ravel())


def test_the_density_of_the_scatter_is_that_of_all_estimates_together():
    density = pooled.Hierarchy.of(("a", "b"), Y, np.linalg.inv(C))
    points = [(0.3, 0.6), (1e-9, 1.2), (2.0, 1e-3)]
    ours = [float(density.log_likelihood(jnp.asarray(x))) for x in points]
    np.testing.assert_allclose(np.subtract(ours[1:], ours[0]), [marginal(x) - marginal(points[0]) for x in points[1:]])
    # It counts like one with a standard error of a thousand prior deviations.
    information = np.linalg.inv(C)
    information[2] = [[0.0, 0.0], [0.0, 5.0]]
    moved = Y.copy()
    moved[2, 0] = 1e3  # what its fit happened to give
    density, far = pooled.Hierarchy.of(("a", "b"), Y, information), pooled.Hierarchy.of(("a", "b"), moved, information)
    vague = np.array([*C[:2], [[1e6, 0.0], [0.0, 0.2]]])
    points = [(0.3, 0.6), (1.0, 0.1)]
    ours = [float(density.log_likelihood(jnp.asarray(x))) for x in points]
    np.testing.assert_allclose(
        ours[1] - ours[0], marginal(points[1], covariance=vague) - marginal(points[0], covariance=vague), rtol=1e-5
    )
    assert float(far.log_likelihood(jnp.asarray(points[0]))) == pytest.approx(ours[0], rel=1e-12)
    means = pooled.given_scatter(far, np.array([[[0.3, 0.6]]]), Means())
    np.testing.assert_allclose(means.manoeuvres[..., 2, 0], means.aircraft[..., 0])


@pytest.mark.parametrize("scatter", [1e-6, 0.3, 1e4])
def test_a_known_scatter_gives_the_shrinkage_estimate(scatter):
    """No scatter: the joint estimate. Large scatter: each manoeuvre alone. Between: weights by precision."""
    means = pooled.given_scatter(ALONE, np.full((1, 1, 1), scatter), Means())
    y, variance = ESTIMATES[:, 0], ERRORS**2
    weight = 1.0 / (variance + scatter**2)
    aircraft = np.sum(weight * y) / (1.0 + np.sum(weight))  # with the prior, a standard normal distribution
    each = (y / variance + aircraft / scatter**2) / (1.0 / variance + 1.0 / scatter**2)
    np.testing.assert_allclose(means.aircraft[0, 0], aircraft, rtol=1e-9)
    np.testing.assert_allclose(means.manoeuvres[0, 0, :, 0], each, rtol=1e-7)


def test_draws_at_a_known_scatter_have_the_covariance_of_the_closed_form():
    """Aircraft and manoeuvres together, by conditioning their joint normal distribution on the estimates."""
    scatter, count = np.array([0.4, 0.7]), 40_000
    density = pooled.Hierarchy.of(("a", "b"), Y, np.linalg.inv(C))
    rng = np.random.default_rng(3)
    draws = pooled.given_scatter(density, np.broadcast_to(scatter, (1, count, 2)).copy(), rng)
    together = np.concatenate([draws.aircraft[0], draws.manoeuvres[0].reshape(count, -1)], axis=1)
    prior = np.kron(np.ones((4, 4)), np.eye(2)) + np.kron(np.diag([0.0, 1.0, 1.0, 1.0]), np.diag(scatter**2))
    seen = np.zeros((6, 8))
    seen[:, 2:] = np.eye(6)
    errors = np.zeros((6, 6))
    for i in range(3):
        errors[2 * i : 2 * i + 2, 2 * i : 2 * i + 2] = C[i]
    gain = prior @ seen.T @ np.linalg.inv(seen @ prior @ seen.T + errors)
    mean, covariance = gain @ Y.ravel(), prior - gain @ seen @ prior
    sd = np.sqrt(np.diag(covariance))
    assert np.all(np.abs(together.mean(axis=0) - mean) < 4.5 * sd / np.sqrt(count))
    off = np.abs(np.cov(together.T) - covariance) / np.outer(sd, sd)
    assert np.all(off < 4.5 * np.sqrt(2.0 / count))


def test_nuts_finds_the_scatter_that_integration_on_a_grid_finds():
    density = ALONE
    draws, sampled = pooled.pool(density, seed=1)
    tau = np.linspace(1e-4, 4.0, 20_001)
    variance = ERRORS[:, None] ** 2 + tau**2
    precision = 1.0 + np.sum(1.0 / variance, axis=0)
    mean = np.sum(ESTIMATES / variance, axis=0) / precision
    log = -0.5 * np.sum(np.log(variance) + ESTIMATES**2 / variance, axis=0) - 0.5 * np.log(precision)
    log += 0.5 * precision * mean**2 + halfnorm(scale=pooled.SCATTER).logpdf(tau)
    weight = np.exp(log - log.max())
    weight /= weight.sum()
    assert sampled.status is PosteriorStatus.CONVERGED
    ess = sampled.marginals["a"].ess_bulk
    expected = weight @ tau, weight @ mean
    sds = np.sqrt(weight @ tau**2 - expected[0] ** 2), np.sqrt(weight @ (mean**2 + 1.0 / precision) - expected[1] ** 2)
    for x, value, sd in zip((draws.scatter, draws.aircraft), expected, sds, strict=True):
        assert abs(x.mean() - value) < 4.0 * sd / np.sqrt(ess)
    inside = np.quantile(draws.scatter, [0.1, 0.5, 0.9])
    for quantile, share in zip(inside, (0.1, 0.5, 0.9), strict=True):
        assert abs(weight[tau < quantile].sum() - share) < 4.0 * np.sqrt(share * (1.0 - share) / ess)
    spread = np.sum(weight * (1.0 / precision + (mean - expected[1]) ** 2 + tau**2))
    assert np.var(draws.following) == pytest.approx(spread, rel=0.25)


def with_free(model, *names):
    """The model with its other parameters known; NumPy's numbers have the shape that effects ask for."""
    held = dict(model.fixed) | {n: TRUTH[n] for n in model.names if n not in names}
    return replace(model, fixed=tuple((n, np.float64(x)) for n, x in sorted(held.items())))


def flown_coefficients(model, o, values):
    theta = jnp.asarray([values[n] for n in model.names])
    return np.asarray(model.predicted(theta, o.signals, o.aircraft))


@pytest.fixture(scope="module")
def unmoved(thinned, model):
    """Three manoeuvres; in the second the elevator never moves, so that it says nothing of Cmde."""
    own = with_free(model, "CLa", "Cmde", "Cm0", "Cma")
    rng, parts = np.random.default_rng(6), []
    for m in range(3):
        o = thinned.only(m % 2)
        if m == 1:
            o = replace(o, signals=o.signals | {"elevator": jnp.zeros(o.n)})
        exact = flown_coefficients(model, o, TRUTH)
        noisy = jnp.asarray(exact + rng.standard_normal(exact.shape) * [0.02, 0.01, 0.005])
        parts.append(replace(o.with_measured(noisy), names=(f"flight{m}",), manoeuvre=np.zeros(o.n, int)))
    fits = {o.names[0]: fit_mle(own, o, extra_starts=0) for o in parts}
    return own, parts, fits


def test_a_parameter_without_information_rests_on_the_other_manoeuvres(unmoved):
    """Of the other parameters the manoeuvre says what its fit with that parameter known says."""
    model, parts, fits = unmoved
    assert fits["flight1"].status is MleStatus.SINGULAR
    given = pooled.normal_estimates(model, parts[1], {"flight1": fits["flight1"]})
    i = model.names.index("Cmde")
    assert not given.determined[0, i]
    assert np.delete(given.determined[0], i).all()
    assert np.isinf(given.sd[0, i])
    known = with_free(model, "CLa", "Cm0", "Cma")
    fit = fit_mle(known, parts[1], extra_starts=0)
    rest = [n for n in model.names if n != "Cmde"]
    units = np.array([p.prior.normal[1] for p in known.free])
    expected = np.linalg.inv(fit.corrected) * np.outer(units, units)
    places = [model.names.index(n) for n in rest]
    np.testing.assert_allclose(given.information[0][np.ix_(places, places)], expected, rtol=1e-5)
    assert np.all(np.abs(given.information[0][i]) < 1e-6 * np.abs(expected).max())


def test_the_next_flight_names_what_is_undetermined_and_needs_two_usable_fits(unmoved):
    model, parts, fits = unmoved
    broken = replace(fits["flight0"], status=MleStatus.NOT_CONVERGED)
    whole = replace(parts[1], names=tuple(fits), manoeuvre=np.ones(parts[1].n, int))  # of the others the fit does
    found = pooled.next_flight(model, whole, fits | {"flight3": broken}, seed=2)
    assert found.status is PosteriorStatus.CONVERGED
    assert found.undetermined == {"Cmde": ("flight1",)}
    assert "Cmde" not in found.alone["flight1"]
    assert found.left_out == {"flight3": MleStatus.NOT_CONVERGED.value}
    assert found.pooled["flight1"]["Cmde"].sd > 2.0 * found.pooled["flight0"]["Cmde"].sd
    for name in ("CLa", "Cma"):
        assert found.pooled["flight1"][name].sd < 0.5 * found.following[name].sd
        low, high = found.aircraft[name].ci95
        assert low < TRUTH[name] < high
    assert found.at_best == pytest.approx((np.sqrt(2.0 / 7.3778), np.sqrt(2.0 / 0.050636)), rel=1e-4)  # tables
    posterior = found.tree["posterior"]
    assert posterior["next_flight"].dims == ("chain", "draw", "parameter")
    assert list(posterior["manoeuvre"].coords["flown"].values) == ["flight0", "flight1", "flight2"]
    with pytest.raises(InputError, match="fewer than two manoeuvres"):
        pooled.next_flight(model, parts[0], {"flight0": broken, "flight2": fits["flight2"]})


def test_a_singular_covariance_is_left_out_with_its_reason(unmoved):
    """One direction of the estimates without scatter: its information would be infinite, and the draws not defined."""
    model, parts, fits = unmoved
    direction = np.ones(len(model.names))
    singular = replace(fits["flight0"], corrected=np.outer(direction, direction))
    given = pooled.normal_estimates(model, parts[0], {"flight0": singular})
    assert not given.names
    assert "singular" in given.left_out["flight0"]


@pytest.mark.parametrize("count", [1, 25])
def test_manoeuvres_that_show_no_scatter_are_refused(count):
    with pytest.raises(InputError, match=f"and there (is|are) {count}; give other records"):
        pooled.check_manoeuvres(count)


def aircraft_and_scatter(v, likelihoods):
    """Means and deviations of aircraft and scatter by integration over both and over each manoeuvre's own value."""
    tau, mu = np.linspace(0.02, 2.5, 150), v[::4]
    kernels = (norm(mu[:, None], t).pdf(v) * (v[1] - v[0]) for t in tau)
    log = np.array([sum(np.log(np.maximum(kernel @ one, 1e-300)) for one in likelihoods) for kernel in kernels])
    log += norm.logpdf(mu) + halfnorm(scale=pooled.SCATTER).logpdf(tau)[:, None]
    weight = np.exp(log - log.max())
    weight /= weight.sum()
    means = [weight.sum(axis=0) @ mu, weight.sum(axis=1) @ tau]
    return means, np.sqrt([weight.sum(axis=0) @ (mu - means[0]) ** 2, weight.sum(axis=1) @ (tau - means[1]) ** 2])


def test_the_normal_approximation_agrees_with_the_full_density_of_simulated_stalls(thinned, model):
    """The likelihood of the break angle is not normal; both are integrated on one grid of aircraft and scatter."""
    alone, rng = with_free(model, "alpha_star"), np.random.default_rng(4)
    (prior,), v = [p.prior for p in alone.free], np.linspace(-1.2, 1.2, 481)  # the angle in units of its prior
    normal, full = [], []
    for m, angle in enumerate((0.262, 0.284)):
        o = thinned.only(m)
        exact = flown_coefficients(alone, o, TRUTH | {"alpha_star": angle})
        o = o.with_measured(jnp.asarray(exact + rng.standard_normal(exact.shape) * [0.1, 0.03, 0.02]))
        fit = fit_mle(alone, o, extra_starts=0)
        white = {o.names[0]: replace(fit, corrected=fit.covariance)}  # as the density has the noise
        given, data = pooled.normal_estimates(alone, o, white), data_of(alone, o)
        normal.append(norm(given.y[0, 0], given.information[0, 0, 0] ** -0.5).pdf(v))
        errors = [np.asarray(evaluate(data, jnp.asarray([x]))[0]) for x in prior.location + prior.scale * v]
        log = np.array([-0.5 * np.sum(np.sum(e**2, axis=0) / fit.R) for e in errors])
        full.append(np.exp(log - log.max()))
    (means, sds), (exact_means, exact_sds) = (aircraft_and_scatter(v, likelihoods) for likelihoods in (normal, full))
    assert np.all(np.abs(np.subtract(means, exact_means)) < 0.05 * exact_sds)
    np.testing.assert_allclose(sds, exact_sds, rtol=0.03)
