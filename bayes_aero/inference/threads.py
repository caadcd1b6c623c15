"""Number of cores that this process may use, and limits on the threads of linear algebra."""

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
    """Number of cores by the variable BAYES_AERO_CORES, else all that the system allows this process.

    A worker of a cluster has one core; the others belong to other workers.
    """
    allowed = os.environ.get(VARIABLE, "")
    return max(1, int(allowed)) if allowed.isdecimal() else cpu_count()


@contextmanager
def blas_threads(rows: int) -> Iterator[None]:
    """Context (or decorator) with one BLAS thread for matrices of few `rows`, on which several wait for each other.

    Larger matrices keep the number of threads with which BLAS was started.
    """
    if rows >= WORTH_THREADS:
        yield
        return
    with _libraries().limit(limits=1, user_api="blas"):
        yield


@lru_cache
def _libraries() -> ThreadpoolController:
    """The BLAS libraries of NumPy and SciPy, found once."""
    return ThreadpoolController()
