"""Models flown along records, by simulation or by filter, and other fits of the same record."""

import math
from dataclasses import replace
from types import SimpleNamespace
from unittest.mock import Mock

import numpy as np
import pytest
import six_axes as six
import stranger_six
from gusty_flight import DT, GUST, LENGTH, SECONDS, gusty_flight
from gusty_flight import TRUTH as GUSTY_TRUTH
from linear_cards import SHORT_PERIOD, SHORT_PERIOD_TRUTH, card_of, record_of, short_period_flight
from parts import cause, fitted_to_stalls, part, without_accelerometers
from scipy.stats import norm
from simulated_halves import halves

from bayes_aero.diagnosis import result
from bayes_aero.diagnosis import search as searches
from bayes_aero.diagnosis import trajectories as hold_out
from bayes_aero.diagnosis.diagnose import band_of, causes_in_band, diagnose, with_sensor_errors_held
from bayes_aero.diagnosis.result import (
    INNOVATIONS,
    LagTest,
    NoiseReport,
    OutputMiss,
    ProcessNoise,
    SimulatedManoeuvre,
    TrajectoryFit,
    Verdict,
    verdict_of,
)
from bayes_aero.diagnosis.search import in_windows
from bayes_aero.diagnosis.selection import LeftOut
from bayes_aero.diagnosis.selection_state import (
    CandidateModel,
    DiagnosisSettings,
    candidate_model,
    constants_of_manoeuvres,
)
from bayes_aero.diagnosis.trajectories import (
    beyond_noise,
    compare_trajectories,
    fit_disagreements,
    flown_mode,
    flown_modes,
    fly_given,
    motion_of,
    still_apart,
)
from bayes_aero.dynamics.flight import aircraft_dynamics
from bayes_aero.dynamics.segments import SegmentTrajectories
from bayes_aero.dynamics.trim import Steady
from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.flight.card import read_card
from bayes_aero.flight.record import FlightRecord
from bayes_aero.inference.prediction_error import GUSTS
from bayes_aero.inference.results import MleResult, MleStatus, OutputErrorStatus
from bayes_aero.jobs import fly as job
from bayes_aero.jobs.fly import fly
from bayes_aero.jobs.results import part_of_errors
from bayes_aero.model.model import Model
from bayes_aero.model.observations import despiked, join
from bayes_aero.parameter import Parameter, Prior
from bayes_aero.physics.aircraft import FLIGHT
from bayes_aero.report.pages.diagnosis import in_band_sentences
from bayes_aero.report.pages.fly import disagreement_sentences
from bayes_aero.report.pages.trajectories import settled_sentences
from bayes_aero.simulate.demo import TRUTH, simulate_stall
from bayes_aero.simulate.injection import Beyond, flyable, hidden_records

# The simulation before and after the extension, and a fit to trajectories alone
SEED = 4132
BANDS = {"airspeed": 1.5, "alpha": 0.035, "theta": 0.035}


@pytest.fixture(scope="module")
def flown(card):
    """A thrust line 0.6 m from where the card has it: found from coefficients, then flown."""
    records = hidden_records({"thrust_moment": {"thrust_arm": 0.6}}, seed=SEED, seconds=90.0)
    found = diagnose(records, card, settings=DiagnosisSettings(gains=False))
    return found, compare_trajectories(despiked(join(records, card))[0], found, BANDS)


@pytest.mark.recovery
def test_the_simulation_gains_on_other_flights_and_gives_the_arm_back(flown):
    found, paths = flown
    assert "thrust_moment" in [c.name for c in found.causes], SEED
    assert {p.split for p in paths.paths} == {"fitted", "hold_out"}
    for manoeuvre in {p.manoeuvre for p in paths.paths}:
        before, after = (paths.path(manoeuvre, model, "hold_out") for model in ("card", "extended"))
        assert after.inside
        for name in ("airspeed", "theta"):
            assert after.errors[name].rms < 0.6 * before.errors[name].rms, (manoeuvre, name, SEED)
        for path in (before, after):
            for name, error in path.errors.items():
                residual = path.measured[name] - path.simulated[name]
                assert error.rms == pytest.approx(np.sqrt(np.mean(residual**2)))
                assert error.largest == pytest.approx(np.abs(residual).max())
                if name in BANDS:
                    assert error.within == pytest.approx(np.mean(np.abs(residual) <= BANDS[name]))
                    assert 0.0 <= error.probability <= 1.0
    near = max(0.06, 4.0 * paths.deviation["thrust_arm"])
    assert paths.extended.values["thrust_arm"] == pytest.approx(0.6, abs=near), SEED
    assert paths.card.values["thrust_arm"] == 0.0
    assert paths.variance_inflation >= 1.0


