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


class Means(np.random.Generator):
    """A random generator whose normal numbers are their means: draws become expectations."""

    def __init__(self):
        super().__init__(np.random.PCG64(0))

    def standard_normal(self, size=None, *_, **__):
        return np.zeros(size)


def one_parameter():
    return pooled.Hierarchy.of(("a",), ESTIMATES, 1.0 / ERRORS[:, None, None] ** 2)


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
    means = pooled.given_scatter(one_parameter(), np.full((1, 1, 1), scatter), Means())
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
    density = one_parameter()
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
def unmoved(clean, model):
    """Three manoeuvres; in the second the elevator never moves, so that it says nothing of Cmde."""
    own = with_free(model, "CLa", "Cmde", "Cm0", "Cma")
    rng, parts = np.random.default_rng(6), []
    for m in range(3):
        o = clean.only(m % 2).subset(np.arange(0, 2000, 4))
        o = o.restarted(np.arange(500) == 0)
        if m == 1:
            o = replace(o, signals=o.signals | {"elevator": jnp.zeros(500)})
        exact = flown_coefficients(model, o, TRUTH)
        noise = rng.standard_normal(exact.shape) * [0.02, 0.01, 0.005]
        parts.append(
            replace(o.with_measured(jnp.asarray(exact + noise)), names=(f"flight{m}",), manoeuvre=np.zeros(500, int))
        )
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
    whole = replace(parts[1], names=tuple(fits), manoeuvre=np.ones(500, int))  # of the others the fit is enough
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


@pytest.fixture(scope="module")
def break_angle(thinned, model):
    """Two stalls with white noise, in which the break angle is the only free parameter."""
    alone = with_free(model, "alpha_star")
    rng, found = np.random.default_rng(4), []
    for m, angle in enumerate((0.262, 0.284)):
        o = thinned.only(m)
        exact = flown_coefficients(model, o, TRUTH | {"alpha_star": angle})
        noisy = exact + rng.standard_normal(exact.shape) * [0.1, 0.03, 0.02]
        found.append(o.with_measured(jnp.asarray(noisy)))
    return alone, found


def aircraft_and_scatter(v, likelihoods):
    """Means and deviations of aircraft and scatter by integration over both and over each manoeuvre's own value."""
    step, tau, mu = v[1] - v[0], np.linspace(0.02, 2.5, 150), v[::4]
    log = np.zeros((len(tau), len(mu)))
    for i, t in enumerate(tau):
        kernel = norm(mu[:, None], t).pdf(v) * step
        log[i] = (
            sum(np.log(np.maximum(kernel @ one, 1e-300)) for one in likelihoods)
            + norm.logpdf(mu)
            + halfnorm(scale=pooled.SCATTER).logpdf(t)
        )
    weight = np.exp(log - log.max())
    weight /= weight.sum()
    moments = []
    for x, w in ((mu, weight.sum(axis=0)), (tau, weight.sum(axis=1))):
        mean = w @ x
        moments += [mean, np.sqrt(w @ (x - mean) ** 2)]
    return moments


def test_the_normal_approximation_agrees_with_the_full_density_of_simulated_stalls(break_angle):
    """The likelihood of the break angle is not normal; both are integrated on one grid of aircraft and scatter."""
    model, flown = break_angle
    (prior,) = [p.prior for p in model.free]
    fits = [fit_mle(model, o, extra_starts=0) for o in flown]
    fits = [replace(fit, corrected=fit.covariance) for fit in fits]  # white noise, as the density has it
    given = [pooled.normal_estimates(model, o, {o.names[0]: f}) for o, f in zip(flown, fits, strict=True)]
    v = np.linspace(-1.2, 1.2, 481)  # the break angle in units of its prior
    normal = [norm(g.y[0, 0], g.information[0, 0, 0] ** -0.5).pdf(v) for g in given]
    full = []
    for o, fit in zip(flown, fits, strict=True):
        data = data_of(model, o)
        at = prior.location + prior.scale * v
        squares = np.array([np.sum(np.asarray(evaluate(data, jnp.asarray([x]))[0]) ** 2, axis=0) for x in at])
        log = -0.5 * np.sum(squares / fit.R, axis=1)
        full.append(np.exp(log - log.max()))
    moments = [aircraft_and_scatter(v, likelihoods) for likelihoods in (normal, full)]
    (a_mean, a_sd, t_mean, t_sd), (A_mean, A_sd, T_mean, T_sd) = moments
    assert abs(a_mean - A_mean) < 0.05 * A_sd
    assert abs(t_mean - T_mean) < 0.05 * T_sd
    assert a_sd == pytest.approx(A_sd, rel=0.03)
    assert t_sd == pytest.approx(T_sd, rel=0.03)
