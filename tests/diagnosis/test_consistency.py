"""Whether sensors agree and what their errors are, and what kinematics, despiking and filters make of records."""

from dataclasses import replace
from functools import partial

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
import six_axes
from gusty_flight import gusty_flight
from stranger import flown
from stranger_six import drawn, fly

from bayes_aero.diagnosis import consistency as sensors
from bayes_aero.diagnosis.diagnose import diagnose
from bayes_aero.diagnosis.selection import filtered_channels
from bayes_aero.diagnosis.selection_state import DiagnosisSettings
from bayes_aero.effects import CATALOGUE
from bayes_aero.flight.card import read_card
from bayes_aero.flight.health import Agreement, Consistency, Departure, PathCheck, noise_of
from bayes_aero.flight.reading import read_record
from bayes_aero.flight.record import FlightRecord
from bayes_aero.inference.mle import filter_mismatch_notes, fit_mle
from bayes_aero.jobs.documents import ConsistencyPart
from bayes_aero.jobs.identify import identify
from bayes_aero.jobs.options import IdentifyOptions
from bayes_aero.model.model import Model
from bayes_aero.model.observations import despiked, join, observe
from bayes_aero.model.records import Forming
from bayes_aero.physics.filters import LONG_REACH, differentiate_joined, smooth
from bayes_aero.physics.kinematics import LATERAL, PATH, Rotation, integral, lever_arm, path_rates, side_force
from bayes_aero.report.pages.diagnosis import sentences
from bayes_aero.report.pages.estimates import verdict
from bayes_aero.report.pages.parts import consistency_sentences, open_sentences
from bayes_aero.residuals.base import FlightPathError
from bayes_aero.residuals.equation_error import EquationError
from bayes_aero.simulate.demo import simulate_stall
from bayes_aero.simulate.injection import hidden_records

# Whether the sensors agree, in absolute terms: noise drawn by itself, faults put into simulated records, real ones
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
    drawn = sensors.gusts(np.random.default_rng(4), 400, 1500, dt, V, across=across)
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
    assert sensors.sensor_noise(channels, quiet)[1]["alpha"] == 0.01
    assert sensors.sensor_noise(channels, card)[1]["alpha"] == pytest.approx(np.radians(0.05))


@pytest.mark.parametrize(("seed", "noise"), [(7002, "buffet"), (7003, "outliers")])
def test_sound_records_agree(card, seed, noise):
    found = sensors.consistency(hidden_records({}, seed=seed, noise=noise), card)
    assert found.agreement is Agreement.AGREE
    assert found.departures == ()


def frozen(r):
    alpha = np.array(r["alpha"])
    alpha[900:1100] = alpha[900]
    return {"alpha": alpha}


FAULTS = {  # what is recorded, the channels of which one at least must be named
    "frozen vane": (frozen, {"alpha"}),
    "ax without gravity": (lambda r: {"ax": r["ax"] - G * np.sin(r["theta"])}, {"airspeed"}),
    "yaw rate of the other sign": (lambda r: {"r": -r["r"]}, {"beta", "phi"}),
    "airspeed in another unit": (lambda r: {"airspeed": r["airspeed"] / 1.15}, {"airspeed", "altitude"}),
    "theta of another flight": (lambda r: {"theta": np.roll(r["theta"], 50)}, {"theta"}),
}


@pytest.mark.parametrize("name", FAULTS)
def test_faults_disagree_and_the_channel_is_named(sound, card, name):
    fault, channels = FAULTS[name]
    checked = sensors.consistency([changed(sound, **fault(sound))], card, seek=False)
    assert checked.agreement is Agreement.UNEXPLAINED
    assert channels & {d.channel for d in checked.departures}
    assert all(d.rms > d.permitted > 0.0 for d in checked.departures)
    if name == "frozen vane":
        begin, end = sound.time[900], sound.time[1100]
        there = [d for d in checked.departures if d.channel == "alpha"]
        assert any(d.begin < end and begin < d.end and d.end - d.begin < 40.0 for d in there)


