"""Predictions and their scores: one step ahead, probability integral transforms, and numbers worked by hand."""

import math
from dataclasses import replace

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from linear_cards import (
    FIRST_ORDER,
    SHORT_PERIOD,
    SHORT_PERIOD_TRUTH,
    card_of,
    disturbed_first_order,
    first_order_hold,
    multistep,
    record_of,
)
from scipy.linalg import expm
from scipy.signal import lfilter
from scipy.stats import binom, kstest, norm

from bayes_aero.dynamics.innovations import filter_segments, prediction_errors
from bayes_aero.dynamics.kalman import Filtered
from bayes_aero.dynamics.linear import linear_dynamics
from bayes_aero.dynamics.segments import segments
from bayes_aero.errors import InputError
from bayes_aero.flight.card import read_card
from bayes_aero.inference.calibration import BAND, LEVELS, histogram, neighbours, one_step, pit, probability_transform
from bayes_aero.inference.results import Histogram
from bayes_aero.inference.scores import Calibration, ScoreStatus, interval_coverage, score
from bayes_aero.model.model import Model
from bayes_aero.model.noise import Colour, Density, Noise
from bayes_aero.model.observations import Observations, join
from bayes_aero.simulate.demo import TRUTH

# One-step predictions: their transform in closed form, shares of a simulated truth, and what correlation does
DT, N = 0.04, 1500
F = np.array([0.004, 0.02])  # alpha, q
NOISE = {"alpha": 0.002, "q": 0.003, "az": 0.15}


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


def autoregressive(seed: int, rho: float, n: int) -> np.ndarray:
    """Standard normal, neighbours correlated by `rho`."""
    x = lfilter([np.sqrt(1.0 - rho**2)], [1.0, -rho], white(seed, n + 100))[100:]
    return x[None, :, None]


def disturbed_short_period():
    """A minute of the short period in white process noise, each sample exact: matrix exponentials, no integration."""
    rng, truth = np.random.default_rng(4), SHORT_PERIOD_TRUTH
    u = sum(multistep(N, DT, begin, 0.6, 0.03) for begin in (1.0, 16.0, 31.0, 46.0))
    A = np.array([[truth["Zalpha"], 1.0], [truth["Malpha"], truth["Mq"]]])
    B = np.array([[truth["Zde"], truth["Z0"]], [truth["Mde"], truth["M0"]]])
    both = expm(DT * np.block([[-A, np.diag(F**2)], [np.zeros((2, 2)), A.T]]))  # Van Loan 1978
    added = np.linalg.cholesky(both[2:, 2:].T @ both[:2, 2:])
    x, states = np.zeros(2), []
    for k in range(N):
        states.append(x)
        ends = np.array([[u[k], 1.0], [u[min(k + 1, N - 1)], 1.0]])
        x = first_order_hold(A, B, x, ends, DT)[1] + added @ rng.standard_normal(2)
    alpha, q = np.array(states).T
    az = truth["az0"] + 90.0 * (truth["Zalpha"] * alpha + truth["Zde"] * u)
    return record_of({"alpha": alpha, "q": q, "elevator": u, "az": az}, noise=NOISE, rng=rng)


@pytest.fixture(scope="module")
def flown():
    card = card_of(SHORT_PERIOD)
    return segments(join([disturbed_short_period()], card, ()), linear_dynamics(card))


def predicted(flown, noise: float):
    """By the filter that knows the truth, told `noise` times the variance of the measurement noise."""
    theta = jnp.asarray([SHORT_PERIOD_TRUTH[name] for name in flown.dynamics.names])
    R = noise * np.array([NOISE[name] for name in flown.outputs]) ** 2
    begin = jnp.sqrt(jnp.asarray(R[[flown.outputs.index(n) for n in ("alpha", "q")]]))
    found = filter_segments(flown, theta, begin, jnp.asarray(F), jnp.asarray(R))
    return one_step(found, np.asarray(prediction_errors(flown.nameless, theta, found)), flown.outputs)


