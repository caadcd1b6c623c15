"""The probability integral transform: uniform for data of the model, not for others, and exact where it is known."""

from __future__ import annotations

from dataclasses import replace

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.stats import kstest, norm

from bayes_aero.flight.card.card import read_card
from bayes_aero.inference.identification import Histogram
from bayes_aero.inference.posterior.pit import BAND, histogram, neighbours, pit
from bayes_aero.model.density import Density
from bayes_aero.model.model import Model
from bayes_aero.model.noise import Colour, Noise
from bayes_aero.model.observations import Observations
from bayes_aero.simulate.demo import TRUTH

N = 3000


def measured(colour: Colour, size: float = 1.0) -> tuple[Density, np.ndarray]:
    """The density of two manoeuvres drawn from its own model at known parameters, noise `size` times as large."""
    model = Model.of(("attached_lift", "profile_drag", "pitching_moment"))
    t = 0.04 * np.arange(N)
    start = np.arange(N) % (N // 2) == 0
    signals = {"alpha": jnp.asarray(0.1 + 0.05 * np.sin(t)), "dt": jnp.full(N, 0.04), "start": jnp.asarray(start)}
    empty = Observations(
        signals=signals,
        measured=jnp.zeros((N, 3)),
        start=jnp.asarray(start),
        manoeuvre=np.cumsum(start) - 1,
        time=t,
        aircraft=read_card("attas").aircraft,
        names=("a", "b"),
    )
    density = Density(empty, model, Noise(colour))
    noise = {"sigma": 0.02, "rho": 0.9, "buffet": 0.0}
    x = np.array([noise.get(n.split("_")[0], TRUTH.get(n, 0.1)) for n in density.names])
    white = np.random.default_rng(0).standard_normal((N, 3))
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
        assert abs(tied(density, column)) < 4.0 / np.sqrt(N)
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
