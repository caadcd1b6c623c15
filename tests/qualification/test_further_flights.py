"""What more records make of a probability to pass: normal errors in closed form, and what no record decides."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import norm

from bayes_aero.diagnosis.design import Information
from bayes_aero.errors import InputError
from bayes_aero.model.joined_channels import join
from bayes_aero.physics.aircraft import FLIGHT, Envelope
from bayes_aero.qualification.flights import OpenTest, _Linear, _precision, _shrunk, further_flights
from bayes_aero.qualification.result import FlightKind
from bayes_aero.report.qualification import further_sentences
from bayes_aero.simulate.demo import TRUTH, simulate_stall

DRAWS, SAMPLES = 20000, 3
MONTE_CARLO = 4.0 * 0.5 / np.sqrt(DRAWS)


def constant_error(rng, sd=1.0):
    """Errors of two parameters, the first of which shifts an output by itself; all else of this deviation."""
    errors = rng.standard_normal((DRAWS, 2))
    by_parameters = np.repeat(errors[:, :1], SAMPLES, axis=1)
    rest = np.repeat(sd * rng.standard_normal((DRAWS, 1)), SAMPLES, axis=1)
    return errors, OpenTest(FlightKind.NEXT, "stall", "theta", 2.0, by_parameters, rest)


@pytest.mark.parametrize("told", [0.0, 1.0, 8.0])
@pytest.mark.parametrize("rest", [0.0, 0.7])
def test_the_probability_with_more_information_is_that_of_a_narrower_normal(told, rest):
    """sd^2 = 1/(1 + told) + rest^2, and P = 2 Phi(2/sd) - 1."""
    errors, test = constant_error(np.random.default_rng(3), rest)
    one, first = _Linear.of(test, errors), np.cov(errors, rowvar=False)
    found = one.probability(errors, _shrunk(errors, first, np.diag([told, 0.0])))
    sd = np.sqrt(1.0 / (1.0 + told) + rest**2)
    assert found == pytest.approx(2.0 * norm.cdf(2.0 / sd) - 1.0, abs=MONTE_CARLO)


def test_information_on_another_parameter_changes_nothing():
    errors, test = constant_error(np.random.default_rng(4))
    one, first = _Linear.of(test, errors), np.cov(errors, rowvar=False)
    assert one.deviation(first) == pytest.approx(1.0, abs=0.02)
    before = one.probability(errors, errors)
    assert one.probability(errors, _shrunk(errors, first, np.diag([0.0, 50.0]))) == pytest.approx(before, abs=0.01)


def test_a_record_s_precision_is_that_of_its_own_estimates():
    """Least squares under coloured noise: the inverse of (X'X)^-1 X'VX (X'X)^-1."""
    rng = np.random.default_rng(5)
    X = rng.standard_normal((60, 2))
    V = 0.9 ** np.abs(np.subtract.outer(np.arange(60), np.arange(60)))
    told = Information(("b", "a"), X.T @ X, X.T @ V @ X, np.zeros(2))
    bread = np.linalg.inv(X.T @ X)
    scale = np.array([2.0, 0.5])
    own = np.linalg.inv(bread @ X.T @ V @ X @ bread)[::-1, ::-1] * np.outer(scale, scale)
    np.testing.assert_allclose(_precision(told, ("a", "b"), scale), own, rtol=1e-9)


@pytest.fixture(scope="module")
def flown(card, model):
    return join([simulate_stall(0, card=card)], card, FLIGHT), {name: TRUTH[name] for name in model.names}


def test_points_make_a_tolerance_that_parameters_leave_open_pass(flown, card, model):
    """The drag at zero lift, known to .02, leaves airspeed open; a record tells it far better."""
    flights, values = flown
    rng = np.random.default_rng(6)
    errors = np.zeros((4000, len(model.names)))
    errors[:, model.names.index("CD0")] = 0.02 * rng.standard_normal(4000)
    by_parameters = np.repeat(80.0 * errors[:, [model.names.index("CD0")]], SAMPLES, axis=1)
    noise = np.repeat(0.2 * rng.standard_normal((4000, 1)), SAMPLES, axis=1)
    tests = [OpenTest(FlightKind.AGAIN, "stall", "airspeed", 1.5, by_parameters, noise)]
    found = further_flights(tests, model.names, errors, flights, model, values, card.envelope)
    (one,) = found.tests
    assert one.present == pytest.approx(2.0 * norm.cdf(1.5 / np.hypot(1.6, 0.2)) - 1.0, abs=0.03)
    assert one.known == 1.0
    assert len(found.points) == 1  # one is enough
    assert found.points[0].expected[0] > 0.95
    assert "V of stall" in further_sentences(found)[1]


def test_what_the_structure_leaves_open_no_record_decides(flown, model):
    flights, values = flown
    errors, test = constant_error(np.random.default_rng(7), 1.5)
    wide = np.zeros((DRAWS, len(model.names)))
    wide[:, :2] = errors
    found = further_flights([test], model.names, wide, flights, model, values, Envelope())
    assert not found.points
    assert not found.tests[0].decidable
    (sentence,) = further_sentences(found)
    assert sentence.startswith("Undecided even if the parameters were known: θ of stall on the next flight.")


def test_without_accelerometers_points_are_refused(flown, model):
    flights, values = flown
    blind = replace(flights, channels={n: x for n, x in flights.channels.items() if n != "az"})
    errors, test = constant_error(np.random.default_rng(8), 0.0)
    wide = np.zeros((DRAWS, len(model.names)))
    wide[:, :2] = errors
    with pytest.raises(InputError, match="az was not recorded"):
        further_flights([test], model.names, wide, blind, model, values, Envelope())
