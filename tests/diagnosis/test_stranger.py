"""Records of aircraft that nobody here has seen, from a simulator of their own: the hidden effect, and nothing else."""

import numpy as np
import pytest
from stranger_records import HIDDEN, Recorder, flown

from bayes_aero.diagnosis.diagnose import diagnose
from bayes_aero.diagnosis.result import Verdict
from bayes_aero.flight.card.card import read_card
from bayes_aero.flight.reading.read_record import read_record

DRAWN = np.random.default_rng(20261).integers(1_000_000, size=2)


def diagnosed(folder, seed, name=None, gusts=0.0, recorder=Recorder()):
    """A random aircraft's two records, read from CSV and diagnosed."""
    p, size, files = flown(folder, np.random.default_rng(seed), name, gusts, recorder)
    card = read_card(str(folder / "card.toml"))
    records = [read_record(path, card.channels) for path in files]
    return p, size, diagnose(records, card, seed=int(seed), gains_wanted=False)


@pytest.mark.recovery
def test_what_was_hidden_is_named_with_its_size(tmp_path):
    name = str(np.random.default_rng(DRAWN[0]).choice(list(HIDDEN)))
    p, size, found = diagnosed(tmp_path, DRAWN[0], name)
    assert [cause.name for cause in found.causes] == [name]
    assert found.verdict is Verdict.EXPLAINED
    estimate = found.causes[0].parameters[HIDDEN[name][0]]
    assert abs(estimate.mean - size) < 3.0 * estimate.sd + 0.01 * abs(size)
    for base, own in (
        ("Cma", p.Cma),
        ("Cmq", p.Cmq / 2.0),
        ("Cmde", p.Cmde),
        ("CLa", p.CLa),
        ("e", p.e),
        ("CDX", p.CDX),
    ):
        assert found.base_moves[base][1] == pytest.approx(own, rel=0.03), base


@pytest.mark.recovery
def test_nothing_is_named_where_nothing_is_hidden(tmp_path):
    found = diagnosed(tmp_path, DRAWN[1])[2]
    assert found.verdict is Verdict.NO_EFFECT


@pytest.mark.verify
def test_a_poor_recorder_is_no_effect_and_hides_none(tmp_path):
    """Noise correlated from sample to sample, a filter of a few hertz, coarse digits: on all channels alike."""
    rng = np.random.default_rng(20264)
    seeds, name = rng.integers(1_000_000, size=2), str(rng.choice(["pitch_rate_bias", "thrust_moment", "alpha_bias"]))
    silent, named = tmp_path / "silent", tmp_path / "named"
    silent.mkdir(), named.mkdir()
    assert diagnosed(silent, seeds[0], recorder=Recorder.poor(rng))[2].verdict is Verdict.NO_EFFECT
    found = diagnosed(named, seeds[1], name, recorder=Recorder.poor(rng))[2]
    assert [cause.name for cause in found.causes] == [name]


@pytest.mark.verify
@pytest.mark.parametrize("name", ["separated_alpha_moment", "alpha_squared_moment"])
def test_noise_of_the_vane_in_lift_and_moment_at_once_is_no_shift_of_the_cg(tmp_path, name):
    """A CG moved aft adds lift to the moment, and takes the vane's noise out of it where it was in both."""
    _, size, found = diagnosed(tmp_path, 0, name)
    assert [cause.name for cause in found.causes] == [name]
    estimate = found.causes[0].parameters[HIDDEN[name][0]]
    assert abs(estimate.mean - size) < 3.0 * estimate.sd


@pytest.mark.verify
def test_gusts_are_no_error_of_a_sensor(tmp_path):
    """They are in vane and airspeed, and what integrates them wanders off like an offset. Their mean is a wind."""
    rng = np.random.default_rng(20262)
    found = diagnosed(tmp_path, rng.integers(1_000_000), gusts=rng.uniform(0.3, 0.7))[2]
    assert {cause.name for cause in found.causes} <= {"vertical_wind"}
    assert not found.unknown


@pytest.mark.verify
def test_an_offset_of_the_vane_is_named_in_gusts_and_no_wind_beside_it(tmp_path):
    """From the flight path alone the two are nearly one; the coefficients feel the vane and not the wind."""
    _, size, found = diagnosed(tmp_path, 20263, "alpha_bias", gusts=0.4)
    assert [cause.name for cause in found.causes] == ["alpha_bias"]
    estimate = found.causes[0].parameters["alpha_bias"]
    assert abs(estimate.mean - size) < 4.0 * estimate.sd
