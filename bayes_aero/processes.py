"""The process that computes: its compiled programs and their cache on disk, its threads, its end with its parent."""

from __future__ import annotations

import ctypes
import gc
import hashlib
import os
import platform
import sys
import threading
import time
import warnings
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any, TypeVar

import platformdirs
from threadpoolctl import ThreadpoolController

MAPPINGS, LIMIT = Path("/proc/self/maps"), Path("/proc/sys/vm/max_map_count")
MAX_SHARE = 0.6  # of the memory mappings; the next task may take as much as a whole diagnosis, a tenth


def give_back_memory() -> None:
    """Return unused memory to the system: compiled programs, and the free lists of glibc (over half a GB)."""
    import jax  # takes seconds, and the cache is chosen before

    jax.clear_caches()
    gc.collect()
    if sys.platform == "linux":
        trim = getattr(ctypes.CDLL(None), "malloc_trim", None)  # other C libraries have none
        if trim is not None:
            trim(0)


MMAP_MAX, TRIM, PAD, ARENAS = -4, -1, -2, -8  # of malloc.h


def keep_freed_memory() -> None:
    """Let large arrays take what others have freed, from one arena, not new pages of the system: a diagnosis takes 6 %
    less time and a quarter less memory. For glibc; other C libraries have no `mallopt`."""
    if sys.platform == "linux" and (mallopt := getattr(ctypes.CDLL(None), "mallopt", None)):
        for option, value in ((MMAP_MAX, 0), (TRIM, 1 << 30), (PAD, 1 << 26), (ARENAS, 1)):
            mallopt(option, value)


def compiled_at(level: int) -> Callable[[Callable], Any]:
    """`equinox.filter_jit` at a level of optimisation, not to be called inside another compiled program. 0 compiles in
    half the time and runs up to five times slower; 1 runs as JAX's default does, compiled in three quarters of it."""
    import equinox  # it takes seconds

    more = {} if level else {"xla_cpu_use_fusion_emitters": False}
    return equinox.filter_jit(compiler_options={"xla_backend_optimization_level": level, **more})  # pyright: ignore


def full_of_programs() -> bool:
    """Whether this process nears the limit of Linux's memory mappings; each compiled program takes about four."""
    # Beyond the limit the compiler ends the process with a segmentation fault.
    try:
        with MAPPINGS.open(encoding="utf-8", errors="replace") as lines:
            count = sum(1 for _ in lines)
        return count > MAX_SHARE * int(LIMIT.read_text(encoding="utf-8"))
    except OSError:  # another system has no such limit
        return False


# --- The cache of compiled programs on disk, shared between processes.

CACHE = "BAYES_AERO_CACHE"
FOLDER = "JAX_COMPILATION_CACHE_DIR"
MIN_SECONDS = "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS"
SECONDS = "0.2"  # s of compilation: half of a command's, in a tenth of the files


def cache_folder() -> Path:
    """Folder of compiled programs: JAX's variable, else in BAYES_AERO_CACHE or the user's cache folder one for each
    kind of processor, because a program compiled for one may not run on another."""
    if given := os.environ.get(FOLDER):
        return Path(given)
    root = Path(os.environ.get(CACHE) or platformdirs.user_cache_path("bayes_aero"))
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
        described = "\n".join(sorted({line for line in lines if line.startswith(("model name", "flags", "Features"))}))
    except OSError:
        described = platform.processor()
    return root / "compiled" / f"{platform.machine()}-{hashlib.sha256(described.encode()).hexdigest()[:8]}"


def enable_cache() -> None:
    """Store the compiled programs of this process; no effect once JAX is loaded, or without a writable folder."""
    if "jax" in sys.modules:
        return
    folder = cache_folder()
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:
        return
    os.environ.setdefault(FOLDER, str(folder))
    os.environ.setdefault(MIN_SECONDS, SECONDS)
    ignore_cache_errors()


def ignore_cache_errors() -> None:
    """Another process may be writing an entry or may have died while writing; the program is then compiled again."""
    warnings.filterwarnings("ignore", "Error (reading|writing) persistent compilation cache", UserWarning)


# --- Number of cores that this process may use, and limits on the threads of linear algebra.

VARIABLE = "BAYES_AERO_CORES"
Item = TypeVar("Item")
Made = TypeVar("Made")
_LIBRARIES = cache(ThreadpoolController)  # of BLAS, found once
WORTH_THREADS = 2500  # rows of a matrix below which a second BLAS thread costs more than it does (twice at 1000 rows)


def cores() -> int:
    """Cores by the variable BAYES_AERO_CORES (a worker of a cluster has one), else all that the system allows."""
    from joblib import cpu_count

    allowed = os.environ.get(VARIABLE, "")
    return max(1, int(allowed)) if allowed.isdecimal() else cpu_count()


def side_by_side(do: Callable[[Item], Made], items: Iterable[Item]) -> list[Made]:
    """`do` for each item, a thread a core: what NumPy and JAX compute is outside Python's lock."""
    given = list(items)
    with ThreadPoolExecutor(max(1, min(len(given), cores()))) as pool:
        return list(pool.map(do, given))


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
