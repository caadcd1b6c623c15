"""Where numbers come from: versions, inputs' hashes, seed, command, platform."""

from __future__ import annotations

import hashlib
import json
import os
import platform
import shlex
import sys
from collections.abc import Mapping, Sequence
from contextlib import suppress
from datetime import UTC, datetime
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import Any

import msgspec

import bayes_aero
from bayes_aero.atomic_write import write_whole
from bayes_aero.flight.card import Card
from bayes_aero.flight.record import FlightRecord

PACKAGES = (
    "bayes-aero", "arviz-base", "arviz-stats", "emcee", "equinox", "jax", "jaxlib", "numpy", "numpyro", "pandas",
    "pint", "scipy", "xarray",
)  # fmt: skip


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
        **({} if options is None else {"options": dict(vars(options))}),
        "inputs": [
            {"name": r.name, "source": Path(r.source).name, **picked(r, "sha256", "content"), "read": r.read or None}
            for r in records
        ],
        **({} if card is None else {"card": {"name": card.name, "sha256": card.sha256, "path": card.path or None}}),
        "effect_files": [{"name": path.name, "sha256": sha256_of(path)} for path in files],
        "versions": {"python": platform.python_version()} | {name: version(name) for name in PACKAGES},
        "platform": {"system": platform.platform(), "machine": platform.machine(), "cores": os.cpu_count()},
        "written": datetime.now(UTC).isoformat(timespec="seconds"),
    }


def sha256_of(path: Path) -> str:
    """Of a file."""
    with path.open("rb") as handle:
        return hashlib.file_digest(handle, "sha256").hexdigest()


def version(name: str) -> str:
    """Of an installed package."""
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return "not installed"


def write_json(content: Any, path: Path) -> None:
    """Write whole or not at all; a number that does not exist (NaN, infinity) becomes null."""
    write_whole(as_json(content), path)


def as_json(content: Any) -> str:
    """The text of a JSON document, with its last newline."""
    return json.dumps(plain(content), indent=2, allow_nan=False) + "\n"


def plain(content: Any) -> Any:
    """A document as it is read: mappings, lists, numbers and text."""

    def simple(value: Any) -> Any:
        if isinstance(value, Mapping):
            return dict(value)
        return str(value) if isinstance(value, Path | str) else value.tolist()

    return json.loads(msgspec.json.encode(content, enc_hook=simple))


def picked(found: Any, *names: str) -> dict[str, Any]:
    """What `found` has under these names, as a part of a JSON document; a rename is written "key=name"."""
    rows = {key: getattr(found, name or key) for key, _, name in (name.partition("=") for name in names)}
    return {key: list(value) if isinstance(value, tuple) else value for key, value in rows.items()}


# --- The exact environment of a run, so that it can be restored: every installed version, Python, platform.

OWN = "bayes-aero"


@cache
def environment() -> dict[str, Any]:
    """Versions of everything installed, and the SHA-256 of this package's own source."""
    packages = {}
    for distribution in metadata.distributions():
        name = distribution.metadata["Name"]
        if name and name.lower().replace("_", "-") != OWN:
            packages[name] = distribution.version
    root, digest = Path(bayes_aero.__file__).parent, hashlib.sha256()
    for path in sorted(root.rglob("*.py")):
        digest.update(path.relative_to(root).as_posix().encode() + b"\0" + path.read_bytes())
    return {
        "python": platform.python_version(),
        "implementation": sys.implementation.name,
        "platform": platform.platform(),
        "machine": platform.machine(),
        "bayes_aero": {"version": bayes_aero.__version__, "source_sha256": digest.hexdigest()},
        "packages": dict(sorted(packages.items(), key=lambda item: item[0].lower())),
    }


def environment_id() -> str:
    """Eight digits that tell one environment from another."""
    return hashlib.sha256(json.dumps(environment(), sort_keys=True).encode()).hexdigest()[:8]


def write_environment(out: Path) -> Path:
    """Write requirements.txt and environment.json into `out`/environment, once; another environment gets its own.

    Returns the folder that describes the present environment.
    """
    folder, own = out / "environment", environment_id()
    if (folder / "environment.json").is_file():
        same = False
        with suppress(ValueError, KeyError, TypeError, RecursionError):
            same = json.loads((folder / "environment.json").read_text(encoding="utf-8"))["id"] == own
        folder = folder if same else out / f"environment-{own}"
    if not (folder / "environment.json").is_file():
        folder.mkdir(parents=True, exist_ok=True)
        here = environment()
        lines = [
            f"# Python {here['python']} on {here['platform']}",
            "# Restore, in this folder: python -m venv env && env/bin/python -m pip install -r requirements.txt",
            *(f"{name}=={version}" for name, version in here["packages"].items()),
            f"# and bayes-aero {here['bayes_aero']['version']} (source_sha256 in environment.json)",
        ]
        write_whole("\n".join(lines) + "\n", folder / "requirements.txt")
        write_json(here | {"id": own}, folder / "environment.json")
    return folder
