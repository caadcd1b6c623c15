"""The records of a finished result, found again: a result names them by their content, and does not repeat them."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from bayes_aero.errors import InputError
from bayes_aero.flight.card.card import Card
from bayes_aero.flight.reading.read_record import read_again
from bayes_aero.flight.reading.segments import segment_of
from bayes_aero.flight.record import FlightRecord


def fitted_records(
    provenance: Mapping[str, Any],
    result: Path,
    card: Card,
    *,
    files: Sequence[Path] = (),
    folders: Sequence[Path] = (),
) -> list[FlightRecord]:
    """The records with which a result was made, in their order and read as they were.

    Args:
        provenance: of the result.
        result: its file.
        card: of the result.
        files: where they are looked for first, whatever their names.
        folders: the same by their names; then at the paths that the result states, from the working directory, the
            result's folder and the one above it.

    Raises:
        InputError: one is not found, or its samples differ.
    """
    return [_found(one, result, card, files, folders) for one in provenance["inputs"]]


def _found(
    one: Mapping[str, Any], result: Path, card: Card, files: Sequence[Path], folders: Sequence[Path]
) -> FlightRecord:
    if "content" not in one:
        raise InputError(
            f"{result} was written by an earlier version, which did not state how it read its records; run the command "
            "again"
        )
    if one["read"] is None:
        raise InputError(
            f"record {one['name']} of {result} was made in memory, so that it cannot be read again; write it to a "
            "file, and run the command with that"
        )
    there = [path for path in _places(Path(one["read"]["path"]), result, files, folders) if path.is_file()]
    for path in there:
        if hashlib.sha256(path.read_bytes()).hexdigest() == one["sha256"]:
            return replace(read_again(one["read"], path, card.channels), name=one["name"])
    for path in there:  # written anew, with other columns or another format
        try:
            record = read_again(one["read"], path, card.channels)
        except InputError:
            continue
        if record.content == one["content"]:
            return replace(record, name=one["name"])
    option = "--fitted" if files else "--records" if folders else "--records (open) or --fitted (qualify)"
    named = [path for path in there if path not in files]
    if named:
        raise InputError(
            f"record {named[0]} has changed since {result} was made (its content differs); run the command again, or "
            f"give the unchanged record with {option}"
        )
    where = f"in {folders[0]}" if folders else "where it was, nor beside the result, nor here"
    raise InputError(f"record {Path(one['read']['path']).name} of {result} is not {where}; give it with {option}")


def _places(path: Path, result: Path, files: Sequence[Path], folders: Sequence[Path]) -> Iterator[Path]:
    """Where the file of a record may be."""
    yield from (segment_of(file).file for file in files)
    yield from (folder / path.name for folder in folders)
    for folder in (Path(), result.parent, result.parent.parent):
        yield from dict.fromkeys((folder / path, folder / path.name))
