"""Compiled programs of this process: how many it may hold, and giving them back."""

from __future__ import annotations

import ctypes
import gc
import sys
from pathlib import Path

import jax

MAPPINGS, LIMIT = Path("/proc/self/maps"), Path("/proc/sys/vm/max_map_count")
FULL = 0.6  # share of the mappings; whatever runs next may take as much as a whole diagnosis, a tenth


def give_back_memory() -> None:
    """Return to the system what compilers and samplers have left: compiled programs that nobody calls again, and
    glibc's free lists, over half a GB."""
    jax.clear_caches()
    gc.collect()
    if sys.platform == "linux":
        trim = getattr(ctypes.CDLL(None), "malloc_trim", None)  # other C libraries have none
        if trim is not None:
            trim(0)


def full_of_programs() -> bool:
    """Whether this process comes near the number of memory mappings that Linux allows it.

    Each compiled program takes some four. Beyond the limit the compiler ends the process with a segmentation fault.
    """
    try:
        with MAPPINGS.open(encoding="utf-8", errors="replace") as lines:
            count = sum(1 for _ in lines)
        return count > FULL * int(LIMIT.read_text(encoding="utf-8"))
    except OSError:  # another system has no such limit
        return False
