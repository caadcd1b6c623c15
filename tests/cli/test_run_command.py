"""Studies: units are made once, resumed, redone where inputs changed, and never anywhere else; and of trajectories."""

import hashlib
import inspect
import json
import re
import shutil
import tomllib
from importlib.metadata import version
from pathlib import Path

import pandas as pd
import pytest
from calling import RINGS, answer, holds, page_of, refused, succeeded, validated
from linear_cards import SHORT_PERIOD_TRUTH

import bayes_aero
from bayes_aero.cli.fits import fly
from bayes_aero.errors import InputError
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
    rows = answer(program("run", "study.toml", *more, "--json"))["units"]
    return {row["name"].split("-")[0]: row for row in rows}


def test_a_study_is_done_once_and_redone_where_its_inputs_changed_or_a_number_was_doctored(program, folder, calls):
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

    results = next((folder / "study_results" / "units").glob("sound-*")) / "results.json"
    doctored = json.loads(results.read_text())
    doctored["mle"]["parameters"]["CLa"]["estimate"] += 1e-9
    write_json(doctored, results)
    planned = {name: row["state"] for name, row in states(program, "--dry-run").items()}
    assert planned == {"sound": "damaged", "biased": "done"}
    assert program("run", "study.toml").code == 0
    assert json.loads(results.read_text()) != doctored


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
    holds(page_of(folder / "study_results"), "All 2 units are done; all converged; ", *table["unit"])


@pytest.mark.usefixtures("calls")
def test_a_unit_that_fails_says_why_and_stops_nobody_and_its_doubts_are_told(program, folder, monkeypatch):
    quick = units.run_task

    def failing(unit, out, *_):
        if unit.shown[0].endswith("biased.csv"):
            raise InputError("this record is too short; give a longer one")
        quick(unit, out)

    def doubtful(unit, out, *_):
        quick(unit, out)
        doubts = {"health": [{"sentence": "biased: q is in deg/s", "grave": True}]}
        doubts |= {"consistency": {"outcome": "disagree_explained"}}
        write_json(json.loads((out / "results.json").read_text()) | doubts, out / "results.json")

    monkeypatch.setattr(units, "run_task", failing)
    assert "this record is too short" in succeeded(program("run", "study.toml"), 1).out
    root = folder / "study_results" / "units"
    files = {p.name.split("-")[0]: [f.name for f in p.iterdir()] for p in root.iterdir()}
    assert "error.txt" in files["biased"]
    assert "results.json" in files["sound"]
    monkeypatch.setattr(units, "run_task", doubtful)
    done = succeeded(program("run", "study.toml"), 3)  # tried again
    assert states(program, "--dry-run")["biased"]["state"] == "done"
    first, second = (line for line in done.out.splitlines() if line.startswith("! biased"))
    assert first.endswith(": biased: q is in deg/s")
    assert "the sensors disagree along the flight path" in second
    table = pd.read_csv(folder / "study_results" / "units.csv").set_index("unit")["doubts"].fillna("")
    assert [bool(doubts) for doubts in table] == [name.startswith("biased") for name in table.index]


def test_units_are_real_work_and_the_environment_is_kept(program, folder, monkeypatch):
    """The runner around `identify`, maximum likelihood alone, so that it is quick."""
    monkeypatch.setattr(job, "posterior_plan", lambda _: [])
    text = STUDY.replace("flights/*.csv", "flights/sound.csv") + "options.resample = 0.08\n"
    (folder / "study.toml").write_text(text)
    succeeded(program("run", "study.toml", "--json"), RINGS)
    out, record = folder / "study_results", folder / "flights" / "sound.csv"
    (unit,) = (out / "units").iterdir()
    made = json.loads((unit / "provenance.json").read_text())
    assert made["inputs"][0]["sha256"] == hashlib.sha256(record.read_bytes()).hexdigest()
    assert made["settings"]["options"] == {"gp": False, "figures": False, "resample": 0.08}
    table, again = pd.read_csv(out / "summary.csv"), pd.read_parquet(out / "summary.parquet")
    pd.testing.assert_frame_equal(table[["value", "sd"]], again[["value", "sd"]], check_dtype=False)
    assert set(table["method"]) == {"mle", "mle_corrected"}
    assert set(table["records"]) == {"flights/sound.csv"}
    # Noise-free flight of an aircraft whose truth is known: the estimate is the truth but for filters and integration.
    assert table.set_index(["method", "parameter"]).loc[("mle", "CLa"), "value"] == pytest.approx(3.6, rel=0.05)
    requirements = (out / "environment" / "requirements.txt").read_text()
    assert f"\njax=={version('jax')}\n" in requirements
    assert requirements.splitlines()[-1].startswith(f"# and bayes-aero {bayes_aero.__version__} (source_sha256")
    assert (out / "study.toml").read_text() == text


