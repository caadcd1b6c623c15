"""Models flown along records: before and after the extension, fitted to trajectories alone, and asked of a lag."""

from dataclasses import replace
from unittest.mock import Mock

import numpy as np
import pytest
from parts import fitted_to_stalls, part
from scipy.stats import norm

from bayes_aero.diagnosis import result
from bayes_aero.diagnosis import search as searches
from bayes_aero.diagnosis.candidate_set import CandidateModel, candidate_model, lag_of
from bayes_aero.diagnosis.diagnose import diagnose
from bayes_aero.diagnosis.result import OutputMiss, Verdict, as_tested
from bayes_aero.diagnosis.screening.selection_state import constants_of_manoeuvres
from bayes_aero.diagnosis.search import in_windows
from bayes_aero.diagnosis.selection.forward_selection import Extension
from bayes_aero.diagnosis.trajectories.histories import fly_given
from bayes_aero.diagnosis.trajectories.holdout import (
    CandidateFit,
    confirmed,
    holdout_fits,
    left_out,
    left_out_of,
    with_lag,
)
from bayes_aero.diagnosis.trajectories.results import LagTest, SimulatedManoeuvre
from bayes_aero.diagnosis.trajectories.trajectories import beyond_noise, compare_trajectories
from bayes_aero.dynamics.flight import aircraft_dynamics
from bayes_aero.dynamics.segments import SegmentTrajectories
from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.flight.card import read_card
from bayes_aero.flight.record import FlightRecord
from bayes_aero.inference.output_error_result import OutputErrorStatus
from bayes_aero.jobs.io import diagnosis_json
from bayes_aero.model.joined_channels import despiked, join
from bayes_aero.model.model import Model
from bayes_aero.parameter import Parameter, Prior
from bayes_aero.physics.aircraft import FLIGHT
from bayes_aero.report.figures.diagnosis import autocorrelation, spectrum
from bayes_aero.simulate.demo import TRUTH, simulate_stall
from bayes_aero.simulate.injection import Beyond, hidden_records
from tests.simulated_halves import halves

# The simulation before and after the extension, and a fit to trajectories alone
SEED = 4132
BANDS = {"airspeed": 1.5, "alpha": 0.035, "theta": 0.035}


@pytest.fixture(scope="module")
def flown(card):
    """A thrust line 0.6 m from where the card has it: found from coefficients, then flown."""
    records = hidden_records({"thrust_moment": {"thrust_arm": 0.6}}, seed=SEED, seconds=90.0)
    found = diagnose(records, card, gains_wanted=False)
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
    _, paths = flown
    near = max(0.06, 4.0 * paths.deviation["thrust_arm"])
    assert paths.extended.values["thrust_arm"] == pytest.approx(0.6, abs=near), SEED
    assert paths.card.values["thrust_arm"] == 0.0
    assert paths.variance_inflation >= 1.0


@pytest.mark.verify
def test_an_attitude_off_in_one_flight_is_fitted_and_leaves_the_arm_alone(flown, card):
    """The second flight's gyro stands off by a constant that the card allows for."""
    rng = np.random.default_rng(SEED)
    off = rng.uniform(0.006, 0.012) * rng.choice([-1.0, 1.0])
    found, plain = flown
    records = hidden_records({"thrust_moment": {"thrust_arm": 0.6}}, seed=SEED, seconds=90.0)
    flights = despiked(join(records, card))[0]
    theta = flights.channels["theta"] + np.where(np.asarray(flights.manoeuvre) == 1, off, 0.0)
    flights = replace(flights, channels={**flights.channels, "theta": theta})
    free = compare_trajectories(flights, found, {}, biases={"theta": Prior("normal", 0.0, 0.01)})
    apart = free.extended.values["bias_theta_2"] - free.extended.values["bias_theta_1"]
    assert apart == pytest.approx(off, abs=0.002), SEED
    near = max(0.06, 4.0 * free.deviation["thrust_arm"])
    assert free.extended.values["thrust_arm"] == pytest.approx(plain.extended.values["thrust_arm"], abs=near), SEED
    assert "bias_theta_2" not in plain.extended.values
    unseen = free.path(flights.names[1], "extended", "hold_out").errors["theta"]
    assert unseen.rms > 0.7 * abs(off)  # compared with the record as it is


def _without_accelerometers(record: FlightRecord) -> FlightRecord:
    kept = {name: x for name, x in record.channels.items() if name not in ("ax", "ay", "az")}
    return FlightRecord.from_arrays(record.name, record.time, kept)


