"""Other fits of the same record: trajectories, a band of frequencies, and modes of motion."""

import math
from dataclasses import replace
from types import SimpleNamespace
from unittest.mock import Mock

import numpy as np
import pytest
from linear_cards import SHORT_PERIOD, SHORT_PERIOD_TRUTH, card_of, record_of, short_period_flight

from bayes_aero.diagnosis.diagnose import diagnose
from bayes_aero.diagnosis.trajectories import fit_disagreements, flown_mode, flown_modes, motion_of, still_apart
from bayes_aero.diagnosis.trajectory_result import ProcessNoise, TrajectoryFit
from bayes_aero.diagnosis.view import band_of, causes_in_band, with_sensor_errors_held
from bayes_aero.dynamics.linear import Steady
from bayes_aero.inference.output_error_result import OutputErrorStatus
from bayes_aero.inference.results import MleResult, MleStatus
from bayes_aero.jobs.fly import fly
from bayes_aero.report.design import in_band_sentences
from bayes_aero.report.text.fly import disagreement_sentences, settled_sentences
from bayes_aero.simulate.injection import flyable


# Coefficients and trajectories of the same record: told where they differ beyond what both intervals allow
def fits(status=MleStatus.CONVERGED, converged=True, at_bound=(), held=()):
    """Of the HFB-320: CLa differs, Cmq not so much; CD0 is in one of them alone."""
    parameters = [SimpleNamespace(name=name, unit=unit) for name, unit in (("CLa", "1/rad"), ("Cmq", "1/rad"))]
    one = Mock(
        spec=MleResult, status=status, names=("CLa", "Cmq", "CD0"), estimate=np.array([4.34, -35.2, 0.03]),
        crb_corrected=np.array([0.14, 3.0, 0.001]), at_bound=(),
    )  # fmt: skip
    fit = SimpleNamespace(
        parameters=parameters, estimate=np.array([3.37, -25.3]), sd_corrected=np.array([0.15, 2.0]),
        at_bound=at_bound, held_by_prior=held,
    )  # fmt: skip
    return one, Mock(spec=TrajectoryFit, fit=fit, converged=converged)


def test_what_differs_beyond_both_intervals_is_told_and_a_failed_filter_decides_nothing():
    (found,) = fit_disagreements(*fits())
    assert (found.name, found.coefficients, found.trajectories) == ("CLa", (4.34, 0.14), (3.37, 0.15))
    assert found.apart == pytest.approx(0.97 / np.hypot(0.14, 0.15))
    (said,) = disagreement_sentences([found])
    assert "CLa 4.34 ± 0.14 from the coefficients, 3.37 ± 0.15 from trajectories" in said
    assert "4.7 combined standard errors apart" in said
    disagree, failed = fit_disagreements(*fits()), with_process_noise((4.33, 0.05), converged=False)
    assert settled_sentences(disagree, failed, (), asked=False) == []
    assert settled_sentences((), failed, (), asked=True) == []


@pytest.mark.parametrize(
    "unusable", [{"status": MleStatus.NOT_CONVERGED}, {"converged": False}, {"at_bound": ("CLa",)}, {"held": ("CLa",)}]
)
def test_what_cannot_be_compared_is_not(unusable):
    assert fit_disagreements(*fits(**unusable)) == ()
    assert disagreement_sentences(()) == []


def with_process_noise(CLa: tuple[float, float], *, converged: bool = True) -> Mock:
    return Mock(spec=ProcessNoise, estimates={"CLa": CLa}, converged=converged, preferred=converged)


@pytest.mark.parametrize(("CLa", "apart", "said"), [
    ((4.33, 0.05), (), "CLa agrees with the coefficients (CLa 4.330 ± 0.050): prefer them"),
    ((3.4, 0.05), ("CLa",), "CLa still differs from the coefficients (CLa 3.400 ± 0.050): the model lacks"),
])  # fmt: skip
def test_the_filter_decides_between_two_fits_that_disagree(CLa, apart, said):
    disagree, filtered = fit_disagreements(*fits()), with_process_noise(CLa)
    assert still_apart(disagree, filtered) == apart
    (told,) = settled_sentences(disagree, filtered, apart, asked=True)
    assert said in told
    assert told.startswith("The coefficients and output error disagree on CLa.")
    (short,) = settled_sentences(disagree, filtered, apart, asked=False)
    assert said in short
    assert "no-process-noise" not in short


# The causes in a band of frequencies: the truth of a simulated flight, and a size that the band does not confirm
@pytest.fixture(scope="module")
def hidden(card):
    effects, flights = flyable(["alpha_dot_moment"], seed=2, noise="ar1", seconds=90.0)
    return effects["alpha_dot_moment"]["Cmadot"], diagnose([f.record for f in flights], card, gains_wanted=False)