def test_departures_are_beyond_repair_where_no_error_explains_them_and_a_simulation_may_be_off_by_less():
    left = tuple(Departure("a", channel, 0.0, 9.0, rms, 0.1) for channel, rms in (("theta", 0.05), ("airspeed", 1.4)))
    checked = Consistency(recorded=(PathCheck("a", left, {}, 0.0, 0.0),))
    tolerances = {"theta": np.radians(2.0), "airspeed": 1.5}
    assert [d.channel for d in checked.beyond(tolerances)] == ["theta"]
    explained = replace(checked, corrected=(PathCheck("a", (), {}, 0.0, 0.0),))
    assert (explained.agreement, explained.beyond(tolerances)) == (Agreement.EXPLAINED, ())


def test_no_effect_is_sought_where_sensors_contradict_each_other_beyond_the_tolerances_unless_asked_for(card):
    """The attitude of two seconds before; and a thrust arm in the coefficients, which do not read the attitude."""
    hidden = hidden_records({"thrust_moment": {"thrust_arm": 0.8}}, seed=42, noise="ar1", seconds=60.0)
    records = [changed(r, theta=np.roll(r["theta"], 50)) for r in hidden]
    settings = DiagnosisSettings(gains=False, process_noise=False)
    found = diagnose(records, card, settings=settings)
    assert found.verdict == "unreliable"
    assert "theta" in {d.channel for d in found.unreliable}
    assert all(d.rms > card.tolerances[d.channel].value for d in found.unreliable)
    assert not [c.name for c in found.causes if c.stage != "flight path"]
    assert (found.unknown, found.terms, found.changes) == ((), (), ())
    assert sentences(found)[0].severity == "error"
    anyway = diagnose(records, card, settings=replace(settings, anyway=True))
    assert anyway.unreliable == ()
    assert "thrust_moment" in {c.name for c in anyway.causes}


@pytest.mark.parametrize(("times", "unit"), [pytest.param(8.0, "", marks=pytest.mark.verify), (1.0 / 4.4482, "lbf")])
def test_a_channel_in_another_unit_is_told_as_a_whole_and_nothing_beside_it_is_sure(card, times, unit):
    """Thrust of both engines, as the record has it; a silent flight but for that."""
    records = hidden_records({}, seed=11, noise="ar1", seconds=80.0)
    engines = ("thrust_left", "thrust_right")
    records = [changed(r, **{name: times * r[name] for name in engines}) for r in records]
    found = diagnose(records, card, settings=DiagnosisSettings(gains=False, process_noise=False))
    (wrong,) = [c.wrong for c in found.beyond if c.wrong]
    assert (wrong.channels, wrong.unit) == (engines, unit)
    assert wrong.times == pytest.approx(times, rel=0.05)
    assert not any(c.sure for c in found.causes)
    (said,) = [s for s in sentences(found) if getattr(s, "key", "") == "whole_channel"]
    assert said.severity == "error"
    assert unit in said


@pytest.mark.parametrize(("lost", "agreement"), [("altitude", Agreement.AGREE), ("theta", Agreement.NOT_CHECKED)])
def test_what_cannot_be_checked_is_said(sound, card, lost, agreement):
    without = FlightRecord.from_arrays("a", sound.time, {k: v for k, v in sound.channels.items() if k != lost})
    checked = sensors.consistency([without], card, seek=False)
    assert checked.agreement is agreement
    assert checked.unchecked == ("altitude",) or lost == "theta"


