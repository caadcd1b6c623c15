"""The approximation through inducing points against the exact process, where both can be had."""

from __future__ import annotations

import numpy as np
import pytest

from bayes_aero.errors import InputError
from bayes_aero.inference.gp import fit as fitting
from bayes_aero.inference.gp import fit_gp
from bayes_aero.inference.gp.predict import gaussian_parts
from bayes_aero.inference.gp.reduced import ReducedData
from bayes_aero.inference.gp.sparse import SparseData, choose_inducing, sparse_parts

THETA = np.log([0.5, 0.3, 0.2, 1.0, 0.8, 1.5, 0.1])  # s0, slopes, sf, lengths, noise: two inputs


def surface(n, seed=0):
    rng = np.random.default_rng(seed)
    x = rng.normal(size=(n, 2))
    return x, np.sin(2.0 * x[:, 0]) + 0.3 * x[:, 1] + 0.5 + 0.1 * rng.normal(size=n)


def test_every_sample_an_inducing_point_is_the_exact_process():
    x, y = surface(60)
    data, new = ReducedData.of(x, y), np.random.default_rng(1).normal(size=(25, 2)) * 1.5
    mean, variance = sparse_parts(THETA, SparseData(data.x, data.fy, data.x), new)
    exact_mean, exact_variance = gaussian_parts(THETA, data, new)
    assert mean == pytest.approx(exact_mean, abs=1e-3)
    assert variance == pytest.approx(exact_variance, abs=1e-3)


def test_greedy_points_leave_little_and_random_ones_leave_more():
    x, y = surface(800)
    data, new = ReducedData.of(x, y), np.random.default_rng(1).normal(size=(200, 2))
    exact, _ = gaussian_parts(THETA, data, new)
    chosen = choose_inducing(THETA, data.x, 0, most=60)
    errors = [
        float(np.sqrt(np.mean((sparse_parts(THETA, SparseData(data.x, data.fy, z), new)[0] - exact) ** 2)))
        for z in (chosen, chosen[:30], data.x[:60])
    ]
    assert errors[0] < 0.005  # a twentieth of the noise
    assert errors[0] < 0.5 * errors[1]
    assert errors[0] < 0.5 * errors[2]


def test_far_from_the_data_it_does_not_know():
    x, y = surface(300)
    sparse = SparseData(x, ReducedData.of(x, y).fy, choose_inducing(THETA, x, 0, most=50))
    _, variance = sparse_parts(THETA, sparse, np.array([[0.0, 0.0], [30.0, 30.0]]))
    assert variance[0] < 0.02
    assert variance[1] > 1.0  # the signal's, and what the slopes leave open


def test_too_many_samples_are_refused_with_the_offer_and_taken_on_asking(monkeypatch):
    x, y = surface(500)
    held, measured = surface(400, seed=9)
    monkeypatch.setattr(fitting, "MAX_SAMPLES", 300)
    monkeypatch.setattr(fitting, "SUBSET", 150)
    with pytest.raises(InputError, match=r"n = 500 .*bound of 300.*approximate"):
        fit_gp(x, y, sample=False)
    fit = fit_gp(x, y, sample=False, starts=2, approximate=True)
    told = fit.approximation
    assert told is not None
    assert (told.n, told.subset) == (500, 150)
    assert told.against_exact[0] < 0.05
    assert told.against_exact[1] < 0.05
    assert "500 samples" in told.sentence
    prediction = fit.predict(held)
    smooth = np.sin(2.0 * held[:, 0]) + 0.3 * held[:, 1] + 0.5
    assert np.sqrt(np.mean((prediction.mean - smooth) ** 2)) < 0.4 * 0.1  # of the noise
    assert prediction.coverage(measured)[0.95] == pytest.approx(0.95, abs=0.04)
    small = fit_gp(x[:60], y[:60], sample=False, starts=2, approximate=True)
    assert small.approximation is None  # the exact one, where it can be had


def test_the_measured_error_shows_what_too_few_points_cost(monkeypatch):
    x, y = surface(500)
    monkeypatch.setattr(fitting, "MAX_SAMPLES", 300)
    monkeypatch.setattr(fitting, "SUBSET", 150)
    monkeypatch.setattr(fitting, "choose_inducing", lambda theta, x, seed: choose_inducing(theta, x, seed, most=6))
    told = fit_gp(x, y, sample=False, starts=2, approximate=True).approximation
    assert told is not None
    assert told.against_exact[0] > 0.2  # above, with enough of them, it is below 0.05
    assert told.halved[0] > 0.2
