"""`bayes-aero simulate`, `card` and `check`: synthetic records, guesses about foreign ones, and all that is wrong."""

import errno
import hashlib
import json
import os
import re
import tomllib
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import get_args
from unittest.mock import Mock

import h5py
import numpy as np
import pandas as pd
import pytest
import six_axes as six
import stranger_six
from calling import answer, holds, page_of, refused, succeeded
from flight.flights import flight
from hypothesis import given, settings
from hypothesis import strategies as st
from stranger import fly, plane, write

from bayes_aero.dynamics.pilot import commands
from bayes_aero.dynamics.trim import Trim
from bayes_aero.effects import CATALOGUE
from bayes_aero.flight.card import parse_card, read_card, shipped_cards
from bayes_aero.flight.channel import ALIASES, Channel
from bayes_aero.flight.reading import read_record
from bayes_aero.flight.record import write_record
from bayes_aero.jobs.preparing import starter_card
from bayes_aero.model.records import with_sums
from bayes_aero.physics.aircraft import standard_air
from bayes_aero.simulate import Manoeuvre, demo
from bayes_aero.simulate.demo import Request
from bayes_aero.simulate.injection import synthetic


def test_a_sensor_error_acts_when_it_is_recorded_and_the_truth_is_beside_the_file(flights):
    sound, biased = (pd.read_csv(path) for path in (flights.sound, flights.biased))
    assert np.allclose(biased["QRGY"] - sound["QRGY"], 0.3, atol=1e-9)  # deg/s, the card's unit
    others = [name for name in sound.columns if name != "QRGY"]
    assert np.allclose(sound[others], biased[others], rtol=0.0, atol=1e-9)
    truth = json.loads((flights.folder / "biased.csv.truth.json").read_text())
    assert truth["effects"] == {"pitch_rate_bias": {"pitch_rate_bias": pytest.approx(np.deg2rad(0.3))}}
    assert truth["seed"] == 3
    assert truth["file"]["sha256"] == hashlib.sha256(flights.biased.read_bytes()).hexdigest()
    assert truth["parameters"]["CLa"] == 3.6
    assert truth["provenance"]["versions"]["jax"]


def test_noise_is_that_of_the_sensors(program, flights):
    """That a seed is a record, and another seed another one, is in test_simulated.py."""
    noisy = (*flights.asked, "--noise", "white", "--noise-scale", "2", "--seed", "5")
    truth = answer(program("simulate", *noisy, "--out", "a.csv", "--json"))
    noise = pd.read_csv("a.csv")["ALCG"] - pd.read_csv(flights.sound)["ALCG"]
    assert noise.std() == pytest.approx(2 * 0.05, rel=0.1)  # deg, twice the card's
    assert truth["sensor_noise"]["alpha"] == pytest.approx(np.deg2rad(0.1))


def test_every_standard_manoeuvre_can_be_chosen():
    flown = commands(np.arange(0.0, 60.0, 0.04), Trim(0.1, 2e4, 0.0), 0.1, 0.0, lateral=True)
    assert {*flown, demo.RANDOM_STALL} == set(demo.MANOEUVRES) == set(get_args(Manoeuvre))


def test_a_file_that_is_there_is_kept_and_a_size_beyond_the_plausible_is_told(program, flights):
    """Bounds are wider than what is plausible, so it is flown, but not without a word."""
    Path("a.csv").write_text("precious")
    size = -1.1 * CATALOGUE["pitch_rate_bias"].sizes["pitch_rate_bias"][1]
    asked = ("simulate", "--effect", f"pitch_rate_bias={size}", *flights.asked, "--out", "a.csv")
    refused(program(*asked), "--force")
    assert Path("a.csv").read_text() == "precious"
    done = succeeded(program(*asked, "--force"))
    assert "largest plausible departure" in " ".join((done.out + done.err).split())
    assert "largest plausible" not in flights.said


def test_an_aileron_doublet_rolls_and_errors_of_sensors_that_a_card_fixes_are_in_the_record():
    """At rest before it a gyro shows its bias, and an accelerometer gravity and its own."""
    card = read_card("full_six")
    record = synthetic(Request({}, "aileron_doublet", "none", duration=14.0), card, CATALOGUE).record
    assert record["q"][0] == pytest.approx(card.fixed["pitch_rate_bias"], abs=1e-9)
    for axis, felt in (("x", np.sin(record["theta"][0])), ("z", -np.cos(record["theta"][0]))):
        assert record[f"a{axis}"][0] == pytest.approx(9.80665 * felt + card.fixed[f"accel_{axis}_bias"], abs=1e-4)
    assert np.ptp(record["phi"]) > np.radians(4.0)


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
    known = {"mass": "8000 kg", "span": "15.492 m", "wing_area": "30 m^2", "Iy": "60000 kg m^2"}
    for key, unit in re.findall(r'^(\w+) = "TODO" # .*?(?:write "\.\.\. ([^"]*)"|$)', text, re.MULTILINE):
        text = text.replace(f'{key} = "TODO"', f'{key} = "{known.get(key, f"3 {unit}")}"')
    return text


