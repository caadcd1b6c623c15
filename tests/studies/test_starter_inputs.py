"""A starter card of a file in legacy units reads its own file, once what says TODO is filled in."""

import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[1] / "flight" / "health"))
from flights import flight

from bayes_aero.flight.card.card import parse_card
from bayes_aero.flight.health import channel_health
from bayes_aero.flight.health.standard import standard_air
from bayes_aero.flight.reading.read_record import read_record
from bayes_aero.jobs.card.card_template import starter_card
from bayes_aero.model.derived_channels import with_sums

G, FOOT, LB, KNOT, DEG = 9.80665, 0.3048, 0.45359237, 1852.0 / 3600.0, np.pi / 180.0
SLUG, PSF = LB * G / FOOT**4, LB * G / FOOT**2
FILLED = {
    "mass": "390 slug", "Ix": "6600 slug-ft2", "Iy": "10300 slug ft^2", "Iz": "14750 SLUG-FT^2", "Ixz": "0 slug ft^2",
    "wing_area": "301 sq ft", "chord": "6.5 ft", "span": "46 ft", "tail_arm": "23 ft",
}  # fmt: skip


def columns(record):
    """Headings with their units, and the numbers in them."""
    rho = standard_air(record["altitude"])[0]
    qbar = 0.5 * rho * record["airspeed"] ** 2
    return {
        "TIME (SEC)": record.time, "TAS (KTS)": record["airspeed"] / KNOT, "ALT (FT)": record["altitude"] / FOOT,
        "AOA (DEG)": record["alpha"] / DEG, "AOS (DEG)": record["beta"] / DEG, "PITCH (DEG)": record["theta"] / DEG,
        "ROLL (DEG)": record["phi"] / DEG, "P (DEG/SEC)": record["p"] / DEG, "Q (DEG/SEC)": record["q"] / DEG,
        "R (DEG/SEC)": record["r"] / DEG, "NX (G)": record["ax"] / G, "NY (G)": record["ay"] / G,
        "NZ (G)": -record["az"] / G, "LEFT ELEVATOR (DEG)": record["elevator"] / DEG + 1.0,
        "RIGHT ELEVATOR (DEG)": record["elevator"] / DEG - 1.0, "THRUST (LBS)": 2000.0 + 9.0 * np.sin(record.time),
        "RHO (SLUG/FT3)": rho / SLUG, "QBAR (PSF)": qbar / PSF,
    }  # fmt: skip


@pytest.mark.parametrize("layout", ["brackets", "unit row"])
@pytest.mark.parametrize("density", [True, False])
def test_legacy_units_come_through(tmp_path, layout, density):
    record = flight(0, seconds=20.0)
    table = {k: x for k, x in columns(record).items() if density or not k.startswith("RHO")}
    split = [heading.rstrip(")").split(" (") for heading in table]
    first = ",".join(table) if layout == "brackets" else "\n".join(",".join(row) for row in zip(*split, strict=True))
    rows = zip(*table.values(), strict=True)
    path = tmp_path / "run.csv"
    path.write_text("\n".join([first, *(",".join(f"{x:.9g}" for x in row) for row in rows)]), encoding="utf-8")
    made = tomllib.loads(starter_card(path).text)
    todo = {key for key, value in made["aircraft"].items() if value == "TODO"}
    assert todo == set(FILLED)
    card = parse_card(made | {"aircraft": FILLED}, "made", "made.toml")
    read = read_record(path, card.channels)
    formed = with_sums(read, card)
    np.testing.assert_allclose(formed["elevator"], record["elevator"], atol=1e-8)
    np.testing.assert_allclose(formed["density"], standard_air(record["altitude"])[0], rtol=1e-6)
    np.testing.assert_allclose(formed["thrust"], (2000.0 + 9.0 * np.sin(record.time)) * LB * G, rtol=1e-6)
    np.testing.assert_allclose(formed["az"], record["az"], rtol=1e-6, atol=1e-6)
    assert ("density" in card.derived) == (not density)
    assert card.aircraft.mass == pytest.approx(390 * LB * G / FOOT)
    assert [f.sentence for f in channel_health([read], card) if f.grave] == []


def starter_of(tmp_path, *, without=(), **columns):
    """The starter card of a flight with these columns beside, as TOML, and its text."""
    record = flight(0, seconds=30.0)
    base = {"time": record.time, "alpha_deg": np.rad2deg(record["alpha"]), "theta_deg": np.rad2deg(record["theta"])}
    base |= {"ax": record["ax"], "az": record["az"], "TAS [m/s]": record["airspeed"], "alt [m]": record["altitude"]}
    both = {name: x for name, x in (base | columns).items() if name not in without}
    path = tmp_path / "run.csv"
    np.savetxt(path, np.stack(list(both.values()), axis=1), delimiter=",", header=",".join(both), comments="")
    text = starter_card(path).text
    return tomllib.loads(text), text


