"""Clock times and dates to seconds since the first sample."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np

from bayes_aero.errors import InputError

__all__ = ["looks_like_clock", "seconds"]

DAY = 86400.0
_TIME = re.compile(r"(?:\d{1,3}:)?\d{1,2}:\d{1,2}(?::\d{1,2})?(?:[.,]\d*)?")
_DATED = re.compile(r"\d{1,4}[-/.]\d{1,2}[-/.]\d{1,4}(?!\d).*")
_OF_DAY = re.compile(r"\d{1,2}:\d{1,2}.*")
_WEIGHTS = {2: (60.0, 1.0), 3: (3600.0, 60.0, 1.0), 4: (DAY, 3600.0, 60.0, 1.0)}


def looks_like_clock(cell: str) -> bool:
    """Whether a cell is a clock time (10:23:45.12, 127:10:23:45, 23:45.1) or a date with one."""
    return (
        _TIME.fullmatch(cell) is not None or _DATED.fullmatch(cell) is not None or _OF_DAY.fullmatch(cell) is not None
    )


def seconds(cells: Sequence[str]) -> np.ndarray:
    """(n,) seconds since the first cell; a clock that passes midnight goes on.

    Raises:
        InputError: a cell is no time.
    """
    if all(_TIME.fullmatch(cell) for cell in cells):
        return _clock(cells)
    return _dates(cells)


def _clock(cells: Sequence[str]) -> np.ndarray:
    """h:m:s, m:s, or day:h:m:s as range clocks (IRIG) write it."""
    parts = [cell.replace(",", ".").split(":") for cell in cells]
    if len({len(part) for part in parts}) > 1:
        raise InputError("clock times of different forms stand in one column; write time in seconds")
    values = np.array(parts, dtype=np.float64) @ np.array(_WEIGHTS[len(parts[0])])
    if len(parts[0]) == 4:
        return values - values[0]
    period = 3600.0 if len(parts[0]) == 2 else DAY
    turns = np.cumsum(np.r_[0.0, np.diff(values)] < -0.5 * period)
    return values + period * turns - values[0]


def _dates(cells: Sequence[str]) -> np.ndarray:
    import pandas as pd

    try:
        stamps = pd.to_datetime(pd.Series(list(cells)), format="ISO8601", utc=True)
    except (ValueError, OverflowError):
        try:  # the order of day and month is the one in which the record is shorter
            texts = pd.Series(list(cells))
            orders = [pd.to_datetime(texts, format="mixed", utc=True, dayfirst=first) for first in (False, True)]
        except (ValueError, OverflowError, TypeError) as reason:
            raise InputError("clock times or dates that cannot be read; write time in seconds") from reason
        stamps = min(orders, key=lambda order: abs(order.iloc[-1] - order.iloc[0]))
    nanoseconds = stamps.to_numpy(dtype="datetime64[ns]").astype(np.int64)
    return (nanoseconds - nanoseconds[0]) * 1e-9