def test_a_foreign_record_is_read_through_its_starter_card_and_guesses_are_told_on_a_page(program, foreign, tmp_path):
    path, truth = foreign
    content = answer(program("card", path, "--out", "mine.toml", "--json"))
    assert (content["channels"]["az"]["sign"], content["unknown"], content["not_found"]) == (-1, ["'Xyzzy'"], [])
    assert "mass" in content["todo"]
    text = (tmp_path / content["card"]).read_text()
    table = tomllib.loads(text)
    assert "separated_induced_drag" in table["model"]["effects"]
    assert "induced_share" not in table["model"]["fixed"]  # published and textbook drag of a stall differ by it
    assert table["channels"]["az"] == {"label": "nz", "unit": "g", "sign": -1}
    assert table["channels"]["elevator"]["sign"] == -1
    assert "Xyzzy" not in str(table)
    assert "Xyzzy" in text
    assert text.count("guess") > 15
    html = page_of(tmp_path, content["report"])
    todo = [key for key, value in table["aircraft"].items() if value == "TODO"]
    holds(html, f"{len(todo)} entries are to be filled in", "turned", *(f'<th scope="row">{key}</th>' for key in todo))
    holds(html, *(f"&#39;{entry['label']}&#39;" for entry in table["channels"].values()))
    assert "&#39;Xyzzy&#39;" in html.split("Columns without a proposal")[-1]
    (tmp_path / "mine.toml").write_text(filled(text))
    record = read_record(path, read_card(tmp_path / "mine.toml").channels)
    for name in ("alpha", "beta", "airspeed", "altitude", "p", "q", "r", "theta", "phi", "ax", "ay", "az", "elevator"):
        scale = np.abs(truth[name]).max()
        assert np.allclose(record[name], truth[name], rtol=1e-6, atol=1e-6 * scale), name
    checked = succeeded(program("check", path, "--model", "mine.toml", "--no-sensors"))
    assert "sign reversed" in checked.out


def test_an_unfilled_card_names_the_first_thing_missing_and_is_not_overwritten(program, foreign, tmp_path):
    path, card = foreign[0], tmp_path / "mine.toml"
    program("card", path, "--out", card)
    refused(program("check", path, "--model", card), "[aircraft] mass is still TODO", "[aircraft] Iy")
    card.write_text(card.read_text().replace('mass = "TODO"', 'mass = "1 t"'))
    refused(program("check", path, "--model", card), "[aircraft] Ix is still TODO")
    (tmp_path / "N123.toml").write_text("mine")
    refused(program("card", path), "--force")
    assert program("card", path, "--force").code == 0
    assert tomllib.loads((tmp_path / "N123.toml").read_text())["title"] == "the aircraft of N123"


def test_a_hostile_header_is_no_code_of_a_card(program):
    table = {"t": 0.1 * np.arange(60), 'al"pha\\': 0.1, "]\n[evil": 0.2, "remark": "climb", "TAS": 80.0}
    pd.DataFrame(table).to_csv("plain.csv", index=False)
    succeeded(program("card", "plain.csv"), 0, 2)


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
    said = " ".join(succeeded(program("check", "run.csv", "--model", "mine.toml")).out.split())
    assert ("state what did not move under [constants]" in said) == rolling
    assert ("Whether the sensors agree was not checked" in said) == rolling


def test_newtons_and_pounds_are_not_guessed_apart_nor_a_stall_without_alpha(program, foreign, tmp_path):
    """And what was not found is missed aloud."""
    table = pd.read_csv(foreign[0])
    table.assign(FN=1000.0 * table["FN"]).to_csv(tmp_path / "large.csv", index=False)
    succeeded(program("card", "large.csv", "--out", "mine.toml"))
    text = (tmp_path / "mine.toml").read_text()
    entry = next(line for line in text.splitlines() if line.startswith("thrust"))
    holds(entry, 'unit = "TODO"', "lbf")
    (tmp_path / "mine.toml").write_text(filled(text))
    refused(program("check", "large.csv", "--model", "mine.toml"), "thrust unit is still TODO")
    table.rename(columns={"AoA": "S0", "nx": "S1", "nz": "S2"}).to_csv("blind.csv", index=False)
    assert "Not found: ax, az" in succeeded(program("card", "blind.csv", "--out", "blind.toml")).out
    text = (tmp_path / "blind.toml").read_text()
    assert "alpha was not found, so nobody knows whether a stall is in the record" in text
    assert "alpha reaches" not in text
    html = page_of(tmp_path, "blind.toml.report.html")
    assert "ax and az were not found" in html.split("<h2")[0]
    rest = html.split("Columns that nothing was guessed for")[-1]
    holds(rest, "Columns without a name", *(f"&#39;{name}&#39;" for name in ("S0", "S1", "S2", "Xyzzy")))


