"""Noise of trajectories that grows as the flow separates: its size is found, and what it does to estimates."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from linear_cards import SHORT_PERIOD, SHORT_PERIOD_TRUTH, card_of, record_of, short_period_flight

from bayes_aero.dynamics.linear import linear_dynamics
from bayes_aero.dynamics.segments import segments
from bayes_aero.inference.likelihood.output_error import fit_output_error
from bayes_aero.inference.variance.noise_growth import MAX_GROWTH, SeparatedFlow
from bayes_aero.model.joined_channels import join

NOISE = {"alpha": 0.002, "q": 0.003}
GROWTH = 9.0
N = 500
APART = np.where((np.arange(N) > 300) & (np.arange(N) < 400), 1.0, 0.0)  # a stall of four seconds


def flown_of(seed, growth=GROWTH):
    card, rng = card_of(SHORT_PERIOD), np.random.default_rng(seed)
    channels = short_period_flight(SHORT_PERIOD_TRUTH, n=N)
    for name, level in NOISE.items():
        channels[name] = channels[name] + level * (1.0 + growth * APART) * rng.standard_normal(N)
    dynamics = linear_dynamics(card)
    flown = segments(join([record_of(channels)], card, dynamics.inputs), dynamics, outputs=("alpha", "q"))
    return flown, np.array([SHORT_PERIOD_TRUTH[name] for name in flown.dynamics.names])


def swelling(fit):
    return SeparatedFlow(fit.columns[..., 0], np.broadcast_to(APART, fit.flown.inside.shape), fit.flown.inside)


@pytest.mark.parametrize("growth", [GROWTH, 0.0])
def test_the_growth_of_noise_is_found(growth):
    """Of a hundred samples of separated flow a deviation is known to 7 %."""
    flown, truth = flown_of(4132, growth)
    fit = fit_output_error(flown, start=truth, held={"az0": 0.0})
    found = swelling(fit).growths()
    assert found == pytest.approx(growth, abs=4.0 * 0.08 * (1.0 + growth))
    noise_growth = swelling(fit).noise_growth()
    assert noise_growth.shape == (1, N, 2)
    np.testing.assert_allclose(noise_growth[0, APART == 0.0], 1.0)


def test_nothing_missed_does_not_grow_and_growth_has_an_end():
    inside = np.ones((1, N), bool)
    assert not SeparatedFlow(np.zeros((1, N, 1)), APART[None], inside).growths().any()
    only = (APART[None, :, None] + 1e-9) * np.ones((1, N, 1))
    assert SeparatedFlow(only, APART[None], inside).growths() == pytest.approx(MAX_GROWTH, rel=1e-3)


def test_a_segment_that_is_left_out_has_no_say():
    residual = np.random.default_rng(1).standard_normal((2, N, 1))
    residual[1] *= 1.0 + GROWTH * APART[:, None]
    parts = SeparatedFlow(residual, np.stack([APART, APART]), np.ones((2, N), bool))
    assert parts.growths(without=1) < 1.0
    assert parts.growths(without=0) > 5.0


def test_weighed_estimates_are_nearer_the_truth():
    """Weighted least squares beats plain least squares; R is that of attached flow, rms that of all as recorded."""
    plain, weighed, sd = [], [], []
    for seed in range(20):
        flown, truth = flown_of([4, seed])
        noise_growth = 1.0 + GROWTH * np.broadcast_to(APART[None, :, None], (1, N, 2))
        for found, one in ((plain, flown), (weighed, replace(flown, noise_growth=noise_growth))):
            fit = fit_output_error(one, start=truth, held={"az0": 0.0})
            own = fit.sd > 0.0
            found.append((fit.estimate - truth)[own])
        sd.append(fit.sd[own])
    np.testing.assert_allclose(fit.R, [x**2 for x in NOISE.values()], rtol=0.3)
    residual = fit.columns[0, :, :, 0] * noise_growth[0]
    np.testing.assert_allclose(fit.rms[0], np.sqrt(np.mean(residual**2, axis=0)))
    ratio = np.mean(np.square(weighed), axis=0) / np.mean(np.square(plain), axis=0)
    assert np.median(ratio) < 0.7
    z = np.array(weighed) / np.array(sd)
    assert 0.8 < np.sqrt(np.mean(z**2)) < 1.25


def test_a_steady_swell_changes_nothing_but_the_scale_of_R():
    flown, truth = flown_of(3, 0.0)
    twice = replace(flown, noise_growth=np.full((1, N, 2), 2.0))
    plain, scaled = (fit_output_error(f, start=truth, held={"az0": 0.0}) for f in (flown, twice))
    np.testing.assert_allclose(scaled.estimate, plain.estimate, rtol=1e-6)
    np.testing.assert_allclose(scaled.sd, plain.sd, rtol=1e-6)
    np.testing.assert_allclose(4.0 * scaled.R, plain.R, rtol=1e-8)
    assert scaled.cost == pytest.approx(plain.cost, rel=1e-9)
