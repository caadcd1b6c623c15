"""The search for the mode that holds most: closed-form mixtures, and stalls of which the truth is known."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
import pytest
from jax.scipy.special import logsumexp
from jax.scipy.stats import norm

from bayes_aero.flight.card.card import read_card
from bayes_aero.inference.likelihood.mle import fit_mle
from bayes_aero.inference.posterior.laplace import density_start, find_mode, other_modes, search_modes
from bayes_aero.model.density import Density
from bayes_aero.model.log_density import LogDensity
from bayes_aero.model.model import Model
from bayes_aero.model.noise import Colour, Noise
from bayes_aero.model.observations import observe
from bayes_aero.parameter import Parameter, Prior
from bayes_aero.simulate.demo import simulate_stall

PRIOR = Prior("normal", 0.0, 2.0)


class Mixture(LogDensity):
    """A posterior that is two normals: `left` of the probability at -1.5, the rest at 2, which is twice as wide."""

    left: float

    @property
    def parameters(self):
        return (Parameter("a", "1", 0.0, 0.1, "-", PRIOR),)

    @property
    def noise_label(self):
        return "white"

    def log_likelihood(self, x):
        parts = jnp.stack([norm.logpdf(x[0], -1.5, 0.2), norm.logpdf(x[0], 2.0, 0.4)])
        return logsumexp(parts + jnp.log(jnp.array([self.left, 1.0 - self.left]))) - PRIOR.log_density(x[0])


@pytest.mark.parametrize(("left", "at"), [(0.7, -1.5), (0.2, 2.0)])
def test_the_mode_with_most_of_the_probability_is_taken_and_the_rest_is_told(left, at):
    mode = search_modes(Mixture(left), np.array([2.0 if left > 0.5 else -1.5]), 10, draws=30)
    assert mode.u[0] == pytest.approx(at, abs=0.01)
    assert mode.other_share == pytest.approx(min(left, 1.0 - left), abs=0.01)
    (said,) = other_modes(mode, "emcee")
    assert f"{mode.other_share:.0%}" in said


def test_one_mode_is_one_however_often_it_is_found():
    alone = search_modes(Mixture(1.0 - 1e-9), np.array([-1.4]), 10, draws=30)
    assert alone.other_share < 1e-6
    assert other_modes(alone, "emcee") == ()
    assert alone.u[0] == find_mode(Mixture(1.0 - 1e-9), np.array([-1.4])).u[0]  # that of the start, to the last digit


@pytest.mark.verify
def test_no_better_mode_lies_at_the_truth():
    """Of stalls drawn from the prior, whose maximum likelihood under white noise may lie elsewhere altogether."""
    card = read_card("attas")
    model = Model.from_card(card)
    signals = observe([simulate_stall(0, card=card)], card, model).thinned(16)
    rng = np.random.default_rng(4132)
    for seed in rng.integers(10**6, size=4):
        draw = np.random.default_rng(seed)
        maker = Density(signals, model, Noise(Colour.AR1))
        x = maker.sample_prior(draw, 1)[0]
        data = signals.with_measured(maker.replicate(jnp.asarray(x), jnp.asarray(draw.standard_normal((signals.n, 3)))))
        density = Density(data, model, Noise(Colour.AR1))
        found = search_modes(density, density_start(density, fit_mle(model, data)), data.n)
        there = find_mode(density, x)
        assert found.log_mass > there.log_mass - 2.0, f"seed {seed}"
