"""The records of a finished result: results name them by their hash, and do not repeat them."""

from __future__ import annotations

import hashlib
import shlex
from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

from bayes_aero.errors import InputError
from bayes_aero.flight.card.card import Card
from bayes_aero.flight.reading.read_record import read_record
from bayes_aero.flight.reading.segments import segment_of
from bayes_aero.flight.record import FlightRecord


def records_of(
    provenance: Mapping[str, Any], result: Path, card: Card, folders: Sequence[Path] = ()
) -> list[FlightRecord]:
    """The records with which a result was made, unchanged.

    Args:
        provenance: of the result.
        result: its file.
        card: of the result.
        folders: where they are looked for first; then at the paths of the result's command, beside the result, above
            it, and in the working directory.

    Raises:
        InputError: one is not found, or its content differs.
    """
    words = shlex.split(provenance.get("command", ""))
    places = [*folders, *_places(words, result)]
    found = [_found(one, places, result, given=bool(folders)) for one in provenance["inputs"]]
    resample = next((float(x) for word, x in pairwise(words) if word == "--resample"), None)
    return [read_record(path, card.channels, resample=resample) for path in found]


def _places(words: Sequence[str], result: Path) -> Iterator[Path]:
    """Folders in which a record may be."""
    yield from dict.fromkeys(segment_of(word).file.parent for word in words[2:] if not word.startswith("-"))
    yield from (result.parent, result.parent.parent, Path())


def _found(one: Mapping[str, Any], places: Sequence[Path], result: Path, *, given: bool) -> Path:
    name = Path(one["source"]).name
    file = segment_of(name).file.name
    there = [place for place in places if (place / file).is_file()]
    for place in there:
        if hashlib.sha256((place / file).read_bytes()).hexdigest() == one["sha256"]:
            return place / name
    if there:
        raise InputError(
            f"record {there[0] / file} has changed since {result} was made (its content differs); run the command "
            "again, or give the folder of the unchanged record with --records"
        )
    where = f"in {places[0]}" if given else "where it was, nor beside the result, nor here"
    raise InputError(f"record {file} of {result} is not {where}; give its folder with --records")
