"""What `card` guesses of names, units and signs, the reader accepts, whatever the format and the spelling of units."""

from itertools import cycle

import numpy as np
import pandas as pd
import pytest
import scipy.io
from flights import DEG, FOOT, KNOT, G, flight

from bayes_aero.flight.card import parse_card, parse_table
from bayes_aero.flight.channel import ALIASES, Channel, plain_heading, split_heading, symbol_of
from bayes_aero.flight.columns import guessed
from bayes_aero.flight.reading import inspect_record, read_raw, read_record
from bayes_aero.jobs.preparing import starter_card


# Headings of files that nobody here has written
@pytest.mark.parametrize(("heading", "channel", "unit"), [
    ("Q gyro [deg/s]", "q", "deg/s"), ("NZ up [g]", "az", "g"), ("Pitch Att [deg]", "theta", "deg"),
    ("measured AoA (deg)", "alpha", "deg"), ("TAS (kn)", "airspeed", "kt"), ("ADC_TAS_KT", "airspeed", "kt"),
    ("BOOM_AOA_DEG", "alpha", "deg"), ("INS_PITCH_DEG", "theta", "deg"), ("INS_Q [deg/s]", "q", "deg/s"),
    ("INS_NZ_G", "az", "g"), ("UTC_SEC", "time", "s"), ("ENG_THRUST_LBF", "thrust", "lbf"),
    ("UTC Time (s)", "time", "s"), ("Longitudinal Acceleration (G)", "ax", "g"), ("Roll (deg)", "phi", "deg"),
    ("Lateral Acceleration (G)", "ay", "g"), ("Normal Acceleration (G)", "az", "g"), ("Pitch (deg)", "theta", "deg"),
    ("Roll Rate (deg/sec)", "p", "deg/s"), ("Yaw Rate (deg/sec)", "r", "deg/s"), ("Sideslip (deg)", "beta", "deg"),
    ("Magnetic Heading (deg)", "psi", "deg"), ("True Airspeed (kt)", "airspeed", "kt"),
    ("AirspeedTrue_kt", "airspeed", "kt"), ("Normal Accel [g]", "az", "g"), ("P_RATE", "p", None),
    ("alpha,__deg", "alpha", "deg"), ("Vtrue,_ktas", "airspeed", "kt"), ("Gload,norml", "az", None),
])  # fmt: skip
def test_words_beside_the_name_are_no_part_of_it(heading, channel, unit):
    key, its_unit = split_heading(plain_heading(heading))
    assert (ALIASES.get(key), its_unit) == (channel, unit)
    assert plain_heading("ADC_RAW") == "ADC_RAW"  # of such words alone


@pytest.mark.parametrize(("heading", "symbol"), [
    ("Long. Load Factor nx [g]", "nx"), ("Boom No. 2 AoA (deg)", "aoa"), ("ADC1_TAS", "tas"),
    ("No2_AoA_deg", "aoa"), ("Commanded theta [deg]", None), ("alpha limit [deg]", None), ("", None),
])  # fmt: skip
def test_a_symbol_at_the_end_names_the_channel(heading, symbol):
    assert symbol_of(heading) == symbol
    assert symbol is None or symbol in ALIASES


@pytest.mark.parametrize(("left", "right", "whole"), [
    ("AileronL [deg]", "AileronR [deg]", "aileron"), ("L_Aileron_deg", "R_Aileron_deg", "aileron"),
    ("SpoilerL", "SpoilerR", "spoiler"), ("Elevator LH (deg)", "Elevator RH (deg)", "elevator"),
    ("Left Elevon", "Right Elevon", "elevon"),
])  # fmt: skip
def test_halves_are_told_apart_and_from_the_whole(tmp_path, left, right, whole):
    """The left aileron alone is no aileron: it would be half of it, with the other sign."""
    columns = guesses(tmp_path, f"Time [s],{right},{left}", (TIME, WAVE, -WAVE))
    numbers = {name: guess.column.number for name, guess in columns.items()}
    assert numbers == {"time": 1, f"{whole}_right": 2, f"{whole}_left": 3}


