"""Estimates without the bias from recording noise: simulated truth, records without noise, an identity."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest

import bayes_aero as ba
from bayes_aero.inference.likelihood.mle import fit_mle
from bayes_aero.inference.likelihood.mle_result import MleStatus
from bayes_aero.inference.likelihood.noise_bias import without_noise_bias
from bayes_aero.model.density import Density
from bayes_aero.model.noise import Colour, Noise
from bayes_aero.model.observations import observe
from bayes_aero.simulate.demo import simulate_stall

VANE = np.radians(0.3)


def flown(card, seed, sensor_noise):
    return [simulate_stall(i, card=card, seed=seed, sensor_noise=sensor_noise, disturbance=0.0) for i in range(2)]


def test_half_the_bias_of_a_noisy_vane_and_more_is_taken_off(card, model):
    """The mean of estimates with noise added and subtracted, less that without noise, is the bias."""
    exact = flown(card, 11, 0.0)
    truth = fit_mle(model, observe(exact, card, model), extra_starts=0).estimate
    rng, before, after = np.random.default_rng(1), [], []
    for _ in range(3):
        noise = [VANE * rng.standard_normal(record.n) for record in exact]
        for sign in (1.0, -1.0):
            records = [
                replace(record, channels={**record.channels, "alpha": record["alpha"] + sign * one})
                for record, one in zip(exact, noise, strict=True)
            ]
            mle = fit_mle(model, observe(records, card, model), start=truth, extra_starts=0)
            freed = without_noise_bias(mle, records, card, model)
            before.append((mle.estimate - truth) / mle.crb_corrected)
            after.append((freed.estimate - truth) / mle.crb_corrected)
            assert np.all(np.diag(freed.corrected) >= np.diag(mle.corrected))
    biased, rest = np.abs(np.mean(before, axis=0)), np.abs(np.mean(after, axis=0))
    large = biased > 1.0
    assert {"tau2", "Cmq", "Cmde"} <= {name for name, is_large in zip(mle.names, large, strict=True) if is_large}
    assert np.all(rest[large] < 0.5 * biased[large])


def test_without_noise_nothing_moves(card, model):
    records = flown(card, 11, 0.0)
    mle = fit_mle(model, observe(records, card, model), extra_starts=0)
    freed = without_noise_bias(mle, records, card, model)
    assert freed.bias is not None
    assert np.all(np.abs(freed.bias) < 0.05 * mle.crb_corrected)


def test_a_fit_at_a_bound_is_left_as_it_is(card, model):
    records = flown(card, 11, 1.0)
    mle = fit_mle(model, observe(records, card, model), extra_starts=0)
    bounded = replace(mle, status=MleStatus.AT_BOUND)
    assert without_noise_bias(bounded, records, card, model) is bounded


@pytest.mark.parametrize("colour", list(Colour))
def test_the_posterior_is_of_parameters_without_the_bias(clean, model, colour):
    """Its density at x is that of the fitted parameters at x + bias, priors apart."""
    noise, bias = Noise(colour), 0.01 * np.arange(len(model.names))
    plain, freed = Density.of(clean, model, noise), Density.of(clean, model, noise, bias)
    x = jnp.asarray([p.start for p in plain.parameters])
    there = x.at[: len(bias)].add(bias)
    assert float(freed.log_likelihood(x)) == pytest.approx(float(plain.log_likelihood(there)), rel=1e-12)
    np.testing.assert_allclose(freed.predict(x), plain.predict(there))


def test_published_coefficients_give_the_published_estimates(card):
    records = flown(card, 11, 1.0)
    assert ba.fit(records, card, coefficients="published").mle.bias is None
    assert ba.fit(records, card).mle.bias is not None