def test_light_turbulence_is_permitted_and_a_gust_of_one_channel_is_not(sound, card):
    """Air is alike in all directions: what only the vane feels is no gust."""
    rng = np.random.default_rng(3)
    V, n = np.asarray(sound["airspeed"]), sound.n
    ahead = 0.6 * sensors.gusts(rng, 1, n, sound.dt, 80.0, across=False)[0]
    up, side = (0.6 * sensors.gusts(rng, 1, n, sound.dt, 80.0, across=True)[0] / V for _ in range(2))
    everywhere = changed(sound, airspeed=V + ahead, alpha=sound["alpha"] + up, beta=sound["beta"] + side)
    found = sensors.consistency([everywhere], card, seek=False)
    assert found.agreement is Agreement.AGREE
    assert 0.3 < found.recorded[0].turbulence <= sensors.LIGHT_TURBULENCE
    assert found.recorded[0].gusts == pytest.approx(0.6, rel=0.3)
    assert sensors.in_gusts([everywhere], card) == {everywhere.name: found.recorded[0].gusts}
    one = changed(sound, alpha=sound["alpha"] + 3.0 * up)
    alone = sensors.consistency([one], card, seek=False)
    assert {d.channel for d in alone.departures} >= {"alpha"}
    assert sensors.in_gusts([one], card) == {}


@pytest.mark.parametrize("seed", [1, 2])
def test_a_record_is_in_gusts_whatever_moves_the_aircraft(seed):
    """By a simulator that shares no code: gusts move it, too, and are not those of the measure."""
    card = read_card("hfb320")
    calm, light = (gusty_flight(seed, gust={"w": size, "u": size}) for size in (0.0, 0.6))
    assert sensors.in_gusts([calm], card) == {}
    (size,) = sensors.in_gusts([light], card).values()
    assert 0.4 < size < 1.4


def test_a_record_without_the_lateral_motion_is_one_with_zeros_of_it():
    """In coefficients and along the flight path, residuals and sensitivities."""
    card, flight = read_card("hfb320"), gusty_flight(1, gust={"w": 0.0, "u": 0.0}, seconds=20.0)
    model, still = Model.from_card(card), dict.fromkeys(("beta", "phi", "p", "r"), np.zeros(len(flight.time)))
    flights = join([flight], card), join([replace(flight, channels={**flight.channels, **still})], card)
    bare, whole = (EquationError.of(x, model) for x in flights)
    theta, shared = np.array([p.start for p in model.free]), [n for n in bare.outputs if n in whole.outputs]
    assert {"CL", "CD", "Cm", "airspeed", "alpha", "theta"} <= {*shared}
    np.testing.assert_allclose(bare.residuals(theta, shared), whole.residuals(theta, shared), atol=1e-9)
    S = [x.linearise(theta)[1][:, [x.outputs.index(n) for n in shared]] for x in (bare, whole)]
    np.testing.assert_allclose(*S, atol=1e-9)


def test_rough_air_that_all_air_data_show_contradicts_no_sensor_and_a_wrong_airspeed_does():
    """Gusts of 1.8 m/s: more than light turbulence, but not more than a filter may estimate."""
    card, rough = read_card("hfb320"), gusty_flight(3, gust={"w": 1.8, "u": 1.8})
    wrong = changed(rough, airspeed=rough["airspeed"] + 30.0 * np.sin(rough.time / 6.0))
    tolerances = {name: tolerance.value for name, tolerance in card.tolerances.items()}
    check = partial(sensors.consistency, card=card, seek=False)
    beyond = lambda record, **air: {d.channel for d in check([record], **air).beyond(tolerances)}
    assert beyond(rough)
    assert not beyond(rough, turbulence=np.inf)
    assert "airspeed" in beyond(wrong, turbulence=np.inf)


@pytest.mark.parametrize("error", ["airspeed_scale", "vane_position", "late sideslip"])
def test_an_error_of_one_sensor_is_no_gust(card, error):
    if error in CATALOGUE:
        (parameter,) = CATALOGUE[error].parameters
        records = hidden_records({error: {parameter.name: parameter.neutral + parameter.prior.scale}}, seed=5)
    else:
        sound = hidden_records({}, seed=5)
        records = [changed(r, beta=np.interp(r.time - 0.25, r.time, r["beta"])) for r in sound]
    assert sensors.in_gusts(records, card) == {}


