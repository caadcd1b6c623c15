"""`bayes-aero qualify`: from a finished result to a page that is signed, and its words for bad input."""

import json
import shutil
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from calling import answer, called, holds, refused, validated

from bayes_aero.errors import InputError
from bayes_aero.flight.card import read_card, shipped_cards
from bayes_aero.flight.reading import read_records
from bayes_aero.flight.record import FlightRecord
from bayes_aero.jobs.fitted import card_of, fitted_records
from bayes_aero.jobs.options import FlyOptions
from bayes_aero.jobs.provenance import as_json, provenance

FEW = ("--draws", "100")


@pytest.fixture(scope="module")
def folder(tmp_path_factory, identified):
    """Two simulated stalls without noise, the result of identify on one, and its qualification."""
    there = tmp_path_factory.mktemp("qualified")
    shutil.copytree(identified, there, dirs_exist_ok=True)
    told = answer(called(there, "qualify", "results", "other.csv", "--gusts", 1, *FEW, "--json"))
    assert told == json.loads((there / "qualification" / "qualification.json").read_text())
    return there


@pytest.fixture
def here(folder, program, tmp_path):
    """A working directory of one's own with result and records."""
    shutil.copytree(folder / "results", tmp_path / "results")
    for name in ("stall", "other"):
        shutil.copy(folder / f"{name}.csv", tmp_path)
    return program


@pytest.fixture(scope="module")
def found(folder):
    return json.loads((folder / "qualification" / "qualification.json").read_text())


def test_the_numbers_follow_the_schema_and_every_thing_counted_makes_a_test_harder(found):
    validated(found, "qualification")
    assert not found["failures"]
    assert {t["kind"] for t in found["tests"]} == {"again", "test"}
    assert list(found["tolerances"]) == ["airspeed", "alpha", "theta", "q", "az"]
    # Draws are shared, so a test that fails by parameters fails with structure and gusts but for single draws.
    for test in found["tests"]:
        chances = [test["counted"][name]["value"] for name in ("parameters", "structure", "gusts")]
        assert chances[1] <= chances[0] + 0.05
        assert chances[2] <= chances[1] + 0.05
        assert test["probability"] == chances[2]
        assert test["record"]["passed"]  # the model is the truth, and there is no noise


def test_extrapolation_is_told_of_the_other_record(folder, found):
    """Beside the hull of the fitted record the other one is outside where single channels already are."""
    fitted, other = (np.genfromtxt(folder / f"{n}.csv", delimiter=",", names=True) for n in ("stall", "other"))
    alpha, low, high = other["ALCG"], fitted["ALCG"].min(), fitted["ALCG"].max()
    told = {one["manoeuvre"]: one for one in found["outside"] if one["motion"] == "recorded"}
    assert "stall" not in told
    assert found["flown_region"] == {"channels": ["alpha", "beta", "mach", "p", "q", "r"], "not_recorded": []}
    clearly = 0.1 * (high - low) / 2.0  # a hull lies within the ranges of its channels
    assert told["other"]["share"] >= np.mean((alpha > high + clearly) | (alpha < low - clearly)) - 0.01
    assert told["other"]["distance"] >= max(alpha.max() - high, low - alpha.min()) / ((high - low) / 2.0) - 0.01


def test_the_page_can_be_signed(folder, found):
    page = (folder / "qualification" / "qualification.html").read_text()
    assert "was not made" not in page
    holds(page, "signature", "accepted", "refused", "Attachment 7", "was not read", "Stated: 1 m/s")
    assert ("The model does not qualify" in page) == (found["verdict"] == "fails")
    rows = (folder / "qualification" / "qualification.csv").read_text().splitlines()
    assert len(rows) == 1 + len(found["tests"])


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("attas",), "a card has no uncertainty"),
        (("nowhere",), "there is no result 'nowhere'"),
        (("results", "nosuch.csv"), "no such file"),
        (("results", "stall.csv"), "was fitted, so it is tested anyway"),
        (("results", "--draws", "3"), "--draws is 3; give a number from 100"),
        (("results", "--gusts", "99"), "--gusts is 99 m/s"),
    ],
)
def test_bad_input_is_one_sentence(here, arguments, words):
    refused(here("qualify", *arguments), words, gone=["qualification"])


