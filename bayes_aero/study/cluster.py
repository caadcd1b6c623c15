"""A study's units on a Dask cluster: workers of this machine, or a scheduler at an address, and what a worker does."""

from __future__ import annotations

import gc
import json
import logging
import os
import platform
import signal
import sys
import threading
import time
import uuid
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from functools import cache
from multiprocessing import resource_tracker
from pathlib import Path
from typing import Any, cast

import dask
import jax
import psutil
from dask.utils import format_bytes
from distributed import Client, Future, KilledWorker, LocalCluster, get_worker
from distributed.system import MEMORY_LIMIT
from jax.experimental.compilation_cache import compilation_cache

from bayes_aero import processes
from bayes_aero.atomic_write import beside, host, sweep
from bayes_aero.errors import InputError
from bayes_aero.jobs.store import PACKAGES, environment
from bayes_aero.processes import FOLDER, cache_folder, ignore_cache_errors
from bayes_aero.processes import VARIABLE as CORES
from bayes_aero.study.run import StoppedError, UnitRunner, run_unit

Report = Callable[[int, int, str, bool], None]
"""Called with the number of finished units, of all units, a text on the progress, and whether there are no workers."""

MIN_MEMORY = 10**9  # bytes of a worker that has compiled one model
POLL_SECONDS = 0.02  # between checks of the running units
COUNT_SECONDS = 1.0  # between counts of the workers
OWN_CLUSTER = {
    # Units have no data to move to disk or to other workers: a paused worker would never resume.
    "distributed.worker.memory.target": False,
    "distributed.worker.memory.spill": False,
    "distributed.worker.memory.pause": False,
    "distributed.worker.memory.terminate": 0.95,
    "distributed.worker.profile.enabled": False,
    "distributed.scheduler.allowed-failures": 2,
}


