"""Files whose channels come at several rates: groups of columns, each group with its own time stamps."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from bayes_aero.errors import InputError
from bayes_aero.flight.readers.base import Column, Heading, refuse_huge, vector

__all__ = ["Group", "Series", "SeveralRates", "several_rates"]

TIME = Heading(("time",), None, "s")
"""Stands for the time stamps of whatever columns are read beside it."""


@dataclass(frozen=True)
class Series:
    """One column of a group: the names that it goes by, its unit where the file tells it, and (n,) values."""

    names: tuple[str, ...]
    unit: str | None
    values: np.ndarray


@dataclass(frozen=True)
class Group:
    """Columns that are sampled together. `time`: (n,) seconds from the file's start."""

    name: str
    time: np.ndarray
    series: tuple[Series, ...]


@dataclass(frozen=True)
class SeveralRates:
    """A file of groups. `places`: group and column of each heading; `tick`: resolution of the time stamps, s."""

    kind: str
    headings: Sequence[Heading]
    remarks: Sequence[str]
    places: Mapping[Heading, tuple[Group, Series]]
    tick: float

    def read(self, wanted: Mapping[str, Heading]) -> dict[str, Column]:
        """See `Opened.read`. The samples are at all time stamps of the groups that the wanted columns are in."""
        found = {name: self.places[heading] for name, heading in wanted.items() if heading != TIME}
        groups = {id(group): group for group, _ in found.values()}
        if not groups:
            groups = {id(group): group for group, _ in self.places.values()}
        size = sum(len(group.time) for group in groups.values())
        for name, heading in wanted.items():
            refuse_huge(name, heading.names[0], size, len(wanted))
        if len(groups) == 1:
            (time,), rows = (group.time for group in groups.values()), dict.fromkeys(groups, slice(None))
        else:
            time, rows = self._union(groups)
        columns = {}
        for name, heading in wanted.items():
            if heading == TIME:
                columns[name] = Column(time.copy(), "s")
                continue
            group, series = found[name]
            values = np.full(len(time), np.nan)
            values[rows[id(group)]] = vector(series.values, name)
            columns[name] = Column(values, heading.unit)
        return columns

    def _union(self, groups: Mapping[int, Group]) -> tuple[np.ndarray, dict[int, np.ndarray]]:
        """The time stamps of all groups, s, and the rows of each group's samples among them."""
        ticks = {key: _ticks(group, self.tick) for key, group in groups.items()}
        union = np.unique(np.concatenate(list(ticks.values())))
        return union / round(1.0 / self.tick), {key: np.searchsorted(union, own) for key, own in ticks.items()}


def several_rates(kind: str, groups: Sequence[Group], remarks: Sequence[str], tick: float) -> SeveralRates:
    """The headings of a file: time first, then every column of its groups, no two with the same first name.

    Args:
        kind: what a column is called there.
        groups: those without a sample are left out.
        remarks: how the file was understood.
        tick: resolution of its time stamps, s; stamps that differ by less than half of it are the same instant.

    Raises:
        InputError: no group has a sample.
    """
    headings, places, taken = [TIME], {}, {"time"}
    for group in groups:
        for series in group.series if len(group.time) else ():
            first, count = series.names[0], 2
            while first in taken:
                first, count = f"{series.names[0]} ({count})", count + 1
            taken.add(first)
            heading = Heading(tuple(dict.fromkeys((first, *series.names[1:]))), None, series.unit)
            headings.append(heading)
            places[heading] = (group, series)
    if not places:
        raise InputError("it holds no samples with time stamps; is it cut off? Write it again")
    return SeveralRates(kind, headings, list(remarks), places, tick)


def _ticks(group: Group, tick: float) -> np.ndarray:
    """(n,) time stamps as whole numbers of ticks; they must increase."""
    scaled = group.time * round(1.0 / tick)
    if not np.isfinite(scaled).all() or np.abs(scaled).max(initial=0.0) > 2.0**62:
        raise InputError(f"a time stamp of {group.name} is no number or far too large; is the file damaged?")
    whole = np.rint(scaled).astype(np.int64)
    back = np.diff(whole) <= 0
    if back.any():
        at = int(np.argmax(back)) + 1
        what = "repeats" if whole[at] == whole[at - 1] else "runs backwards"
        raise InputError(
            f"the time of {group.name} {what} at its sample {at} (counted from 0; t = {group.time[at]:.9g} s), "
            f"{int(back.sum())} times in all, and cannot be joined with that of other groups; take the channels of "
            f"{group.name} off the card, or cut the record there"
        )
    return whole
