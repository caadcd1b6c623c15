"""Rivals of Gaussian processes: what trains them, and that the one-step network finds the parameter of a simulation."""

from types import SimpleNamespace

import numpy as np
import pytest
from seed_rivals import INNER, Problem, _runs, one_step, problems

SEED = 11


@pytest.mark.parametrize("kind", list(INNER))
def test_the_inner_holdout_is_a_part_of_the_training_part(kind):
    m = 300
    flights = SimpleNamespace(
        inputs=np.zeros((m, 4)), states=np.zeros((m, 4)), measured=np.zeros((m, 3)),
        manoeuvre=np.repeat([0, 1], [180, 120]), state=SimpleNamespace(responses=SimpleNamespace(seconds=0.2)),
    )  # fmt: skip
    found = problems(flights, kind)
    held_out = sum((~p.train).astype(int) for p in found)
    assert held_out.max() == 1
    for p in found:
        assert not np.any(p.inner & ~p.train)
        assert 0.2 < p.inner.sum() / p.train.sum() < 0.4
        if kind == "manoeuvre":
            assert len(np.unique(p.manoeuvre[p.train])) == 1


def test_stretches_are_the_marked_blocks():
    rows = np.array([1, 1, 0, 1, 0, 0, 1], bool)
    assert _runs(rows) == (slice(0, 2), slice(3, 4), slice(6, 7))


def test_a_one_step_network_finds_the_parameter_that_flew_the_states():
    pytest.importorskip("sklearn", reason="scikit-learn comes with the `bench` extra")
    rng = np.random.default_rng(SEED)
    m, true = 600, 0.7
    control = np.repeat(rng.standard_normal(m // 10), 10)
    x = np.zeros(m)
    for k in range(m - 1):
        x[k + 1] = 0.9 * x[k] + 0.2 * true * control[k]
    measured = (true * control)[:, None]
    train = np.arange(m) < 400
    inner = train & (np.arange(m) >= 300)
    problem = Problem(control[:, None], measured, x[:, None], np.zeros(m, int), train, inner)
    guess = one_step(problem, SEED, lambda theta: theta[0] * control[:, None], np.array([0.2]), ([-5.0], [5.0]))
    np.testing.assert_allclose(guess.mean, measured, atol=0.01 * true * np.abs(control).max())
