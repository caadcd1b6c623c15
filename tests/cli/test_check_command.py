"""Checks of records: all that is wrong at once, where each channel comes from, whether the sensors agree.

The faulty records of `../shared/records`: `check` and `identify` must report each, and nothing on sound ones. `make.py`
there writes the records, and `run.py` has the tables and says what counts as told. They are read here, and the program
is called in this process: forty processes would each load and compile it."""

import ast
import errno
import json
import os
import re
import runpy
import shutil
import subprocess
import sys
import warnings
from pathlib import Path
from unittest.mock import patch

import numpy as np
import pandas as pd
import pytest
from calling import answer, called, holds, page_of, refused

import bayes_aero as ba
from bayes_aero.diagnosis import consistency
from bayes_aero.diagnosis.consistency import screen_sensor_errors
from bayes_aero.errors import InputError
from bayes_aero.flight.card import shipped_cards
from bayes_aero.jobs import check
from bayes_aero.jobs import identify as job
from bayes_aero.jobs.card_template import starter_card


def test_a_gyro_bias_is_seen_without_aerodynamics(program, flights):
    found = answer(program("check", flights.biased, "--json"), 3)  # usable, but in doubt
    assert found["usable"]
    assert found["consistency"]["outcome"] == "disagree_explained"
    assert found["uses"]["identify"]["possible"]
    assert found["sensors"]["agree"] is False
    size = found["sensors"]["errors"]["pitch_rate_bias"]["parameters"]["pitch_rate_bias"]
    assert size["mean"] == pytest.approx(np.deg2rad(0.3), rel=0.05)
    record = found["records"][0]
    alpha = next(c for c in record["channels"] if c["name"] == "alpha")
    assert (alpha["place"], alpha["unit"], alpha["si"]) == ("'ALCG'", "deg", "rad")
    assert record["samples"] == 1001
    assert "spoiler_lift" in found["not_testable"]  # no spoiler moved


def test_everything_that_is_wrong_is_told_at_once(program, flights):
    table = pd.read_csv(flights.sound)
    table.loc[100, "THE"] = np.nan
    table["ALCG"] *= 57.3  # as if degrees had been converted once too often
    table["T"] = table["T"].where(table.index < 500, table["T"] + 1.0)
    table.drop(columns="VTASCG").assign(extra=1.0).to_csv("bad.csv", index=False)
    done = program("check", "bad.csv", "--no-sensors", "--json", "--out", "checked")
    assert done.code == 1
    html = page_of(Path("checked"))
    holds(html, "Not usable as it is", "airspeed")
    record = json.loads(done.out)["records"][0]
    said = "\n".join(record["problems"])
    holds(said, "theta", "alpha", "gap", "airspeed")
    assert record["gaps"] == 1
    assert record["unused"] == ["'extra'"]
    assert "Traceback" not in done.err


def test_what_a_lost_channel_costs_is_said_and_an_empty_file_is_bad_input(program, flights, tmp_path):
    card = tmp_path / "few.toml"
    text = shipped_cards()["attas"].read_text()
    card.write_text(text.replace('az = { column = 4, label = "AZCG", unit = "m/s^2" }\n', ""))
    done = program("check", flights.sound, "--model", card, "--no-sensors")
    assert done.code == 0, done.err  # diagnose can work from trajectories
    assert "identify: not possible, no channel az" in done.out
    assert "because a channel was not recorded (az" in " ".join(done.out.split())
    assert "'AZCG'" in done.out.split("in the file, not on the card:")[1].splitlines()[0]
    (tmp_path / "empty.csv").write_text("")
    refused(program("check", "empty.csv"), "empty.csv")


def test_a_report_of_the_check_is_written_on_request_only(program, flights, tmp_path):
    assert program("check", flights.biased).code == 3
    assert list(tmp_path.iterdir()) == []
    done = program("check", flights.biased, "--out", "checked")
    assert done.code == 3
    assert "checked/report.html" in done.out.replace("\n", "")
    html = page_of(tmp_path / "checked")
    holds(html, "pitch_rate_bias", "Usable for identify, diagnose, fly", "spoiler_lift", "ALCG")
    assert json.loads((tmp_path / "checked" / "check.json").read_text())["usable"]


@pytest.mark.parametrize("file", ["check.json", "report.html"])
def test_a_full_disk_is_one_sentence(program, flights, tmp_path, monkeypatch, file):
    write = Path.write_bytes

    def full(path, content):
        if file in path.name:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return write(path, content)

    monkeypatch.setattr(Path, "write_bytes", full)
    done = program("check", flights.sound, "--no-sensors", "--out", "checked")
    assert done.code == 2
    assert done.err == f"error: checked/{file}: No space left on device; check the path and the disk\n"
    assert not (tmp_path / "checked" / file).exists()


