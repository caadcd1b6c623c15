"""End of processes whose parent was killed; they would wait for ever to return their results."""

from __future__ import annotations

import os
import threading
import time

POLL_SECONDS = 1.0
_watched: set[int] = set()


def exit_with(parent: int) -> None:
    """End this process soon after its parent has ended; without effect in the parent itself."""
    if os.getppid() != parent or parent in _watched:
        return
    _watched.add(parent)
    threading.Thread(target=_watch, args=(parent,), daemon=True).start()


def _watch(parent: int) -> None:
    while os.getppid() == parent:
        time.sleep(POLL_SECONDS)
    os._exit(1)
