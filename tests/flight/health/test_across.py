"""Quantities that several channels make together: a wrong unit is told, and sound records are silent."""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from bayes_aero.model.records import with_sums

sys.path.insert(0, str(Path(__file__).parent))
from flights import card, changed, flight, smooth
from stranger import fly as flown
from stranger import plane

from bayes_aero.flight.card import read_card
from bayes_aero.flight.channel import Channel
from bayes_aero.flight.health import channel_health
from bayes_aero.flight.health.air import across, derivatives
from bayes_aero.flight.health.channel import frozen
from bayes_aero.flight.health.controls import answers_no_input, feedback
from bayes_aero.flight.reading import read_record
from bayes_aero.flight.record import FlightRecord
from bayes_aero.physics.aircraft import standard_air

BOOK = Path(__file__).parents[3].parent / "shared" / "book"
LBF, LB, FOOT, KNOT = 0.45359237 * 9.80665, 0.45359237, 0.3048, 1852.0 / 3600.0
SLUG = LB * 9.80665 / FOOT / FOOT**3  # kg/m3
UNITS = {
    "density": {"unit": "kg/m^3"}, "dynamic_pressure": {"unit": "Pa"}, "mach": {"unit": "1"},
    "static_pressure": {"unit": "Pa"}, "static_temperature": {"unit": "K"},
}  # fmt: skip


def air(record, altitude=None, warm=0.0):
    """Air data of the standard day at the altitude, warmer by some kelvin."""
    h = record["altitude"] if altitude is None else altitude
    rho, sound = standard_air(h)
    T = sound**2 / (1.4 * 287.05287)
    rho, V = rho * T / (T + warm), record["airspeed"]
    return {"density": rho, "dynamic_pressure": 0.5 * rho * V**2, "mach": V / (sound * np.sqrt((T + warm) / T))}


def findings(record, **changes):
    return channel_health([record], card(**UNITS, **changes))


@pytest.fixture(scope="module")
def sound():
    record = flight(0)
    return changed(record, **air(record))


def test_the_standard_atmosphere_is_the_published_one():
    """ISO 2533:1975, table 5: density and speed of sound at 0, 5, 11, 15 and 20 km."""
    rho, speed = standard_air(np.array([0.0, 5e3, 11e3, 15e3, 20e3]))
    np.testing.assert_allclose(rho, [1.225, 0.736116, 0.363918, 0.193674, 0.0880348], rtol=2e-5)
    np.testing.assert_allclose(speed, [340.294, 320.529, 295.069, 295.069, 295.069], rtol=2e-6)


@pytest.mark.parametrize("warm", [-40.0, -15.0, 0.0, 15.0, 30.0])
@pytest.mark.parametrize("altitude", [0.0, 4000.0, 9000.0])
def test_air_of_any_weather_is_silent(altitude, warm):
    record = flight(1, altitude=altitude, seconds=30.0)
    assert [*across(changed(record, **air(record, warm=warm)), card(**UNITS))] == []


@pytest.mark.parametrize(("name", "size", "unit"), [
    ("density", SLUG, "slug/ft^3"), ("density", LB / FOOT**3, "lb/ft^3"),
    ("dynamic_pressure", LBF / FOOT**2, "lbf/ft^2"), ("dynamic_pressure", 100.0, "hPa"),
])  # fmt: skip
@pytest.mark.parametrize("with_altitude", [True, False])
def test_a_unit_of_density_or_dynamic_pressure_is_told(sound, name, size, unit, with_altitude):
    record = changed(sound, without=() if with_altitude else ("altitude",), **{name: sound[name] / size})
    told = [f for f in findings(record) if f.fault in ("unit", "load", "density")]
    assert [(f.channel, f.fault) for f in told] == [(name, "unit")]
    assert f'set unit = "{unit}" for {name}' in told[0].sentence
    assert told[0].grave == (name == "density")  # nothing rests on the dynamic pressure


