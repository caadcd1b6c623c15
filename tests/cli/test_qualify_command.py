"""`bayes-aero qualify`: from a finished result to a page that is signed, and its words for bad input."""

from __future__ import annotations

import json
import shutil
from importlib import resources
from pathlib import Path

import jsonschema
import numpy as np
import pytest
from calling import called

from bayes_aero.flight.reading.read_record import write_record

QUICK = ("--no-sample", "--no-gp", "--no-figures")
FEW = ("--draws", "100")
SCHEMA = json.loads(resources.files("bayes_aero.jobs.io.schemas").joinpath("qualification.schema.json").read_text())


@pytest.fixture(scope="module")
def folder(tmp_path_factory, clean_records, card):
    """Two simulated stalls without noise as CSV files, the result of identify on one, and its qualification."""
    there = tmp_path_factory.mktemp("qualified")
    for record, name in zip(clean_records, ("fitted", "other"), strict=False):
        part = record.window(25.0, 65.0)
        write_record(part, there / f"{name}.csv", [c for c in card.channels if part.has(c.name) or c.name == "time"])
    done = called(there, "identify", "fitted.csv", "--out", "results", *QUICK)
    assert done.code == 0, done.err
    done = called(there, "qualify", "results", "other.csv", "--gusts", 1, *FEW, "--json")
    assert done.code == 0, done.err
    assert json.loads(done.out) == json.loads((there / "qualification" / "qualification.json").read_text())
    return there


@pytest.fixture
def here(folder, program, tmp_path):
    """A working directory of one's own with result and records."""
    shutil.copytree(folder / "results", tmp_path / "results")
    for name in ("fitted", "other"):
        shutil.copy(folder / f"{name}.csv", tmp_path)
    return program


@pytest.fixture(scope="module")
def found(folder):
    return json.loads((folder / "qualification" / "qualification.json").read_text())


def refused(done, words):
    """One sentence, and nothing written."""
    assert done.code == 2
    assert done.err.startswith("error: ")
    assert done.err.count("\n") == 1
    assert words in done.err, done.err
    assert not Path("qualification").exists()


def test_the_numbers_follow_the_schema(found):
    jsonschema.Draft202012Validator.check_schema(SCHEMA)
    jsonschema.validate(found, SCHEMA)
    assert not found["failures"]
    assert {t["kind"] for t in found["tests"]} == {"again", "test"}
    assert list(found["tolerances"]) == ["airspeed", "alpha", "theta", "q", "az"]


def test_every_thing_counted_makes_a_test_harder(found):
    """Draws are shared, so a test that fails by parameters fails with structure and gusts but for single draws."""
    for test in found["tests"]:
        chances = [test["counted"][name]["value"] for name in ("parameters", "structure", "gusts")]
        assert chances[1] <= chances[0] + 0.05
        assert chances[2] <= chances[1] + 0.05
        assert test["probability"] == chances[2]
        assert test["record"]["passed"]  # the model is the truth, and there is no noise


def test_extrapolation_is_told_of_the_other_record(folder, found):
    """Beside the hull of the fitted record the other one is outside where single channels already are."""
    fitted, other = (np.genfromtxt(folder / f"{n}.csv", delimiter=",", names=True) for n in ("fitted", "other"))
    alpha, low, high = other["ALCG"], fitted["ALCG"].min(), fitted["ALCG"].max()
    told = {one["manoeuvre"]: one for one in found["outside"] if one["motion"] == "recorded"}
    assert "fitted" not in told
    assert found["flown_region"] == {"channels": ["alpha", "beta", "mach", "p", "q", "r"], "not_recorded": []}
    clearly = 0.1 * (high - low) / 2.0  # a hull lies within the ranges of its channels
    assert told["other"]["share"] >= np.mean((alpha > high + clearly) | (alpha < low - clearly)) - 0.01
    assert told["other"]["distance"] >= max(alpha.max() - high, low - alpha.min()) / ((high - low) / 2.0) - 0.01


def test_the_page_can_be_signed(folder, found):
    page = (folder / "qualification" / "qualification.html").read_text()
    assert "was not made" not in page
    for words in ("signature", "accepted", "refused", "Attachment 7", "was not read", "Stated: 1 m/s"):
        assert words in page
    assert ("The model does not qualify" in page) == (found["verdict"] == "fails")
    rows = (folder / "qualification" / "qualification.csv").read_text().splitlines()
    assert len(rows) == 1 + len(found["tests"])


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("attas",), "a card has no uncertainty"),
        (("nowhere",), "there is no result 'nowhere'"),
        (("results", "nosuch.csv"), "no such file"),
        (("results", "fitted.csv"), "was fitted, so it is tested anyway"),
        (("results", "--draws", "3"), "--draws is 3; give a number from 100"),
        (("results", "--gusts", "99"), "--gusts is 99 m/s"),
    ],
)
def test_bad_input_is_one_sentence(here, arguments, words):
    refused(here("qualify", *arguments), words)


def test_records_that_changed_are_refused(here):
    with Path("fitted.csv").open("a") as file:
        file.write("\n")
    refused(here("qualify", "results", *FEW), "the record fitted to which the model")
    Path("fitted.csv").unlink()
    refused(here("qualify", "results", *FEW), "give all records of that run with --fitted")