def test_records_that_changed_are_refused(here):
    table = pd.read_csv("stall.csv")
    table.assign(ALCG=table["ALCG"] + 1e-6).to_csv("stall.csv", index=False)
    refused(here("qualify", "results", *FEW), "stall.csv has changed since results/results.json")
    Path("stall.csv").unlink()
    refused(here("qualify", "results", *FEW), "stall.csv", "--fitted")


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        (lambda t: t[[*reversed(t.columns)]], "is the same record as stall"),
        (lambda t: t.round(4), "is the same record as stall"),
        (lambda t: t.iloc[300:700], "is part of the same record as stall"),
        (lambda t: t.assign(T=t["T"] + 1000.0).iloc[::2], "is the same record as stall"),
    ],
)
def test_a_copy_of_a_fitted_record_is_no_new_one(here, changed, words):
    changed(pd.read_csv("stall.csv")).to_csv("new.csv", index=False)
    refused(here("qualify", "results", "new.csv", *FEW), f"new {words}")


def test_faults_of_a_new_record_are_told_first(here):
    """In knots no flight can be simulated; an altitude in feet costs nothing that is compared."""
    table = pd.read_csv("other.csv")
    table.assign(VTASCG=table["VTASCG"] * 3600.0 / 1852.0).to_csv("knots.csv", index=False)
    refused(here("qualify", "results", "knots.csv", *FEW), "knots: airspeed is in kt", "leave this record out")
    table.assign(HQNH=table["HQNH"] / 0.3048).to_csv("feet.csv", index=False)
    done = here("qualify", "results", "feet.csv", *FEW)
    assert done.code == 3, done.err
    assert done.out.startswith("! feet: altitude is in ft and not in m")
    found = json.loads(Path("qualification/qualification.json").read_text())
    assert ("altitude", "unit") in {(f["channel"], f["fault"]) for f in found["health"] if f["grave"]}
    assert "altitude is in ft" in Path("qualification/qualification.html").read_text()


@pytest.fixture
def reread(tmp_path, card, monkeypatch):
    """`reread(made, *files)`: the records of a result made of `made`, found again as its JSON names them."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", ["bayes-aero", "fly", "x@1:0", "--model", "other.toml", "--resample=7", "'"])

    def again(made, *files):
        source = json.loads(as_json(provenance(card, made, 0, {}, FlyOptions())))
        return fitted_records(source, Path("results/trajectories.json"), card, remedy="give it", files=files), source

    return again


def test_records_are_read_again_as_they_were_whatever_the_command_said(folder, card, reread):
    shutil.copy(folder / "stall.csv", "stall.csv")
    (part,) = read_records(["stall.csv@30:60"], card.channels, resample=0.1)
    cut = read_records(["stall.csv"], card.channels)[0].window(40.0, 50.0)
    found, source = reread([part, cut])
    assert [r.content for r in found] == [part.content, cut.content]
    assert [r.name for r in found] == ["stall_30-60", cut.name]
    assert source["inputs"][0]["read"] == {
        "path": "stall.csv", "part": "30:60", "resample": 0.1, "windows": [], "split": False,
    }  # fmt: skip
    assert source["options"]["windows"] == 12.0


def test_records_are_found_by_their_content_and_not_by_their_name(folder, card, reread):
    shutil.copy(folder / "stall.csv", "stall.csv")
    made = read_records(["stall.csv"], card.channels)
    table = pd.read_csv("stall.csv", dtype=str)
    table[[*reversed(table.columns)]].to_csv("moved.csv", index=False)
    Path("stall.csv").unlink()
    with pytest.raises(InputError, match=r"record stall\.csv of .* is not where it was"):
        reread(made)
    with pytest.raises(InputError, match=r"record stall\.csv of .* is not where it was"):
        reread(made, folder / "other.csv")
    ((found,), _) = reread(made, folder / "other.csv", Path("moved.csv"))
    assert (found.name, found.content) == ("stall", made[0].content)
    with pytest.raises(InputError, match="was made in memory"):
        reread([FlightRecord.from_arrays("mine", made[0].time, made[0].channels)])


@pytest.mark.usefixtures("reread")
def test_a_card_is_found_where_the_result_says(tmp_path):
    text = shipped_cards()["attas"].read_text()
    (tmp_path / "cards").mkdir()
    (tmp_path / "cards" / "mine.toml").write_text(text)
    own = read_card("cards/mine.toml")
    source = json.loads(as_json(provenance(own, [], 0, {})))
    assert card_of(source, Path("elsewhere/results.json"), None).path == "cards/mine.toml"
    (tmp_path / "cards" / "mine.toml").write_text(text + "\n")
    with pytest.raises(InputError, match="not found here unchanged"):
        card_of(source, Path("elsewhere/results.json"), None)
