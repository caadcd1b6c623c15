"""Compiled programs of this process: their limit, and how to free them."""

from __future__ import annotations

import ctypes
import gc
import sys
from pathlib import Path

import jax

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
    """Whether this process is near the limit of memory mappings of Linux.

    Each compiled program takes about four. Beyond the limit the compiler ends the process with a segmentation fault.
    """
    try:
        with MAPPINGS.open(encoding="utf-8", errors="replace") as lines:
            count = sum(1 for _ in lines)
        return count > MAX_SHARE * int(LIMIT.read_text(encoding="utf-8"))
    except OSError:  # another system has no such limit
        return False
