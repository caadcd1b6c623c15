"""Work of studies: beside others, on workers, and in files that appear whole whatever happens."""

import errno
import json
import os
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from threading import Event, get_ident

import pytest

from bayes_aero import atomic_write as durable
from bayes_aero import processes as compiled
from bayes_aero.atomic_write import beside, put_folder, sweep, write_whole
from bayes_aero.errors import ERROR, InputError, no_space
from bayes_aero.jobs.diagnose import in_background
from bayes_aero.jobs.results import put_histories
from bayes_aero.processes import cache_folder, cores
from bayes_aero.report.page import put_page
from bayes_aero.study import cluster
from bayes_aero.study.cluster import Driver, work
from bayes_aero.study.run import MANIFEST, run_unit

LONG = 20.0  # s: a test that waits so long has failed


def test_both_run_at_once_and_a_failure_is_that_of_who_waits():
    """Each waits for the other: one after the other they would never end."""
    here, there = Event(), Event()

    def meets(_):
        there.set()
        assert here.wait(LONG)
        return get_ident()

    with in_background(meets) as running:
        assert there.wait(LONG)
        here.set()
        assert running() != get_ident()

    def fails(_):
        raise ValueError("no such luck")

    with pytest.raises(ValueError, match="no such luck"), in_background(fails) as running:
        running()


def test_it_is_shown_only_while_it_is_waited_for_and_ends_with_a_block_that_fails():
    shown, begun, ends = [], Event(), []

    def job(tell):
        tell("beside", 0.1)
        begun.set()
        try:
            while not shown:
                tell("waited for", 0.9)
        finally:
            ends.append(len(shown))

    with in_background(job, lambda *row: shown.append(row)) as running:
        assert begun.wait(LONG)
        assert shown == []
        running()
    assert shown == [("waited for", 0.9)]
    shown.clear()
    begun.clear()

    def interrupted():
        with in_background(job):
            assert begun.wait(LONG)
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert ends == [1, 0]


@pytest.fixture
def driver(tmp_path, monkeypatch):
    """One whose folder is seen, and a worker that does nothing but tell what it was asked for."""
    monkeypatch.setattr(cluster, "configure", lambda: None)
    monkeypatch.setattr(cluster, "FILE_TIMEOUT", 0.1)
    monkeypatch.setattr(cluster, "run_unit", lambda given, _: {"name": given["name"], "argv": list(sys.argv)})
    return Driver.of(tmp_path)


def test_a_unit_tells_the_command_of_its_driver(driver):
    before = list(sys.argv)
    asked = replace(driver, command=("bayes-aero", "run", "study.toml"))
    assert work({"name": "one"}, "", asked, None) == {"name": "one", "argv": ["bayes-aero", "run", "study.toml"]}
    assert sys.argv == before


def test_other_versions_and_a_folder_that_is_not_shared_are_refused(driver):
    for package in ("jax", "bayes_aero"):
        other = replace(driver, versions={**driver.versions, package: "0.0.1"})
        with pytest.raises(InputError, match=rf"{package} {driver.versions[package].split()[0]}.* 0.0.1"):
            work({"name": "one"}, "", other, None)
    Path(driver.token).unlink()
    with pytest.raises(InputError, match=r"does not see .*; give --out, .* under the same path"):
        work({"name": "one"}, "", driver, None)


def test_what_is_compiled_is_forgotten_when_memory_runs_short(driver, monkeypatch):
    forgot = []
    monkeypatch.setattr("bayes_aero.processes.give_back_memory", lambda: forgot.append(True))
    for memory, times in ((1 << 50, 0), (None, 0), (1 << 20, 1)):
        work({"name": "one"}, "", driver, memory)
        assert len(forgot) == times


def test_a_worker_keeps_to_its_cores_and_the_cache_lies_where_the_user_says(monkeypatch, tmp_path):
    places = {"JAX_COMPILATION_CACHE_DIR": "", "BAYES_AERO_CACHE": "compiled", "XDG_CACHE_HOME": "bayes_aero/compiled"}
    for name, below in places.items() if sys.platform == "linux" else ():
        monkeypatch.setenv(name, str(tmp_path / name))
        place = cache_folder()
        assert (place.parent if below else place) == tmp_path / name / below
        monkeypatch.delenv(name)
    monkeypatch.setenv("BAYES_AERO_CORES", "3")
    assert cores() == 3
    monkeypatch.setenv("BAYES_AERO_CORES", "")
    assert 1 <= cores() <= (os.cpu_count() or 1)


WORKER = "from bayes_aero.study import cluster; cluster.configure()\n"
COMMAND = """import sys; from bayes_aero.cli import main; sys.argv[1:] = ["--version"]
try: main()
except SystemExit: pass
"""


