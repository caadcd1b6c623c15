"""Where results lie and numbers come from: the folder, JSON, and versions, inputs' hashes, seed, command, platform."""

from __future__ import annotations

import hashlib
import json
import os
import platform
import shlex
import sys
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from datetime import UTC, datetime
from functools import cache
from importlib import metadata
from pathlib import Path
from threading import RLock
from typing import Any, Generic, TypeVar

import msgspec

import bayes_aero
from bayes_aero.atomic_write import write_whole
from bayes_aero.errors import ERROR, InputError, attempted
from bayes_aero.flight.card import Card, shipped_cards
from bayes_aero.flight.record import FlightRecord, is_file

PACKAGES = (
    "arviz-base", "arviz-stats", "emcee", "equinox", "jax", "jaxlib", "numpy", "numpyro", "pandas", "pint", "scipy",
    "xarray",
)  # fmt: skip


def provenance(
    card: Card | None, records: Sequence[FlightRecord], seed: int | None, settings: dict[str, Any], options: Any = None
) -> dict[str, Any]:
    """All that is needed to make the run again, the only part of the results that names a time or a machine. The
    command is for people: what reads a result goes by inputs, card and `options` (a dataclass)."""
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
        "versions": {"python": platform.python_version(), "bayes-aero": bayes_aero.__version__}
        | {name: metadata.version(name) for name in PACKAGES},
        "platform": {"system": platform.platform(), "machine": platform.machine(), "cores": os.cpu_count()},
        "written": datetime.now(UTC).isoformat(timespec="seconds"),
    }


def sha256_of(path: Path) -> str:
    with path.open("rb") as handle:
        return hashlib.file_digest(handle, "sha256").hexdigest()


def write_json(content: Any, path: Path) -> None:
    """Write whole or not at all; a number that does not exist (NaN, infinity) becomes null."""
    write_whole(as_json(content), path)


def as_json(content: Any) -> str:
    return json.dumps(plain(content), indent=2, allow_nan=False) + "\n"


def plain(content: Any) -> Any:
    def simple(value: Any) -> Any:
        if isinstance(value, Mapping):
            return dict(value)
        return str(value) if isinstance(value, Path | str) else value.tolist()

    return json.loads(msgspec.json.encode(content, enc_hook=simple))


def picked(source: Any, *names: str) -> dict[str, Any]:
    """What `source` has under these names, as a part of a JSON document; a rename is written "key=name"."""
    rows = {key: getattr(source, name or key) for key, _, name in (name.partition("=") for name in names)}
    return {key: list(value) if isinstance(value, tuple) else value for key, value in rows.items()}


# --- A result that grows, and its files with it.

Result = TypeVar("Result")


class Growing(Generic[Result]):
    """A result with `notes` and `failures`, written into `out` whenever there is more of it, from any thread."""

    result: Result

    def __init__(self, card: Card, records: Sequence[FlightRecord], out: Path | None, source: dict[str, Any]) -> None:
        self.card, self.records, self.out, self.source, self.lock = card, records, out, source, RLock()

    def write(self, out: Path) -> None:
        raise NotImplementedError

    def keep(self, notes: Sequence[str] = (), failures: Sequence[str] = (), **changes: Any) -> None:
        with self.lock:
            before: Any = self.result
            more = {"notes": (*before.notes, *notes), "failures": (*before.failures, *failures)}
            self.result = replace(before, **changes, **more)
            if self.out is not None:
                self.write(self.out)

    def fail(self, failures: Sequence[str]) -> None:
        if failures:
            self.keep(failures=failures)

    def attempt(self, what: str, do: Callable[[], Any], otherwise: Any = None, *, bad: str = "") -> Any:
        """What `do` returns or, if it fails unexpectedly or by bad input with a form `bad` of a note, `otherwise`."""
        try:
            value, failed = attempted(what, do, otherwise, self.out, user_code=bool(self.card.effect_files))
        except InputError as error:
            if not bad:
                raise
            self.keep([bad.format(what, error)])
            return otherwise
        self.fail(failed)
        return value


# --- The exact environment of a run, so that it can be restored: every installed version, Python, platform.


@cache
def environment() -> dict[str, Any]:
    packages = {}
    for distribution in metadata.distributions():
        name = distribution.metadata["Name"]
        if name and name.lower().replace("_", "-") != "bayes-aero":
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
    return hashlib.sha256(json.dumps(environment(), sort_keys=True).encode()).hexdigest()[:8]


