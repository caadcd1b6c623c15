"""Signs, axes, units, factors and air data that other channels of a record refute; sound records are silent."""

import re
from dataclasses import replace

import numpy as np
import pytest
from flights import BOOK, FOOT, KNOT, NOISE, UNITS, G, card, changed, flight, needs_book, smooth

from bayes_aero.flight.card import read_card
from bayes_aero.flight.health.air import air_data
from bayes_aero.flight.health.channel import channel_health
from bayes_aero.flight.health.kinematics import refuted
from bayes_aero.flight.reading import read_record
from bayes_aero.flight.record import FlightRecord
from bayes_aero.physics.aircraft import standard_air

LB = 0.45359237
LBF, SLUG = LB * G, LB * G / FOOT / FOOT**3  # N; kg/m3
AIR = {
    "density": {"unit": "kg/m^3"}, "dynamic_pressure": {"unit": "Pa"}, "mach": {"unit": "1"},
    "static_pressure": {"unit": "Pa"}, "static_temperature": {"unit": "K"},
}  # fmt: skip


def air(record, warm=0.0):
    """Air data of the standard day at the altitude, warmer by some kelvin."""
    rho, sound = standard_air(record["altitude"])
    T = sound**2 / (1.4 * 287.05287)
    rho, V = rho * T / (T + warm), record["airspeed"]
    return {"density": rho, "dynamic_pressure": 0.5 * rho * V**2, "mach": V / (sound * np.sqrt((T + warm) / T))}


def findings(record, **changes):
    return channel_health([record], card(**AIR, **changes))


@pytest.fixture(scope="module")
def sound():
    record = flight(0)
    return changed(record, **air(record))


def test_the_standard_atmosphere_is_the_published_one():
    """ISO 2533:1975, table 5: density and speed of sound at 0, 5, 11, 15 and 20 km."""
    rho, speed = standard_air(np.array([0.0, 5e3, 11e3, 15e3, 20e3]))
    np.testing.assert_allclose(rho, [1.225, 0.736116, 0.363918, 0.193674, 0.0880348], rtol=2e-5)
    np.testing.assert_allclose(speed, [340.294, 320.529, 295.069, 295.069, 295.069], rtol=2e-6)


@pytest.mark.parametrize("warm", [-40.0, 0.0, 30.0])
@pytest.mark.parametrize("altitude", [0.0, 9000.0])
def test_air_of_any_weather_is_silent(altitude, warm):
    record = flight(1, altitude=altitude, seconds=30.0)
    assert [*air_data(changed(record, **air(record, warm=warm)), card(**AIR))] == []


@pytest.mark.parametrize(("name", "size", "unit"), [
    ("density", SLUG, "slug/ft^3"), ("density", LB / FOOT**3, "lb/ft^3"),
    ("dynamic_pressure", LBF / FOOT**2, "lbf/ft^2"), ("dynamic_pressure", 100.0, "hPa"),
])  # fmt: skip
@pytest.mark.parametrize("without", [(), ("altitude",)])
def test_a_unit_of_density_or_dynamic_pressure_is_reported(sound, name, size, unit, without):
    record = changed(sound, without=without, **{name: sound[name] / size})
    (finding,) = [f for f in findings(record) if f.fault in ("unit", "load", "density")]
    assert (finding.channel, finding.fault) == (name, "unit")
    assert f'set unit = "{unit}" for {name}' in finding.sentence
    assert finding.grave == (name == "density")  # nothing rests on the dynamic pressure


def test_wrong_units_show_in_level_flight_and_in_the_density(sound):
    """CL = m g/(qbar S): 5700 x 9.80665/(0.5 x 0.0016 x 6400 x 28) is some 390."""
    record = changed(sound, without=("altitude", "dynamic_pressure", "mach"), density=sound["density"] / SLUG)
    (finding,) = [f for f in findings(record) if f.fault == "load"]
    assert (finding.channel, finding.grave) == ("density", True)
    assert "correct the unit of one of them" in finding.sentence
    feet = changed(sound, altitude=sound["altitude"] / FOOT)
    finding, *_ = [f for f in air_data(feet, card(**AIR)) if f.fault == "unit"]
    assert finding.channel == "altitude"
    assert 'set unit = "ft" for altitude' in finding.sentence


def test_a_constant_or_derived_density_is_held_against_the_altitude(sound):
    record = changed(sound, without=("density", "dynamic_pressure", "mach"))
    assert [*air_data(record, card(constants={"density": "0.82 kg/m^3"}))] == []
    (finding,) = air_data(record, card(constants={"density": "1.225 kg/m^3"}))  # sea level's, at 4 km
    assert (finding.fault, finding.channel, finding.grave) == ("density", "density", True)

    def derived(record):
        made = replace(card(**AIR), derived={"density": "dynamic pressure"})
        return [(f.channel, f.fault, f.grave) for f in channel_health([record], made) if f.fault in ("unit", "load")]

    record = changed(sound, without=("density",))
    assert derived(record) == []
    psf = changed(record, dynamic_pressure=record["dynamic_pressure"] / (LBF / FOOT**2))
    assert derived(psf) == [("dynamic_pressure", "unit", True)]


