"""Effects injected into records: what the record then shows, and that diagnosis finds them in the real ones."""

import numpy as np
import pytest
from injected_effects import injected

from bayes_aero.diagnosis.diagnose import diagnose
from bayes_aero.errors import InputError
from bayes_aero.flight.reading.read_record import read_record
from bayes_aero.simulate.demo import simulate_stall


@pytest.fixture(scope="module")
def record(card):
    return simulate_stall(0, card=card)


def test_a_faulty_sensor_records_the_error_and_nothing_else(record, card):
    (faulty,) = injected([record], {"pitch_rate_bias": {"pitch_rate_bias": 0.01}}, card, Cmde=-0.7)
    np.testing.assert_allclose(np.asarray(faulty["q"]) - np.asarray(record["q"]), 0.01, atol=1e-9)
    for name in ("alpha", "ax", "az", "elevator", "thrust_left", "airspeed"):
        np.testing.assert_allclose(faulty[name], record[name], rtol=1e-9, atol=1e-9)
    assert faulty.sha256 != record.sha256


def test_thrust_is_shared_between_the_engines_as_it_was(record, card):
    (faulty,) = injected([record], {"thrust_scale": {"thrust_scale": 0.25}}, card, Cmde=-0.7)
    for name in ("thrust_left", "thrust_right"):  # true = recorded x 1.25
        np.testing.assert_allclose(np.asarray(faulty[name]) * 1.25, record[name], rtol=1e-6)


def test_the_elevator_holds_an_injected_moment(record, card):
    (held,) = injected([record], {"thrust_moment": {"thrust_arm": 0.5}}, card, Cmde=-0.7)
    a, thrust = card.aircraft, np.asarray(record["thrust_left"]) + np.asarray(record["thrust_right"])
    pressure = 0.5 * np.asarray(record["density"]) * np.asarray(record["airspeed"]) ** 2
    moment = 0.5 * thrust / (pressure * a.wing_area * a.chord)
    change = np.asarray(held["elevator"]) - np.asarray(record["elevator"])
    # Density and airspeed are smoothed before coefficients are formed.
    np.testing.assert_allclose(-0.7 * change + moment, 0.0, atol=0.02 * moment.max())


def test_lift_cannot_be_injected(record, card):
    with pytest.raises(InputError, match="more than the pitching moment"):
        injected([record], {"thrust_lift": {"thrust_lift": 0.3}}, card, Cmde=-0.7)
    with pytest.raises(InputError, match="rests on parameters of other effects"):
        injected([record], {"drag_offset": {"CLmin": 0.1}}, card, Cmde=-0.7)


def test_what_depends_on_separation_cannot_be_injected(record, card):
    with pytest.raises(InputError, match="depends on separation"):
        injected([record], {"separated_damping": {"CmqX": 0.3}}, card, Cmde=-0.7)


def test_alpha_dot_is_made_from_the_record(record, card):
    (held,) = injected([record], {"alpha_dot_moment": {"Cmadot": -3.0}}, card, Cmde=-0.7)
    assert np.std(np.asarray(held["elevator"]) - np.asarray(record["elevator"])) > 1e-4


@pytest.mark.verify
def test_sensor_errors_are_found_on_top_of_what_the_real_records_contain(attas_paths, card):
    records = [read_record(path, card.channels) for path in attas_paths]
    rng = np.random.default_rng(90)
    hidden = {"pitch_rate_bias": rng.uniform(0.004, 0.012), "accel_z_bias": rng.uniform(0.2, 0.6)}
    hidden["alpha_scale"] = rng.uniform(0.05, 0.1)
    faulty = injected(records, {name: {name: size} for name, size in hidden.items()}, card, Cmde=-0.7)
    before, after = (
        {p: s for c in diagnose(r, card, gains_wanted=False).causes for p, s in c.parameters.items()}
        for r in (records, faulty)
    )
    for name, size in hidden.items():
        assert name in after, name
        moved = after[name].mean - (before[name].mean if name in before else 0.0)
        assert moved == pytest.approx(size, abs=0.15 * abs(size) + 2.0 * after[name].sd), name
