"""Parts of a file: `FILE@FROM:TO` in seconds of the file's time, `FILE@#2` for the second part between gaps."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from bayes_aero.errors import InputError
from bayes_aero.flight.card.toml_tables import is_file
from bayes_aero.flight.record import FlightRecord
from bayes_aero.units import instant

GAP = 1.5  # a step longer than this many median steps is a gap: at least one sample is lost
SHORTEST = 50  # samples of a part that is worth a record
_NUMBER = r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d{1,3})?"
_SPAN = re.compile(rf"(?P<file>.+)@(?:(?P<begin>{_NUMBER})?:(?P<end>{_NUMBER})?|#(?P<part>\d{{1,6}}))")


@dataclass(frozen=True)
class Segment:
    """A file, and the part of it that is meant."""

    file: Path  # without the part
    begin: float | None = None  # first time, s; None from the beginning
    end: float | None = None  # last time, s; None to the end
    part: int | None = None  # number of the part between gaps, counted from 1, instead of times
    words: str = ""  # the part as it was written behind "@"; empty for the whole file

    @property
    def whole(self) -> bool:
        """Whether all of the file is meant."""
        return self.begin is None and self.end is None and self.part is None

    @property
    def label(self) -> str:
        """A name for the record: the file's stem, and the part."""
        if self.whole:
            return self.file.stem
        if self.part is not None:
            return f"{self.file.stem}_part{self.part}"
        begin, end = ("" if limit is None else instant(limit) for limit in (self.begin, self.end))
        return f"{self.file.stem}_{begin}-{end}"


def segment_of(path: str | os.PathLike[str]) -> Segment:
    """What a path means; a file whose whole name looks like a segment is that file."""
    text = os.fspath(path)
    match = _SPAN.fullmatch(text)
    if match is None or is_file(Path(text)):
        return Segment(Path(text))
    begin, end = (None if match[key] is None else float(match[key]) for key in ("begin", "end"))
    if begin is not None and end is not None and not begin < end:
        raise InputError(
            f"{text}: the part from {instant(begin)} to {instant(end)} s holds nothing; write FILE@FROM:TO, "
            "FROM before TO"
        )
    part, words = match["part"], text[len(match["file"]) + 1 :]
    return Segment(Path(match["file"]), begin, end, None if part is None else int(part), words)


def cut(record: FlightRecord, segment: Segment) -> FlightRecord:
    """The part of a record, with the file's own time; raises as `samples_of`."""
    if segment.whole:
        return record
    own = samples_of(record.time, segment)
    return replace(record, time=record.time[own], channels={name: x[own] for name, x in record.channels.items()})


def samples_of(time: np.ndarray, segment: Segment) -> slice:
    """Which samples of a file with (n,) time in s a part has. Raises InputError: the file has no sample there."""
    if segment.whole:
        return slice(None)
    if segment.part is not None:
        parts = parts_of(time)
        if not 1 <= segment.part <= len(parts):
            raise InputError(f"there is no part {segment.part}: gaps in time divide it into {len(parts)}")
        return slice(*parts[segment.part - 1])
    if (np.diff(time) <= 0.0).any():
        raise InputError(
            "its time starts over or repeats, so that seconds do not tell a part; name parts by number (FILE@#1, "
            "FILE@#2, or --split)"
        )
    begin = -np.inf if segment.begin is None else segment.begin
    end = np.inf if segment.end is None else segment.end
    slack = 1e-6 * float(np.median(np.diff(time))) if len(time) > 1 else 0.0  # times that were typed are rounded
    inside = np.flatnonzero((time >= begin - slack) & (time <= end + slack))
    if not len(inside):
        raise InputError(
            f"no sample lies in the part from {instant(begin)} to {instant(end)} s: its time goes "
            f"from {instant(time[0])} to {instant(time[-1])} s; correct the part"
        )
    return slice(int(inside[0]), int(inside[-1]) + 1)


def parts_of(time: np.ndarray) -> list[tuple[int, int]]:
    """First sample and the one after the last of each part between gaps, or where time starts over; (n,) time in s."""
    step = np.diff(time)
    if not len(step):
        return [(0, len(time))]
    forward = step[step > 0.0]
    median = float(np.median(forward)) if len(forward) else 0.0
    repeated = np.mean(step == 0.0) > 0.1  # rounded stamps: no seam between them
    seams = (step > GAP * median) | ((step < 0.0) if repeated else (step <= 0.0))
    if repeated or np.mean(seams) > 0.05:  # stamps that are rounded or uneven throughout are no gaps
        seams = (step > 5.0 * max(median, float(np.mean(step[step >= 0.0])))) | (step < 0.0)
    edges = [0, *(np.flatnonzero(seams) + 1).tolist(), len(time)]
    return list(pairwise(edges))


def expanded(
    paths: Sequence[str | os.PathLike[str]], stated: Mapping[str, Sequence[str]], times: Mapping[str, np.ndarray] | None
) -> list[Path]:
    """The manoeuvres that records stand for: what a card has `stated` of a file of that name, else its parts between
    gaps, if `times` has the (n,) time in s of each whole file by its path. A path with a part stands for that alone."""
    found: list[Path] = []
    for path in paths:
        text = os.fspath(path)
        segment = segment_of(text)
        own = stated.get(segment.file.name, ()) if segment.whole else ()
        if own:
            found += [Path(f"{text}@{part}") for part in own]
        elif segment.whole and times is not None:
            time, all_parts = times[text], parts_of(times[text])
            long = [(k, a, b) for k, (a, b) in enumerate(all_parts, 1) if b - a >= SHORTEST]
            if len(all_parts) == 1:
                found.append(Path(text))
            elif (np.diff(time) <= 0.0).any():
                found += [Path(f"{text}@#{k}") for k, _, _ in long]
            else:
                found += [Path(f"{text}@{time[a]:.15g}:{time[b - 1]:.15g}") for _, a, b in long]
        else:
            found.append(Path(text))
    return found