def test_the_transform_is_that_of_a_scalar_filter_by_hand():
    """P, S, K of a first-order system in five lines, without an input; from the state in which the filter begins."""
    Zalpha, force, sd, n = -0.8, 0.03, 0.01, 60
    channels = disturbed_first_order(n, 0.05, Zalpha, force, sd)
    channels["elevator"] = np.zeros(n)
    card = card_of(FIRST_ORDER)
    flown = segments(join([record_of(channels, dt=0.05)], card, ()), linear_dynamics(card))
    found = filter_segments(flown, jnp.array([Zalpha]), jnp.array([0.002]), jnp.array([force]), jnp.array([sd**2]))
    x, P, phi, expected, errors = float(found.predicted[0, 0, 0]), 0.002**2, np.exp(Zalpha * 0.05), [], []
    for z in channels["alpha"]:
        S, K = P + sd**2, P / (P + sd**2)
        expected.append(norm.cdf((z - x) / np.sqrt(S)))
        errors.append(z - x)
        x, P = phi * (x + K * (z - x)), phi**2 * (1.0 - K) * P + force**2 * (phi**2 - 1.0) / (2.0 * Zalpha)
    assert probability_transform(found)[0, :, 0] == pytest.approx(np.array(expected), abs=1e-5)
    away = np.asarray(prediction_errors(flown.nameless, jnp.array([Zalpha]), found))
    assert away[0, :, 0] == pytest.approx(np.array(errors), abs=1e-7)
    told = one_step(found, away, flown.outputs)
    assert told.outputs["alpha"].rms == pytest.approx(np.sqrt(np.mean(np.square(errors))), rel=1e-6)


def test_errors_of_an_output_do_not_know_the_other_outputs_of_their_sample(flown):
    """Its innovation does: the first output's are equal, the last one's are smaller than its error."""
    theta = jnp.asarray([SHORT_PERIOD_TRUTH[name] for name in flown.dynamics.names])
    R = jnp.asarray([NOISE[name] ** 2 for name in flown.outputs])
    found = filter_segments(flown, theta, jnp.full(2, 0.002), jnp.asarray(F), R)
    errors, known = np.asarray(prediction_errors(flown.nameless, theta, found))[0], np.asarray(found.innovation)[0]
    assert errors[:, 0] == pytest.approx(known[:, 0], abs=1e-12)
    assert np.std(known[:, -1]) < 0.99 * np.std(errors[:, -1])


def test_filters_are_calibrated_only_with_the_true_noise(flown):
    """Within exact binomial bounds of 99.9 %, for every output, level, and all together."""
    found = predicted(flown, 1.0)
    assert found.status == "calibrated"
    assert found.together.count == 3 * N
    for one in (*found.outputs.values(), found.together):
        assert abs(one.ratio[0] - 1.0) < 3.5 * one.ratio[1]
        for share, level in zip(one.shares, LEVELS, strict=True):
            low, high = binom.interval(0.999, one.count, level)
            assert low <= round(share.share * one.count) <= high
            assert share.sd == pytest.approx(np.sqrt(level * (1.0 - level) / one.count), rel=0.6)
    found = predicted(flown, 0.5)
    assert found.status == "not_calibrated"
    for one in (*found.outputs.values(), found.together):
        assert one.calibration is Calibration.TOO_NARROW
        assert one.ratio[0] > 1.1
        for share in one.shares:
            assert share.share * one.count < binom.interval(0.999, one.count, share.level)[0]
    found = predicted(flown, 4.0)
    assert found.status == "not_calibrated"
    assert {one.calibration for one in found.outputs.values()} <= {Calibration.TOO_WIDE, Calibration.COLOURED}
    assert found.together.calibration is Calibration.TOO_WIDE


def test_heavy_tails_are_not_normal():
    """Student's t with 3 degrees of freedom and unit variance: 0.60 inside 50 %, 0.974 inside 99 %."""
    z = np.random.default_rng(0).standard_t(3.0, (1, 3000, 1)) / np.sqrt(3.0)
    found = judged(z).outputs["y0"]
    assert found.calibration is Calibration.NOT_NORMAL
    score, value, _, high = found.quantiles[-1]
    assert value > high > score


@pytest.mark.verify
@pytest.mark.parametrize("rho", [0.0, 0.2])
def test_calibrated_predictions_are_seldom_said_not_to_be(rho):
    """At most one in twenty: an exact binomial bound on 200 records of three outputs."""
    said = 0
    for seed in range(200):
        z = np.concatenate([autoregressive(3 * seed + c, rho, 1000) for c in range(3)], axis=2)
        said += judged(z).status == "not_calibrated"
    assert said <= binom.ppf(0.999, 200, 0.05)


def test_a_standard_error_counts_samples_that_repeat_others():
    """Each innovation four times: the information, and the standard error, of a quarter of the samples."""
    found = []
    for seed in range(40):
        repeated = judged(np.repeat(white(seed, 1, 400, 1), 4, axis=1)).outputs["y0"]
        assert repeated.calibration is not Calibration.CALIBRATED
        found.append([share.sd for share in repeated.shares])
    expected = [np.sqrt(level * (1.0 - level) / 400) for level in LEVELS]
    assert np.mean(np.square(found), axis=0) == pytest.approx(np.square(expected), rel=0.3)


