"""The file of a finished result: found and read without the numerical libraries."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from bayes_aero.errors import InputError
from bayes_aero.flight.card.card import shipped_cards
from bayes_aero.flight.card.toml_tables import is_file

FILES = {"results.json": "identify", "trajectories.json": "fly", "diagnosis.json": "diagnose"}
MOST_BYTES = 1 << 28


def result_file(given: str) -> Path | None:
    """The file of a result by its folder or its own path; None for a card."""
    path = Path(given)
    if given in shipped_cards() or path.suffix == ".toml":
        return None
    if is_file(path) and path.name.endswith(".json"):
        return path
    if not path.is_dir():
        raise InputError(
            f"there is no result {str(path)!r}: give a folder that identify, fly or diagnose wrote, one of its files "
            f"({', '.join(FILES)}), or a card"
        )
    there = [path / name for name in FILES if is_file(path / name)]
    if len(there) != 1:
        names = " and ".join(p.name for p in there)
        which = f"it has {names}: name one of them" if there else f"it has none of {', '.join(FILES)}"
        raise InputError(f"folder {path} is not the result of one run of identify, fly or diagnose; {which}")
    return there[0]


def read_result(file: Path) -> Mapping[str, Any]:
    """What a result of identify, fly or diagnose says."""
    try:
        if file.stat().st_size > MOST_BYTES:
            raise ValueError(f"it has more than {MOST_BYTES} bytes")
        told = json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as reason:
        raise InputError(f"{file} cannot be read ({reason}); give the result of a finished run") from None
    kind = str(told.get("schema", "")).split("/")[:2] if isinstance(told, dict) else []
    if kind not in (["bayes_aero", name] for name in ("results", "trajectories", "diagnosis")):
        raise InputError(f"{file} is no result of identify, fly or diagnose; give the folder of one")
    return told
