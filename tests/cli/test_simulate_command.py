"""Synthetic records: what is hidden is in the file, nothing else is, and the file is a record like any other."""

from __future__ import annotations

import hashlib
import json

import numpy as np
import pandas as pd
import pytest

from bayes_aero.cli.choices import Manoeuvre
from bayes_aero.dynamics.simulated.manoeuvres import commands
from bayes_aero.dynamics.simulated.rigid_manoeuvres import lateral_commands
from bayes_aero.dynamics.simulated.trim import Trim
from bayes_aero.effects import CATALOGUE
from bayes_aero.flight.reading.read_record import read_record
from bayes_aero.simulate import request


def test_a_sensor_error_acts_when_it_is_recorded(flights):
    sound, biased = (pd.read_csv(path) for path in (flights.sound, flights.biased))
    assert np.allclose(biased["QRGY"] - sound["QRGY"], 0.3, atol=1e-9)  # deg/s, the card's unit
    others = [name for name in sound.columns if name != "QRGY"]
    assert np.allclose(sound[others], biased[others], rtol=0.0, atol=1e-9)


def test_the_flight_begins_in_level_flight_and_reaches_the_stall(flights, card):
    record = read_record(flights.sound, card.channels)
    assert record.n == 1001
    assert record.dt == pytest.approx(0.04)
    force = np.hypot(record["ax"][0], record["az"][0])
    assert force == pytest.approx(9.80665, rel=0.01)
    assert np.rad2deg(record["alpha"].max()) > 15.0
    speed_of_sound = record["airspeed"] / record["mach"]
    assert speed_of_sound[0] == pytest.approx(319.7, abs=1.0)  # ISO 2533 table, 5200 m: 319.7 m/s


def test_the_truth_is_beside_the_file(flights):
    truth = json.loads((flights.folder / "biased.csv.truth.json").read_text())
    assert truth["effects"] == {"pitch_rate_bias": {"pitch_rate_bias": pytest.approx(np.deg2rad(0.3))}}
    assert truth["seed"] == 3
    assert truth["file"]["sha256"] == hashlib.sha256(flights.biased.read_bytes()).hexdigest()
    assert truth["parameters"]["CLa"] == 3.6
    assert truth["provenance"]["versions"]["jax"]


def test_noise_is_that_of_the_sensors_and_of_the_seed(program, flights):
    arguments = ["--manoeuvre", "slow_stall", "--duration", "40", "--noise", "white", "--noise-scale", "2"]
    made = {}
    for name, seed in (("a.csv", 5), ("again.csv", 5), ("b.csv", 6)):
        done = program("simulate", *arguments, "--seed", seed, "--out", name, "--json")
        assert done.code == 0, done.err
        truth = json.loads(done.out)
        made[name] = pd.read_csv(name)
    pd.testing.assert_frame_equal(made["a.csv"], made["again.csv"])
    still = pd.read_csv(flights.sound)
    noise = made["a.csv"]["ALCG"] - still["ALCG"]
    assert noise.std() == pytest.approx(2 * 0.05, rel=0.1)  # deg, twice the card's
    assert truth["sensor_noise"]["alpha"] == pytest.approx(np.deg2rad(0.1))
    assert abs(np.corrcoef(noise, made["b.csv"]["ALCG"] - still["ALCG"])[0, 1]) < 0.15


def test_every_standard_manoeuvre_can_be_chosen():
    time = np.arange(0.0, 60.0, 0.04)
    trim = Trim(0.1, 2e4, 0.0)
    longitudinal = commands(time, trim, 0.1, 0.0)
    known = {*longitudinal, *lateral_commands(time, trim, longitudinal["slow_stall"]), request.RANDOM_STALL}
    assert known == set(request.MANOEUVRES) == set(Manoeuvre)


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["--effect", "pitch_rat_bias=1"], "pitch_rate_bias"),
        (["--effect", "pitch_rate_bias"], "NAME=VALUE"),
        (["--effect", "flow_separation=3"], "flow_separation.alpha_star=VALUE"),
        (["--effect", "thrust_lag=-1"], "between 0 and 20"),
        (["--effect", "thrust_lag=1 kg"], "kg"),
        (["--effect", "kirchhoff_lift=1"], "no parameter"),
        (["--dt", "5"], "0.1 s"),
        (["--duration", "1000"], "random_stall"),
        (["--model", "nowhere.toml"], "nowhere.toml"),
    ],
)
def test_bad_requests_are_one_sentence(program, tmp_path, arguments, told):
    done = program("simulate", *arguments, "--out", "f.csv")
    assert done.code == 2
    assert told in done.err
    assert done.err.count("\n") == 1
    assert not list(tmp_path.iterdir())


def test_a_file_that_is_there_is_kept(program, tmp_path):
    (tmp_path / "flight.csv").write_text("precious")
    done = program("simulate", "--out", "flight.csv")
    assert done.code == 2
    assert "--force" in done.err
    assert (tmp_path / "flight.csv").read_text() == "precious"


def test_a_page_shows_the_record_and_its_truth(program, tmp_path):
    arguments = ["--manoeuvre", "slow_stall", "--duration", "20", "--effect", "thrust_lag=1", "--out", "a.csv"]
    assert program("simulate", *arguments, "--no-page").code == 0
    assert not (tmp_path / "a.csv.report.html").exists()
    assert program("simulate", *arguments, "--force").code == 0
    html = (tmp_path / "a.csv.report.html").read_text()
    assert "hidden effect: thrust_lag" in html
    assert "was not made" not in html


def test_a_folder_that_is_not_there_is_named(program):
    done = program("simulate", "--out", "nowhere/a.csv")
    assert done.code == 2
    assert "there is no folder nowhere" in done.err
    assert "Errno" not in done.err


def test_a_size_beyond_the_plausible_is_told(program):
    """Bounds are wider than what is plausible, so it is flown, but not without a word."""
    effect = CATALOGUE["pitch_rate_bias"]
    most = effect.sizes["pitch_rate_bias"][1]
    arguments = ["--manoeuvre", "slow_stall", "--duration", "20", "--no-page", "--force", "--out", "a.csv"]
    for size, told in ((0.9 * most, False), (-1.1 * most, True)):
        done = program("simulate", "--effect", f"pitch_rate_bias={size}", *arguments)
        assert done.code == 0, done.err
        assert ("largest plausible departure" in " ".join((done.out + done.err).split())) == told
