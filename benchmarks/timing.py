"""Contenders timed in turn, so that a slow moment of the machine falls on all."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from typing import Any

Runs = Mapping[str, Callable[[], Any]]


def timed(runs: Runs, repeats: int = 5) -> dict[str, float]:
    """Least seconds of each.

    Each runs once untimed in its turn: the first time it may compile, and later the shortest would pay for the caches
    and the memory that the longest left.
    """
    times: dict[str, list[float]] = {name: [] for name in runs}
    for _ in range(repeats):
        for name, run in runs.items():
            run()
            began = time.perf_counter()
            run()
            times[name].append(time.perf_counter() - began)
    return {name: min(taken) for name, taken in times.items()}


def compare(runs: Runs, repeats: int = 5) -> None:
    """A line each, with the ratio to the first."""
    times = timed(runs, repeats)
    first = next(iter(times.values()))
    for name, seconds in times.items():
        print(f"  {name:40s} {1e3 * seconds:9.1f} ms  {seconds / first:7.2f} x", flush=True)
