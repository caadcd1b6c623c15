"""A job beside others: on the core that they leave free, and stopped when they are."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import CancelledError, Executor, ThreadPoolExecutor
from contextlib import contextmanager
from threading import Event
from typing import Generic, TypeVar

from bayes_aero.progress import Progress

Result = TypeVar("Result")


class BackgroundJob(Generic[Result]):
    """A job that runs. Where it is will be shown from when it is waited for."""

    def __init__(self, pool: Executor, job: Callable[[Progress], Result], progress: Progress | None) -> None:
        self._progress, self._stopped, self._waited = progress, Event(), Event()
        self._running = pool.submit(job, self._tell)

    def result(self) -> Result:
        """What the job returns, or raises, once it has."""
        self._waited.set()
        return self._running.result()

    def stop(self) -> None:
        """End the job where it next tells where it is."""
        self._stopped.set()

    def _tell(self, text: str, share: float) -> None:
        if self._stopped.is_set():
            raise CancelledError
        if self._progress and self._waited.is_set():
            self._progress(text, share)


@contextmanager
def in_background(
    job: Callable[[Progress], Result], progress: Progress | None = None
) -> Iterator[BackgroundJob[Result]]:
    """Run `job` in a thread of its own while the block lasts, and until it ends.

    The job is handed a function to be told where it is. There it ends if the block fails: Ctrl-C does not wait for its
    whole length.
    """
    with ThreadPoolExecutor(1) as pool:
        running = BackgroundJob(pool, job, progress)
        try:
            yield running
        except BaseException:
            running.stop()
            raise
