"""The folder of results, in which nothing leads elsewhere, and the file of a finished one; no numerical library."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from bayes_aero.errors import ERROR, InputError
from bayes_aero.flight.card import shipped_cards
from bayes_aero.flight.card_tables import is_file

RESERVED = {"con", "prn", "aux", "nul", *(f"{port}{number}" for port in ("com", "lpt") for number in range(10))}
"""Names that Windows keeps for devices, whatever follows their first full stop."""


def writable(folder: Path) -> None:
    """Make the folder for results, or say why it cannot be; a link in it that leads out of it is refused.

    What is written would land there. The folder may be a link itself, for the user has named it.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        root = folder.resolve()
        for path in sorted(folder.iterdir()):
            if path.is_symlink() and not path.resolve().is_relative_to(root):
                raise InputError(f"{path} is a link that leads out of {folder}; remove it, or give another --out")
        (folder / ERROR).unlink(missing_ok=True)  # of an earlier run
    except (OSError, ValueError) as error:
        if isinstance(error, InputError):
            raise
        reason = getattr(error, "strerror", None) or error
        raise InputError(f"cannot write to {folder} ({reason}); give another folder with --out") from None


def safe_name(words: str) -> str:
    """`words` as the beginning of a file's name on every system: no leading full stop or dash, no device of Windows."""
    words = words.lstrip(".-")
    return f"_{words}" if words.split(".")[0].split("-")[0].lower() in RESERVED else words


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
