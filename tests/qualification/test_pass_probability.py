"""Probability of staying inside a tolerance, where a closed form gives it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from linear_cards import record_of
from scipy.stats import norm

from bayes_aero.dynamics.linear import linear_dynamics
from bayes_aero.dynamics.segments import segments
from bayes_aero.flight.card.card import read_card
from bayes_aero.model.joined_channels import join
from bayes_aero.qualification.qualify import Uncertain, qualify
from bayes_aero.qualification.refits import HoldOut
from bayes_aero.qualification.result import Chance, Kind, Qualification, Recorded, Test, Verdict

FREE = {"az0": -9.8, "azde": 1.0}
SD, COUNT, N = 0.5, 1000, 60
ERROR = 4.0 * np.sqrt(0.25 / COUNT)  # four standard errors of a probability, at most


@pytest.fixture(scope="module")
def flown():
    """az is a constant and an elevator that stands still: whatever differs, differs by a constant."""
    still = np.zeros(N)
    channels = {"alpha": still, "q": still, "elevator": still, "az": np.full(N, -9.8)}
    shipped = read_card("short_period")
    held = tuple((n, {"Zalpha": -1.0, "Mq": -1.0}.get(n, 0.0)) for n in shipped.linear.parameters if n not in FREE)
    card = replace(shipped, linear=replace(shipped.linear, fixed=held))
    records = [record_of(channels, dt=0.2, name=name) for name in ("one", "two")]
    flights = join(records, card, card.linear.inputs)
    dynamics = linear_dynamics(card, flights.lengths)
    return segments(flights, dynamics, outputs=("az",))


def unknown(flown, rng, sd=SD, **more):
    names = flown.dynamics.names
    estimate = np.array([FREE[name] for name in names])
    draws = np.tile(estimate, (COUNT, 1))
    draws[:, names.index("az0")] += sd * rng.standard_normal(COUNT)
    return Uncertain(estimate, draws, **more)


def chance(tests, kind=Kind.AGAIN):
    return next(t for t in tests if t.kind is kind)


@pytest.mark.parametrize("band", [0.2, 0.5, 1.0, 2.0])
def test_a_constant_error_of_normal_distribution(flown, band):
    """It stays inside +-b with probability 2 Phi(b / sd) - 1, however long the flight."""
    tests = qualify(flown, None, unknown(flown, np.random.default_rng(1)), {"az": band}).tests
    found = chance(tests)
    exact = 2.0 * norm.cdf(band / SD) - 1.0
    assert found.chance.value == pytest.approx(exact, abs=ERROR)
    assert found.chances["structure"] == found.chances["parameters"]  # the record has no error
    assert found.recorded.passed
    assert found.recorded.largest < 1e-9
    assert found.within == pytest.approx(exact, abs=ERROR)


def test_white_errors_of_the_structure(flown):
    """White errors of standard deviation s: inside all n samples with the n-th power of 2 Phi(b / s) - 1.

    Means over 0.2 s are single samples here, so all that was left out is in the autoregression.
    """
    rng = np.random.default_rng(2)
    errors = 0.3 * rng.standard_normal((2, N, 1))
    size = float(np.sqrt(np.mean(errors**2)))
    given = unknown(flown, rng, sd=0.0, hold_out=HoldOut(errors, np.zeros(1)))
    band = 0.9
    tests = qualify(flown, None, given, {"az": band}).tests
    assert chance(tests).chance.value == 1.0  # flown again: the records have no error
    sizes = size / np.sqrt(rng.chisquare(6, 100_000) / 6)  # two manoeuvres show six sizes
    averaged = float(np.mean((2.0 * norm.cdf(band / sizes) - 1.0) ** N))
    assert chance(tests, Kind.NEXT).chance.value == pytest.approx(averaged, abs=ERROR + 0.03)


def test_the_next_flight_has_its_own_parameters(flown):
    """Scatter between manoeuvres adds to the estimate's: sqrt(sd^2 + tau^2)."""
    rng = np.random.default_rng(3)
    given, wider = unknown(flown, rng), unknown(flown, rng, sd=1.3)
    tests = qualify(flown, None, Uncertain(given.estimate, given.draws, wider.draws), {"az": 1.0}).tests
    assert chance(tests, Kind.NEXT).chance.value == pytest.approx(2.0 * norm.cdf(1.0 / 1.3) - 1.0, abs=ERROR)
    assert chance(tests, Kind.NEXT).recorded is None


def test_scatter_that_flights_left_out_do_not_show_is_not_used(flown):
    """Left out, flights missed by 0.1; parameters that miss by 1.3 are the prior's."""
    rng = np.random.default_rng(5)
    given, wider = unknown(flown, rng, sd=0.0), unknown(flown, rng, sd=1.3)
    for error, used in ((0.1, False), (2.0, True)):
        left_out = HoldOut(error * rng.standard_normal((2, N, 1)), np.zeros(1))
        found = qualify(flown, None, Uncertain(given.estimate, given.draws, wider.draws, left_out), {"az": 1.0})
        assert found.scattered is used
    assert qualify(flown, None, given, {"az": 1.0}).scattered is None


def test_the_same_seed_draws_the_same_flights(flown):
    given = unknown(flown, np.random.default_rng(4), hold_out=HoldOut(np.ones((2, N, 1)), np.zeros(1)))
    few = Uncertain(given.estimate, given.draws[:100], given.draws[:100], given.hold_out)
    one, two, other = (qualify(flown, None, few, {"az": 1.0}, seed=seed).tests for seed in (1, 1, 2))
    assert one == two
    assert one != other


def test_monte_carlo_errors_are_those_of_a_binomial():
    found = Chance.of(300, 400)
    assert found.value == 0.75
    assert found.error == pytest.approx(np.sqrt(0.75 * 0.25 / 400), rel=0.01)
    assert Chance.of(400, 400).error > 0.0


def test_verdicts_need_the_monte_carlo_error_and_the_record():
    def one(passed, within=1.0):
        record = Recorded(1.0, within)
        return Test(Kind.AGAIN, "m", "az", 1.0, {"parameters": Chance.of(passed, 400)}, 1.0, record)

    def verdict(*tests):
        return Qualification(tests, (), (), (), (), {"az": (1.0, "")}, 400).whole

    assert one(380).chance.verdict is Verdict.UNDECIDED  # 0.95, not known to two standard errors
    assert verdict(one(400)) is Verdict.PASSES
    assert verdict(one(400), one(380)) is Verdict.UNDECIDED
    assert verdict(one(400, within=0.99)) is Verdict.UNDECIDED  # the record was outside
    assert verdict(one(400), one(2)) is Verdict.FAILS
    assert one(20).chance.verdict is Verdict.UNDECIDED