@pytest.mark.parametrize(
    ("column", "name", "declared", "meant", "factor"),
    [("VTASCG", "airspeed", "m/s", "kt", 1.0 / 0.514444), ("HQNH", "altitude", "m", "ft", 1.0 / 0.3048)],
)
def test_a_unit_that_the_flight_path_refutes_is_doubted(
    program, flights, tmp_path, column, name, declared, meant, factor
):
    """A file in knots or feet that the card takes for SI; each number alone is plausible."""
    assert answer(program("check", flights.sound, "--no-sensors", "--json"))["cautions"] == []
    table = pd.read_csv(flights.sound)
    table[column] *= factor
    table.to_csv("other.csv", index=False)
    done = program("check", "other.csv", "--no-sensors", "--json")
    found = json.loads(done.out)
    assert f"{name} is in {meant} and not in {declared}, as the card says" in found["cautions"][0]
    first = found["health"][0]
    assert (first["channel"], first["fault"], first["grave"]) == (name, "unit", True)
    for record, doubted in ((flights.sound, False), ("other.csv", True)):
        done = program("identify", record, "--no-sample", "--no-gp", "--no-figures", "--out", "id")
        assert done.code == (3 if doubted else 0), done.err
        assert (f"! other: {name} is in {meant}" in done.out) == doubted
        health = json.loads((tmp_path / "id" / "results.json").read_text())["health"]
        assert [f["fault"] for f in health][:1] == ["unit"] * doubted
        page = page_of(tmp_path / "id")
        assert (f"is in {meant} and not in" in page.split("<h2")[0]) == doubted  # before all sections


@pytest.mark.parametrize(
    ("column", "factor", "words"),
    [
        ("AZCG", -1.0, "write sign = -1 at az"),
        ("AZCG", 1.0 / 9.80665, 'set unit = "g"'),
        ("QRGY", -1.0, "q counts the other way"),
        ("DELV", -1.0, "write sign = -1 at elevator"),
        ("QRGY", np.pi / 180.0, "q is in rad/s and not in deg/s"),
    ],
)
def test_a_sign_or_unit_that_other_channels_refute_is_doubted(program, flights, column, factor, words):
    table = pd.read_csv(flights.sound)
    table[column] *= factor
    table.to_csv("other.csv", index=False)
    for record, doubted in ((flights.sound, False), ("other.csv", True)):
        done = program("check", record, "--no-sensors", "--json")
        assert done.code == (3 if doubted else 0), done.err
        cautions = json.loads(done.out)["cautions"]
        assert any(words in caution for caution in cautions) == doubted, cautions


def test_columns_that_the_card_does_not_map_are_listed_once(program, flights):
    """Two parts of one file, and one with another column."""
    table = pd.read_csv(flights.sound).assign(spare=1.0)
    table.iloc[:500].to_csv("a.csv", index=False)
    table.iloc[500:].to_csv("b.csv", index=False)
    table.iloc[500:].assign(other=2.0).to_csv("c.csv", index=False)
    out = " ".join(program("check", "a.csv", "b.csv", "c.csv", "--no-sensors").out.split())
    listed = [part.split(".csv")[0] for part in out.split("in the file, not on the card: ")[1:]]
    assert len(listed) == 2
    assert "'spare'" in listed[0]
    assert "'other'" not in listed[0]
    assert "'spare', 'other'" in listed[1]


SHARED = Path(__file__).resolve().parents[3] / "shared" / "records"
QUICK = ("--no-sample", "--no-gp", "--no-figures")
REFUSED = ("several_rates_blank", "several_rates_nan", "unit_row_as_avionics_spell")  # the others are read


def judge():
    """`WRONG`, `SOUND`, `FILES` and `told` of run.py, without running it."""
    if not (SHARED / "run.py").is_file():
        return {"WRONG": {}, "SOUND": [], "FILES": {}, "told": None}
    tree = ast.parse((SHARED / "run.py").read_text())
    tree.body = [
        node
        for node in tree.body
        if (isinstance(node, ast.Assign) and getattr(node.targets[0], "id", "") in ("WRONG", "SOUND", "FILES"))
        or (isinstance(node, ast.FunctionDef) and node.name == "told")
    ]
    found = {"re": re}
    exec(compile(tree, "run.py", "exec"), found)
    return found


JUDGE = judge()


