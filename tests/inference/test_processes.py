"""Processes and compiled programs end with what they were made for."""

import os
import subprocess
import sys
import time

import jax
import jax.numpy as jnp
import psutil
import pytest

from bayes_aero import processes as compiled_programs
from bayes_aero.processes import MAPPINGS, full_of_programs, give_back_memory

# Processes that train for a parent that was killed do not outlive it
PARENT = """
import os, time
from joblib import Parallel, delayed, parallel_config
from bayes_aero.processes import exit_with

def work(parent):
    exit_with(parent)
    print(os.getpid(), flush=True)
    time.sleep(600.0)

with parallel_config(backend="loky"):
    Parallel(n_jobs=2)(delayed(work)(os.getpid()) for _ in range(2))
"""


@pytest.mark.skipif(sys.platform == "win32", reason="a process has no new parent there")
def test_processes_end_with_a_parent_that_is_killed():
    with subprocess.Popen([sys.executable, "-c", PARENT], stdout=subprocess.PIPE, text=True) as parent:
        assert parent.stdout is not None
        children = [psutil.Process(int(parent.stdout.readline())) for _ in range(2)]
        assert all(child.ppid() == parent.pid for child in children)
        parent.kill()
    _, alive = psutil.wait_procs(children, timeout=20.0)
    assert [child for child in alive if child.status() != psutil.STATUS_ZOMBIE] == []


def test_nothing_watches_in_the_process_itself(monkeypatch):
    monkeypatch.setattr(compiled_programs.os, "_exit", lambda code: pytest.fail(f"left with {code}"))
    monkeypatch.setattr(compiled_programs, "POLL_SECONDS", 0.01)
    compiled_programs.exit_with(os.getpid())
    time.sleep(0.1)
    assert compiled_programs._watched == set()


# Compiled programs take memory mappings, of which Linux allows a process so many
LINUX_ONLY = pytest.mark.skipif(sys.platform != "linux", reason="another system has no such limit")


def mappings():
    return len(MAPPINGS.read_text().splitlines())


@pytest.mark.forgets
@LINUX_ONLY
def test_programs_take_mappings_and_give_them_back():
    give_back_memory()
    before = mappings()
    for k in range(40):
        jax.jit(lambda x, k=k: jax.lax.scan(lambda c, y: (c + k * jnp.sin(y), c), 0.0, x)[0])(jnp.ones(3 + k))
    taken = mappings() - before
    assert taken >= 40
    give_back_memory()
    assert mappings() - before < 0.5 * taken


@pytest.mark.forgets
@LINUX_ONLY
def test_a_process_is_full_near_the_limit_of_the_system(tmp_path, monkeypatch):
    limit = tmp_path / "max_map_count"
    monkeypatch.setattr(compiled_programs, "LIMIT", limit)
    assert not full_of_programs()  # no such limit
    for allowed, full in ((2 * mappings(), False), (mappings(), True)):
        limit.write_text(f"{allowed}\n")
        assert full_of_programs() is full
