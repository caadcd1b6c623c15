"""Whether sensors agree, what flight-path kinematics and filters make of records, and how noise is called."""

from dataclasses import replace
from pathlib import Path

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from gusty_flight import gusty_flight
from stranger import flown

from bayes_aero.diagnosis.consistency import consistency, in_gusts
from bayes_aero.diagnosis.diagnose import diagnose
from bayes_aero.diagnosis.filter_mismatch import filter_mismatch_notes
from bayes_aero.diagnosis.flight_path_check import LIGHT_TURBULENCE, gusts, sensor_noise
from bayes_aero.effects import CATALOGUE
from bayes_aero.flight.agreement import Agreement
from bayes_aero.flight.card.card import read_card
from bayes_aero.flight.health.signals import noise_of
from bayes_aero.flight.reading.read_record import read_record
from bayes_aero.flight.record import FlightRecord
from bayes_aero.inference.likelihood.mle import fit_mle
from bayes_aero.jobs.identify import identify
from bayes_aero.jobs.options import IdentifyOptions
from bayes_aero.model.joined_channels import despiked, join
from bayes_aero.model.model import Model
from bayes_aero.model.observations import Forming, observe
from bayes_aero.physics.filters import LONG_REACH, differentiate_joined, smooth_joined
from bayes_aero.physics.flightpath import LATERAL, PATH, Rotation, integral, lever_arm, path_rates, side_force
from bayes_aero.report.text.identification import verdict
from bayes_aero.simulate.injection import hidden_records

# Whether the sensors agree, in absolute terms: noise drawn by itself, faults put into simulated records, real ones
SHARED = Path(__file__).resolve().parents[3] / "shared"
G = 9.80665


def changed(record: FlightRecord, **channels) -> FlightRecord:
    return FlightRecord.from_arrays(record.name, record.time, {**record.channels, **channels})


@pytest.fixture(scope="module")
def sound():
    return hidden_records({}, seed=7100, noise="ar1")[0]


@pytest.mark.parametrize("across", [False, True])
def test_gusts_have_the_spectrum_of_dryden(across):
    """MIL-F-8785C: variance one; autocorrelation exp(-t/T), across the path (1 - t/2T) exp(-t/T), T = L/V."""
    dt, V = 0.1, 80.0
    T = 533.0 / V
    drawn = gusts(np.random.default_rng(4), 400, 1500, dt, V, across=across)
    assert drawn.std() == pytest.approx(1.0, abs=0.03)
    for lag in (5, 20, 60):
        t = lag * dt
        expected = np.exp(-t / T) * ((1.0 - t / (2.0 * T)) if across else 1.0)
        assert np.mean(drawn[:, lag:] * drawn[:, :-lag]) == pytest.approx(expected, abs=0.04)


def test_noise_is_read_off_a_channel_or_the_card_s(sound, card):
    t = np.arange(4000) * 0.04
    x = np.sin(0.8 * t) + 0.02 * np.random.default_rng(0).standard_normal(t.size)
    assert noise_of(x) == pytest.approx(0.02, rel=0.05)
    quiet = replace(card, sensors={**card.sensors, "alpha": 0.01})
    channels = {name: np.asarray(x) for name, x in sound.channels.items()}
    assert sensor_noise(channels, quiet).constant["alpha"] == 0.01
    assert sensor_noise(channels, card).constant["alpha"] == pytest.approx(np.radians(0.05))


@pytest.mark.parametrize(("seed", "noise"), [(7000, "white"), (7001, "ar1"), (7002, "buffet"), (7003, "outliers")])
def test_sound_records_agree(card, seed, noise):
    found = consistency(hidden_records({}, seed=seed, noise=noise), card)
    assert found.agreement is Agreement.AGREE
    assert found.departures == ()


def frozen(r):
    alpha = np.array(r["alpha"])
    alpha[900:1100] = alpha[900]
    return {"alpha": alpha}


FAULTS = {  # what is recorded, the channels of which one at least must be named
    "frozen vane": (frozen, {"alpha"}),
    "ax without gravity": (lambda r: {"ax": r["ax"] - G * np.sin(r["theta"])}, {"airspeed"}),
    "lateral accelerometer scaled and tilted": (lambda r: {"ay": 1.4 * r["ay"] + 0.03 * r["az"]}, {"beta"}),
    "yaw rate of the other sign": (lambda r: {"r": -r["r"]}, {"beta", "phi"}),
    "airspeed in another unit": (lambda r: {"airspeed": r["airspeed"] / 1.15}, {"airspeed", "altitude"}),
    "theta of another flight": (lambda r: {"theta": np.roll(r["theta"], 50)}, {"theta"}),
}


