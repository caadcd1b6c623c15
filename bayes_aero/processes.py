"""The process that computes: its compiled programs and their cache on disk, its threads, its end with its parent."""

from __future__ import annotations

import ctypes
import functools
import gc
import hashlib
import io
import os
import pickle
import platform
import sys
import threading
import time
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from dataclasses import fields, is_dataclass
from functools import cache
from importlib.metadata import version
from pathlib import Path
from types import FunctionType
from typing import Any, TypeVar

import platformdirs
from threadpoolctl import ThreadpoolController

from bayes_aero.atomic_write import write_whole

MAPPINGS, LIMIT = Path("/proc/self/maps"), Path("/proc/sys/vm/max_map_count")
MAX_SHARE = 0.6  # of the memory mappings; the next task may take as much as a whole diagnosis, a tenth


def give_back_memory() -> None:
    """Return unused memory to the system: compiled programs, and the free lists of glibc (over half a GB)."""
    import jax  # takes seconds, and the cache is chosen before

    jax.clear_caches()
    for program in _every:
        program.made.clear()
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


def compiled_at(level: int) -> Callable[[Callable], Compiled]:
    """`Compiled` at a level of optimisation: 0 compiles in half the time and runs up to five times slower; 1 runs as
    JAX's default does, compiled in three quarters of it."""
    more = {} if level else {"xla_cpu_use_fusion_emitters": False}
    return lambda function: Compiled(function, {"xla_backend_optimization_level": level, **more})


_COMPILING = threading.RLock()
_every: list[Compiled] = []


class Compiled:
    """A function compiled by JAX for each kind of arguments, of which all but arrays is constant; inside another, its
    part. What is compiled is kept on disk, so that no other process traces or compiles it again."""

    def __init__(self, function: Callable, options: dict[str, Any] | None = None) -> None:
        self.function, self.options, self.making = function, options, threading.RLock()
        self.made = dict[Any, tuple[Any, Any]]()
        functools.update_wrapper(self, function)
        _every.append(self)

    def __call__(self, *args: Any) -> Any:
        import jax  # it takes seconds
        import numpy as np
        from jax.core import Tracer

        leaves, structure = jax.tree.flatten(args)
        places = [k for k, x in enumerate(leaves) if isinstance(x, jax.Array | np.ndarray | np.generic)]
        arrays = [leaves[k] for k in places]
        if any(isinstance(x, Tracer) for x in arrays):
            return self.function(*args)
        for k in places:
            leaves[k] = leaves[k].shape, leaves[k].dtype
        key = structure, tuple(leaves)
        if (made := self.made.get(key)) is None:
            with self.making:
                if (made := self.made.get(key)) is None:
                    made = self.made[key] = self._loaded(structure, leaves, arrays, places)
        program, result = made
        return jax.tree.unflatten(result, program(arrays))

    def _loaded(self, structure: Any, leaves: list[Any], arrays: list[Any], places: list[int]) -> tuple[Any, Any]:
        """The compiled program, from the disk where it is there, and the structure of its results."""
        import jax
        from jax.experimental.serialize_executable import deserialize_and_load, serialize

        given, result = list(leaves), None

        def traced(arrays: list[Any]) -> list[Any]:
            nonlocal result
            for place, array in zip(places, arrays, strict=True):
                given[place] = array
            made, result = jax.tree.flatten(self.function(*jax.tree.unflatten(structure, given)))
            return made

        path = self._path(jax.tree.unflatten(structure, leaves))
        traced.__name__ = self.function.__qualname__ + ("" if path is None else f"_{path.stem[:8]}")
        if path is not None and path.is_file():
            with suppress(Exception):  # of a file that is not whole; it is made again
                code, blank = pickle.loads(path.read_bytes())
                result = jax.tree.structure(blank)
                _with_lapack()
                trees = jax.tree.structure(((arrays,), {})), jax.tree.structure([0] * result.num_leaves)
                return deserialize_and_load(code, *trees), result
        program = jax.jit(traced, compiler_options=self.options).lower(arrays)
        if path is None:
            return program.compile(), result
        with _COMPILING:  # JAX's own cache must not keep it: of what that gives back no file can be made
            before = getattr(jax.config, LEAST_TIME)
            jax.config.update(LEAST_TIME, 1e9)
            try:
                compiled = program.compile()
            finally:
                jax.config.update(LEAST_TIME, before)
        with suppress(Exception):  # a full disk, or a program of which JAX makes no file; the next process compiles it
            content = pickle.dumps((serialize(compiled)[0], jax.tree.unflatten(result, [0] * len(compiled.out_info))))
            path.parent.mkdir(parents=True, exist_ok=True)
            write_whole(content, path)
            for old in (f for f in path.parent.glob("*.bin") if f.stat().st_mtime < time.time() - MOST_DAYS * 86400):
                old.unlink(missing_ok=True)
        return compiled, result

    def _path(self, kinds: Any) -> Path | None:
        """The file of a program for arguments of these `kinds`; None where another process could not know it again."""
        import jax

        if not (root := os.environ.get(FOLDER)):
            return None
        words = io.BytesIO()
        try:
            _Words(words).dump((self.function, self.options, str(jax.dtypes.canonicalize_dtype(float)), kinds))
        except (pickle.PicklingError, TypeError, AttributeError):
            return None
        return Path(root) / "programs" / f"{hashlib.sha256(_version() + words.getvalue()).hexdigest()}.bin"


