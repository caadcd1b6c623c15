"""Where numbers come from: versions, inputs' hashes, seed, command, platform."""

from __future__ import annotations

import hashlib
import json
import math
import os
import platform
import shlex
import sys
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from datetime import UTC, datetime
from enum import Enum
from importlib import metadata
from pathlib import Path
from typing import Any

from bayes_aero.atomic_write import write_whole
from bayes_aero.flight.card.card import Card
from bayes_aero.flight.record import FlightRecord

PACKAGES = (
    "bayes-aero",
    "arviz-base",
    "arviz-stats",
    "emcee",
    "equinox",
    "jax",
    "jaxlib",
    "numpy",
    "numpyro",
    "pandas",
    "pint",
    "scipy",
    "xarray",
)


def provenance(
    card: Card | None,
    records: Sequence[FlightRecord],
    seed: int | None,
    settings: dict[str, Any],
    options: Any = None,
) -> dict[str, Any]:
    """All that is needed to make the run again; the only part of the results that names a time or a machine.

    A card, records or a seed that the command did not need are absent. The command is for people: what reads a result
    goes by inputs, card and `options` (a dataclass).
    """
    files = () if card is None else card.effect_files
    return {
        "command": shlex.join([Path(sys.argv[0]).name, *sys.argv[1:]]),
        "settings": settings,
        **({} if seed is None else {"seed": seed}),
        **({} if options is None else {"options": asdict(options)}),
        "inputs": [
            {
                "name": r.name,
                "source": Path(r.source).name,
                "sha256": r.sha256,
                "content": r.content,
                "read": r.read or None,
            }
            for r in records
        ],
        **({} if card is None else {"card": {"name": card.name, "sha256": card.sha256, "path": card.path or None}}),
        "effect_files": [
            {"name": path.name, "sha256": hashlib.sha256(path.read_bytes()).hexdigest()} for path in files
        ],
        "versions": {"python": platform.python_version()} | {name: _version(name) for name in PACKAGES},
        "platform": {"system": platform.platform(), "machine": platform.machine(), "cores": os.cpu_count()},
        "written": datetime.now(UTC).isoformat(timespec="seconds"),
    }


def _version(name: str) -> str:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return "not installed"


def write_json(content: dict[str, Any], path: Path) -> None:
    """Write whole or not at all; a number that does not exist (NaN, infinity) becomes null."""
    write_whole(as_json(content), path)


def as_json(content: dict[str, Any]) -> str:
    """The text of a JSON document, with its last newline."""
    return json.dumps(_plain(content), indent=2, allow_nan=False) + "\n"


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, Enum):
        return value.value
    if hasattr(value, "tolist"):
        return _plain(value.tolist())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