@pytest.mark.parametrize("name", FAULTS)
def test_faults_disagree_and_the_channel_is_named(sound, card, name):
    fault, channels = FAULTS[name]
    found = consistency([changed(sound, **fault(sound))], card, seek=False)
    assert found.agreement is Agreement.UNEXPLAINED
    assert channels & {d.channel for d in found.departures}
    assert all(d.rms > d.permitted > 0.0 for d in found.departures)


def test_where_a_vane_froze_and_what_cannot_be_checked_is_said(sound, card):
    found = consistency([changed(sound, **frozen(sound))], card, seek=False)
    there = [d for d in found.departures if d.channel == "alpha"]
    begin, end = sound.time[900], sound.time[1100]
    assert any(d.begin < end and begin < d.end and d.end - d.begin < 40.0 for d in there)
    without = [FlightRecord.from_arrays("a", sound.time, {k: v for k, v in sound.channels.items() if k != "altitude"})]
    found = consistency(without, card, seek=False)
    assert found.agreement is Agreement.AGREE
    assert found.unchecked == ("altitude",)
    without = [FlightRecord.from_arrays("a", sound.time, {k: v for k, v in sound.channels.items() if k != "theta"})]
    assert consistency(without, card).agreement is Agreement.NOT_CHECKED


def test_light_turbulence_is_permitted_and_a_gust_of_one_channel_is_not(sound, card):
    """Air is alike in all directions: what only the vane feels is no gust."""
    rng = np.random.default_rng(3)
    V, n = np.asarray(sound["airspeed"]), sound.n
    ahead = 0.6 * gusts(rng, 1, n, sound.dt, 80.0, across=False)[0]
    up, side = (0.6 * gusts(rng, 1, n, sound.dt, 80.0, across=True)[0] / V for _ in range(2))
    everywhere = changed(sound, airspeed=V + ahead, alpha=sound["alpha"] + up, beta=sound["beta"] + side)
    found = consistency([everywhere], card, seek=False)
    assert found.agreement is Agreement.AGREE
    assert 0.3 < found.recorded[0].turbulence <= LIGHT_TURBULENCE
    assert found.recorded[0].gusts == pytest.approx(0.6, rel=0.3)
    assert in_gusts([everywhere], card) == {everywhere.name: found.recorded[0].gusts}
    one = changed(sound, alpha=sound["alpha"] + 3.0 * up)
    alone = consistency([one], card, seek=False)
    assert {d.channel for d in alone.departures} >= {"alpha"}
    assert in_gusts([one], card) == {}


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_record_is_in_gusts_whatever_moves_the_aircraft(seed):
    """By a simulator that shares no code: gusts move it, too, and are not those of the measure."""
    card = read_card("hfb320")
    calm, light = (gusty_flight(seed, gust={"w": size, "u": size}) for size in (0.0, 0.6))
    assert in_gusts([calm], card) == {}
    (size,) = in_gusts([light], card).values()
    assert 0.4 < size < 1.4


@pytest.mark.parametrize("error", ["airspeed_scale", "alpha_scale", "vane_position", "yaw_rate_scale"])
def test_an_error_of_one_sensor_is_no_gust(card, error):
    (parameter,) = CATALOGUE[error].parameters
    usual = parameter.neutral + parameter.prior.scale
    assert in_gusts(hidden_records({error: {parameter.name: usual}}, seed=5), card) == {}


def test_a_late_sideslip_is_no_gust(card):
    records = hidden_records({}, seed=5)
    late = [changed(r, beta=np.interp(r.time - 0.25, r.time, r["beta"])) for r in records]
    assert in_gusts(late, card) == {}


def test_a_known_error_explains_and_a_stated_one_is_taken_out(card, sound):
    records = hidden_records({"pitch_rate_bias": {"pitch_rate_bias": 0.008}}, seed=7104, noise="white")
    found = consistency(records, card)
    assert found.agreement is Agreement.EXPLAINED
    size = found.errors["pitch_rate_bias"]["parameters"]["pitch_rate_bias"]
    assert size["mean"] == pytest.approx(0.008, abs=4.0 * size["sd"])
    biased = changed(sound, q=sound["q"] + 0.008)
    stated = replace(card, effects=(*card.effects, "pitch_rate_bias"), fixed={**card.fixed, "pitch_rate_bias": 0.008})
    assert consistency([biased], card, seek=False).agreement is Agreement.UNEXPLAINED
    assert consistency([biased], stated, seek=False).agreement is Agreement.AGREE


