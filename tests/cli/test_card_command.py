"""Starter cards: a foreign record's names, units and signs are guessed right, and the rest is asked for."""

import re
import tomllib
from pathlib import Path
from tempfile import TemporaryDirectory

import h5py
import numpy as np
import pandas as pd
import pytest
from calling import answer, holds, refused, succeeded
from flight.flights import flight
from hypothesis import given, settings
from hypothesis import strategies as st
from stranger import fly, plane, write

from bayes_aero.errors import InputError
from bayes_aero.flight.card import parse_card, read_card
from bayes_aero.flight.channel import ALIASES, Channel
from bayes_aero.flight.reading import read_record
from bayes_aero.flight.record import write_record
from bayes_aero.jobs.preparing import starter_card
from bayes_aero.model.records import with_sums
from bayes_aero.physics.aircraft import standard_air

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


def test_a_foreign_record_is_read_through_its_starter_card_and_guesses_are_told_on_a_page(program, foreign, tmp_path):
    path, truth = foreign
    told = answer(program("card", path, "--out", "mine.toml", "--json"))
    assert (told["channels"]["az"]["sign"], told["unknown"], told["not_found"]) == (-1, ["'Xyzzy'"], [])
    assert "mass" in told["todo"]
    text = (tmp_path / told["card"]).read_text()
    table = tomllib.loads(text)
    assert "separated_induced_drag" in table["model"]["effects"]
    assert "induced_share" not in table["model"]["fixed"]  # published and textbook drag of a stall differ by it
    assert table["channels"]["az"] == {"label": "nz", "unit": "g", "sign": -1}
    assert table["channels"]["elevator"]["sign"] == -1
    assert "Xyzzy" not in str(table)
    assert "Xyzzy" in text
    assert text.count("guess") > 15
    html = (tmp_path / told["report"]).read_text().replace("<wbr>", "")
    assert "was not made" not in html
    assert all(f"&#39;{entry['label']}&#39;" in html for entry in table["channels"].values())
    todo = [key for key, value in table["aircraft"].items() if value == "TODO"]
    assert f"{len(todo)} entries are to be filled in" in html
    assert all(f'<th scope="row">{key}</th>' in html for key in todo)
    assert "&#39;Xyzzy&#39;" in html.split("Columns without a proposal")[-1]
    assert "turned" in html
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


def test_a_hostile_header_is_no_code_of_a_card(program):
    table = {"t": 0.1 * np.arange(60), 'al"pha\\': 0.1, "]\n[evil": 0.2, "remark": "climb", "TAS": 80.0}
    pd.DataFrame(table).to_csv("plain.csv", index=False)
    done = program("card", "plain.csv")
    assert done.code in (0, 2)
    assert "Traceback" not in done.err


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


def test_accelerations_are_missed_aloud(program, foreign, tmp_path):
    table = pd.read_csv(foreign[0])
    table.rename(columns={"nx": "S1", "nz": "S2"}).to_csv("blind.csv", index=False)
    done = program("card", "blind.csv", "--out", "blind.toml")
    assert "Not found: ax, az" in done.out + done.err
    html = (tmp_path / "blind.toml.report.html").read_text().replace("<wbr>", "")
    assert "ax and az were not found" in html.split("<h2")[0]
    rest = html.split("Columns that nothing was guessed for")[-1]
    assert all(f"&#39;{name}&#39;" in rest for name in ("S1", "S2", "Xyzzy"))
    assert "Columns without a name" in rest


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
def test_every_starter_card_is_a_card_of_the_file_s_columns(data):
    """Any columns of any size; each is in the card, or among those that nothing was guessed for."""
    names = data.draw(st.lists(st.sampled_from(sorted(ALIASES)), min_size=1, max_size=12, unique=True))
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
        starter = starter_card(path)
    labels = {entry["label"] for entry in tomllib.loads(starter.text)["channels"].values()}
    assert labels - {"TODO"} <= set(columns)
    assert {guess.column.label for guess in starter.found.values()} >= labels - {"TODO"}
    assert {column.label for column in (*starter.unknown, *(g.column for g in starter.found.values()))} == set(columns)


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


@pytest.mark.parametrize(("left", "right"), [
    ("net_thrust_1", "net_thrust_2"), ("Thrust Eng1", "Thrust Eng2"), ("thrust_port", "thrust_stbd"),
    ("engine_thrust_left", "engine_thrust_right"), ("Left engine net thrust", "Right engine net thrust"),
    ("netthrst_l", "netthrst_r"),
])  # fmt: skip
def test_the_thrust_of_one_side_is_never_the_whole(tmp_path, left, right):
    thrust = 3000.0 + 100.0 * np.sin(flight(0, seconds=30.0).time)
    made, _ = starter_of(tmp_path, **{left: thrust, right: thrust + 50.0})
    assert {n: c["label"] for n, c in made["channels"].items() if "thrust" in n} == {
        "thrust_left": left, "thrust_right": right,
    }  # fmt: skip
    assert made["sums"]["thrust"] == ["thrust_left", "thrust_right"]


