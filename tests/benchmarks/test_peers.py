"""The race against the peers runs, and all who find the optimum find the same one; of speed it says nothing here."""

import importlib
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

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