def test_airspeed_dynamic_pressure_and_mach_number_are_held_against_each_other(sound):
    record = changed(sound, airspeed=sound["airspeed"] * np.sqrt(sound["density"] / 1.225))
    assert ("factor", "dynamic_pressure") in [(f.fault, f.channel) for f in air_data(record, card(**AIR))]
    M = 0.85
    fast = changed(sound, airspeed=sound["airspeed"] * (M / sound["mach"]), mach=np.full(sound.n, M))
    q = 0.5 * fast["density"] * fast["airspeed"] ** 2
    assert [*air_data(changed(fast, dynamic_pressure=q), card(**AIR))] == []
    knots = changed(sound, without=("density", "dynamic_pressure"), airspeed=sound["airspeed"] / KNOT)
    (finding,) = air_data(knots, card(**AIR))
    assert (finding.channel, finding.fault, finding.grave) == ("airspeed", "unit", True)
    assert 'unit = "kt"' in finding.sentence


@needs_book
@pytest.mark.parametrize("name", ["fAttasElv1_pqrDot.asc", "fAttasAil1_pqrDot.asc", "fAttasRud1_pqrDot.asc"])
def test_the_records_of_the_book_are_silent_in_their_units(name):
    attas = read_card("full_six")
    assert [*air_data(read_record(BOOK / name, attas.channels), attas)] == []


TRIALS = BOOK.parent / "trials"
FORWARD_LEFT_UP, LATERAL = ("ay", "az", "q", "r", "theta", "psi"), ("phi", "psi", "beta", "p", "r", "ay")
FLU, AFT = (f"the axes of the sensors are {axes}" for axes in ("x forward, y left, z up", "x aft, y right, z up"))
IN_PITCH = (*LATERAL, "altitude")
AXES = [  # channels that are missing, turned, exchanged; the fault and words of the sentence
    ((), FORWARD_LEFT_UP, (), "axes", FLU),
    ((), ("q", "r", "theta", "psi"), (), "axes", "the axes of the rates are x forward, y left, z up"),
    ((), ("ax", "az", "p", "r"), (), "axes", AFT),
    ((), ("az", "r"), (("ax", "ay"), ("p", "q")), "axes", "the axes of the sensors are x right, y forward, z up"),
    ((), ("ay", "az"), (), "sign", ""),  # two wrong signs are as likely
    ((), ("ax", "ay", "az"), (), "sign", ""),  # of the other hand
    ((), ("q",), (), "sign", ""),
    (IN_PITCH, ("q", "az", "theta"), (), "axes", FLU),
    (LATERAL, ("q", "az"), (), "sign", f"as where {FLU}"),  # or two wrong signs
    (IN_PITCH, ("ax", "az", "q"), (), "sign", ""),  # of the other hand
    (LATERAL, ("q", "ax"), (), "sign", "as where the axes of the sensors are x aft, y left, z down"),  # turned about z
    (LATERAL, ("az",), (), "sign", ""),
]  # fmt: skip


@pytest.mark.parametrize(("missing", "turned", "exchanged", "fault", "named"), AXES)
def test_axes_and_signs_are_named_and_the_advice_followed_gives_a_sound_record(
    missing, turned, exchanged, fault, named
):
    """The frame is that of the file; each channel that changes is in the advice, and no other."""
    true = changed(flight(1, seconds=30.0, bank=0.0) if missing else flight(0, seconds=30.0), without=missing)
    other = {name: -true[name] for name in turned}
    for first, second in exchanged:
        other |= {first: true[second], second: true[first]}
    record = changed(true, **other)
    findings = [f for f in channel_health([record], card_of(missing)) if f.grave]
    assert {f.fault for f in findings} == {fault}
    assert len(findings) == 1 or not named
    assert named in findings[0].sentence
    assert not missing or ("axes" in findings[0].sentence) == bool(named)
    advised = [re.findall(r"sign = -1 at ([\w, ]+) on the card", f.sentence)[0].split(", ") for f in findings]
    assert sorted(name for names in advised for name in names) == sorted(turned)
    places = dict([*exchanged, *(pair[::-1] for pair in exchanged)])
    followed = card_of(missing, **{
        name: {"unit": UNITS[name], "label": places.get(name, name), "sign": -1 if name in turned else 1}
        for name in (*turned, *places)
    })  # fmt: skip
    assert channel_health([read_as(record, followed)], followed) == ()