@pytest.mark.verify
def test_the_standard_error_of_a_share_is_its_scatter():
    """Neighbours correlated by 0.8: standard errors of the shares against their scatter over 300 records."""
    found = [judged(autoregressive(seed, 0.8, 1000)).outputs["y0"].shares for seed in range(300)]
    for k, level in enumerate(LEVELS):
        scatter = np.std([shares[k].share for shares in found])
        assert scatter > 1.1 * np.sqrt(level * (1.0 - level) / 1000)
        assert np.median([shares[k].sd for shares in found]) == pytest.approx(scatter, rel=0.25)


def test_two_sensors_of_one_signal_know_no_more_than_one():
    z = white(1, 1, 800, 1)
    found = judged(np.concatenate([z, z], axis=2))
    for one, both in zip(found.outputs["y0"].shares, found.together.shares, strict=True):
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
    assert np.isnan(probability_transform(innovations(z))[0, 0, 0])
    found = judged(3.0 * white(3, 1, 20, 1))
    assert found.status == "undecided"
    assert found.outputs["y0"].quantiles.shape[1] == 4


@pytest.mark.parametrize("size", [0.0, 1e-3, 50.0])
def test_shares_of_none_and_all_have_numbers(size):
    found = judged(size * white(4, 1, 300, 1)).outputs["y0"]
    assert {s.share for s in found.shares} <= {0.0, 1.0} or size > 1.0
    assert found.calibration is (Calibration.TOO_NARROW if size > 1.0 else Calibration.TOO_WIDE)
    assert np.all(np.isfinite([(s.sd, s.p) for s in found.shares]))


@pytest.mark.verify
def test_quantiles_of_white_innovations_keep_to_their_band():
    """All of them, in at least 95 % of 200 records, but for an exact binomial bound."""
    left = 0
    for seed in range(200):
        _, value, low, high = judged(white(seed, 1, 600, 1)).outputs["y0"].quantiles.T
        left += bool(np.any((value < low) | (value > high)))
    assert left <= binom.ppf(0.999, 200, 0.05)


# The probability integral transform: uniform for data of the model, not for others, and exact where it is known
COUNT = 3000