@pytest.mark.parametrize(
    ("left", "right"),
    [
        ("net_thrust_1", "net_thrust_2"), ("Thrust Eng1", "Thrust Eng2"), ("thrust_port", "thrust_stbd"),
        ("engine_thrust_left", "engine_thrust_right"), ("Left engine net thrust", "Right engine net thrust"),
        ("netthrst_l", "netthrst_r"),
    ],
)  # fmt: skip
def test_the_thrust_of_one_side_is_never_the_whole(tmp_path, left, right):
    thrust = 3000.0 + 100.0 * np.sin(flight(0, seconds=30.0).time)
    made, _ = starter_of(tmp_path, **{left: thrust, right: thrust + 50.0})
    assert {n: c["label"] for n, c in made["channels"].items() if "thrust" in n} == {
        "thrust_left": left, "thrust_right": right,
    }  # fmt: skip
    assert made["sums"]["thrust"] == ["thrust_left", "thrust_right"]


def test_what_the_file_has_is_not_said_to_be_missing(tmp_path):
    thrust = np.full(751, 3000.0) + np.arange(751)
    made, text = starter_of(tmp_path, thrust_left=thrust, **{"rho [kg/m^3]": np.full(751, 830.0) + np.arange(751)})
    assert made["constants"]["thrust"] == "TODO"
    assert "only thrust_left was" in text
    assert 'density = "standard atmosphere" # guess; what the file has was not taken' in text
    assert "ot recorded" not in text


@pytest.mark.parametrize("altitude", [True, False])
@pytest.mark.parametrize(
    ("unit", "size"), [("kg/m^3", 1.0), ("slug/ft^3", 515.3788), ("lb/ft^3", 16.018463), ("g/m^3", 1e-3)]
)
def test_the_unit_of_a_density_is_that_of_the_air(tmp_path, unit, size, altitude):
    rho = standard_air(flight(0, seconds=30.0)["altitude"])[0]
    made, _ = starter_of(tmp_path, without=() if altitude else ("alt [m]",), rho=rho / size)
    assert made["channels"]["density"]["unit"] == unit


@pytest.mark.parametrize("unit", ["rad/s", "deg/s"])
def test_rates_of_one_instrument_have_one_unit(tmp_path, unit):
    """The roll rate shows its unit by the bank angle; pitch and yaw rate, by themselves, could be of either."""
    record, size = flight(0, seconds=30.0), 1.0 if unit == "rad/s" else np.rad2deg(1.0)
    rates = {"p": size * record["p"], "q": size * record["q"], "r": size * record["r"]}
    made, _ = starter_of(tmp_path, without=("theta_deg",), phi_deg=np.rad2deg(record["phi"]), **rates)
    assert [made["channels"][name]["unit"] for name in "pqr"] == [unit] * 3
    told = {"r [rad/s]": record["r"], "p": rates["p"], "q": rates["q"]}
    made, _ = starter_of(tmp_path, without=("theta_deg",), phi_deg=np.rad2deg(record["phi"]), **told)
    assert made["channels"]["r"]["unit"] == "rad/s"  # what the file says itself stays
    assert made["channels"]["p"]["unit"] == unit  # and so does what the data say


def test_a_heading_and_a_yaw_rate_of_another_instrument_have_their_own_unit(tmp_path):
    """Heading in deg and yaw rate in deg/s beside angles in rad and rates in rad/s, none of them labelled."""
    record, deg = flight(0, seconds=30.0), np.rad2deg(1.0)
    angles = {name: record[name] for name in ("alpha", "beta", "theta", "phi")}
    rates = {"p": record["p"], "q": record["q"], "r": deg * record["r"]}
    heading = deg * record["psi"] + 90.0
    bare = ("alpha_deg", "theta_deg")
    made, _ = starter_of(tmp_path, without=bare, **angles, psi=heading, **rates)
    units = {name: made["channels"][name]["unit"] for name in (*angles, "psi", *rates)}
    assert units == {
        "alpha": "rad", "beta": "rad", "theta": "rad", "phi": "rad", "psi": "deg",
        "p": "rad/s", "q": "rad/s", "r": "deg/s",
    }  # fmt: skip
    made, _ = starter_of(tmp_path, without=bare, **{n: deg * x for n, x in angles.items()}, psi=heading)
    assert {made["channels"][name]["unit"] for name in (*angles, "psi")} == {"deg"}


@pytest.mark.parametrize(
    ("heading", "size", "unit"), [("eng N2", 85.0, "%"), ("N1", 80.0, "%"), ("N2", 14000.0, "rpm")]
)
def test_spool_speeds_are_no_forces(tmp_path, heading, size, unit):
    _, text = starter_of(tmp_path, **{heading: size + 0.01 * np.arange(751)})
    (line,) = [line for line in text.splitlines() if f'label = "{heading}"' in line]
    assert f'unit = "{unit}"' in line
