"""Models flown along records by simulation, their errors on hold-out flights, and other fits of the same record."""

import math
from dataclasses import replace
from types import SimpleNamespace
from unittest.mock import Mock

import numpy as np
import pytest
from gusty_flight import gusty_flight
from linear_cards import SHORT_PERIOD, SHORT_PERIOD_TRUTH, card_of, record_of, short_period_flight
from parts import cause, part, without_accelerometers
from simulated_halves import halves

from bayes_aero.diagnosis import result
from bayes_aero.diagnosis import search as searches
from bayes_aero.diagnosis import trajectories as hold_out
from bayes_aero.diagnosis.diagnose import diagnose
from bayes_aero.diagnosis.result import (
    Diagnosis,
    LagTest,
    NoiseReport,
    OutputMiss,
    ProcessNoise,
    TrajectoryFit,
    Verdict,
    verdict_of,
)
from bayes_aero.diagnosis.selection import Extension, LeftOut
from bayes_aero.diagnosis.selection_state import (
    CandidateModel,
    DiagnosisSettings,
    SelectionState,
    candidate_model,
    constants_of_manoeuvres,
)
from bayes_aero.dynamics.flight import aircraft_dynamics
from bayes_aero.dynamics.trim import Steady
from bayes_aero.effects import CATALOGUE
from bayes_aero.flight.card import read_card
from bayes_aero.flight.record import FlightRecord
from bayes_aero.inference.results import MleResult, MleStatus, OutputErrorStatus
from bayes_aero.jobs import fly as job
from bayes_aero.jobs.fly import fly
from bayes_aero.jobs.results import part_of_errors
from bayes_aero.model.model import Model
from bayes_aero.model.observations import despiked, join
from bayes_aero.physics.aircraft import FLIGHT
from bayes_aero.report.pages.fly import disagreement_sentences
from bayes_aero.report.pages.trajectories import settled_sentences
from bayes_aero.simulate.demo import TRUTH, simulate_stall
from bayes_aero.simulate.injection import hidden_records

# The simulation of hold-out flights before and after the extension, and with a lag of the separation point
SEED = 4132
BANDS = {"airspeed": 1.5, "alpha": 0.035, "theta": 0.035}
NOBODY = {0: {}, 1: {}}


def compared(card, hidden, causes, *, begin=20.0, end=60.0):
    """Two stalls that hide something, flown with these causes and, beside them, a lag; and what was asked of each."""
    records = [r.window(begin, end) for r in hidden_records(hidden, seed=SEED, seconds=90.0)]
    flights = despiked(join(records, card))[0]
    full = candidate_model(Model.from_card(card), flights)
    state = part(SelectionState, full=full, theta=full.vector({n: x for n, x in TRUTH.items() if n in full.neutral}))
    searched = part(Extension, base=state, state=state)
    asked, eliminate = [], hold_out.eliminate
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(result, "WINDOW", end)  # near enough to need no shorter ones
        patch.setattr(hold_out, "open_lag", lambda whole, *_: whole.lag)
        patch.setattr(hold_out, "eliminate", lambda *given: asked.append(given) or eliminate(*given))
        diagnosis = part(Diagnosis, causes=tuple(map(cause, causes)), aerodynamics=searched)
        return hold_out.compare_trajectories(flights, diagnosis, BANDS), asked[0]


@pytest.fixture(scope="module")
def flown(card):
    """A thrust line 0.6 m from where the card has it, and drag that no flight has."""
    return compared(card, {"thrust_moment": {"thrust_arm": 0.6}}, ("thrust_moment", "drag_offset"))


