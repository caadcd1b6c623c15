"""Studies on schedulers and workers in processes of their own, some killed while they work, against undisturbed ones:
every file of every unit, but for what names times and machines (unit.json's seconds and hashes, provenance)."""

import hashlib
import json
import os
import re
import runpy
import shutil
import signal
import socket
import subprocess
import sys
import time
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from unittest.mock import Mock

import dask
import distributed  # its defaults come with it: set before, they would go with what a test has set
import psutil
import pytest
from calling import answer, called, holds, refused, succeeded

from bayes_aero.study import run as units
from bayes_aero.study.cluster import outcome_of

pytestmark = pytest.mark.cluster
QUICK = Path(__file__).with_name("quick_units.py")
STUDY = """
records = ["flights/*.csv"]
one_by_one = true
noise = ["white"]
seeds = [0, 1, 2, 3, 4]
options.sample = false
options.gp = false
options.figures = false
options.page = false
"""
UNITS = 10  # two records, five seeds
ENVIRONMENT = {
    **{name: value for name, value in os.environ.items() if not name.startswith(("DASK_", "COVERAGE", "XLA_"))},
    "JAX_PLATFORMS": "cpu",
    "QUICK_SECONDS": "0.3",
    "DASK_DISTRIBUTED__WORKER__PRELOAD": f"['{QUICK}']",
    "DASK_DISTRIBUTED__COMM__TIMEOUTS__CONNECT": "10s",
    "DASK_DISTRIBUTED__ADMIN__TICK__INTERVAL": "1s",
    "COLUMNS": "300",
}


@pytest.fixture
def folder(flights_here):
    """A study of ten units, in a folder of its own."""
    (flights_here / "study.toml").write_text(STUDY)
    return flights_here


@pytest.fixture(scope="module")
def cluster():
    """A scheduler and two workers, all processes of their own."""
    with scheduler() as (address, _), workers(address) as process:
        yield SimpleNamespace(address=address, pid=process.pid)


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory, flights, cluster):
    """What a study leaves that nobody disturbs."""
    place = tmp_path_factory.mktemp("undisturbed")
    shutil.copytree(flights.folder, place / "flights", ignore=shutil.ignore_patterns("*.json"))
    (place / "study.toml").write_text(STUDY)
    with driving(place, "--scheduler", cluster.address) as driver:
        assert f"{UNITS} done now" in succeeded(ended(driver)).out
    return place


@contextmanager
def started(*command, **settings):
    """A process in a session of its own, with no child left behind."""
    process = subprocess.Popen(
        command, env=ENVIRONMENT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True,
        **settings,
    )  # fmt: skip
    try:
        yield process
    finally:
        for child in [*descendants(process.pid), process]:
            with_no_process(child.kill)
        process.communicate()


@contextmanager
def scheduler():
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    where = ("--host", "127.0.0.1", "--port", str(port), "--no-dashboard", "--dashboard-address", "127.0.0.1:0")
    with started(sys.executable, "-m", "distributed.cli.dask_scheduler", *where) as process:
        yield f"tcp://127.0.0.1:{port}", process


def workers(address, count=2):
    more = ("--nworkers", str(count), "--nthreads", "1", "--host", "127.0.0.1", "--no-dashboard", "--memory-limit", "0")
    return started(sys.executable, "-m", "distributed.cli.dask_worker", address, *more)


def driving(place, *more):
    return started(sys.executable, "-m", "bayes_aero", "run", "study.toml", *more, cwd=place)


def ended(process):
    out, err = process.communicate(timeout=300)
    assert "Traceback" not in err, err
    return SimpleNamespace(code=process.returncode, out=out, err=err)


def with_no_process(do):
    try:
        return do()
    except (psutil.NoSuchProcess, ProcessLookupError):
        return []


def descendants(pid):
    return with_no_process(lambda: psutil.Process(pid).children(recursive=True))


def at_work(pid):
    """Processes below that have loaded the quick units: the workers, not the nannies that watch them."""
    return [child for child in descendants(pid) if "spawn_main" in " ".join(with_no_process(child.cmdline))]


def gone(processes):
    """Whether none runs any more; one that nobody has asked how it ended is gone too."""
    return all(with_no_process(child.status) in ([], psutil.STATUS_ZOMBIE) for child in processes)


def wait_for(what, seconds=300.0):
    until = time.monotonic() + seconds
    while not (outcome := what()):
        assert time.monotonic() < until, "it never came"
        time.sleep(0.02)
    return outcome


def finished(place):
    return [path for path in (place / "study_results" / "units").glob("*/unit.json") if path.parent.name[0] != "."]


def begun(place, count=2):
    """Wait until so many units are done."""
    wait_for(lambda: len(finished(place)) >= count)


def content(out):
    """Every file of every unit by a hash, without times and machines; hidden files count, since none should be left."""
    files = {"summary.csv": (out / "summary.csv").read_bytes()}
    for path in sorted((out / "units").rglob("*")):
        if path.is_file() and path.name != "provenance.json":
            raw = path.read_bytes()
            if path.suffix == ".json":
                apart = ("seconds", "files") if path.name == "unit.json" else ("provenance",)
                raw = json.dumps({key: value for key, value in json.loads(raw).items() if key not in apart}).encode()
            files[path.relative_to(out).as_posix()] = raw
    return {name: hashlib.sha256(raw).hexdigest() for name, raw in files.items()}


def same(place, undisturbed):
    assert content(place / "study_results") == content(undisturbed / "study_results")


def finished_by(cluster, place, undisturbed):
    """The same command once more, in this process, makes what nobody disturbed."""
    succeeded(called(place, "run", "study.toml", "--scheduler", cluster.address))
    same(place, undisturbed)


