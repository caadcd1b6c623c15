"""The exact environment of a run, so that it can be restored: every installed version, Python, platform."""

from __future__ import annotations

import hashlib
import json
import platform
import sys
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import Any

import bayes_aero
from bayes_aero.atomic_write import write_whole
from bayes_aero.jobs.provenance.provenance import write_json

OWN = "bayes-aero"


@cache
def environment() -> dict[str, Any]:
    """Versions of everything installed, and the SHA-256 of this package's own source."""
    packages = {}
    for distribution in metadata.distributions():
        name = distribution.metadata["Name"]
        if name and name.lower().replace("_", "-") != OWN:
            packages[name] = distribution.version
    return {
        "python": platform.python_version(),
        "implementation": sys.implementation.name,
        "platform": platform.platform(),
        "machine": platform.machine(),
        "bayes_aero": {"version": bayes_aero.__version__, "source_sha256": _source()},
        "packages": dict(sorted(packages.items(), key=lambda item: item[0].lower())),
    }


def environment_id() -> str:
    """Eight digits that tell one environment from another."""
    return hashlib.sha256(json.dumps(environment(), sort_keys=True).encode()).hexdigest()[:8]


def write_environment(out: Path) -> Path:
    """Write requirements.txt and environment.json into `out`/environment, once; another environment gets its own.

    Returns the folder that describes the present environment.
    """
    first = out / "environment"
    known = first / "environment.json"
    own = environment_id()
    folder = first
    if known.is_file():
        try:
            same = json.loads(known.read_text(encoding="utf-8"))["id"] == own
        except (ValueError, KeyError, TypeError, RecursionError):
            same = False
        if not same:
            folder = out / f"environment-{own}"
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


def _source() -> str:
    root = Path(bayes_aero.__file__).parent
    digest = hashlib.sha256()
    for path in sorted(root.rglob("*.py")):
        digest.update(path.relative_to(root).as_posix().encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()