@pytest.mark.recovery
def test_the_simulation_gains_on_other_flights_and_gives_the_arm_back(flown):
    paths, _ = flown
    assert {p.split for p in paths.paths} == {"fitted", "hold_out"}
    for manoeuvre in {p.manoeuvre for p in paths.paths}:
        before, after = (paths.path(manoeuvre, model, "hold_out") for model in ("card", "extended"))
        assert after.inside
        for name in ("airspeed", "theta"):
            assert after.errors[name].rms < 0.6 * before.errors[name].rms, (manoeuvre, name)
        for name, error in after.errors.items():
            residual = after.measured[name] - after.simulated[name]
            assert error.rms == pytest.approx(np.sqrt(np.mean(residual**2)))
            assert error.largest == pytest.approx(np.abs(residual).max())
            if name in BANDS:
                assert error.within == pytest.approx(np.mean(np.abs(residual) <= BANDS[name]))
                assert 0.0 <= error.probability <= 1.0
    near = max(0.06, 4.0 * paths.deviation["thrust_arm"])
    assert paths.extended.values["thrust_arm"] == pytest.approx(0.6, abs=near)
    assert paths.card.values["thrust_arm"] == 0.0
    assert paths.variance_inflation >= 1.0
    assert not paths.lag.kept  # the hysteresis that was flown is quasi-steady


@pytest.mark.recovery
def test_what_was_flown_stays_and_first_order_tells_what_refitting_finds(flown):
    paths, (contender, fits, _, silent, noise, *_) = flown
    assert paths.asked.kept == ("thrust_moment",)
    assert paths.out == ("drag_offset",)
    assert "CLmin" not in paths.extended.values
    estimated = hold_out.eliminate(contender, fits, [CATALOGUE["thrust_moment"]], silent, noise)
    told = estimated.confirmation.missed["thrust_moment"]
    less = replace(contender, held={"thrust_arm": 0.0})
    again = [fit for _, fit in hold_out.left_out([less], {less.name: silent}, noise)]
    flights = [hold_out.holdout_fits(c, own, {}) for c, own in ((contender, fits), (less, again))]
    within, without = (hold_out.left_out_of(one, contender.fit.flown, noise.variance_inflation) for one in flights)
    assert told == pytest.approx(within.gain(without), rel=0.5)
    assert told[0] == pytest.approx(within.gain(without)[0], rel=0.3)
    # What a manoeuvre does not identify is not tested; what is neutral at infinity is.
    held = hold_out.eliminate(contender, fits, [CATALOGUE["drag_offset"]], {0: {"CLmin": 0.1}, 1: {}}, noise)
    assert not held.confirmation.missed
    assert not held.gone
    assert held.fits is fits
    induced = hold_out.eliminate(contender, fits, [CATALOGUE["induced_drag"]], NOBODY, noise).confirmation
    assert induced.kept == ("induced_drag",)
    assert np.all(np.isfinite(induced.missed["induced_drag"]))


@pytest.mark.verify
def test_a_hidden_lag_is_kept_and_measured(card):
    """Eight to sixteen chords: half a second and more in the stall."""
    tau1 = np.random.default_rng(SEED).uniform(8.0, 16.0)
    paths, _ = compared(card, {"separation_lag": {"tau1": tau1}}, (), begin=0.0, end=90.0)
    assert paths.lag.effect == "separation_lag"
    assert paths.lag.kept, paths.lag
    assert paths.extended.values["tau2"] >= 0.0
    assert paths.extended.values["tau1"] == pytest.approx(tau1, rel=0.2)


@pytest.mark.parametrize(("gain", "flyable", "kept"), [(9.0, True, True), (1.0, True, False), (9.0, False, False)])
def test_a_lag_is_kept_where_held_out_flights_are_predicted_worse_without(gain, flyable, kept):
    lagged = Mock(spec=LeftOut, flyable=flyable, gain=lambda _: (gain, 1.0))
    tested = hold_out.confirmed(LagTest("separation_lag", 5.0), Mock(spec=LeftOut), lagged)
    assert tested.kept is kept
    assert tested.unseen == (gain, 1.0)


class SearchedError(Exception):
    """Ends the diagnosis where its search begins, or ends."""


