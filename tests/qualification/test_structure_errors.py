"""Errors of a model's structure: simulated series of known size and memory, and what is drawn from them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from bayes_aero.qualification.structure import BLOCK_SECONDS, Structure

DT, PHI = BLOCK_SECONDS, 0.9
CERTAIN = 10**9


def from_zero(rng, count, n, phi=PHI):
    """Autoregressions of unit innovations that begin at zero, (count, n, 1)."""
    x, rows = np.zeros(count), []
    for _ in range(n):
        x = phi * x + rng.standard_normal(count)
        rows.append(x)
    return np.stack(rows, axis=1)[:, :, None]


def structure(errors, separated=None, explained=0.0):
    w, n, _ = errors.shape
    separated = np.zeros((w, n)) if separated is None else separated
    return Structure.of(errors, separated, np.ones((w, n), bool), np.full(w, DT), np.full(errors.shape[2], explained))


def test_draws_have_the_size_and_the_memory_of_the_errors():
    """The variance from zero is (1 - phi^2t) / (1 - phi^2); 200 series of 300 samples, 3 % of it by their number."""
    errors = from_zero(np.random.default_rng(1), 200, 300)
    found = replace(structure(errors), sizes=CERTAIN)
    drawn = found.draws(4000, np.zeros(300), DT, np.random.default_rng(2))[:, :, 0]
    steady = 1.0 / (1.0 - PHI**2)
    early = sum(PHI ** (2 * k) for k in range(3))  # after three innovations
    spread = 4.0 * np.sqrt(2.0 / 4000)  # four standard errors of a variance
    assert np.var(drawn[:, 2]) == pytest.approx(early, rel=spread + 0.03)
    assert np.var(drawn[:, 200]) == pytest.approx(steady, rel=spread + 0.03)
    assert np.corrcoef(drawn[:, 200], drawn[:, 205])[0, 1] == pytest.approx(PHI**5, abs=4.0 / np.sqrt(4000) + 0.01)


def test_what_is_explained_is_left_out():
    """Half of the mean square explained: half is left."""
    errors = from_zero(np.random.default_rng(3), 200, 300)
    whole, half = structure(errors), structure(errors, explained=0.5 * float(np.mean(errors**2)))
    assert half.innovation**2 == pytest.approx(0.5 * whole.innovation**2, rel=1e-6)
    assert structure(errors, explained=2.0 * float(np.mean(errors**2))).innovation == 0.0


def test_errors_grow_with_separation_as_they_did():
    """Three times as large in separated flow: a growth of 2."""
    rng = np.random.default_rng(4)
    separated = np.repeat((np.arange(300) > 200).astype(float)[None], 100, axis=0)
    errors = rng.standard_normal((100, 300, 1)) * (1.0 + 2.0 * separated[:, :, None])
    found = structure(errors, separated)
    assert found.growth == pytest.approx(2.0, abs=0.1)
    drawn = replace(found, sizes=CERTAIN).draws(2000, separated[0], DT, rng)[:, :, 0]
    assert np.var(drawn[:, 250]) / np.var(drawn[:, 100]) == pytest.approx(9.0, rel=0.3)


def one(sizes=CERTAIN, left=1.0, innovation=1.0):
    """White errors of standard deviation `innovation`."""
    return Structure(np.zeros((1, 3)), np.array([innovation]), np.zeros(1), np.zeros(1), sizes, np.array([left]))


def test_few_sizes_widen_the_tails():
    """Of nu independent values the size is that of nu over a chi-square: Student's t, of variance nu/(nu-2)."""
    rng = np.random.default_rng(5)
    wide, narrow = (one(sizes).draws(40_000, np.zeros(1), DT, rng)[:, 0, 0] for sizes in (8, CERTAIN))
    assert np.var(narrow) == pytest.approx(1.0, rel=0.03)
    assert np.var(wide) == pytest.approx(8.0 / 6.0, rel=0.06)
    assert structure(np.ones((5, 40, 1))).sizes == 3 * 5


def test_a_part_of_an_error_repeats():
    """Of a constant error b a share w of the square repeats, w uniform: the mean is b E sqrt(w) = 2 b / 3, the mean
    square b^2 / 2, beside half of that of the random errors."""
    own = np.full((40, 1), 5.0)
    drawn = one().draws(40_000, np.zeros(40), DT, np.random.default_rng(6), own)[:, 10, 0]
    assert np.mean(drawn) == pytest.approx(5.0 * 2.0 / 3.0, rel=0.01)
    assert np.mean(drawn**2) == pytest.approx(25.0 / 2.0 + 0.5, rel=0.02)
    none = one(left=0.0, innovation=0.0).draws(10, np.zeros(40), DT, np.random.default_rng(7), own)
    assert not none.any()
