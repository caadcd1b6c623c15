"""Flights in gusts: what the filter finds, and where process noise is estimated."""

from dataclasses import replace

import numpy as np
import pytest
import six_axes as six
import stranger_six
from gusty_flight import DT, GUST, LENGTH, SECONDS, TRUTH, gusty_flight

from bayes_aero.diagnosis import diagnose as diagnosis
from bayes_aero.diagnosis import search as searches
from bayes_aero.diagnosis.candidate_set import DiagnosisSettings
from bayes_aero.diagnosis.diagnose import diagnose
from bayes_aero.diagnosis.result import Verdict, as_white
from bayes_aero.diagnosis.screening import NoiseReport
from bayes_aero.flight.card import read_card
from bayes_aero.inference.output_error import GUSTS
from bayes_aero.jobs import fly as job
from bayes_aero.model.model import Model
from bayes_aero.residuals.base import INNOVATIONS

# A flight in gusts, by a simulator that shares no code: the filter finds the gusts, and the search what is hidden
HIDDEN, SEED = -3.0, 5  # Cma2, 1/rad2


@pytest.fixture(scope="module")
def record():
    """A minute in gusts, of an aircraft with a curved moment; its flaps stay where they are."""
    flight = gusty_flight(SEED, truth={"Cma2": HIDDEN})
    return replace(flight, channels={**flight.channels, "flap": np.full(len(flight.time), 0.1)})


@pytest.fixture(scope="module")
def found(record, hfb320):
    """The search, and the fit that it began with."""
    fits, fit = [], searches.fit_disturbed
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(searches, "fit_disturbed", lambda *a, **k: fits.append(fit(*a, **k)) or fits[-1])
        settings = DiagnosisSettings(max_effects=3)
        result = searches.Search([record], hfb320, Model.from_card(hfb320), (), settings, 0).innovations()
    return result, fits[0][1]


def test_gusts_and_the_hidden_effect_are_found_beside_what_is_on_the_card(found):
    _, fit = found
    known = dict(zip(fit.names, zip(fit.estimate, fit.sd, strict=True), strict=True))
    for name, truth in (("vertical_gust", GUST["w"]), ("longitudinal_gust", GUST["u"])):
        estimate, sd = known[name]
        assert abs(estimate - truth) < 3.0 * sd
        assert sd < 0.4 * truth
        length, length_sd = known[f"{name}_length"]
        assert abs(length - LENGTH) < 3.0 * length_sd
    # Derivatives of flaps at rest would share the coefficients' constants.
    result, fit = found
    gusts = {n for name in GUSTS for n in (name, f"{name}_length")}
    own = {p.name for p in Model.from_card(read_card("hfb320")).free}
    assert "flap_lift" in result.full.not_testable
    assert set(fit.names) == own | gusts
    # Correlation of neighbouring samples within 4 / sqrt(n), n of them.
    noise = found[0].noise
    assert noise.of_innovations
    assert max(abs(r) for r in noise.lag1.values()) < 4.0 / np.sqrt(SECONDS / DT)
    assert noise.coloured == ()
    result, _ = found
    assert [stage for stage, _ in result.stages] == [INNOVATIONS]
    assert result.model.steps[0].chosen == "alpha_squared_moment"
    size = result.model.sizes["Cma2"]
    assert abs(size.mean - HIDDEN) < 3.0 * size.sd
    assert size.sd < 0.2 * abs(HIDDEN)
    result, _ = found
    for name in ("CLa", "CDa", "Cmq", "Cmde"):
        size = result.model.sizes[name]
        assert abs(size.mean - TRUTH[name]) < 4.0 * size.sd, name


@pytest.mark.parametrize(
    "name", ["airspeed_scale", "alpha_scale", "pitch_attitude_bias", "CLa", "Cma2", "thrust_scale"]
)
def test_sensitivities_of_innovations_match_finite_differences(found, name):
    """An error of scale makes the sensor's noise larger, too, which its sensitivity must hold."""
    state = found[0].model.base
    at, step = state.full.columns([name])[0], 1e-5
    directions = np.zeros((16, len(state.theta)))
    directions[0, at] = 1.0
    _, slope = state.responses.slopes(state.theta, directions)
    up, down = (state.responses.evaluate(state.theta + sign * step * directions[0])[0] for sign in (1, -1))
    difference = (np.asarray(down) - np.asarray(up)) / (2.0 * step)
    np.testing.assert_allclose(slope[0], difference, rtol=1e-5, atol=1e-5 * np.abs(difference).max())