def test_an_error_that_the_card_states_is_taken_out(card, sound):
    biased = changed(sound, q=sound["q"] + 0.008)
    stated = replace(card, effects=(*card.effects, "pitch_rate_bias"), fixed={**card.fixed, "pitch_rate_bias": 0.008})
    assert sensors.consistency([biased], card, seek=False).agreement is Agreement.UNEXPLAINED
    assert sensors.consistency([biased], stated, seek=False).agreement is Agreement.AGREE


def test_noise_is_read_off_the_record_where_it_was_not_filtered(card, clean_records):
    """White noise of known deviations, added to clean simulated records."""
    rng = np.random.default_rng(20)
    noise = {"alpha": rng.uniform(3e-4, 3e-3), "q": rng.uniform(2e-4, 2e-3), "airspeed": rng.uniform(0.05, 0.5)}
    noise["elevator"] = rng.uniform(2e-4, 1e-3)
    steps = [{n: sd * rng.standard_normal(r.n) for n, sd in noise.items()} for r in clean_records]
    records = [changed(r, **{n: r[n] + x for n, x in s.items()}) for r, s in zip(clean_records, steps, strict=True)]
    found = join(records, card).noise
    for name, sd in noise.items():
        assert found[name] == pytest.approx(sd, rel=0.06), name
    assert found["theta"] < 1e-5  # moves by tenths of a radian, recorded without noise
    assert filtered_channels(join(records, card)) == ()
    smoothed = [changed(r, alpha=np.asarray(smooth(jnp.asarray(r["alpha"])))) for r in records]
    assert filtered_channels(join(smoothed, card)) == ("alpha",)


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
    arms = zip(("ax", "ay", "az"), lever_arm(rates, card.aircraft.accelerometer), strict=True)
    felt = {name: signals[name] - arm for name, arm in arms}
    found = side_force(signals, felt["ax"], felt["az"])
    assert np.ptp(np.asarray(felt["ay"])) > 1.0
    off = np.abs(np.asarray(found - felt["ay"]))
    assert np.quantile(off, 0.99) < 0.01 * np.ptp(np.asarray(felt["ay"]))


def test_alpha_dot_follows_the_flight_and_no_offset_of_gyro_and_accelerometer(quiet):
    dt, first, last = (quiet.channels[name] for name in ("dt", "first", "last"))
    truth = np.asarray(differentiate_joined(quiet.channels["alpha"], dt, first, last))
    inner = np.asarray(jnp.minimum(jnp.arange(quiet.n) - first, last - jnp.arange(quiet.n))) > LONG_REACH
    off = quiet.channels | {"q": quiet.channels["q"] + 0.01, "az": quiet.channels["az"] + 0.4}
    exact, moved = (np.asarray(quiet.with_slopes(x)["alpha_dot"]) for x in (quiet.channels, off))
    assert np.std((exact - truth)[inner]) < 0.01 * np.std(truth[inner])
    assert np.abs((moved - exact)[inner]).max() < 1e-4  # of 0.016 rad/s that the two offsets make together


def in_channel(flights, name, x):
    """The flights with this in a channel, repaired: the channel, and how many spikes it had."""
    found, count = despiked(eqx.tree_at(lambda f: f.channels[name], flights, jnp.asarray(x)))
    return np.asarray(found.channels[name]), count.get(name, 0)


def test_spikes_are_replaced(quiet):
    rng = np.random.default_rng(8)
    x = np.array(quiet.channels["az"]) + 0.05 * rng.standard_normal(quiet.n)
    at = rng.choice(np.arange(20, quiet.n - 20, 40), 15, replace=False)
    spiked = x.copy()
    spiked[at] += 2.0 * rng.choice([-1.0, 1.0], len(at))
    found, count = in_channel(quiet, "az", spiked)
    assert count == len(at)
    off = np.abs(found - x)
    assert off[at].max() < 0.5
    assert np.delete(off, at).max() == 0.0


