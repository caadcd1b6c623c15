"""A unit run by a worker of a cluster: same versions, shared files, one core, limited memory, shared compiled
programs."""

from __future__ import annotations

import os
import platform
import sys
import threading
import time
import uuid
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import jax
import psutil
from jax.experimental.compilation_cache import compilation_cache

from bayes_aero import processes
from bayes_aero.atomic_write import beside, host, sweep
from bayes_aero.errors import InputError
from bayes_aero.jobs.provenance import PACKAGES, environment
from bayes_aero.processes import VARIABLE as CORES
from bayes_aero.study.case import run_unit
from bayes_aero.study.jit_cache import FOLDER, cache_folder, ignore_cache_errors

THREADS = dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1")
XLA = "--xla_cpu_multi_thread_eigen=false"
MAX_MEMORY_SHARE = 0.6  # of a worker's memory, above which its compiled programs are freed
FILE_TIMEOUT = 5.0  # s, until a shared file system shows a new file
_LOCK = threading.Lock()


@dataclass(frozen=True)
class Driver:
    """The program that drives the study: versions and folders that a worker must share, and its command."""

    versions: Mapping[str, str]
    token: str
    key: str
    command: tuple[str, ...]

    @classmethod
    def of(cls, units: Path) -> Driver:
        """This process; writes a file into the folder of units by which workers recognise it."""
        token, key = beside(units.resolve() / "driver"), uuid.uuid4().hex
        try:
            token.write_text(key, encoding="utf-8")
        except OSError as reason:
            raise InputError(
                f"cannot write to {units} ({reason.strerror}); mend that and give the same command again"
            ) from None
        return cls(versions_of(), str(token), key, tuple(sys.argv))


def versions_of() -> dict[str, str]:
    """Versions on which numbers depend, and this package's own source."""
    here = environment()
    found = {"Python": ".".join(platform.python_version_tuple()[:2])}
    found |= {name: here["packages"].get(name, "none") for name in PACKAGES if name in here["packages"]}
    own = here["bayes_aero"]
    return found | {"bayes_aero": f"{own['version']} (source {own['source_sha256'][:8]})"}


def variables() -> dict[str, str]:
    """Environment variables of a worker: one core, and the shared cache of compiled programs."""
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


_CHECKED: set[str] = set()


def _check_driver(driver: Driver) -> None:
    """Check a driver once: refuse other versions and folders that are not shared, and delete files of dead runs."""
    if driver.key in _CHECKED:
        return
    here = versions_of()
    other = [f"{name} {here.get(name, 'none')} for {v}" for name, v in driver.versions.items() if here.get(name) != v]
    if other:
        raise InputError(
            f"a worker on {host()} has {', '.join(other)}, and its numbers would differ; install there what "
            "environment/requirements.txt beside the results names"
        )
    token, until = Path(driver.token), time.monotonic() + FILE_TIMEOUT
    while True:
        with suppress(OSError):
            if token.read_text(encoding="utf-8") == driver.key:
                break
        if time.monotonic() > until:
            raise InputError(
                f"a worker on {host()} does not see {token.parent}; give --out, and keep study and records, where "
                "all machines see them under the same path"
            )
        time.sleep(0.25)
    sweep(token.parent)
    configure()
    _CHECKED.add(driver.key)
