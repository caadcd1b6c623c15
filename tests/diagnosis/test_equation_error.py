"""Sensitivities of everything measured and modelled, on the shorter way where it leads: against differences."""

import numpy as np
import pytest

from bayes_aero.diagnosis.candidate_set import candidate_model
from bayes_aero.effect import Stage
from bayes_aero.model.joined_channels import join
from bayes_aero.residuals.equation_error import EquationError
from bayes_aero.simulate.demo import TRUTH
from bayes_aero.simulate.injection import hidden_records

STEP = 1e-5  # of a parameter's usual deviation


@pytest.fixture(scope="module")
def problem(card, model):
    """EquationError of two flights, its field, and parameters near those flown but off neutral.

    Of the length of other tests' flights, whose compiled programs serve.
    """
    flights = join(hidden_records({}, seed=12, noise="white", seconds=90.0), card)
    full = candidate_model(model, flights)
    rng = np.random.default_rng(12)
    deviation = np.array([p.prior.normal[1] for p in full.model.free])
    middle = np.array([TRUTH.get(name, full.neutral[name]) for name in full.model.names])
    theta = middle + 1e-3 * deviation * rng.uniform(0.5, 1.0, len(middle))
    low, high = np.array([p.bounds for p in full.model.free]).T
    return EquationError.of(flights, full.model), full, np.clip(theta, low, high), deviation


def test_what_moves_the_measured_side_are_the_effects_on_record_and_aircraft(problem):
    responses, full, _, _ = problem
    acting = {p.name for e in full.model.effects if e.stage <= Stage.AIRCRAFT for p in e.parameters}
    assert {full.model.names[i] for i in responses.measuring} == acting & set(full.model.names)


def test_sensitivities_are_those_of_central_differences(problem):
    responses, full, theta, deviation = problem
    residual, S = responses.linearise(theta)
    np.testing.assert_allclose(residual, responses.evaluate(theta)[0], atol=1e-12)
    for i, name in enumerate(full.model.names):
        h = STEP * deviation[i]
        ahead, behind = (
            np.asarray(responses.evaluate(theta + s * h * (np.arange(len(theta)) == i))[0]) for s in (1, -1)
        )
        slope = -(ahead - behind) / (2.0 * h)
        # Rounding of the integrals along the flight path, over the step.
        floor = 1e-11 / h
        assert np.linalg.norm(S[:, :, i] - slope) <= 1e-3 * np.linalg.norm(slope) + floor * np.sqrt(slope.size), name


def test_columns_come_in_the_order_that_was_asked_for(problem):
    responses, _, theta, _ = problem
    whole = responses.linearise(theta)[1]
    columns = np.random.default_rng(4).permutation(len(theta))[:21]
    np.testing.assert_allclose(responses.linearise(theta, columns)[1], whole[:, :, columns], rtol=1e-9, atol=1e-12)
