"""Starter cards: a foreign record's names, units and signs are guessed right, and the rest is asked for."""

import re
import tomllib
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pandas as pd
import pytest
from calling import answer, holds, refused, succeeded
from flight.flights import flight
from hypothesis import given, settings
from hypothesis import strategies as st
from stranger import fly, plane
from stranger_records import write

from bayes_aero.errors import InputError
from bayes_aero.flight.atmosphere import standard_air
from bayes_aero.flight.card.card import parse_card, read_card, shipped_cards
from bayes_aero.flight.channel import ALIASES, Channel
from bayes_aero.flight.health import channel_health
from bayes_aero.flight.reading.read_record import read_record
from bayes_aero.flight.writers import write_record
from bayes_aero.jobs.card_template import starter_card
from bayes_aero.model.derived_channels import with_sums

CONSTANTS = {"mass": "8000 kg", "span": "15.492 m", "wing_area": "30 m^2", "Iy": "60000 kg m^2"}


@pytest.fixture(scope="module")
def foreign(flights, card, tmp_path_factory):
    """The simulated stall as another house would write it; and the record as it was."""
    record = read_record(flights.sound, card.channels)
    deg = np.rad2deg
    table = pd.DataFrame(
        {
            "Time (sec)": record.time, "AoA": deg(record["alpha"]), "AOS [deg]": deg(record["beta"]),
            "KTAS": record["airspeed"] * 3600.0 / 1852.0, "PressAlt_ft": record["altitude"] / 0.3048,
            "RollRate": deg(record["p"]), "PitchRate": deg(record["q"]), "YawRate": deg(record["r"]),
            "PitchAngle": deg(record["theta"]), "Bank": deg(record["phi"]), "nx": record["ax"] / 9.80665,
            "ny": record["ay"] / 9.80665, "nz": -record["az"] / 9.80665, "ElevPos": -deg(record["elevator"]),
            "FN": (record["thrust_left"] + record["thrust_right"]) / 1000.0, "Xyzzy": record["q"],
        }
    )  # fmt: skip
    path = tmp_path_factory.mktemp("foreign") / "N123.csv"
    table.to_csv(path, index=False, float_format="%.9g")
    return path, record


def filled(text):
    """The card with its TODO entries filled in as a user would."""
    for key, unit in re.findall(r'^(\w+) = "TODO" # .*?(?:write "\.\.\. ([^"]*)"|$)', text, re.MULTILINE):
        text = text.replace(f'{key} = "TODO"', f'{key} = "{CONSTANTS.get(key, f"3 {unit}")}"')
    return text


def test_a_foreign_record_is_read_through_its_starter_card(program, foreign, tmp_path):
    path, truth = foreign
    succeeded(program("card", path, "--out", "mine.toml"))
    text = (tmp_path / "mine.toml").read_text()
    table = tomllib.loads(text)
    assert table["channels"]["az"] == {"label": "nz", "unit": "g", "sign": -1}
    assert table["channels"]["elevator"]["sign"] == -1
    assert "Xyzzy" not in str(table)
    assert "Xyzzy" in text
    assert text.count("guess") > 15

    (tmp_path / "mine.toml").write_text(filled(text))
    record = read_record(path, read_card(tmp_path / "mine.toml").channels)
    for name in ("alpha", "beta", "airspeed", "altitude", "p", "q", "r", "theta", "phi", "ax", "ay", "az", "elevator"):
        scale = np.abs(truth[name]).max()
        assert np.allclose(record[name], truth[name], rtol=1e-6, atol=1e-6 * scale), name
    checked = succeeded(program("check", path, "--model", "mine.toml", "--no-sensors"))
    assert "sign reversed" in checked.out


