"""Priors against the data, and bounds that push, against linear fits that can be done by hand."""

import numpy as np
import pandas as pd
import pytest

from bayes_aero.inference.likelihood.restraints import active_bounds, prior_conflicts
from bayes_aero.parameter import Parameter, Prior
from bayes_aero.report.text.restraints import bound_sentences, conflict_sentences, leaning_sentences


def parameter(name, prior=None, bounds=(-np.inf, np.inf)):
    return Parameter(name, "1/rad", 0.0, 2.9, name, prior or Prior("normal", 0.0, 100.0), bounds)


def test_a_prior_that_the_record_contradicts_is_named_with_its_distance():
    prior = Prior("normal", 2.5, 0.02, "wind tunnel")
    (found,) = prior_conflicts([parameter("CLa", prior), parameter("Cmq")], np.array([3.55, -8.0]), np.array([0.03, 1]))
    assert found.distance == pytest.approx(1.05 / np.hypot(0.02, 0.03))
    (said,) = conflict_sentences([found])
    assert "CLa" in said
    assert "wind tunnel" in said
    assert "29.1 combined standard errors away" in said


@pytest.mark.parametrize("estimate", [2.49, 2.55])
def test_a_prior_that_agrees_is_not(estimate):
    prior = Prior("normal", 2.5, 0.02)
    assert prior_conflicts([parameter("CLa", prior)], np.array([estimate]), np.array([0.03])) == ()


def test_a_lognormal_prior_is_compared_on_its_logarithm():
    prior = Prior("lognormal", 20.0, 0.7)  # four times the median is two deviations, not 4.3
    assert prior_conflicts([parameter("a1", prior)], np.array([80.0]), np.array([0.5])) == ()


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


def test_how_far_a_posterior_leans_on_a_contradicted_prior_is_told():
    prior = Prior("normal", 2.5, 0.02, "wind tunnel")
    conflicts = prior_conflicts([parameter("CLa", prior)], np.array([3.55]), np.array([0.03]))
    rows = {"prior": {"CLa": 0.8, "e": 0.2, "CD0": 0.01}, "likelihood": {"CLa": 0.7, "e": 0.3, "CD0": 0.2}}
    (said,) = leaning_sentences(pd.DataFrame(rows), conflicts)
    assert "CLa 0.80 to the prior" in said
    assert "also move e" in said
    assert leaning_sentences(pd.DataFrame(rows), ()) == ()
