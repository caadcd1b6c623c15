"""A unit done in a process of a cluster: same versions, same files, one core, a bounded memory, compiled only once."""

from __future__ import annotations

import os
import platform
import sys
import threading
import time
import uuid
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import jax
import psutil
from jax.experimental.compilation_cache import compilation_cache

from bayes_aero.errors import InputError
from bayes_aero.inference import compiled_programs
from bayes_aero.inference.threads import VARIABLE as CORES
from bayes_aero.jobs.io.atomic_write import beside, host, sweep
from bayes_aero.jobs.provenance.environment import environment
from bayes_aero.jobs.provenance.provenance import PACKAGES
from bayes_aero.study.case import run_unit
from bayes_aero.study.jit_cache import FOLDER, cache_folder, forgive

THREADS = dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1")
XLA = "--xla_cpu_multi_thread_eigen=false"
FULL_SHARE = 0.6  # of a worker's memory, beyond which it forgets what it has compiled
PATIENCE = 5.0  # seconds in which a shared file system shows a new file
_ALONE = threading.Lock()


@dataclass(frozen=True)
class Driver:
    """What a worker must have in common with the program that drives the study."""

    made_of: Mapping[str, str]
    token: str
    word: str
    command: tuple[str, ...]

    @classmethod
    def of(cls, units: Path) -> Driver:
        """This process; puts into the folder of units the file by which workers know it."""
        token, word = beside(units.resolve() / "driver"), uuid.uuid4().hex
        try:
            token.write_text(word, encoding="utf-8")
        except OSError as reason:
            raise InputError(
                f"cannot write to {units} ({reason.strerror}); mend that and give the same command again"
            ) from None
        return cls(made_of(), str(token), word, tuple(sys.argv))


def made_of() -> dict[str, str]:
    """Versions on which numbers depend, and this package's own source."""
    here = environment()
    found = {"Python": ".".join(platform.python_version_tuple()[:2])}
    found |= {name: here["packages"].get(name, "none") for name in PACKAGES if name in here["packages"]}
    own = here["bayes_aero"]
    return found | {"bayes_aero": f"{own['version']} (source {own['source_sha256'][:8]})"}


def variables() -> dict[str, str]:
    """What to set before a worker's process starts, so that it keeps to one core and shares what is compiled."""
    flags = os.environ.get("XLA_FLAGS", "")
    return {
        **THREADS,
        CORES: os.environ.get(CORES, "1"),
        "NPROC": os.environ.get("NPROC", "1"),  # the size of XLA's own pools
        "XLA_FLAGS": flags if "xla_cpu_multi_thread_eigen" in flags else f"{flags} {XLA}".strip(),
        FOLDER: str(cache_folder()),
    }


def work(given: Mapping[str, Any], folder: str, driver: Driver, memory: int | None) -> dict[str, Any]:
    """`run_unit` for a driver elsewhere, one at a time in a process that may take `memory` bytes."""
    with _ALONE:
        _join(driver)
        before, sys.argv = sys.argv, list(driver.command)  # what provenance calls the command
        try:
            return run_unit(given, folder)
        finally:
            sys.argv = before
            if memory and psutil.Process().memory_info().rss > FULL_SHARE * memory:
                compiled_programs.give_back_memory()


@cache
def _settled() -> None:
    """Once for a process: the cache of compiled programs, and one core, as far as it is not too late for that."""
    for name, value in variables().items():
        os.environ.setdefault(name, value)
    folder = os.environ[FOLDER]
    if getattr(jax.config, "jax_compilation_cache_dir", None) != folder:
        jax.config.update("jax_compilation_cache_dir", folder)
        compilation_cache.reset_cache()
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
    forgive()


_JOINED: set[str] = set()


def _join(driver: Driver) -> None:
    """Once for a driver: refuse other versions and folders that are not shared, and clear up after the dead."""
    if driver.word in _JOINED:
        return
    here = made_of()
    other = [f"{name} {here.get(name, 'none')} for {v}" for name, v in driver.made_of.items() if here.get(name) != v]
    if other:
        raise InputError(
            f"a worker on {host()} has {', '.join(other)}, and its numbers would differ; install there what "
            "environment/requirements.txt beside the results names"
        )
    _see(Path(driver.token), driver.word)
    sweep(Path(driver.token).parent)
    _settled()
    _JOINED.add(driver.word)


def _see(token: Path, word: str) -> None:
    until = time.monotonic() + PATIENCE
    while True:
        try:
            if token.read_text(encoding="utf-8") == word:
                return
        except OSError:
            pass
        if time.monotonic() > until:
            raise InputError(
                f"a worker on {host()} does not see {token.parent}; give --out, and keep study and records, where "
                "all machines see them under the same path"
            )
        time.sleep(0.25)
