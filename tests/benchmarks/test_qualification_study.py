"""Stated probabilities of single aircraft of the study, and that its truth is what it says."""

from __future__ import annotations

import numpy as np
from qualification import CUBIC, DT, NOISE, OUTPUTS, TRUTH, N, aircraft, flight

SEEDS = (0, 1)


def test_the_true_aircraft_obeys_its_equations():
    """Accelerations from noisy rates: with the cubic moment the residual of q-dot is noise and turbulence."""
    rng = np.random.default_rng(0)
    de = 0.04 * np.sin(2.0 * np.pi * DT * np.arange(N) / 3.0)
    record = flight(TRUTH, de, rng, "one")
    alpha, q = record["alpha"], record["q"]
    q_dot = np.gradient(q, DT)
    full = TRUTH["Malpha"] * alpha + CUBIC * alpha**3 + TRUTH["Mq"] * q + TRUTH["Mde"] * de
    noise = NOISE["q"] / DT / np.sqrt(2.0)
    assert np.std(q_dot - full) < 2.0 * noise
    assert np.std(q_dot - full + CUBIC * alpha**3) > np.std(q_dot - full)
    assert np.allclose(record["az"].mean(), 90.0 * np.mean(TRUTH["Zalpha"] * alpha + TRUTH["Zde"] * de), atol=0.05)


def test_stated_probabilities_order_what_happens():
    """Of the tests of two aircraft those that are stated to pass do, and those that are stated to fail do not."""
    rows = [row for seed in SEEDS for row in aircraft(seed, 3)]
    assert len(rows) == len(SEEDS) * 3 * 3 * len(OUTPUTS)
    stated, passed = (np.array([row[i] for row in rows]) for i in (1, 2))
    assert passed[stated > 0.99].mean() > 0.9
    assert passed[stated < 0.01].mean() < 0.1
    assert np.corrcoef(stated, passed)[0, 1] > 0.8