@pytest.mark.recovery
def test_a_fit_that_strays_in_long_windows_is_begun_in_shorter_ones(card):
    """This flight, begun in windows of 10 s, ends at tau2 = -50 and a1 = 10, and leaves the envelope."""
    records = hidden_records({}, seed=8930, seconds=90.0, noise="ar1")
    flights, _ = despiked(join([_without_accelerometers(r) for r in records], card, FLIGHT))
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
        channels = {n: np.asarray(x) for n, x in flight.channels.items() if n not in ("ax", "ay", "az")}
        channels["flap"] = flap + 0.004 * np.sin(0.3 * np.asarray(flight.time) + k)
        records.append(FlightRecord.from_arrays(flight.name, np.asarray(flight.time), channels, "simulated"))
    found = diagnose(records, card, gains_wanted=False, process_noise=compared == "innovations")
    assert found.compared == compared
    assert not found.causes
    (told,) = found.unknown
    assert (told.coefficient, told.channel) == ("CL", "manoeuvre")
    ((size, sd),) = told.offsets.values()
    assert size == pytest.approx(0.06, abs=3.0 * sd)
    assert "flap_lift" in told.rivals


# A model flown with given parameters: the truth flies a simulated record, and a wrong derivative does not
BAND = {"alpha": np.radians(2.0), "theta": np.radians(2.0)}


@pytest.fixture(scope="module")
def flights():
    """One manoeuvre without noise or disturbance."""
    card = read_card("attas")
    return card, join([simulate_stall(0, card=card, sensor_noise=0.0, disturbance=0.0)], card, FLIGHT)


def flown_with(flights, **changed):
    card, joined = flights
    (path,) = fly_given(joined, Model.from_card(card), {**TRUTH, **changed}, BAND)
    return path


def test_the_truth_flies_what_was_recorded_and_a_wrong_derivative_does_not(flights):
    path = flown_with(flights)
    assert path.inside
    assert path.errors["alpha"].rms < np.radians(0.1)
    assert path.errors["airspeed"].rms < 0.3
    assert path.errors["alpha"].within == path.errors["theta"].within == 1.0
    assert path.errors["q"].tolerance is None
    right, wrong = flown_with(flights), flown_with(flights, Cma=0.7 * TRUTH["Cma"])
    assert wrong.errors["alpha"].rms > 10.0 * right.errors["alpha"].rms
    assert wrong.errors["alpha"].within < 0.9
    joined = flights[1]
    assert np.array_equal(path.measured["theta"], np.asarray(joined.channels["theta"]))
    worst = np.max(np.abs(path.measured["theta"] - path.simulated["theta"]))
    assert path.errors["theta"].largest == pytest.approx(worst)


# What trajectories alone have tested: errors against the noise of sensors, and the verdict that follows
DEG = np.pi / 180.0
NAN = float("nan")


def test_errors_beyond_the_noise_decide_the_verdict():
    """Noise of variance 1 and as much again of another origin: root mean square sqrt(2)."""
    assert not OutputMiss(1.0, 1.0, NAN).beyond
    assert not OutputMiss(1.0, 1.414, 9.0).beyond  # the noise of the measured initial state is in what is unseen
    assert OutputMiss(1.0, 1.4143, NAN).beyond
    assert OutputMiss(0.0, 1e-9, NAN).beyond
    assert OutputMiss(1.0, NAN, NAN).beyond
    assert OutputMiss(1.0, np.inf, NAN).beyond
    noise, more = (result.Tested({"alpha": OutputMiss(1.0, x, x)}) for x in (1.0, 3.0))
    never = result.Tested({})
    assert [as_tested(Verdict.EXPLAINED, t) for t in (noise, more, never)] == [
        Verdict.EXPLAINED, Verdict.PARTLY_EXPLAINED, Verdict.PARTLY_EXPLAINED,
    ]  # fmt: skip
    assert [as_tested(Verdict.NO_EFFECT, t) for t in (noise, more, never)] == [
        Verdict.NO_EFFECT, Verdict.UNDECIDED, Verdict.NO_EFFECT,
    ]  # fmt: skip
    assert as_tested(Verdict.UNEXPLAINED, noise) is Verdict.UNEXPLAINED
    assert [diagnosis_json.tested_results(t, result.TRAJECTORIES)["within_noise"] for t in (noise, more, never)] == [
        True,
        False,
        None,
    ]


def test_errors_are_judged_by_the_noise_that_the_card_states(card):
    """The extended model is off by a tenth of a degree: noise of 0.1 deg makes that, noise of 0.02 deg does not."""
    n = 400
    t = 0.05 * np.arange(n)
    smooth = {"airspeed": 100.0 + np.sin(t), "alpha": 0.05 + 0.02 * np.sin(0.5 * t)}
    record = FlightRecord.from_arrays("a", t, smooth)
    flown = halves(record)
    for sd, beyond in ((0.1 * DEG, False), (0.02 * DEG, True)):
        stated = replace(card, sensors={"alpha": sd, "airspeed": 0.3})
        found = beyond_noise(flown, [record], stated)["alpha"]
        assert found.noise == pytest.approx(sd)
        assert found.fitted == pytest.approx(0.1 * DEG)
        assert found.beyond is beyond