@pytest.mark.verify
def test_a_fit_that_strays_in_long_windows_is_begun_in_shorter_ones(card):
    """This flight, begun in windows of 10 s, ends at tau2 = -50 and a1 = 10, and leaves the envelope."""
    records = [without_accelerometers(r) for r in hidden_records({}, seed=8930, seconds=90.0, noise="ar1")]
    flights, _ = despiked(join(records, card, FLIGHT))
    fit = in_windows(flights, aircraft_dynamics(Model.from_card(card), flights))
    assert fit.status is OutputErrorStatus.CONVERGED
    found = dict(zip(fit.names, fit.estimate, strict=True))
    assert found["alpha_star"] == pytest.approx(TRUTH["alpha_star"], abs=0.01)
    assert found["tau2"] == pytest.approx(TRUTH["tau2"], rel=0.3)
    assert found["a1"] == pytest.approx(TRUTH["a1"], rel=0.3)


def test_an_offset_of_a_coefficient_in_one_manoeuvre_is_its_constant_there():
    """Flown outputs to CL0, manoeuvre by manoeuvre: the constants add up to the model's own."""
    rng = np.random.default_rng(0)
    S, manoeuvre = rng.standard_normal((7, 2, 3)), np.array([0, 0, 0, 1, 1, 2, 2])
    full = CandidateModel(Model.of(["profile_drag", "attached_lift"]), (), (), {})
    assert full.model.names == ("CD0", "CL0", "CLa")
    found = constants_of_manoeuvres(full, manoeuvre, ("airspeed", "alpha"), S, "CL")
    np.testing.assert_allclose(found.sum(axis=2), S[:, :, 1])
    for k in range(3):
        np.testing.assert_array_equal(found[manoeuvre == k, :, k], S[manoeuvre == k, :, 1])
        assert not found[manoeuvre != k, :, k].any()


@pytest.mark.verify
@pytest.mark.parametrize("compared", ["trajectories", "innovations"])
def test_a_channel_that_labels_manoeuvres_explains_no_offset_of_simulated_flights(compared, card):
    """Lift 0.06 larger in the second flight, flown with flaps that hardly move: the offset is reported, and no flap."""
    made = Parameter("CLstep", "1", 0.0, 0.0, "more lift", Prior("normal", 0.0, 1.0), (-1.0, 1.0))
    step = Effect(
        "lift_step", Kind.AERODYNAMICS, Stage.ATTACHED, "More lift.", (made,), ("alpha",),
        lambda v, s, a, known: {"CL_attached": v["CLstep"] + 0.0 * s["alpha"]},  # noqa: ARG005
        Example({"CLstep": 0.1}, {"alpha": 0.1}, {"CL_attached": 0.1}, "by hand"), "by hand",
    )  # fmt: skip
    records = []
    for k, (more, flap) in enumerate(((0.0, 0.0), (0.06, 0.2))):
        beyond = Beyond((step,), lambda _, more=more: {"CLstep": more})
        flight = hidden_records({}, seed=77, noise="white", seconds=30.0, beyond=beyond)[k]
        moved = {"flap": flap + 0.004 * np.sin(0.3 * np.asarray(flight.time) + k)}
        records.append(without_accelerometers(replace(flight, channels={**flight.channels, **moved})))
    found = diagnose(records, card, settings=DiagnosisSettings(gains=False, process_noise=compared == "innovations"))
    assert found.compared == compared
    assert not found.causes
    (told,) = found.unknown
    assert (told.coefficient, told.channel) == ("CL", "manoeuvre")
    ((size, sd),) = told.offsets.values()
    assert size == pytest.approx(0.06, abs=3.0 * sd)
    assert "flap_lift" in told.rivals