def test_an_unfilled_card_names_the_first_thing_missing_and_is_not_overwritten(program, foreign, tmp_path):
    path, _ = foreign
    program("card", path, "--out", "mine.toml")
    refused(program("check", path, "--model", "mine.toml"), "[aircraft] mass is still TODO", "[aircraft] Iy")
    text = (tmp_path / "mine.toml").read_text().replace('mass = "TODO"', 'mass = "1 t"')
    (tmp_path / "mine.toml").write_text(text)
    with pytest.raises(InputError, match=r"\[aircraft\] Ix is still TODO"):
        read_card(tmp_path / "mine.toml")
    (tmp_path / "N123.toml").write_text("mine")
    refused(program("card", foreign[0]), "--force")
    assert program("card", foreign[0], "--force").code == 0
    assert tomllib.loads((tmp_path / "N123.toml").read_text())["title"] == "the aircraft of N123"


def test_radians_metres_and_a_hostile_header(program, flights, card, tmp_path):
    record = read_record(flights.sound, card.channels)
    table = pd.DataFrame(
        {
            "t": record.time, 'al"pha\\': record["alpha"], "alpha": record["alpha"], "q": record["q"],
            "theta": record["theta"], "TAS": record["airspeed"], "h": record["altitude"], "az": record["az"],
            "]\n[evil": record["q"], "remark": ["climb"] * record.n,
        }
    )  # fmt: skip
    table.to_csv("plain.csv", index=False)
    done = program("card", "plain.csv")
    assert done.code in (0, 2)
    assert "Traceback" not in done.err
    table.drop(columns="]\n[evil").to_csv("plain.csv", index=False)
    succeeded(program("card", "plain.csv"))
    table = tomllib.loads((tmp_path / "plain.toml").read_text())
    units = {name: entry["unit"] for name, entry in table["channels"].items()}
    assert units["alpha"] == units["theta"] == "rad"
    assert (units["q"], units["airspeed"], units["altitude"], units["az"]) == ("rad/s", "m/s", "m", "m/s^2")
    assert table["derived"] == {"density": "standard atmosphere", "mach": "standard atmosphere"}
    assert table["constants"]["thrust"] == "TODO"


def test_density_and_mach_follow_from_the_altitude(flights, card, tmp_path):
    text = shipped_cards()["attas"].read_text()
    for name in ("density", "mach"):
        text = re.sub(rf"^{name} = .*$", "", text, count=1, flags=re.MULTILINE)
    text += '[derived]\ndensity = "standard atmosphere"\nmach = "standard atmosphere"\n'
    (tmp_path / "few.toml").write_text(text)
    few = read_card(tmp_path / "few.toml")
    record = read_record(flights.sound, few.channels)
    assert not record.has("density")
    formed = with_sums(record, few)
    # ISO 2533: 5000 m 0.7361 kg/m3 and 320.5 m/s; log density and sound are straight lines over 200 m.
    density = np.exp(np.interp(record["altitude"], [4500.0, 5000.0, 5500.0], np.log([0.7768, 0.7361, 0.6971])))
    assert np.allclose(formed["density"], density, rtol=5e-4)
    assert np.allclose(formed["mach"], read_record(flights.sound, card.channels)["mach"], rtol=1e-9)


@pytest.mark.parametrize(
    ("line", "words"), [('mach = "ideal gas"', "standard atmosphere"), ('thrust = "standard atmosphere"', "[derived]")]
)
def test_bad_rules_are_one_sentence(tmp_path, line, words):
    (tmp_path / "bad.toml").write_text(shipped_cards()["attas"].read_text() + f"[derived]\n{line}\n")
    with pytest.raises(InputError, match=re.escape(words)):
        read_card(tmp_path / "bad.toml")


def test_a_sign_survives_writing_and_reading(flights, card, tmp_path):
    record = read_record(flights.sound, card.channels)
    channels = [Channel("time", "s"), Channel("alpha", "deg"), Channel("az", "g", label="nz", sign=-1)]
    write_record(record, tmp_path / "up.csv", channels)
    assert pd.read_csv(tmp_path / "up.csv")["nz"].median() == pytest.approx(1.0, abs=0.15)
    assert np.allclose(read_record(tmp_path / "up.csv", channels)["az"], record["az"], atol=1e-12)


