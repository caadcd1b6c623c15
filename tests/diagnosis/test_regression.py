"""Regression, gains and sensitivities against plain linear algebra, closed forms and differences."""

from types import SimpleNamespace

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from gusty_flight import TRUTH as GUSTY_TRUTH
from gusty_flight import gusty_flight
from parts import part
from scipy import stats
from scipy.signal import lfilter

from bayes_aero.diagnosis.candidate_set import candidate_model
from bayes_aero.diagnosis.screening.autocorrelation import (
    Autocorrelation,
    Middle,
    autocorrelation_of,
    autocorrelations_of,
)
from bayes_aero.diagnosis.screening.regression import Products, inverse
from bayes_aero.diagnosis.screening.selection_state import SelectionState
from bayes_aero.diagnosis.selection.holdout import LeftOut
from bayes_aero.diagnosis.view.models import compared, profiles
from bayes_aero.dynamics.flight import aircraft_dynamics
from bayes_aero.effect import Stage
from bayes_aero.flight.card import read_card
from bayes_aero.inference.covariance import MAX_ROOT, ORDER, standard_error_of_sum
from bayes_aero.model.joined_channels import join
from bayes_aero.model.model import Model
from bayes_aero.physics.aircraft import FLIGHT, NAMES
from bayes_aero.residuals.equation_error import EquationError
from bayes_aero.residuals.output_error import OutputError
from bayes_aero.simulate.demo import TRUTH
from bayes_aero.simulate.injection import hidden_records


# Regression from inner products, the colour's covariance and noise records: against plain linear algebra
@pytest.fixture(params=[3, 4])
def problem(request):
    rng = np.random.default_rng(request.param)
    m, c, k = 400, 3, 5
    S = rng.standard_normal((m, c, k))
    S[:, 0, 3] = 0.0  # a parameter that does not reach every output
    truth = rng.standard_normal(k)
    residual = S @ truth + np.array([0.1, 1.0, 0.01]) * rng.standard_normal((m, c))
    return residual, S, truth, [slice(0, 150), slice(150, 400)]


def test_fits_are_weighted_least_squares_with_priors_as_observations(problem):
    residual, S, truth, folds = problem
    k = S.shape[2]
    fit = Products.of(residual, S, folds).fit(np.arange(k), np.zeros(k), np.zeros(k))
    w = 1.0 / np.sqrt(fit.variance)
    A, b = (S * w[:, None]).reshape(-1, k), (residual * w).ravel()
    np.testing.assert_allclose(fit.step, np.linalg.lstsq(A, b, rcond=None)[0], rtol=1e-5)
    np.testing.assert_allclose(fit.variance, np.mean((residual - S @ fit.step) ** 2, axis=0), rtol=1e-5)
    mean, precision = np.full(k, 0.3), np.full(k, 1e4)
    fit = Products.of(residual, S, folds).fit(np.arange(k), mean, precision)
    w = 1.0 / np.sqrt(fit.variance)
    A = np.vstack([(S * w[:, None]).reshape(-1, k), np.diag(np.sqrt(precision))])
    b = np.concatenate([(residual * w).ravel(), np.sqrt(precision) * mean])
    np.testing.assert_allclose(fit.step, np.linalg.lstsq(A, b, rcond=None)[0], rtol=1e-5)
    columns = np.array([1, 4])
    moved = Products.of(residual, S, folds).shifted(columns, truth[columns])
    direct = Products.of(residual - S[:, :, columns] @ truth[columns], S, folds)
    np.testing.assert_allclose(moved.gram, direct.gram, atol=1e-8)
    # Columns that are filled up with zeros change nothing.
    S = np.concatenate([S, np.zeros((*residual.shape, 1))], axis=2)
    products, precision = Products.of(residual, S, folds), np.append(np.zeros(k), 1.0)
    alone = products.fit(np.arange(3), np.zeros(k + 1), precision)
    step, _, variance, deviance = products.fit_many(np.array([[0, 1, 2, k, k]]), np.zeros(k + 1), precision)
    np.testing.assert_allclose(step[0, :3], alone.step, rtol=1e-8)
    assert deviance[0] == pytest.approx(alone.deviance)
    np.testing.assert_allclose(variance[0], alone.variance)