# A model flown with given parameters: the truth flies a simulated record, and a wrong derivative does not


def test_the_truth_flies_what_was_recorded_and_a_wrong_derivative_does_not(card):
    """One manoeuvre without noise or disturbance."""
    joined = join([simulate_stall(0, card=card, sensor_noise=0.0, disturbance=0.0)], card, FLIGHT)
    band = {"alpha": np.radians(2.0), "theta": np.radians(2.0)}
    (path,), (wrong,) = (
        fly_given(joined, Model.from_card(card), TRUTH | moved, band) for moved in ({}, {"Cma": 0.7 * TRUTH["Cma"]})
    )
    assert path.inside
    assert path.errors["alpha"].rms < np.radians(0.1)
    assert path.errors["airspeed"].rms < 0.3
    assert path.errors["alpha"].within == path.errors["theta"].within == 1.0
    assert path.errors["q"].tolerance is None
    assert wrong.errors["alpha"].rms > 10.0 * path.errors["alpha"].rms
    assert wrong.errors["alpha"].within < 0.9
    assert np.array_equal(path.measured["theta"], np.asarray(joined.channels["theta"]))
    worst = np.max(np.abs(path.measured["theta"] - path.simulated["theta"]))
    assert path.errors["theta"].largest == pytest.approx(worst)


# What trajectories alone have tested: errors against the noise of sensors, and the verdict that follows


@pytest.mark.parametrize(("noise", "fitted", "held_out", "beyond"), [
    (1.0, 1.0, np.nan, False), (1.0, 1.4143, np.nan, True), (0.0, 1e-9, np.nan, True), (1.0, np.nan, np.nan, True),
    (1.0, np.inf, np.nan, True),
    (1.0, 1.414, 9.0, False),  # the noise of the measured initial state is in what is unseen
])  # fmt: skip
def test_errors_are_beyond_noise_of_variance_one_and_as_much_again_of_another_origin(noise, fitted, held_out, beyond):
    assert OutputMiss(noise, fitted, held_out).beyond is beyond


@pytest.mark.parametrize(("left", "explained", "no_effect", "within_noise"), [
    ({"alpha": 1.0}, Verdict.EXPLAINED, Verdict.NO_EFFECT, True),
    ({"alpha": 3.0}, Verdict.PARTLY_EXPLAINED, Verdict.UNDECIDED, False),
    ({}, Verdict.PARTLY_EXPLAINED, Verdict.NO_EFFECT, None),
])  # fmt: skip
def test_errors_beyond_the_noise_decide_the_verdict(left, explained, no_effect, within_noise):
    tested = result.Tested({name: OutputMiss(1.0, x, x) for name, x in left.items()})
    assert verdict_of([cause()], (), tested) is explained
    assert verdict_of((), (), tested) is no_effect
    assert verdict_of([cause(confirmed=False)], (), tested) is Verdict.UNEXPLAINED
    assert part_of_errors(tested, result.TRAJECTORIES).within_noise is within_noise


def test_errors_are_judged_by_the_noise_that_the_card_states(card):
    """The extended model is off by a tenth of a degree: noise of 0.1 deg makes that, noise of 0.02 deg does not."""
    n = 400
    t = 0.05 * np.arange(n)
    smooth = {"airspeed": 100.0 + np.sin(t), "alpha": 0.05 + 0.02 * np.sin(0.5 * t)}
    record = FlightRecord.from_arrays("a", t, smooth)
    flown = halves(record)
    for sd, beyond in ((np.radians(0.1), False), (np.radians(0.02), True)):
        stated = replace(card, sensors={"alpha": sd, "airspeed": 0.3})
        found = beyond_noise(flown, [record], stated).outputs["alpha"]
        assert found.noise == pytest.approx(sd)
        assert found.fitted == pytest.approx(np.radians(0.1))
        assert found.beyond is beyond


