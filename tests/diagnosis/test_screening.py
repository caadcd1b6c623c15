"""Screening against linear algebra and closed forms: regression, colour, gains, what is noise and what is no rival."""

from dataclasses import dataclass, replace
from types import SimpleNamespace

import jsonschema
import numpy as np
import pytest
from parts import cause, part
from scipy import stats
from scipy.linalg import lstsq
from scipy.signal import lfilter

from bayes_aero.diagnosis import diagnose, selection, selection_state
from bayes_aero.diagnosis.diagnose import compared, judged_on_held_out_flights, profiles
from bayes_aero.diagnosis.result import Absorbed, Confirmation, Size, Verdict, verdict_of
from bayes_aero.diagnosis.screening import (
    Autocorrelation,
    CandidateScore,
    Middle,
    PartialledRegression,
    ScreeningResult,
    autocorrelations_of,
    block_jackknife_covariance,
    screen,
    white_noise,
)
from bayes_aero.diagnosis.selection import Extension, LeftOut, absorbed, worth
from bayes_aero.diagnosis.selection_state import (
    DEFAULT,
    CandidateModel,
    Products,
    RegressionFit,
    SelectionState,
    candidate_model,
    inverse,
    linearised,
    refitted,
)
from bayes_aero.diagnosis.unexplained import left_beside
from bayes_aero.effect import Stage
from bayes_aero.effects import CATALOGUE
from bayes_aero.inference.covariance import MAX_ROOT, ORDER, standard_error_of_sum
from bayes_aero.jobs.documents import AbsorbedPart, document_schema
from bayes_aero.jobs.store import plain
from bayes_aero.model.model import Model
from bayes_aero.model.observations import join
from bayes_aero.model.records import Flights
from bayes_aero.physics.aircraft import NAMES, Axis
from bayes_aero.report.pages.diagnosis import sentences
from bayes_aero.residuals.base import Blockwise
from bayes_aero.residuals.equation_error import EquationError
from bayes_aero.simulate.demo import TRUTH
from bayes_aero.simulate.injection import hidden_records


# Regression from inner products, the colour's covariance and noise records: against plain linear algebra
@pytest.fixture
def problem():
    rng = np.random.default_rng(3)
    m, c, k = 400, 3, 5
    S = rng.standard_normal((m, c, k))
    S[:, 0, 3] = 0.0  # a parameter that does not reach every output
    truth = rng.standard_normal(k)
    residual = S @ truth + np.array([0.1, 1.0, 0.01]) * rng.standard_normal((m, c))
    return residual, S, truth, [slice(0, 150), slice(150, 400)]


@pytest.mark.parametrize("weight", [0.0, 1e4])
def test_fits_are_weighted_least_squares_with_priors_as_observations(problem, weight):
    residual, S, _, folds = problem
    k = S.shape[2]
    mean, precision = np.full(k, 0.3), np.full(k, weight)
    fit = Products.of(residual, S, folds).fit(np.arange(k), mean, precision)
    w = 1.0 / np.sqrt(fit.variance)
    A = np.vstack([(S * w[:, None]).reshape(-1, k), np.diag(np.sqrt(precision))])
    b = np.concatenate([(residual * w).ravel(), np.sqrt(precision) * mean])
    np.testing.assert_allclose(fit.step, lstsq(A, b)[0], rtol=1e-5)
    np.testing.assert_allclose(fit.variance, np.mean((residual - S @ fit.step) ** 2, axis=0), rtol=1e-5)


def test_products_move_with_the_parameters_and_columns_of_zeros_change_nothing(problem):
    residual, S, truth, folds = problem
    k, columns = S.shape[2], np.array([1, 4])
    moved = Products.of(residual, S, folds).shifted(columns, truth[columns])
    direct = Products.of(residual - S[:, :, columns] @ truth[columns], S, folds)
    np.testing.assert_allclose(moved.gram, direct.gram, atol=1e-8)
    S = np.concatenate([S, np.zeros((*residual.shape, 1))], axis=2)
    products, precision = Products.of(residual, S, folds), np.append(np.zeros(k), 1.0)
    alone = products.fit(np.arange(3), np.zeros(k + 1), precision)
    step, _, variance, deviance = products.fit_many(np.array([[0, 1, 2, k, k]]), np.zeros(k + 1), precision)
    np.testing.assert_allclose(step[0, :3], alone.step, rtol=1e-8)
    assert deviance[0] == pytest.approx(alone.deviance)
    np.testing.assert_allclose(variance[0], alone.variance)