# The log score on hold-out flights is a normal density in closed form, for segments of any length
LENGTHS = (90, 91)  # the halves of a manoeuvre with an odd number of samples


def test_log_scores_and_figures_of_segments_of_different_length():
    rng = np.random.default_rng(1)
    missed, longest = [rng.standard_normal((n, 1)) for n in LENGTHS], max(LENGTHS)
    real = np.arange(longest) < np.array(LENGTHS)[:, None]
    flown = part(SegmentTrajectories, outputs=("q",), noise_growth=np.full((2, longest, 1), 2.0), inside=real)
    paths = [
        SimulatedManoeuvre(
            "run", "extended", "hold_out", True, {}, 0.1 * np.arange(len(x)), {"q": x[:, 0]}, {"q": np.zeros(len(x))}
        )
        for x in missed
    ]
    expected = np.concatenate(missed)[:, 0] / 2.0
    density = norm.logpdf(expected, scale=np.sqrt(np.mean(expected**2)))
    for _ in range(20):  # the type checker looks at one element of a sequence, drawn at random
        found = left_out_of(paths, flown, 1.0)
    assert found.density() == pytest.approx(density)
    # White noise of variance 2: no correlation beyond lag 0, and twice the variance over the sampling rate.
    rng = np.random.default_rng(2)
    parts = [np.sqrt(2.0) * rng.standard_normal(n) for n in (4000, 6000)]
    for _ in range(20):
        lags, correlation = autocorrelation(parts, 5)
        _, power = spectrum(parts, 0.1)
    assert list(lags) == [0, 1, 2, 3, 4, 5]
    assert correlation[0] == 1.0
    assert np.abs(correlation[1:]).max() < 4.0 / np.sqrt(10_000)
    assert power.mean() == pytest.approx(2.0 * 2.0 * 0.1, rel=0.05)


# A lag of the separation point asked of trajectories: found where it is, not wanted where it is not
OUTPUTS = ("airspeed", "alpha", "theta", "q", "ax", "az")


def asked(card, hidden, seed):
    """The card's model fitted to two stalls, and what is said of a lag beside it."""
    model = Model.from_card(card)
    flights, fit, noise = fitted_to_stalls(card, model, hidden, seed)
    full = candidate_model(model, flights)
    plain, effect = CandidateFit("extended", fit), lag_of(full)
    wider = replace(model.extended(), fixed=())
    lagged, lag = with_lag(wider, effect, plain, noise, flights)
    if not lag.gains:
        return lag, lagged
    silent = {c.name: {0: {}, 1: {}} for c in (plain, lagged)}
    fits: dict[str, list] = {"extended": [], "lagged": []}
    for name, found in left_out((plain, lagged), silent, noise):
        fits[name].append(found)
    paths = [holdout_fits(c, fits[c.name], {}) for c in (plain, lagged)]
    without, within = (left_out_of(one, fit.flown, noise.variance_inflation) for one in paths)
    return confirmed(lag, without, within), lagged


@pytest.mark.parametrize("broken", [lambda _: np.float64(1e300) * 1e300, lambda _: np.linalg.inv(np.zeros((2, 2)))])
def test_a_lag_whose_fit_breaks_down_is_a_failure_and_not_no_lag(monkeypatch, broken):
    monkeypatch.setattr(searches, "lag_of", broken)
    lagged, failures = searches._asked_of_a_lag(Mock(spec=CandidateModel), Mock(spec=Extension), 0, None)
    assert lagged is None
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


def path(errors, name="a"):
    n = len(next(iter(errors.values())))
    zero = {key: np.zeros(n) for key in errors}
    return SimulatedManoeuvre(
        name, "extended", "hold_out", True, {}, np.arange(n) * 0.04, zero, {k: -x for k, x in errors.items()}
    )


def test_the_gain_on_unseen_flight_is_that_of_normal_densities():
    """Half the error gains n log 2 over the colour's cost; a noise_growth that both share changes nothing of it."""
    n, rng = 400, np.random.default_rng(2)
    seen = np.ones((2, n), bool)
    noise = [{"alpha": rng.standard_normal(n)} for _ in range(2)]
    before, after = ([path({k: s * x for k, x in e.items()}) for e in noise] for s in (1.0, 0.5))
    tried = LagTest("separation_lag", 5.0)

    def judged(without, lagged, growth=1.0):
        flown = part(SegmentTrajectories, outputs=("alpha",), noise_growth=growth * np.ones((2, n, 1)), inside=seen)
        return confirmed(tried, *(left_out_of(paths, flown, 10.0) for paths in (without, lagged)))

    found = judged(before, after)
    assert found.kept
    assert found.unseen[0] == pytest.approx(2 * n * np.log(2.0) / 10.0)
    swollen = judged(before, after, 3.0)
    assert swollen.unseen[0] == pytest.approx(found.unseen[0])
    worse = judged(after, before)
    assert not worse.kept
    assert worse.unseen[0] == pytest.approx(-found.unseen[0])