# The log score on hold-out flights is a normal density in closed form, for segments of any length
LENGTHS = (90, 91)  # the halves of a manoeuvre with an odd number of samples


def test_log_scores_of_segments_of_different_length():
    rng = np.random.default_rng(1)
    missed, longest = [rng.standard_normal((n, 1)) for n in LENGTHS], max(LENGTHS)
    real = np.arange(longest) < np.array(LENGTHS)[:, None]
    flown = part(SegmentTrajectories, outputs=("q",), noise_growth=np.full((2, longest, 1), 2.0), inside=real)
    known = [{"measured": {"q": x[:, 0]}, "simulated": {"q": np.zeros(len(x))}} for x in missed]
    paths = [part(SimulatedManoeuvre, inside=True, **one) for one in known]
    expected = np.concatenate(missed)[:, 0] / 2.0
    density = norm.logpdf(expected, scale=np.sqrt(np.mean(expected**2)))
    for _ in range(20):  # the type checker looks at one element of a sequence, drawn at random
        found = hold_out.left_out_of(paths, flown, 1.0)
    assert found.densities().sum(axis=1) == pytest.approx(density)


# A lag of the separation point asked of trajectories: found where it is, not wanted where it is not


def asked(card, hidden, seed):
    """The card's model fitted to two stalls, and what is said of a lag beside it."""
    model = Model.from_card(card)
    flights, fit, noise = fitted_to_stalls(card, model, hidden, seed)
    full = candidate_model(model, flights)
    plain, effect = hold_out.CandidateFit("extended", fit), full.lag
    wider = replace(model.extended(), fixed=())
    lagged, lag = hold_out.with_lag(wider, effect, plain, noise)
    if not lag.gains:
        return lag, lagged
    silent = {c.name: {0: {}, 1: {}} for c in (plain, lagged)}
    fits: dict[str, list] = {"extended": [], "lagged": []}
    for name, found in hold_out.left_out((plain, lagged), silent, noise):
        fits[name].append(found)
    paths = [hold_out.holdout_fits(c, fits[c.name], {}) for c in (plain, lagged)]
    without, within = (hold_out.left_out_of(one, fit.flown, noise.variance_inflation) for one in paths)
    return hold_out.confirmed(lag, without, within), lagged


@pytest.mark.parametrize("broken", [lambda *_: np.float64(1e300) * 1e300, lambda *_: np.linalg.inv(np.zeros((2, 2)))])
def test_a_lag_whose_fit_breaks_down_is_a_failure_and_not_no_lag(monkeypatch, broken):
    fit = Mock(names=(), estimate=(), status=OutputErrorStatus.CONVERGED)
    for name, given in {
        "join": None, "despiked": (None, {}), "aircraft_dynamics": None, "in_windows": fit, "candidate_model": None,
        "without_lags": None, "_first_state": None, "plausible_selection": "without a lag", "lacking": (),
        "too_few_windows": "",
    }.items():  # fmt: skip
        where = next(m for m in (searches, searches.selection, searches.selection_state) if hasattr(m, name))
        monkeypatch.setattr(where, name, lambda *_, given=given, **__: given)

    def ended(_, found, *rest):
        raise SearchedError(found, rest[-1])

    monkeypatch.setattr(searches, "_with_lag", broken)
    monkeypatch.setattr(searches.Search, "_inside", lambda _, fit: fit)
    monkeypatch.setattr(searches.Search, "_with_terms", ended)
    search = part(
        searches.Search, records=(), card=None, model=None, extra=(), settings=None, seed=0, progress=lambda *_: None
    )
    with pytest.raises(SearchedError) as ending:
        search.trajectories()
    found, failures = ending.value.args
    assert found == "without a lag"
    assert [told.split(":")[0] for told in failures] == ["Whether the separation point lags was not tested"]