@pytest.mark.parametrize("noise", [0.01, 0.001])
@pytest.mark.parametrize(("times", "values", "digit"), [
    ([30.0, 30.0 + 1e-9], [0.0, 5.0], 0.0),  # a step
    # A pitch rate that stands still, then runs to and fro at a constant slope, as after a 3-2-1-1 at 20 Hz.
    ([30.0, 30.6, 31.4, 32.2, 32.6], [0.0, 0.35, -0.35, 0.25, 0.0], 0.0),
    ([0.0, 30.0, 60.0], [0.0, 0.1, 0.0], 5e-4),  # steps of a quantised channel, which four were taken for spikes once
])  # fmt: skip
def test_steps_and_sharp_peaks_are_no_spikes_and_a_spike_beside_them_is(quiet, times, values, digit, noise):
    time = np.asarray(quiet.channels["elapsed"])
    x = np.interp(time, times, values)
    x = np.round(x / digit) * digit if digit else x + noise * np.random.default_rng(4).standard_normal(quiet.n)
    found, count = in_channel(quiet, "q", x)
    assert count == 0
    np.testing.assert_array_equal(found, x)
    at = int(np.searchsorted(time, 31.0))
    spiked = x.copy()
    spiked[at] += 0.2
    found, count = in_channel(quiet, "q", spiked)
    assert count == 1
    assert abs(found[at] - x[at]) < 0.05


# What smoothing one side only does to estimates: against the truth of an aircraft of another simulator
def test_filtered_alike_the_moment_is_that_of_the_truth_and_the_note_says_so(tmp_path):
    """An aircraft whose doublets are fast."""
    truth, _, files = flown(tmp_path, np.random.default_rng([7, 31]), None)
    card = read_card(str(tmp_path / "card.toml"))
    records, model = [read_record(path, card.channels) for path in files], Model.from_card(card)
    run = identify(records, card, IdentifyOptions(coefficients="published", sample=False, gp=False))
    alike = fit_mle(model, observe(records, card, model)).estimate
    for name in ("Cmde", "Cma", "CmX"):
        i, true = run.mle.names.index(name), getattr(truth, name)
        assert abs(alike[i] - true) < 0.5 * abs(run.mle.estimate[i] - true), name
        assert alike[i] == pytest.approx(true, rel=0.01), name
    note, *_ = verdict(run)
    assert "Cmde would be" in note
    assert "CD0" not in note


def test_no_word_where_slow_stalls_were_flown(attas_paths, card, model):
    records = [read_record(path, card.channels) for path in attas_paths]
    published = fit_mle(model, observe(records, card, model, Forming.PUBLISHED))
    assert filter_mismatch_notes(records, card, model, published) == ()


# Errors of sensors without an altitude: named, or told with what cannot be parted from them; silent where none is
NOISE = {"ax": 0.01, "az": 0.02, "q": 2e-4, "theta": 5e-4, "alpha": 5e-4, "airspeed": 0.1}


def level_flight(seconds: float, seed: int, **offsets: float) -> FlightRecord:
    """Wings level, by hand: u' = ax - g sin theta - q w, w' = az + g cos theta + q u with u = V cos a, w = V sin a."""
    t = np.arange(0.0, seconds, 0.1)
    swing = [(0.02, 0.9), (0.015, 1.7), (0.03, 0.25)]
    alpha = 0.10 + sum(a * np.sin(w * t) for a, w in swing)
    alpha_dot = sum(a * w * np.cos(w * t) for a, w in swing)
    theta = 0.12 + sum(1.5 * a * np.sin(w * t - 0.4) for a, w in swing)
    q = sum(1.5 * a * w * np.cos(w * t - 0.4) for a, w in swing)
    V, V_dot = 100.0 + 4.0 * np.sin(0.2 * t), 0.8 * np.cos(0.2 * t)
    u, w = V * np.cos(alpha), V * np.sin(alpha)
    true = {
        "ax": V_dot * np.cos(alpha) - w * alpha_dot + q * w + G * np.sin(theta),
        "az": V_dot * np.sin(alpha) + u * alpha_dot - q * u - G * np.cos(theta),
        "q": q, "theta": theta, "alpha": alpha, "airspeed": V,
    }  # fmt: skip
    rng = np.random.default_rng(seed)
    measured = {n: x + offsets.get(n, 0.0) + NOISE[n] * rng.standard_normal(t.size) for n, x in true.items()}
    return FlightRecord.from_arrays(f"level_{seed}", t, measured)