def test_wrong_units_show_in_level_flight_and_in_the_density(sound):
    """CL = m g/(qbar S): 5700 x 9.80665/(0.5 x 0.0016 x 6400 x 28) is some 390."""
    record = changed(sound, without=("altitude", "dynamic_pressure", "mach"), density=sound["density"] / SLUG)
    (told,) = [f for f in findings(record) if f.fault == "load"]
    assert told.grave
    assert told.channel == "density"
    assert "density were in slug/ft^3 (the card says kg/m^3)" in told.sentence
    small = card(**UNITS)
    small = replace(small, aircraft=replace(small.aircraft, mass=1500.0, wing_area=28.0 / FOOT**2))
    told = [f for f in across(changed(sound, without=("altitude", "mach")), small) if f.fault == "load"]
    assert len(told) == 1
    assert "wing_area were in ft^2" in told[0].sentence
    told = [f for f in across(changed(sound, altitude=sound["altitude"] / FOOT), card(**UNITS)) if f.fault == "unit"]
    assert [f.channel for f in told][:1] == ["altitude"]
    assert 'set unit = "ft" for altitude' in told[0].sentence


def test_a_constant_or_derived_density_is_held_against_the_altitude(sound):
    record = changed(sound, without=("density", "dynamic_pressure", "mach"))
    assert [*across(record, card(constants={"density": "0.82 kg/m^3"}))] == []
    (told,) = across(record, card(constants={"density": "1.225 kg/m^3"}))  # sea level's, at 4 km
    assert (told.fault, told.channel, told.grave) == ("density", "density", True)

    def derived(record):
        made = replace(card(**UNITS), derived={"density": "dynamic pressure"})
        return [(f.channel, f.fault, f.grave) for f in channel_health([record], made) if f.fault in ("unit", "load")]

    record = changed(sound, without=("density",))
    assert derived(record) == []
    psf = changed(record, dynamic_pressure=record["dynamic_pressure"] / (LBF / FOOT**2))
    assert derived(psf) == [("dynamic_pressure", "unit", True)]


def test_airspeed_dynamic_pressure_and_mach_number_are_held_against_each_other(sound):
    record = changed(sound, airspeed=sound["airspeed"] * np.sqrt(sound["density"] / 1.225))
    assert ("airspeed_kind", "airspeed") in [(f.fault, f.channel) for f in across(record, card(**UNITS))]
    M = 0.85
    fast = changed(sound, airspeed=sound["airspeed"] * (M / sound["mach"]), mach=np.full(sound.n, M))
    q = 0.5 * fast["density"] * fast["airspeed"] ** 2
    impact = fast["dynamic_pressure"] * 0.0 + 0.7**-1 * q / M**2 * ((1.0 + 0.2 * M**2) ** 3.5 - 1.0)
    told = [*across(changed(fast, dynamic_pressure=impact), card(**UNITS))]
    assert [(f.channel, f.grave) for f in told] == [("dynamic_pressure", False)]
    assert "impact pressure" in told[0].sentence
    assert [*across(changed(fast, dynamic_pressure=q), card(**UNITS))] == []
    (told,) = across(changed(sound, without=("density", "dynamic_pressure"), airspeed=sound["airspeed"] / KNOT),
                     card(**UNITS))  # fmt: skip
    assert (told.channel, told.fault, told.grave) == ("airspeed", "unit", True)
    assert 'unit = "kt"' in told.sentence


@pytest.mark.parametrize(("off", "kind"), [(1.0, True), (0.96, True), (1.04, True), (1.0554, False), (0.94, False)])
def test_an_airspeed_is_calibrated_where_its_ratio_is_that_of_calibrated_airspeed(sound, off, kind):
    """The root of the density ratio is 0.813 at 4000 m: 0.858 is 5.5 % off. Without a name, the factor is told."""
    ratio = off * np.sqrt(sound["density"] / 1.225)
    found = [*across(changed(sound, airspeed=sound["airspeed"] * ratio, without=("mach",)), card(**UNITS))]
    assert {f.fault for f in found if f.fault != "load"} == {"airspeed_kind" if kind else "factor"}


