"""What all file formats share: the columns that a file offers, their values, and the search for those a card names."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from difflib import get_close_matches
from typing import Any

import numpy as np

from bayes_aero.errors import InputError
from bayes_aero.flight.channel import Channel

MAX_VALUES = 20_000_000  # most samples that one channel may have; held against the file's header before memory is taken
MOST_VALUES_IN_ALL = 100_000_000
"""Most samples of all channels together: 0.8 GB. A compressed file of some kB can claim any number."""

MOST_HEADINGS = 20_000
"""Most columns of a file: an autopilot's log has thousands; searching for a name among millions would take hours."""


@dataclass(frozen=True)
class FileColumn:
    """One channel as in the file: (n,) values in the file's unit, NaN where it has none, and the unit it states."""

    values: np.ndarray
    unit: str | None = None


@dataclass(frozen=True)
class Heading:
    """One column of a file before its values are read."""

    names: tuple[str, ...] = ()  # as in the file; none without a header, several with more than one row of names
    column: int | None = None  # its number on a card, counted from 1; None where it goes by its name alone
    unit: str | None = None  # that the file states beside the name
    formed: bool = False  # the name was formed by the reader, "data(:,3)": a card's number counts beside any label


@dataclass(frozen=True)
class OpenedFile:
    """A file whose columns are known, of one length, and whose values are still to be read. `read` gives those of some
    headings, each under the name of the channel that it was taken for; NaN at samples that a column of several rates
    lacks. `kind`: what a column is called there. `remarks`: how the file was understood; reading may add to them."""

    headings: Sequence[Heading]
    read: Callable[[Mapping[str, Heading]], dict[str, FileColumn]]
    kind: str = "variable"
    remarks: list[str] = field(default_factory=list)


def located(channels: Sequence[Channel], opened: OpenedFile) -> dict[str, Heading]:
    """The heading of each channel, see `candidates`. A required one must be there, and none may be twice."""
    if len(opened.headings) > MOST_HEADINGS:
        raise InputError(
            f"it has {len(opened.headings)} {opened.kind}s, more than {MOST_HEADINGS}; is it a flight record?"
        )
    look = HeadingIndex(opened.headings)
    places = {}
    for channel in channels:
        there = look.candidates(channel)
        if len(there) > 1:
            raise InputError(
                f"channel {channel.name}: {len(there)} {opened.kind}s are called {channel.heading!r}; rename all but "
                "the right one"
            )
        if there:
            places[channel.name] = there[0]
        elif channel.required:
            raise InputError(_absent(channel, list(look.by_name), len(look.by_column), opened.kind))
    return places


class HeadingIndex:
    """Headings by name and by number."""

    def __init__(self, headings: Sequence[Heading]) -> None:
        self.by_name: dict[str, list[Heading]] = {}
        for heading in headings:
            for name in dict.fromkeys(heading.names):
                self.by_name.setdefault(name, []).append(heading)
        self.by_column = {heading.column: heading for heading in headings if heading.column is not None}

    def candidates(self, channel: Channel) -> list[Heading]:
        """The headings of a channel's name; else its number, unless the card has a label that names none."""
        numbered = None if channel.column is None else self.by_column.get(channel.column)
        usable = numbered is not None and (channel.label is None or not numbered.names or numbered.formed)
        return self.by_name.get(channel.heading) or ([numbered] if usable and numbered is not None else [])


def _absent(channel: Channel, available: Sequence[str], columns: int, kind: str) -> str:
    """Why a required channel is not there, and what to do."""
    if not available:
        if channel.column is None:
            return (
                f"channel {channel.name} has no column number on the card, and the file has no header; add column = N, "
                "or write the file with a header line"
            )
        return (
            f"channel {channel.name} is column {channel.column} on the card, but the file has {columns} columns; "
            "correct the column, or set required = false"
        )
    folded = {name.casefold(): name for name in available}
    close = [folded[name] for name in get_close_matches(channel.heading.casefold(), folded, n=3, cutoff=0.5)]
    if close:
        hint = "did you mean " + " or ".join(repr(name) for name in close) + "?"
    else:
        more = ", ..." if len(available) > 15 else ""
        hint = f"the file has {', '.join(repr(name[:40]) for name in available[:15])}{more};"
    by_number = "" if channel.column is None else ", take the label off it (then its column number counts)"
    return (
        f"channel {channel.name}: no {kind} is called {channel.heading!r}; {hint} correct its label on the "
        f"card{by_number}, or set required = false"
    )


def refuse_huge(name: str, heading: str, size: float, channels: int) -> None:
    """Hold what a header claims for one of so many `channels` against what a record can have."""
    if size > MAX_VALUES:
        raise InputError(
            f"channel {name} ({heading!r}) claims {size:.0f} samples, more than {MAX_VALUES}; "
            f"is the file damaged? Write it again"
        )
    if size * channels > MOST_VALUES_IN_ALL:
        raise InputError(
            f"{channels} channels of {size:.0f} samples, as {name} ({heading!r}) claims, are more than "
            f"{MOST_VALUES_IN_ALL} values; is the file damaged? Otherwise cut the record"
        )


