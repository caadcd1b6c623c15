"""Checks of records: all that is wrong at once, what the card takes from where, whether the sensors agree."""

from __future__ import annotations

import errno
import json
import os
from pathlib import Path

import numpy as np
import pandas as pd
import pytest


def test_a_gyro_bias_is_seen_without_aerodynamics(program, flights):
    done = program("check", flights.biased, "--json")
    assert done.code == 3, done.err  # usable, but in doubt
    found = json.loads(done.out)
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
    done = program("check", "bad.csv", "--no-sensors", "--json")
    assert done.code == 1
    record = json.loads(done.out)["records"][0]
    said = "\n".join(record["problems"])
    for word in ("theta", "alpha", "gap", "airspeed"):
        assert word in said
    assert record["gaps"] == 1
    assert record["unused"] == ["'extra'"]
    assert "Traceback" not in done.err


def test_what_a_lost_channel_costs_is_said(program, flights, tmp_path):
    card = tmp_path / "few.toml"
    text = open_card()
    card.write_text(text.replace('az = { column = 4, label = "AZCG", unit = "m/s^2" }\n', ""))
    done = program("check", flights.sound, "--model", card, "--no-sensors")
    assert done.code == 0, done.err  # diagnose can work from trajectories
    assert "identify: not possible, no channel az" in done.out
    assert "because a channel was not recorded (az" in " ".join(done.out.split())
    assert "'AZCG'" in done.out.split("in the file, not on the card:")[1].splitlines()[0]


def open_card():
    from bayes_aero.flight.card.card import shipped_cards

    return shipped_cards()["attas"].read_text()


def test_a_file_that_is_no_record_is_bad_input(program, tmp_path):
    (tmp_path / "empty.csv").write_text("")
    done = program("check", "empty.csv")
    assert done.code == 2
    assert "empty.csv" in done.err


def test_an_elevator_that_the_file_counts_the_other_way_is_told(program, flights, tmp_path):
    lines = flights.sound.read_text().splitlines()
    column = lines[0].split(",").index("DELV")
    turned = [line.split(",") for line in lines]
    for row in turned[1:]:
        row[column] = str(-float(row[column]))
    (tmp_path / "turned.csv").write_text("\n".join(",".join(row) for row in turned) + "\n")
    done = program("check", "turned.csv", "--no-sensors")
    assert done.code == 3
    assert "write sign = -1 at elevator" in done.out
    assert json.loads(program("check", "turned.csv", "--no-sensors", "--json").out)["cautions"]
    assert json.loads(program("check", flights.sound, "--no-sensors", "--json").out)["cautions"] == []


def test_a_report_of_the_check_is_written_on_request_only(program, flights, tmp_path):
    assert program("check", flights.biased).code == 3
    assert list(tmp_path.iterdir()) == []
    done = program("check", flights.biased, "--out", "checked")
    assert done.code == 3
    assert "checked/report.html" in done.out.replace("\n", "")
    html = (tmp_path / "checked" / "report.html").read_text().replace("<wbr>", "")
    for words in ("pitch_rate_bias", "Usable for identify, diagnose, fly", "spoiler_lift", "ALCG"):
        assert words in html
    assert "was not made" not in html
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


def test_an_unusable_record_has_a_report_that_says_why(program, flights, tmp_path):
    table = pd.read_csv(flights.sound)
    table.drop(columns="VTASCG").to_csv("bad.csv", index=False)
    assert program("check", "bad.csv", "--out", "checked").code == 1
    html = (tmp_path / "checked" / "report.html").read_text().replace("<wbr>", "")
    assert "Not usable as it is" in html
    assert "airspeed" in html
    assert "was not made" not in html


@pytest.mark.parametrize(
    ("column", "name", "declared", "meant", "factor"),
    [("VTASCG", "airspeed", "m/s", "kt", 1.0 / 0.514444), ("HQNH", "altitude", "m", "ft", 1.0 / 0.3048)],
)
def test_a_unit_that_the_flight_path_refutes_is_doubted(
    program, flights, tmp_path, column, name, declared, meant, factor
):
    """A file in knots or feet that the card takes for SI; each number alone is plausible."""
    cautions = json.loads(program("check", flights.sound, "--no-sensors", "--json").out)["cautions"]
    assert cautions == []
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
        assert [f["fault"] for f in json.loads((tmp_path / "id" / "results.json").read_text())["health"]][:1] == (
            ["unit"] if doubted else []
        )
        page = (tmp_path / "id" / "report.html").read_text().replace("<wbr>", "")
        assert (f"is in {meant} and not in" in page.split("<h2")[0]) == doubted  # before all sections


@pytest.mark.parametrize(
    ("column", "factor", "words"),
    [
        ("AZCG", -1.0, "write sign = -1 at az"),
        ("AZCG", 1.0 / 9.80665, 'set unit = "g"'),
        ("QRGY", -1.0, "q counts the other way"),
        ("QRGY", np.pi / 180.0, "q is in rad/s and not in deg/s"),
    ],
)
def test_a_sign_or_unit_that_other_channels_refute_is_doubted(program, flights, column, factor, words):
    table = pd.read_csv(flights.sound)
    table[column] *= factor
    table.to_csv("other.csv", index=False)
    for record, doubted in ((flights.sound, False), ("other.csv", True)):
        cautions = json.loads(program("check", record, "--no-sensors", "--json").out)["cautions"]
        assert any(words in caution for caution in cautions) == doubted, cautions
