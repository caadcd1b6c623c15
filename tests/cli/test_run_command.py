"""Studies: units are made once, resumed, redone where inputs changed, and never anywhere else; and of trajectories."""

import hashlib
import inspect
import json
import re
import shutil
import tomllib
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from calling import answer, holds, refused, succeeded
from linear_cards import SHORT_PERIOD, SHORT_PERIOD_TRUTH, card_of, record_of, short_period_flight

import bayes_aero
from bayes_aero.cli.fits import fly
from bayes_aero.errors import InputError
from bayes_aero.flight.record import write_record
from bayes_aero.jobs import identify as job
from bayes_aero.jobs.store import write_json
from bayes_aero.study import run as units
from bayes_aero.study.run import KEYS, OPTIONS, RESULTS, read_study

STUDY = """
title = "two records"
records = ["flights/*.csv"]
one_by_one = true
noise = ["white"]
options.gp = false
options.figures = false
"""


@pytest.fixture
def folder(flights_here):
    """A study of two records in the working directory."""
    (flights_here / "study.toml").write_text(STUDY)
    return flights_here


@pytest.fixture
def calls(monkeypatch):
    """The task replaced by a quick one whose number depends on the record alone; the units it was called for."""
    done = []

    def quick(unit, out, *_):
        done.append(unit.shown[0])
        number = int(hashlib.sha256(Path(unit.records[0]).read_bytes()).hexdigest()[:6], 16)
        parameters = {"CLa": {"estimate": number / 7.0, "crb": 0.1, "crb_corrected": 0.2, "unit": "1/rad"}}
        write_json({"mle": {"status": "converged", "parameters": parameters}}, out / "results.json")

    monkeypatch.setattr(units, "run_task", quick)
    return done


def states(program, *more):
    told = answer(program("run", "study.toml", *more, "--json"))
    return {row["name"].split("-")[0]: row for row in told["units"]}


def test_a_study_is_done_once_and_redone_where_its_inputs_changed(program, folder, calls):
    assert [row["state"] for row in states(program, "--dry-run").values()] == ["missing"] * 2
    assert not (folder / "study_results").exists()
    assert program("run", "study.toml").code == 0
    assert sorted(calls) == ["flights/biased.csv", "flights/sound.csv"]
    first = {p: p.read_bytes() for p in (folder / "study_results" / "units").rglob("results.json")}
    assert program("run", "study.toml").code == 0
    assert len(calls) == 2

    record = folder / "flights" / "sound.csv"
    record.write_text(record.read_text() + "\n")
    planned = states(program, "--dry-run")
    assert planned["biased"]["state"] == "done"
    assert planned["sound"]["state"] == "changed"
    assert "flights/sound.csv" in planned["sound"]["why"]
    assert program("run", "study.toml").code == 0
    assert calls[2:] == ["flights/sound.csv"]
    assert sum(p.read_bytes() != text for p, text in first.items()) == 1


def test_an_interrupted_study_goes_on_where_it_stopped(program, folder, calls, monkeypatch):
    quick = units.run_task

    def interrupted(unit, out, *_):
        if unit.shown[0].endswith("sound.csv"):
            (out / "half.txt").write_text("half done")
            raise KeyboardInterrupt
        quick(unit, out)

    monkeypatch.setattr(units, "run_task", interrupted)
    done = program("run", "study.toml")
    assert done.code == 130
    holds(done.err, "1 of 2 units are done", "same command")
    assert len(list((folder / "study_results" / "units").iterdir())) == 1  # nothing half done
    monkeypatch.setattr(units, "run_task", quick)
    assert program("run", "study.toml").code == 0
    assert calls == ["flights/biased.csv", "flights/sound.csv"]
    table = pd.read_csv(folder / "study_results" / "units.csv")
    assert list(table["state"]) == ["done", "done"]
    page = (folder / "study_results" / "report.html").read_text(encoding="utf-8")
    assert "All 2 units are done; all converged; " in page
    assert all(name in page for name in table["unit"])


