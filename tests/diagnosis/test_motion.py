"""Modes of a fit with standard errors, against closed forms."""

from __future__ import annotations

import math
from dataclasses import replace
from unittest.mock import Mock

import numpy as np
import pytest
from linear_cards import SHORT_PERIOD, SHORT_PERIOD_TRUTH, card_of, record_of, short_period_flight

from bayes_aero.diagnosis.trajectories.motion.flown_modes import flown_mode, flown_modes
from bayes_aero.diagnosis.trajectories.motion.motion import motion_of
from bayes_aero.diagnosis.trajectories.results import ProcessNoise
from bayes_aero.dynamics.modes import Steady
from bayes_aero.inference.likelihood.output_error_result import OutputErrorStatus
from bayes_aero.jobs.fly import fly


@pytest.fixture(scope="module")
def flown():
    """A linear short period fitted to two noisy flights of 8 s."""
    noise = {"alpha": 0.002, "q": 0.003, "az": 0.15}
    motions = [short_period_flight(SHORT_PERIOD_TRUTH, n=200, x0=(0.04, 0.03 * k)) for k in range(2)]
    rngs = [np.random.default_rng(k) for k in range(2)]
    records = [record_of(motions[k], noise=noise, rng=rngs[k], name=f"flight {k}") for k in range(2)]
    return fly(records, card_of(SHORT_PERIOD)).flown


@pytest.mark.parametrize("value", [-0.18 + 1.64j, -1.4 + 0.0j, 0.03 + 0.0j])
def test_errors_of_first_order_are_those_of_draws(value):
    rng = np.random.default_rng(5)
    covariance = np.array([[4e-6, 1e-6 if value.imag else 0.0], [1e-6 if value.imag else 0.0, 9e-6 * (value.imag > 0)]])
    mode = flown_mode("some", value, covariance)
    s, w = rng.multivariate_normal([value.real, value.imag], covariance, 20000).T
    drawn = {
        "period": 2.0 * np.pi / w if value.imag else None,
        "damping_ratio": -s / np.hypot(s, w),
        "time_constant": -1.0 / s,
        "time_to_half": -np.log(2.0) / s,
        "time_to_double": np.log(2.0) / s,
    }
    names = {-0.18: ("period", "damping_ratio", "time_to_half"), -1.4: ("time_constant", "time_to_half")}
    assert tuple(mode.quantities) == names.get(value.real, ("time_to_double",))
    for name, (centre, sd) in mode.quantities.items():
        assert centre == pytest.approx(np.median(drawn[name]), rel=5e-3), name
        low, high = np.quantile(drawn[name], [0.1587, 0.8413])
        assert sd == pytest.approx(0.5 * (high - low), rel=0.05), name


def test_a_mode_whose_sign_is_open_has_no_time():
    assert flown_mode("spiral", 0.01 + 0.0j, np.diag([1e-4, 0.0])).quantities == {}


def test_modes_of_a_fit_spread_as_draws_of_its_parameters(flown):
    """Linear short period: eigenvalues in closed form, of draws from the covariance of the estimates."""
    (mode,) = flown_modes(flown.fit, Steady(1.0, 0.0))
    names = list(flown.fit.names)
    draws = np.random.default_rng(2).multivariate_normal(flown.fit.estimate, flown.fit.corrected, 20000).T
    Zalpha, Mq, Malpha = (draws[names.index(n)] for n in ("Zalpha", "Mq", "Malpha"))
    real = 0.5 * (Zalpha + Mq)
    w = np.sqrt(Zalpha * Mq - Malpha - real**2)
    assert mode.name == "short period"
    for (value, sd), drawn in (
        (mode.quantities["period"], 2.0 * np.pi / w),
        (mode.quantities["damping_ratio"], -real / np.hypot(real, w)),
    ):
        assert value == pytest.approx(np.median(drawn), rel=5e-3)
        assert sd == pytest.approx(0.5 * np.diff(np.quantile(drawn, [0.1587, 0.8413]))[0], rel=0.05)


def test_modes_are_those_of_the_better_fit(flown):
    """Linear short period again, of the estimates and the covariance of a fit with process noise."""
    found = dict(zip(flown.fit.names, flown.fit.estimate, strict=True)) | {"Zalpha": -1.3, "Mq": -1.1, "Malpha": -9.0}
    names = list(found)[::-1]  # in another order
    sd = {"Zalpha": 0.0, "Mq": 0.04, "Malpha": 0.2}
    beside = Mock(
        spec=ProcessNoise,
        preferred=True,
        estimates={name: (float(found[name]), sd.get(name, 0.0)) for name in names},
        covariance=np.diag([sd.get(name, 0.0) ** 2 for name in names]),
    )
    moved = motion_of(flown, beside)
    assert moved.filtered
    (mode,) = moved.modes
    w = np.sqrt(1.3 * 1.1 + 9.0 - 1.2**2)
    assert mode.eigenvalue == pytest.approx(-1.2 + 1j * w)
    slopes = np.array([(-1.3 + 1.2) / (2.0 * w), -1.0 / (2.0 * w)])  # of w by Mq and Malpha
    assert mode.sd == pytest.approx((0.02, float(np.hypot(*(slopes * [0.04, 0.2])))), rel=1e-3)
    worse = motion_of(flown, Mock(spec=ProcessNoise, preferred=False))
    assert (worse.filtered, worse.modes) == (False, motion_of(flown).modes)


def test_a_parameter_that_the_record_does_not_determine_leaves_no_error(flown):
    fit = flown.fit
    (mode,) = flown_modes(replace(fit, undetermined=("Mq",)), Steady(1.0, 0.0))
    assert math.isinf(mode.quantities["period"][1])
    assert math.isinf(mode.quantities["damping_ratio"][1])
    assert math.isinf(flown_mode("Dutch roll", 0.1 + 1.0j, np.full((2, 2), np.inf)).quantities["damping_ratio"][1])
    (same,) = flown_modes(replace(fit, undetermined=("az0",)), Steady(1.0, 0.0))
    assert math.isfinite(same.quantities["period"][1])


def test_a_fit_that_did_not_converge_has_no_motion(flown):
    assert motion_of(replace(flown, fit=replace(flown.fit, status=OutputErrorStatus.NOT_CONVERGED))) is None
    assert math.isnan(motion_of(flown).airspeed)  # of a linear card
