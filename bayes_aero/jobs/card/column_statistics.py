"""One column of an unknown file, taken for a channel, and simple measures of its values."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from bayes_aero.flight.channel import STANDARD_CHANNELS
from bayes_aero.flight.reading.raw import RawColumn
from bayes_aero.units import to_si

SI = {name: channel.unit for name, channel in STANDARD_CHANNELS.items()}
FOLLOWS = 0.5  # correlation of a rate with the angle that it changes; our choice
FAINT = 0.25  # correlation beyond that of noise, within 0.2 in smoothed records of 2000 samples; our choice


@dataclass(frozen=True)
class Guess:
    """One column taken for a channel; `evidence` says why, in words."""

    channel: str
    column: RawColumn
    unit: str | None
    sign: int = 1
    evidence: str = ""

    @property
    def values(self) -> np.ndarray:
        """As in the file; the median where there is no finite number."""
        x = np.zeros(1) if self.column.values is None else self.column.values
        sound = np.isfinite(x)
        return x if sound.all() else np.where(sound, x, np.median(x[sound]) if sound.any() else 0.0)

    @property
    def si(self) -> np.ndarray:
        """In SI; in the file's numbers where the unit is not known."""
        if self.unit is None:
            return self.sign * self.values
        return self.sign * to_si(self.values, self.unit, self.channel, SI.get(self.channel))

    def because(self, text: str, **changes: object) -> Guess:
        """The guess with a change, and the reason added to the evidence."""
        return replace(self, evidence=f"{self.evidence}; {text}", **changes)  # type: ignore[arg-type]


def step_of(found: Mapping[str, Guess]) -> float | None:
    """Median sampling interval, s; None where time is of no use."""
    if "time" not in found:
        return None
    step = float(np.median(np.diff(found["time"].si)))
    return step if step > 0.0 else None


def largest(guess: Guess) -> float:
    """The largest size of a value, in the file's unit."""
    return float(np.nanmax(np.abs(guess.values)))


def smooth(x: np.ndarray) -> np.ndarray:
    """Means of nine samples, so that noise does not swamp a derivative."""
    return np.convolve(np.pad(x, 4, mode="edge"), np.full(9, 1.0 / 9.0), mode="valid")


def slope_of(x: np.ndarray, y: np.ndarray) -> float | None:
    """Least-squares slope of y over x, both without their means."""
    x, y = x - np.mean(x), y - np.mean(y)
    power = float(x @ x)
    return float(x @ y) / power if power > 0.0 else None


def alike(x: np.ndarray, y: np.ndarray, least: float = FOLLOWS) -> bool:
    """Whether one of two signals follows the other, upright or reversed: what is mostly noise tells no sign."""
    return bool(min(np.ptp(x), np.ptp(y)) > 0.0 and abs(np.corrcoef(x, y)[0, 1]) > least)