@pytest.mark.parametrize("name", ["p", "q", "r"])
@pytest.mark.parametrize("dt", [0.02, 0.1])
def test_a_derivative_in_degrees_is_told(name, dt):
    record = flight(2, dt)
    rng = np.random.default_rng(1)
    slope = np.gradient(record[name], dt) + 0.02 * rng.standard_normal(record.n)
    unit = {f"{name}_dot": {"unit": "rad/s^2"}}
    assert [*derivatives(changed(record, **{f"{name}_dot": slope}), card(**unit))] == []
    (told,) = derivatives(changed(record, **{f"{name}_dot": np.rad2deg(slope)}), card(**unit))
    assert (told.channel, told.fault) == (f"{name}_dot", "unit")
    assert 'set unit = "deg/s^2"' in told.sentence
    (told,) = derivatives(changed(record, **{f"{name}_dot": -slope}), card(**unit))
    assert (told.channel, told.fault) == (f"{name}_dot", "sign")


def test_an_axis_that_is_not_excited_says_nothing():
    rng = np.random.default_rng(3)
    record = flight(3)
    still = {"r": 4e-4 * rng.standard_normal(record.n), "r_dot": 0.6 * rng.standard_normal(record.n)}
    assert [*derivatives(changed(record, **still), card(r_dot={"unit": "rad/s^2"}))] == []


TRIALS = BOOK.parent / "trials"
needs_trials = pytest.mark.skipif(not TRIALS.is_dir(), reason="the small inputs are not in ../shared/trials")
needs_book = pytest.mark.skipif(not BOOK.is_dir(), reason="the records of the book are not in ../shared/book")
ATTAS = {
    "time": (1, "s"), "ax": (2, "m/s^2"), "ay": (3, "m/s^2"), "az": (4, "m/s^2"), "p": (7, "deg/s"), "q": (8, "deg/s"),
    "r": (9, "deg/s"), "phi": (10, "deg"), "theta": (11, "deg"), "psi": (12, "deg"), "alpha": (13, "deg"),
    "beta": (14, "deg"), "airspeed": (15, "m/s"), "altitude": (16, "ft"), "p_dot": (17, "deg/s^2"),
    "q_dot": (18, "deg/s^2"), "r_dot": (19, "deg/s^2"), "calibrated_airspeed": (21, "kt"), "elevator": (22, "deg"),
    "mach": (31, "1"), "static_temperature": (32, "K"), "static_pressure": (33, "hPa"), "density": (34, "kg/m^3"),
}  # fmt: skip


def book(name, **changes):
    """A record of the book with the columns of cases.md, and what is said of it."""
    places = ATTAS | changes
    channels = tuple(Channel(key, unit, None, column) for key, (column, unit) in places.items())
    record = read_record(BOOK / name, channels)
    ours = replace(card(), channels=channels)
    return [*across(record, ours), *derivatives(record, ours)]


@needs_book
@pytest.mark.parametrize("name", ["fAttasElv1_pqrDot.asc", "fAttasAil1_pqrDot.asc", "fAttasRud1_pqrDot.asc"])
def test_the_records_of_the_book_are_silent_in_their_units_and_tell_others(name):
    own = {"p_dot": (46, "rad/s^2"), "q_dot": (47, "rad/s^2"), "r_dot": (48, "rad/s^2")}
    assert book(name) == []
    assert book(name, **own) == []
    axis = {"E": ("q_dot", 47), "A": ("p_dot", 46), "R": ("r_dot", 48)}[name[6]]
    told = book(name, **{axis[0]: (axis[1], "deg/s^2")})  # as the book's own program takes them (its case 32)
    assert [(f.channel, f.fault) for f in told] == [(axis[0], "unit")]