@pytest.mark.usefixtures("calls")
def test_doubts_about_the_records_of_a_unit_are_told(program, folder, monkeypatch):
    quick = units.run_task

    def doubtful(unit, out, *_):
        quick(unit, out)
        biased = unit.shown[0].endswith("biased.csv")
        fault = {"sentence": "biased: q is in deg/s", "grave": True}
        told = json.loads((out / "results.json").read_text()) | {"health": [fault] * biased}
        told |= {"consistency": {"outcome": "disagree_explained" if biased else "agree"}}
        write_json(told, out / "results.json")

    monkeypatch.setattr(units, "run_task", doubtful)
    done = program("run", "study.toml")
    assert done.code == 3, done.err
    first, second = (line for line in done.out.splitlines() if line.startswith("! biased"))
    assert first.endswith(": biased: q is in deg/s")
    assert "the sensors disagree along the flight path" in second
    table = pd.read_csv(folder / "study_results" / "units.csv").set_index("unit")["doubts"].fillna("")
    assert [bool(said) for said in table] == [name.startswith("biased") for name in table.index]


@pytest.mark.usefixtures("calls")
def test_a_unit_that_fails_says_why_and_stops_nobody(program, folder, monkeypatch):
    quick = units.run_task

    def failing(unit, out, *_):
        if unit.shown[0].endswith("biased.csv"):
            raise InputError("this record is too short; give a longer one")
        quick(unit, out)

    monkeypatch.setattr(units, "run_task", failing)
    done = program("run", "study.toml")
    assert done.code == 1
    assert "this record is too short" in done.out
    root = folder / "study_results" / "units"
    told = {p.name.split("-")[0]: [f.name for f in p.iterdir()] for p in root.iterdir()}
    assert "error.txt" in told["biased"]
    assert "results.json" in told["sound"]
    monkeypatch.setattr(units, "run_task", quick)
    assert program("run", "study.toml").code == 0  # tried again
    assert states(program, "--dry-run")["biased"]["state"] == "done"


@pytest.mark.usefixtures("calls")
def test_a_doctored_number_is_found(program, folder):
    program("run", "study.toml")
    results = next((folder / "study_results" / "units").glob("sound-*")) / "results.json"
    content = json.loads(results.read_text())
    content["mle"]["parameters"]["CLa"]["estimate"] += 1e-9
    write_json(content, results)
    assert {name: row["state"] for name, row in states(program, "--dry-run").items()} == {
        "sound": "damaged", "biased": "done",
    }  # fmt: skip
    assert program("run", "study.toml").code == 0
    assert json.loads(results.read_text()) != content  # done again


@pytest.mark.usefixtures("calls")
def test_the_summary_and_the_environment(program, folder):
    program("run", "study.toml")
    out = folder / "study_results"
    table = pd.read_csv(out / "summary.csv")
    again = pd.read_parquet(out / "summary.parquet")
    pd.testing.assert_frame_equal(table[["value", "sd"]], again[["value", "sd"]], check_dtype=False)
    assert list(table["method"]) == ["mle", "mle_corrected"] * 2
    assert set(table["records"]) == {"flights/sound.csv", "flights/biased.csv"}
    requirements = (out / "environment" / "requirements.txt").read_text()
    import jax

    assert f"\njax=={jax.__version__}\n" in requirements
    assert requirements.splitlines()[-1].startswith(f"# and bayes-aero {bayes_aero.__version__} (source_sha256")
    assert (out / "study.toml").read_text() == STUDY


def test_units_are_real_work(program, folder, monkeypatch):
    """The runner around `identify`, maximum likelihood alone, so that it is quick."""
    monkeypatch.setattr(job, "posterior_plan", lambda _: [])
    (folder / "study.toml").write_text(STUDY.replace("flights/*.csv", "flights/sound.csv"))
    succeeded(program("run", "study.toml", "--json"))
    (unit,) = (folder / "study_results" / "units").iterdir()
    made = json.loads((unit / "provenance.json").read_text())
    record = folder / "flights" / "sound.csv"
    assert made["inputs"][0]["sha256"] == hashlib.sha256(record.read_bytes()).hexdigest()
    assert made["settings"]["options"] == {"gp": False, "figures": False}
    table = pd.read_csv(folder / "study_results" / "summary.csv").set_index(["method", "parameter"])
    # Noise-free flight of an aircraft whose truth is known: the estimate is the truth but for filters and integration.
    assert table.loc[("mle", "CLa"), "value"] == pytest.approx(3.6, rel=0.05)