def write_environment(out: Path) -> None:
    """Write requirements.txt and environment.json into `out`/environment; another environment gets its own folder."""
    here, number = environment(), environment_id()
    folder = out / "environment"
    if (folder / "environment.json").is_file():
        with suppress(ValueError, KeyError, TypeError, RecursionError):
            if json.loads((folder / "environment.json").read_text(encoding="utf-8"))["id"] == number:
                return
        folder = out / f"environment-{number}"
    folder.mkdir(parents=True, exist_ok=True)
    lines = [
        f"# Python {here['python']} on {here['platform']}",
        "# Restore, in this folder: python -m venv env && env/bin/python -m pip install -r requirements.txt",
        *(f"{name}=={version}" for name, version in here["packages"].items()),
        f"# and bayes-aero {here['bayes_aero']['version']} (source_sha256 in environment.json)",
    ]
    write_whole("\n".join(lines) + "\n", folder / "requirements.txt")
    write_json(here | {"id": number}, folder / "environment.json")


# --- The folder of results, in which nothing leads elsewhere, and the file of a finished one; no numerical library.

RESERVED = {"con", "prn", "aux", "nul", *(f"{port}{number}" for port in ("com", "lpt") for number in range(10))}
"""Names that Windows keeps for devices, whatever follows their first full stop."""
FILES = {"results.json": "identify", "trajectories.json": "fly", "diagnosis.json": "diagnose"}
MOST_BYTES = 1 << 28


def writable(folder: Path) -> None:
    """Make the folder for results, which may be a link; refuse a link in it that leads out of it."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        root, leads_out = folder.resolve(), None
        for path in sorted(folder.iterdir()):
            if path.is_symlink() and not path.resolve().is_relative_to(root):
                leads_out = path
        if leads_out is None:
            (folder / ERROR).unlink(missing_ok=True)  # of an earlier run
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise InputError(f"cannot write to {folder} ({reason}); give another folder with --out") from None
    if leads_out is not None:
        raise InputError(f"{leads_out} is a link that leads out of {folder}; remove it, or give another --out")


def older_files(folder: Path, names: Sequence[str]) -> dict[Path, int]:
    """Files of an earlier run under these names, with the times at which they were written."""
    return {path: path.stat().st_mtime_ns for name in names if (path := folder / name).is_file()}


def remove_older(older: Mapping[Path, int]) -> None:
    """Take away the files of an earlier run that have not been written again."""
    for path, written in older.items():
        if path.is_file() and path.stat().st_mtime_ns == written:
            path.unlink()


def safe_name(words: str) -> str:
    """`words` as the beginning of a file's name on every system: no leading full stop or dash, no device of Windows."""
    words = words.lstrip(".-")
    return f"_{words}" if words.split(".")[0].split("-")[0].lower() in RESERVED else words


def result_file(given: str) -> Path | None:
    """The file of a result by its folder or its own path; None for a card."""
    path = Path(given)
    if given in shipped_cards() or path.suffix == ".toml":
        return None
    if is_file(path) and path.name.endswith(".json"):
        return path
    if not path.is_dir():
        raise InputError(f"there is no result {str(path)!r}: give a folder of identify, fly or diagnose, or a card")
    there = [path / name for name in FILES if is_file(path / name)]
    if len(there) != 1:
        names = " and ".join(p.name for p in there)
        which = f"it has {names}: name one of them" if there else f"it has none of {', '.join(FILES)}"
        raise InputError(f"folder {path} is not the result of one run of identify, fly or diagnose; {which}")
    return there[0]


def read_result(file: Path) -> Mapping[str, Any]:
    try:
        if file.stat().st_size > MOST_BYTES:
            raise ValueError(f"it has more than {MOST_BYTES} bytes")
        document = json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as reason:
        raise InputError(f"{file} cannot be read ({reason}); give the result of a finished run") from None
    kind = str(document.get("schema", "")).split("/")[:2] if isinstance(document, dict) else []
    if kind not in (["bayes_aero", name] for name in ("results", "trajectories", "diagnosis")):
        raise InputError(f"{file} is no result of identify, fly or diagnose; give the folder of one")
    return document