@pytest.fixture(scope="module")
def bare(card):
    """A card that states the aircraft and no constants: lateral channels are neither recorded nor stated."""
    return replace(card, aircraft=replace(card.aircraft, accelerometer=(0.0, 0.0, 0.0)), constants={}, sums={})


def searched(record: FlightRecord, card) -> tuple[sensors.KnownErrors, Consistency]:
    errors = sensors.errors_of_path(sensors.screen_sensor_errors([record], card))
    return errors, sensors.consistency([record], card, errors=errors)


def test_an_offset_of_the_attitude_is_told_with_the_accelerometers_that_look_the_same(bare):
    """Gravity in the body axes turns: ax by g b cos theta and az by g b sin theta do the same to V and alpha."""
    b = 0.0125
    errors, checked = searched(level_flight(60.0, 1, theta=b), bare)
    assert checked.unchecked == ("altitude", "beta", "phi")
    entry = {e.name: e for e in checked.open}["pitch_attitude_bias"]
    assert "accel_x_bias" in entry.imitators
    assert entry.among > 3.0 * entry.sd or entry.among > 0.005  # with those free it is not known as well
    size = errors.errors.get("pitch_attitude_bias", {}).get("parameters", {}).get("pitch_attitude_bias")
    mean, sd = (size["mean"], size["sd"]) if size else (entry.mean, entry.sd)
    assert mean == pytest.approx(b, abs=max(4.0 * sd, 0.003))
    assert ConsistencyPart.of(checked).open["pitch_attitude_bias"].imitators
    # An offset b of theta and offsets of ax and az that stand for it give one and the same flight path.
    tilted = {"ax": -G * b * np.cos(0.12), "az": -G * b * np.sin(0.12)}
    still_open = {e.name: e for e in searched(level_flight(60.0, 1, **tilted), bare)[1].open}
    assert {"accel_x_bias", "pitch_attitude_bias"} <= set(still_open)
    assert "pitch_attitude_bias" in still_open["accel_x_bias"].imitators
    # Where nothing is hidden nothing is asked for.
    errors, checked = searched(level_flight(60.0, 2), bare)
    assert checked.agreement is Agreement.AGREE
    assert not [e for e in errors.errors.values() if not e["minor"]]
    assert not [e.name for e in checked.open if e.asked]


def misread(card, **errors: float) -> FlightRecord:
    """A simulated stall whose airspeed has errors: of the impact pressure (Pa), then in proportion, then a constant."""
    pressure, scale, bias = (
        errors.get(name, 0.0) for name in ("pitot_pressure_bias", "airspeed_scale", "airspeed_bias")
    )
    stall = simulate_stall(0, card=card)
    V = np.array(stall["airspeed"])
    shown = np.sqrt(V**2 + 2.0 * pressure / stall["density"]) * (1.0 + scale) + bias
    return changed(stall, airspeed=shown, mach=stall["mach"] * shown / V)


LARGE = {"airspeed_bias": 6.0, "airspeed_scale": 0.05}