def test_units_have_the_same_names_where_the_study_was_moved(folder):
    """That these are names of folders everywhere is in test_hostile.py."""
    study = read_study(folder / "study.toml")
    for unit in study.units:
        assert units.Unit.of_json(json.loads(json.dumps(unit.as_json()))) == unit
    moved = folder / "elsewhere"
    shutil.copytree(folder / "flights", moved / "flights")
    shutil.copy(folder / "study.toml", moved)
    assert [u.name for u in read_study(moved / "study.toml").units] == [u.name for u in study.units]


def test_the_study_in_the_documentation_is_one():
    text = (Path(__file__).parents[2] / "docs" / "howto" / "studies.md").read_text(encoding="utf-8")
    block = text.split("`bayes-aero run")[0]
    table = tomllib.loads("\n".join(line for line in block.splitlines() if line.startswith("    ")))
    assert set(table) <= set(KEYS)
    assert set(table["options"]) <= set(OPTIONS[table["task"]])
    rows = re.findall(r"^\| `(\w+)` \| (.*) \| `(.*)` \|$", text, re.M)
    listed = {task: set(re.findall(r"\w+", options)) for task, options, _ in rows}
    assert listed == {task: set(options) for task, options in OPTIONS.items()}
    assert {task: name for task, _, name in rows} == RESULTS


def test_the_units_are_the_product_of_all_lists(folder):
    text = STUDY + 'seeds = [0, 1]\nsplits = ["random", "block"]\neffects = [[], ["alpha_squared_moment"]]\n'
    text = text.replace('["white"]', '["white", "ar1", "buffet-ar1"]')
    # Keys after "options.gp" are still keys of the study: dotted keys open no section.
    (folder / "study.toml").write_text(text)
    found = read_study(folder / "study.toml").units
    assert len(found) == len({unit.name for unit in found}) == 2 * 2 * 2 * 2 * 3


NOISE = {"alpha": 0.002, "q": 0.003, "az": 0.15}
FLY_STUDY = """
task = "fly"
records = ["*.csv"]
one_by_one = true
cards = ["short_period.toml"]
options.windows = 20
options.priors = false
options.outputs = "q,alpha,az"
options.figures = false
"""
BOTH = "options.process_noise = true\noptions.frequency = [0.2, 2]\n"


@pytest.fixture
def fly_folder(tmp_path):
    """Two short flights of a linear system, its card and a study of both."""
    (tmp_path / "short_period.toml").write_text(SHORT_PERIOD)
    channels = card_of(SHORT_PERIOD).channels
    for seed, name in enumerate(("one", "two")):
        flight = short_period_flight(SHORT_PERIOD_TRUTH, n=300, x0=(0.04, 0.02 * seed))
        noisy = record_of(flight, noise=NOISE, rng=np.random.default_rng(seed), name=name)
        write_record(noisy, tmp_path / f"{name}.csv", channels)
    (tmp_path / "study.toml").write_text(FLY_STUDY)
    return tmp_path


def test_options_are_the_command_s():
    asked = inspect.signature(fly).parameters
    assert set(OPTIONS["fly"]) <= set(asked)
    assert set(asked) - set(OPTIONS["fly"]) == {"records", "model", "out", "seed", "json"}  # a study has its own