def measured(colour: Colour, size: float = 1.0) -> tuple[Density, np.ndarray]:
    """The density of two manoeuvres drawn from its own model at known parameters, noise `size` times as large."""
    model = Model.of(("attached_lift", "profile_drag", "pitching_moment"))
    t = 0.04 * np.arange(COUNT)
    start = np.arange(COUNT) % (COUNT // 2) == 0
    signals = {"alpha": jnp.asarray(0.1 + 0.05 * np.sin(t)), "dt": jnp.full(COUNT, 0.04), "start": jnp.asarray(start)}
    empty = Observations(
        signals=signals, measured=jnp.zeros((COUNT, 3)), start=jnp.asarray(start), manoeuvre=np.cumsum(start) - 1,
        time=t, aircraft=read_card("attas").aircraft, names=("a", "b"),
    )  # fmt: skip
    density = Density(empty, model, Noise(colour))
    noise = {"sigma": 0.02, "rho": 0.9, "buffet": 0.0}
    x = np.array([noise.get(n.split("_")[0], TRUTH.get(n, 0.1)) for n in density.names])
    white = np.random.default_rng(0).standard_normal((COUNT, 3))
    clean = density.predict(jnp.asarray(x))
    noisy = clean + size * (density.replicate(jnp.asarray(x), jnp.asarray(white)) - clean)
    return eqx.tree_at(lambda d: d.observations, density, empty.with_measured(noisy)), x


def tied(density: Density, column: np.ndarray) -> float:
    return neighbours(column, np.asarray(density.observations.start))


@pytest.mark.parametrize("colour", Colour)
def test_data_of_the_model_are_uniform_and_independent(colour):
    density, x = measured(colour)
    values = pit(density, x[None])
    for column in values.T:
        assert kstest(column, "uniform").pvalue > 1e-3
        assert abs(tied(density, column)) < 4.0 / np.sqrt(COUNT)
        assert histogram(column).outside <= 1


@pytest.mark.parametrize("colour", Colour)
def test_twice_the_noise_is_not_uniform(colour):
    """It falls beyond the outer twentieths as often as a normal deviate beyond half the limits: 2 Phi(-0.822)."""
    density, x = measured(colour, size=2.0)
    for column in pit(density, x[None]).T:
        assert kstest(column, "uniform").pvalue < 1e-6
        bars = histogram(column)
        assert bars.outside > 2
        outer = (bars.height[0] + bars.height[-1]) / len(bars.height)
        assert outer == pytest.approx(2.0 * norm.cdf(0.5 * norm.ppf(0.05)), abs=0.03)


def test_white_predictions_of_coloured_data_show_their_colour():
    """Uniform each by itself, but tied to its neighbours by the correlation of the noise."""
    density, x = measured(Colour.AR1)
    white = Density(density.observations, density.model, Noise(Colour.WHITE))
    values = pit(white, np.array([[x[density.names.index(n)] for n in white.names]]))
    for column in values.T:
        assert tied(density, column) == pytest.approx(0.9, abs=0.05)


def test_uncertain_parameters_widen_the_prediction():
    """A normal mean known to +-s: the predictive is normal with variance sigma^2 + s^2."""
    density, x = measured(Colour.WHITE)
    s, sigma = 0.05, 0.02
    draws = np.tile(x, (200, 1))
    draws[:, density.names.index("CL0")] += s * norm.ppf((np.arange(200) + 0.5) / 200)
    residual = np.asarray(density.observations.measured - density.predict(jnp.asarray(x)))[:, 0]
    assert pit(density, draws)[:, 0] == pytest.approx(norm.cdf(residual / np.hypot(s, sigma)), abs=0.005)


@pytest.mark.parametrize("n", [60, 300, 3000])
def test_the_band_holds_uniform_values_as_often_as_it_says(n):
    rng = np.random.default_rng(n)
    whole = np.mean([histogram(rng.uniform(size=n)).outside == 0 for _ in range(1000)])
    assert whole >= BAND - 0.02  # three deviations of a share of a thousand
    found = histogram(rng.uniform(size=n))
    assert np.mean(found.height) == pytest.approx(1.0)
    assert found.lower <= 1.0 <= found.upper


def test_bars_outside_are_counted():
    bars = Histogram(np.linspace(0.0, 1.0, 4), np.array([0.5, 1.0, 1.5]), 0.8, 1.2)
    assert bars.outside == 2
    assert replace(bars, lower=0.4).outside == 1


# The scores against hand-worked numbers and their own definitions
def test_scores_of_a_hand_worked_case_constant_channels_and_bad_samples():
    s = score(np.array([1.0, 2, 3, 4]), np.array([1.0, 2, 3, 5]))
    assert s.rmse == pytest.approx(0.5)
    assert s.r2 == pytest.approx(0.8)
    assert s.theil == pytest.approx(0.5 / (math.sqrt(7.5) + math.sqrt(9.75)))
    assert s.r == pytest.approx(6.5 / math.sqrt(5 * 8.75))
    assert s.status is ScoreStatus.ok
    z = np.linspace(0.0, 1, 20)
    flat = np.full(20, 0.1)
    assert score(flat, z).status is ScoreStatus.constant_measurement
    assert score(z, flat).status is ScoreStatus.constant_prediction
    assert math.isnan(score(z, flat).r)
    assert math.isfinite(score(z, flat).r2)
    assert score(np.zeros(5), np.zeros(5)).theil == 0.0
    z = np.zeros(6)
    y = z.copy()
    y[4] = np.nan
    with pytest.raises(InputError, match="sample 4"):
        score(z, y)


@pytest.mark.parametrize("seed", range(3))
def test_scores_do_not_depend_on_the_unit(seed):
    rng = np.random.default_rng(seed)
    z, e = rng.normal(size=(2, 200))
    a, b = score(z, z + 0.3 * e), score(57.3 * z, 57.3 * (z + 0.3 * e))
    assert b.r == pytest.approx(a.r)
    assert b.theil == pytest.approx(a.theil)
    assert b.r2 == pytest.approx(a.r2)
    assert b.rmse == pytest.approx(57.3 * a.rmse)


@pytest.mark.parametrize(("z", "y"), [(np.zeros(4), np.zeros(5)), (np.zeros(1), np.zeros(1))])
def test_shapes_that_do_not_match_are_refused(z, y):
    with pytest.raises(InputError, match="one length"):
        score(z, y)


def test_coverage_of_a_known_distribution_and_what_cannot_be_counted():
    rng = np.random.default_rng(11)
    z, draws = rng.normal(size=20000), rng.normal(size=(2000, 1)) * np.ones(20000)
    for level, share in interval_coverage(z, draws).items():
        assert share == pytest.approx(level, abs=0.03)
    narrow = interval_coverage(z, 0.5 * draws)
    assert narrow[0.95] == pytest.approx(0.673, abs=0.04)  # P(|z| < 0.98)
    with pytest.raises(InputError, match="measurements"):
        interval_coverage(np.zeros(4), np.zeros((10, 5)))
    with pytest.raises(InputError, match="levels"):
        interval_coverage(np.zeros(4), np.zeros((10, 4)), (95.0,))