def test_colour_is_found_and_reaches_no_further_than_its_fold():
    truth = Autocorrelation(np.array([[0.9, 0.0, 0.0], [0.5, 0.2, 0.1]]), np.array([1.0, 0.3]))
    folds = [slice(0, 4000), slice(4000, 8000)]
    noise = truth.simulate(1, folds, 8000, np.random.default_rng(1))[0]
    found = autocorrelation_of(noise, folds)
    # Least squares has a standard error of about 1/sqrt(n) here.
    np.testing.assert_allclose(found.phi, truth.phi, atol=5 / np.sqrt(8000))
    np.testing.assert_allclose(found.sigma, truth.sigma, rtol=0.05)
    rng = np.random.default_rng(2)
    m, phi, sigma = 300, 0.7, 0.4
    colour = Autocorrelation(np.array([[phi, 0.0, 0.0]]), np.array([sigma]))
    S, variance = rng.standard_normal((m, 1, 2)), np.array([0.5])
    lags = np.abs(np.subtract.outer(np.arange(m), np.arange(m)))
    covariance = sigma**2 / (1 - phi**2) * phi**lags
    W = S[:, 0] / variance[0]
    exact = W.T @ covariance @ W
    # Filtering backwards leaves out what lies before the first sample: a correction of order one sample in m.
    np.testing.assert_allclose(colour.meat(S, variance, [slice(0, m)]), exact, rtol=0.03, atol=0.02 * np.trace(exact))
    colour = Autocorrelation(np.full((1, ORDER), 0.3), np.ones(1))
    noise = colour.simulate(4000, [slice(0, 5), slice(5, 10)], 10, np.random.default_rng(3))[:, :, 0]
    within, across = np.corrcoef(noise[:, 3], noise[:, 4])[0, 1], np.corrcoef(noise[:, 4], noise[:, 5])[0, 1]
    assert within > 0.3
    assert abs(across) < 5 / np.sqrt(4000)


def test_records_fitted_together_are_fitted_each_by_itself():
    """Least squares on the lags by linear algebra; the root of what grows is drawn inside."""
    folds = [slice(0, 200), slice(210, 400)]
    slow = Autocorrelation(np.array([[0.6, 0.2, -0.1]]), np.array([0.7])).simulate(
        2, folds, 400, np.random.default_rng(5)
    )
    growing = (1.02 ** np.arange(400.0) + 0.01 * np.random.default_rng(6).standard_normal(400)).reshape(1, 400, 1)
    found = autocorrelations_of(np.concatenate([slow, growing]), folds)
    for record, one in zip(slow, found, strict=False):
        rows = np.concatenate([np.lib.stride_tricks.sliding_window_view(record[f, 0], ORDER + 1) for f in folds])
        expected = np.linalg.lstsq(rows[:, ORDER - 1 :: -1], rows[:, ORDER], rcond=None)[0]
        np.testing.assert_allclose(one.phi[0], expected, rtol=1e-6)
        left = rows[:, ORDER] - rows[:, ORDER - 1 :: -1] @ expected
        assert one.sigma[0] == pytest.approx(np.sqrt(np.mean(left**2)), rel=1e-6)
    assert np.abs(np.roots(np.append(1.0, -found[2].phi[0]))).max() == pytest.approx(MAX_ROOT, rel=1e-6)


def test_middles_are_the_blocks_of_the_whole(problem):
    _, S, _, folds = problem
    colour = Autocorrelation(np.array([[0.8, 0.1, 0.0], [0.3, 0.0, 0.2], [0.95, 0.0, 0.0]]), np.array([0.1, 1.0, 0.01]))
    variance, places = np.array([0.02, 1.3, 0.001]), [np.array([0]), np.array([1, 3]), np.array([2, 3, 4])]
    diagonal, blocks = Middle(S, variance, folds, places).under_each([colour], [1, 2])
    whole = colour.meat(S, variance, folds)
    np.testing.assert_allclose(diagonal[0], np.diag(whole), rtol=1e-10)
    for block, place in zip(blocks, places[1:], strict=True):
        np.testing.assert_allclose(block[0], whole[np.ix_(place, place)], rtol=1e-10)


def test_no_noise_and_no_information_leave_numbers(problem, recwarn):
    """Altitudes of kilometres that the model follows to the last digit: what is left is rounding, of either sign."""
    _, S, truth, folds = problem
    S = np.concatenate([S, np.ones((len(S), 3, 1))], axis=2)
    exact = S[:, :, :-1] @ truth + 5000.0
    with np.errstate(all="raise"):
        fit = Products.of(exact, S, folds).fit(
            np.arange(len(truth) + 1), np.zeros(len(truth) + 1), np.zeros(len(truth) + 1)
        )
    np.testing.assert_allclose(fit.step, [*truth, 5000.0], rtol=1e-6, atol=1e-6)
    assert np.all(fit.variance > 0.0)
    assert np.all(fit.variance < 1e-6)
    # A candidate that the model imitates wholly leaves none; its square enters a covariance.
    found = inverse(np.diag([4.0, 0.0, 1e-200]))
    assert np.isfinite(found @ found).all()
    assert found[0, 0] == pytest.approx(0.25)
    assert not recwarn.list