def simulated(colour: Autocorrelation, count: int, folds, m: int, rng) -> np.ndarray:
    """Noise records (count, m, c) of this colour."""
    return colour.coloured(white_noise(count, folds, len(colour.sigma), rng), folds, m)


def test_colour_has_its_covariance_and_reaches_no_further_than_its_fold():
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
    noise = simulated(colour, 4000, [slice(0, 5), slice(5, 10)], 10, np.random.default_rng(3))[:, :, 0]
    within, across = np.corrcoef(noise[:, 3], noise[:, 4])[0, 1], np.corrcoef(noise[:, 4], noise[:, 5])[0, 1]
    assert within > 0.3
    assert abs(across) < 5 / np.sqrt(4000)


def test_records_fitted_together_are_fitted_each_by_itself():
    """Least squares on the lags by linear algebra; the root of what grows is drawn inside."""
    folds = [slice(0, 200), slice(210, 400)]
    slow = Autocorrelation(np.array([[0.6, 0.2, -0.1]]), np.array([0.7]))
    slow = simulated(slow, 2, folds, 400, np.random.default_rng(5))
    growing = (1.02 ** np.arange(400.0) + 0.01 * np.random.default_rng(6).standard_normal(400)).reshape(1, 400, 1)
    found = autocorrelations_of(np.concatenate([slow, growing]), folds)
    for record, one in zip(slow, found, strict=False):
        rows = np.concatenate([np.lib.stride_tricks.sliding_window_view(record[f, 0], ORDER + 1) for f in folds])
        expected = np.linalg.lstsq(rows[:, ORDER - 1 :: -1], rows[:, ORDER], rcond=None)[0]
        np.testing.assert_allclose(one.phi[0], expected, rtol=1e-6)
        left = rows[:, ORDER] - rows[:, ORDER - 1 :: -1] @ expected
        assert one.sigma[0] == pytest.approx(np.sqrt(np.mean(left**2)), rel=1e-6)
    assert np.abs(np.roots(np.append(1.0, -found[2].phi[0]))).max() == pytest.approx(MAX_ROOT, rel=1e-6)


@pytest.mark.parametrize("count", [1, 30])  # filtered one after another, or by sums over lags
def test_middles_are_the_blocks_of_the_whole(problem, count):
    _, S, _, folds = problem
    colour = Autocorrelation(np.array([[0.8, 0.1, 0.0], [0.3, 0.0, 0.2], [0.95, 0.0, 0.0]]), np.array([0.1, 1.0, 0.01]))
    variance, places = np.array([0.02, 1.3, 0.001]), [np.array([0]), np.array([1, 3]), np.array([2, 3, 4])]
    diagonal, blocks = Middle(S, variance, folds, places).under_each([colour] * count, [1, 2])
    whole = colour.meat(S, variance, folds)
    np.testing.assert_allclose(diagonal[-1], np.diag(whole), rtol=1e-10)
    for block, place in zip(blocks, places[1:], strict=True):
        np.testing.assert_allclose(block[-1], whole[np.ix_(place, place)], rtol=1e-10)


def test_no_noise_and_no_information_leave_numbers(problem, recwarn):
    """Altitudes of kilometres that the model follows to the last digit: what is left is rounding, of either sign."""
    _, S, truth, folds = problem
    S = np.concatenate([S, np.ones((len(S), 3, 1))], axis=2)
    exact = S[:, :, :-1] @ truth + 5000.0
    with np.errstate(all="raise"):
        fit = Products.of(exact, S, folds).fit(np.arange(6), np.zeros(6), np.zeros(6))
    np.testing.assert_allclose(fit.step, [*truth, 5000.0], rtol=1e-6, atol=1e-6)
    assert np.all((fit.variance > 0.0) & (fit.variance < 1e-6))
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


@pytest.mark.parametrize("a", [0.0, 0.9])
def test_deviation_of_a_coloured_sum_is_its_closed_form(a):
    """Var of a sum of n values of AR(1) with unit innovations: n (1-a^2) - 2a(1 - a^n), over (1-a)^2 (1-a^2)."""
    exact = sum((n * (1 - a**2) - 2 * a * (1 - a**n)) / ((1 - a) ** 2 * (1 - a**2)) for n in LENGTHS)
    rng = np.random.default_rng(4132)
    found = np.mean([standard_error_of_sum(ar1(rng, a), LENGTHS) ** 2 for _ in range(300)])
    assert found == pytest.approx(exact, rel=0.2)  # low by a few per cent: the mean is taken out, lags are tapered


