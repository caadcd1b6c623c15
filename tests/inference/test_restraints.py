"""Priors and bounds against the data, and parameters that a record cannot separate."""

import jax.numpy as jnp
import numpy as np
import pandas as pd
import pytest

from bayes_aero.inference.calibration import Dependence, prior_sensitivity
from bayes_aero.inference.ensemble import Drawn, assemble
from bayes_aero.inference.results import active_bounds, inseparable, prior_conflicts
from bayes_aero.model.noise import LogDensity
from bayes_aero.parameter import Parameter, Prior
from bayes_aero.report.text.restraints import (
    bound_sentences,
    conflict_sentences,
    inseparable_sentences,
    leaning_sentences,
)


# Priors against the data, and bounds that push, against linear fits that can be done by hand
def parameter(name, prior=None, bounds=(-np.inf, np.inf)):
    return Parameter(name, "1/rad", 0.0, 2.9, name, prior or Prior("normal", 0.0, 100.0), bounds)


def test_a_prior_that_the_record_contradicts_is_named_and_how_far_the_posterior_leans():
    prior = Prior("normal", 2.5, 0.02, "wind tunnel")
    (found,) = prior_conflicts([parameter("CLa", prior), parameter("Cmq")], np.array([3.55, -8.0]), np.array([0.03, 1]))
    assert found.distance == pytest.approx(1.05 / np.hypot(0.02, 0.03))
    (said,) = conflict_sentences([found])
    assert "CLa" in said
    assert "wind tunnel" in said
    assert "29.1 combined standard errors away" in said
    conflicts = prior_conflicts([parameter("CLa", prior)], np.array([3.55]), np.array([0.03]))
    rows = {"prior": {"CLa": 0.8, "e": 0.2, "CD0": 0.01}, "likelihood": {"CLa": 0.7, "e": 0.3, "CD0": 0.2}}
    (said,) = leaning_sentences(pd.DataFrame(rows), conflicts)
    assert "CLa 0.80 to the prior" in said
    assert "also move e" in said
    assert leaning_sentences(pd.DataFrame(rows), ()) == ()


@pytest.mark.parametrize(("prior", "estimate", "error"), [
    (Prior("normal", 2.5, 0.02), 2.49, 0.03), (Prior("normal", 2.5, 0.02), 2.55, 0.03),
    (Prior("lognormal", 20.0, 0.7), 80.0, 0.5),  # four times the median is two deviations of the logarithm, not 4.3
])  # fmt: skip
def test_a_prior_that_agrees_is_not(prior, estimate, error):
    assert prior_conflicts([parameter("CLa", prior)], np.array([estimate]), np.array([error])) == ()


def test_lifting_the_bound_of_a_linear_fit_gives_the_free_fit():
    rng = np.random.default_rng(3)
    X = rng.standard_normal((200, 2)) @ np.array([[1.0, 0.8], [0.0, 0.6]])
    y = X @ [3.6, 7.0] + 0.1 * rng.standard_normal(200)
    A = X.T @ X / 0.01
    free = np.linalg.solve(X.T @ X, X.T @ y)
    held = np.array([3.2, X[:, 1] @ (y - 3.2 * X[:, 0]) / (X[:, 1] @ X[:, 1])])
    gradient = X.T @ (y - X @ held) / 0.01
    sd = np.sqrt(np.diag(np.linalg.inv(A)))
    (found,) = active_bounds(
        [parameter("CLa", bounds=(2.5, 3.2)), parameter("CLaM")], held, gradient, np.linalg.inv(A), sd, [True, False]
    )
    assert (found.name, found.bound, found.lower) == ("CLa", 3.2, False)
    assert found.unbounded == pytest.approx(free[0], rel=1e-9)
    assert found.shifts["CLaM"] == pytest.approx((free[1] - held[1]) / sd[1], rel=1e-9)
    (said,) = bound_sentences([found])
    assert "upper bound, 3.2" in said
    assert "CLaM" in said


