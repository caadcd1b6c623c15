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
    remedy: str,
    files: Sequence[Path] = (),
    folders: Sequence[Path] = (),
) -> list[FlightRecord]:
    """The records with which a result was made, in their order and read as they were.

    Args:
        provenance: of the result.
        result: its file.
        card: of the result.
        remedy: what to do where one is not found, e.g. "give it with --fitted".
        files: where they are looked for first, whatever their names.
        folders: the same by their names; then at the paths that the result states, from the working directory, the
            result's folder and the one above it.

    Raises:
        InputError: one is not found, or its samples differ.
    """
    found = []
    for one in provenance["inputs"]:
        _refuse_lost(one, result)
        there = [path for path in _places(Path(one["read"]["path"]), result, files, folders) if path.is_file()]
        record = _same(one, card, there)
        if record is None:
            changed = [path for path in there if path not in files]
            where = f"in {folders[0]}" if folders else "where it was, nor beside the result, nor here"
            raise InputError(
                f"record {changed[0]} has changed since {result} was made (its content differs); run the command "
                f"again, or {remedy} as it was"
                if changed
                else f"record {Path(one['read']['path']).name} of {result} is not {where}; {remedy}"
            )
        found.append(replace(record, name=one["name"]))
    return found


def _refuse_lost(one: Mapping[str, Any], result: Path) -> None:
    """Refuse a record that cannot be read again wherever it may be."""
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


def _same(one: Mapping[str, Any], card: Card, there: Sequence[Path]) -> FlightRecord | None:
    """The record from the first file that is unchanged; else from one with the same samples, as written anew."""
    for path in there:
        if hashlib.sha256(path.read_bytes()).hexdigest() == one["sha256"]:
            return read_again(one["read"], path, card.channels)
    for path in there:
        try:
            record = read_again(one["read"], path, card.channels)
        except InputError:
            continue
        if record.content == one["content"]:
            return record
    return None


def _places(path: Path, result: Path, files: Sequence[Path], folders: Sequence[Path]) -> Iterator[Path]:
    """Where the file of a record may be."""
    yield from (segment_of(file).file for file in files)
    yield from (folder / path.name for folder in folders)
    for folder in (Path(), result.parent, result.parent.parent):
        yield from dict.fromkeys((folder / path, folder / path.name))