@cache
def _with_lapack() -> None:
    """Make LAPACK known to loaded programs, as JAX does when it lowers the first program that calls it."""
    import jax

    jax.jit(jax.numpy.linalg.cholesky).lower(jax.ShapeDtypeStruct((1, 1), "float32"))


TOLD = (__package__, "jax", "jaxlib", "equinox", "numpy", "builtins", "types")  # by their version; a user's file is not


class _Words(pickle.Pickler):
    """All that a program depends on, in the same words in every process, and not to be read back."""

    def __init__(self, file: io.BytesIO) -> None:
        super().__init__(file)
        self.fast = True  # nothing by reference to what came before, for equal objects need not be the same

    def reducer_override(self, x: Any) -> Any:
        if isinstance(x, FunctionType | type) and x.__module__.partition(".")[0] not in TOLD:
            raise pickle.PicklingError(x.__qualname__)
        if isinstance(x, FunctionType):
            place, cells = next(iter(x.__code__.co_positions()), None), [c.cell_contents for c in x.__closure__ or ()]
            return str, (x.__module__, x.__qualname__, place, x.__defaults__, x.__kwdefaults__, cells)
        if isinstance(x, Mapping) and type(x) is not dict:
            return dict, (tuple(x.items()),)
        if is_dataclass(x) and not isinstance(x, type):  # without what it has found since it was made
            return type(x), tuple(getattr(x, field.name) for field in fields(x))
        return NotImplemented


@cache
def _version() -> bytes:
    """The package's source, the libraries that compile it, what they are told, and for which processor."""
    what = hashlib.sha256((os.environ.get("XLA_FLAGS", "") + processor()).encode())
    what.update(" ".join([sys.version, *map(version, ("jax", "jaxlib", "equinox", "numpy"))]).encode())
    for path in sorted(Path(__file__).parent.rglob("*.py")):
        what.update(path.read_bytes())
    return what.digest()


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

CACHE, MOST_DAYS = "BAYES_AERO_CACHE", 90.0  # after which a program is compiled anew: it may be of another version
FOLDER = "JAX_COMPILATION_CACHE_DIR"
MIN_SECONDS = "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS"
LEAST_TIME = MIN_SECONDS.lower()
SECONDS = "0.2"  # s of compilation: half of a command's, in a tenth of the files


def cache_folder() -> Path:
    """Folder of compiled programs: JAX's variable, else in BAYES_AERO_CACHE or the user's cache folder one for each
    kind of processor, because a program compiled for one may not run on another."""
    if given := os.environ.get(FOLDER):
        return Path(given)
    root = Path(os.environ.get(CACHE) or platformdirs.user_cache_path("bayes_aero"))
    return root / "compiled" / f"{platform.machine()}-{hashlib.sha256(processor().encode()).hexdigest()[:8]}"


def processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
        return "\n".join(sorted({line for line in lines if line.startswith(("model name", "flags", "Features"))}))
    except OSError:
        return platform.processor()


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