@pytest.fixture(scope="session")
def made(tmp_path_factory):
    """The records: what make.py asks the program for is done in this process."""
    if not JUDGE["WRONG"]:
        pytest.skip(f"the faulty records are not in {SHARED}")
    root = tmp_path_factory.mktemp("faulty_records")

    def simulated(command, **_):
        done = called(root, *command[1:])
        assert (command[0], done.code) == ("bayes-aero", 0), done.err

    with (
        patch.object(sys, "argv", ["make.py", str(root)]),
        patch.object(subprocess, "run", simulated),
        warnings.catch_warnings(action="ignore"),  # what it has pandas do is no matter of the program's
    ):
        runpy.run_path(str(SHARED / "make.py"))
    assert (root / "files" / "matrix.mat").is_file()
    return root


@pytest.fixture
def bare(monkeypatch):
    """`identify` without its page and the simulation on it: faults are reported before those are made.

    Both commands search the same records for errors of sensors: that is done once.
    """
    found = {}

    def once(records, card, *, seed=0):
        key = (*((record.sha256, record.n) for record in records), seed)
        if key not in found:
            found[key] = screen_sensor_errors(records, card, seed=seed)
        return found[key]

    monkeypatch.setattr(check, "screen_sensor_errors", once)
    monkeypatch.setattr(consistency, "screen_sensor_errors", once)
    monkeypatch.setattr(job, "put_page", lambda *_: ())
    monkeypatch.setattr(job, "fly_identified", lambda *_: ((), (), ()))


@pytest.fixture
def call(program, made, tmp_path):
    """`run.py`'s own: copies under names that give nothing away."""

    def called(*words):
        given, number = [], 0
        for word in words:
            path = made / word
            if path.is_file() and not word.startswith("-"):
                number += path.suffix != ".toml"
                name = "c.toml" if path.suffix == ".toml" else f"r{number}{path.suffix}"
                shutil.copy(path, tmp_path / name)
                given.append(f"./{name}")
            else:
                given.append(word)
        done = program(*given)
        return done.code, done.out + done.err

    return called


@pytest.mark.usefixtures("bare")
@pytest.mark.parametrize("records", JUDGE["SOUND"], ids=" ".join)
def test_sound_records_pass(call, records):
    code, said = call("check", *records)
    fit, told = call("identify", *records, *QUICK, "--out", "sound")
    assert (code, fit) == (0, 0)
    assert "disagree" not in said + told
    assert "✗" not in said + told


@pytest.mark.usefixtures("bare")
@pytest.mark.parametrize("records", JUDGE["WRONG"], ids=" ".join)
def test_wrong_contents_are_told(call, records):
    options, words = JUDGE["WRONG"][records]
    for command, more in (("check", ()), ("identify", (*QUICK, "--out", "wrong"))):
        code, said = call(command, *records, *options, *more)
        assert JUDGE["told"](code, said, words), (command, code, said)


@pytest.mark.parametrize("name", JUDGE["FILES"])
def test_files_are_read_right_or_refused_in_words(made, name):
    """`run.py` fits each file: one whose channels are those of the base record has its estimates."""
    base = ba.read(made / "base.csv")[0]
    if Path(name).stem in REFUSED:
        with pytest.raises(InputError) as refused:
            ba.read(made / name)
        assert any(word in str(refused.value) for word in JUDGE["FILES"][name])
    else:
        same(ba.read(made / name)[0], base)


@pytest.mark.parametrize("name", ["several_rates_blank", "several_rates_nan"])
def test_several_rates_are_interpolated(made, name):
    base = ba.read(made / "base.csv")[0]
    found = ba.read(made / f"files/{name}.csv", resample=0.04)[0]
    assert found.n == base.n
    for channel, noise in (("airspeed", 0.5), ("altitude", 2.0), ("density", 5e-3)):
        assert np.std(found[channel] - base[channel]) < noise  # of the simulated sensors


def same(found, base) -> None:
    """To the digits of the file; time from the first sample."""
    np.testing.assert_allclose(found.time - found.time[0], base.time - base.time[0], atol=1e-6)
    assert set(found.names) == set(base.names)
    for channel, values in base.channels.items():
        whole = 0.5 if channel in ("altitude", "thrust_left", "thrust_right") else 0.0
        np.testing.assert_allclose(found[channel], values, rtol=1e-5, atol=whole + 1e-8 + 1e-6 * np.ptp(values))


@pytest.mark.parametrize(
    ("name", "channels"),
    [
        ("pipes.txt", {"time", "alpha", "theta", "phi", "q", "az", "ax", "airspeed", "elevator", "altitude"}),
        ("two_header_rows.csv", {"time", "ax", "ay", "az", "p", "q", "r", "phi", "theta", "psi", "alpha", "beta"}),
        ("struct73.mat", {"time", "ax", "az", "q", "alpha", "airspeed", "elevator", "density", "mach"}),
    ],
)
def test_card_finds_the_columns(made, name, channels):
    assert channels <= set(starter_card(made / "files" / name).found)
