"""Synthetic records: what is hidden is in the file, nothing else is; records of three axes, flown with their states."""

import hashlib
import json
from dataclasses import replace
from typing import get_args

import numpy as np
import pandas as pd
import pytest
import six_axes as six
import stranger_six
from calling import answer, called, refused, succeeded, validated

from bayes_aero.dynamics.flight import AircraftDynamics
from bayes_aero.dynamics.pilot import commands
from bayes_aero.dynamics.trim import Steady, Trim, modes
from bayes_aero.effects import CATALOGUE
from bayes_aero.flight.card import read_card
from bayes_aero.flight.reading import read_record
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


def test_the_flight_begins_in_level_flight_and_reaches_the_stall(flights, card):
    record = read_record(flights.sound, card.channels)
    assert record.n == 1001
    assert record.dt == pytest.approx(0.04)
    force = np.hypot(record["ax"][0], record["az"][0])
    assert force == pytest.approx(9.80665, rel=0.01)
    assert np.rad2deg(record["alpha"].max()) > 15.0
    speed_of_sound = record["airspeed"] / record["mach"]
    assert speed_of_sound[0] == pytest.approx(319.7, abs=1.0)  # ISO 2533 table, 5200 m: 319.7 m/s


def test_noise_is_that_of_the_sensors(program, flights):
    """That a seed is a record, and another seed another one, is in test_simulated.py."""
    arguments = ["--manoeuvre", "slow_stall", "--duration", "40", "--noise", "white", "--noise-scale", "2"]
    truth = answer(program("simulate", *arguments, "--seed", "5", "--out", "a.csv", "--json"))
    noise = pd.read_csv("a.csv")["ALCG"] - pd.read_csv(flights.sound)["ALCG"]
    assert noise.std() == pytest.approx(2 * 0.05, rel=0.1)  # deg, twice the card's
    assert truth["sensor_noise"]["alpha"] == pytest.approx(np.deg2rad(0.1))


def test_every_standard_manoeuvre_can_be_chosen():
    time = np.arange(0.0, 60.0, 0.04)
    trim = Trim(0.1, 2e4, 0.0)
    known = {*commands(time, trim, 0.1, 0.0, lateral=True), demo.RANDOM_STALL}
    assert known == set(demo.MANOEUVRES) == set(get_args(Manoeuvre))


def test_a_file_that_is_there_is_kept(program, tmp_path):
    (tmp_path / "flight.csv").write_text("precious")
    refused(program("simulate", "--out", "flight.csv"), "--force")
    assert (tmp_path / "flight.csv").read_text() == "precious"


def test_a_size_beyond_the_plausible_is_told(program):
    """Bounds are wider than what is plausible, so it is flown, but not without a word."""
    most = CATALOGUE["pitch_rate_bias"].sizes["pitch_rate_bias"][1]
    arguments = ["--manoeuvre", "slow_stall", "--duration", "20", "--force", "--out", "a.csv"]
    for size, told in ((0.9 * most, False), (-1.1 * most, True)):
        done = succeeded(program("simulate", "--effect", f"pitch_rate_bias={size}", *arguments))
        assert ("largest plausible departure" in " ".join((done.out + done.err).split())) == told


SECONDS = 14.0
EFFECTS = (
    "attached_lift", "mach_lift", "elevator_moment", "pitching_moment", "pitch_damping", "profile_drag", "induced_drag",
    *six.LATERAL,
)  # fmt: skip


@pytest.fixture(scope="module")
def flown(tmp_path_factory):
    """Three manoeuvres of another simulator as files, and their aircraft."""
    folder, rng = tmp_path_factory.mktemp("stranger"), np.random.default_rng(11)
    plane = stranger_six.drawn(rng, **six.ATTACHED)
    for kind in ("elevator", "aileron", "rudder"):
        flight = six.recorded(stranger_six.fly(plane, kind, rng, seconds=SECONDS), rng)
        pd.DataFrame(flight).to_csv(folder / f"{kind}.csv", index=False)
    return folder, plane


