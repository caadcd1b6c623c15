"""Slow noise of every sensor and surface, in flights of a simulator that shares no code: it names nothing."""

import numpy as np
import pytest
import six_axes
from scipy.signal import lfilter
from stranger_six import drawn, fly

from bayes_aero.diagnosis.candidate_set import candidate_model
from bayes_aero.diagnosis.diagnose import rivals_of
from bayes_aero.diagnosis.search.stages import search_in_stages
from bayes_aero.diagnosis.selection.forward_selection import noise_shares
from bayes_aero.flight.card.card import read_card
from bayes_aero.flight.record import FlightRecord
from bayes_aero.inference.likelihood.mle import fit_mle
from bayes_aero.model.joined_channels import despiked, join
from bayes_aero.model.model import Model
from bayes_aero.model.observations import observe
from bayes_aero.physics.coefficient_names import required_of
from bayes_aero.residuals.equation_error import EquationError

NOISE = six_axes.NOISE | dict.fromkeys(("elevator", "aileron", "rudder"), 1e-3)
SLOW, DT = 0.15, 0.02  # s


def searched(tmp_path, seed, times, left_out=None, scale=1.0):
    """Causes of three flights of 26 s at 50 Hz, half of the noise's variance with a time constant of .15 s; `times` as
    large as usual, with an effect that the card lacks or a lateral accelerometer of another `scale`."""
    rng = np.random.default_rng([seed, 17])
    plane, keep = drawn(rng, **six_axes.ATTACHED), np.exp(-DT / SLOW)
    effects = [e for e in (*six_axes.LONGITUDINAL, *six_axes.LATERAL) if e != left_out]
    path = tmp_path / "another.toml"
    path.write_text(six_axes.card_text(plane, effects), encoding="utf-8")
    card, records = read_card(str(path)), []
    for kind in ("elevator", "aileron", "rudder"):
        flight = fly(plane, kind, rng, dt=DT, seconds=26.0)
        flight["ay"] = scale * flight["ay"]
        shown = {}
        for name in six_axes.RECORDED:
            white, shock = rng.standard_normal((2, len(flight["time"])))
            slow = lfilter([np.sqrt(1.0 - keep**2)], [1.0, -keep], shock)
            shown[name] = flight[name] + times * NOISE.get(name, 0.0) * np.sqrt(0.5) * (white + slow)
        shown["thrust"] = shown["thrust_left"] + shown["thrust_right"]
        records.append(FlightRecord.from_arrays(kind, flight["time"], shown, "simulated"))
    model = Model.from_card(card)
    flights, _ = despiked(join(records, card, required_of(model.axes)))
    full = candidate_model(model, flights)
    fit, theta = fit_mle(model, observe(records, card, model), seed=0), full.neutral_vector
    theta[full.columns(fit.names)] = fit.estimate
    return search_in_stages(full, EquationError.of(flights, full.model), theta, seed=0)


@pytest.mark.verify
@pytest.mark.parametrize(("seed", "times", "left_out"), [(1, 3.0, None), (2, 3.0, None), (3, 1.0, "rudder_side_force")])
def test_noise_of_the_regressors_is_no_error_of_a_sensor(tmp_path, seed, times, left_out):
    """r_dot, which is recorded well, then tells more of sideslip and rudder than their own channels: a lateral
    accelerometer 2 to 3 m away, were it believed. With the usual noise the missing effect is named."""
    found = searched(tmp_path, seed, times, left_out)
    assert found.sensors is not None
    assert found.sensors.causes == ()
    assert found.aerodynamics.causes == (() if left_out is None else (left_out,))


@pytest.mark.verify
@pytest.mark.parametrize("seed", [1, 3])
def test_what_outdoes_its_rival_by_less_noise_alone_is_not_named_alone(tmp_path, seed):
    """With three times the noise an accelerometer 2 m away explains more than the missing effect of the rudder."""
    found = searched(tmp_path, seed, 3.0, "rudder_side_force").aerodynamics
    noise = noise_shares(found.state, found.fit)
    for name in found.causes:
        assert "rudder_side_force" in (name, *rivals_of(found, name, noise=noise[name])[1])


@pytest.mark.verify
@pytest.mark.parametrize("seed", [1, 3])
def test_the_scale_of_an_accelerometer_is_found_in_slow_noise(tmp_path, seed):
    found = searched(tmp_path, seed, 1.0, scale=0.85).aerodynamics
    assert found.causes == ("accel_y_scale",)
    size = found.sizes["accel_y_scale"]
    assert abs(size.mean + 0.15) < 1.96 * size.sd