def test_a_command_does_not_resemble_what_it_asks_for(tmp_path):
    assert list(guesses(tmp_path, "Time [s],elevator_cmd [deg]", (TIME, WAVE))) == ["time"]


# What `card` guesses from a file's own units, the reader accepts: one table serves both
N = 60
TIME = np.arange(N) * 0.04
WAVE = np.sin(np.linspace(0.0, 6.0, N))
LB = 0.45359237
LBF, SLUG = LB * G, LB * G / FOOT
CASES = [  # heading, channel, SI values, SI size of one of the unit, spellings
    ("AoA", "alpha", 0.1 + 0.05 * WAVE, DEG, "deg DEG Degrees ° degs"),
    ("AoA", "alpha", 0.1 + 0.05 * WAVE, 1.0, "rad RAD radians"),
    ("Q", "q", 0.05 * WAVE, DEG, "deg/s DEG/SEC dps °/s deg/sec degrees/second deg_s DPS"),
    ("qdot", "q_dot", 0.2 * WAVE, DEG, "deg/s2 deg/sec^2 DEG/S/S °/s² deg/s**2"),
    ("qdot", "q_dot", 0.2 * WAVE, 1.0, "rad/s2 RAD/SEC2"),
    ("TAS", "airspeed", 80.0 + 5.0 * WAVE, FOOT, "ft/s FT/SEC fps f/s feet/sec"),
    ("TAS", "airspeed", 80.0 + 5.0 * WAVE, KNOT, "kt kts KNOTS kn KTAS Kn"),
    ("TAS", "airspeed", 80.0 + 5.0 * WAVE, 1.0, "m/s M/S mps m/sec"),
    ("Nz", "az", -G - WAVE, G, "g G Gs g's"),
    ("az", "az", -G - WAVE, FOOT, "ft/s2 ft/sec^2 FT/S/S"),
    ("az", "az", -G - WAVE, 1.0, "m/s2 m/s/s M/S^2 m/s²"),
    ("Altitude", "altitude", 2000.0 + 20.0 * WAVE, FOOT, "ft FEET Ft"),
    ("rho", "density", 1.0 + 0.01 * WAVE, SLUG / FOOT**3, "slug/ft3 slugs/ft^3 SLUG/FT3 slug/cu\N{NO-BREAK SPACE}ft"),
    ("rho", "density", 1.0 + 0.01 * WAVE, LB / FOOT**3, "lb/ft3 lbm/ft^3"),
    ("rho", "density", 1.0 + 0.01 * WAVE, 1.0, "kg/m3 KG/M3 kg/m³"),
    ("qbar", "dynamic_pressure", 3000.0 + 99.0 * WAVE, LBF / FOOT**2, "psf PSF lbf/ft2 lb/ft2 lbs/ft^2"),
    ("PDYN", "dynamic_pressure", 3000.0 + 99.0 * WAVE, 100.0, "hPa HPA mb mbar"),
    ("Ps", "static_pressure", 8e4 + 99.0 * WAVE, 3386.388640341, "inHg INHG in\N{NO-BREAK SPACE}Hg in_Hg"),
    ("Ps", "static_pressure", 8e4 + 99.0 * WAVE, LBF / 0.0254**2, "psi PSIA lb/in2"),
    ("Thrust", "thrust", 9000.0 + 99.0 * WAVE, LBF, "lbf LBF lbs LBS lb pounds Lbs."),
    ("Thrust", "thrust", 9000.0 + 99.0 * WAVE, 1000.0, "kN KN"),
    ("Fuel_Used", "fuel_used", 500.0 + 9.0 * WAVE, LB, "lbs LBS lb lbm"),
    ("N1L", "n1_left", 0.7 + 0.05 * WAVE, 0.01, "% pct percent PCT"),
    ("EngineRPM", "engine_speed", 200.0 + 9.0 * WAVE, 2.0 * np.pi / 60.0, "rpm RPM rev/min"),
    ("RPM", "engine_speed", 200.0 + 9.0 * WAVE, 2.0 * np.pi / 60.0, "1/min"),
]
SPELLED = [(*case[:4], unit) for case in CASES for unit in case[4].split(" ")]
PITCHING = "Time [s],RollRate [deg/s],Roll [deg],PitchRate [deg/s],Pitch [deg],AoA [deg],Elevator [deg]"
LAYOUTS = {"brackets": "Time [s],{0} ({1})", "unit row": "Time,{0}\ns,{1}"}


