"""Hyperparameter priors are densities of the logarithm, and refuse nonsense."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import quad

from bayes_aero.errors import InputError
from bayes_aero.inference.gp.priors import FLAT, HyperPrior, Priors

PROPER = [
    HyperPrior("half-normal", 0.7),
    HyperPrior("log-normal", 0.3, 0.8),
    HyperPrior("inverse-gamma", 3.0, 2.0),
    HyperPrior("frechet", 2.0, 5.0),
]


@pytest.mark.parametrize("prior", PROPER, ids=lambda p: p.family)
def test_density_of_the_logarithm_integrates_to_one(prior):
    mass, _ = quad(lambda t: float(jnp.exp(prior.log_density(jnp.asarray(t)))), -15, 8, limit=200)
    assert mass == pytest.approx(1.0, abs=1e-6)


@pytest.mark.parametrize("prior", PROPER, ids=lambda p: p.family)
def test_draws_follow_the_density(prior):
    t = np.asarray(prior.sample(jax.random.PRNGKey(4), (4000,)))
    mean, _ = quad(lambda s: s * float(jnp.exp(prior.log_density(jnp.asarray(s)))), -15, 8, limit=200)
    assert t.mean() == pytest.approx(mean, abs=5 * t.std() / np.sqrt(t.size))


def test_a_frechet_prior_charges_for_what_is_shorter_than_its_scale():
    prior = HyperPrior("frechet", 6.0, 10.0)
    t = prior.sample(jax.random.PRNGKey(1), (20000,))
    assert float(jnp.mean(jnp.exp(t) < 6.0)) == pytest.approx(np.exp(-1.0), abs=0.02)  # its scale is that quantile
    at_half, at_scale = prior.log_density(jnp.log(jnp.array([3.0, 6.0])))
    assert float(at_scale - at_half) == pytest.approx(2.0**10 - 1.0 - 10.0 * np.log(2.0))


def test_theta_is_laid_out_as_the_priors_are():
    priors, d = Priors(), 3
    theta = jnp.linspace(-1, 1, 2 * d + 3)
    parts = [float(p.log_density(t)) for p, t in zip(priors.per_parameter(d), theta, strict=True)]
    assert float(priors.log_density(theta)) == pytest.approx(sum(parts))
    assert priors.sample(jax.random.PRNGKey(0), d, 7).shape == (7, 2 * d + 3)


def test_nonsense_is_refused():
    with pytest.raises(InputError, match="positive"):
        HyperPrior("half-normal", -1.0)
    with pytest.raises(InputError, match="improper"):
        FLAT.sample(jax.random.PRNGKey(0), (1,))
    assert not Priors(noise=FLAT).proper
