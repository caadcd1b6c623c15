"""Stretches of a flight, and what the coefficients deny."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from bayes_aero.diagnosis.consistency.sensor_errors import check_sensors, screen_sensor_errors
from bayes_aero.diagnosis.diagnose import diagnose
from bayes_aero.diagnosis.result import Verdict
from bayes_aero.diagnosis.screening.accuracy import Size
from bayes_aero.diagnosis.screening.selection_state import moved
from bayes_aero.diagnosis.search import stages as module
from bayes_aero.diagnosis.selection.block_jackknife import Blocks
from bayes_aero.diagnosis.settings import DEFAULT
from bayes_aero.simulate.injection import draw_hidden, hidden_records

SENSORS = ("alpha_bias", "accel_z_bias", "airspeed_scale", "pitch_rate_bias", "altitude_scale")


@pytest.fixture(scope="module")
def silent():
    return hidden_records({}, seed=413_232, noise="white", seconds=90.0)


def test_stretches_measure_an_error_with_its_uncertainty(card):
    rng = np.random.default_rng(4132)
    seed, name = int(rng.integers(1_000_000)), str(rng.choice(SENSORS))
    truth = draw_hidden(rng, name)
    records = hidden_records({name: truth}, seed=seed, noise="ar1", seconds=90.0)
    found = screen_sensor_errors(records, card, seed=seed)
    assert name in found.causes, (seed, name, truth, found.causes)
    judged = Blocks(found.state, found.fit)
    assert judged.freedom == 2 * round(90.0 / DEFAULT.block) - 1
    step, covariance = judged.judge(name)
    estimate = found.state.theta[found.state.full.columns(list(truth))] + step
    for (parameter, true), x, sd in zip(truth.items(), estimate, np.sqrt(np.diag(covariance)), strict=True):
        assert abs(x - true) < 5.0 * sd + 0.02 * abs(true), (seed, name, truth)
        assert found.sizes[parameter].sd >= 0.999 * sd
    assert judged.p_value(name) < 1e-3


def test_what_is_not_there_is_not_borne_out(silent, card):
    """A wrong correction moves every stretch by what it is, and the stretches say by how much to take it back."""
    found = screen_sensor_errors(silent, card)
    state, name = found.state, "accel_z_bias"
    theta, wrong = state.theta.copy(), 0.2
    theta[state.full.columns(["accel_z_bias"])] += wrong
    state = moved(state, theta, tuple(dict.fromkeys((*state.active, name))))  # chance may have it in, too small to tell
    (step,), ((variance,),) = Blocks(state, state.fit()).judge(name)
    left = wrong + state.fit().step[list(state.fit().columns).index(state.full.columns(["accel_z_bias"])[0])]
    assert abs(left) < 0.1 * wrong
    assert abs(step) < 5.0 * np.sqrt(variance) + 0.1 * wrong


def test_disagreement_is_the_scatter_of_the_stretches_own_estimates(silent, card):
    """For an effect with equal information in every stretch: the standard error of the mean of estimates."""
    found = screen_sensor_errors(silent, card)
    judged = Blocks(found.base, found.base_fit)
    name = "pitch_rate_bias"
    step, covariance = judged.judge(name)
    column = found.base.full.columns([name])
    S = judged._centred(found.base.scaled[:, :, column])[:, :, 0] * np.sqrt(judged.weight)
    y = judged.left * np.sqrt(judged.weight)
    own = judged.number[judged.number >= 0]
    parts = [(np.sum(S[own == k] ** 2), np.sum(S[own == k] * y[own == k])) for k in range(judged.freedom + 1)]
    information, right = np.array(parts).T
    mean = right.sum() / information.sum()
    weights = information / information.sum()
    n = len(parts)
    error = np.sqrt(n / (n - 1) * np.sum((weights * (right / information - mean)) ** 2))
    assert step[0] == pytest.approx(mean, rel=1e-9)
    assert np.sqrt(covariance[0, 0]) == pytest.approx(error, rel=1e-9)
    assert stats.variation(information) < 0.5  # near the plain standard error of a mean then
    assert error == pytest.approx(stats.sem(right / information), rel=0.6)


def test_the_coefficients_deny_a_correction_that_harms_them(silent, card, monkeypatch):
    """An airspeed that is right is corrected by 2 m/s: lift over dynamic pressure tells."""

    def wrong(full, responses, theta, **options):
        found = check_sensors(full, responses, theta, **options)
        state, name = found.state, "airspeed_bias"
        theta = state.theta.copy()
        theta[state.full.columns(["airspeed_bias"])] = 2.0
        state = moved(state, theta, tuple(dict.fromkeys((*state.active, name))))
        sizes = {**found.sizes, name: Size(2.0, 0.1, "m/s")}
        return replace(found, state=state, fit=state.fit(), sizes=sizes, causes=(name,))

    monkeypatch.setattr(module, "check_sensors", wrong)
    found = diagnose(silent, card, gains_wanted=False)
    assert found.verdict is Verdict.NO_EFFECT, [c.name for c in found.causes]
    assert any("airspeed_bias" in note for note in found.notes)
