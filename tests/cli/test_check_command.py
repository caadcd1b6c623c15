"""Checks of records: all that is wrong at once, where each channel comes from, whether the sensors agree."""

import errno
import json
import os
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from calling import answer, holds, page_of, succeeded

from bayes_aero.flight.card import shipped_cards


def test_a_gyro_bias_is_seen_without_aerodynamics_and_reported_on_request(program, flights, tmp_path):
    found = answer(program("check", flights.biased, "--json", "--out", "checked"), 3)  # usable, but in doubt
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
    html = page_of(tmp_path / "checked")
    holds(html, "pitch_rate_bias", "Usable for identify, diagnose, fly", "spoiler_lift", "ALCG")
    assert json.loads((tmp_path / "checked" / "check.json").read_text())["usable"]


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


def test_what_a_lost_channel_costs_is_said(program, flights, tmp_path):
    card = tmp_path / "few.toml"
    text = shipped_cards()["attas"].read_text()
    card.write_text(text.replace('az = { column = 4, label = "AZCG", unit = "m/s^2" }\n', ""))
    done = succeeded(program("check", flights.sound, "--model", card, "--no-sensors"))  # trajectories are left
    assert list(tmp_path.iterdir()) == [card]
    assert "identify: not possible, no channel az" in done.out
    assert "because channel az" in " ".join(done.out.split())
    assert "'AZCG'" in done.out.split("in the file, not on the card:")[1].splitlines()[0]


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


def test_a_unit_that_other_channels_refute_is_doubted_by_check_and_identify(program, flights, tmp_path):
    """A file in knots that the card takes for SI; each number alone is plausible."""
    table = pd.read_csv(flights.sound)
    table.assign(VTASCG=table["VTASCG"] / 0.514444).to_csv("other.csv", index=False)
    said = "airspeed is in kt and not in m/s, as the card says"
    for record, doubted in ((flights.sound, False), ("other.csv", True)):
        code = 3 if doubted else 0
        found = answer(program("check", record, "--no-sensors", "--json"), code)
        assert [said in caution for caution in found["cautions"]][:1] == [True] * doubted
        first = [("airspeed", "unit", True)] * doubted
        assert [(f["channel"], f["fault"], f["grave"]) for f in found["health"]][:1] == first
    done = succeeded(program("identify", "other.csv", "--no-sample", "--no-gp", "--no-figures", "--out", "id"), 3)
    assert "! other: airspeed is in kt" in done.out
    health = json.loads((tmp_path / "id" / "results.json").read_text())["health"]
    assert [(f["channel"], f["fault"], f["grave"]) for f in health][:1] == first
    assert "is in kt and not in" in page_of(tmp_path / "id").split("<h2")[0]  # before all sections


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
