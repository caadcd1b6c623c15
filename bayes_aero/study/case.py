"""One unit of a study: its inputs, whether its results are up to date, and how it is run, whole or not at all."""

from __future__ import annotations

import json
import shutil
import sys
import time
import traceback
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import bayes_aero
from bayes_aero.atomic_write import beside, put_folder, write_whole
from bayes_aero.errors import ERROR, InputError, no_space
from bayes_aero.flight.card import read_card
from bayes_aero.flight.card_tables import is_file
from bayes_aero.jobs.provenance import environment_id, provenance, sha256_of, write_json
from bayes_aero.progress import Progress
from bayes_aero.study.study import TASKS, Unit, card_of

SCHEMA = "bayes_aero/unit/1"
MANIFEST = "unit.json"
MIN_FREE_BYTES = 1 << 20  # of the disk, below which no unit starts
Task = Callable[[Unit, Path, Progress | None], None]


@dataclass(frozen=True)
class CaseState:
    """`word` is done, missing, changed, damaged or failed; `why` says what changed or failed."""

    word: str
    why: str = ""


def fingerprint(unit: Unit) -> dict[str, Any]:
    """Hashes of all inputs on which the unit's numbers depend, without the versions of libraries."""
    card = read_card(unit.card)
    return {
        "settings": unit.settings,
        "records": {shown: _sha256(Path(path)) for shown, path in zip(unit.shown, unit.records, strict=True)},
        "card": card.sha256,
        "effect_files": {path.name: _sha256(path) for path in card.effect_files},
        "bayes_aero": bayes_aero.__version__,
    }


def state_of(unit: Unit, folder: Path) -> CaseState:
    """Whether the unit's folder has its results, computed from the present inputs."""
    manifest = folder / MANIFEST
    if not manifest.is_file():
        return CaseState("missing")
    try:
        known = json.loads(manifest.read_text(encoding="utf-8"))
        files, made_from, state = dict(known["files"]), dict(known["made_from"]), str(known["state"])
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return CaseState("damaged", f"{MANIFEST} cannot be read")
    if state != "done":
        return CaseState("failed", str(known.get("error", "")))
    here = fingerprint(unit)
    changed = [key for key in here if here[key] != made_from.get(key)]
    if changed:
        words = []
        for key in changed:
            own, before = here[key], made_from.get(key)
            names: list[str] = []
            if isinstance(own, dict) and isinstance(before, dict):
                names = sorted(n for n in {*own, *before} if own.get(n) != before.get(n))
            words.append(f"{key} {', '.join(names)}".strip().replace("_", " "))
        return CaseState("changed", "; ".join(words))
    for name, sha256 in files.items():
        path = folder / name
        inside = ".." not in Path(name).parts and not Path(name).is_absolute()
        if not (inside and is_file(path)) or _sha256(path) != sha256:
            return CaseState("damaged", f"{name} is not what was written")
    return CaseState("done")


def run_unit(
    given: Mapping[str, Any], folder: str, *, task: Task | None = None, progress: Progress | None = None
) -> dict[str, Any]:
    """Run a unit (`Unit.as_json`) into `folder`, which appears when it is complete, with results or with error.txt.

    A pure function of its description and of the files that it names, so that another process can run it. Returns name,
    state, seconds and error. A disk that cannot be written to is an `InputError` and no failure of the unit.
    """

    def attempt(unit: Unit, out: Path) -> str:
        """Empty, or why the task failed: a sentence for bad input, a traceback for a defect in the unit's folder."""
        try:
            (task or run_task)(unit, out, progress)
        except Exception as reason:  # the study continues
            if no_space(reason):
                raise
            bad = isinstance(reason, InputError)
            write_whole(f"{reason}\n" if bad else traceback.format_exc(), out / ERROR)
            return str(reason) if bad else f"{type(reason).__name__}: {reason}"
        return ""

    found = _write_unit(Unit.of_json(given), Path(folder), attempt)
    if "jax" in sys.modules:
        from bayes_aero.processes import full_of_programs, give_back_memory

        if full_of_programs():  # units of many sizes compile many programs
            give_back_memory()
    return found


def fail_unit(given: Mapping[str, Any], folder: str, error: str) -> dict[str, Any]:
    """Record the failure of a unit that could not do so itself, as one that ended its process."""

    def written(_: Unit, out: Path) -> str:
        write_whole(f"{error}\n", out / ERROR)
        return error

    return _write_unit(Unit.of_json(given), Path(folder), written)


def _write_unit(unit: Unit, target: Path, attempt: Callable[[Unit, Path], str]) -> dict[str, Any]:
    began, partial = time.perf_counter(), beside(target)
    shutil.rmtree(partial, ignore_errors=True)
    try:
        partial.mkdir(parents=True)
        if shutil.disk_usage(partial).free < MIN_FREE_BYTES:
            raise InputError(_disk_full(target))
        made_from = fingerprint(unit)
        error = attempt(unit, partial)
        seconds = round(time.perf_counter() - began, 2)
        state = "failed" if error else "done"
        files = sorted(p for p in partial.rglob("*") if p.is_file())
        content = {
            "schema": SCHEMA,
            "state": state,
            "error": error,
            "name": unit.name,
            "made_from": made_from,
            "environment": environment_id(),
            "seconds": seconds,
            "files": {p.relative_to(partial).as_posix(): _sha256(p) for p in files},
        }
        write_json(content, partial / MANIFEST)  # last
        put_folder(partial, target)
    except Exception as reason:
        if no_space(reason):
            raise InputError(_disk_full(target)) from None
        if isinstance(reason, OSError):
            raise InputError(
                f"cannot write to {target.parent} ({reason.strerror}); mend that and give the same command again"
            ) from None
        raise
    finally:
        shutil.rmtree(partial, ignore_errors=True)
    return {"name": unit.name, "state": state, "seconds": seconds, "error": error}


def _disk_full(target: Path) -> str:
    return (
        f"the disk of {target.parent} is full; units that were done are kept: free some space and give the same "
        "command again"
    )


def run_task(unit: Unit, out: Path, progress: Progress | None = None) -> None:
    """Run the task of a unit; all its files are in `out`."""
    from bayes_aero.flight.reading import read_records
    from bayes_aero.jobs.diagnose import diagnose_records
    from bayes_aero.jobs.fly import fly
    from bayes_aero.jobs.identify import identify  # imported here, because a driver of a cluster needs none of these

    card = card_of(unit)
    options: dict[str, Any] = {**unit.options, "seed": unit.seed}
    reading = {"resample": options.pop("resample", None), "split": options.pop("split", False)}
    if "frequency" in options:
        options["frequency"] = tuple(map(float, options["frequency"]))
    records = read_records([Path(p) for p in unit.records], card.channels, segments=card.segments, **reading)
    settings = unit.settings | {"environment": environment_id()}
    write_json(provenance(card, records, unit.seed, settings), out / "provenance.json")
    if unit.task == "identify":
        options |= {"noise": unit.noise or "buffet-ar1", "split": unit.split or "random"}
    jobs: dict[str, Any] = {"identify": identify, "diagnose": diagnose_records, "fly": fly}
    jobs[unit.task](records, card, TASKS[unit.task](**options), out=out, progress=progress)


def _sha256(path: Path) -> str:
    try:
        return sha256_of(path)
    except OSError as reason:
        raise InputError(f"{path} cannot be read ({reason.strerror}); check the path and its permissions") from None