GAINS = (0.8, 0.5, 0.0, 0.0)  # of alpha, q, and the integrals of alpha and theta
LAWS = {  # gains, true or measured outputs, lag of the actuator, noise of the recorded surface, rad, its step, interval
    "measured outputs": {},
    "true outputs": {"measured": False},
    "true outputs, noisy surface": {"measured": False, "surface": 5e-4},
    "an actuator": {"lag": 0.15},
    "rounded": {"step": np.deg2rad(0.02)},
    "100 Hz": {"measured": False, "dt": 0.01},
    "no noise": {"noise": 0.0},
    "a pitch damper": {"gains": (0.0, 0.6, 0.0, 0.0)},
    "integral of alpha": {"gains": (0.0, 0.5, 0.5, 0.0)},
    "integral of alpha, noiseless surface": {"gains": (0.4, 0.5, 0.6, 0.0), "measured": False},
    "integral of theta": {"gains": (0.0, 0.5, 0.0, 0.25)},
    "integral of theta, an actuator": {"gains": (0.0, 0.5, 0.0, 0.25), "lag": 0.15, "noise": 0.1},
    "a slow actuator": {"lag": 0.3, "noise": 0.1},
    "a slow actuator, noiseless surface": {"lag": 0.3, "measured": False},
    "integral of theta, which is not recorded": {"gains": (0.4, 0.5, 0.0, 0.25), "without": ("theta",)},
    "integral of theta, not recorded, a lag": {"gains": (0.0, 0.5, 0.0, 0.25), "without": ("theta",), "lag": 0.15},
    "limits of the deflection": {"gust": 20.0, "limit": np.deg2rad(2.0)},
    "a limit of the rate": {"gust": 20.0, "rate": np.deg2rad(6.0), "surface": 3e-4},
    "both limits, an actuator": {"gust": 20.0, "limit": np.deg2rad(2.0), "rate": np.deg2rad(5.0), "lag": 0.1},
    "a limit of the rate, no theta": {"gust": 20.0, "rate": np.deg2rad(5.0), "without": ("theta",), "measured": False},
}


PILOTS = {
    "doublets": lambda t: np.where(t % 20.0 < 4.0, np.sign(np.sin(2.0 * np.pi * t / 4.0)), 0.0),
    "3211": lambda t: np.interp(t, [4.99, 5.0, 7.99, 8.0, 9.99, 10.0, 10.99, 11.0, 11.99, 12.0],
                                [0.0, 1.0, 1.0, -1.0, -1.0, 1.0, 1.0, -1.0, -1.0, 0.0]),
    "multisine": lambda t: 0.5 * sum(np.sin(0.4 * np.pi * k * t + k * k) for k in range(1, 9)),
}  # fmt: skip


def under_feedback(
    pilot=0.0, flown="doublets", *, gains=GAINS, measured=True, lag=0.0, surface=0.0, step=0.0, dt=0.04, noise=1.0,
    seconds=40.0, held=None, name="fed", gust=1.0, limit=np.inf, rate=np.inf, without=(),
):  # fmt: skip
    """A short period of dimensional derivatives in gusts under feedback and a pilot; `held` replaces the surface. What
    is asked of it is limited to `limit` rad, and its rate to `rate` rad/s."""
    rng, n = np.random.default_rng(3), round(seconds / dt)
    time = np.arange(n) * dt
    command = pilot * PILOTS[flown](time)
    x, wind, deflection, sums, rows = np.array([0.05, 0.0, 0.0]), 0.0, 0.04, np.zeros(2), []
    for k in range(n):
        y = x + noise * np.array([8e-4, 4e-4, 4e-4]) * rng.standard_normal(3)
        seen = y if measured else x
        asked = np.array(gains) @ (*seen[:2], *sums) + command[k]
        sums = sums + dt * seen[[0, 2]]
        change = (np.clip(asked, -limit, limit) - deflection) * (1.0 if lag == 0.0 else 1.0 - np.exp(-dt / lag))
        deflection += np.clip(change, -rate * dt, rate * dt)
        deflection = deflection if held is None else held[k]
        rows.append((*y, deflection + surface * rng.standard_normal()))
        for _ in range(4):
            wind += -0.25 * dt * wind + 4e-3 * gust * np.sqrt(0.25 * dt) * rng.standard_normal()
            alpha, q = x[0] + wind, x[1]
            slopes = [-0.9 * alpha + q - 0.1 * deflection, -3.0 * alpha - 1.2 * q - 4.0 * deflection, q]
            x = x + 0.25 * dt * np.array(slopes)
    alpha, q, theta, elevator = np.transpose(rows)
    elevator = step * np.round(elevator / step) if step else elevator
    channels = {"alpha": alpha, "q": q, "theta": theta, "elevator": elevator, "az": -9.8 - 60.0 * alpha}
    return FlightRecord.from_arrays(name, time, {key: x for key, x in channels.items() if key not in without})


