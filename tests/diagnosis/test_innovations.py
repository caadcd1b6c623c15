"""A flight in gusts, by a simulator that shares no code: the filter finds the gusts, and the search what is hidden."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import fsolve

from bayes_aero.diagnosis.result import INNOVATIONS, NoiseReport, Verdict, as_white
from bayes_aero.diagnosis.search import search_innovations as searched
from bayes_aero.diagnosis.settings import DiagnosisSettings
from bayes_aero.flight.card.card import read_card
from bayes_aero.flight.record import FlightRecord
from bayes_aero.model.model import Model

TRUTH = {
    "CL0": -0.13, "CLV": 0.16, "CLa": 4.5, "CD0": 0.125, "CDV": -0.065, "CDa": 0.315,
    "Cm0": 0.139, "CmV": -0.018, "Cma": -1.0, "Cmq": -26.5, "Cmde": -1.44,
}  # fmt: skip
HIDDEN = -3.0  # Cma2, 1/rad2
GUST, LENGTH = {"w": 1.5, "u": 1.0}, 200.0  # m/s, m
NOISE = {"airspeed": 0.1, "alpha": 0.001, "theta": 0.0005, "q": 0.0005, "ax": 0.02, "az": 0.05}
MASS, INERTIA, AREA, CHORD, DENSITY, V0 = 7472.0, 91388.0, 30.097, 2.43, 0.792, 104.67
TILT, ARM, G = 0.0524, -0.642, 9.80665
DT, FINER, SECONDS, SEED = 0.05, 10, 60.0, 5


def _body(V, alpha, q, elevator, thrust):
    """Specific force along body x and z, and pitch acceleration, of a flow; the published equations (TC04)."""
    t, pressure = TRUTH, 0.5 * DENSITY * V**2 * AREA
    CL = t["CL0"] + t["CLV"] * V / V0 + t["CLa"] * alpha
    CD = t["CD0"] + t["CDV"] * V / V0 + t["CDa"] * alpha
    Cm = t["Cm0"] + t["CmV"] * V / V0 + t["Cma"] * alpha + t["Cmq"] * q * CHORD / (2.0 * V0) + t["Cmde"] * elevator
    Cm += HIDDEN * alpha**2
    ax = pressure * (CL * np.sin(alpha) - CD * np.cos(alpha)) / MASS + thrust / MASS * np.cos(TILT)
    az = -pressure * (CL * np.cos(alpha) + CD * np.sin(alpha)) / MASS - thrust / MASS * np.sin(TILT)
    return ax, az, (pressure * CHORD * Cm + thrust * ARM * np.cos(TILT)) / INERTIA


def _rates(x, gust, elevator, thrust):
    V, alpha, theta, q = x
    ax, az, q_dot = _body(V + gust[1], alpha + gust[0] / V, q, elevator, thrust)
    along = ax * np.cos(alpha) + az * np.sin(alpha) - G * np.sin(theta - alpha)
    turn = q + (az * np.cos(alpha) - ax * np.sin(alpha) + G * np.cos(theta - alpha)) / V
    return np.array([along, turn, q, q_dot])


@pytest.fixture(scope="module")
def record():
    """Elevator steps and a slow sweep of alpha from trimmed level flight, in first-order gusts; Heun's method."""
    rng, h = np.random.default_rng(SEED), DT / FINER
    trim = lambda y: _rates([104.0, y[0], y[0], 0.0], (0.0, 0.0), y[1], 1e3 * y[2])[[0, 1, 3]]
    alpha, still, thrust = fsolve(trim, [0.11, 0.0, 9.0])
    n = round(SECONDS / DT)
    x, gust, rows = np.array([104.0, alpha, alpha, 0.0]), np.array([rng.normal(0.0, s) for s in GUST.values()]), []
    t = DT * np.arange(n)
    command = still + np.deg2rad(1.2) * np.sign(np.sin(2.0 * np.pi * t / 7.0)) * (t > 3.0)
    command -= np.deg2rad(1.5) * np.sin(2.0 * np.pi * t / 40.0)
    for k in range(n):
        V, angle, theta, q = x
        flow = (V + gust[1], angle + gust[0] / V)
        ax, az, _ = _body(*flow, q, command[k], 1e3 * thrust)
        rows.append([*flow, theta, q, ax, az])
        ahead = command[min(k + 1, n - 1)]
        for j in range(FINER):
            elevator = command[k] + (ahead - command[k]) * np.array([j, j + 1]) / FINER
            kept = np.exp(-V / LENGTH * h)
            new = kept * gust + np.sqrt(1.0 - kept**2) * rng.normal(size=2) * np.array(list(GUST.values()))
            first = _rates(x, gust, elevator[0], 1e3 * thrust)
            second = _rates(x + h * first, new, elevator[1], 1e3 * thrust)
            x, gust = x + 0.5 * h * (first + second), new
    clean = np.array(rows)
    channels = {name: clean[:, i] + rng.normal(0.0, sd, n) for i, (name, sd) in enumerate(NOISE.items())}
    channels |= {"elevator": command, "thrust": np.full(n, 1e3 * thrust), "density": np.full(n, DENSITY)}
    return FlightRecord("gusty", t, channels, "simulated", "")