@pytest.fixture(scope="module")
def shown(hidden):
    return causes_in_band(hidden[1])


def test_the_band_is_that_of_the_motion_and_gives_the_size_that_was_hidden(hidden, shown):
    (size,) = shown.sizes
    mean, sd = size.in_band
    assert size.cause == "alpha_dot_moment"
    assert abs(mean - hidden[0]) < 3.0 * sd
    assert sd < 0.1 * abs(hidden[0])
    assert size.apart < 3.0
    (sentence,) = in_band_sentences(shown)
    assert "agree: alpha_dot_moment" in sentence
    # From two periods of the shorter manoeuvre; nearly all power of the pitch rate is inside.
    flights = hidden[1].aerodynamics.state.responses.flights
    assert shown.band == band_of(flights)
    assert shown.band[0] == pytest.approx(2.0 / 90.04, rel=1e-3)
    q = np.asarray(flights.channels["q"])[: flights.lengths[0]]
    frequency, power = np.fft.rfftfreq(len(q), 0.04), np.abs(np.fft.rfft(q - q.mean())) ** 2
    assert power[frequency <= shown.band[1]].sum() > 0.95 * power.sum()


def test_sizes_that_are_not_in_the_band_errors_of_sensors_and_no_causes(hidden):
    """As a slow model error would leave it."""
    found = hidden[1]
    (cause,) = found.causes
    size = cause.parameters["Cmadot"]
    off = replace(size, mean=size.mean + 6.0 * size.sd)
    (one,) = causes_in_band(replace(found, causes=(replace(cause, parameters={"Cmadot": off}),))).sizes
    assert one.apart > 3.0
    shown = causes_in_band(replace(found, causes=(replace(cause, parameters={"Cmadot": off}),)))
    assert "a drift or a slow model error has a part in it" in in_band_sentences(shown)[0]
    # It is no candidate of the coefficients, and the model in the band has it all the same.
    state = hidden[1].aerodynamics.state
    theta = state.theta.copy()
    theta[state.full.columns(["accel_z_bias"])] = 0.3
    model, start = with_sensor_errors_held(replace(state, theta=theta))
    assert model.values(start)["accel_z_bias"] == 0.3
    assert "accel_z_bias" not in model.names
    assert set(model.names) == {p for n in (*state.full.base, *state.active) for p in state.full.parameters_of(n)}
    assert causes_in_band(replace(hidden[1], causes=())) is None
    assert in_band_sentences(None) == ()


# Modes of a fit with standard errors, against closed forms
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
        "period": 2.0 * np.pi / w if value.imag else None, "damping_ratio": -s / np.hypot(s, w),
        "time_constant": -1.0 / s, "time_to_half": -np.log(2.0) / s, "time_to_double": np.log(2.0) / s,
    }  # fmt: skip
    names = {-0.18: ("period", "damping_ratio", "time_to_half"), -1.4: ("time_constant", "time_to_half")}
    assert tuple(mode.quantities) == names.get(value.real, ("time_to_double",))
    for name, (centre, sd) in mode.quantities.items():
        assert centre == pytest.approx(np.median(drawn[name]), rel=5e-3), name
        low, high = np.quantile(drawn[name], [0.1587, 0.8413])
        assert sd == pytest.approx(0.5 * (high - low), rel=0.05), name


def test_modes_without_a_known_sign_an_error_or_a_converged_fit(flown):
    assert flown_mode("spiral", 0.01 + 0.0j, np.diag([1e-4, 0.0])).quantities == {}
    fit = flown.fit
    (mode,) = flown_modes(replace(fit, undetermined=("Mq",)), Steady(1.0, 0.0))
    assert math.isinf(mode.quantities["period"][1])
    assert math.isinf(mode.quantities["damping_ratio"][1])
    assert math.isinf(flown_mode("Dutch roll", 0.1 + 1.0j, np.full((2, 2), np.inf)).quantities["damping_ratio"][1])
    (same,) = flown_modes(replace(fit, undetermined=("az0",)), Steady(1.0, 0.0))
    assert math.isfinite(same.quantities["period"][1])
    assert motion_of(replace(flown, fit=replace(flown.fit, status=OutputErrorStatus.NOT_CONVERGED))) is None
    assert math.isnan(motion_of(flown).airspeed)  # of a linear card


def test_modes_spread_as_draws_of_the_parameters_of_the_better_fit(flown):
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
    # Linear short period again, of the estimates and the covariance of a fit with process noise.
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