def test_a_comparison_by_manoeuvre_is_the_difference_of_plain_scores():
    """Two manoeuvres, three coefficients: R2 and normal log densities formed by hand."""
    rng, m, second, inflation = np.random.default_rng(4132), 900, 350, 3.0
    manoeuvre = np.repeat([0, 1], [m - second, second])
    measured = np.cumsum(rng.standard_normal((m, 3)), axis=0)
    growth = 1.0 + rng.uniform(0.0, 3.0, (m, 1)) * np.ones(3)
    given = growth, np.ones(m, bool), NAMES, (m - second, second), inflation
    before, after = (LeftOut(size * rng.standard_normal((m, 3)), *given) for size in (2.0, 1.0))
    responses = SimpleNamespace(manoeuvre=manoeuvre)
    state = part(SelectionState, responses=responses, variance_inflation=inflation, outputs=NAMES)
    density, squares = [], []
    for left in (before, after):
        deviation = np.sqrt(np.mean((left.residual / growth) ** 2, axis=0)) * growth
        density.append(stats.norm.logpdf(left.residual, 0.0, deviation))
        squares.append(left.residual**2)
    for k in (0, 1):
        scores, here = compared(before, after, state, measured, k), manoeuvre == k
        total = np.sum((measured[here] - measured[here].mean(axis=0)) ** 2, axis=0)
        for c, name in enumerate(NAMES):
            score = scores[name]
            assert score.r2 == pytest.approx((squares[0] - squares[1])[here, c].sum() / total[c], rel=1e-9)
            assert score.elpd == pytest.approx((density[1] - density[0])[here, c].sum() / inflation, rel=1e-9)
            assert score.r2_sd > 0.0
            assert 0.0 < score.elpd_sd < score.elpd


# Sensitivities of everything measured and modelled, on the shorter way where it leads: against differences
def test_sensitivities_of_two_stalls_are_those_of_central_differences(card, model):
    """Near the parameters that were flown but off neutral; of the length of other tests' flights: compiled already."""
    flights = join(hidden_records({}, seed=12, noise="white", seconds=90.0), card)
    full = candidate_model(model, flights)
    rng, responses, free = np.random.default_rng(12), EquationError.of(flights, full.model), full.model.free
    deviation = np.array([p.prior.normal[1] for p in free])
    theta = full.vector({p.name: TRUTH.get(p.name, full.neutral[p.name]) for p in free})
    theta = theta + 1e-3 * deviation * rng.uniform(0.5, 1.0, len(theta))
    theta = np.clip(theta, *np.array([p.bounds for p in free]).T)
    acting = {p.name for e in full.model.effects if e.stage <= Stage.AIRCRAFT for p in e.parameters}
    assert {full.model.names[i] for i in responses.measuring} == acting & set(full.model.names)
    residual, S = responses.linearise(theta)
    np.testing.assert_allclose(residual, responses.evaluate(theta)[0], atol=1e-12)
    for i, name in enumerate(full.model.names):
        h = 1e-5 * deviation[i]  # of its usual one
        step = h * (np.arange(len(theta)) == i)
        ahead, behind = (np.asarray(responses.evaluate(theta + s * step)[0]) for s in (1, -1))
        slope = -(ahead - behind) / (2.0 * h)
        # Rounding of the integrals along the flight path, over the step.
        floor = 1e-11 / h
        assert np.linalg.norm(S[:, :, i] - slope) <= 1e-3 * np.linalg.norm(slope) + floor * np.sqrt(slope.size), name
    columns = np.random.default_rng(4).permutation(len(theta))[:21]
    np.testing.assert_allclose(responses.linearise(theta, columns)[1], S[:, :, columns], rtol=1e-9, atol=1e-12)


# A residual model of a newcomer: one class, and all that searches over residual models uses it


@dataclass(frozen=True)
class Straight(Blockwise):
    """Outputs that are linear in all parameters."""

    flights: Flights
    model: Model
    measured: np.ndarray  # (m, c)
    per_parameter: np.ndarray  # (m, c, k)
    stage = "straight"

    @property
    def outputs(self):
        return NAMES

    def evaluate(self, theta):
        return self.measured - self.per_parameter @ theta, {"X": np.ones(self.flights.n)}

    def slopes(self, theta, directions):
        return self.evaluate(theta)[0], np.einsum("mck,dk->dmc", self.per_parameter, directions)