def test_one_process_compiles_for_the_next(tmp_path):
    """Real processes, a worker and a command: the second finds in the cache what the first has compiled."""
    code = (
        "import os, jax, jax.numpy as jnp\n"
        "seen = []\n"
        "jax.monitoring.register_event_listener(lambda name, **_: seen.append(name.rsplit('/', 1)[1]))\n"
        "jax.jit(lambda x: jnp.linalg.cholesky(x @ x.T + jnp.eye(5)).sum())(jnp.ones((5, 5))).block_until_ready()\n"
        "print(seen.count('cache_hits'), seen.count('cache_misses'))\n"
    )
    settings = {k: v for k, v in os.environ.items() if not k.startswith(("JAX_COMPILATION", "XLA_"))}
    settings |= {"JAX_PLATFORMS": "cpu", "BAYES_AERO_CACHE": str(tmp_path), compiled.MIN_SECONDS: "0"}
    told = []
    for begins in (WORKER, COMMAND):
        command = [sys.executable, "-c", begins + code]
        ended = subprocess.run(command, env=settings, capture_output=True, text=True, timeout=120, check=True)
        told.append([int(x) for x in ended.stdout.splitlines()[-1].split()])
        assert not ended.stderr
    (hits, misses), (later, none) = told
    assert hits == 0
    assert misses > 0
    assert (later, none) == (misses, 0)


REGRESSION = """
import jax, numpy as np
import bayes_aero.dynamics
from bayes_aero.physics.coefficients import lift_regression
from bayes_aero.processes import Compiled
made = []
jax.monitoring.register_event_duration_secs_listener(lambda name, *_, **__: made.append(name.rsplit("/", 1)[1]))
rng, n, at = np.random.default_rng(0), 400, (1.0, 0.0, 0.0)
names = ("alpha", "q", "p", "r", "ax", "az", "elevator")
s = {name: 0.01 * np.cumsum(rng.standard_normal(n)) for name in names}
s |= {"airspeed": np.full(n, 90.0), "density": np.ones(n)}
ends = np.full(n, 0.04), np.zeros(n, int), np.full(n, n - 1)
numpy = lift_regression(s, at, *ends)
np.testing.assert_allclose(Compiled(lift_regression)(s, at, *ends).share, numpy.share, rtol=1e-6, atol=1e-9)
print(made.count("backend_compile_duration"))
theirs = Compiled(lambda x: x.sum())
print(float(theirs(np.ones(3))))
"""


def test_what_one_process_has_compiled_another_loads(tmp_path):
    """With the functions of LAPACK that it calls; compiled anew where the file is not whole. NumPy has the numbers."""
    settings = {k: v for k, v in os.environ.items() if not k.startswith(("JAX_COMPILATION", "XLA_"))}
    settings |= {"JAX_PLATFORMS": "cpu", "BAYES_AERO_CACHE": str(tmp_path)}

    def compiled_by_a_process() -> bool:
        command = [sys.executable, "-c", COMMAND + REGRESSION]
        ended = subprocess.run(command, env=settings, capture_output=True, text=True, timeout=120, check=True)
        *_, count, total = ended.stdout.split()
        assert float(total) == 3.0  # a function that is not of the package is not kept
        return int(count) > 0

    assert compiled_by_a_process()
    (kept,) = tmp_path.rglob("programs/*.bin")
    assert not compiled_by_a_process()
    kept.write_bytes(kept.read_bytes()[:1000])
    assert compiled_by_a_process()


def test_a_cache_that_cannot_be_made_is_done_without(monkeypatch, tmp_path):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("BAYES_AERO_CACHE", str(tmp_path / "file"))
    monkeypatch.delenv(compiled.FOLDER, raising=False)
    monkeypatch.delitem(sys.modules, "jax")
    compiled.enable_cache()
    assert compiled.FOLDER not in os.environ


@pytest.fixture
def dead():
    """The number of a process that is no more."""
    process = subprocess.Popen([sys.executable, "-c", ""])
    process.wait()
    return process.pid


def filled(folder: Path, text: str) -> Path:
    folder.mkdir()
    (folder / "results.json").write_text(text)
    return folder


def contents(folder: Path) -> dict[str, str]:
    return {path.name: (path / "results.json").read_text() for path in folder.iterdir()}


def test_a_kill_between_the_renames_leaves_what_was_there(tmp_path, monkeypatch, dead):
    target, replace = filled(tmp_path / "unit", "old"), os.replace

    def killed(source, to):
        if Path(to) == target:
            raise KeyboardInterrupt
        replace(source, to)

    monkeypatch.setattr(os, "getpid", lambda: dead)
    monkeypatch.setattr(os, "replace", killed)
    with pytest.raises(KeyboardInterrupt):
        put_folder(filled(beside(target), "new"), target)
    assert not target.exists()
    monkeypatch.undo()
    sweep(tmp_path)
    assert contents(tmp_path) == {"unit": "old"}


def test_a_neighbour_that_puts_the_same_unit_first_is_replaced(tmp_path, monkeypatch):
    target, replace, raced = tmp_path / "unit", os.replace, []

    def racing(source, to):
        if Path(to) == target and not raced:
            raced.append(filled(target, "neighbour"))
        replace(source, to)

    monkeypatch.setattr(os, "replace", racing)
    put_folder(filled(beside(target), "ours"), target)
    assert raced
    assert contents(tmp_path) == {"unit": "ours"}


