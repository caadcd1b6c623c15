"""Cache of compiled programs on disk, shared between processes."""

from __future__ import annotations

import hashlib
import os
import platform
import sys
import warnings
from pathlib import Path

import platformdirs

CACHE = "BAYES_AERO_CACHE"
FOLDER = "JAX_COMPILATION_CACHE_DIR"
MIN_SECONDS = "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS"
SECONDS = "0.2"  # s of compilation: half of a command's, in a tenth of the files


def cache_folder() -> Path:
    """Folder of compiled programs: JAX's variable, else BAYES_AERO_CACHE, else the user's cache folder.

    The latter two have a folder for each kind of processor, its model and features, because a program compiled for one
    may not run on another.
    """
    given = os.environ.get(FOLDER)
    if given:
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
    """Ignore entries of the cache that cannot be read or written.

    Another process may be writing the entry or may have died while writing; the program is then compiled again.
    """
    warnings.filterwarnings("ignore", "Error (reading|writing) persistent compilation cache", UserWarning)