def test_a_residual_model_is_one_class(state):
    rng, full, truth = np.random.default_rng(0), state.full, state.theta.copy()
    own = full.own_columns("pitch_rate_lift")
    truth[own] = 8.0
    sensitivities = state.responses.linearise(state.theta)[1][:, :3]
    measured = sensitivities @ truth
    measured = measured + 0.01 * measured.std(axis=0) * rng.standard_normal(measured.shape)
    straight = Straight(state.responses.flights, full.model, measured, sensitivities)
    assert screen(linearised(full, straight, NAMES, state.theta)).candidate_scores[0].effect == "pitch_rate_lift"
    fitted = refitted(linearised(full, straight, NAMES, state.theta, active=("pitch_rate_lift",)))
    assert fitted.theta[own] == pytest.approx([8.0], rel=0.1)


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


def state_of(S, folds, **given) -> SelectionState:
    """A state in which noise does not grow."""
    return part(SelectionState, S=S, noise_growth=np.ones(S.shape[:2]), folds=folds, **given)


# What only takes correlated noise out of one coefficient with another gains nothing; nor is doubt a cause
@pytest.fixture
def projected():
    """Noise of one sensor in two of three coefficients; columns: a constant (in the model), that noise, a wave."""
    rng = np.random.default_rng(31)
    n = 2400
    vane = rng.standard_normal(n)
    residual = 0.3 * rng.standard_normal((n, 3))
    residual[:, 0] += vane
    residual[:, 2] += rng.uniform(0.5, 2.0) * vane
    wave = np.sin(np.arange(n) / 9.0)
    residual[:, 2] += rng.uniform(0.8, 1.5) * wave
    S = np.zeros((n, 3, 3))
    S[:, :, 0], S[:, 2, 1], S[:, 2, 2] = 1.0, residual[:, 0], wave
    residual -= residual.mean(axis=0)
    state = state_of(S, (slice(0, 1200), slice(1200, n)))
    variance = residual.var(axis=0)
    fit = RegressionFit(np.array([0]), np.zeros(1), np.array([[n * np.sum(1.0 / variance)]]), variance, 0.0)
    return PartialledRegression(state, fit, [np.array([1]), np.array([2])]), residual


def test_a_whole_covariance_leaves_nothing_to_sums_of_outputs(projected):
    given, residual = projected
    right = given.right(residual)
    for block, (mixes, coefficient) in enumerate([(True, 2), (False, 2)]):
        place = given.place[block]
        estimate = given.bread[block] @ right[place]
        left = residual[:, coefficient] - (given.P[:, :, place] @ estimate)[:, coefficient]
        alone = len(left) * np.log(np.mean(residual[:, coefficient] ** 2) / np.mean(left**2))
        together = given.deviance(residual) - given.deviance(residual, block, estimate)
        assert alone > 100.0
        assert (together < 0.05 * alone) if mixes else (together > 0.7 * alone)
    mix = np.array([[1.0, 0.0, 0.7], [0.0, 1.0, 0.0], [0.0, -2.0, 1.0]])
    expected = given.deviance(residual) + 2.0 * len(residual) * np.log(abs(np.linalg.det(mix)))
    assert given.deviance(residual @ mix.T) == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("share", [0.02, 1.0])