def test_a_lateral_accelerometer_that_does_not_fit_is_no_wind(card):
    """Two simulated records, elsewhere, whose lateral acceleration does not fit their sideslip, bank and rates."""
    paths = [SHARED / "records" / f"side_force_{i}.asc" for i in (1, 2)]
    if not all(path.is_file() for path in paths):
        pytest.skip("the records with a wrong lateral acceleration are not here")
    found = consistency([read_record(path, card.channels) for path in paths], card)
    assert found.agreement is Agreement.UNEXPLAINED or set(found.errors) <= {"accel_y_bias", "accel_y_scale"}
    assert not set(found.errors) - {"accel_y_bias", "accel_y_scale"}
    assert {"beta"} <= {d.channel for d in found.departures}


# Flight-path kinematics against flown flights, and spikes
@pytest.fixture(scope="module")
def quiet(card):
    """Two flights with bank and sideslip, without any noise."""
    return join(hidden_records({}, seed=12, noise="white", sensor_noise=0.0, disturbance=0.0), card)


def test_kinematics_of_the_path_are_those_of_the_flown_flights(quiet, card):
    signals = quiet.with_slopes(quiet.channels)
    rates = path_rates(signals, card.aircraft)
    start, first = quiet.channels["start"], quiet.channels["first"]
    # Smoothing and the trapezoidal rule err where the flight bends within half a second.
    tolerance = {"airspeed": 0.05, "alpha": 1e-3, "theta": 5e-4, "altitude": 0.5, "beta": 1e-3, "phi": 1e-3}
    for name in (*PATH, *LATERAL):
        found = signals[name][first] + integral(rates[name], signals["dt"], start, first)
        off = np.abs(np.asarray(found - signals[name]))
        assert off.max() < tolerance[name], name
        assert np.ptp(np.asarray(signals[name])) > 20 * tolerance[name], name
    # The flights were made with the body's equations: v-dot + r u - p w less gravity, and the sensor off the CG.
    ends = (quiet.channels[name] for name in ("dt", "first", "last"))
    signals["beta_dot"] = differentiate_joined(quiet.channels["beta"], *ends)
    rates = Rotation(*(signals[name] for name in ("p", "q", "r", "p_dot", "q_dot", "r_dot")))
    felt = {
        name: signals[name] - arm
        for name, arm in zip(("ax", "ay", "az"), lever_arm(rates, card.aircraft.accelerometer), strict=True)
    }
    found = side_force(signals, felt["ax"], felt["az"])
    assert np.ptp(np.asarray(felt["ay"])) > 1.0
    off = np.abs(np.asarray(found - felt["ay"]))
    assert np.quantile(off, 0.99) < 0.01 * np.ptp(np.asarray(felt["ay"]))
    # No force but gravity: V dV + g dh = 0 whatever the attitude.
    rng = np.random.default_rng(5)
    n = 50
    s = {name: jnp.asarray(rng.uniform(-0.3, 0.3, n)) for name in ("p", "q", "r", "phi", "theta", "alpha", "beta")}
    s |= {name: jnp.zeros(n) for name in ("ax", "ay", "az", "p_dot", "q_dot", "r_dot")}
    s["airspeed"] = jnp.asarray(rng.uniform(50, 120, n))
    at_cg = replace(card.aircraft, accelerometer=(0.0, 0.0, 0.0))
    rates = path_rates(s, at_cg)
    np.testing.assert_allclose(s["airspeed"] * rates["airspeed"] + 9.80665 * rates["altitude"], 0.0, atol=1e-9)


def test_alpha_dot_has_the_gyro_s_noise_and_not_its_offset(quiet):
    """The vane's noise, differentiated, is what a one-sided hysteresis makes a bias of."""
    dt, first, last = (quiet.channels[name] for name in ("dt", "first", "last"))
    truth = np.asarray(differentiate_joined(quiet.channels["alpha"], dt, first, last))
    inner = np.asarray(jnp.minimum(jnp.arange(quiet.n) - first, last - jnp.arange(quiet.n))) > LONG_REACH
    rng = np.random.default_rng(9)
    noise = {"alpha": 1e-3, "q": 1e-3, "az": 0.05, "airspeed": 0.2}
    noisy = {name: quiet.channels[name] + sd * rng.standard_normal(quiet.n) for name, sd in noise.items()}
    channels = quiet.channels | noisy
    found = np.asarray(quiet.with_slopes(channels)["alpha_dot"])
    vane = np.asarray(differentiate_joined(smooth_joined(channels["alpha"], first, last), dt, first, last))
    smoothed, true = (np.asarray(smooth_joined(jnp.asarray(x), first, last)) for x in (found, truth))
    assert np.std((smoothed - true)[inner]) < 0.4 * np.std((vane - truth)[inner])
    exact = np.asarray(quiet.with_slopes(quiet.channels)["alpha_dot"])
    assert np.std((exact - truth)[inner]) < 0.01 * np.std(truth[inner])
    off = channels | {"q": channels["q"] + 0.01, "az": channels["az"] + 0.4}
    moved = np.asarray(quiet.with_slopes(off)["alpha_dot"]) - found
    assert np.abs(moved[inner]).max() < 1e-4  # of 0.016 rad/s that the two offsets make together


