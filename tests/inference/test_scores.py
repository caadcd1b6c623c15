"""Scores and splits: probability integral transforms, numbers worked by hand, coverage, what a split holds back."""

import math

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.stats import kstest, norm

from bayes_aero.errors import InputError
from bayes_aero.inference.gp import BLOCK_SECONDS, make_splits
from bayes_aero.inference.results import score
from bayes_aero.inference.sampling import BAND, histogram, neighbours, pit
from bayes_aero.model.model import Model
from bayes_aero.model.observations import Colour, Density, Noise
from bayes_aero.simulate.demo import TRUTH


# The probability integral transform: uniform for data of the model, not for others, and exact where it is known
def measured(clean, colour: Colour, size: float = 1.0) -> tuple[Density, np.ndarray]:
    """The density of two manoeuvres drawn from its own model at known parameters, noise `size` times as large."""
    density = Density(clean, Model.of(("attached_lift", "profile_drag", "pitching_moment")), Noise(colour))
    noise = {"sigma": 0.02, "rho": 0.9, "buffet": 0.0}
    x = np.array([noise.get(n.split("_")[0], TRUTH.get(n, 0.1)) for n in density.names])
    exact = density.predict(jnp.asarray(x))
    white = np.random.default_rng(0).standard_normal((clean.n, 3))
    noisy = exact + size * (density.replicate(jnp.asarray(x), jnp.asarray(white)) - exact)
    return eqx.tree_at(lambda d: d.observations, density, clean.with_measured(noisy)), x


@pytest.mark.parametrize("colour", Colour)
def test_data_of_the_model_are_uniform_and_independent_and_twice_the_noise_is_not(clean, colour):
    """It falls beyond the outer twentieths as often as a normal deviate beyond half the limits: 2 Phi(-0.822)."""
    density, x = measured(clean, colour)
    for column in pit(density, x[None]).T:
        assert kstest(column, "uniform").pvalue > 1e-3
        assert abs(neighbours(column, np.asarray(density.observations.start))) < 4.0 / np.sqrt(len(column))
        assert histogram(column).outside <= 1
    density, x = measured(clean, colour, size=2.0)
    for column in pit(density, x[None]).T:
        assert kstest(column, "uniform").pvalue < 1e-6
        bars = histogram(column)
        assert bars.outside > 2
        outer = (bars.height[0] + bars.height[-1]) / len(bars.height)
        assert outer == pytest.approx(2.0 * norm.cdf(0.5 * norm.ppf(0.05)), abs=0.03)


def test_white_predictions_of_coloured_data_show_their_colour(clean):
    """Uniform each by itself, but tied to its neighbours by the correlation of the noise."""
    density, x = measured(clean, Colour.AR1)
    white = Density(density.observations, density.model, Noise(Colour.WHITE))
    values = pit(white, np.array([[x[density.names.index(n)] for n in white.names]]))
    for column in values.T:
        assert neighbours(column, np.asarray(density.observations.start)) == pytest.approx(0.9, abs=0.05)


def test_uncertain_parameters_widen_the_prediction(clean):
    """A normal mean known to +-s: the predictive is normal with variance sigma^2 + s^2."""
    density, x = measured(clean, Colour.WHITE)
    s, sigma = 0.05, 0.02
    draws = np.tile(x, (200, 1))
    draws[:, density.names.index("CL0")] += s * norm.ppf((np.arange(200) + 0.5) / 200)
    residual = np.asarray(density.observations.measured - density.predict(jnp.asarray(x)))[:, 0]
    assert pit(density, draws)[:, 0] == pytest.approx(norm.cdf(residual / np.hypot(s, sigma)), abs=0.005)


@pytest.mark.parametrize("n", [60, 3000])
def test_the_band_holds_uniform_values_as_often_as_it_says(n):
    rng = np.random.default_rng(n)
    whole = np.mean([histogram(rng.uniform(size=n)).outside == 0 for _ in range(1000)])
    assert whole >= BAND - 0.02  # three deviations of a share of a thousand
    bars = histogram(rng.uniform(size=n))
    assert np.mean(bars.height) == pytest.approx(1.0)
    assert bars.lower <= 1.0 <= bars.upper