def guesses(folder, header, columns):
    """What is guessed from a file of these columns: channels by name."""
    path = folder / "run.csv"
    np.savetxt(path, np.stack(columns, axis=1), delimiter=",", header=header, comments="", fmt="%.9g", encoding="utf-8")
    return guessed(read_raw(path).columns)[0]


@pytest.mark.parametrize(("layout", "heading", "channel", "si", "size", "unit"), [
    (layout, *spelled) for spelled, layout in zip(SPELLED, cycle(LAYOUTS), strict=False)
])  # fmt: skip
def test_a_guess_from_the_files_own_unit_passes_the_reader(tmp_path, layout, heading, channel, si, size, unit):
    columns = guesses(tmp_path, LAYOUTS[layout].format(heading, unit), (TIME, si / size))
    both = columns["time"], columns[channel]
    card = [Channel(g.channel, str(g.unit), label=g.column.label, sign=g.sign) for g in both]
    np.testing.assert_allclose(read_record(tmp_path / "run.csv", card)[channel], si, rtol=1e-6)


SWING = np.arange(400) * 0.04
SPEED = 80.0 + 5.0 * WAVE
BESIDE = {  # units of what follows from a channel beside it, s and SI: heading and values of both
    "q_dot": ("Time [s],Q [deg/s],Qdot", SWING, 0.1 * np.sin(SWING) / DEG, 0.1 * np.cos(SWING)),
    "dynamic_pressure": ("Time [s],TAS [m/s],Qbar", TIME, SPEED, 0.5 * 1.1 * SPEED**2),
}


@pytest.mark.parametrize(("name", "unit", "size"), [
    ("q_dot", "rad/s^2", 1.0), ("q_dot", "deg/s^2", DEG),
    ("dynamic_pressure", "Pa", 1.0), ("dynamic_pressure", "lbf/ft^2", LBF / FOOT**2),
])  # fmt: skip
def test_units_of_angular_acceleration_and_dynamic_pressure_show_in_rate_and_airspeed(tmp_path, name, unit, size):
    header, time, beside, values = BESIDE[name]
    assert guesses(tmp_path, header, (time, beside, values / size))[name].unit == unit


@pytest.mark.parametrize(
    ("units", "speed", "height"), [("m/s m", 1.0, 1.0), ("ft/s ft", FOOT, FOOT), ("km/h m", 1 / 3.6, 1)]
)
def test_the_turn_of_the_path_shows_units_that_the_climb_cannot(tmp_path, units, speed, height):
    """The climb is 0.87 times what it should be, as moving air makes it: nearer to km/h and ft than to m/s and m."""
    time, V = np.arange(0.0, 8.0, 0.05), 70.0
    alpha, theta = 0.06 + 0.03 * np.sin(2.0 * time), 0.06 + 0.06 * np.sin(1.0 * time)
    q, slope = 0.06 * np.cos(1.0 * time), 0.06 * np.cos(2.0 * time)  # of theta, of alpha
    az = -G * np.cos(theta) + V * (slope - q)
    climb = 0.87 * V * np.sin(theta - alpha)
    altitude = 2500.0 + 0.05 * np.cumsum(climb)
    columns = (time, np.full(len(time), V / speed), alpha, theta, q, az, altitude / height)
    given = guesses(tmp_path, "time,airspeed,alpha,theta,q,az,altitude", columns)
    assert f"{given['airspeed'].unit} {given['altitude'].unit}" == units


def test_noise_shows_neither_the_sign_of_a_rate_nor_that_of_the_elevator(tmp_path):
    """Wings that stay level and an elevator at rest, recorded with noise: the heading alone counts. Ten records."""
    time, rng = np.arange(0.0, 60.0, 0.04), np.random.default_rng(3)
    for _ in range(10):
        noise = 0.05 * rng.standard_normal((6, len(time)))
        noise[2] += np.cos(0.5 * time)
        noise[3] += 2.0 * np.sin(0.5 * time)
        columns = guesses(tmp_path, PITCHING, [time, *noise])
        assert [columns[name].sign for name in ("p", "q", "elevator")] == [1, 1, 1]
        assert "changes" not in columns["p"].evidence
        assert "follows" not in columns["elevator"].evidence