def test_noise_of_a_recorded_channel_bends_a_slope_by_no_more_than_residuals_permit(share):
    """y = a x, x recorded with noise: least squares gives a V/(V + s2), and a true slope is within the bounds.

    `share` of what is left is that noise, of whatever colour. Closed form: the lowest bias is -r2/(a var(x)), r2 what
    is left and a, var(x) as estimated and recorded; to first order in it.
    """
    rng, n, slope, sd = np.random.default_rng(8), 40_000, -0.8, 0.02
    beta = 0.1 * np.sin(np.arange(n) / 9.0)
    y = slope * beta
    beta = beta + sd * rng.standard_normal(n)
    y = y + abs(slope) * sd * np.sqrt(1.0 / share - 1.0) * rng.standard_normal(n)
    estimate = float(beta @ y / (beta @ beta))
    left = y - estimate * beta
    r2 = float(np.mean(left**2))

    def of(x):
        along = lambda theta, directions: ((y - theta[0] * x)[:, None], x[:, None, None] * directions[:, 0])
        return SimpleNamespace(along=along, outputs=("CY",))

    responses = of(beta)
    responses.noisy = {"beta": of(beta + sd * rng.standard_normal(n))}
    effect = CATALOGUE["sideslip_side_force"]
    fit = RegressionFit(np.array([0]), np.zeros(1), np.array([[beta @ beta / r2]]), np.array([r2]), 0.0)
    state = state_of(
        beta[:, None, None], (slice(0, n),), active=(effect.name,), responses=responses, outputs=("CY",),
        full=part(CandidateModel, candidates=(effect,), model=Model.of([effect], axes=(Axis.LATERAL,))),
        theta=np.array([estimate]), residual=left[:, None],
    )  # fmt: skip
    object.__setattr__(state, "best", fit)
    ((low, high),) = selection.largest_noise_bias(state).values()
    exact = -r2 / (estimate * np.mean(beta**2))
    assert sorted((low, high)) == pytest.approx(sorted((0.0, exact)), rel=0.05, abs=1e-6)
    if share == 1.0:
        assert estimate - exact == pytest.approx(slope, rel=0.02)


def test_the_bias_of_one_addition_is_that_which_it_has_among_all(diagnosed):
    state = diagnosed.view.diagnosis.sensors.state
    one, other = (state.full.own_columns(name) for name in ("pitch_rate_bias", "alpha_bias"))
    theta = state.full.neutral_vector
    theta[one], theta[other] = 0.002, 0.01
    state = selection_state.moved(state, theta, ("pitch_rate_bias", "alpha_bias"))
    both = selection.largest_noise_bias(state)
    assert len(both) == 2
    for name in state.active:
        (pair,) = selection.largest_noise_bias(state, (name,)).values()
        assert pair == pytest.approx(both[name], rel=1e-6)
        assert pair[0] < pair[1]


@pytest.mark.parametrize(("score", "named"), [(2.4, False), (2.6, True)])
def test_a_size_that_may_as_well_be_none_is_no_cause(monkeypatch, score, named):
    size = 2.0 * CATALOGUE["cg_shift"].sizes["cg_shift"][0]
    full = part(CandidateModel, candidates=(CATALOGUE["cg_shift"],), model=Model.of(["cg_shift"]))
    monkeypatch.setattr(selection, "largest_noise_bias", lambda *_: {})
    state = part(SelectionState, active=("cg_shift",), full=full)
    causes, minor = worth(state, {"cg_shift": Size(size, size / score, "m")})
    assert (causes, minor) == ((("cg_shift",), ()) if named else ((), ("cg_shift",)))


def ranked(monkeypatch, *standing) -> CandidateModel:
    """A screening of effects by name, gain, step and gain under the whole covariance; the candidates are they."""
    scores = tuple(
        CandidateScore(name, (0,), None, gain, 12.0, 1.0, 50.0, (step,), (0.01,), together, 1.0)
        for name, gain, step, together in standing
    )
    monkeypatch.setattr(diagnose, "screen", lambda *_, **__: part(ScreeningResult, candidate_scores=scores))
    return part(CandidateModel, candidates=tuple(CATALOGUE[one.effect] for one in scores), settings=DEFAULT)


LARGEST = CATALOGUE["vane_position"].sizes["vane_position"][1]


@pytest.mark.parametrize(("outputs", "rival", "gain", "step", "together", "before", "cause", "close"), [
    # A centre of gravity that adds CY to Cn takes the vane's noise out of Cn, whatever else is missing there.
    (("CY", "Cl", "Cn"), "cg_shift", 500.0, 0.1, -140.0, None, "sideslip_cubed_yaw", False),
    (("CY", "Cl", "Cn"), "cg_shift", 500.0, 0.1, 480.0, None, "sideslip_cubed_yaw", True),
    # A vane farther ahead than on any aircraft explains nothing: to first order, or fitted before.
    (("V",), "vane_position", 260.0, 0.9, 260.0, None, "alpha_bias", True),
    (("V",), "vane_position", 260.0, 1.1, 260.0, None, "alpha_bias", False),
    (("V",), "vane_position", 260.0, 0.5, 260.0, 0.9, "alpha_bias", True),
    (("V",), "vane_position", 260.0, 0.5, 260.0, 1.1, "alpha_bias", False),
])  # fmt: skip
def test_what_mixes_noise_or_must_be_larger_than_aircraft_have_is_no_rival(
    monkeypatch, outputs, rival, gain, step, together, before, cause, close
):
    size = LARGEST if rival == "vane_position" else 1.0
    full = ranked(monkeypatch, (rival, gain, step * size, together), (cause, 250.0, 0.01, 250.0))
    responses = SimpleNamespace(model=SimpleNamespace(coefficients=outputs if outputs[0] == "CY" else ("CL",)))
    state = part(SelectionState, full=full, responses=responses, outputs=outputs, active=(rival,))
    sized = None if before is None else part(
        Extension, base=part(SelectionState, active=()), state=state, too_large=None,
        sizes={rival: Size(before * size, 1.0, "m")},
    )  # fmt: skip
    probability, rivals = diagnose.rivals_of(part(Extension, state=state, too_large=sized), cause)
    assert rivals == ((rival,) if close else ())
    assert probability == pytest.approx(0.5 if close else 1.0)


