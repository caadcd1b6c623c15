"""Samples that a recorder wrote twice."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
from jaxtyping import Bool

from bayes_aero.flight.record import FlightRecord

__all__ = ["repeats", "without_repeats"]


def repeats(time: np.ndarray, channels: Iterable[np.ndarray]) -> Bool[np.ndarray, " n"]:
    """True where a sample is the one before it once more, in time and in every channel; all are (n,)."""
    again = np.r_[False, np.diff(time) == 0.0]
    for x in channels if again.any() else ():
        again[1:] &= (x[1:] == x[:-1]) | (np.isnan(x[1:]) & np.isnan(x[:-1]))
    return again


def without_repeats(record: FlightRecord) -> FlightRecord:
    """The record without such samples, which say nothing new, and a remark.

    Samples of one time that differ stay, for nobody knows which of them is right.
    """
    again = repeats(record.time, record.channels.values())
    if not again.any():
        return record
    count = int(again.sum())
    what = "1 sample repeats" if count == 1 else f"{count} samples repeat"
    remark = f"{what} the one before in time and in every channel of the card, and {_are(count)} left out"
    channels = {name: x[~again] for name, x in record.channels.items()}
    return replace(record, time=record.time[~again], channels=channels, remarks=(*record.remarks, remark))


def _are(count: int) -> str:
    return "is" if count == 1 else "are"