@pytest.mark.verify
@pytest.mark.parametrize("hidden", [None, "rudder_yaw", "sideslip_scale"])
def test_an_effect_of_six_axes_is_named_in_gusts_and_none_where_none_is_hidden(hidden, tmp_path):
    """Three manoeuvres in gusts of 0.7 m/s: a derivative that the card lacks, or a vane that shows a fifth too little.

    The standard error of the vane's scale is some 0.02: the gusts move the vane, and the derivatives take up the rest.
    """
    plane, rng = stranger_six.Plane(**six.ATTACHED), np.random.default_rng(3)
    effects = [n for n in (*six.LONGITUDINAL, *six.LATERAL) if n != hidden]
    seen, records = 0.8 if hidden == "sideslip_scale" else 1.0, []
    for kind in ("elevator", "aileron", "rudder"):
        flight = stranger_six.fly(plane, kind, rng, gust=0.7)
        records.append(six.record(kind, {**flight, "beta": seen * flight["beta"]}, rng))
    card = six.card_in(tmp_path, plane, effects)
    found = diagnose(records, card, process_noise=True, gains_wanted=False, settings=DiagnosisSettings(max_effects=2))
    truth = {"rudder_yaw": ("Cndr", plane.Cndr), "sideslip_scale": ("sideslip_scale", seen - 1.0)}
    assert [c.name for c in found.causes] == [hidden] * (hidden is not None)
    assert not found.unknown
    for cause in found.causes:
        name, true = truth[cause.name]
        size = cause.parameters[name]
        assert abs(size.mean - true) < 3.0 * size.sd


@pytest.mark.parametrize(("lag", "found", "verdict"), [
    (0.02, Verdict.EXPLAINED, Verdict.EXPLAINED), (0.86, Verdict.EXPLAINED, Verdict.PARTLY_EXPLAINED),
    (0.86, Verdict.NO_EFFECT, Verdict.UNDECIDED), (-0.5, Verdict.NO_EFFECT, Verdict.UNDECIDED),
    (0.86, Verdict.UNEXPLAINED, Verdict.UNEXPLAINED),
])  # fmt: skip
def test_coloured_innovations_leave_the_error_unexplained(lag, found, verdict):
    noise = NoiseReport({"alpha": lag, "q": 0.0}, {}, {"alpha": 1.0, "q": 1.0}, {}, of_innovations=True)
    assert as_white(found, noise) is verdict
    assert as_white(found, replace(noise, of_innovations=False)) is found


# Process noise is estimated where a record is in gusts, unless the user decides
OUTPUTS = "airspeed,alpha,theta,q,ax,az"
CALM, GUSTY = {"w": 0.0, "u": 0.0}, {"w": 1.0, "u": 1.0}
DECISIONS = [(GUSTY, None, True), (CALM, None, False), (GUSTY, False, False), (CALM, True, True)]


@pytest.fixture(scope="module")
def hfb320():
    return read_card("hfb320")


class SearchedError(Exception):
    """Ends the diagnosis where its search begins."""


@pytest.mark.parametrize(("gust", "given", "expected"), DECISIONS)
def test_a_diagnosis_compares_with_innovations_in_gusts(hfb320, monkeypatch, gust, given, expected):
    def begun(name):
        def search(*_, **__):
            raise SearchedError(name)

        return search

    for name in ("innovations", "coefficients", "trajectories"):
        monkeypatch.setattr(searches.Search, name, begun(name))
    with pytest.raises(SearchedError) as found:
        diagnosis.diagnose([gusty_flight(4, gust=gust, seconds=20.0)], hfb320, process_noise=given)
    assert (str(found.value) == "innovations") is expected


@pytest.mark.parametrize(("gust", "given", "expected"), DECISIONS)
def test_a_fit_to_trajectories_has_process_noise_in_gusts(hfb320, monkeypatch, gust, given, expected):
    filtered = []

    def instead(_, options, *__):
        filtered.append(options.process_noise)
        return (None, None), ()

    monkeypatch.setattr(job, "process_noise", instead)
    found = job.fly([gusty_flight(4, gust=gust, seconds=20.0)], hfb320, process_noise=given, outputs=OUTPUTS)
    assert filtered == [expected]
    asked = expected and given is None
    assert found.sentences[0].startswith("The flight path alone, without aerodynamics, shows gusts") is asked