# A derivative of a control at rest takes up what is constant: by how much, in closed form, and where it does not
NOISE, SAMPLES = 1e-5, 400
USUAL, WIDTH = CATALOGUE["rudder_yaw"].parameters[0].prior.normal


def fitted(rudder: np.ndarray, hidden: float) -> Extension:
    """A card that knows of yaw only the rudder, fitted to a rudder as usual and a yawing moment without cause."""
    model, outputs = Model.of(["rudder_yaw", "yaw_offset"], axes=tuple(Axis)), ("CY", "Cl", "Cn")
    full, at = CandidateModel(model, ("rudder_yaw",), (CATALOGUE["yaw_offset"],), {}), model.names.index("Cndr")
    S, folds = np.zeros((SAMPLES, 3, 3)), (slice(0, 200), slice(200, SAMPLES))
    S[:, 2, at], S[:, 2, model.names.index("Cn0")] = rudder, 1.0
    measured = NOISE * np.random.default_rng(5).standard_normal((SAMPLES, 3))
    measured[:, 2] += hidden + USUAL * rudder

    def state(theta: np.ndarray) -> SelectionState:
        residual = measured - S[:, :, :2] @ theta
        mean, precision = full.prior(range(2), theta)
        return state_of(
            S, folds, full=full, outputs=outputs, theta=theta, residual=residual, scans=(), nuisance=0, active=(),
            products=Products.of(residual, S, folds), mean=np.append(mean, 0.0), precision=np.append(precision, 1.0),
            chosen=(), components=(), variance_inflation=1.0,
            responses=SimpleNamespace(model=SimpleNamespace(coefficients=outputs)),
        )  # fmt: skip

    theta = np.zeros(2)
    theta[at] = state(theta).fit().step.sum()  # one, or none where the rudder makes nothing
    return part(Extension, state=state(theta), sizes={"Cndr": Size(float(theta[at]), 1e-3, "1/rad")})


def test_what_a_rudder_at_rest_takes_up_has_the_size_that_it_has_with_a_usual_rudder():
    """Cn0 = (Cndr - usual) dr, and its deviation that of the prior times dr."""
    held, hidden = 0.0075, 9e-4
    (found,) = absorbed(fitted(np.full(SAMPLES, held), hidden))
    assert (found.effect, found.parameter, found.control) == ("rudder_yaw", "Cndr", "rudder")
    assert found.estimate[0] == pytest.approx(USUAL + hidden / held, abs=0.01)
    assert found.usual == (USUAL, WIDTH)
    assert found.members == {"rudder_yaw", "yaw_offset"}
    size = found.sizes["yaw_offset"]
    assert size.mean == pytest.approx(hidden, rel=0.02)
    assert size.sd == pytest.approx(WIDTH * held, rel=0.05)


@pytest.mark.parametrize(("held", "moves", "hidden"), [
    (0.0075, 0.02, 9e-4),  # it moves, and tells its derivative
    (0.0, 0.0, 9e-4),  # neutral, it makes nothing
    (1e-4, 0.0, 9e-4),  # so little aside that it would need a derivative that no rudder has
    (0.0075, 0.0, 2e-4),  # what it takes up is not worth a name
    (0.0075, 0.0, 0.02),  # nor is there so much on any aircraft
])  # fmt: skip
def test_elsewhere_nothing_is_taken_up(held, moves, hidden):
    rudder = held + moves * np.sin(np.arange(SAMPLES) / 9.0)
    assert absorbed(fitted(rudder, hidden)) == ()


