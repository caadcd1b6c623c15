"""Whether the sensors agree, in absolute terms: noise drawn by itself, faults put into simulated records, real ones."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from gusty_flight import gusty_flight

from bayes_aero.diagnosis.consistency.consistency import consistency, in_gusts
from bayes_aero.diagnosis.consistency.flight_path_noise import LIGHT_TURBULENCE, gusts, sensor_noise
from bayes_aero.effects import CATALOGUE
from bayes_aero.flight.agreement import Agreement
from bayes_aero.flight.card.card import read_card
from bayes_aero.flight.health.signals import noise_of
from bayes_aero.flight.reading.read_record import read_record
from bayes_aero.flight.record import FlightRecord
from bayes_aero.simulate.injection import hidden_records

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


def test_white_noise_is_read_off_a_channel_that_moves():
    t = np.arange(4000) * 0.04
    x = np.sin(0.8 * t) + 0.02 * np.random.default_rng(0).standard_normal(t.size)
    assert noise_of(x) == pytest.approx(0.02, rel=0.05)


def test_noise_is_the_card_s_where_it_states_any(sound, card):
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


def test_where_a_vane_froze_is_said_in_seconds(sound, card):
    found = consistency([changed(sound, **frozen(sound))], card, seek=False)
    there = [d for d in found.departures if d.channel == "alpha"]
    begin, end = sound.time[900], sound.time[1100]
    assert any(d.begin < end and begin < d.end and d.end - d.begin < 40.0 for d in there)


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


def test_a_known_error_explains(card):
    records = hidden_records({"pitch_rate_bias": {"pitch_rate_bias": 0.008}}, seed=7104, noise="white")
    found = consistency(records, card)
    assert found.agreement is Agreement.EXPLAINED
    size = found.errors["pitch_rate_bias"]["parameters"]["pitch_rate_bias"]
    assert size["mean"] == pytest.approx(0.008, abs=4.0 * size["sd"])


def test_an_error_that_the_card_states_is_taken_out(sound, card):
    biased = changed(sound, q=sound["q"] + 0.008)
    stated = replace(card, effects=(*card.effects, "pitch_rate_bias"), fixed={**card.fixed, "pitch_rate_bias": 0.008})
    assert consistency([biased], card, seek=False).agreement is Agreement.UNEXPLAINED
    assert consistency([biased], stated, seek=False).agreement is Agreement.AGREE


def test_what_cannot_be_checked_is_said(sound, card):
    without = [FlightRecord.from_arrays("a", sound.time, {k: v for k, v in sound.channels.items() if k != "altitude"})]
    found = consistency(without, card, seek=False)
    assert found.agreement is Agreement.AGREE
    assert found.unchecked == ("altitude",)
    without = [FlightRecord.from_arrays("a", sound.time, {k: v for k, v in sound.channels.items() if k != "theta"})]
    assert consistency(without, card).agreement is Agreement.NOT_CHECKED


def test_a_lateral_accelerometer_that_does_not_fit_is_no_wind(card):
    """Two simulated records, elsewhere, whose lateral acceleration does not fit their sideslip, bank and rates."""
    paths = [SHARED / "records" / f"side_force_{i}.asc" for i in (1, 2)]
    if not all(path.is_file() for path in paths):
        pytest.skip("the records with a wrong lateral acceleration are not here")
    found = consistency([read_record(path, card.channels) for path in paths], card)
    assert found.agreement is Agreement.UNEXPLAINED or set(found.errors) <= {"accel_y_bias", "accel_y_scale"}
    assert not set(found.errors) - {"accel_y_bias", "accel_y_scale"}
    assert {"beta"} <= {d.channel for d in found.departures}