@pytest.mark.parametrize("law", LAWS)
def test_a_surface_that_only_follows_the_outputs_is_told(law):
    (finding,) = feedback([under_feedback(**LAWS[law])], read_card("short_period"))
    assert (finding.channel, finding.fault, finding.grave) == ("elevator", "feedback", True)
    assert "follows the recorded" in finding.sentence


@pytest.mark.parametrize("pilot", [0.0, 0.3])
def test_a_wing_leveller_with_an_integral_is_told_from_the_roll_rate_alone(pilot):
    """Aileron of 0.3 p + 0.4 phi + 0.15 times its integral in gusts; phi is not recorded. The pilot's is in degrees."""
    rng, dt = np.random.default_rng(5), 0.04
    time, (p, phi, total, wind), rows = np.arange(1500) * dt, np.zeros(4), []
    for command in np.deg2rad(pilot) * PILOTS["doublets"](time):
        aileron = 0.3 * p + 0.4 * phi + 0.15 * total + command
        rows.append((p + 4e-4 * rng.standard_normal(), aileron + 2e-4 * rng.standard_normal()))
        wind += -0.5 * dt * wind + 0.3 * np.sqrt(dt) * rng.standard_normal()
        total, phi, p = total + dt * phi, phi + dt * p, p + dt * (-2.0 * p - 8.0 * aileron + wind)
    channels = dict(zip(("p", "aileron_left"), np.transpose(rows), strict=True))
    record = FlightRecord.from_arrays("rolling", time, channels)
    assert [f.channel for f in feedback([record], read_card("lateral"))] == ["aileron_left"] * (pilot == 0.0)


@pytest.mark.parametrize("seed", range(30, 34))
def test_steps_of_a_pilot_in_a_slow_stall_are_no_feedback_between_limits(seed):
    """Steps of 2 deg at the rate of the actuator, then 20 s of a slow pull in which the elevator only trims."""
    rng = np.random.default_rng(seed)
    time, *rows = flown(plane(rng), rng, 0.05, seconds=40.0)
    noise = {"airspeed": (0, 0.1), "alpha": (1, 8e-4), "theta": (2, 4e-4), "q": (3, 4e-4), "elevator": (7, 1e-4)}
    channels = {name: rows[row] + sd * rng.standard_normal(len(time)) for name, (row, sd) in noise.items()}
    record = FlightRecord.from_arrays("stall", time, channels)
    assert [*feedback([record], read_card("short_period"))] == []