def test_everything_is_on_the_disk_before_it_is_named(tmp_path, monkeypatch):
    """Files first, then their folders; the folder that holds the name last of all."""
    target = tmp_path / "unit"
    made = filled(beside(target), "new")
    (made / "figures").mkdir()
    (made / "figures" / "one.png").write_text("picture")
    done = []
    flush = os.fsync

    def flushing(handle):
        done.append((Path(os.readlink(f"/proc/self/fd/{handle}")).name, target.exists()))
        flush(handle)

    if sys.platform != "linux":
        pytest.skip("open files are told by name in /proc only")
    monkeypatch.setattr(os, "fsync", flushing)
    put_folder(made, target)
    names = [name for name, _ in done]
    assert set(names) == {"results.json", "one.png", "figures", made.name, tmp_path.name}
    assert names.index("one.png") < names.index("figures") < names.index(made.name)
    assert [named for _, named in done] == [False] * 4 + [True]


def test_only_the_dead_of_this_machine_are_swept(tmp_path, dead):
    alive, elsewhere = f".unit.{durable.host()}.{os.getpid()}.part", f".unit.other.{dead}.part"
    token = tmp_path / f".driver.{durable.host()}.{dead}.part"
    token.write_text("word")
    for name in (alive, elsewhere, f".unit.{durable.host()}.{dead}.part"):
        filled(tmp_path / name, "half")
    sweep(tmp_path)
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted([alive, elsewhere])


@pytest.fixture
def given(tmp_path):
    """A unit of a record that exists."""
    (tmp_path / "record.csv").write_text("time\n0\n")
    return {
        "name": "record-1", "task": "identify", "records": [str(tmp_path / "record.csv")], "shown": ["record.csv"],
        "card": str(Path(__file__).parents[2] / "models" / "attas.toml"), "card_name": "attas", "seed": 0,
        "split": "random", "noise": "white", "effects": [], "options": {},
    }  # fmt: skip


def test_a_full_disk_is_no_failure_of_the_unit(tmp_path, given):
    def task(_, out, *__):
        (out / "half.txt").write_text("half done")
        try:
            raise OSError(errno.EDQUOT, os.strerror(errno.EDQUOT))
        except OSError:
            raise RuntimeError("a library's own words") from None

    with pytest.raises(InputError, match=r"the disk of .*units is full; .* give the same command again"):
        run_unit(given, str(tmp_path / "units" / "record-1"), task=task)
    assert not list((tmp_path / "units").iterdir())


@pytest.mark.parametrize("point", ["Path.write_bytes", "durable.sync", "durable.os.replace"])
@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EACCES])
def test_a_file_is_written_whole_or_not_at_all(tmp_path, monkeypatch, point, number):
    path = write_whole("before", tmp_path / "numbers.json")

    def fails(*_):
        raise OSError(number, os.strerror(number))  # as the system says it of an open file: without a name

    owner, name = point.rsplit(".", 1)
    monkeypatch.setattr({"Path": Path, "durable": durable, "durable.os": os}[owner], name, fails)
    with pytest.raises(OSError, match=r"numbers\.json") as told:
        write_whole(b"after", path, flush=True)
    assert (told.value.errno, told.value.filename) == (number, str(path))
    monkeypatch.undo()
    assert path.read_text() == "before"
    assert list(tmp_path.iterdir()) == [path]


def test_libraries_are_never_given_the_name_of_a_result_to_write_to():
    """What they write goes to memory, and from there to the disk at one place."""
    package = Path(durable.__file__).parent
    lone = re.compile(r"to_netcdf\((?!engine)|\.to_csv\((?!index|lineterm|\))|savefig\((?!drawn)|write_bytes\(")
    source = {str(p.relative_to(package)): p.read_text(encoding="utf-8") for p in package.rglob("*.py")}
    assert {name for name, text in source.items() if lone.search(text)} == {"atomic_write.py"}
    own = {name for name, text in source.items() if "write_text(" in text}
    assert own == {"export/simulators.py"}


def test_a_full_disk_is_told_by_a_page_by_histories_and_by_h5py_in_words_alone(tmp_path):
    def full():
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    for put in (put_page, put_histories):
        with pytest.raises(OSError, match="No space left"):
            put(full, tmp_path)
    assert no_space(OSError("Unable to write (file write failed: time = now, errno = 28, error message = 'x')"))
    assert not no_space(OSError("Unable to open (errno = 2, error message = 'No such file or directory')"))
    assert not no_space(ValueError("no"))


def test_a_failure_told_from_outside_is_kept_as_one_told_from_inside(tmp_path, given):
    told = run_unit(given, str(tmp_path / "units" / "record-1"), failed="its process died")
    assert (told["state"], told["error"]) == ("failed", "its process died")
    folder = tmp_path / "units" / "record-1"
    assert (folder / ERROR).read_text() == "its process died\n"
    manifest = json.loads((folder / MANIFEST).read_text())
    assert (manifest["state"], manifest["error"], list(manifest["files"])) == ("failed", "its process died", [ERROR])