def test_a_column_that_is_not_taken_leaves_the_others_their_places(program, tmp_path):
    """An elevator in thousands of degrees is no elevator: its entry asks for another column by its label."""
    t = 0.05 * np.arange(100)
    columns = {"t": t, "delta_e [deg]": 5000.0 * np.sin(t), "tas [m/s]": 80.0 + t, "thrust_l [N]": 1e9 * t}
    pd.DataFrame(columns).to_csv("odd.csv", index=False)
    assert program("card", "odd.csv", "--no-page").code == 0
    entries = tomllib.loads((tmp_path / "odd.toml").read_text())["channels"]
    assert entries["elevator"] == {"label": "TODO", "unit": "rad"}
    assert entries["airspeed"]["label"] == "tas [m/s]"


UNITS = st.sampled_from(["", " [deg]", "_rad", ' ["]', " (N)", "_kt"])
SIZES = st.sampled_from([1e-4, 0.1, 30.0, 1e4, 1e8])
COLUMNS = st.tuples(st.sampled_from(sorted(ALIASES)), UNITS, SIZES)


@settings(max_examples=60, deadline=None, derandomize=True, database=None)
@given(st.lists(COLUMNS, min_size=1, max_size=12, unique_by=lambda column: column[0]))
def test_every_starter_card_is_a_card_of_the_file_s_columns(columns):
    """Any columns of any size; each is in the card, or among those that nothing was guessed for."""
    rng, headings = np.random.default_rng(len(columns)), [name + unit for name, unit, _ in columns]
    values = rng.standard_normal((60, len(columns))) * [size for *_, size in columns]
    with TemporaryDirectory() as folder:
        path = Path(folder) / "any.csv"
        pd.DataFrame(values, columns=headings).to_csv(path, index=False)
        starter = starter_card(path)
    labels = {entry["label"] for entry in tomllib.loads(starter.text)["channels"].values()} - {"TODO"}
    guessed = {guess.column.label for guess in starter.found.values()}
    assert labels <= guessed
    assert guessed | {column.label for column in starter.unknown} == set(headings)


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


@pytest.mark.parametrize(("left", "right"), [("Thrust Eng1", "Thrust Eng2"), ("thrust_port", "thrust_stbd")])
def test_the_thrust_of_one_side_is_never_the_whole_and_not_said_to_be_missing(tmp_path, left, right):
    thrust = 3000.0 + np.arange(751)
    table, _ = starter_of(tmp_path, **{left: thrust, right: thrust + 50.0})
    thrusts = {n: c["label"] for n, c in table["channels"].items() if "thrust" in n}
    assert thrusts == {"thrust_left": left, "thrust_right": right}
    assert table["sums"]["thrust"] == ["thrust_left", "thrust_right"]
    table, text = starter_of(tmp_path, thrust_left=thrust, **{"rho [kg/m^3]": thrust - 2170.0})
    assert table["constants"]["thrust"] == "TODO"
    holds(text, "only thrust_left was", 'density = "standard atmosphere" # guess; what the file has was not taken')
    assert "ot recorded" not in text


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


@pytest.mark.parametrize(("unit", "size", "altitude"), [
    ("kg/m^3", 1.0, False), ("slug/ft^3", 515.3788, True), ("slug/ft^3", 515.3788, False), ("g/m^3", 1e-3, True),
])  # fmt: skip
def test_the_unit_of_a_density_is_that_of_the_air(tmp_path, unit, size, altitude):
    rho = standard_air(flight(0, seconds=30.0)["altitude"])[0]
    made, _ = starter_of(tmp_path, without=() if altitude else ("alt [m]",), rho=rho / size)
    assert made["channels"]["density"]["unit"] == unit


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


def test_a_gyro_bias_is_seen_without_aerodynamics_and_reported_on_request(program, flights):
    content = answer(program("check", flights.biased, "--json", "--out", "checked"), 3)  # usable, but in doubt
    assert content["usable"]
    assert content["consistency"]["outcome"] == "disagree_explained"
    assert content["uses"]["identify"]["possible"]
    assert content["sensors"]["agree"] is False
    size = content["sensors"]["errors"]["pitch_rate_bias"]["parameters"]["pitch_rate_bias"]
    assert size["mean"] == pytest.approx(np.deg2rad(0.3), rel=0.05)
    (record,) = content["records"]
    alpha = next(c for c in record["channels"] if c["name"] == "alpha")
    assert (alpha["place"], alpha["unit"], alpha["si"]) == ("'ALCG'", "deg", "rad")
    assert record["samples"] == 1001
    assert "spoiler_lift" in content["not_testable"]  # no spoiler moved
    page = page_of(Path("checked"))
    holds(page, "pitch_rate_bias", "Usable for identify, diagnose and fly", "spoiler_lift", "ALCG")
    assert json.loads(Path("checked/check.json").read_text())["usable"]