def test_the_units_are_the_product_of_all_lists_and_have_the_same_names_where_the_study_was_moved(folder):
    text = STUDY + 'seeds = [0, 1]\nsplits = ["random", "block"]\neffects = [[], ["alpha_squared_moment"]]\n'
    text = text.replace('["white"]', '["white", "ar1", "buffet-ar1"]')
    # Keys after "options.gp" are still keys of the study: dotted keys open no section.
    (folder / "study.toml").write_text(text)
    made = read_study(folder / "study.toml").units
    assert len(made) == len({unit.name for unit in made}) == 2 * 2 * 2 * 2 * 3
    assert all(units.Unit.of_json(json.loads(json.dumps(unit.as_json()))) == unit for unit in made)
    moved = folder / "elsewhere"
    shutil.copytree(folder / "flights", moved / "flights")
    shutil.copy(folder / "study.toml", moved)
    assert [u.name for u in read_study(moved / "study.toml").units] == [u.name for u in made]


def test_the_study_in_the_documentation_is_one_and_options_are_the_command_s():
    text = (Path(__file__).parents[2] / "docs" / "howto" / "studies.md").read_text(encoding="utf-8")
    block = text.split("`bayes-aero run")[0]
    table = tomllib.loads("\n".join(line for line in block.splitlines() if line.startswith("    ")))
    assert set(table) <= set(KEYS)
    assert set(table["options"]) <= set(OPTIONS[table["task"]])
    rows = re.findall(r"^\| `(\w+)` \| (.*) \| `(.*)` \|$", text, re.M)
    listed = {task: set(re.findall(r"\w+", options)) for task, options, _ in rows}
    assert listed == {task: set(options) for task, options in OPTIONS.items()}
    assert {task: name for task, _, name in rows} == RESULTS
    asked = set(inspect.signature(fly).parameters)
    own = {"records", "model", "out", "seed", "verbose", "timings", "json"}  # a study has its own
    assert asked - set(OPTIONS["fly"]) == own
    assert asked >= set(OPTIONS["fly"])


FLY_STUDY = """
task = "fly"
records = ["*.csv"]
one_by_one = true
cards = ["sp.toml"]
options.windows = 5
options.priors = false
options.outputs = "q,alpha,az"
options.figures = false
"""


@pytest.fixture
def fly_folder(short_period, tmp_path):
    """Two flights of a linear system, its card and a study of both."""
    for name in ("sp.toml", "one.csv", "two.csv"):
        shutil.copy(short_period.folder / name, tmp_path)
    (tmp_path / "study.toml").write_text(FLY_STUDY)
    return tmp_path