@pytest.mark.parametrize("broken", [lambda *_: np.float64(1e300) * 1e300, lambda *_: np.linalg.inv(np.zeros((2, 2)))])
def test_a_lag_whose_fit_breaks_down_is_a_failure_and_not_no_lag(monkeypatch, broken):
    fit = Mock(names=(), estimate=(), status=OutputErrorStatus.CONVERGED)
    for name, given in {
        "join": None, "despiked": (None, {}), "aircraft_dynamics": None, "in_windows": fit, "candidate_model": None,
        "without_lags": None, "_first_state": None, "plausible_selection": "without a lag", "lacking": (),
        "too_few_windows": "", "_with_lag": broken,
    }.items():  # fmt: skip
        where = next(m for m in (searches, searches.selection, searches.selection_state) if hasattr(m, name))
        monkeypatch.setattr(where, name, given if name == "_with_lag" else lambda *_, given=given, **__: given)
    ended = Mock(side_effect=SearchedError)
    monkeypatch.setattr(searches.Search, "_with_terms", ended)
    monkeypatch.setattr(searches.Search, "_inside", lambda _, fit: fit)
    given = dict.fromkeys(("card", "model", "settings")) | {"progress": lambda *_: None}
    with pytest.raises(SearchedError):
        part(searches.Search, records=(), extra=(), seed=0, **given).trajectories()
    extension, *_, failures = ended.call_args.args
    assert extension == "without a lag"
    assert [said.split(":")[0] for said in failures] == ["Whether the separation point lags was not tested"]


@pytest.mark.verify
def test_a_fit_that_strays_in_long_windows_is_begun_in_shorter_ones(card):
    """This flight, begun in windows of 10 s, ends at tau2 = -50 and a1 = 10, and leaves the envelope."""
    records = [without_accelerometers(r) for r in hidden_records({}, seed=8930, seconds=90.0, noise="ar1")]
    flights, _ = despiked(join(records, card, FLIGHT))
    fit = searches.in_windows(flights, aircraft_dynamics(Model.from_card(card), flights))
    assert fit.status is OutputErrorStatus.CONVERGED
    estimates = dict(zip(fit.names, fit.estimate, strict=True))
    assert estimates["alpha_star"] == pytest.approx(TRUTH["alpha_star"], abs=0.01)
    assert estimates["tau2"] == pytest.approx(TRUTH["tau2"], rel=0.3)
    assert estimates["a1"] == pytest.approx(TRUTH["a1"], rel=0.3)


def test_an_offset_of_a_coefficient_in_one_manoeuvre_is_its_constant_there():
    """Flown outputs to CL0, manoeuvre by manoeuvre: the constants add up to the model's own."""
    rng = np.random.default_rng(0)
    S, manoeuvre = rng.standard_normal((7, 2, 3)), np.array([0, 0, 0, 1, 1, 2, 2])
    full = CandidateModel(Model.of(["profile_drag", "attached_lift"]), (), (), {})
    assert full.model.names == ("CD0", "CL0", "CLa")
    constants = constants_of_manoeuvres(full, manoeuvre, ("airspeed", "alpha"), S, "CL")
    np.testing.assert_allclose(constants.sum(axis=2), S[:, :, 1])
    for k in range(3):
        np.testing.assert_array_equal(constants[manoeuvre == k, :, k], S[manoeuvre == k, :, 1])
        assert not constants[manoeuvre != k, :, k].any()


def test_the_truth_flies_what_was_recorded_and_a_wrong_derivative_does_not(card):
    """One manoeuvre without noise or disturbance."""
    record = simulate_stall(0, card=card, sensor_noise=0.0, disturbance=0.0)
    flights, band = join([record], card, FLIGHT), {"alpha": np.radians(2.0), "theta": np.radians(2.0)}
    (path,), (wrong,) = (
        hold_out.fly_given(flights, Model.from_card(card), TRUTH | moved, band)
        for moved in ({}, {"Cma": 0.7 * TRUTH["Cma"]})
    )
    assert path.inside
    assert path.errors["alpha"].rms < np.radians(0.1)
    assert path.errors["airspeed"].rms < 0.3
    assert path.errors["alpha"].within == path.errors["theta"].within == 1.0
    assert path.errors["q"].tolerance is None
    assert wrong.errors["alpha"].rms > 10.0 * path.errors["alpha"].rms
    assert wrong.errors["alpha"].within < 0.9
    assert np.array_equal(path.measured["theta"], record["theta"])


