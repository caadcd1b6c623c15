"""Recompute a unit and compare it with what is on disk, number by number.

Figures and pages are held by the hashes of the manifest alone.
"""

from __future__ import annotations

import csv
import json
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from bayes_aero.study.case import MANIFEST, Task, run_unit, state_of
from bayes_aero.study.study import Unit

IGNORED_KEYS = ("provenance",)  # has times, machines and durations
EMPTY_STATES = ("missing", "failed")  # states of units without results
MAX_SHOWN = 5  # reported differences of one unit


def verify_unit(unit: Unit, folder: Path, *, task: Task | None = None) -> list[str]:
    """Differences between a finished unit and the same unit run again, one sentence each; none if it is reproduced."""
    state = state_of(unit, folder)
    if state.word in EMPTY_STATES:
        return [f"it is {state.word}, so there is nothing to compare; run the study first"]
    differences = [f"{state.word}: {state.why}"] if state.word != "done" else []
    with tempfile.TemporaryDirectory(prefix=".verify-", dir=folder.parent) as place:
        recomputed = Path(place) / folder.name
        outcome = run_unit(unit.as_json(), str(recomputed), task=task)
        if outcome["state"] != "done":
            return [*differences, f"done again, it fails: {outcome['error']}"]
        differences += list(_compared(folder, recomputed))
        shutil.rmtree(recomputed, ignore_errors=True)
    more = [f"and {len(differences) - MAX_SHOWN} more"] if len(differences) > MAX_SHOWN else []
    return differences[:MAX_SHOWN] + more


def _compared(disk: Path, recomputed: Path) -> Iterator[str]:
    kept, made = _files(disk), _files(recomputed)
    for name in sorted(made - kept):
        yield f"{name} is missing on disk"
    for name in sorted(kept & made - {MANIFEST, "provenance.json"}):
        if name.endswith(".json"):
            yield from _differences(name, _json(disk / name), _json(recomputed / name))
        elif name.endswith(".csv"):
            yield from _rows(name, disk / name, recomputed / name)
        elif name.endswith(".nc"):
            yield from _arrays(name, disk / name, recomputed / name)


def _files(root: Path) -> set[str]:
    return {p.relative_to(root).as_posix() for p in root.rglob("*") if p.is_file()}


def _json(path: Path) -> Any:
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return None
    return {k: v for k, v in content.items() if k not in IGNORED_KEYS} if isinstance(content, dict) else content


def _differences(where: str, disk: Any, recomputed: Any) -> Iterator[str]:
    if isinstance(disk, dict) and isinstance(recomputed, dict):
        for key in sorted({*disk, *recomputed}):
            place = f"{where}: {key}" if where.endswith(".json") else f"{where}.{key}"
            if key not in disk or key not in recomputed:
                yield f"{place} is {'not on disk' if key not in disk else 'only on disk'}"
            else:
                yield from _differences(place, disk[key], recomputed[key])
    elif isinstance(disk, list) and isinstance(recomputed, list) and len(disk) == len(recomputed):
        for index, (one, other) in enumerate(zip(disk, recomputed, strict=True)):
            yield from _differences(f"{where}[{index}]", one, other)
    elif disk != recomputed:
        yield f"{where} is {_short(disk)} on disk, {_short(recomputed)} recomputed"


def _rows(name: str, disk: Path, recomputed: Path) -> Iterator[str]:
    one, other = (_table(path) for path in (disk, recomputed))
    if len(one) != len(other):
        yield f"{name} has {len(one)} lines on disk, {len(other)} recomputed"
        return
    for number, (a, b) in enumerate(zip(one, other, strict=True), 1):
        for column, (x, y) in enumerate(zip(a, b, strict=False)):
            if x != y:
                heading = one[0][column] or f"column {column + 1}"
                yield f"{name}, line {number}, {heading} is {_short(x)} on disk, {_short(y)} recomputed"
        if len(a) != len(b):
            yield f"{name}, line {number} has {len(a)} cells on disk, {len(b)} recomputed"


def _arrays(name: str, disk: Path, recomputed: Path) -> Iterator[str]:
    """NetCDF: every variable of every group."""
    try:
        one = _variables(disk)
    except (OSError, ValueError, KeyError):
        yield f"{name} cannot be read on disk"
        return
    other = _variables(recomputed)
    for key in sorted({*one, *other}):
        if key not in one or key not in other:
            yield f"{name}: {key} is {'not on disk' if key not in one else 'only on disk'}"
            continue
        a, b = one[key], other[key]
        if a.shape != b.shape:
            yield f"{name}: {key} has shape {a.shape} on disk, {b.shape} recomputed"
            continue
        different = (a != b) & ((a == a) | (b == b))  # NaN on both sides is the same
        if different.any():
            first = tuple(int(i) for i in np.argwhere(different)[0])
            yield (
                f"{name}: {key} differs at {np.count_nonzero(different)} of {different.size} places, first at {first}: "
                f"{a[first]} on disk, {b[first]} recomputed"
            )


def _variables(path: Path) -> dict[str, np.ndarray]:
    with xr.open_datatree(path, engine="h5netcdf") as tree:
        return {
            f"{node.path}/{name}".lstrip("/"): np.asarray(variable.values)
            for node in tree.subtree
            for name, variable in node.to_dataset(inherit=False).variables.items()
        }


def _table(path: Path) -> list[list[str]]:
    with path.open(newline="", encoding="utf-8") as handle:
        return list(csv.reader(handle))


def _short(value: Any) -> str:
    text = json.dumps(value, ensure_ascii=False) if not isinstance(value, str) else value
    return text if len(text) <= 60 else text[:57] + "..."