@pytest.mark.verify
def test_a_hidden_lag_is_kept_and_measured(card):
    """Eight to sixteen chords: half a second and more in the stall."""
    tau1 = np.random.default_rng(SEED).uniform(8.0, 16.0)
    lag, lagged = asked(card, {"separation_lag": {"tau1": tau1}}, SEED)
    assert lag.effect == "separation_lag"
    assert lag.kept, lag
    found = dict(zip(lagged.fit.names, lagged.fit.estimate, strict=True))
    assert found["tau2"] >= 0.0
    assert found["tau1"] == pytest.approx(tau1, rel=0.2)


@pytest.mark.recovery
def test_a_lag_is_not_wanted_where_the_hysteresis_is_quasi_steady(card):
    assert not asked(card, {}, SEED + 1)[0].kept


@pytest.mark.parametrize(("gain", "flyable", "kept"), [(9.0, True, True), (1.0, True, False), (9.0, False, False)])
def test_a_lag_is_kept_where_held_out_flights_are_predicted_worse_without(gain, flyable, kept):
    lagged = Mock(spec=LeftOut, flyable=flyable, gain=lambda _: (gain, 1.0))
    found = hold_out.confirmed(LagTest("separation_lag", 5.0), Mock(spec=LeftOut), lagged)
    assert found.kept is kept
    assert found.unseen == (gain, 1.0)


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
    unusable = {"status": MleStatus.NOT_CONVERGED, "converged": False, "at_bound": ("CLa",), "held": ("CLa",)}
    assert [fit_disagreements(*fits(**{name: x})) for name, x in unusable.items()] == [()] * 4
    assert disagreement_sentences(()) == []
    disagree, failed = fit_disagreements(*fits()), with_process_noise((4.33, 0.05), converged=False)
    assert settled_sentences(disagree, failed, (), disputed=False) == []
    assert settled_sentences((), failed, (), disputed=True) == []


def with_process_noise(CLa: tuple[float, float], *, converged: bool = True) -> Mock:
    return Mock(spec=ProcessNoise, estimates={"CLa": CLa}, converged=converged, preferred=converged)


@pytest.mark.parametrize(("CLa", "apart", "said"), [
    ((4.33, 0.05), (), "CLa agrees with the coefficients (CLa 4.330 ± 0.050). Prefer the estimates with process noise"),
    ((3.4, 0.05), ("CLa",), "CLa still differs from the coefficients (CLa 3.400 ± 0.050): the model lacks"),
])  # fmt: skip
def test_the_filter_decides_between_two_fits_that_disagree(CLa, apart, said):
    disagree, filtered = fit_disagreements(*fits()), with_process_noise(CLa)
    assert still_apart(disagree, filtered) == apart
    (told,) = settled_sentences(disagree, filtered, apart, disputed=True)
    assert said in told
    assert told.startswith("The coefficients and output error disagree on CLa.")
    (short,) = settled_sentences(disagree, filtered, apart, disputed=False)
    assert said in short
    assert "no-process-noise" not in short


# The causes in a band of frequencies: the truth of a simulated flight, and a size that the band does not confirm
@pytest.fixture(scope="module")
def hidden(card):
    effects, flights = flyable(["alpha_dot_moment"], seed=2, noise="ar1", seconds=90.0)
    return effects["alpha_dot_moment"]["Cmadot"], diagnose(
        [f.record for f in flights], card, settings=DiagnosisSettings(gains=False)
    )


def test_the_band_is_that_of_the_motion_and_gives_the_size_that_was_hidden(hidden):
    shown = causes_in_band(hidden[1])
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
    shown = causes_in_band(replace(found, causes=(replace(cause, parameters={"Cmadot": off}),)))
    assert shown.sizes[0].apart > 3.0
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
def linear():
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


