"""Draws of a diagnosis: of the covariance that diagnosis.json states, as wide as the standard errors beside it."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import bayes_aero.jobs.diagnose as job
from bayes_aero.explore.opened import open_result
from bayes_aero.explore.simulator import DRAWS, Simulator
from bayes_aero.flight.reading.read_record import write_record


@pytest.fixture
def told(program, diagnosed, card, monkeypatch):
    """diagnosis.json of a diagnosis already made: test_every_stage.py has the command make one."""
    monkeypatch.setattr(job, "diagnose", lambda *_, **__: diagnosed.view.diagnosis)
    monkeypatch.setattr(job, "view_of", lambda _: diagnosed.view)
    (record,) = diagnosed.records
    write_record(record, Path("a.csv"), [c for c in card.channels if record.has(c.name) or c.name == "time"])
    done = program("diagnose", "a.csv", "--no-figures", "--no-trajectories", "--no-test-points")
    assert done.code == 0, done.err
    return json.loads(Path("diagnosis/diagnosis.json").read_text())


def reported(told):
    """Standard errors that diagnosis.json states elsewhere, of the card's parameters and of confirmed causes."""
    causes = {n: p["sd"] for c in told["causes"] if c["confirmed"] for n, p in c["parameters"].items()}
    return {name: move["sd_after"] for name, move in told["base_parameters"].items()}, causes


def test_the_covariance_is_as_wide_as_the_reported_errors(told):
    stored = told["covariance"]
    matrix, sd = np.array(stored["matrix"]), np.sqrt(np.diag(stored["matrix"]))
    own = dict(zip(stored["parameters"], sd, strict=True))
    base, causes = reported(told)
    assert stored["residuals"] == "coloured"
    assert set(base) <= set(own)
    assert [own[name] for name in base] == pytest.approx(list(base.values()), rel=1e-9)
    assert all(own[name] >= x * (1.0 - 1e-9) for name, x in causes.items() if name in own)
    np.testing.assert_array_equal(matrix, matrix.T)
    assert np.linalg.eigvalsh(matrix / np.outer(sd, sd)).min() > -1e-9


def test_draws_have_this_covariance_and_the_page_its_fan(told, program):
    """1000 normal draws: standard deviations within 10 % (four of their errors), correlations within 0.15."""
    done = program("export", "diagnosis", "--to", "jsbsim", "--draws", 1000, "--seed", 4, "--out", "one", "--json")
    assert done.code == 0, done.err
    assert "covariance corrected for coloured residuals" in json.loads(done.out)["draws"]["origin"]
    names = Path("one/draws.csv").read_text().splitlines()[0].split(",")
    draws = np.loadtxt("one/draws.csv", delimiter=",", skiprows=1)
    stored = told["covariance"]
    order = [stored["parameters"].index(name) for name in names]
    covariance = np.array(stored["matrix"])[np.ix_(order, order)]
    sd = np.sqrt(np.diag(covariance))
    np.testing.assert_allclose(draws.std(axis=0), sd, rtol=0.1)
    np.testing.assert_allclose(np.corrcoef(draws.T), covariance / np.outer(sd, sd), atol=0.15)
    simulator = Simulator(open_result("diagnosis"))
    origin, fan = simulator.fan(0)
    assert origin.startswith("normal distribution of the estimates, covariance corrected for coloured residuals")
    assert fan["alpha"].shape == (DRAWS, len(simulator.time(0)))
    assert np.all(np.std(fan["CL"], axis=0).max() > 0.0)


def test_an_older_diagnosis_says_how_to_get_draws(told, program):
    del told["covariance"]
    Path("diagnosis/diagnosis.json").write_text(json.dumps(told))
    done = program("export", "diagnosis", "--to", "jsbsim", "--draws", 10, "--out", "no")
    assert done.code == 2
    assert done.err.count("\n") == 1
    assert "run the command of the result again with this version" in done.err
    assert not Path("no").exists()
