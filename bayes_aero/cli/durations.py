"""How much time is left of a stage: from its speed, and from how long it took the last time.

A stage that compiles has not moved yet; one that trains a large process moves once in minutes, and a speed measured
then says nothing of the minutes after.
"""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable
from contextlib import suppress
from datetime import timedelta
from pathlib import Path

from rich.progress import ProgressColumn, Task
from rich.text import Text

from bayes_aero.atomic_write import write_whole

FILE = "durations.json"
SHORT = 2.0  # s; nobody asks how much is left of less
MOST = 200  # stages that are remembered, the latest
TYPICAL = {
    "loading libraries": 4.0,
    "mle": 10.0,
    "flights": 4.0,
    "emcee": 30.0,
    "nuts": 15.0,
    "white": 15.0,
    "gp": 420.0,
    "figures": 25.0,
    "sensors": 15.0,
    "do the sensors agree?": 12.0,
    "coefficients": 6.0,
    "causes": 8.0,
    "gain on hold-out data": 4.0,
    "trajectories": 60.0,
    "windows, then whole manoeuvres": 30.0,
    "report": 6.0,
}
"""Seconds that stages take of two manoeuvres of a minute and a half on two cores; until one's own are known."""


class Durations:
    """Seconds by stage, in a file of the cache folder that may be lost at any time.

    A stage is named by its text up to a colon; one that is not followed by another, or by the end, is not kept.
    """

    def __init__(self, folder: Path, clock: Callable[[], float] = time.monotonic) -> None:
        self._path, self._clock = folder / FILE, clock
        self._last: dict[str, float] = {}
        with suppress(OSError, ValueError, TypeError):
            held = json.loads(self._path.read_text(encoding="utf-8"))
            self._last = {str(name): float(seconds) for name, seconds in dict(held).items()}
        self._new: dict[str, float] = {}
        self._stage, self._began, self._moved = "", clock(), clock()

    def stage(self, text: str) -> None:
        """What is done now, and that it has moved."""
        name = text.split(":")[0]
        self._moved = self._clock()
        if name != self._stage:
            self._end()
            self._stage, self._began = name, self._clock()

    def left(self, share: float = 0.0, recent: float | None = None) -> float | None:
        """Seconds left of the present stage, of which a `share` is done; None where nothing tells.

        `recent` are those that its last speed left when it last moved: they count until they have passed.
        """
        spent, still = self._clock() - self._began, self._clock() - self._moved
        last = self._last.get(self._stage, TYPICAL.get(self._stage))
        if recent is not None and recent > still:
            return recent - still
        if last is not None and last > spent:
            return last - spent
        if share > 0.0:
            return spent * (1.0 - share) / share
        return None if last is None else 0.0

    def keep(self) -> None:
        """All stages have ended; a file that cannot be written costs nothing but these numbers."""
        self._end()
        held = {name: s for name, s in self._last.items() if name not in self._new} | self._new
        with suppress(OSError):
            self._path.parent.mkdir(parents=True, exist_ok=True)
            write_whole(json.dumps(dict([*held.items()][-MOST:])), self._path)

    def _end(self) -> None:
        if self._stage:
            spent = self._new.pop(self._stage, 0.0) + self._clock() - self._began
            if spent >= SHORT:
                self._new[self._stage] = round(spent, 1)


class TimeLeft(ProgressColumn):
    """Time left of the stage."""

    max_refresh = 0.5

    def __init__(self, durations: Durations) -> None:
        super().__init__()
        self._durations = durations

    def render(self, task: Task) -> Text:
        """As h:mm:ss."""
        left = 0.0 if task.finished else self._durations.left(task.completed, task.time_remaining)
        shown = "-:--:--" if left is None else str(timedelta(seconds=math.ceil(left)))
        return Text(shown, style="progress.remaining")
