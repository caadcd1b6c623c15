"""Studies of trajectories: options of the command, summary rows, verification, and what a linear card cannot have."""

from __future__ import annotations

import inspect
import json

import numpy as np
import pandas as pd
import pytest
from linear_cards import SHORT_PERIOD, SHORT_PERIOD_TRUTH, card_of, record_of, short_period_flight

from bayes_aero.cli.fly import fly
from bayes_aero.flight.reading.read_record import write_record
from bayes_aero.study.study import OPTIONS

NOISE = {"alpha": 0.002, "q": 0.003, "az": 0.15}
STUDY = """
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
def folder(tmp_path):
    """Two short flights of a linear system, its card and a study of both."""
    (tmp_path / "short_period.toml").write_text(SHORT_PERIOD)
    channels = card_of(SHORT_PERIOD).channels
    for seed, name in enumerate(("one", "two")):
        flight = short_period_flight(SHORT_PERIOD_TRUTH, n=300, x0=(0.04, 0.02 * seed))
        noisy = record_of(flight, noise=NOISE, rng=np.random.default_rng(seed), name=name)
        write_record(noisy, tmp_path / f"{name}.csv", channels)
    (tmp_path / "study.toml").write_text(STUDY)
    return tmp_path


def test_options_are_the_command_s():
    asked = inspect.signature(fly).parameters
    assert set(OPTIONS["fly"]) <= set(asked)
    assert set(asked) - set(OPTIONS["fly"]) == {
        "records",
        "model",
        "out",
        "seed",
        "json",
    }  # a study has its own of these


def test_process_noise_has_rows_of_its_own(program, folder):
    (folder / "study.toml").write_text(STUDY.replace('"*.csv"', '"one.csv"') + BOTH)
    done = program("run", "study.toml")
    assert done.code == 0, done.out + done.err
    (flown,) = (folder / "study_results").rglob("trajectories.json")
    assert json.loads(flown.read_text())["frequency"]
    table = pd.read_csv(folder / "study_results" / "summary.csv")
    rows = table[table["method"] == "process_noise"].set_index("parameter")
    assert set(rows.index) == set(SHORT_PERIOD_TRUTH)
    assert all(abs(rows["value"] - pd.Series(SHORT_PERIOD_TRUTH)) < 4.0 * rows["sd"])


def test_a_band_is_two_frequencies(program, folder):
    (folder / "study.toml").write_text(STUDY + "options.frequency = 1.5\n")
    done = program("run", "study.toml")
    assert done.code == 2
    assert "write two frequencies in Hz" in done.err


def test_linear_cards_fly_and_are_verified(program, folder):
    done = program("run", "study.toml")
    assert done.code == 0, done.out + done.err
    out = folder / "study_results"
    units = pd.read_csv(out / "units.csv")
    assert list(units["verdict"]) == ["converged"] * 2
    assert set(units["task"]) == {"fly"}
    table = pd.read_csv(out / "summary.csv")
    assert len(table) == 2 * 2 * len(SHORT_PERIOD_TRUTH)  # records, deviations, parameters
    for _, row in table.iterrows():
        found = json.loads((out / "units" / row["unit"] / "trajectories.json").read_text())
        known = found["parameters"][row["parameter"]]
        assert abs(row["value"] - SHORT_PERIOD_TRUTH[row["parameter"]]) < 4.0 * known["sd_corrected"], row["parameter"]
        key = {"output_error": "crb", "output_error_corrected": "sd_corrected"}[row["method"]]
        assert (row["value"], row["sd"], row["unit_of_value"]) == (known["estimate"], known[key], known["unit"])
        assert row["high95"] - row["low95"] == pytest.approx(2.0 * 1.96 * row["sd"])
        assert row["status"] == "converged"
    first = out / "units" / units["unit"][0]
    assert found["windows"] == 20.0
    assert found["setting"] == {"initial_state": "free", "priors": False, "inputs": "linear"}
    assert found["fitted_outputs"] == ["q", "alpha", "az"]
    assert (first / "report.html").is_file()
    assert not (first / "figures").exists()


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (("options.windows", "options.window"), "did you mean 'windows'"),
        (("options.windows", "options.gp"), "unknown option of the task fly"),
        (("windows = 20", "windows = true"), "write a number"),
        (("windows = 20", 'initial_state = "known"'), "use one of free, fixed"),
        (('outputs = "q,alpha,az"', "outputs = 3"), "write names in quotes"),
        (("windows = 20", "windows = 0"), "must be positive"),
        (("one_by_one = true", 'noise = ["white"]'), "noise is of no use"),
        (("one_by_one = true", 'effects = [[], ["thrust_lag"]]'), "a linear system, which has no effects"),
        ((STUDY, 'task = "diagnose"\nrecords = ["*.csv"]\ncards = ["short_period.toml"]'), "a linear system"),
    ],
)
def test_a_bad_study_is_one_sentence(program, folder, change, told):
    assert change[0] in STUDY
    (folder / "study.toml").write_text(STUDY.replace(*change))
    done = program("run", "study.toml")
    assert done.code == 2
    assert told in done.err
    assert done.err.count("\n") == 1
    assert not (folder / "study_results").exists()


def test_windows_too_short_to_fly_fail_their_units(program, folder):
    (folder / "study.toml").write_text(STUDY.replace("windows = 20", "windows = 0.2"))
    done = program("run", "study.toml")
    assert done.code == 1
    assert done.out.count("at least 1 s") == 2
