"""Rivals: peers that reach the same optimum (of speed nothing is said), and networks that take a process's place."""

import importlib
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from seed_rivals import INNER, Problem, _runs, one_step, problems

PEERS = Path(__file__).parents[2] / "benchmarks" / "peers"


def rows_of(text):
    """Cells of every row of the tables, by the contender's name."""
    lines = [[cell.strip() for cell in line.strip("|").split("|")] for line in text.splitlines() if line[:2] == "| "]
    return {cells[0]: cells[1:] for cells in lines}


@pytest.fixture(scope="module")
def quick(tmp_path_factory, model, thinned):
    folder = tmp_path_factory.mktemp("peers")
    noise = np.random.default_rng(3).standard_normal(thinned.measured.shape) * [0.02, 0.004, 0.008]
    with pytest.MonkeyPatch.context() as patch:
        for path in (PEERS.parent, PEERS):
            patch.syspath_prepend(path)
        problem = importlib.import_module("problem")
        asked = {"of": [], "sizes": [60], "quick": True}
        problem.lay_down(model, replace(thinned, measured=thinned.measured + noise), folder, asked)
    settings = os.environ | {"PYTHONPATH": str(PEERS.parents[1]), "JAX_COMPILATION_CACHE_DIR": str(folder / "programs")}
    command = [sys.executable, str(PEERS), "--quick", "--blocks", "fits", "--folder", str(folder)]
    command += ["--out", str(folder / "table.md")]
    ended = subprocess.run(command, env=settings, capture_output=True, text=True, timeout=300, check=False)
    assert ended.returncode == 0, ended.stderr
    return (folder / "table.md").read_text(), ended.stdout


def test_scipy_and_the_package_reach_one_optimum_each_with_its_own_memory(quick):
    written, printed = quick
    assert written == printed
    rows = rows_of(written)
    for name in ("bayes_aero", "scipy least_squares, trf", "scipy least_squares, lm"):
        assert float(rows[name][2]) < 1e-2, (name, rows[name])  # nats above the best
    assert float(rows["scipy least_squares, lm"][3]) < 0.6 * float(rows["bayes_aero"][3])  # it does without JAX


def test_a_record_that_is_not_there_is_one_sentence():
    command = [sys.executable, str(PEERS), "nowhere.csv"]
    ended = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert ended.returncode == 2
    assert "no record at nowhere.csv" in ended.stderr
    assert "Traceback" not in ended.stderr


SEED = 11


@pytest.mark.parametrize("kind", list(INNER))
def test_the_inner_holdout_is_a_part_of_the_training_part(kind):
    m = 300
    flights = SimpleNamespace(
        inputs=np.zeros((m, 4)), states=np.zeros((m, 4)), measured=np.zeros((m, 3)),
        manoeuvre=np.repeat([0, 1], [180, 120]), state=SimpleNamespace(responses=SimpleNamespace(seconds=0.2)),
    )  # fmt: skip
    found = problems(flights, kind)
    held_out = sum((~p.train).astype(int) for p in found)
    assert held_out.max() == 1
    for p in found:
        assert not np.any(p.inner & ~p.train)
        assert 0.2 < p.inner.sum() / p.train.sum() < 0.4
        if kind == "manoeuvre":
            assert len(np.unique(p.manoeuvre[p.train])) == 1


def test_stretches_are_marked_blocks():
    rows = np.array([1, 1, 0, 1, 0, 0, 1], bool)
    assert _runs(rows) == (slice(0, 2), slice(3, 4), slice(6, 7))


def test_a_one_step_network_finds_the_parameter_that_flew_the_states():
    pytest.importorskip("sklearn", reason="scikit-learn comes with the `bench` extra")
    rng = np.random.default_rng(SEED)
    m, true = 600, 0.7
    control = np.repeat(rng.standard_normal(m // 10), 10)
    x = np.zeros(m)
    for k in range(m - 1):
        x[k + 1] = 0.9 * x[k] + 0.2 * true * control[k]
    measured = (true * control)[:, None]
    train = np.arange(m) < 400
    inner = train & (np.arange(m) >= 300)
    problem = Problem(control[:, None], measured, x[:, None], np.zeros(m, int), train, inner)
    guess = one_step(problem, SEED, lambda theta: theta[0] * control[:, None], np.array([0.2]), ([-5.0], [5.0]))
    np.testing.assert_allclose(guess.mean, measured, atol=0.01 * true * np.abs(control).max())