def card_of(missing, **changes):
    made = card(**changes)
    return replace(made, channels=tuple(c for c in made.channels if c.name not in missing))


def read_as(record, card):
    """The record as it is read through a card: our files hold SI in the units of our cards."""
    channels = {c.name: c.sign * record[c.heading] for c in card.channels if c.name != "time"}
    return FlightRecord.from_arrays(record.name, record.time, channels)


FRAMES = {  # the program's channel i is read from the file's channel order[i], with this sign
    "x forward, y right, z down": ((0, 1, 2), (1, 1, 1)),
    "x forward, y left, z up": ((0, 1, 2), (1, -1, -1)),
    "x aft, y right, z up": ((0, 1, 2), (-1, 1, -1)),
    "x aft, y left, z down": ((0, 1, 2), (-1, -1, 1)),
    "x right, y forward, z up": ((1, 0, 2), (1, 1, -1)),
}
SENSORS = (("p", "q", "r"), ("ax", "ay", "az"))


@pytest.mark.parametrize(("axes", "seed", "wrong"), [
    pytest.param(axes, k % 2, wrong, marks=() if wrong == (0, 0, 1, 3, 0)[k] else pytest.mark.verify)
    for k, axes in enumerate(FRAMES) for wrong in range(4)
])  # fmt: skip
def test_axes_are_named_despite_errors_of_scale_and_never_where_single_signs_are_wrong(axes, seed, wrong):
    """Up to four sensors are off by a scale of 0.75 to 1.33, and `wrong` of all channels count the other way."""
    rng = np.random.default_rng([seed, wrong, *axes.encode()])
    frame = tuple(zip(*FRAMES[axes], strict=True))
    record = flight(seed, seconds=30.0)
    kinds = (*(n for kind in SENSORS for n in kind), "phi", "theta", "psi", "alpha", "beta")
    scales = {name: 0.75 ** rng.uniform(-1.0, 1.0) for name in rng.choice(kinds, rng.integers(0, 5), replace=False)}
    true = {name: scales.get(name, 1.0) * record[name] for name in kinds}
    filed = true | {kind[j]: s * true[kind[i]] for kind in SENSORS for i, (j, s) in enumerate(frame)}
    flipped = rng.choice(kinds, wrong, replace=False)
    findings = channel_health([changed(record, **(filed | {name: -filed[name] for name in flipped}))], card())
    named = [re.search(r"the axes of the sensors are (x \w+, y \w+, z \w+) \(", f.sentence) for f in findings]
    if wrong:
        assert {m[1] for m in named if m} <= {axes}
        assert all(f.fault != "axes" or "sensors" in f.sentence for f in findings)
    else:
        assert [m[1] for m in named if m] == ([] if axes == "x forward, y right, z down" else [axes])


def test_units_that_are_not_advised():
    """An airspeed in ft/s that is 4.75 % too large is as near to km/h: 3.44 times as large as in m/s."""
    record = flight(0, seconds=30.0)
    (finding,) = refuted(changed(record, airspeed=1.0475 * record["airspeed"] / FOOT), card())[0]
    assert finding.fault == "factor"
    assert "airspeed is 3.4" in finding.sentence
    record = flight(2)
    wrong = changed(record, airspeed=record["airspeed"] * KNOT)  # the file is in m/s, the card says kt
    (finding,) = [f for f in channel_health([wrong], card(airspeed={"unit": "kt"})) if f.grave]
    assert 'unit = "m/s"' in finding.sentence
    assert 'unit = "kt"' not in finding.sentence


def gusty(record, size=1.5):
    """The record in turbulence of `size` m/s that moves the air data alone, in 2 s."""
    rng = np.random.default_rng(4)
    u, v, w = (size * smooth(rng, record.n, record.dt, 2.0) for _ in range(3))
    V = record["airspeed"]
    return changed(record, airspeed=V + u, alpha=record["alpha"] + w / V, beta=record["beta"] + v / V)


@pytest.mark.parametrize(("seed", "factor", "gust"), [
    (0, 1.85, 0.0), (2, 1.5, 1.0), (0, 0.7, 1.0),
])  # fmt: skip
def test_a_factor_of_the_airspeed_is_reported_with_its_error_and_no_bias(seed, factor, gust):
    record = gusty(flight(seed, 0.02, 40.0), gust)
    (finding,) = channel_health([changed(record, airspeed=factor * record["airspeed"])], card())
    assert (finding.channel, finding.fault, finding.grave) == ("airspeed", "factor", True)
    size, error = (float(x) for x in re.findall(r"is ([\d.]+) \+- ([\d.]+) times", finding.sentence)[0])
    assert abs(size - factor) < 3.0 * error < 0.1
    assert channel_health([record], card()) == ()