def test_spikes_are_replaced_and_steps_and_sharp_peaks_are_not(quiet):
    rng = np.random.default_rng(8)
    x = np.array(quiet.channels["az"]) + 0.05 * rng.standard_normal(quiet.n)
    at = rng.choice(np.arange(20, quiet.n - 20, 40), 15, replace=False)
    spiked = x.copy()
    spiked[at] += 2.0 * rng.choice([-1.0, 1.0], len(at))
    found, count = despiked(eqx.tree_at(lambda f: f.channels["az"], quiet, jnp.asarray(spiked)))
    assert count["az"] == len(at)
    off = np.abs(np.asarray(found.channels["az"]) - x)
    assert off[at].max() < 0.5
    assert np.delete(off, at).max() == 0.0
    x = np.where(np.asarray(quiet.channels["elapsed"]) > 30.0, 5.0, 0.0)
    x = x + 0.01 * np.random.default_rng(3).standard_normal(quiet.n)
    found, count = despiked(eqx.tree_at(lambda f: f.channels["q"], quiet, jnp.asarray(x)))
    assert "q" not in count
    np.testing.assert_array_equal(np.asarray(found.channels["q"]), x)
    # A pitch rate that stands still, then runs to and fro at a constant slope, as after a 3-2-1-1 at 20 Hz.
    rng = np.random.default_rng(4)
    time = np.asarray(quiet.channels["elapsed"])
    x = np.interp(time, [30.0, 30.6, 31.4, 32.2, 32.6], [0.0, 0.35, -0.35, 0.25, 0.0])
    x = x + 0.001 * rng.standard_normal(quiet.n)
    found, count = despiked(eqx.tree_at(lambda f: f.channels["q"], quiet, jnp.asarray(x)))
    assert "q" not in count
    np.testing.assert_array_equal(np.asarray(found.channels["q"]), x)
    at = int(np.searchsorted(time, 31.0))
    spiked = x.copy()
    spiked[at] += 0.2
    found, count = despiked(eqx.tree_at(lambda f: f.channels["q"], quiet, jnp.asarray(spiked)))
    assert count["q"] == 1
    assert abs(np.asarray(found.channels["q"])[at] - x[at]) < 0.05


# What smoothing one side only does to estimates: against the truth of an aircraft of another simulator
MOMENT = ("Cmde", "Cma", "CmX")


@pytest.fixture(scope="module")
def stranger(tmp_path_factory):
    """Truth, records, card, model and maximum likelihood of an aircraft whose doublets are fast."""
    folder = tmp_path_factory.mktemp("stranger")
    truth, _, files = flown(folder, np.random.default_rng([7, 31]), None)
    card = read_card(str(folder / "card.toml"))
    records, model = [read_record(path, card.channels) for path in files], Model.from_card(card)
    return truth, records, card, model, fit_mle(model, observe(records, card, model, Forming.PUBLISHED))


def test_filtered_alike_the_moment_is_that_of_the_truth_and_the_note_says_so(stranger):
    truth, records, card, model, mle = stranger
    alike = fit_mle(model, observe(records, card, model)).estimate
    for name in MOMENT:
        i, true = mle.names.index(name), getattr(truth, name)
        assert abs(alike[i] - true) < 0.5 * abs(mle.estimate[i] - true), name
        assert alike[i] == pytest.approx(true, rel=0.01), name
    _, *given = stranger
    (note,) = filter_mismatch_notes(*given)
    assert "Cmde would be" in note
    assert "CD0" not in note
    _, records, card, *_ = stranger
    first, *_ = verdict(identify(records, card, IdentifyOptions(coefficients="published", sample=False, gp=False)))
    assert "Cmde would be" in first
    assert not any(
        "would be" in said for said in verdict(identify(records, card, IdentifyOptions(sample=False, gp=False)))
    )


def test_no_word_where_slow_stalls_were_flown(attas_paths, card, model):
    records = [read_record(path, card.channels) for path in attas_paths]
    published = fit_mle(model, observe(records, card, model, Forming.PUBLISHED))
    assert filter_mismatch_notes(records, card, model, published) == ()


# What is said of noise, on flights whose noise is known
@pytest.mark.parametrize(("noise", "coloured"), [("white", False), ("ar1", True)])
def test_noise_is_called_coloured_only_if_it_is(card, noise, coloured):
    records = hidden_records({}, seed=31, noise=noise, seconds=90.0)
    found = diagnose(records, card, seed=0, gains_wanted=False)
    assert ("colored" in found.noise.labels) is coloured, found.noise.lag1