def test_linear_cards_fly_and_process_noise_changes_nothing_in_calm_air(program, fly_folder, short_period):
    """Estimates are the same within their errors, measurement noise is as it was made, process noise next to none."""
    (fly_folder / "study.toml").write_text(FLY_STUDY + "options.process_noise = true\n")
    succeeded(program("run", "study.toml"))
    out, noise = fly_folder / "study_results", short_period.noise
    units = pd.read_csv(out / "units.csv")
    assert list(units["verdict"]) == ["converged"] * 2
    assert set(units["task"]) == {"fly"}
    table = pd.read_csv(out / "summary.csv").set_index("method")
    keys = {"output_error": "crb", "output_error_corrected": "sd_corrected"}
    assert len(table.loc[list(keys)]) == 2 * 2 * len(SHORT_PERIOD_TRUTH)  # records, deviations, parameters
    results = {unit: validated(out / "units" / unit / "trajectories.json", "trajectories") for unit in units["unit"]}
    for method, row in table.loc[["process_noise", *keys]].iterrows():
        parameter = results[row["unit"]]["parameters"][row["parameter"]]
        sd = row["sd"] if method == "process_noise" else parameter["sd_corrected"]
        assert abs(row["value"] - SHORT_PERIOD_TRUTH[row["parameter"]]) < 4.0 * sd, row["parameter"]
        assert row["high95"] - row["low95"] == pytest.approx(2.0 * 1.96 * row["sd"])
        assert row["status"] == "converged"
        if method in keys:
            expected = (parameter["estimate"], parameter[keys[method]], parameter["unit"])
            assert (row["value"], row["sd"], row["unit_of_value"]) == expected
    unit, content = next(iter(results.items()))
    assert content["windows"] == 5.0
    assert content["setting"] == {"initial_state": "free", "priors": False, "inputs": "linear"}
    assert content["fitted_outputs"] == ["q", "alpha", "az"]
    filtered = content["process_noise"]
    assert filtered["converged"]
    for name, (estimate, sd) in filtered["estimates"].items():
        assert abs(estimate - content["parameters"][name]["estimate"]) < sd, name
    for name, sd in filtered["noise_sd"].items():
        assert sd == pytest.approx(noise[name], rel=0.1)
    assert filtered["F"]["alpha"] < 0.2 * noise["alpha"] / 0.04**0.5  # of what noise adds to a step
    assert abs(filtered["gain"]) < 10.0
    assert max(map(abs, filtered["autocorrelation"].values())) < 0.2
    one_step = filtered["one_step"]
    assert one_step["status"] == "calibrated"
    assert set(one_step["outputs"]) == set(filtered["noise_sd"])
    for name, predicted in one_step["outputs"].items():
        assert predicted["rms"] == pytest.approx(noise[name], rel=0.15)  # the state is known far better
        assert [share["level"] for share in predicted["shares"]] == [0.5, 0.9, 0.95, 0.99]
    assert any("inside their 95 % intervals: q " in sentence for sentence in content["sentences"])
    holds(page_of(out / "units" / unit), "with process noise", "inside the interval, %")
    assert not (out / "units" / unit / "figures").exists()


BAD = [
    ("title", "titel", "did you mean 'title'"), ("flights/*.csv", "flights/none.csv", "flights/none.csv"),
    ("flights/*.csv", "flights/*.mat", "no record matches"), ('["white"]', '["pink"]', "'pink'"),
    ('["white"]', '"white"', "noise must be a list of white, ar1"),
    ("options.gp", "options.gpr", "did you mean 'gp'"), ("gp = false", "gp = 1", "true or false"),
    ("one_by_one = true", 'cards = ["nobody"]', "nobody"), ("one_by_one = true", "seeds = [1, 1]", "twice"),
    ("one_by_one = true", "seeds = [-1]", "whole numbers from 0"),
    ("one_by_one = true", 'effects = [["thrust_leg"]]', "thrust_lag"),
    ("one_by_one = true", 'effects = ["thrust_lag"]', "effects must be a list of lists"),
    ("one_by_one = true", 'task = "guess"', "identify, diagnose, fly"),
    ("one_by_one = true", 'task = "diagnose"', "noise is of no use"), ("one_by_one = true", "one_by_one = tru", "TOML"),
]  # fmt: skip
BAD_FLY = [
    ("options.windows", "options.gp", "unknown option of the task fly"), ("windows = 5", "windows = true", "a number"),
    ("windows = 5", 'initial_state = "known"', "use one of free, fixed"), ("windows = 5", "windows = 0", "positive"),
    ('outputs = "q,alpha,az"', "outputs = 3", "write names in quotes"),
    ("windows = 5", "frequency = 1.5", "two frequencies"), ("one_by_one = true", 'noise = ["white"]', "of no use"),
    ("one_by_one = true", 'effects = [[], ["thrust_lag"]]', "a linear system, which has no effects"),
    (FLY_STUDY, 'task = "diagnose"\nrecords = ["*.csv"]\ncards = ["sp.toml"]', "a linear system"),
]  # fmt: skip
BAD_STUDIES = [*((STUDY, *row) for row in BAD), *((FLY_STUDY, *row) for row in BAD_FLY)]


@pytest.mark.usefixtures("folder", "fly_folder")
@pytest.mark.parametrize(("study", "old", "new", "words"), BAD_STUDIES)
def test_a_bad_study_is_one_sentence(program, tmp_path, study, old, new, words):
    assert old in study
    (tmp_path / "study.toml").write_text(study.replace(old, new))
    refused(program("run", "study.toml"), words, gone=["study_results"])