def test_a_cluster_gives_the_numbers_of_one_process(program, folder, undisturbed, monkeypatch):
    monkeypatch.setattr(units, "run_task", units.run_task)  # put back after the test
    runpy.run_path(str(QUICK))
    monkeypatch.chdir(folder)
    assert program("run", "study.toml").code == 0
    same(folder, undisturbed)


def test_a_result_that_is_lost_with_its_worker_is_taken_when_it_was_made_again():
    """Between Dask's `done` and the reading of the result its status may be pending again."""
    future = Mock(
        spec=distributed.Future, status="pending", **{"cancelled.return_value": False, "exception.return_value": None}
    )
    future.result.return_value = {"name": "one"}
    assert outcome_of(future, ({"name": "one"}, "."), "tcp://127.0.0.1:1", "") == {"name": "one"}


def test_a_killed_worker_costs_nothing(folder, cluster, undisturbed):
    with driving(folder, "--scheduler", cluster.address) as driver:
        begun(folder)
        at_work(cluster.pid)[0].send_signal(signal.SIGKILL)
        done = ended(driver)
    assert done.code == 0, done.err
    assert f"{UNITS} units: {UNITS} done now" in done.out
    same(folder, undisturbed)


def test_a_killed_driver_costs_what_was_in_work(folder, cluster, undisturbed):
    with driving(folder, "--scheduler", cluster.address) as driver:
        begun(folder)
        driver.kill()
    kept = {path: path.stat().st_mtime_ns for path in finished(folder)}
    assert len(kept) < UNITS
    finished_by(cluster, folder, undisturbed)
    assert {path: path.stat().st_mtime_ns for path in kept} == kept  # nothing was done twice


@pytest.mark.verify
def test_a_killed_driver_takes_its_own_workers_along(folder, cluster, undisturbed, monkeypatch):
    monkeypatch.setitem(ENVIRONMENT, "QUICK_SECONDS", "2.0")
    with driving(folder, "--workers", "1") as driver:
        begun(folder, 1)
        orphans = at_work(driver.pid)
        driver.kill()
        assert len(orphans) == 1
        wait_for(lambda: gone(orphans), seconds=60.0)
    assert len(finished(folder)) < UNITS
    finished_by(cluster, folder, undisturbed)


@pytest.mark.verify
def test_a_lost_scheduler_is_told_and_costs_what_was_in_work(folder, cluster, undisturbed):
    with scheduler() as (address, process), workers(address, 1), driving(folder, "--scheduler", address) as driver:
        begun(folder)
        process.kill()
        done = ended(driver)
    assert done.code == 1
    lost = r"error: the scheduler at tcp://[\d.:]+ is lost; \d+ of 10 units are done and kept in study_results"
    assert re.match(lost, done.err), done.err
    assert done.err.count("\n") == 1
    assert (folder / "study_results" / "units.csv").is_file()
    finished_by(cluster, folder, undisturbed)


@pytest.mark.usefixtures("interruptible")
def test_ctrl_c_stops_at_once_and_says_how_to_go_on(folder, cluster, undisturbed, monkeypatch):
    monkeypatch.setitem(ENVIRONMENT, "QUICK_SECONDS", "2.0")  # quicker ones may be over before the signal
    with driving(folder, "--workers", "2") as driver:
        begun(folder, 1)
        children = descendants(driver.pid)
        os.killpg(driver.pid, signal.SIGINT)  # as a terminal does: to the workers too
        done = ended(driver)
        wait_for(lambda: gone(children), seconds=30.0)
    assert done.code == 130
    assert re.match(r"interrupted; \d of 10 units are done and kept in study_results; the same command", done.err)
    assert done.err.count("\n") == 1
    assert not list((folder / "study_results" / "units").glob(".*"))
    finished_by(cluster, folder, undisturbed)


@pytest.mark.verify
def test_a_unit_that_kills_its_workers_fails_alone(folder):
    (folder / "flights" / "sound.csv").rename(folder / "flights" / "deadly.csv")
    (folder / "study.toml").write_text(STUDY.replace("[0, 1, 2, 3, 4]", "[0]"))
    with driving(folder, "--workers", "2", "--json") as driver:
        rows = {row["name"].split("-")[0]: row for row in answer(ended(driver), 1)["units"]}
    assert {name: row["state"] for name, row in rows.items()} == {"biased": "done", "deadly": "failed"}
    holds(rows["deadly"]["error"], "its process died 3 times", "give fewer --workers")
    (error,) = (folder / "study_results" / "units").glob("deadly-*/error.txt")
    assert error.read_text().strip() == rows["deadly"]["error"]


@pytest.mark.parametrize("address", ["tcp://127.0.0.1:9", "udp://127.0.0.1:8786"])
def test_an_address_that_does_not_answer_is_one_sentence(program, folder, monkeypatch, address):
    monkeypatch.chdir(folder)
    with dask.config.set({"distributed.comm.timeouts.connect": "1s"}):
        done = program("run", "study.toml", "--scheduler", address)
    assert done.code == 2
    assert re.fullmatch(rf"error: --scheduler {re.escape(address)} does not answer [^\n]+\n", done.err), done.err
    assert dask.config.get("scheduler", None) is None  # else xarray would look for that client from now on
    assert not finished(folder)


def test_without_dask_the_way_to_have_it_is_told(program, folder, monkeypatch):
    monkeypatch.chdir(folder)
    monkeypatch.delitem(sys.modules, "bayes_aero.study.cluster", raising=False)
    monkeypatch.delattr("bayes_aero.study.cluster", raising=False)
    monkeypatch.setitem(sys.modules, "distributed", None)
    refused(program("run", "study.toml", "--workers", "2"), "--workers", 'pip install "bayes-aero[cluster]"')
