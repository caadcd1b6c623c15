"""The scores against hand-worked numbers and their own definitions."""

import math

import numpy as np
import pytest

from bayes_aero.errors import InputError
from bayes_aero.inference.scores import ScoreStatus, interval_coverage, score


def test_scores_of_a_hand_worked_case():
    # z = 1 2 3 4, y = 1 2 3 5: SSE 1, SST 5, rms z = sqrt(7.5), rms y = sqrt(9.75)
    s = score(np.array([1.0, 2, 3, 4]), np.array([1.0, 2, 3, 5]))
    assert s.rmse == pytest.approx(0.5)
    assert s.r2 == pytest.approx(0.8)
    assert s.theil == pytest.approx(0.5 / (math.sqrt(7.5) + math.sqrt(9.75)))
    assert s.r == pytest.approx(6.5 / math.sqrt(5 * 8.75))
    assert s.status is ScoreStatus.ok


@pytest.mark.parametrize("seed", range(3))
def test_scores_do_not_depend_on_the_unit(seed):
    rng = np.random.default_rng(seed)
    z, e = rng.normal(size=(2, 200))
    a, b = score(z, z + 0.3 * e), score(57.3 * z, 57.3 * (z + 0.3 * e))
    assert b.r == pytest.approx(a.r)
    assert b.theil == pytest.approx(a.theil)
    assert b.r2 == pytest.approx(a.r2)
    assert b.rmse == pytest.approx(57.3 * a.rmse)


def test_constant_channels_are_named_not_silent():
    z = np.linspace(0.0, 1, 20)
    flat = np.full(20, 0.1)
    assert score(flat, z).status is ScoreStatus.constant_measurement
    assert score(z, flat).status is ScoreStatus.constant_prediction
    assert math.isnan(score(z, flat).r)
    assert math.isfinite(score(z, flat).r2)
    assert score(np.zeros(5), np.zeros(5)).theil == 0.0


@pytest.mark.parametrize(("z", "y"), [(np.zeros(4), np.zeros(5)), (np.zeros(1), np.zeros(1))])
def test_shapes_that_do_not_match_are_refused(z, y):
    with pytest.raises(InputError, match="one length"):
        score(z, y)


def test_a_bad_sample_is_named():
    z = np.zeros(6)
    y = z.copy()
    y[4] = np.nan
    with pytest.raises(InputError, match="sample 4"):
        score(z, y)


def test_coverage_of_a_known_predictive_distribution():
    rng = np.random.default_rng(11)
    z, draws = rng.normal(size=20000), rng.normal(size=(2000, 1)) * np.ones(20000)
    for level, share in interval_coverage(z, draws).items():
        assert share == pytest.approx(level, abs=0.03)
    narrow = interval_coverage(z, 0.5 * draws)
    assert narrow[0.95] == pytest.approx(0.673, abs=0.04)  # P(|z| < 0.98)


def test_coverage_refuses_what_it_cannot_count():
    with pytest.raises(InputError, match="measurements"):
        interval_coverage(np.zeros(4), np.zeros((10, 5)))
    with pytest.raises(InputError, match="levels"):
        interval_coverage(np.zeros(4), np.zeros((10, 4)), (95.0,))