def vector(values: np.ndarray, name: str) -> np.ndarray:
    """A numeric array as a float64 vector; row and column vectors are flattened."""
    if values.dtype.kind not in "fiub":
        raise InputError(
            f"channel {name} holds {values.dtype} where numbers should be; store it as plain numbers, "
            f"and time as seconds"
        )
    if values.size > MAX_VALUES:
        raise InputError(f"channel {name} claims {values.size} samples, more than {MAX_VALUES}; cut the record")
    if values.ndim != 1 and values.size != max(values.shape, default=1):
        raise InputError(f"channel {name} has shape {values.shape} where one value a sample should be; split it up")
    return values.astype(np.float64).reshape(-1)


PACKING = (
    "_Unsigned", "scale_factor", "add_offset", "_FillValue", "missing_value", "valid_min", "valid_max", "valid_range",
    "flag_values", "flag_masks", "flag_meanings",
)  # fmt: skip
"""Attributes by which NetCDF says what stored numbers mean."""

_ONE = np.ones(1)
_NEVER_WRITTEN = {
    "i2": -32767, "i4": -2147483647, "i8": -9223372036854775806, "f4": 2.0**122 * 1.875, "f8": 2.0**122 * 1.875,
}  # fmt: skip
"""What the NetCDF library stores where nothing was written (netcdf.h: NC_FILL_SHORT and so on)."""


def unpacked(raw: np.ndarray, attributes: Mapping[str, Any], name: str) -> np.ndarray:
    """The numbers that (n,) stored ones stand for by the variable's `attributes`, of which those of `PACKING` count.
    NaN where they are missing or outside the valid range; flags and packing that is no numbers are refused. Source: CF
    conventions 1.11, sections 2.5.1 and 8.1; NetCDF User's Guide, appendix A."""
    if any(key.startswith("flag_") for key in PACKING if key in attributes):
        raise InputError(
            f"channel {name} holds flags (it has flag_meanings), no measured quantity; name another variable on the "
            "card, or take the flag attributes off it"
        )
    given = {key: _native(attributes[key]) for key in PACKING if key in attributes}
    said = given.pop("_Unsigned", np.array([""]))[:1].astype(str)
    unsigned = "".join(said).strip().casefold()
    wrong = [key for key, x in given.items() if x.dtype.kind not in "fiu" or not x.size]
    wrong += [key for key in ("scale_factor", "add_offset") if key in given and given[key].size != 1]
    wrong += ["_Unsigned"] if unsigned not in ("", "true", "false") else []
    if wrong:
        raise InputError(f"channel {name} has a {wrong[0]} that says nothing; write it again with plain numbers there")
    raw = _native(raw)
    stored = raw.dtype
    if unsigned and stored.kind in "iu":
        meant = np.dtype(f"{'u' if unsigned == 'true' else 'i'}{stored.itemsize}")
        raw, given = raw.view(meant), {key: x.view(meant) if x.dtype == stored else x for key, x in given.items()}
    with np.errstate(all="ignore"):  # a damaged file may state any number
        values = raw.astype(np.float64)
        never = _NEVER_WRITTEN.get(raw.dtype.str[1:], ()) if stored.kind == "f" else ()
        if {"scale_factor", "add_offset"} & set(given):
            values = values * given.get("scale_factor", _ONE)[0] + given.get("add_offset", 0.0 * _ONE)[0]
            never = _NEVER_WRITTEN.get(raw.dtype.str[1:], ())
        missing = np.isin(raw, given.get("_FillValue", never))
        missing |= np.isin(raw, given.get("missing_value", ()))
        for key in ("valid_min", "valid_max", "valid_range"):
            if key in given:
                # A limit of a wider type than the packed numbers is one of the unpacked ones.
                x = values if given[key].dtype.kind == "f" and stored.kind in "iu" else raw
                missing |= (key != "valid_max") & (x < given[key][0]) | (key != "valid_min") & (x > given[key][-1])
    values[missing] = np.nan
    return values


def _native(values: Any) -> np.ndarray:
    """A vector in the byte order of this machine."""
    array = np.asarray(values).reshape(-1)
    return array.astype(array.dtype.newbyteorder("="))


def stated_unit(units: Any) -> str | None:
    """The unit in an attribute `units`; of "seconds since 2020-01-01" the seconds."""
    units = units.decode("utf-8", "replace") if isinstance(units, bytes) else units
    return str(units).split(" since ")[0][:60] if isinstance(units, str) else None


@contextmanager
def foreign(kind: str) -> Iterator[None]:
    """Turn whatever a foreign parser throws at a damaged file, KeyError to zlib.error, into one sentence."""
    try:
        yield
    except InputError:
        raise
    except MemoryError as reason:
        raise InputError(
            f"it claims more data than there is memory for; is it damaged? Write the {kind} again"
        ) from reason
    except Exception as reason:
        said = " ".join(str(reason).split())[:120] or type(reason).__name__
        raise InputError(f"it is not a readable {kind} ({said}); is it damaged or misnamed? Write it again") from reason


# --- Files whose channels come at several rates: groups of columns, each group with its own time stamps.

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
    """A file of groups: time first, then every column, no two with the same first name. `kind`: what a column is
    called; `tick`: resolution of the stamps, s."""
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
        chosen = {name: places[heading] for name, heading in wanted.items() if heading != TIME}
        used = {id(group): group for group, _ in (chosen or places).values()}
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
            group, series = chosen[name]
            values = np.full(len(time), np.nan)
            values[rows[id(group)]] = vector(series.values, name)
            columns[name] = FileColumn(values, heading.unit)
        return columns

    return OpenedFile(headings, read, kind, list(remarks))
