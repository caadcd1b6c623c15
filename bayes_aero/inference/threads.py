"""How many cores this process may keep busy, and when linear algebra should not try."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from functools import lru_cache

from joblib import cpu_count
from threadpoolctl import ThreadpoolController

VARIABLE = "BAYES_AERO_CORES"
WORTH_THREADS = 2500  # rows of a matrix below which a second BLAS thread costs more than it does (twice at 1000 rows)


def cores() -> int:
    """Those that the variable BAYES_AERO_CORES allows, else all that the system allows this process.

    A worker of a cluster is given one: the other cores belong to its neighbours.
    """
    allowed = os.environ.get(VARIABLE, "")
    return max(1, int(allowed)) if allowed.isdecimal() else cpu_count()


@contextmanager
def blas_threads(rows: int) -> Iterator[None]:
    """While it lasts, one BLAS thread works on matrices of so few `rows` that several would wait for each other.

    Larger ones are left to as many as BLAS was started with. It serves as a decorator, too.
    """
    if rows >= WORTH_THREADS:
        yield
        return
    with _libraries().limit(limits=1, user_api="blas"):
        yield


@lru_cache
def _libraries() -> ThreadpoolController:
    """The BLAS libraries that NumPy and SciPy brought, looked for once."""
    return ThreadpoolController()