def test_modes_without_a_known_sign_an_error_or_a_converged_fit(linear):
    assert flown_mode("spiral", 0.01 + 0.0j, np.diag([1e-4, 0.0])).quantities == {}
    fit = linear.fit
    (mode,) = flown_modes(replace(fit, undetermined=("Mq",)), Steady(1.0, 0.0))
    assert math.isinf(mode.quantities["period"][1])
    assert math.isinf(mode.quantities["damping_ratio"][1])
    assert math.isinf(flown_mode("Dutch roll", 0.1 + 1.0j, np.full((2, 2), np.inf)).quantities["damping_ratio"][1])
    (same,) = flown_modes(replace(fit, undetermined=("az0",)), Steady(1.0, 0.0))
    assert math.isfinite(same.quantities["period"][1])
    assert motion_of(replace(linear, fit=replace(linear.fit, status=OutputErrorStatus.NOT_CONVERGED))) is None
    assert math.isnan(motion_of(linear).airspeed)  # of a linear card


def test_modes_spread_as_draws_of_the_parameters_of_the_better_fit(linear):
    """Linear short period: eigenvalues in closed form, of draws from the covariance of the estimates."""
    (mode,) = flown_modes(linear.fit, Steady(1.0, 0.0))
    names = list(linear.fit.names)
    draws = np.random.default_rng(2).multivariate_normal(linear.fit.estimate, linear.fit.corrected, 20000).T
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
    changed = {"Zalpha": (-1.3, 0.0), "Mq": (-1.1, 0.04), "Malpha": (-9.0, 0.2)}
    known = {n: (float(x), 0.0) for n, x in zip(linear.fit.names, linear.fit.estimate, strict=True)} | changed
    known = dict(reversed(known.items()))  # in another order
    covariance = np.diag([sd**2 for _, sd in known.values()])
    beside = Mock(spec=ProcessNoise, preferred=True, estimates=known, covariance=covariance)
    moved = motion_of(linear, beside)
    assert moved.filtered
    (mode,) = moved.modes
    w = np.sqrt(1.3 * 1.1 + 9.0 - 1.2**2)
    assert mode.eigenvalue == pytest.approx(-1.2 + 1j * w)
    slopes = np.array([(-1.3 + 1.2) / (2.0 * w), -1.0 / (2.0 * w)])  # of w by Mq and Malpha
    assert mode.sd == pytest.approx((0.02, float(np.hypot(*(slopes * [0.04, 0.2])))), rel=1e-3)
    worse = motion_of(linear, Mock(spec=ProcessNoise, preferred=False))
    assert (worse.filtered, worse.modes) == (False, motion_of(linear).modes)


# A flight in gusts, by a simulator that shares no code: the filter finds the gusts, and the search what is hidden
Cma2, GUSTS_SEED = -3.0, 5  # Cma2, 1/rad2


@pytest.fixture(scope="module")
def in_gusts():
    """A minute in gusts, of an aircraft with a curved moment; its flaps stay where they are."""
    flight = gusty_flight(GUSTS_SEED, truth={"Cma2": Cma2})
    return replace(flight, channels={**flight.channels, "flap": np.full(len(flight.time), 0.1)})


@pytest.fixture(scope="module")
def found(in_gusts, hfb320):
    """The search, and the fit that it began with."""
    fits, fit = [], searches.fit_disturbed
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(searches, "fit_disturbed", lambda *a, **k: fits.append(fit(*a, **k)) or fits[-1])
        settings = DiagnosisSettings(max_effects=3)
        result = searches.Search([in_gusts], hfb320, Model.from_card(hfb320), (), settings, 0).innovations()
    return result, fits[0][1]