def test_everything_that_is_wrong_is_told_at_once(program, flights):
    table = pd.read_csv(flights.sound)
    table.loc[100, "THE"] = np.nan
    table["ALCG"] *= 57.3  # as if degrees had been converted once too often
    table["T"] = table["T"].where(table.index < 500, table["T"] + 1.0)
    table.drop(columns="VTASCG").assign(extra=1.0).to_csv("bad.csv", index=False)
    (record,) = answer(program("check", "bad.csv", "--no-sensors", "--json", "--out", "checked"), 1)["records"]
    holds(page_of(Path("checked")), "Not usable as it is", "airspeed")
    holds("\n".join(record["problems"]), "theta", "alpha", "gap", "airspeed")
    assert record["gaps"] == 1
    assert record["unused"] == ["'extra'"]


def test_what_a_lost_channel_costs_is_said(program, flights, tmp_path):
    card = tmp_path / "few.toml"
    text = shipped_cards()["attas"].read_text()
    card.write_text(text.replace('az = { column = 4, label = "AZCG", unit = "m/s^2" }\n', ""))
    done = succeeded(program("check", flights.sound, "--model", card, "--no-sensors"))  # trajectories are left
    assert list(tmp_path.iterdir()) == [card]
    said = " ".join(done.out.split())
    holds(said, "identify: not possible, no channel az", "because channel az")
    assert "'AZCG'" in said.split("In the file, not on the card: ")[1].split(". ")[0]


def test_a_full_disk_is_one_sentence(program, flights, monkeypatch):
    """What fails in the middle is in test_units_of_work.py."""
    monkeypatch.setattr(Path, "write_bytes", Mock(side_effect=OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))))
    done = program("check", flights.sound, "--no-sensors", "--out", "checked")
    assert done.code == 2
    assert done.err == "error: checked/check.json: No space left on device; check the path and the disk\n"
    assert not Path("checked/check.json").exists()


def test_a_record_without_sideslip_has_no_lateral_axis_and_an_elevator_that_holds_the_attitude_is_feedback(program):
    rng, plane = np.random.default_rng(11), stranger_six.Plane(**six.ATTACHED)
    columns = six.recorded(stranger_six.fly(plane, "rudder", rng, seconds=14.0), rng)
    pd.DataFrame(columns).drop(columns="beta").to_csv("blind.csv", index=False)
    text = six.card_text(plane).replace('beta = { label = "beta",', 'beta = { label = "beta", required = false,')
    Path("card.toml").write_text(text)
    said = " ".join(succeeded(program("check", "blind.csv", "--model", "card.toml", "--no-sensors"), 3).out.split())
    holds(said, "elevator follows the recorded", "axis (CY, Cl, Cn) is left out: record blind has no channel beta")


def test_a_unit_that_other_channels_refute_is_doubted(program, flights):
    """A file in knots that the card takes for SI, of which each number alone is plausible; `identify` says it too."""
    table = pd.read_csv(flights.sound)
    table.assign(VTASCG=table["VTASCG"] / 0.514444).to_csv("knots.csv", index=False)
    sound = answer(program("check", flights.sound, "--no-sensors", "--json"))
    assert sound["cautions"] == sound["health"] == []
    content = answer(program("check", "knots.csv", "--no-sensors", "--json"), 3)
    assert "airspeed is in kt and not in m/s, as the card says" in content["cautions"][0]
    first = content["health"][0]
    assert (first["channel"], first["fault"], first["grave"]) == ("airspeed", "unit", True)


def test_columns_that_the_card_does_not_map_are_listed_once(program, flights):
    """Two parts of one file, and one with another column."""
    table = pd.read_csv(flights.sound).assign(spare=1.0)
    for name, part in {"a": table.iloc[:500], "b": table.iloc[500:], "c": table.iloc[500:].assign(other=2.0)}.items():
        part.to_csv(f"{name}.csv", index=False)
    out = " ".join(program("check", "a.csv", "b.csv", "c.csv", "--no-sensors").out.split())
    first, second = [part.split(". ")[0] for part in out.split("In the file, not on the card: ")[1:]]
    assert "'spare'" in first
    assert "'other'" not in first
    assert "'spare', 'other'" in second