def test_no_output_is_given_up_for_another_that_a_wrong_form_fits_worse():
    """Two outputs want a common slope of 1 and of 3; the first, known ten times as well, has another signal beside it.

    The profile of the likelihood has a minimum at each; the lower one, by a grid, is at 1.
    """
    rng = np.random.default_rng(5)
    x, z, w, noise = rng.standard_normal((4, 400))
    residual = np.stack([x + 100.0 * w + 0.01 * noise, 3.0 * z + 0.1 * rng.standard_normal(400)], axis=1)
    S = np.zeros((400, 2, 2))
    S[:, 0, 0], S[:, 1, 0], S[:, 0, 1] = x, z, w
    slopes = np.linspace(0.0, 4.0, 4001)
    left = residual[:, :, None] - S[:, :, :1] * slopes
    left[:, 0] -= np.outer(w, w @ left[:, 0] / (w @ w))
    profile = np.log(np.mean(left**2, axis=0)).sum(axis=0)
    assert slopes[profile.argmin()] == pytest.approx(1.0, abs=0.01)
    assert slopes[2000 + profile[2000:].argmin()] == pytest.approx(3.0, abs=0.05)
    found = Products.of(residual, S, [slice(0, 400)]).fit(np.arange(2), np.zeros(2), np.zeros(2))
    assert found.step == pytest.approx([slopes[profile.argmin()], 100.0], abs=0.01)


# The deviation of a gain on unseen data, against closed forms
LENGTHS = (600, 400)


def ar1(rng, a):
    """Stationary, two stretches that know nothing of each other, driven by unit white noise."""
    stretches = [lfilter([1.0], [1.0, -a], rng.standard_normal(n + 500))[500:] for n in LENGTHS]
    return np.concatenate(stretches)


@pytest.mark.parametrize("a", [0.0, 0.5, 0.9])
def test_deviation_of_a_coloured_sum_is_its_closed_form(a):
    """Var of a sum of n values of AR(1) with unit innovations: n (1-a^2) - 2a(1 - a^n), over (1-a)^2 (1-a^2)."""
    exact = sum((n * (1 - a**2) - 2 * a * (1 - a**n)) / ((1 - a) ** 2 * (1 - a**2)) for n in LENGTHS)
    rng = np.random.default_rng(4132)
    found = np.mean([standard_error_of_sum(ar1(rng, a), LENGTHS) ** 2 for _ in range(300)])
    assert found == pytest.approx(exact, rel=0.2)  # low by a few per cent: the mean is taken out, lags are tapered


def test_stretches_that_are_not_neighbours_are_independent():
    """A series that jumps between its stretches: as one the colour counts across the jumps, as twenty it does not."""
    rng = np.random.default_rng(7)
    values = np.repeat(rng.standard_normal(20), 50)
    apart = standard_error_of_sum(values, [50] * 20)
    assert apart < standard_error_of_sum(values, [len(values)])


def test_a_comparison_by_manoeuvre_is_the_difference_of_plain_scores():
    """Two manoeuvres, three coefficients, known residuals: R2 and normal log densities formed by hand."""
    rng = np.random.default_rng(4132)
    m, second = 900, 350
    manoeuvre = np.repeat([0, 1], [m - second, second])
    measured = np.cumsum(rng.standard_normal((m, 3)), axis=0)
    noise_growth = 1.0 + rng.uniform(0.0, 3.0, (m, 1)) * np.ones(3)
    residuals = [size * rng.standard_normal((m, 3)) for size in (2.0, 1.0)]
    variance_inflation = rng.uniform(1.0, 9.0)
    given = noise_growth, np.ones(m, bool), NAMES, (m - second, second), variance_inflation
    before, after = (LeftOut(residual, *given) for residual in residuals)
    state = part(
        SelectionState, responses=SimpleNamespace(manoeuvre=manoeuvre), variance_inflation=variance_inflation,
        outputs=NAMES,
    )  # fmt: skip
    density = []
    for left in (before, after):
        deviation = np.sqrt(np.mean((left.residual / noise_growth) ** 2, axis=0)) * noise_growth
        density.append(stats.norm.logpdf(left.residual, 0.0, deviation))
    for k in (0, 1):
        found, here = compared(before, after, state, measured, k), manoeuvre == k
        for c, name in enumerate(("CL", "CD", "Cm")):
            r2 = [r2_score(measured[here, c], (measured - left.residual)[here, c]) for left in (before, after)]
            assert found[name].r2 == pytest.approx(r2[1] - r2[0], rel=1e-9)
            assert found[name].elpd == pytest.approx(
                (density[1] - density[0])[here, c].sum() / variance_inflation, rel=1e-9
            )
            assert found[name].r2_sd > 0.0
            assert 0.0 < found[name].elpd_sd < found[name].elpd