def test_gusts_and_the_hidden_effect_are_found_beside_what_is_on_the_card(found):
    searched, fit = found
    known = dict(zip(fit.names, zip(fit.estimate, fit.sd, strict=True), strict=True))
    for name, truth in (("vertical_gust", GUST["w"]), ("longitudinal_gust", GUST["u"])):
        estimate, sd = known[name]
        assert abs(estimate - truth) < 3.0 * sd
        assert sd < 0.4 * truth
        length, length_sd = known[f"{name}_length"]
        assert abs(length - LENGTH) < 3.0 * length_sd
    # Derivatives of flaps at rest would share the coefficients' constants.
    gusts = {n for name in GUSTS for n in (name, f"{name}_length")}
    own = {p.name for p in Model.from_card(read_card("hfb320")).free}
    assert "flap_lift" in searched.full.not_testable
    assert set(fit.names) == own | gusts
    # Correlation of neighbouring samples within 4 / sqrt(n), n of them.
    noise = searched.noise
    assert noise.of_innovations
    assert max(abs(r) for r in noise.lag1.values()) < 4.0 / np.sqrt(SECONDS / DT)
    assert noise.coloured == ()
    assert list(searched.stages) == [INNOVATIONS]
    assert searched.model.steps[0].chosen == "alpha_squared_moment"
    size = searched.model.sizes["Cma2"]
    assert abs(size.mean - Cma2) < 3.0 * size.sd
    assert size.sd < 0.2 * abs(Cma2)
    for name in ("CLa", "CDa", "Cmq", "Cmde"):
        size = searched.model.sizes[name]
        assert abs(size.mean - GUSTY_TRUTH[name]) < 4.0 * size.sd, name


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
    found = diagnose(records, card, settings=DiagnosisSettings(max_effects=2, process_noise=True, gains=False))
    truth = {"rudder_yaw": ("Cndr", plane.Cndr), "sideslip_scale": ("sideslip_scale", seen - 1.0)}
    assert [c.name for c in found.causes] == [hidden] * (hidden is not None)
    assert not found.unknown
    for one in found.causes:
        name, true = truth[one.name]
        size = one.parameters[name]
        assert abs(size.mean - true) < 3.0 * size.sd


@pytest.mark.parametrize(("lag", "found", "verdict"), [
    (0.02, Verdict.EXPLAINED, Verdict.EXPLAINED), (0.86, Verdict.EXPLAINED, Verdict.PARTLY_EXPLAINED),
    (0.86, Verdict.NO_EFFECT, Verdict.UNDECIDED), (-0.5, Verdict.NO_EFFECT, Verdict.UNDECIDED),
    (0.86, Verdict.UNEXPLAINED, Verdict.UNEXPLAINED),
])  # fmt: skip
def test_coloured_innovations_leave_the_error_unexplained(lag, found, verdict):
    noise = NoiseReport({"alpha": lag, "q": 0.0}, {}, {"alpha": 1.0, "q": 1.0}, {}, of_innovations=True)
    causes = {Verdict.EXPLAINED: [cause()], Verdict.NO_EFFECT: [], Verdict.UNEXPLAINED: [cause(confirmed=False)]}
    assert verdict_of(causes[found], (), noise=noise) is verdict
    assert verdict_of(causes[found], (), noise=replace(noise, of_innovations=False)) is found


# Process noise is estimated where a record is in gusts, unless the user decides
OUTPUTS = "airspeed,alpha,theta,q,ax,az"
CALM, GUSTY = {"w": 0.0, "u": 0.0}, {"w": 1.0, "u": 1.0}


@pytest.fixture(scope="module")
def hfb320():
    return read_card("hfb320")


class SearchedError(Exception):
    """Ends the diagnosis where its search begins."""


@pytest.mark.parametrize(("gust", "given", "expected"), [
    (GUSTY, None, True), (CALM, None, False), (GUSTY, False, False), (CALM, True, True),
])  # fmt: skip
def test_process_noise_is_estimated_in_gusts_unless_the_user_decides(hfb320, monkeypatch, gust, given, expected):
    records, filtered = [gusty_flight(4, gust=gust, seconds=20.0)], []

    def begun(name):
        def search(*_, **__):
            raise SearchedError(name)

        return search

    for name in ("innovations", "coefficients", "trajectories"):
        monkeypatch.setattr(searches.Search, name, begun(name))
    with pytest.raises(SearchedError) as found:
        diagnose(records, hfb320, settings=DiagnosisSettings(process_noise=given))
    assert (str(found.value) == "innovations") is expected

    monkeypatch.setattr(job, "with_process_noise", lambda *_: filtered.append(True))
    flown = job.fly(records, hfb320, process_noise=given, outputs=OUTPUTS)
    assert filtered == [True] * expected
    told = flown.sentences[0].startswith("The flight path alone, without aerodynamics, shows gusts")
    assert told is (expected and given is None)