def test_a_surface_that_moves_at_its_limits_and_at_the_ends_of_the_record_alone_is_judged():
    rng, n = np.random.default_rng(2), 1500
    elevator, noise = np.zeros(n), 1e-3 * rng.standard_normal((2, n))
    elevator[600:660] = 0.1 * np.where(np.arange(60) // 3 % 2, 1.0, -1.0)
    elevator[[1, -2]], elevator[[0, 2, -1, -3]] = 0.08, -0.08
    channels = {"alpha": np.cumsum(noise[0]), "q": np.cumsum(noise[1]), "elevator": elevator}
    record = FlightRecord.from_arrays("steps", 0.04 * np.arange(n), channels)
    assert [*feedback([record], read_card("short_period"))] == []


@pytest.mark.parametrize("gust", [0.0, 1.0])
@pytest.mark.parametrize("flown", PILOTS)
def test_a_pilot_who_reaches_the_limits_of_the_surface_is_no_feedback(flown, gust):
    limits = {"limit": np.deg2rad(2.0), "rate": np.deg2rad(8.0)}
    record = under_feedback(np.deg2rad(3.0), flown, gust=gust, gains=np.zeros(4), without=("theta",), **limits)
    assert [*feedback([record], read_card("short_period"))] == []


@pytest.mark.parametrize("flown", PILOTS)
@pytest.mark.parametrize("law", LAWS)
def test_a_pilot_beside_the_feedback_parts_the_two(law, flown):
    """Inputs of 0.3 deg; one record with them serves the others that are fitted with it."""
    card, piloted = read_card("short_period"), under_feedback(np.deg2rad(0.3), flown, **LAWS[law])
    assert [*feedback([piloted], card)] == []
    assert [*feedback([under_feedback(**LAWS[law], name="other"), piloted], card)] == []


@pytest.mark.parametrize("flown", PILOTS)
def test_an_input_without_a_signal_is_told_where_the_aircraft_answers_one(flown):
    """The short period under doublets of 2 deg; the same aircraft in gusts alone needs no input."""
    moved = under_feedback(np.deg2rad(2.0), flown, gains=np.zeros(4))
    calm = under_feedback(0.0, gains=np.zeros(4))
    dead = [changed(record, elevator=np.full(record.n, 0.02)) for record in (moved, calm)]
    assert [answers_no_input(record) for record in (*dead, moved)] == [True, False, False]
    (finding,) = [f for f in channel_health(dead[:1], read_card("short_period")) if f.fault == "frozen"]
    assert (finding.channel, finding.grave) == ("elevator", True)


def test_an_input_without_a_signal_is_told_in_a_long_record_and_beside_a_stabilizer_that_trims():
    """Seven seconds of input in two minutes of gusts. What a stabilizer picks up of the elevator's signal is no cause;
    a stabilizer that makes the same motion is."""
    moved = under_feedback(np.deg2rad(2.0), "3211", gains=np.zeros(4), seconds=120.0)
    dead = changed(moved, elevator=np.full(moved.n, 0.02))
    assert answers_no_input(dead)
    assert answers_no_input(changed(dead, stabilizer=0.02 * moved["elevator"]))
    assert not answers_no_input(changed(dead, stabilizer=0.5 * moved["elevator"]))


@pytest.mark.parametrize("seed", range(4))
def test_pitching_by_the_inertia_of_roll_and_yaw_needs_no_input(seed):
    """A short period that p r and p^2 - r^2 pitch, of moments of inertia of 1, 6 and 6.5; the elevator is fixed."""
    rng, n, dt = np.random.default_rng(seed), 1000, 0.04
    p, r = 0.8 * smooth(rng, n, dt, 0.7), 0.2 * smooth(rng, n, dt, 0.7)
    x, rows = np.zeros(2), []
    for k in range(n):
        rows.append(x + np.array([8e-4, 4e-4]) * rng.standard_normal(2))
        turning = -3.0 * x[0] - 1.2 * x[1] + 5.5 / 6.0 * p[k] * r[k] - 0.05 * (p[k] ** 2 - r[k] ** 2)
        x = x + dt * np.array([-0.9 * x[0] + x[1], turning])
    alpha, q = np.transpose(rows)
    channels = {"alpha": alpha, "q": q, "p": p, "r": r, "elevator": np.full(n, 0.02)}
    record = FlightRecord.from_arrays("rolls", np.arange(n) * dt, channels)
    assert not answers_no_input(record)
    assert answers_no_input(changed(record, without=("p", "r")))  # which is why both are asked


@needs_book
@pytest.mark.parametrize(("model", "name", "pitches"), [
    ("full_six", "fAttasElv1.mat", True), ("full_six", "fAttasElv2.mat", True),
    ("hfb320", "hfb320_1_10.asc", True), ("full_six", "fAttasAil1.mat", False),
    ("full_six", "fAttasRud1.mat", False),
])  # fmt: skip
def test_records_of_the_book_without_their_elevator_are_told_where_it_was_flown(model, name, pitches):
    """cases.md: elevator 3-2-1-1 of ATTAS and HFB 320; aileron and rudder manoeuvres. As recorded all are sound."""
    card = read_card(model)
    record = read_record(BOOK / name, card.channels)
    dead = changed(record, elevator=np.full(record.n, record["elevator"].mean()))
    told = [[f.channel for f in frozen(r, card) if f.grave] for r in (record, dead)]
    assert told == [[], ["elevator"] if pitches else []]


@pytest.mark.parametrize("moved", [1, 3])
@pytest.mark.parametrize("trim", [0.0, 0.02])
def test_an_elevator_that_moves_in_the_first_samples_alone_follows_nothing(moved, trim):
    record = flight(0)
    elevator = np.where(np.arange(record.n) < moved, 0.05, trim)
    said = channel_health([changed(record, elevator=elevator)], card())
    assert {f.fault for f in said if f.channel == "elevator"} == {"frozen"}


RESTS = {  # of a surface that no law moves, rad at time in s
    "still": lambda t, _: 0.02 + 0.0 * t,
    "drifts": lambda t, _: 0.02 + 1e-4 * t,
    "creeps": lambda t, _: 0.02 + 2e-3 * np.exp(-t / 2.0),
    "comes back": lambda t, _: 0.02 + 0.035 * np.exp(-t / 0.4),
    "a pulse": lambda t, _: np.where(t < 1.0, 0.055, 0.02),
    "slow noise": lambda t, rng: 0.02 + 2e-3 * np.convolve(rng.standard_normal(len(t)), np.full(9, 1 / 3.0), "same"),
}


@pytest.mark.parametrize("surface", [0.0, 1e-4])
@pytest.mark.parametrize("seconds", [6.0, 10.0, 25.0])
@pytest.mark.parametrize("rest", RESTS)
def test_a_free_response_is_no_feedback(rest, seconds, surface):
    time = np.arange(round(seconds / 0.04)) * 0.04
    held = RESTS[rest](time, np.random.default_rng(8))
    record = under_feedback(seconds=seconds, surface=surface, held=held)
    assert [*feedback([record], read_card("short_period"))] == []


@needs_trials
def test_the_record_without_a_pilot_is_told():
    card = read_card("short_period")
    record = read_record(TRIALS / "feedback_only.csv", card.channels)
    assert [f.fault for f in channel_health([record], card) if f.grave] == ["feedback"]


@needs_book
@pytest.mark.parametrize(
    ("model", "name"),
    [("unstable", "unStabAC_sim.asc"), ("hfb320", "hfb320_1_10.asc"), ("attas_lateral", "fAttasAilRud1.asc")],
)
def test_pilots_of_the_book_are_no_feedback(model, name):
    """The unstable aircraft is under feedback of w beside the pilot's command (cases.md): its published fit holds."""
    card = read_card(model)
    assert [*feedback([read_record(BOOK / name, card.channels)], card)] == []


@needs_book
def test_the_dynamic_pressure_of_the_hfb_320_makes_its_density():
    """cases.md: 2 PDYN/V^2 is 0.7925 +- 0.0032 kg/m3."""
    channels = (Channel("time", "s", None, 1), Channel("dynamic_pressure", "Pa", None, 3),
                Channel("airspeed", "m/s", None, 5), Channel("q", "rad/s", None, 8),
                Channel("q_dot", "rad/s^2", None, 9))  # fmt: skip
    record = read_record(BOOK / "hfb320_1_10.asc", channels)
    ours = replace(card(), channels=channels, derived={"density": "dynamic pressure"})
    rho = with_sums(record, ours)["density"]
    assert np.mean(rho) == pytest.approx(0.7925, abs=5e-4)
    assert np.std(rho) == pytest.approx(0.0032, abs=5e-4)
    assert [*across(record, ours), *derivatives(record, ours)] == []
