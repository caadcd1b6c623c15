"""Information of records adds up and follows closed forms; test points decide most a second, inside the envelope."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from bayes_aero.diagnosis.candidate_set import CandidateModel
from bayes_aero.diagnosis.design.information import Information, noise_of
from bayes_aero.diagnosis.design.next_test_points import next_test_points
from bayes_aero.diagnosis.design.standard import of_records, on_record
from bayes_aero.diagnosis.screening.selection_state import linearised
from bayes_aero.diagnosis.settings import ENOUGH
from bayes_aero.effects import CATALOGUE
from bayes_aero.flight.envelope import DEFAULT_RANGES, Envelope, excursion
from bayes_aero.model.joined_channels import join
from bayes_aero.physics.atmosphere import GRAVITY
from bayes_aero.physics.coefficients import NAMES
from bayes_aero.residuals.equation_error import EquationError
from bayes_aero.simulate.demo import TRUTH, simulate_stall

CANDIDATES = ("alpha_dot_lift", "pitch_rate_lift", "sideslip_drag", "mach_drag")
RATES, DRAGS = frozenset(CANDIDATES[:2]), frozenset(CANDIDATES[2:])
SETS = {RATES: {"CLq": 3.5, "CLadot": 3.5}, DRAGS: {}}


def state_of(card, model, seeds):
    base = tuple(e for e in model.effects if e.name != "separation_lag")  # fixed at neutral by the card
    candidates = tuple(CATALOGUE[name] for name in CANDIDATES)
    changed = {p.name: p for p in model.parameters}
    parameters = tuple(changed.get(p.name, p) for e in (*base, *candidates) for p in e.parameters)
    whole = replace(model, effects=(*base, *candidates), parameters=parameters, fixed=())
    full = CandidateModel(whole, tuple(e.name for e in base), candidates, {})
    theta = np.array([TRUTH.get(p.name, p.neutral) for p in parameters])
    records = [simulate_stall(seed, card=card) for seed in seeds]
    return linearised(full, EquationError.of(join(records, card), whole), NAMES, theta)


@pytest.fixture(scope="module")
def state(card, model):
    return state_of(card, model, (0, 1))


@pytest.fixture(scope="module")
def chosen(state):
    return next_test_points(state, SETS, Envelope())


def test_two_columns_in_white_noise_differ_by_the_textbook_s_deviations():
    """What is left of a signal after regression on another, over the noise; by numpy's least squares."""
    rng, sigma = np.random.default_rng(4), 0.3
    X = rng.standard_normal((200, 3)) @ np.array([[1.0, 0.6, 0.0], [0.0, 0.8, 0.5], [0.0, 0.0, 1.0]])
    told = Information(("one", "other", "base"), X.T @ X / sigma**2, X.T @ X / sigma**2, np.zeros(3))
    found = told.deviations({"one": {"one": 2.0}, "other": {"other": 0.5}})
    for (a, b), size, (column, rest) in zip(found, (2.0, 0.5), ((0, [1, 2]), (1, [0, 2])), strict=True):
        left = np.linalg.lstsq(X[:, rest], X[:, column], rcond=None)[1][0]
        assert found[a, b] == pytest.approx(size * np.sqrt(left) / sigma, rel=1e-10)
    twice = told + told
    assert twice.deviations({"one": {"one": 2.0}, "other": {"other": 0.5}})["one", "other"] == pytest.approx(
        np.sqrt(2.0) * found["one", "other"], rel=1e-10
    )


def test_information_of_two_records_is_the_sum_of_each_after_its_own_offsets(state):
    """An offset of a flight-path output takes the mean out of each manoeuvre; coefficients have none."""
    noise, effects = noise_of(state), [CATALOGUE[name] for name in CANDIDATES]
    theta = dict(zip(state.full.model.names, map(float, state.theta), strict=True))
    flown = on_record(state, state.full.model, state.responses.flights, theta, effects, noise)
    told, manoeuvre = flown.information(), flown.state.responses.manoeuvre
    at = [flown.state.full.model.names.index(label) for label in told.labels]
    expected = np.zeros_like(told.matrix)
    for part in (0, 1):
        for c, name in enumerate(flown.state.outputs):
            S = flown.state.scaled[manoeuvre == part][:, c, at]
            S = S if name in NAMES else S - S.mean(axis=0)
            expected += S.T @ S / flown.noise.variance[c]
    np.testing.assert_allclose(told.matrix, expected, rtol=1e-8, atol=1e-8 * np.abs(expected).max())
    present = of_records(state, effects, noise).information()  # what the state knows already
    assert present.labels == told.labels
    np.testing.assert_allclose(present.matrix, expected, rtol=1e-8, atol=1e-8 * np.abs(expected).max())
    first = flown.information(float(np.sum(manoeuvre == 0)) * flown.state.responses.seconds)
    assert np.all(np.diag(first.matrix) <= np.diag(told.matrix) * (1.0 + 1e-9))


def test_points_decide_what_the_records_leave_open(chosen):
    assert {frozenset(q.effects) for q in chosen.questions} == {RATES, DRAGS}
    place = [frozenset(q.effects) for q in chosen.questions].index(DRAGS)
    assert chosen.present[place] == 0.0  # no record has sideslip
    assert chosen.points[0].manoeuvre == "sideslip"
    previous = chosen.present
    for point in chosen.points:
        assert all(b >= a - 1e-9 for a, b in zip(previous, point.expected, strict=True))
        previous = point.expected
    assert chosen.expected[place] >= ENOUGH


def test_every_point_stays_inside_the_envelope(state, chosen):
    quiet = {"load_factor": (0.85, 1.25), "altitude_loss": (-np.inf, 200.0)}
    allowed = Envelope(DEFAULT_RANGES | quiet, tuple(quiet))
    found = next_test_points(state, SETS, allowed)
    assert found.points
    assert any(allowed.left_by(p.excursion) for p in chosen.points)  # another choice without it
    for point in found.points:
        assert allowed.left_by(point.excursion) is None
        assert point.excursion["load_factor"][1] <= 1.25


def test_a_computer_s_inputs_are_proposed_only_where_the_card_allows_them(state, chosen):
    assert "computer" in chosen.refused["multisine"]
    found = next_test_points(state, {RATES: SETS[RATES]}, Envelope(programmed_inputs=True))
    assert "multisine" not in found.refused


def test_excursions_of_a_level_turn():
    """n = 1/cos phi."""
    phi = np.full(50, 0.6)
    flight = {"phi": phi, "az": -GRAVITY / np.cos(phi), "altitude": np.linspace(1000.0, 940.0, 50)}
    found = excursion(flight)
    assert found["load_factor"] == pytest.approx((1.0 / np.cos(0.6),) * 2)
    assert found["altitude_loss"] == pytest.approx((0.0, 60.0))