@pytest.mark.parametrize("hidden", [
    {"pitot_pressure_bias": -200.0}, LARGE,
    # Of opposite signs they go with speed nearly as a pitot pressure: dp / (rho V) = 2 e - e V / V0 about V0.
    {"airspeed_bias": 2.0, "airspeed_scale": -0.01},
    *(pytest.param(dict(zip(("airspeed_bias", "airspeed_scale"), sizes, strict=False)), marks=pytest.mark.verify)
      for sizes in ((-3.0,), (4.0, -0.0225), (-3.0, 0.02))),
    pytest.param({"airspeed_scale": 0.03}, marks=pytest.mark.verify),
])  # fmt: skip
def test_errors_of_the_airspeed_are_told_apart_by_how_they_go_with_speed(card, hidden):
    """rho V dV = dp; two errors of it are one joint estimate."""
    known, found = searched(misread(card, **hidden), card)
    assert set(known.errors) == set(hidden)
    for name, true in hidden.items():
        size = known.errors[name]["parameters"][name]
        assert size["mean"] == pytest.approx(true, abs=4.0 * size["sd"])
        assert size["sd"] < 0.02 * abs(true) or len(hidden) == 2
        assert set(known.errors[name]["joint"]) == set(hidden) - {name}
        assert all(-1.0 < r < -0.9 for r in known.errors[name]["joint"].values())
    assert found.agreement is (Agreement.EXPLAINED if hidden is LARGE else Agreement.AGREE)
    if hidden is LARGE:
        (answer, *_) = consistency_sentences(found, corrects=False)
        assert answer.count("estimated together with") == 2
        assert not {e.name for e in found.open} & set(known.errors)


def test_half_of_a_joint_estimate_is_no_correction(card):
    """A bias of 13 m/s is larger than sensors have, and the scale was estimated beside it."""
    errors, checked = searched(misread(card, airspeed_bias=13.0, airspeed_scale=0.05), card)
    assert not errors.errors
    assert checked.agreement is Agreement.UNEXPLAINED
    assert not checked.corrected
    joint = {e.name: e.joint for e in checked.open if e.joint}
    assert set(joint) == {"airspeed_bias", "airspeed_scale"}
    assert -1.0 < joint["airspeed_scale"]["airspeed_bias"] < -0.9
    assert any("estimated together" in said and "airspeed_scale" in said for said in open_sentences(checked))
    assert ConsistencyPart.of(checked).open["airspeed_scale"].joint == joint["airspeed_scale"]


def test_the_true_pitot_pressure_leaves_the_path_and_errors_beside_larger_ones_are_found(card):
    """The scale of the correction goes with the airspeed; where its integral begins must not be multiplied by it."""

    def left(pressure: float) -> float:
        flights = join([misread(card, pitot_pressure_bias=pressure)], card)
        path = FlightPathError.of(flights, Model.of(["pitot_pressure_bias"]))
        residual = path.evaluate(np.array([pressure]))[0][:, path.outputs.index("airspeed")]
        assert {"airspeed", "ax", "q"} <= set(path.noise) <= set(flights.noise) - {"elevator", "thrust"}
        return float(np.std(residual))

    assert left(258.0) == pytest.approx(left(0.0), rel=0.2)
    # A vane 9 deg off is no error that vanes have and is not corrected; the airspeed is judged beside it.
    record = misread(card, airspeed_bias=-3.0)
    record = changed(record, alpha=record.channels["alpha"] + np.radians(9.0))
    errors = sensors.errors_of_path(sensors.screen_sensor_errors([record], card)).errors
    assert list(errors) == ["airspeed_bias"]
    size = errors["airspeed_bias"]["parameters"]["airspeed_bias"]
    assert size["mean"] == pytest.approx(-3.0, abs=4.0 * size["sd"])


# Sensors elsewhere, late or of another scale: told from each other, and sized
AT = 3.0  # m from where the card says


