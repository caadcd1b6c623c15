"""Files whose channels come at several rates: groups of columns, each group with its own time stamps."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from bayes_aero.errors import InputError
from bayes_aero.flight.readers.base import FileColumn, Heading, OpenedFile, refuse_huge, vector

TIME = Heading(("time",), None, "s")  # stands for the time stamps of whatever columns are read beside it


@dataclass(frozen=True)
class Series:
    """One column of a group: the names that it goes by, its unit where the file tells it, and (n,) values."""

    names: tuple[str, ...]
    unit: str | None
    values: np.ndarray


@dataclass(frozen=True)
class SampleGroup:
    """Columns that are sampled together. `time`: (n,) seconds from the file's start."""

    name: str
    time: np.ndarray
    series: tuple[Series, ...]

    def ticks(self, tick: float) -> np.ndarray:
        """(n,) time stamps as whole numbers of ticks of so many seconds; they must increase."""
        scaled = self.time * round(1.0 / tick)
        if not np.isfinite(scaled).all() or np.abs(scaled).max(initial=0.0) > 2.0**62:
            raise InputError(f"a time stamp of {self.name} is no number or far too large; is the file damaged?")
        whole = np.rint(scaled).astype(np.int64)
        back = np.diff(whole) <= 0
        if back.any():
            at = int(np.argmax(back)) + 1
            what = "repeats" if whole[at] == whole[at - 1] else "runs backwards"
            raise InputError(
                f"the time of {self.name} {what} at its sample {at} (counted from 0; t = {self.time[at]:.9g} s), "
                f"{int(back.sum())} times in all, and cannot be joined with that of other groups; take the channels of "
                f"{self.name} off the card, or cut the record there"
            )
        return whole


def several_rates(kind: str, groups: Sequence[SampleGroup], remarks: Sequence[str], tick: float) -> OpenedFile:
    """A file of groups with a sample: time first, then every column, no two with the same first name. `kind` is what a
    column is called there, `tick` the resolution of its time stamps, s: stamps that differ by less than half of it are
    the same instant."""
    headings, places, taken = [TIME], dict[Heading, tuple[SampleGroup, Series]](), {"time"}
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

    def read(wanted: Mapping[str, Heading]) -> dict[str, FileColumn]:
        # The samples are at all time stamps of the groups that the wanted columns are in.
        found = {name: places[heading] for name, heading in wanted.items() if heading != TIME}
        used = {id(group): group for group, _ in (found or places).values()}
        size = sum(len(group.time) for group in used.values())
        for name, heading in wanted.items():
            refuse_huge(name, heading.names[0], size, len(wanted))
        if len(used) == 1:
            (time,), rows = (group.time for group in used.values()), dict.fromkeys(used, slice(None))
        else:
            stamps = {key: group.ticks(tick) for key, group in used.items()}
            union = np.unique(np.concatenate(list(stamps.values())))
            time, rows = union / round(1.0 / tick), {k: np.searchsorted(union, own) for k, own in stamps.items()}
        columns = {}
        for name, heading in wanted.items():
            if heading == TIME:
                columns[name] = FileColumn(time.copy(), "s")
                continue
            group, series = found[name]
            values = np.full(len(time), np.nan)
            values[rows[id(group)]] = vector(series.values, name)
            columns[name] = FileColumn(values, heading.unit)
        return columns

    return OpenedFile(headings, read, kind, list(remarks))
