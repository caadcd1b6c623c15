"""The real files: every column lands in the channel that the publisher's list says, in SI."""

import time

import numpy as np
import pytest

from bayes_aero.flight.channel import STANDARD_CHANNELS, Channel
from bayes_aero.flight.reading import read_record

pytestmark = pytest.mark.attas

G = np.pi / 180
# name, unit in the file, column, first sample of qst01 in SI (typed off the file's first line)
LAYOUT = (  # of the pressure the list says hPa; the values are pascal (p = rho R T)
    ("time", "s", 1, 0.0), ("ax", "m/s^2", 2, 1.145436), ("ay", "m/s^2", 3, 0.0941775),
    ("az", "m/s^2", 4, -9.35899), ("p", "deg/s", 7, 0.35808659 * G), ("q", "deg/s", 8, 0.30738040 * G),
    ("r", "deg/s", 9, -0.01799775 * G), ("phi", "deg", 10, -1.7633063 * G), ("theta", "deg", 11, 6.7126475 * G),
    ("psi", "deg", 12, 2.2357386 * G), ("alpha", "deg", 13, 5.16904 * G), ("beta", "deg", 14, -0.793239 * G),
    ("airspeed", "m/s", 15, 98.74842), ("altitude", "m", 16, 5469.941), ("p_dot", "deg/s^2", 17, 0.43918934 * G),
    ("q_dot", "deg/s^2", 18, 1.4655458 * G), ("r_dot", "deg/s^2", 19, 0.0062481048 * G),
    ("radio_altitude", "m", 20, 787.8696), ("calibrated_airspeed", "m/s", 21, 77.27116),
    ("elevator", "deg", 22, 1.8355276 * G), ("stabilizer", "deg", 23, -1.3252772 * G),
    ("n1_left", "%", 24, 0.8326477), ("n1_right", "%", 25, 0.8559144), ("dlc_left", "deg", 26, -0.84823881 * G),
    ("dlc_right", "deg", 27, -0.83640264 * G), ("aileron_left", "deg", 28, -0.87378929 * G),
    ("aileron_right", "deg", 29, 0.08288121 * G), ("rudder", "deg", 30, -0.96240466 * G),
    ("mach", "1", 31, 0.3186875), ("static_temperature", "K", 32, 249.8909), ("static_pressure", "Pa", 33, 50956.0),
    ("density", "kg/m^3", 34, 0.7103676), ("latitude", "deg", 35, 53.659978 * G),
    ("longitude", "deg", 36, 10.869428 * G), ("thrust_left", "N", 37, 10281.97),
    ("thrust_right", "N", 38, 11068.86), ("fuel_used", "kg", 39, 1990.0), ("beta_dot", "deg/s", 40, 4.3097943 * G),
    ("gear", "1", 41, 0.0), ("alpha_dot", "deg/s", 42, 5.7248568 * G), ("flap", "deg", 43, 1.2531498 * G),
    ("spoiler_left", "deg", 44, 0.086010018 * G), ("spoiler_right", "deg", 45, 0.19280941 * G),
)  # fmt: skip
CHANNELS = tuple(Channel(name, unit, column=column) for name, unit, column, _ in LAYOUT)


ELSEWHERE = {  # of other aircraft; thrust is the sum of two columns here
    "thrust", "elevator_left", "elevator_right", "elevon_left", "elevon_right", "canard", "engine_speed", "throttle",
    "throttle_left", "throttle_right", "dynamic_pressure", "aileron",
}  # fmt: skip


def test_every_standard_channel_is_in_the_layout():
    assert {name for name, *_ in LAYOUT} == set(STANDARD_CHANNELS) - ELSEWHERE


@pytest.mark.parametrize(("name", "n", "end"), [("fAttas_qst01", 3001, 120.0), ("fAttas_qst02", 2051, 82.0)])
def test_extent(attas, name, n, end):
    record = read_record(attas / f"{name}.asc", CHANNELS)
    assert (record.name, record.n) == (name, n)
    assert record.time[-1] == pytest.approx(end)
    assert record.dt == pytest.approx(0.04, rel=1e-9)


def test_first_sample_is_right_and_soon_read(attas):
    record = read_record(attas / "fAttas_qst01.asc", CHANNELS)
    for name, _, _, value in LAYOUT:
        assert record[name][0] == pytest.approx(value, rel=1e-12, abs=1e-15), name
    read_record(attas / "fAttas_qst01.asc", CHANNELS)  # the unit registry is made once
    start = time.process_time()
    read_record(attas / "fAttas_qst01.asc", CHANNELS)
    assert time.process_time() - start < 0.2


@pytest.mark.parametrize("name", ["fAttas_qst01", "fAttas_qst02"])
def test_the_channels_agree_with_each_other(attas, name):
    """Units and columns by physics: the gas law, Mach, and the rates that are derivatives of other channels."""
    r = read_record(attas / f"{name}.asc", CHANNELS)
    np.testing.assert_allclose(r["static_pressure"], r["density"] * 287.05 * r["static_temperature"], rtol=0.01)
    np.testing.assert_allclose(r["mach"], r["airspeed"] / np.sqrt(1.4 * 287.05 * r["static_temperature"]), atol=0.03)
    for angle, rate in (("p", "p_dot"), ("q", "q_dot"), ("r", "r_dot"), ("alpha", "alpha_dot"), ("beta", "beta_dot")):
        taken = np.convolve(np.gradient(r[angle], r.dt), np.ones(9) / 9, "valid")
        given = np.convolve(r[rate], np.ones(9) / 9, "valid")
        assert np.polyfit(taken, given, 1)[0] == pytest.approx(1.0, abs=0.1), angle