# Sensitivity to priors where the answer is known: a normal mean with a vague, an informative and a deciding prior
class Mean(LogDensity):
    """Twenty-five measurements of unit deviation about 1; the prior's mean is 0."""

    width: float

    @property
    def parameters(self):
        return (Parameter("m", "1", 0.0, 0.0, "a mean", Prior("normal", 0.0, self.width)),)

    @property
    def noise_label(self):
        return "white"

    def log_likelihood(self, x):
        return -0.5 * 25.0 * jnp.square(x[0] - 1.0)


@pytest.mark.parametrize(
    ("width", "says"), [(100.0, Dependence.DATA), (0.2, Dependence.BOTH), (0.005, Dependence.PRIOR)]
)
def test_a_prior_is_told_by_its_width(width, says):
    """Draws from the closed form: precision 25 + width^-2, mean 25 over it."""
    precision = 25.0 + width**-2.0
    draws = 25.0 / precision + np.random.default_rng(1).standard_normal((4, 1000, 1)) / np.sqrt(precision)
    density = Mean(width)
    posterior = assemble(density, Drawn("closed form", draws), seed=0, seconds=0.0)
    row = prior_sensitivity(density, posterior).loc["m"]
    assert row["says"] == says.value


# Parameters that a record cannot separate: linear regressions whose near dependencies are known beforehand
NAMES, UNITS = ("CL0", "CLa", "Cmq", "Cmde"), ("1", "1/rad", "1/rad", "1/rad")


def asked(X, estimate, noise):
    covariance = noise**2 * np.linalg.inv(X.T @ X)
    return inseparable(NAMES, UNITS, np.array(estimate), covariance, np.sqrt(np.diag(covariance))), covariance


def columns(spread, n=400):
    """A constant, an angle about 5 deg that moves by `spread` rad, and two inputs of their own."""
    rng = np.random.default_rng(2)
    alpha = 0.087 + spread * rng.standard_normal(n)
    return np.column_stack([np.ones(n), alpha, rng.standard_normal((n, 2))])


def test_an_angle_that_hardly_moves_is_not_parted_from_the_constant_in_any_unit():
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
    # The same dependency with one column in other units.
    (one,), _ = asked(X, [0.25, 4.9, -20.0, -1.2], 0.1)
    (other,), _ = asked(X * [1.0, 1e4, 1e-6, 1.0], [0.25, 4.9e-4, -20e6, -1.2], 0.1)
    assert one.names == other.names
    np.testing.assert_allclose(one.wider, other.wider, rtol=1e-5)
    sd = np.array([0.1, 0.0, 0.2, 0.1])
    assert inseparable(NAMES, UNITS, np.ones(4), np.diag(sd**2), sd) == ()
    assert inseparable(NAMES, UNITS, np.ones(4), np.full((4, 4), np.nan), sd) == ()


@pytest.mark.parametrize(("spread", "noise"), [(0.3, 0.1), (0.003, 0.001)])
def test_what_moves_or_is_known_well_enough_is_not_told(spread, noise):
    """A large movement parts them; and where all is known to a per cent, a correlation costs nothing."""
    assert asked(columns(spread), [0.25, 4.9, -20.0, -1.2], noise)[0] == ()


def test_two_dependencies_are_two_and_three_parameters_are_told_together():
    """Lift and moment have each a constant and a speed that hardly moves: four parameters, two pairs."""
    rng = np.random.default_rng(5)
    V = 1.0 + 0.003 * rng.standard_normal(400)
    lift, moment = np.column_stack([np.ones(400), V]), np.zeros((400, 2))
    X = np.concatenate([np.hstack([lift, moment]), np.hstack([moment, lift])])
    found, _ = asked(X, [0.2, 0.3, 0.1, 0.01], 0.02)
    assert {frozenset(one.names) for one in found} == {frozenset(NAMES[:2]), frozenset(NAMES[2:])}
    # The third input is the sum of the first two but for a thousandth.
    rng = np.random.default_rng(7)
    X = rng.standard_normal((400, 4))
    X[:, 2] = X[:, 0] + X[:, 1] + 1e-3 * rng.standard_normal(400)
    (found,), _ = asked(X, [0.2, 0.3, 0.1, 1.0], 0.02)
    assert set(found.names) == set(NAMES[:3])
