"""What a worker asks before it does a unit for a driver, and what it is told to keep to."""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from bayes_aero.errors import InputError
from bayes_aero.inference.threads import cores
from bayes_aero.study import jit_cache as compiled
from bayes_aero.study import worker
from bayes_aero.study.jit_cache import cache_folder
from bayes_aero.study.worker import Driver, work


@pytest.fixture
def driver(tmp_path, monkeypatch):
    """One whose folder is seen, and a worker that does nothing but tell what it was asked for."""
    monkeypatch.setattr(worker, "_configure", lambda: None)
    monkeypatch.setattr(worker, "FILE_TIMEOUT", 0.1)
    monkeypatch.setattr(worker, "run_unit", lambda given, _: {"name": given["name"], "argv": list(sys.argv)})
    return Driver.of(tmp_path)


def test_a_unit_tells_the_command_of_its_driver(driver):
    own = list(sys.argv)
    asked = replace(driver, command=("bayes-aero", "run", "study.toml"))
    assert work({"name": "one"}, "", asked, None) == {"name": "one", "argv": ["bayes-aero", "run", "study.toml"]}
    assert sys.argv == own


@pytest.mark.parametrize("package", ["jax", "bayes_aero"])
def test_other_versions_are_refused(driver, package):
    other = replace(driver, versions={**driver.versions, package: "0.0.1"})
    with pytest.raises(
        InputError, match=rf"has {package} {driver.versions[package].split()[0]}.* for 0.0.1, .*numbers"
    ):
        work({"name": "one"}, "", other, None)


def test_a_folder_that_is_not_shared_is_told(driver):
    Path(driver.token).unlink()
    with pytest.raises(InputError, match=r"does not see .*; give --out, .* under the same path"):
        work({"name": "one"}, "", driver, None)
    Path(driver.token).write_text("another folder of that name")
    with pytest.raises(InputError, match="does not see"):
        work({"name": "one"}, "", driver, None)


def test_what_is_compiled_is_forgotten_when_memory_runs_short(driver, monkeypatch):
    forgot = []
    monkeypatch.setattr("bayes_aero.inference.compiled_programs.give_back_memory", lambda: forgot.append(True))
    work({"name": "one"}, "", driver, 1 << 50)
    work({"name": "one"}, "", driver, None)
    assert not forgot
    work({"name": "one"}, "", driver, 1 << 20)
    assert forgot


def test_the_cache_lies_where_the_user_says(monkeypatch, tmp_path):
    monkeypatch.setenv("JAX_COMPILATION_CACHE_DIR", str(tmp_path / "jax"))
    assert cache_folder() == tmp_path / "jax"
    monkeypatch.delenv("JAX_COMPILATION_CACHE_DIR")
    monkeypatch.setenv("BAYES_AERO_CACHE", str(tmp_path / "ours"))
    assert cache_folder().parent == tmp_path / "ours" / "compiled"
    monkeypatch.delenv("BAYES_AERO_CACHE")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "home"))
    if sys.platform == "linux":
        assert cache_folder().parent == tmp_path / "home" / "bayes_aero" / "compiled"


def test_a_worker_keeps_to_the_cores_that_it_is_given(monkeypatch):
    monkeypatch.setenv("BAYES_AERO_CORES", "3")
    assert cores() == 3
    monkeypatch.setenv("BAYES_AERO_CORES", "")
    assert 1 <= cores() <= (os.cpu_count() or 1)


WORKER = "from bayes_aero.study import worker; worker._configure()\n"
COMMAND = """import sys; from bayes_aero.cli import main; sys.argv[1:] = ["--version"]
try: main()
except SystemExit: pass
"""


@pytest.mark.parametrize("begins", [WORKER, COMMAND])
def test_one_process_compiles_for_the_next(begins, tmp_path):
    """Real processes, workers and commands: the second finds in the cache what the first has compiled."""
    code = (
        f"{begins}"
        "import os, jax, jax.numpy as jnp\n"
        "seen = []\n"
        "jax.monitoring.register_event_listener(lambda name, **_: seen.append(name.rsplit('/', 1)[1]))\n"
        "jax.jit(lambda x: jnp.linalg.cholesky(x @ x.T + jnp.eye(5)).sum())(jnp.ones((5, 5))).block_until_ready()\n"
        "print(seen.count('cache_hits'), seen.count('cache_misses'))\n"
    )
    settings = {k: v for k, v in os.environ.items() if not k.startswith(("JAX_COMPILATION", "XLA_"))}
    settings |= {"JAX_PLATFORMS": "cpu", "BAYES_AERO_CACHE": str(tmp_path), compiled.MIN_SECONDS: "0"}
    told = []
    for _ in range(2):
        ended = subprocess.run(
            [sys.executable, "-c", code], env=settings, capture_output=True, text=True, timeout=120, check=True
        )
        told.append([int(x) for x in ended.stdout.splitlines()[-1].split()])
        assert not ended.stderr
    (hits, misses), (later, none) = told
    assert hits == 0
    assert misses > 0
    assert (later, none) == (misses, 0)


def test_a_cache_that_cannot_be_made_is_done_without(monkeypatch, tmp_path):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("BAYES_AERO_CACHE", str(tmp_path / "file"))
    monkeypatch.delenv(compiled.FOLDER, raising=False)
    monkeypatch.delitem(sys.modules, "jax")
    compiled.enable_cache()
    assert compiled.FOLDER not in os.environ