def test_halves_are_summed_and_density_and_mach_follow_from_the_altitude(tmp_path):
    record = flight(0, seconds=30.0)
    whole = np.rad2deg(record["elevator"])
    halves = {"LEFT ELEVATOR (DEG)": whole + 1.0, "RIGHT ELEVATOR (DEG)": whole - 1.0}
    _, text = starter_of(tmp_path, **halves, **{"q [rad/s]": record["q"], "thrust [N]": 3000.0 + record.time})
    card = parse_card(tomllib.loads(filled(text)), "made", "made.toml")
    formed = with_sums(read_record(tmp_path / "run.csv", card.channels), card)
    density, sound = standard_air(record["altitude"])
    np.testing.assert_allclose(formed["elevator"], record["elevator"], atol=1e-8)
    np.testing.assert_allclose(formed["density"], density, rtol=1e-6)
    np.testing.assert_allclose(formed["mach"], record["airspeed"] / sound, rtol=1e-6)


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


DEGREES = np.rad2deg(1.0)
FLAT = ("alpha_deg", "theta_deg")


@pytest.mark.parametrize(("sizes", "stated"), [
    ({"p": 1.0, "q": 1.0, "r": 1.0}, {}),
    ({"p": DEGREES, "q": DEGREES, "r": DEGREES}, {}),
    ({"p": DEGREES, "q": DEGREES, "r": 1.0}, {"r": "r [rad/s]"}),  # what the file says itself stays
    ({"alpha": 1.0, "beta": 1.0, "theta": 1.0, "phi": 1.0, "psi": DEGREES, "p": 1.0, "q": 1.0, "r": DEGREES}, {}),
    ({"alpha": DEGREES, "beta": DEGREES, "theta": DEGREES, "phi": DEGREES, "psi": DEGREES}, {}),
])  # fmt: skip
def test_units_of_angles_and_rates_show_in_one_another(tmp_path, sizes, stated):
    """Roll rate shows its unit by bank angle, others go with it; heading and yaw rate may be of another instrument."""
    record = flight(0, seconds=30.0)
    bank = {} if "phi" in sizes else {"phi_deg": DEGREES * record["phi"]}
    columns = {stated.get(name, name): size * record[name] for name, size in sizes.items()}
    columns |= {"psi": columns["psi"] + 90.0} if "psi" in sizes else {}
    made, _ = starter_of(tmp_path, without=FLAT if "alpha" in sizes else FLAT[1:], **bank, **columns)
    units = {name: ("rad" if size == 1.0 else "deg") + "/s" * (name in "pqr") for name, size in sizes.items()}
    assert {name: made["channels"][name]["unit"] for name in sizes} == units


XPLANE = {
    "time": "_real,_time", "airspeed": "Vtrue,_ktas", "alpha": "alpha,__deg", "theta": "pitch,__deg",
    "phi": "_roll,__deg", "q": "____Q,rad/s", "az": "Gload,norml", "ax": "Gload,axial", "altitude": "__alt,ftmsl",
}  # fmt: skip


def test_columns_of_x_plane_are_found(tmp_path):
    record = flight(0, seconds=20.0)
    rows = (" | ".join(f"{x:.6f}" for x in row) for row in zip(*(record[name] for name in XPLANE), strict=True))
    (tmp_path / "run.txt").write_text("\n".join([" | ".join(XPLANE.values()), *rows]))
    assert set(XPLANE) <= set(starter_card(tmp_path / "run.txt").found)


def test_columns_of_a_structure_of_matlab_7_3_are_found(tmp_path):
    record, names = flight(0, seconds=20.0), ("time", "alpha", "q", "az", "airspeed")
    with h5py.File(tmp_path / "run.mat", "w", userblock_size=512) as file:
        group = file.create_group("flight")
        group.attrs["MATLAB_class"] = np.bytes_("struct")
        for name in names:
            group.create_dataset(name, data=record[name][None, :]).attrs["MATLAB_class"] = np.bytes_("double")
    with (tmp_path / "run.mat").open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file".ljust(124) + b"\0\2IM")
    assert set(names) <= set(starter_card(tmp_path / "run.mat").found)