def test_linear_cards_fly_and_are_verified(program, fly_folder):
    (fly_folder / "study.toml").write_text(FLY_STUDY + BOTH)
    succeeded(program("run", "study.toml"))
    out = fly_folder / "study_results"
    units = pd.read_csv(out / "units.csv")
    assert list(units["verdict"]) == ["converged"] * 2
    assert set(units["task"]) == {"fly"}
    table = pd.read_csv(out / "summary.csv").set_index("method")
    filtered = table.loc["process_noise"].groupby("parameter")
    assert list(filtered["unit"].nunique()) == [2] * len(SHORT_PERIOD_TRUTH)
    keys = {"output_error": "crb", "output_error_corrected": "sd_corrected"}
    assert len(table.loc[list(keys)]) == 2 * 2 * len(SHORT_PERIOD_TRUTH)  # records, deviations, parameters
    for method, row in table.loc[["process_noise", *keys]].iterrows():
        found = json.loads((out / "units" / row["unit"] / "trajectories.json").read_text())
        known = found["parameters"][row["parameter"]]
        sd = row["sd"] if method == "process_noise" else known["sd_corrected"]
        assert abs(row["value"] - SHORT_PERIOD_TRUTH[row["parameter"]]) < 4.0 * sd, row["parameter"]
        assert row["high95"] - row["low95"] == pytest.approx(2.0 * 1.96 * row["sd"])
        assert row["status"] == "converged"
        if method in keys:
            expected = (known["estimate"], known[keys[method]], known["unit"])
            assert (row["value"], row["sd"], row["unit_of_value"]) == expected
    assert found["frequency"]
    assert found["windows"] == 20.0
    assert found["setting"] == {"initial_state": "free", "priors": False, "inputs": "linear"}
    assert found["fitted_outputs"] == ["q", "alpha", "az"]
    first = out / "units" / units["unit"][0]
    assert (first / "report.html").is_file()
    assert not (first / "figures").exists()


BAD = [
    ("title", "titel", "did you mean 'title'"), ("flights/*.csv", "flights/none.csv", "flights/none.csv"),
    ("flights/*.csv", "flights/*.mat", "no record matches"), ("flights/*.csv", "/nowhere/*.csv", "no record matches"),
    ('["white"]', '["pink"]', "'pink'"), ('["white"]', '"white"', "noise must be a list of white, ar1"),
    ("options.gp", "options.gpr", "did you mean 'gp'"), ("gp = false", "gp = 1", "true or false"),
    ("one_by_one = true", 'cards = ["nobody"]', "nobody"),
    ("one_by_one = true", "seeds = [-1]", "whole numbers from 0"),
    ("one_by_one = true", "seeds = [1, 1]", "twice"),
    ("one_by_one = true", 'effects = [["thrust_leg"]]', "thrust_lag"),
    ("one_by_one = true", 'effects = ["thrust_lag"]', "effects must be a list of lists"),
    ("one_by_one = true", 'task = "guess"', "identify, diagnose, fly"),
    ("one_by_one = true", 'task = "diagnose"', "noise is of no use"), ("one_by_one = true", "one_by_one = tru", "TOML"),
]  # fmt: skip
BAD_FLY = [
    ("options.windows", "options.window", "did you mean 'windows'"),
    ("options.windows", "options.gp", "unknown option of the task fly"),
    ("windows = 20", "windows = true", "write a number"),
    ("windows = 20", 'initial_state = "known"', "use one of free, fixed"),
    ('outputs = "q,alpha,az"', "outputs = 3", "write names in quotes"),
    ("windows = 20", "windows = 0", "must be positive"), ("windows = 20", "frequency = 1.5", "two frequencies"),
    ("one_by_one = true", 'noise = ["white"]', "noise is of no use"),
    ("one_by_one = true", 'effects = [[], ["thrust_lag"]]', "a linear system, which has no effects"),
    (FLY_STUDY, 'task = "diagnose"\nrecords = ["*.csv"]\ncards = ["short_period.toml"]', "a linear system"),
]  # fmt: skip
BAD_STUDIES = [*((STUDY, *row) for row in BAD), *((FLY_STUDY, *row) for row in BAD_FLY)]


@pytest.mark.usefixtures("folder", "fly_folder")
@pytest.mark.parametrize(("study", "old", "new", "told"), BAD_STUDIES)
def test_a_bad_study_is_one_sentence(program, tmp_path, study, old, new, told):
    assert old in study
    (tmp_path / "study.toml").write_text(study.replace(old, new))
    refused(program("run", "study.toml"), told, gone=["study_results"])