def test_a_turn_without_manoeuvres_does_not_tell_a_bias_of_ay_from_a_factor_of_the_airspeed():
    """V r cos(phi) = g sin(phi) of a level turn of 15 deg: k times the airspeed is sin(15 deg) (1/k - 1) g of ay."""
    n, phi, V = 751, np.deg2rad(15.0), 80.0
    rng, turn = np.random.default_rng(7), G / V * np.tan(phi)
    true = {"phi": phi, "psi": turn * 0.04 * np.arange(n), "p": 0.0, "r": turn * np.cos(phi), "ay": 0.0, "beta": 0.0}
    record = flight(0, seconds=30.0)
    true |= {"q": turn * np.sin(phi), "theta": 0.0, "alpha": 0.0, "ax": 0.0, "az": -G / np.cos(phi), "airspeed": V}
    noisy = {k: x + NOISE[k] * rng.standard_normal(n) for k, x in true.items()}
    noisy["airspeed"] *= 0.4
    findings = channel_health([changed(record, without=("altitude", "elevator"), **noisy)], card())
    assert not [f for f in findings if f.channel in ("ay", "airspeed")]


def off_by_a_tenth(record, rng, _):
    """Scale, and a bias."""
    bias = {"ax": 0.3, "ay": 0.3, "az": 0.3, "p": 0.003, "q": 0.003, "r": 0.003, "alpha": 0.01, "beta": 0.01}
    names = (*bias, "airspeed")
    return {n: rng.choice([0.9, 1.1]) * record[n] + rng.choice([-1.0, 1.0]) * bias.get(n, 2.0) for n in names}


def off_by_half(record, rng, seed):
    """An airspeed 1.17 times true, a normal acceleration of 1 g, other scales, biases and signs."""
    wrong = {name: record[name] * rng.uniform(0.6, 1.6) for name in ("alpha", "q", "az")}
    wrong |= {"airspeed": 1.17 * record["airspeed"] + 3.0 * smooth(rng, record.n, record.dt, 2.0)}
    wrong |= {"ax": record["ax"] + rng.uniform(-1.5, 1.5), "ay": record["ay"] + 0.16 * G}
    flipped = rng.choice(["az", "q", "theta", "phi"], seed % 3, replace=False)
    return wrong | {name: -wrong.get(name, record[name]) for name in flipped}


@pytest.mark.parametrize(("errors", "seed", "none"), [
    *((off_by_a_tenth, seed, {"unit", "airspeed_kind", "gravity", "load", "sign", "axes"}) for seed in range(1, 2)),
    *((off_by_half, seed, {"unit", "gravity", "load"}) for seed in range(3)),
])  # fmt: skip
def test_no_unit_is_claimed_of_sensors_with_errors_of_scale_bias_and_sign(errors, seed, none):
    """All units are right."""
    record, rng = flight(seed % 4, seconds=30.0), np.random.default_rng(seed)
    wrong = changed(record, **errors(record, rng, seed))
    assert not {f.fault for f in channel_health([wrong], card())} & none


def test_thrust_in_thousands_is_reported_and_thrust_of_idle_is_not():
    """A tenth of the weight of 17.5 t is 17 kN."""
    record, known = flight(0), card(thrust={"unit": "N"})
    for size, faults in ((1.5e4, []), (500.0, []), (15.0, [("thrust", "unit", False)])):
        findings = channel_health([changed(record, thrust=np.full(record.n, size))], known)
        assert [(f.channel, f.fault, f.grave) for f in findings if f.fault == "unit"] == faults


def test_time_in_another_unit_is_reported():
    record = flight(22, 0.2)
    findings = channel_health([changed(record, time=record.time * 1e-3)], card(time={"unit": "ms"}))
    (finding,) = [f for f in findings if f.fault == "unit"]
    assert 'unit = "s" for it on the card' in finding.sentence


@pytest.mark.skipif(not TRIALS.is_dir(), reason="the small inputs of a user are not in ../shared/trials")
def test_the_axes_of_a_simulated_stall_are_named_and_its_elevator_is_not_blamed():
    """README of the inputs: sensors x forward, y left, z up. Yaw rate and heading turn together there."""
    attas = read_card("attas")
    record = read_record(TRIALS / "axes_flu.csv", attas.channels)
    (finding,) = [f for f in channel_health([record], attas) if f.grave]
    assert finding.fault == "axes"
    assert "x forward, y left, z up" in finding.sentence
    assert set(re.search(r"sign = -1 at ([\w, ]+) on", finding.sentence)[1].split(", ")) == set(FORWARD_LEFT_UP)
    channels = tuple(replace(c, sign=-1) if c.name in FORWARD_LEFT_UP else c for c in attas.channels)
    followed = replace(attas, channels=channels)
    assert channel_health([read_record(TRIALS / "axes_flu.csv", channels)], followed) == ()