@pytest.fixture(scope="module")
def found(record):
    """The search, and the fit that it began with."""
    fits, fit = [], searched.fit_disturbed
    card = read_card("hfb320")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(searched, "fit_disturbed", lambda *a, **k: fits.append(fit(*a, **k)) or fits[-1])
        settings = DiagnosisSettings(max_effects=3)
        result = searched.search_innovations([record], card, Model.from_card(card), (), settings, seed=0)
    return result, fits[0][1]


def test_the_gusts_are_found_with_their_intensity_and_length(found):
    _, fit = found
    known = dict(zip(fit.names, zip(fit.estimate, fit.sd, strict=True), strict=True))
    for name, truth in (("vertical_gust", GUST["w"]), ("longitudinal_gust", GUST["u"])):
        estimate, sd = known[name]
        assert abs(estimate - truth) < 3.0 * sd
        assert sd < 0.4 * truth
        length, length_sd = known[f"{name}_length"]
        assert abs(length - LENGTH) < 3.0 * length_sd


def test_the_hidden_effect_is_named_first_and_its_interval_holds(found):
    result, _ = found
    assert [stage for stage, _ in result.stages] == [INNOVATIONS]
    assert result.model.steps[0].chosen == "alpha_squared_moment"
    size = result.model.sizes["Cma2"]
    assert abs(size.mean - HIDDEN) < 3.0 * size.sd
    assert size.sd < 0.2 * abs(HIDDEN)


def test_the_parameters_are_those_of_the_aircraft(found):
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


def test_what_the_filter_foresees_wholly_leaves_white_innovations(found):
    """Correlation of neighbouring samples within 4 / sqrt(n), n of them."""
    noise = found[0].noise
    assert noise.of_innovations
    assert max(abs(r) for r in noise.lag1.values()) < 4.0 / np.sqrt(SECONDS / DT)
    assert noise.coloured == ()


@pytest.mark.parametrize(
    ("lag", "found", "verdict"),
    [
        (0.02, Verdict.EXPLAINED, Verdict.EXPLAINED),
        (0.86, Verdict.EXPLAINED, Verdict.PARTLY_EXPLAINED),
        (0.86, Verdict.NO_EFFECT, Verdict.UNDECIDED),
        (-0.5, Verdict.NO_EFFECT, Verdict.UNDECIDED),
        (0.86, Verdict.UNEXPLAINED, Verdict.UNEXPLAINED),
    ],
)
def test_coloured_innovations_leave_the_error_unexplained(lag, found, verdict):
    noise = NoiseReport({"alpha": lag, "q": 0.0}, {}, {"alpha": 1.0, "q": 1.0}, {}, of_innovations=True)
    assert as_white(found, noise) is verdict
    assert as_white(found, replace(noise, of_innovations=False)) is found
