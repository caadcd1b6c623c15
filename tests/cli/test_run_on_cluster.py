"""Studies on real schedulers and workers, in processes of their own, of which some are killed while they work.

Each study that was disturbed and then done again is compared with one that nobody disturbed: every file of every unit,
but for what names times and machines (unit.json's seconds and hashes, provenance).
"""

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

import dask
import distributed  # noqa: F401  (its defaults come with it: set before, they would go with what a test has set)
import psutil
import pytest
from calling import called, refused, succeeded

from bayes_aero.study import run as units

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
    done = succeeded(run(place, "--scheduler", cluster.address))
    assert f"{UNITS} done now" in done.out
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
        for one in [*descendants(process.pid), process]:
            with_no_process(one.kill)
        process.communicate()


@contextmanager
def scheduler():
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    module = "distributed.cli.dask_scheduler"
    where = ("--host", "127.0.0.1", "--port", str(port), "--no-dashboard", "--dashboard-address", "127.0.0.1:0")
    with started(sys.executable, "-m", module, *where) as process:
        yield f"tcp://127.0.0.1:{port}", process


@contextmanager
def workers(address, count=2):
    more = ("--nworkers", str(count), "--nthreads", "1", "--host", "127.0.0.1", "--no-dashboard", "--memory-limit", "0")
    with started(sys.executable, "-m", "distributed.cli.dask_worker", address, *more) as process:
        yield process


@contextmanager
def driving(place, *more, study="study.toml"):
    with started(sys.executable, "-m", "bayes_aero", "run", study, *more, cwd=place) as process:
        yield process


def ended(process):
    out, err = process.communicate(timeout=300)
    assert "Traceback" not in err, err
    return SimpleNamespace(code=process.returncode, out=out, err=err)


def run(place, *more):
    with driving(place, *more) as process:
        return ended(process)


def done_again(place, cluster):
    """The same command after what has disturbed it, which needs no process of its own."""
    return called(place, "run", "study.toml", "--scheduler", cluster.address)


def with_no_process(do):
    try:
        return do()
    except (psutil.NoSuchProcess, ProcessLookupError):
        return []


def descendants(pid):
    return with_no_process(lambda: psutil.Process(pid).children(recursive=True))


def at_work(cluster_or_driver):
    """Processes that have loaded the quick units: the workers, not the nannies that watch them."""
    found = []
    for process in descendants(cluster_or_driver):
        line = " ".join(with_no_process(process.cmdline))
        if "spawn_main" in line:
            found.append(process)
    return found


def gone(processes):
    """Whether none runs any more; one that nobody has asked how it ended is gone too."""
    return all(with_no_process(one.status) in ([], psutil.STATUS_ZOMBIE) for one in processes)


def wait_for(what, seconds=300.0):
    until = time.monotonic() + seconds
    while not (found := what()):
        assert time.monotonic() < until, "it never came"
        time.sleep(0.02)
    return found


def finished(place):
    return [path for path in (place / "study_results" / "units").glob("*/unit.json") if path.parent.name[0] != "."]


def content(out):
    """Every file of every unit by a hash, without times and machines; hidden files count, since none should be left."""
    found = {}
    for path in sorted((out / "units").rglob("*")):
        name = path.relative_to(out).as_posix()
        if path.is_file() and path.name != "provenance.json":
            raw = path.read_bytes()
            if path.suffix == ".json":
                told = json.loads(raw)
                apart = ("seconds", "files") if path.name == "unit.json" else ("provenance",)
                raw = json.dumps({key: value for key, value in told.items() if key not in apart}).encode()
            found[name] = hashlib.sha256(raw).hexdigest()
    found["summary.csv"] = hashlib.sha256((out / "summary.csv").read_bytes()).hexdigest()
    return found


def same(place, undisturbed):
    assert content(place / "study_results") == content(undisturbed / "study_results")


def test_a_cluster_gives_the_numbers_of_one_process(program, folder, undisturbed, monkeypatch):
    monkeypatch.setattr(units, "run_task", units.run_task)  # put back after the test
    runpy.run_path(str(QUICK))
    monkeypatch.chdir(folder)
    assert program("run", "study.toml").code == 0
    same(folder, undisturbed)


def test_a_killed_worker_costs_nothing(folder, cluster, undisturbed):
    with driving(folder, "--scheduler", cluster.address) as driver:
        wait_for(lambda: len(finished(folder)) >= 2)
        at_work(cluster.pid)[0].send_signal(signal.SIGKILL)
        done = ended(driver)
    assert done.code == 0, done.err
    assert f"{UNITS} units: {UNITS} done now" in done.out
    same(folder, undisturbed)