@contextmanager
def local(workers: int, units: Path, report: Report) -> Iterator[UnitRunner]:
    """Worker processes of this machine, one thread and an equal share of the memory each; they end with the context."""
    memory = int(MEMORY_LIMIT // workers)
    if memory < MIN_MEMORY:
        few = f"{format_bytes(memory)} for each worker are too little to compile a model in"
        raise InputError(f"{few}; give fewer --workers")
    with ExitStack() as stack:
        stack.callback(sweep, units)
        stack.enter_context(_logs_silenced())
        stack.enter_context(dask.config.set(OWN_CLUSTER))
        try:
            with interrupts_blocked():
                cluster = LocalCluster(
                    n_workers=workers,
                    threads_per_worker=1,
                    processes=True,
                    memory_limit=memory,
                    host="127.0.0.1",
                    dashboard_address="127.0.0.1:0",  # any port that is free; its pages are left out
                    scheduler_kwargs={"dashboard": False},
                    silence_logs=logging.CRITICAL,
                    env=variables(),
                )
                stack.callback(_close, cluster)
                client = Client(cluster, set_as_default=False)
                stack.callback(_close, client)
        except (OSError, RuntimeError) as reason:
            raise InputError(f"{workers} workers cannot be started ({_short(reason)}); leave --workers out") from None
        yield _runner(client, units, report, f"each has {format_bytes(memory)}; give fewer --workers")


@contextmanager
def remote(address: str, units: Path, report: Report) -> Iterator[UnitRunner]:
    """The present and later workers of a running scheduler; they are not ended."""
    gc.collect()  # a client that failed closes itself when it is collected, and deadlocks where another one is starting
    with _logs_silenced():
        try:
            client = Client(address, set_as_default=False)  # else a failed one stays the default
        except (OSError, ValueError, TypeError, ImportError) as reason:
            raise InputError(f"--scheduler {address} does not answer ({_short(reason)}); check the address") from None
        try:
            yield _runner(client, units, report, "give its workers more memory")
        finally:
            _close(client)


def _runner(client: Client, units: Path, report: Report, remedy: str) -> UnitRunner:
    """Yields results of `run_unit` in the order in which the units end."""
    address = str(client.scheduler.addr) if client.scheduler else "the scheduler"

    def run_units(given: Iterable[tuple[Mapping[str, Any], str]]) -> Iterator[Mapping[str, Any]]:
        driver, waiting = Driver.of(units), deque(given)
        running: dict[Future, tuple[Mapping[str, Any], str]] = {}
        total, finished, workers, counted = len(waiting), 0, 0, -COUNT_SECONDS
        try:
            while waiting or running:
                try:
                    if time.monotonic() - counted > COUNT_SECONDS:
                        workers, counted = len(cast("dict[str, int]", client.nthreads())), time.monotonic()
                    # One unit for each worker: one that waited at a worker that dies would seem a cause of its death.
                    while waiting and len(running) < workers:
                        unit, folder = waiting[0]
                        what = (json.dumps(unit), str(Path(folder).resolve()), driver)
                        key = f"{unit['name']}-{uuid.uuid4().hex}"
                        running[client.submit(on_worker, *what, key=key, pure=False)] = waiting[0]
                        waiting.popleft()
                except Exception as reason:  # whatever a client without its scheduler raises
                    raise StoppedError(f"the scheduler at {address} is lost") from reason
                ended = [future for future in running if future.done()]
                for future in ended:
                    finished += 1
                    yield outcome_of(future, running.pop(future), address, remedy)
                what = (
                    f"{len(running)} in work on {workers} workers" if workers else f"waiting for workers at {address}"
                )
                report(finished, total, what, not workers)
                if not ended:
                    time.sleep(POLL_SECONDS)
        finally:
            Path(driver.token).unlink(missing_ok=True)
            sweep(units)

    return run_units


def outcome_of(future: Future, unit: tuple[Mapping[str, Any], str], address: str, remedy: str) -> Mapping[str, Any]:
    """What `run_unit` returned on a worker, or the failure of a unit that ended its process."""
    if future.cancelled():  # Dask does so with all that runs when the connection is lost
        raise StoppedError(f"the scheduler at {address} is lost")
    # A result that was lost with its worker is waited for: Dask has it made again.
    reason = cast("BaseException | None", future.exception())
    if reason is None:
        return cast("dict[str, Any]", future.result())
    if isinstance(reason, InputError):
        raise reason
    if isinstance(reason, KilledWorker):
        deaths = reason.allowed_failures + 1
        return run_unit(*unit, failed=f"its process died {deaths} times, most likely for lack of memory; {remedy}")
    raise StoppedError(f"the cluster at {address} cannot do units ({_short(reason)}); it needs bayes-aero[cluster]")


def on_worker(given: str, folder: str, driver: Driver) -> dict[str, Any]:
    return work(json.loads(given), folder, driver, getattr(get_worker().memory_manager, "memory_limit", None))


def _close(what: Client | LocalCluster) -> None:
    with suppress(Exception):
        what.close(timeout=5)


@contextmanager
def interrupts_blocked() -> Iterator[None]:
    """Threads and processes that start in this context do not receive Ctrl-C, which this program handles."""
    if not hasattr(signal, "pthread_sigmask") or threading.current_thread() is not threading.main_thread():
        yield
        return
    resource_tracker.ensure_running()  # the first process to be begun would begin it, and hear again
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextmanager
def _logs_silenced() -> Iterator[None]:
    """Without Dask's logs of lost connections and dead workers, which are reported by this program."""
    every = logging.root.manager.loggerDict
    loggers = [
        logging.getLogger(name) for name in every if name.partition(".")[0] in ("distributed", "dask", "tornado")
    ]
    before = [logger.level for logger in loggers]
    for logger in loggers:
        logger.setLevel(logging.CRITICAL + 1)
    try:
        yield
    finally:
        for logger, level in zip(loggers, before, strict=True):
            logger.setLevel(level)


def _short(reason: BaseException) -> str:
    lines = str(reason).strip().splitlines() or [type(reason).__name__]
    return lines[0].partition(". ")[0].strip().rstrip(".:")


# --- A unit run by a worker: same versions, shared files, one core, limited memory, shared compiled programs.

THREADS = dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1")
XLA = "--xla_cpu_multi_thread_eigen=false"
MAX_MEMORY_SHARE = 0.6  # of a worker's memory, above which its compiled programs are freed
FILE_TIMEOUT = 5.0  # s, until a shared file system shows a new file
_LOCK = threading.Lock()
_CHECKED: set[str] = set()


@dataclass(frozen=True)
class Driver:
    """The program that drives the study: versions and folders that a worker must share, and its command."""

    versions: Mapping[str, str]
    token: str  # a file in the folder of units, by which workers recognise it
    command: tuple[str, ...]

    @classmethod
    def of(cls, units: Path) -> Driver:
        """This process, with its token written."""
        token = beside(units.resolve() / f"driver-{uuid.uuid4().hex}")
        try:
            token.touch()
        except OSError as reason:
            raise InputError(f"cannot write to {units} ({reason.strerror}); give the same command again") from None
        return cls(versions_of(), str(token), tuple(sys.argv))


def versions_of() -> dict[str, str]:
    """Versions on which numbers depend, and this package's own source."""
    here = environment()
    source, packages = here["bayes_aero"], here["packages"]
    versions = {"Python": ".".join(platform.python_version_tuple()[:2])}
    versions |= {name: packages[name] for name in PACKAGES if name in packages}
    return versions | {"bayes_aero": f"{source['version']} (source {source['source_sha256'][:8]})"}


def variables() -> dict[str, str]:
    flags = os.environ.get("XLA_FLAGS", "")
    return {
        **THREADS,
        CORES: os.environ.get(CORES, "1"),
        "NPROC": os.environ.get("NPROC", "1"),  # the size of XLA's own pools
        "XLA_FLAGS": flags if "xla_cpu_multi_thread_eigen" in flags else f"{flags} {XLA}".strip(),
        FOLDER: str(cache_folder()),
    }


def work(given: Mapping[str, Any], folder: str, driver: Driver, memory: int | None) -> dict[str, Any]:
    """`run_unit` for a driver on another machine, one at a time, in a process with at most `memory` bytes."""
    with _LOCK:
        _check_driver(driver)
        before, sys.argv = sys.argv, list(driver.command)  # the command in the provenance
        try:
            return run_unit(given, folder)
        finally:
            sys.argv = before
            if memory and psutil.Process().memory_info().rss > MAX_MEMORY_SHARE * memory:
                processes.give_back_memory()


@cache
def configure() -> None:
    """Configure this process once: the cache of compiled programs, and one core where JAX is not yet loaded."""
    for name, value in variables().items():
        os.environ.setdefault(name, value)
    folder = os.environ[FOLDER]
    if getattr(jax.config, "jax_compilation_cache_dir", None) != folder:
        jax.config.update("jax_compilation_cache_dir", folder)
        compilation_cache.reset_cache()
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
    ignore_cache_errors()


def _check_driver(driver: Driver) -> None:
    """Check a driver once: refuse other versions and folders that are not shared, and delete files of dead runs."""
    if driver.token in _CHECKED:
        return
    here = versions_of()
    other = [f"{name} {here.get(name, 'none')} for {v}" for name, v in driver.versions.items() if here.get(name) != v]
    if other:
        raise InputError(f"a worker on {host()} has {', '.join(other)}; install environment/requirements.txt there")
    token, until = Path(driver.token), time.monotonic() + FILE_TIMEOUT
    while not token.exists():
        if time.monotonic() > until:
            raise InputError(
                f"a worker on {host()} does not see {token.parent}; give --out, and keep study and records, where "
                "all machines see them under the same path"
            )
        time.sleep(0.25)
    sweep(token.parent)
    configure()
    _CHECKED.add(driver.token)
