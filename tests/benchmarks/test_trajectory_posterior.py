"""The posterior of a trajectory: where the fit is nearly linear, both samplers must find the normal that it implies."""

from __future__ import annotations

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from linear_cards import SHORT_PERIOD, SHORT_PERIOD_TRUTH, card_of, record_of, short_period_flight
from trajectory_density import trajectory_density

from bayes_aero.dynamics.linear import linear_dynamics
from bayes_aero.dynamics.segments import segments
from bayes_aero.inference.likelihood.output_error import fit_output_error
from bayes_aero.inference.posterior.ensemble import sample_ensemble
from bayes_aero.inference.posterior.laplace import find_mode
from bayes_aero.inference.posterior.nuts import sample_nuts
from bayes_aero.inference.posterior.posterior import PosteriorStatus
from bayes_aero.model.joined_channels import join

NOISE = {"alpha": 0.002, "q": 0.003, "az": 0.15}


@pytest.fixture(scope="module")
def fitted():
    card = card_of(SHORT_PERIOD)
    dynamics = linear_dynamics(card)
    record = record_of(short_period_flight(SHORT_PERIOD_TRUTH), 0.04, NOISE, np.random.default_rng(11))
    start = np.array([SHORT_PERIOD_TRUTH[name] for name in dynamics.names])
    return fit_output_error(segments(join([record], card, dynamics.inputs), dynamics), start=start)


def test_its_gradient_is_that_of_differences(fitted):
    density = trajectory_density(fitted)
    u = np.asarray(density.unconstrain(jnp.asarray(density.start(fitted)))) + 1e-3
    value = jax.jit(type(density).__call__)
    slope = np.asarray(jax.grad(density)(jnp.asarray(u)))
    for k in range(density.size):
        move = np.zeros(density.size)
        move[k] = 1e-6
        difference = (value(density, jnp.asarray(u + move)) - value(density, jnp.asarray(u - move))) / 2e-6
        assert slope[k] == pytest.approx(float(difference), rel=1e-4, abs=1e-3)


@pytest.mark.recovery
@pytest.mark.parametrize("engine", [sample_ensemble, sample_nuts])
def test_samplers_agree_with_the_fit(fitted, engine):
    density = trajectory_density(fitted)
    found = engine(density, find_mode(density, density.start(fitted)), seed=1, predictive=False)
    assert found.status is PosteriorStatus.CONVERGED
    for name, estimate, sd in zip(fitted.names, fitted.estimate, fitted.sd, strict=True):
        marginal = found.marginals[name]
        assert abs(marginal.mean - estimate) < 0.15 * sd, name
        assert marginal.sd == pytest.approx(sd, rel=0.1), name
    for name, true in NOISE.items():
        assert found.marginals[f"sigma_{name}"].mean == pytest.approx(true, rel=0.1)


def test_a_sample_that_counts_less_widens_the_posterior(fitted):
    """A likelihood raised to 1/4 has twice the deviations: curvature at the mode is a quarter."""
    wide = [find_mode(d, d.start(fitted)) for d in (trajectory_density(fitted), trajectory_density(fitted, 4.0))]
    deviations = [np.sqrt(np.sum(mode.factor**2, axis=1))[: len(fitted.names)] for mode in wide]
    np.testing.assert_allclose(deviations[1] / deviations[0], 2.0, rtol=0.05)


def test_a_steady_growth_of_noise_changes_nothing_but_the_scale(fitted):
    """Twice the noise everywhere is half the level."""
    flown = fitted.flown
    twice = replace(flown, noise_growth=np.full_like(np.asarray(flown.noise_growth), 2.0))
    scaled = fit_output_error(twice, start=fitted.estimate)
    values = [
        float(trajectory_density(fit).log_likelihood(jnp.asarray(trajectory_density(fit).start(fit))))
        for fit in (fitted, scaled)
    ]
    assert values[0] == pytest.approx(values[1], rel=1e-9)
