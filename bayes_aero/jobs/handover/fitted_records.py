"""The records of a finished result, found again: a result names them by their hashes."""

from __future__ import annotations

import os
import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from bayes_aero.errors import InputError
from bayes_aero.flight.card.card import Card
from bayes_aero.flight.reading.read_record import read_records
from bayes_aero.flight.reading.segments import segment_of
from bayes_aero.flight.record import FlightRecord


def fitted_records(told: Mapping[str, Any], result: Path, card: Card, given: Sequence[Path]) -> list[FlightRecord]:
    """The records to which a model was fitted, in their order.

    Args:
        told: the result.
        result: its file.
        card: of the result.
        given: their files (FILE@FROM:TO for parts); none: those of the result's command.

    Raises:
        InputError: one of them is not found unchanged.
    """
    wanted = [(one["name"], one["sha256"]) for one in told["provenance"]["inputs"]]
    words = shlex.split(told["provenance"].get("command", ""))
    names = {segment_of(one["source"]).file.name for one in told["provenance"]["inputs"]}
    paths = list(given) or [p for word in words for p in _there(word, names, result)]
    read = read_records(paths, card.channels, **read_options(told, card)) if paths else []
    found = {(r.name, r.sha256): r for r in read}
    missing = [name for name, sha256 in wanted if (name, sha256) not in found]
    if missing:
        raise InputError(
            f"the record {missing[0]} to which the model of {result} was fitted is not found here unchanged; give all "
            "records of that run with --fitted, as that run had them"
        )
    return [found[one] for one in wanted]


def read_options(told: Mapping[str, Any], card: Card) -> dict[str, Any]:
    """How the command of a result read its records."""
    words = shlex.split(told["provenance"].get("command", ""))
    options: dict[str, Any] = {"split": "--split" in words, "segments": card.segments}
    if "--resample" in words[:-1]:
        options["resample"] = float(words[words.index("--resample") + 1])
    return options


def _there(word: str, names: set[str], result: Path) -> list[Path]:
    """A word of the command that is a record of these file names: from the working directory, or beside the result."""
    try:
        segment = segment_of(word)
    except (InputError, ValueError):
        return []
    if segment.file.name not in names:
        return []
    for folder in (Path(), result.parent, result.parent.parent):
        if (folder / segment.file).is_file():
            return [Path(os.path.join(folder, word))]
    return []