def test_what_is_taken_up_is_in_the_verdict_and_the_text(diagnosed):
    taken_up = absorbed(fitted(np.full(SAMPLES, 0.0075), 9e-4))
    assert verdict_of((), (), absorbed=taken_up) is Verdict.UNDECIDED
    assert verdict_of([cause()], (), absorbed=taken_up) is Verdict.EXPLAINED
    silent = replace(diagnosed.view.diagnosis, causes=(), unknown=(), changes=(), tested=None)
    for given, verdict in ((taken_up, Verdict.UNDECIDED), ((), Verdict.NO_EFFECT)):
        after = judged_on_held_out_flights(replace(silent, absorbed=given), Confirmation((), {}))
        assert after.verdict is verdict
    sizes = {"thrust_scale": Size(-0.1, 0.2, "1")}
    elevator = Absorbed("elevator_moment", "Cmde", "1/rad", "elevator", (-0.2, 0.01), (-1.0, 0.5), sizes)
    said = sentences(replace(diagnosed.view.diagnosis, absorbed=(elevator,)))
    (sentence,) = (x for x in said if "elevator does not move" in x)
    for told in ("Cmde", "-0.200 ± 0.010", "-1.00 ± 0.50", "thrust_scale", "cannot tell which"):
        assert told in sentence
    schema, written = document_schema("diagnosis"), plain([AbsorbedPart.of(elevator)])
    jsonschema.validate(written, schema["properties"]["absorbed"] | {"$defs": schema["$defs"]})
    assert written[0]["usual"] == {"mean": -1.0, "sd": 0.5}


# What a candidate is worth where folds have gaps between them, as those of a single manoeuvre do
def test_information_is_what_the_model_cannot_follow_in_the_folds():
    """Against least squares on the folds alone; a candidate that the model follows everywhere has none."""
    rng = np.random.default_rng(40)
    n, k, gap = 900, 4, 40
    folds = tuple(slice(begin, begin + 300 - gap) for begin in (0, 300, 600))
    S = np.cumsum(rng.standard_normal((n, 3, k + 2)), axis=0) + rng.uniform(3.0, 9.0, k + 2)
    S[:, :, k] = S[:, :, :k] @ rng.standard_normal(k)
    residual = rng.standard_normal((n, 3)) * [1.0, 0.1, 3.0]
    fit = Products.of(residual, S, folds).fit(np.arange(k), np.zeros(k + 2), np.zeros(k + 2))
    information = PartialledRegression(state_of(S, folds), fit, [np.array([k]), np.array([k + 1])]).information
    inside = np.concatenate([np.arange(n)[fold] for fold in folds])
    A = (S[inside] / np.sqrt(fit.variance)[:, None]).reshape(-1, k + 2)
    left = A[:, k + 1] - A[:, :k] @ lstsq(A[:, :k], A[:, k + 1])[0]
    assert information[1, 1] == pytest.approx(left @ left, rel=1e-6)
    assert information[0, 0] < 1e-12 * (A[:, k] @ A[:, k])


def test_two_rivals_are_told_apart_by_the_noise_along_what_parts_them():
    """Log likelihood ratios of two simple hypotheses have a variance of twice their mean; so has the white one, over
    `apart`, under a colour that white noise does not know."""
    rng = np.random.default_rng(4132)
    n, phi = 800, rng.uniform(0.5, 0.9)
    colour = Autocorrelation(np.array([[phi, 0.0, 0.0]]), np.array([np.sqrt(1.0 - phi**2)]))
    folds = (slice(0, n),)
    t = np.linspace(0.0, 1.0, n)
    period = rng.uniform(0.05, 0.4)
    S = np.stack([np.ones(n), t, np.sin(2.0 * np.pi * t / period), t**2, np.zeros(n)], axis=1)[:, None, :]
    fit = Products.of(simulated(colour, 1, folds, n, rng)[0], S, folds).fit(np.arange(2), np.zeros(5), np.zeros(5))
    fit = replace(fit, variance=np.ones(1), normal=S[:, 0, :2].T @ S[:, 0, :2])
    projected = PartialledRegression(state_of(S, folds), fit, [np.array([2]), np.array([3])])
    sizes = [np.array([0.3]), np.array([2.0])]
    apart = projected.apart(np.zeros((n, 1)), sizes, 0, colour, np.zeros(n, int))
    assert apart[0] == 1.0
    d = projected.P[:, 0, :] @ np.array([-sizes[0][0], sizes[1][0]])
    covariance = phi ** np.abs(np.subtract.outer(np.arange(n), np.arange(n)))
    assert apart[1] == pytest.approx(d @ covariance @ d / (d @ d), rel=0.05)  # but for the ends of the record
    ratios = (0.5 * d @ d - simulated(colour, 4000, folds, n, rng)[:, :, 0] @ d) / apart[1]
    assert ratios.var() == pytest.approx(2.0 * ratios.mean(), rel=0.15)