@pytest.mark.parametrize("rolling", [False, True])
def test_wings_that_stayed_level_let_the_sensors_be_checked(program, tmp_path, rolling):
    """Bank, sideslip and side force were not recorded: zero where roll and yaw rate stand still, unknown elsewhere."""
    rng = np.random.default_rng(31)
    p = plane(rng)
    rows = fly(p, rng, 0.05, seconds=40.0)
    write(tmp_path / "run.csv", rows, {}, rng)
    if rolling:
        table = pd.read_csv(tmp_path / "run.csv")
        table["PB_dps"] += 8.0 * np.sin(table["Time_s"])
        table.to_csv(tmp_path / "run.csv", index=False)
    succeeded(program("card", "run.csv", "--out", "mine.toml"))
    text = filled((tmp_path / "mine.toml").read_text())
    (tmp_path / "mine.toml").write_text(text)
    still = {"phi": "0 deg", "beta": "0 deg", "ay": "0 m/s^2"}
    assert tomllib.loads(text).get("constants", {}) == ({} if rolling else still)
    done = program("check", "run.csv", "--model", "mine.toml")
    said = " ".join(done.out.split())
    assert done.code == 0, done.err
    assert ("state what did not move under [constants]" in said) == rolling
    assert ("Whether the sensors agree was not checked" in said) == rolling


def test_guesses_are_told_on_a_page(program, foreign, tmp_path):
    path, _ = foreign
    succeeded(program("card", path, "--out", "mine.toml"))
    html = (tmp_path / "mine.toml.report.html").read_text().replace("<wbr>", "")
    assert "was not made" not in html
    table = tomllib.loads((tmp_path / "mine.toml").read_text())
    for entry in table["channels"].values():
        assert f"&#39;{entry['label']}&#39;" in html
    todo = [key for key, value in table["aircraft"].items() if value == "TODO"]
    assert f"{len(todo)} entries are to be filled in" in html
    assert all(f'<th scope="row">{key}</th>' in html for key in todo)
    assert "&#39;Xyzzy&#39;" in html.split("Columns without a proposal")[-1]
    assert "turned" in html


def test_newtons_and_pounds_are_not_guessed_apart_nor_a_stall_without_alpha(program, foreign, tmp_path):
    table = pd.read_csv(foreign[0])
    table["FN"] *= 1000.0
    table.to_csv(tmp_path / "large.csv", index=False)
    assert program("card", "large.csv", "--out", "mine.toml").code == 0
    entry = next(line for line in (tmp_path / "mine.toml").read_text().splitlines() if line.startswith("thrust"))
    holds(entry, 'unit = "TODO"', "lbf")
    (tmp_path / "mine.toml").write_text(filled((tmp_path / "mine.toml").read_text()))
    refused(program("check", "large.csv", "--model", "mine.toml"), "thrust unit is still TODO")
    pd.read_csv(foreign[0]).rename(columns={"AoA": "S1"}).to_csv("blind.csv", index=False)
    assert program("card", "blind.csv", "--out", "blind.toml", "--no-page").code == 0
    text = (tmp_path / "blind.toml").read_text()
    assert "alpha was not found, so nobody knows whether a stall is in the record" in text
    assert "alpha reaches" not in text