def test_a_killed_driver_costs_what_was_in_work(folder, cluster, undisturbed):
    with driving(folder, "--scheduler", cluster.address) as driver:
        wait_for(lambda: len(finished(folder)) >= 2)
        driver.kill()
    kept = {path: path.stat().st_mtime_ns for path in finished(folder)}
    assert len(kept) < UNITS
    succeeded(done_again(folder, cluster))
    assert {path: path.stat().st_mtime_ns for path in kept} == kept  # nothing was done twice
    same(folder, undisturbed)


@pytest.mark.verify
def test_a_killed_driver_takes_its_own_workers_along(folder, cluster, undisturbed, monkeypatch):
    monkeypatch.setitem(ENVIRONMENT, "QUICK_SECONDS", "2.0")
    with driving(folder, "--workers", "1") as driver:
        wait_for(lambda: finished(folder))
        orphans = at_work(driver.pid)
        driver.kill()
        assert len(orphans) == 1
        wait_for(lambda: gone(orphans), seconds=60.0)
    assert len(finished(folder)) < UNITS
    assert done_again(folder, cluster).code == 0
    same(folder, undisturbed)


@pytest.mark.verify
def test_a_lost_scheduler_is_told_and_costs_what_was_in_work(folder, cluster, undisturbed):
    with scheduler() as (address, process), workers(address, 1), driving(folder, "--scheduler", address) as driver:
        wait_for(lambda: len(finished(folder)) >= 2)
        process.kill()
        done = ended(driver)
    assert done.code == 1
    told = r"error: the scheduler at tcp://[\d.:]+ is lost; \d+ of 10 units are done and kept in study_results"
    assert re.match(told, done.err), done.err
    assert done.err.count("\n") == 1
    assert (folder / "study_results" / "units.csv").is_file()
    assert done_again(folder, cluster).code == 0
    same(folder, undisturbed)


@pytest.mark.usefixtures("interruptible")
def test_ctrl_c_stops_at_once_and_says_how_to_go_on(folder, cluster, undisturbed, monkeypatch):
    monkeypatch.setitem(ENVIRONMENT, "QUICK_SECONDS", "2.0")  # quicker ones may be over before the signal
    with driving(folder, "--workers", "2") as driver:
        wait_for(lambda: finished(folder))
        children = descendants(driver.pid)
        os.killpg(driver.pid, signal.SIGINT)  # as a terminal does: to the workers too
        began = time.monotonic()
        done = ended(driver)
        assert time.monotonic() - began < 30.0
        wait_for(lambda: gone(children), seconds=30.0)
    assert done.code == 130
    assert re.match(r"interrupted; \d of 10 units are done and kept in study_results; the same command", done.err)
    assert done.err.count("\n") == 1
    assert not list((folder / "study_results" / "units").glob(".*"))
    assert done_again(folder, cluster).code == 0
    same(folder, undisturbed)


@pytest.mark.verify
def test_a_unit_that_kills_its_workers_fails_alone(folder):
    (folder / "flights" / "sound.csv").rename(folder / "flights" / "deadly.csv")
    (folder / "study.toml").write_text(STUDY.replace("[0, 1, 2, 3, 4]", "[0]"))
    done = run(folder, "--workers", "2", "--memory", "2GiB", "--json")
    assert done.code == 1, done.err
    rows = {row["name"].split("-")[0]: row for row in json.loads(done.out)["units"]}
    assert rows["biased"]["state"] == "done"
    assert rows["deadly"]["state"] == "failed"
    assert "its process died 3 times" in rows["deadly"]["error"]
    assert "--memory 2.00 GiB" in rows["deadly"]["error"]
    (error,) = (folder / "study_results" / "units").glob("deadly-*/error.txt")
    assert error.read_text().strip() == rows["deadly"]["error"]


@pytest.mark.verify
def test_a_full_disk_is_told_and_costs_what_was_in_work(folder, cluster, undisturbed):
    out = folder / "study_results"
    out.mkdir()
    with small_disk(out, "3m"):
        done = run(folder, "--scheduler", cluster.address)
        assert done.code == 2
        assert re.fullmatch(r"error: the disk of \S+/units is full; [^\n]+\n", done.err), done.err
        assert 2 <= len(finished(folder)) < UNITS  # a unit takes 0.3 of 3 MB, of which the last is never begun
        assert not list((out / "units").glob(".*"))
        subprocess.run(["mount", "-o", "remount,size=16m", out], check=True)
        assert done_again(folder, cluster).code == 0
        same(folder, undisturbed)


@contextmanager
def small_disk(place, size):
    mount = ["mount", "-t", "tmpfs", "-o", f"size={size}", "tmpfs", place]
    if sys.platform != "linux" or subprocess.run(mount, capture_output=True, check=False).returncode:
        pytest.skip("a small disk cannot be mounted; test_units_of_work.py limits the size of files instead")
    try:
        yield
    finally:
        subprocess.run(["umount", "--lazy", place], check=False)


@pytest.mark.parametrize("address", ["tcp://127.0.0.1:9", "nowhere", "udp://127.0.0.1:8786"])
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