def on_a_boom(f, x=13.08):
    """Flow angles at this place: at 120 m/s x/V is .1 s, so that a lag is what a boom would pretend to be."""
    V, alpha, beta = f["airspeed"], f["alpha"], f["beta"]
    u, v, w = V * np.cos(alpha) * np.cos(beta), V * np.sin(beta), V * np.sin(alpha) * np.cos(beta)
    across, down = v + x * f["r"], w - x * f["q"]
    return {"alpha": np.arctan2(down, u), "beta": np.arctan2(across, np.hypot(u, down))}


BESIDE = {  # what such a sensor shows, of a flight's channels and its angular accelerations
    "vane_position": (13.08, lambda f, _: on_a_boom(f)),
    "alpha_delay": (0.15, lambda f, _: {"alpha": np.interp(f["time"] - 0.15, f["time"], f["alpha"])}),
    "sideslip_vane_position": (6.0, lambda f, _: {"beta": f["beta"] + 6.0 * f["r"] / f["airspeed"]}),
    "sideslip_vane_height": (2.0, lambda f, _: {"beta": f["beta"] + 2.0 * f["p"] / f["airspeed"]}),
    "sideslip_delay": (0.1, lambda f, _: {"beta": np.interp(f["time"] - 0.1, f["time"], f["beta"])}),
    "sideslip_scale": (0.15, lambda f, _: {"beta": 1.15 * f["beta"]}),
    "accel_y_position": (AT, lambda f, dot: {"ay": f["ay"] + AT * (dot["r"] + f["p"] * f["q"])}),
    "accelerometer_position": (AT, lambda f, dot: {
        "ax": f["ax"] - AT * (f["q"] ** 2 + f["r"] ** 2),
        "ay": f["ay"] + AT * (dot["r"] + f["p"] * f["q"]),
        "az": f["az"] + AT * (f["p"] * f["r"] - dot["q"]),
    }),
}  # fmt: skip


@pytest.mark.verify
def test_a_right_mach_number_beside_a_wrong_airspeed_leaves_the_lift_as_it_is(card):
    """CLa is 3.6, CD0 .045; moved with the airspeed, the Mach number would make CLa 3.78."""
    record, right = misread(card, pitot_pressure_bias=300.0), misread(card)
    record = replace(record, channels={**record.channels, "mach": right.channels["mach"]})
    found = diagnose([record], card, settings=DiagnosisSettings(gains=False))
    assert {c.name for c in found.causes} == {"pitot_pressure_bias"}
    assert not found.minor
    assert not found.unknown
    for name, true in (("CLa", 3.6), ("CD0", 0.045)):
        _, after, sd = found.base_moves[name]
        assert after == pytest.approx(true, abs=3.0 * sd)


ALWAYS = (None, "vane_position", "accelerometer_position")  # the others in `make verify`


@pytest.mark.parametrize("name", [
    pytest.param(name, marks=() if name in ALWAYS else pytest.mark.verify) for name in (None, *BESIDE)
])  # fmt: skip
def test_sensors_elsewhere_or_late_are_told_apart(tmp_path, name):
    """By kinematics, in flights of a simulator that shares no code: velocities and accelerations of a rigid body."""
    rng = np.random.default_rng(41)
    plane = drawn(rng, **six_axes.ATTACHED)
    records = []
    for kind in ("aileron", "rudder", "elevator"):
        flight = fly(plane, kind, rng)
        dot = {n: np.gradient(flight[n], flight["time"]) for n in "pqr"}
        flight |= BESIDE[name][1](flight, dot) if name else {}
        records.append(six_axes.record(kind, flight, rng))
    found = sensors.screen_sensor_errors(records, six_axes.card_in(tmp_path, plane))
    assert found.causes == (() if name is None else (name,))
    if name is not None:
        size = found.sizes[name]
        assert abs(size.mean - BESIDE[name][0]) < 3.0 * size.sd
        assert size.sd < 0.1 * BESIDE[name][0]
        judged = sensors.Blocks(found.state)  # by stretches of the flights
        assert size.sd >= 0.999 * np.sqrt(judged.judge(name)[1][0, 0])
        assert judged.p_value(name) < 1e-3
