"""Where compiled programs are kept, so that what one process has compiled the next one reads."""

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
LEAST = "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS"
WORTH_KEEPING = "0.2"  # s of compilation: half of a command's, in a tenth of the files


def cache_folder() -> Path:
    """Where compiled programs are kept: JAX's own variable, else BAYES_AERO_CACHE, else the user's cache folder.

    Ours has a folder for each kind of processor, since a program compiled for one may not run on another.
    """
    given = os.environ.get(FOLDER)
    if given:
        return Path(given)
    root = Path(os.environ.get(CACHE) or platformdirs.user_cache_path("bayes_aero"))
    return root / "compiled" / _processor()


def keep_compiled() -> None:
    """Let this process keep what it compiles; without effect once JAX is loaded, or where the folder cannot be made."""
    if "jax" in sys.modules:
        return
    folder = cache_folder()
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:
        return
    os.environ.setdefault(FOLDER, str(folder))
    os.environ.setdefault(LEAST, WORTH_KEEPING)
    forgive()


def forgive() -> None:
    """Say nothing of an entry that cannot be read or written.

    A neighbour may still be writing it, or have died of it: it is compiled here, which is all that is lost.
    """
    warnings.filterwarnings("ignore", "Error (reading|writing) persistent compilation cache", UserWarning)


def _processor() -> str:
    """A name for this kind of processor: its make, and what it can do."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
        told = "\n".join(sorted({line for line in lines if line.startswith(("model name", "flags", "Features"))}))
    except OSError:
        told = platform.processor()
    return f"{platform.machine()}-{hashlib.sha256(told.encode()).hexdigest()[:8]}"