# The scores against hand-worked numbers and their own definitions
def test_scores_of_a_hand_worked_case_constant_channels_and_bad_samples():
    s = score(np.array([1.0, 2, 3, 4]), np.array([1.0, 2, 3, 5]))
    assert s.rmse == pytest.approx(0.5)
    assert s.r2 == pytest.approx(0.8)
    assert s.theil == pytest.approx(0.5 / (math.sqrt(7.5) + math.sqrt(9.75)))
    assert s.r == pytest.approx(6.5 / math.sqrt(5 * 8.75))
    z = np.linspace(0.0, 1, 20)
    flat = np.full(20, 0.1)
    assert math.isnan(score(flat, z).r)
    assert math.isnan(score(flat, z).r2)
    assert math.isnan(score(z, flat).r)
    assert math.isfinite(score(z, flat).r2)
    assert score(np.zeros(5), np.zeros(5)).theil == 0.0
    z = np.zeros(6)
    y = z.copy()
    y[4] = np.nan
    with pytest.raises(InputError, match="sample 4"):
        score(z, y)


def test_what_cannot_be_scored_is_refused():
    for z, y in ((np.zeros(4), np.zeros(5)), (np.zeros(1), np.zeros(1))):
        with pytest.raises(InputError, match="one length"):
            score(z, y)


# Every split is a partition, and holds back what its name says
DT = 0.04
INDEX = np.repeat(np.arange(3), (1500, 3099, 2000))


@pytest.mark.parametrize("kind", ["random", "block", "manoeuvre"])
def test_each_split_is_a_partition_in_time_order_and_the_seed_decides(kind):
    first, again, other = (make_splits(kind, INDEX, DT, seed=s) for s in (1, 1, 2))
    for split in first:
        both = np.concatenate([split.train_idx, split.test_idx])
        assert np.array_equal(np.sort(both), np.arange(INDEX.size))
        assert np.all(np.diff(split.train_idx) > 0)
        assert np.all(np.diff(split.test_idx) > 0)
    assert np.array_equal(first[0].train_idx, again[0].train_idx)
    assert np.array_equal(first[0].train_idx, other[0].train_idx) == (kind == "manoeuvre")


def test_splits_have_the_papers_size_ten_groups_or_are_unknown():
    (split,) = make_splits("random", np.zeros(5052, int), DT, seed=0)
    assert split.train_idx.size == 3536
    index = np.repeat(np.arange(25), 4)
    folds = make_splits("manoeuvre", index, 0.04, 0)
    assert len(folds) == 10
    assert np.array_equal(np.sort(np.concatenate([f.test_idx for f in folds])), np.arange(100))
    for fold in folds:
        assert not set(index[fold.test_idx]) & set(index[fold.train_idx])
    with pytest.raises(Exception, match="alternate"):  # InputError, or the type hook before it
        make_splits("alternate", np.zeros(100, int), DT, 0)


def test_blocks_are_contiguous_and_each_manoeuvre_is_held_back_once():
    (split,) = make_splits("block", INDEX, DT, seed=5)
    test = np.isin(np.arange(INDEX.size), split.test_idx)
    for m in range(3):
        part = test[m == INDEX]
        assert 0.25 < part.mean() < 0.35
        assert np.all(np.diff(np.flatnonzero(np.diff(part))) >= round(BLOCK_SECONDS / DT))  # no shorter run
    held = [np.unique(INDEX[s.test_idx]).tolist() for s in make_splits("manoeuvre", INDEX, DT, seed=0)]
    assert held == [[0], [1], [2]]


@pytest.mark.parametrize(("kind", "n", "says"), [
    ("manoeuvre", 100, "at least two records"), ("block", 150, "too few for two blocks"),
    ("random", 3, "at least 10 samples"),
])  # fmt: skip
def test_what_cannot_be_split_is_refused_in_words(kind, n, says):
    with pytest.raises(InputError, match=says):
        make_splits(kind, np.zeros(n, int), DT, 0)
