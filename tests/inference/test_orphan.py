"""Processes that train for a parent that was killed do not outlive it."""

from __future__ import annotations

import os
import subprocess
import sys
import time

import psutil
import pytest

from bayes_aero.inference import parent_watchdog as orphan

PARENT = """
import os, time
from joblib import Parallel, delayed, parallel_config
from bayes_aero.inference.parent_watchdog import exit_with

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
    monkeypatch.setattr(orphan.os, "_exit", lambda code: pytest.fail(f"left with {code}"))
    monkeypatch.setattr(orphan, "POLL_SECONDS", 0.01)
    orphan.exit_with(os.getpid())
    time.sleep(0.1)
    assert orphan._watched == set()