@pytest.mark.parametrize("sign", [1, -1])
def test_the_sign_of_a_rate_and_of_an_elevator_that_move_is_known(tmp_path, sign):
    time, rng = np.arange(0.0, 60.0, 0.04), np.random.default_rng(4)
    q, roll = 3.0 * np.sin(0.8 * time), 10.0 * np.sin(0.6 * time)
    pitch, alpha, elevator = -3.75 * np.cos(0.8 * time), 2.0 * np.sin(0.3 * time), -sign * 0.4 * np.gradient(q, time)
    table = np.stack([sign * np.gradient(roll, time), roll, q, pitch, alpha, elevator], axis=1)
    noisy = table + 0.05 * rng.standard_normal(table.shape)
    columns = guesses(tmp_path, PITCHING, [time, *noisy.T])
    assert [columns[name].sign for name in ("p", "q", "elevator")] == [sign, 1, sign]


@pytest.mark.parametrize(("size", "unit"), [(1.0, "rad"), (DEG, "deg")])
def test_a_heading_in_radians_makes_no_degrees_of_the_rest(tmp_path, size, unit):
    """Headings to 6.2 rad, attitude and flow angles of a tenth: none can be degrees. And the same in degrees."""
    time = np.arange(0.0, 40.0, 0.05)
    heading = np.mod(3.0 + 0.2 * time, 2.0 * np.pi)
    small = [0.1 + 0.05 * np.sin(f * time) for f in (0.5, 0.7, 0.9)]
    columns = guesses(tmp_path, "time,yaw,pitch,roll,alpha", [time, heading / size, *(x / size for x in small)])
    assert {columns[name].unit for name in ("psi", "theta", "phi", "alpha")} == {unit}


RATES, METRES = ("p", "q", "r"), {"airspeed": "m/s", "altitude": "m"}


def _turns(size=1.0):
    """Gentle turns and climbs from kinematics, coordinated, in SI: no angle exceeds 1.5 deg, no rate 0.5 deg/s."""
    time = np.arange(0.0, 60.0, 0.05)
    phi, theta = 0.02 * size * np.sin(0.3 * time), 0.02 * size * np.sin(0.25 * time)
    V = np.full(len(time), 80.0)
    alpha = 0.012 * size * (1.0 + np.sin(0.4 * time))
    turn = G / V * np.tan(phi)
    psi, climbing = np.cumsum(turn) * 0.05, np.gradient(theta, time)
    p, q = np.gradient(phi, time) - turn * np.sin(theta), climbing * np.cos(phi) + turn * np.sin(phi) * np.cos(theta)
    r = turn * np.cos(phi) * np.cos(theta) - climbing * np.sin(phi)
    altitude = 2000.0 + np.cumsum(V * np.sin(theta - alpha)) * 0.05
    return {
        "time": time, "phi": phi, "theta": theta, "psi": psi, "alpha": alpha, "p": p, "q": q, "r": r, "airspeed": V,
        "altitude": altitude,
    }  # fmt: skip


ATTITUDES, FLOW = ("p", "phi", "q", "theta"), ("theta", "alpha", "airspeed", "altitude")
SMALL = [  # channels beside time, those in degrees, those whose headings say so, the size of turns, the airspeed's unit
    # None of the attitudes is too large for radians. Where rates state no units, theirs and the others' are unlike.
    *((ATTITUDES, deg, ("p", "q"), 1.0, 1.0) for deg in ((), ("phi", "theta"), ("p", "q"), ("phi", "theta", "p", "q"))),
    *((ATTITUDES, deg, (), 1.0, 1.0) for deg in (("phi", "theta"), ("p", "q"))),
    # The climb makes the units of flow angles. Where neither is stated, both are in one unit.
    *((FLOW, deg, tuple(METRES), 1.0, 1.0) for deg in ((), ("alpha", "theta"))),
    *((FLOW, deg, (n, *METRES), 1.0, 1.0) for n in ("theta", "alpha")
      for deg in ((), ("alpha",), ("theta",), ("alpha", "theta"))),
    # The yaw rate has the unit of the turn: of the heading, and without one of the bank, whatever the airspeed is in.
    *(((*ATTITUDES, "r", "airspeed", *psi), deg, (*ATTITUDES, *psi), 4.0, speed) for psi in (("psi",), ())
      for deg in (("r",), ()) for speed in (1.0, KNOT, FOOT)),
]  # fmt: skip