# What trajectories alone have tested: errors against the noise of sensors, and the verdict that follows
@pytest.mark.parametrize(("noise", "fitted", "held_out", "beyond"), [
    (1.0, 1.0, np.nan, False), (1.0, 1.4143, np.nan, True), (0.0, 1e-9, np.nan, True), (1.0, np.nan, np.nan, True),
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


def test_errors_are_judged_by_the_noise_that_the_card_states(card):
    """The extended model is off by a tenth of a degree: noise of 0.1 deg makes that, noise of 0.02 deg does not."""
    t = 0.05 * np.arange(400)
    smooth = {"airspeed": 100.0 + np.sin(t), "alpha": 0.05 + 0.02 * np.sin(0.5 * t)}
    record = FlightRecord.from_arrays("a", t, smooth)
    for sd, beyond in ((np.radians(0.1), False), (np.radians(0.02), True)):
        stated = replace(card, sensors={"alpha": sd, "airspeed": 0.3})
        missed = hold_out.beyond_noise(halves(record), [record], stated).outputs["alpha"]
        assert missed.noise == pytest.approx(sd)
        assert missed.fitted == pytest.approx(np.radians(0.1))
        assert missed.beyond is beyond


@pytest.mark.parametrize(("gust", "given", "expected"), [
    (1.0, None, True), (0.0, None, False), (1.0, False, False), (0.0, True, True),
])  # fmt: skip
def test_process_noise_is_estimated_in_gusts_unless_the_user_decides(monkeypatch, gust, given, expected):
    for name in ("innovations", "coefficients", "trajectories"):
        monkeypatch.setattr(searches.Search, name, Mock(side_effect=SearchedError(name)))
    records = [gusty_flight(4, gust={"w": gust, "u": gust}, seconds=20.0)]
    with pytest.raises(SearchedError) as begun:
        diagnose(records, read_card("hfb320"), settings=DiagnosisSettings(process_noise=given))
    assert (str(begun.value) == "innovations") is expected
    filtered = []
    monkeypatch.setattr(job, "with_process_noise", lambda *_: filtered.append(True))
    outputs = "airspeed,alpha,theta,q,ax,az"
    first, *_ = job.fly(records, read_card("hfb320"), process_noise=given, outputs=outputs).sentences
    assert filtered == [True] * expected
    shown = first.startswith("The flight path alone, without aerodynamics, shows gusts")
    assert shown is (expected and given is None)


# Coefficients and trajectories of the same record: told where they differ beyond what both intervals allow
def fits(status=MleStatus.CONVERGED, converged=True, at_bound=(), held=()):
    """Of the HFB-320: CLa differs, Cmq not so much; CD0 is in one of them alone."""
    mle = Mock(
        spec=MleResult, status=status, names=("CLa", "Cmq", "CD0"), estimate=np.array([4.34, -35.2, 0.03]),
        crb_corrected=np.array([0.14, 3.0, 0.001]), at_bound=(),
    )  # fmt: skip
    fit = SimpleNamespace(
        parameters=[SimpleNamespace(name=name, unit="1/rad") for name in ("CLa", "Cmq")], at_bound=at_bound,
        estimate=np.array([3.37, -25.3]), sd_corrected=np.array([0.15, 2.0]), held_by_prior=held,
    )  # fmt: skip
    return mle, Mock(spec=TrajectoryFit, fit=fit, converged=converged)


def test_what_differs_beyond_both_intervals_is_told_and_the_filter_decides():
    (apart,) = hold_out.fit_disagreements(*fits())
    assert (apart.name, apart.coefficients, apart.trajectories) == ("CLa", (4.34, 0.14), (3.37, 0.15))
    assert apart.apart == pytest.approx(0.97 / np.hypot(0.14, 0.15))
    unusable = {"status": MleStatus.NOT_CONVERGED, "converged": False, "at_bound": ("CLa",), "held": ("CLa",)}
    assert [hold_out.fit_disagreements(*fits(**{name: x})) for name, x in unusable.items()] == [()] * 4
    for CLa, still in ((4.33, ()), (3.4, ("CLa",))):
        filtered = Mock(spec=ProcessNoise, estimates={"CLa": (CLa, 0.05)}, preferred=True, converged=True)
        assert hold_out.still_apart([apart], filtered) == still
        (sentence,) = settled_sentences([apart], filtered, still, disputed=True)
        assert sentence.startswith("The coefficients and output error disagree on CLa, ")
        assert ("the model lacks" if still else "Prefer the estimates with process noise") in sentence
    failed = Mock(spec=ProcessNoise, estimates={"CLa": (4.33, 0.05)}, preferred=False, converged=False)
    assert settled_sentences([apart], failed, (), disputed=False) == []
    assert "4.7 combined standard errors apart" in disagreement_sentences([apart])[0]


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
    mode = hold_out.flown_mode("some", value, covariance)
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
    assert hold_out.flown_mode("spiral", 0.01 + 0.0j, np.diag([1e-4, 0.0])).quantities == {}
    assert math.isinf(
        hold_out.flown_mode("Dutch roll", 0.1 + 1.0j, np.full((2, 2), np.inf)).quantities["damping_ratio"][1]
    )
    for undetermined, known in (("Mq", False), ("az0", True)):
        (mode,) = hold_out.flown_modes(replace(linear.fit, undetermined=(undetermined,)), Steady(1.0, 0.0))
        assert math.isfinite(mode.quantities["period"][1]) is known
        assert math.isfinite(mode.quantities["damping_ratio"][1]) is known
    assert hold_out.motion_of(replace(linear, fit=replace(linear.fit, status=OutputErrorStatus.NOT_CONVERGED))) is None
    assert math.isnan(hold_out.motion_of(linear).airspeed)  # of a linear card


def test_modes_spread_as_draws_of_the_parameters_of_the_better_fit(linear):
    """Linear short period: eigenvalues in closed form, of draws from the covariance of the estimates."""
    (mode,) = hold_out.flown_modes(linear.fit, Steady(1.0, 0.0))
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
    # Linear short period again, of the estimates and the covariance of a fit with process noise, in another order.
    changed = {"Zalpha": (-1.3, 0.0), "Mq": (-1.1, 0.04), "Malpha": (-9.0, 0.2)}
    estimates = {n: (float(x), 0.0) for n, x in zip(linear.fit.names, linear.fit.estimate, strict=True)} | changed
    estimates = dict(reversed(estimates.items()))
    covariance = np.diag([sd**2 for _, sd in estimates.values()])
    moved = hold_out.motion_of(
        linear, Mock(spec=ProcessNoise, preferred=True, estimates=estimates, covariance=covariance)
    )
    assert moved.filtered
    (mode,) = moved.modes
    w = np.sqrt(1.3 * 1.1 + 9.0 - 1.2**2)
    assert mode.eigenvalue == pytest.approx(-1.2 + 1j * w)
    slopes = np.array([(-1.3 + 1.2) / (2.0 * w), -1.0 / (2.0 * w)])  # of w by Mq and Malpha
    assert mode.sd == pytest.approx((0.02, float(np.hypot(*(slopes * [0.04, 0.2])))), rel=1e-3)
    worse = hold_out.motion_of(linear, Mock(spec=ProcessNoise, preferred=False))
    assert (worse.filtered, worse.modes) == (False, hold_out.motion_of(linear).modes)