def fitted(folder, plane, name, kinds, *arguments, **card):
    (folder / f"{name}.toml").write_text(six.card_text(plane, **card))
    files = [folder / f"{kind}.csv" for kind in kinds]
    options = ("--no-process-noise", "--no-figures", "--json", "--out", folder / name)
    succeeded(called(folder, "fly", *files, "--model", folder / f"{name}.toml", *options, *arguments))
    return json.loads((folder / name / "trajectories.json").read_text())


def recovered(found, plane):
    for name, row in found["parameters"].items():
        true = getattr(plane, name)
        assert abs(row["estimate"] - true) < 4.0 * row["sd_corrected"], name
        assert row["sd_corrected"] < 0.1 * abs(true) + 0.01, name


def moves_as(found, plane):
    """Modes within four standard errors of those of the true derivatives; what cannot be tested is said."""
    model, told = six.model(), validated(found, "trajectories")["motion"]
    steady = Steady(told["airspeed"], told["altitude"])
    true = modes(AircraftDynamics(model), six.values(plane, model), six.aircraft(plane), steady)
    assert [mode["name"] for mode in told["modes"]] == ["short period", "phugoid", "Dutch roll", "roll", "spiral"]
    for mode, right in zip(told["modes"], true, strict=True):
        off = complex(*mode["eigenvalue"]) - right.eigenvalue
        real, imaginary = mode["eigenvalue_sd"]
        assert abs(off.real) < 4.0 * real < 0.1, mode["name"]
        assert abs(off.imag) <= 4.0 * imaginary < 0.1, mode["name"]


def test_six_coefficients_come_back_from_three_manoeuvres(flown):
    folder, plane = flown
    found = fitted(folder, plane, "six", ("elevator", "aileron", "rudder"))
    assert found["converged"]
    assert len(found["parameters"]) == 22
    assert found["fitted_outputs"] == [
        "airspeed", "alpha", "beta", "p", "q", "r", "phi", "theta", "psi", "ax", "ay", "az",
    ]  # fmt: skip
    recovered(found, plane)
    assert set(found["initial_states"]["rudder"]) == {*found["fitted_outputs"][:9], "altitude"}
    page = (folder / "six" / "report.html").read_text()
    assert "Clda" in page
    moves_as(found, plane)
    assert all(name in page for name in ("Modes of motion", "Dutch roll", "spiral"))


def test_lateral_derivatives_come_back_with_the_longitudinal_motion_held(flown):
    folder, plane = flown
    found = fitted(folder, plane, "lateral", ("aileron", "rudder"), effects=six.LATERAL, axes=(six.BOTH[1],))
    assert found["fitted_outputs"] == ["beta", "p", "r", "phi", "psi", "ay"]
    assert any("Held to the record: airspeed, alpha, q, theta and altitude" in note for note in found["notes"])
    recovered(found, plane)
    assert [mode["name"] for mode in found["motion"]["modes"]] == ["Dutch roll", "roll", "spiral"]


def test_a_card_holds_further_states(flown):
    """Roll and yaw alone, sideslip and bank as recorded; what the vane's noise adds is not in the errors."""
    folder, plane = flown
    more = '[fly]\nheld = ["beta", "phi"]\noutputs = ["p", "r"]\n'
    card = {"effects": [n for n in six.LATERAL if not n.endswith("side_force")], "axes": (six.BOTH[1],), "more": more}
    found = fitted(folder, plane, "held", ("aileron", "rudder"), **card)
    assert found["fitted_outputs"] == ["p", "r"]
    assert found["motion"]["modes"] == []
    (why,) = (sentence for sentence in found["sentences"] if sentence.startswith("Modes of motion are not given"))
    assert "holds beta, phi to the record" in why
    for name in ("Clp", "Clda", "Cnbe", "Cndr"):
        assert found["parameters"][name]["estimate"] == pytest.approx(getattr(plane, name), rel=0.05)