def test_stretches_that_disagree_more_than_the_colour_says_part_rivals_less():
    rng = np.random.default_rng(4132)
    n, stretches = 400, np.repeat(np.arange(20), 20)
    S = np.stack([np.ones(n), *rng.standard_normal((2, n)) + np.repeat(rng.standard_normal((2, 20)), 20, axis=1)])
    S = np.append(S, np.zeros((1, n)), axis=0).T[:, None, :]
    residual = np.repeat(rng.standard_normal(20), 20)[:, None]
    folds, white = (slice(0, n),), Autocorrelation(np.zeros((1, 3)), np.ones(1))
    fit = Products.of(residual, S, folds).fit(np.arange(1), np.zeros(4), np.zeros(4))
    projected = PartialledRegression(state_of(S, folds), fit, [np.array([1]), np.array([2])])
    estimates = [np.zeros(1), np.ones(1)]
    alone, together = (projected.apart(residual, estimates, 0, white, s)[1] for s in (0 * stretches, stretches))
    sums = np.add.reduceat(projected.P[:, 0, 1] * residual[:, 0], np.arange(0, n, 20)) / fit.variance[0]
    assert together == pytest.approx(np.sum(sums**2) * 20 / 19 / np.sum(projected.P[:, 0, 1] ** 2 / fit.variance[0]))
    assert together > alone


def test_deviations_are_those_of_fits_without_each_stretch():
    """Against least squares done again without each stretch; one of them alone decides the second parameter."""
    rng, count, length, k = np.random.default_rng(4132), 8, 30, 3
    n, stretch = count * length, np.repeat(np.arange(count), length)
    S = np.zeros((n, 2, k + count))
    S[:, :, :k] = rng.standard_normal((n, 2, k))
    S[stretch != 3, :, 1] *= 0.05
    S[np.arange(n), :, k + stretch] = 1.0
    residual = rng.standard_normal((n, 2)) * [1.0, 3.0] + np.repeat(rng.standard_normal((count, 2)), length, axis=0)
    precision, folds = np.append(np.full(k, 4.0), np.zeros(count)), (slice(0, n),)
    variance = np.array([1.0, 9.0])
    fit = Products.of(residual, S, folds).fit(np.arange(k + count), np.zeros(k + count), precision, variance)
    responses = SimpleNamespace(parts=stretch, flights=SimpleNamespace(lengths=[length] * count))
    given = {"residual": residual, "precision": precision, "nuisance": count, "theta": np.zeros(k)}
    state = state_of(S, folds, responses=responses, **given)
    columns, covariance = block_jackknife_covariance(state, replace(fit, variance=variance))
    assert list(columns) == [0, 1, 2]
    prior = np.hstack([np.diag(np.sqrt(precision[:k])), np.zeros((k, count))])

    def estimate(kept):
        A, b = (S / np.sqrt(variance)[:, None])[kept], (residual / np.sqrt(variance))[kept]
        return lstsq(np.vstack([A.reshape(-1, k + count), prior]), np.append(b, np.zeros(k)))[0][:k]

    every = estimate(np.ones(n, bool))
    moves = np.array([estimate(stretch != number) - every for number in range(count)])
    expected = moves.T @ moves * (count - 1) / count
    np.testing.assert_allclose(covariance, expected, rtol=1e-6, atol=1e-6 * np.diag(expected).min())


# When a function of a channel takes the place of a named cause


@pytest.mark.parametrize(("proxy", "replaced"), [(1.0, False), (0.6, True), (0.3, True)])
def test_a_curve_replaces_a_proxy_and_not_the_line_that_is_true(proxy, replaced):
    """CD is a line in the elevator beside as much noise, half of which a curve explains alone. Beside a cause that
    follows the elevator by a correlation r, it explains (1 - r^2) / (2 - r^2) of what that leaves: of the true, none.
    """
    assert left_beside(0.5, (1.0 - proxy**2) / (2.0 - proxy**2), DEFAULT) is replaced