@pytest.mark.parametrize(("names", "degrees", "stated", "size", "speed"), SMALL)
def test_small_motions_show_each_others_units(tmp_path, names, degrees, stated, size, speed):
    """With noise of 2 % of each signal."""
    true, rng = _turns(size), np.random.default_rng(5)
    units = {n: ("deg" if n in degrees else "rad") + ("/s" if n in RATES else "") for n in names} | METRES
    sizes = dict.fromkeys(degrees, DEG) | {"airspeed": speed}
    columns = [true[n] / sizes.get(n, 1.0) for n in names]
    noisy = [x + 0.02 * np.std(x) * rng.standard_normal(len(x)) for x in columns]
    header = ",".join(["time", *(f"{n} [{units[n]}]" if n in stated else n for n in names)])
    columns = guesses(tmp_path, header, [true["time"], *noisy])
    assert {n: columns[n].unit for n in names if n not in METRES} | METRES == {n: units[n] for n in names} | METRES


# A card that `card` makes passes `check` on its own file, whatever the format, once its TODO entries are filled in
FILLED = {"mass": "9000 kg", "wing_area": "28 m^2", "span": "14.2 m"}


def american(r):
    """The record as an American recorder writes it."""
    angles = {
        "AoA_deg": "alpha", "theta_deg": "theta", "phi_deg": "phi", "AOS_deg": "beta", "p_deg_s": "p", "q_deg_s": "q",
        "r_deg_s": "r", "elev_deg": "elevator", "psi_deg": "psi",
    }  # fmt: skip
    columns = {"time_s": r.time, **{heading: r[name] / DEG for heading, name in angles.items()}}
    columns |= {f"{name}_g": r[name] / G for name in ("ax", "ay", "az")}
    columns |= {"TAS_kts": r["airspeed"] / KNOT, "alt_ft": r["altitude"] / FOOT}
    return pd.DataFrame(columns | {"thrust_lbf": 9000.0 / LBF + 10.0 * np.sin(0.1 * r.time)})


def write(frame: pd.DataFrame, path) -> None:
    if path.suffix == ".csv":
        frame.to_csv(path, index=False, float_format="%.9g")
    elif path.suffix == ".mat":
        scipy.io.savemat(path, {"flight": {name: frame[name].to_numpy() for name in frame}})
    else:
        frame.to_xarray().to_netcdf(path, engine="h5netcdf")


@pytest.mark.parametrize("suffix", [".csv", ".mat", ".nc"])
def test_a_starter_card_passes_on_its_own_file(tmp_path, suffix):
    path, true = tmp_path / f"run{suffix}", flight(0, 0.05, 24.0)
    write(american(true), path)
    starter = starter_card(path)
    text = starter.text
    for key, meaning in starter.todo:
        assert key in ("mass", "Ix", "Iy", "Iz", "Ixz", "wing_area", "chord", "span", "tail_arm")
        unit = "kg m^2" if key.startswith("I") else "m"
        text = text.replace(f'{key} = "TODO"', f'{key} = "{FILLED.get(key, f"3 {unit}")}"')
        assert meaning
    card = parse_card(parse_table(text.encode(), "own"), "own", "own.toml")
    units = {channel.name: channel.unit for channel in card.channels}
    assert [units[name] for name in ("alpha", "airspeed", "altitude", "thrust")] == ["deg", "kt", "ft", "lbf"]
    looked = inspect_record(path, card)
    assert looked.problems == ()
    assert looked.record is not None
    for name in true.names:
        np.testing.assert_allclose(looked.record[name], true[name], rtol=1e-6, atol=1e-7 * np.ptp(true[name]))