def test_a_state_that_there_is_not_cannot_be_held(flown, program):
    folder, plane = flown
    (folder / "wrong.toml").write_text(six.card_text(plane, more='[fly]\nheld = ["bank"]\n'))
    refused(program("fly", folder / "rudder.csv", "--model", folder / "wrong.toml"), "[fly] held", "airspeed, alpha")


def test_a_record_without_sideslip_is_flown_without_the_lateral_axis(flown, program, tmp_path):
    folder, plane = flown
    table = pd.read_csv(folder / "rudder.csv").drop(columns="beta")
    table.to_csv(tmp_path / "blind.csv", index=False)
    text = six.card_text(plane).replace('beta = { label = "beta",', 'beta = { label = "beta", required = false,')
    (tmp_path / "card.toml").write_text(text)
    done = program("fly", "blind.csv", "--model", tmp_path / "card.toml", "--no-process-noise", "--no-figures")
    said = " ".join(done.out.split())
    assert done.code == 3, done.err  # while the rudder moves, the elevator only holds the attitude
    assert "elevator follows the recorded q, theta" in said
    assert "The lateral axis (CY, Cl, Cn) is left out: record blind has no channel beta" in said


@pytest.mark.verify
def test_simulated_manoeuvres_of_three_axes_are_flown_again(tmp_path):
    """Doublets of aileron and rudder and a 3-2-1-1, by `simulate`; their derivatives come back from `fly`."""
    plane = stranger_six.Plane()
    more = "fixed = { CLaM = 7.0 }\n"
    (tmp_path / "card.toml").write_text(six.card_text(plane, EFFECTS, more=more))
    files = []
    for seed, kind in enumerate(("elevator_3211", "aileron_doublet", "rudder_doublet")):
        files.append(f"{kind}.csv")
        asked = ("--manoeuvre", kind, "--noise", "white", "--duration", SECONDS, "--seed", seed)
        succeeded(called(tmp_path, "simulate", "--model", "card.toml", *asked, "--out", files[-1]))
    table = pd.read_csv(tmp_path / "aileron_doublet.csv")
    assert np.ptp(table["aileron"]) > np.radians(8.0)
    assert np.ptp(table["phi"]) > np.radians(4.0)
    options = ("--no-process-noise", "--no-figures", "--json", "--out", "out")
    succeeded(called(tmp_path, "fly", *files, "--model", "card.toml", *options))
    found = json.loads((tmp_path / "out" / "trajectories.json").read_text())
    truth = json.loads((tmp_path / "rudder_doublet.csv.truth.json").read_text())["parameters"]
    for name in ("CLa", "Cma", "Cmq", "Cmde", "Clp", "Clda", "Clbe", "Cnbe", "Cnr", "Cndr", "CYbe"):
        row = found["parameters"][name]
        assert abs(row["estimate"] - truth[name]) < 4.0 * row["sd_corrected"], name
        assert row["sd_corrected"] < 0.2 * abs(truth[name]), name


def test_errors_of_sensors_that_a_card_fixes_are_in_the_record():
    """At rest before the doublet a gyro shows its bias, and an accelerometer differs from another card's by its own."""
    card, demo = read_card("full_six"), Request({}, "elevator_doublet", "none", duration=6.0)
    plain = replace(card, effects=tuple(n for n in card.effects if n not in ("pitch_rate_bias", "accel_z_bias")))
    found, without = (synthetic(demo, one, CATALOGUE).record for one in (card, plain))
    assert found["q"][0] == pytest.approx(card.fixed["pitch_rate_bias"], abs=1e-9)
    np.testing.assert_allclose(found["q"] - without["q"], card.fixed["pitch_rate_bias"], atol=1e-9)
    np.testing.assert_allclose(found["az"] - without["az"], card.fixed["accel_z_bias"], atol=1e-7)