def test_accelerations_are_found_by_their_symbol_and_missed_aloud(program, foreign, tmp_path):
    table = pd.read_csv(foreign[0])
    named = table.rename(columns={"nx": "Long. Load Factor nx [g]", "nz": "Body axis nz [g]"})
    named.to_csv("named.csv", index=False)
    done = program("card", "named.csv", "--out", "named.toml")
    assert "Not found" not in done.out + done.err
    channels = tomllib.loads((tmp_path / "named.toml").read_text())["channels"]
    assert (channels["ax"]["label"], channels["az"]["label"]) == ("Long. Load Factor nx [g]", "Body axis nz [g]")
    assert channels["az"]["sign"] == -1
    table.rename(columns={"nx": "S1", "nz": "S2"}).to_csv("blind.csv", index=False)
    done = program("card", "blind.csv", "--out", "blind.toml")
    assert "Not found: ax, az" in done.out + done.err
    html = (tmp_path / "blind.toml.report.html").read_text().replace("<wbr>", "")
    assert "ax and az were not found" in html.split("<h2")[0]
    rest = html.split("Columns that nothing was guessed for")[-1]
    assert all(f"&#39;{name}&#39;" in rest for name in ("S1", "S2", "Xyzzy"))
    assert "Columns without a name" in rest


def test_guesses_for_machines_leave_the_drag_form_of_a_stall_open(program, foreign, tmp_path):
    """Published and textbook drag of a stall differ by one share; a card that fixed it would be called wrong."""
    told = answer(program("card", foreign[0], "--out", "mine.toml", "--no-page", "--json"))
    assert told["channels"]["az"]["sign"] == -1
    assert told["unknown"] == ["'Xyzzy'"]
    assert "mass" in told["todo"]
    assert (told["not_found"], told["report"]) == ([], None)
    model = tomllib.loads((tmp_path / told["card"]).read_text())["model"]
    assert "separated_induced_drag" in model["effects"]
    assert "induced_share" not in model["fixed"]


def test_a_column_that_is_not_taken_leaves_the_others_their_places(program, tmp_path):
    """An elevator in thousands of degrees is no elevator: its entry asks for another column by its label."""
    t = 0.05 * np.arange(100)
    table = pd.DataFrame({"t": t, "delta_e [deg]": 5000.0 * np.sin(t), "tas [m/s]": 80.0 + t, "thrust_l [N]": 1e9 * t})
    table.to_csv(tmp_path / "odd.csv", index=False)
    assert program("card", "odd.csv", "--no-page").code == 0
    entries = tomllib.loads((tmp_path / "odd.toml").read_text())["channels"]
    assert entries["elevator"] == {"label": "TODO", "unit": "rad"}
    assert entries["airspeed"]["label"] == "tas [m/s]"


@settings(max_examples=60, deadline=None, derandomize=True, database=None)
@given(st.data())
def test_every_starter_card_is_a_card(data):
    """Any columns of any size: the card is read back before it is written."""
    names = data.draw(st.lists(st.sampled_from(sorted(ALIASES)), min_size=1, max_size=12))
    units = data.draw(
        st.lists(st.sampled_from(["", " [deg]", "_rad", ' ["]', " (N)", "_kt"]), min_size=12, max_size=12)
    )
    sizes = data.draw(st.lists(st.sampled_from([1e-4, 0.1, 30.0, 1e4, 1e8]), min_size=12, max_size=12))
    rng = np.random.default_rng(len(names))
    with TemporaryDirectory() as folder:
        path = Path(folder) / "any.csv"
        columns = [name + unit for name, unit in zip(names, units, strict=False)]
        values = rng.standard_normal((60, len(names))) * sizes[: len(names)]
        pd.DataFrame(values, columns=columns).to_csv(path, index=False)
        try:
            starter = starter_card(path)
        except InputError:
            return
    tomllib.loads(starter.text)


def test_a_card_that_cannot_be_read_back_is_never_written(program, tmp_path, monkeypatch):
    monkeypatch.setattr("bayes_aero.jobs.card_template.sums_block", lambda *_: iter(['a = "b" = "c"']))
    (tmp_path / "one.csv").write_text("t,V\n" + "\n".join(f"{0.1 * i},80" for i in range(60)))
    done = program("card", "one.csv")
    assert done.code == 1
    assert "the starter card of one.csv was not written" in done.err
    assert not (tmp_path / "one.toml").exists()


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
    holds(text, "only thrust_left was", 'density = "standard atmosphere" # guess; what the file has was not taken')
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
