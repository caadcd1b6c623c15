"""The process that computes: its compiled programs, its threads, and its end with its parent."""

from __future__ import annotations

import ctypes
import gc
import os
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path

import jax
from joblib import cpu_count
from threadpoolctl import ThreadpoolController

MAPPINGS, LIMIT = Path("/proc/self/maps"), Path("/proc/sys/vm/max_map_count")
MAX_SHARE = 0.6  # of the memory mappings; the next task may take as much as a whole diagnosis, a tenth


def give_back_memory() -> None:
    """Return unused memory to the system: compiled programs, and the free lists of glibc (over half a GB)."""
    jax.clear_caches()
    gc.collect()
    if sys.platform == "linux":
        trim = getattr(ctypes.CDLL(None), "malloc_trim", None)  # other C libraries have none
        if trim is not None:
            trim(0)


def full_of_programs() -> bool:
    """Whether this process nears the limit of Linux's memory mappings; each compiled program takes about four."""
    # Beyond the limit the compiler ends the process with a segmentation fault.
    try:
        with MAPPINGS.open(encoding="utf-8", errors="replace") as lines:
            count = sum(1 for _ in lines)
        return count > MAX_SHARE * int(LIMIT.read_text(encoding="utf-8"))
    except OSError:  # another system has no such limit
        return False


# --- Number of cores that this process may use, and limits on the threads of linear algebra.

VARIABLE = "BAYES_AERO_CORES"
_LIBRARIES = cache(ThreadpoolController)  # of BLAS, found once
WORTH_THREADS = 2500  # rows of a matrix below which a second BLAS thread costs more than it does (twice at 1000 rows)


def cores() -> int:
    """Cores by the variable BAYES_AERO_CORES (a worker of a cluster has one), else all that the system allows."""
    allowed = os.environ.get(VARIABLE, "")
    return max(1, int(allowed)) if allowed.isdecimal() else cpu_count()


@contextmanager
def blas_threads(rows: int) -> Iterator[None]:
    """Context (or decorator) with one BLAS thread for matrices of few `rows`, on which several wait for each other."""
    if rows >= WORTH_THREADS:
        yield
        return
    with _LIBRARIES().limit(limits=1, user_api="blas"):
        yield


# --- End of processes whose parent was killed; they would wait for ever to return their results.

POLL_SECONDS = 1.0
_watched: set[int] = set()


def exit_with(parent: int) -> None:
    """End this process soon after its parent has ended; without effect in the parent itself."""
    if os.getppid() != parent or parent in _watched:
        return
    _watched.add(parent)

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(POLL_SECONDS)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()
