"""Parameters that a record cannot separate: linear regressions whose near dependencies are known beforehand."""

from __future__ import annotations

import numpy as np
import pytest

from bayes_aero.inference.variance.inseparable import inseparable
from bayes_aero.report.text.restraints import inseparable_sentences

NAMES, UNITS = ("CL0", "CLa", "Cmq", "Cmde"), ("1", "1/rad", "1/rad", "1/rad")


def asked(X, estimate, noise):
    covariance = noise**2 * np.linalg.inv(X.T @ X)
    return inseparable(NAMES, UNITS, np.array(estimate), covariance, np.sqrt(np.diag(covariance))), covariance


def columns(spread, n=400):
    """A constant, an angle about 5 deg that moves by `spread` rad, and two inputs of their own."""
    rng = np.random.default_rng(2)
    alpha = 0.087 + spread * rng.standard_normal(n)
    return np.column_stack([np.ones(n), alpha, rng.standard_normal((n, 2))])


def test_an_angle_that_hardly_moves_is_not_parted_from_the_constant():
    X = columns(0.003)
    (found,), covariance = asked(X, [0.25, 4.9, -20.0, -1.2], 0.1)
    assert set(found.names) == {"CL0", "CLa"}
    for name, wider in zip(found.names, found.wider, strict=True):
        i = NAMES.index(name)
        alone = 0.1 / np.sqrt(
            np.sum(X[:, i] ** 2) - np.sum((X[:, 2:].T @ X[:, i]) ** 2 / np.sum(X[:, 2:] ** 2, axis=0))
        )
        assert wider == pytest.approx(np.sqrt(covariance[i, i]) / alone, rel=0.02)
    (said,) = inseparable_sentences([found])
    assert "cannot separate" in said
    assert "CLa 4.9 ± 1.7 1/rad" in said


@pytest.mark.parametrize(("spread", "noise"), [(0.3, 0.1), (0.003, 0.001)])
def test_what_moves_or_is_known_well_enough_is_not_told(spread, noise):
    """A large movement parts them; and where all is known to a per cent, a correlation costs nothing."""
    assert asked(columns(spread), [0.25, 4.9, -20.0, -1.2], noise)[0] == ()


def test_two_dependencies_equally_near_are_two():
    """Lift and moment have each a constant and a speed that hardly moves: four parameters, two pairs."""
    rng = np.random.default_rng(5)
    V = 1.0 + 0.003 * rng.standard_normal(400)
    lift, moment = np.column_stack([np.ones(400), V]), np.zeros((400, 2))
    X = np.concatenate([np.hstack([lift, moment]), np.hstack([moment, lift])])
    found, _ = asked(X, [0.2, 0.3, 0.1, 0.01], 0.02)
    assert {frozenset(one.names) for one in found} == {frozenset(NAMES[:2]), frozenset(NAMES[2:])}


def test_three_that_no_pair_of_which_is_correlated_beyond_the_others_are_told_together():
    """The third input is the sum of the first two but for a thousandth."""
    rng = np.random.default_rng(7)
    X = rng.standard_normal((400, 4))
    X[:, 2] = X[:, 0] + X[:, 1] + 1e-3 * rng.standard_normal(400)
    (found,), _ = asked(X, [0.2, 0.3, 0.1, 1.0], 0.02)
    assert set(found.names) == set(NAMES[:3])


def test_units_do_not_count():
    """The same dependency with one column in other units."""
    X = columns(0.003)
    (one,), _ = asked(X, [0.25, 4.9, -20.0, -1.2], 0.1)
    (other,), _ = asked(X * [1.0, 1e4, 1e-6, 1.0], [0.25, 4.9e-4, -20e6, -1.2], 0.1)
    assert one.names == other.names
    np.testing.assert_allclose(one.wider, other.wider, rtol=1e-5)


def test_what_has_no_variance_or_no_number_is_left_out():
    sd = np.array([0.1, 0.0, 0.2, 0.1])
    assert inseparable(NAMES, UNITS, np.ones(4), np.diag(sd**2), sd) == ()
    assert inseparable(NAMES, UNITS, np.ones(4), np.full((4, 4), np.nan), sd) == ()