def r2_score(z, y):
    return 1.0 - np.sum((z - y) ** 2) / np.sum((z - z.mean()) ** 2)


# Sensitivities of everything measured and modelled, on the shorter way where it leads: against differences
STEP = 1e-5  # of a parameter's usual deviation


@pytest.fixture(scope="module")
def two_stalls(card, model):
    """EquationError of two flights, its field, and parameters near those flown but off neutral.

    Of the length of other tests' flights, whose compiled programs serve.
    """
    flights = join(hidden_records({}, seed=12, noise="white", seconds=90.0), card)
    full = candidate_model(model, flights)
    rng = np.random.default_rng(12)
    deviation = np.array([p.prior.normal[1] for p in full.model.free])
    middle = np.array([TRUTH.get(name, full.neutral[name]) for name in full.model.names])
    theta = middle + 1e-3 * deviation * rng.uniform(0.5, 1.0, len(middle))
    low, high = np.array([p.bounds for p in full.model.free]).T
    return EquationError.of(flights, full.model), full, np.clip(theta, low, high), deviation


def test_sensitivities_of_two_stalls_are_those_of_central_differences(two_stalls):
    responses, full, _, _ = two_stalls
    acting = {p.name for e in full.model.effects if e.stage <= Stage.AIRCRAFT for p in e.parameters}
    assert {full.model.names[i] for i in responses.measuring} == acting & set(full.model.names)
    responses, full, theta, deviation = two_stalls
    residual, S = responses.linearise(theta)
    np.testing.assert_allclose(residual, responses.evaluate(theta)[0], atol=1e-12)
    for i, name in enumerate(full.model.names):
        h = STEP * deviation[i]
        ahead, behind = (
            np.asarray(responses.evaluate(theta + s * h * (np.arange(len(theta)) == i))[0]) for s in (1, -1)
        )
        slope = -(ahead - behind) / (2.0 * h)
        # Rounding of the integrals along the flight path, over the step.
        floor = 1e-11 / h
        assert np.linalg.norm(S[:, :, i] - slope) <= 1e-3 * np.linalg.norm(slope) + floor * np.sqrt(slope.size), name
    responses, _, theta, _ = two_stalls
    whole = responses.linearise(theta)[1]
    columns = np.random.default_rng(4).permutation(len(theta))[:21]
    np.testing.assert_allclose(responses.linearise(theta, columns)[1], whole[:, :, columns], rtol=1e-9, atol=1e-12)


# Sensitivities of simulated windows to where they begin, against differences
def test_offsets_are_central_differences_along_initial_states():
    """Two windows, each with an initial state of its own, of which the other knows nothing."""
    card = read_card("hfb320")
    model = Model.from_card(card)
    flights = join([gusty_flight(5, seconds=20.0)], card, FLIGHT)
    responses = OutputError.of(flights, aircraft_dynamics(model, flights))
    theta = np.array([GUSTY_TRUTH.get(p.name, p.start) for p in model.free])
    offsets, states = responses.offsets(theta, responses.outputs), responses.windows.dynamics.start
    window = np.asarray(responses.stretch)
    assert set(window) == {0, 1}
    residual = eqx.filter_jit(lambda shared: responses.residual(jnp.asarray(theta), shared))
    for k in range(len(states)):
        step = STEP * (np.arange(len(states)) == k)
        ahead, behind = (np.asarray(residual(jnp.asarray(sign * step))) for sign in (1, -1))
        slope = (behind - ahead) / (2.0 * STEP)
        for w in (0, 1):
            own = offsets[:, :, w * len(states) + k]
            np.testing.assert_allclose(own[window == w], slope[window == w], atol=1e-7 * np.abs(slope).max())
            assert not own[window != w].any()


# Mean residuals over a channel: the channel that the residual follows comes first
N = 600


@pytest.mark.parametrize("rest", [0, 200])
def test_the_channel_that_the_residual_follows_comes_first(rest):
    """Also of a simulation without noise that begins at rest: a bin of equal residuals has no deviation."""
    rng = np.random.default_rng(0)
    followed, other = rng.uniform(-1.0, 1.0, (2, N))
    followed[:rest], other[:rest] = -1.0, 0.0
    found = profiles(1e-5 * followed**2, {"other": other, "followed": followed}, 1.0)
    assert [p.channel for p in found] == ["followed", "other"]
    assert (np.min(found[0].deviation) == 0.0) == (rest > 0)
    np.testing.assert_allclose(found[0].mean, 1e-5 * found[0].centre ** 2, atol=2e-7)
