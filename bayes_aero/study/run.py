"""Units of a study: whether each is up to date, how it is run, whole or not at all, and what all have found."""

from __future__ import annotations

import json
import shutil
import sys
import time
import traceback
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd

import bayes_aero
from bayes_aero.atomic_write import beside, put_folder, sweep, write_whole
from bayes_aero.errors import ERROR, InputError, no_space
from bayes_aero.flight.card import read_card
from bayes_aero.flight.record import is_file
from bayes_aero.jobs.store import (
    environment,
    environment_id,
    provenance,
    sha256_of,
    writable,
    write_environment,
    write_json,
)
from bayes_aero.progress import Progress
from bayes_aero.report.page import put_page
from bayes_aero.report.pages.study import StudyContext, study_headline, study_page
from bayes_aero.study.study import TASKS, Study, Unit, card_of

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


# --- All units of a study as two tables, in CSV and Parquet: a row a unit, and a row a result.

RESULT_COLUMNS = (
    "unit", "records", "card", "effects", "noise", "split", "seed", "method", "cause", "parameter", "unit_of_value",
    "value", "sd", "low95", "high95", "status",
)  # fmt: skip
NUMBERS = ("seed", "seconds", "value", "sd", "low95", "high95")
RESULTS = {"identify": "results.json", "diagnose": "diagnosis.json", "fly": "trajectories.json"}
"""Where a task leaves its numbers."""


def write_summary(units: Sequence[Unit], folder: Path, out: Path) -> tuple[pd.DataFrame, pd.DataFrame]:
    """units.csv and results.csv with their Parquet twins in `out`; units that are not done have no results."""
    rows, results = [], []
    for unit in units:
        manifest = _json(folder / unit.name / MANIFEST)
        found = _json(folder / unit.name / RESULTS[unit.task])
        about = {
            "records": " + ".join(unit.shown),
            "card": unit.card_name,
            "effects": " + ".join(unit.effects),
            "noise": unit.noise,
            "split": unit.split,
            "seed": unit.seed,
        }
        state = manifest.get("state", "missing")
        status = found.get("mle", {}) if unit.task == "identify" else found
        verdict = status.get("verdict" if unit.task == "diagnose" else "status", "")
        rows.append(
            {
                "unit": unit.name,
                "state": state,
                "task": unit.task,
                **about,
                "seconds": manifest.get("seconds"),
                "verdict": str(verdict),
                "doubts": "; ".join(doubts_of(unit, folder)),
                "error": manifest.get("error", ""),
            }
        )
        if state == "done":
            results += [{"unit": unit.name, **about, **row} for row in ROWS[unit.task](found)]
    tables = (pd.DataFrame(rows), pd.DataFrame(results, columns=list(RESULT_COLUMNS)))
    for table, name in zip(tables, ("units", "summary"), strict=True):
        text = [c for c in table.columns if c not in NUMBERS]
        parquet = table.astype(dict.fromkeys(text, "string")).to_parquet(index=False)
        write_whole(table.to_csv(index=False, lineterminator="\n"), out / f"{name}.csv", flush=True)
        write_whole(parquet, out / f"{name}.parquet", flush=True)
    return tables


def _json(path: Path) -> dict[str, Any]:
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}


def doubts_of(unit: Unit, folder: Path) -> list[str]:
    """What the results of a unit in `folder` say against its records, a sentence each; nothing of sound ones."""
    found = _json(folder / unit.name / RESULTS[unit.task])
    said = [str(finding["sentence"]) for finding in found.get("health", ()) if finding["grave"]]
    outcome = str((found.get("consistency") or {}).get("outcome", ""))
    corrected = unit.task == "diagnose" and outcome == "disagree_explained"
    disagree = outcome.startswith("disagree") and not corrected
    return said + (["the sensors disagree along the flight path (see the unit's report)"] if disagree else [])


def row_of(method: str, parameter: str, unit: str, estimate: Sequence[Any], status: Any, **more: Any) -> dict[str, Any]:
    """A result: `estimate` is value, standard deviation and, where it is not symmetric, the interval of 95 %."""
    value, sd, *interval = estimate
    low, high = interval or ((None, None) if sd is None else (value - 1.96 * sd, value + 1.96 * sd))
    row = {"method": method, "parameter": parameter, "unit_of_value": unit, "value": value, "sd": sd}
    return row | {"low95": low, "high95": high, "status": status} | more


def rows_of_estimates(found: dict[str, Any], methods: dict[str, str]) -> Iterator[dict[str, Any]]:
    """A row for each parameter and method, which is named after the deviation taken."""
    for name, p in found.get("parameters", {}).items():
        for method, key in methods.items():
            yield row_of(method, name, p["unit"], (p["estimate"], p[key]), found.get("status"))


def rows_of_fly(found: dict[str, Any]) -> Iterator[dict[str, Any]]:
    """Output error, then the estimates with process noise where these were asked for."""
    yield from rows_of_estimates(found, {"output_error": "crb", "output_error_corrected": "sd_corrected"})
    filtered = found.get("process_noise") or {}
    for name, estimate in filtered.get("estimates", {}).items():
        unit = found["parameters"][name]["unit"]
        yield row_of("process_noise", name, unit, estimate, filtered.get("status"))


def rows_of_identify(found: dict[str, Any]) -> Iterator[dict[str, Any]]:
    """Maximum likelihood, then a row for each parameter and posterior."""
    mle, posterior = found.get("mle", {}), found.get("posterior", {})
    yield from rows_of_estimates(mle, {"mle": "crb", "mle_corrected": "crb_corrected"})
    units = {name: p["unit"] for name, p in mle.get("parameters", {}).items()}
    for engine, status in posterior.get("status", {}).items():
        for name, m in posterior.get(engine, {}).items():
            estimate = (m["mean"], m["sd"], *m["ci95"])
            yield row_of(engine, name, units.get(name, "1"), estimate, status["status"])


def rows_of_diagnose(found: dict[str, Any]) -> Iterator[dict[str, Any]]:
    """A row for each parameter of each named cause."""
    for cause in found.get("causes", []):
        for name, size in cause["parameters"].items():
            estimate = (size["mean"], size["sd"], *size["ci95"])
            yield row_of(cause["stage"], name, size["unit"], estimate, found.get("verdict"), cause=cause["name"])


ROWS = {"identify": rows_of_identify, "diagnose": rows_of_diagnose, "fly": rows_of_fly}


# --- report.html of a study, from the tables that its units have left.


def put_report(study: Study, out: Path) -> tuple[str, tuple[str, ...]]:
    """Write the page into the results folder; return its verdict, and sentences on parts that could not be made."""
    here = environment()
    facts = {
        "Study": f"{study.path.name}, SHA-256 {study.sha256}",
        "Python": f"{here['python']} on {here['platform']}",
        "bayes_aero": here["bayes_aero"]["version"],
        "Each unit": "provenance.json in its folder has its inputs, versions, seed and command",
        "To restore": "environment/requirements.txt has every version",
    }
    context = StudyContext(study.title, study.task, _table(out, "units"), _table(out, "summary"), out, facts)
    return study_headline(context), put_page(lambda: study_page(context), out)


def _table(out: Path, name: str) -> pd.DataFrame:
    table = pd.read_parquet(out / f"{name}.parquet")
    text = [column for column in table.columns if column not in NUMBERS]
    return table.assign(**{column: table[column].astype(object).fillna("") for column in text})


# --- Runs a study: its units one after the other, or by a cluster; a repeated run resumes it.

UNITS, COPY = "units", "study.toml"
Report = Callable[[int, int, Unit, str], None]
"""Called with the number of finished units, of all units, the running unit, and its stage."""


class StoppedError(Exception):
    """Why the rest of a study cannot run now, in one sentence; finished units are kept."""


UnitRunner = Callable[[Iterable[tuple[Mapping[str, Any], str]]], Iterator[Mapping[str, Any]]]
"""Takes (description, folder) of units and yields the results of `run_unit` in any order, as a cluster does."""


@dataclass(frozen=True)
class Planned:
    """A unit, its folder and its state."""

    unit: Unit
    folder: Path
    state: CaseState


def plan(study: Study, out: Path) -> list[Planned]:
    """Every unit with its state; nothing is written."""
    folders = [out / UNITS / unit.name for unit in study.units]
    return [Planned(u, f, state_of(u, f)) for u, f in zip(study.units, folders, strict=True)]


def leftovers(study: Study, out: Path) -> list[str]:
    """Folders of units that the study no longer has."""
    folder = out / UNITS
    names = {unit.name for unit in study.units}
    if not folder.is_dir():
        return []
    return sorted(p.name for p in folder.iterdir() if p.is_dir() and not p.name.startswith(".") and p.name not in names)


def run_study(
    study: Study,
    out: Path,
    planned: Sequence[Planned],
    *,
    report: Report | None = None,
    runner: UnitRunner | None = None,
) -> dict[str, Mapping[str, Any]]:
    """Run the units that are not done; return the result of each by name. The summary is written in any case."""
    prepare(study, out)
    due = [p for p in planned if p.state.word != "done"]
    said: dict[str, Mapping[str, Any]] = {}
    work = [(p.unit.as_json(), str(p.folder)) for p in due]

    def one_by_one() -> Iterator[Mapping[str, Any]]:
        for number, p in enumerate(due):

            def progress(text: str, _: float, number: int = number, unit: Unit = p.unit) -> None:
                if report:
                    report(number, len(due), unit, text)

            progress("reading", 0.0)
            yield run_unit(p.unit.as_json(), str(p.folder), progress=progress)

    try:
        for outcome in runner(work) if runner else one_by_one():
            said[str(outcome["name"])] = outcome
    except BaseException:
        with suppress(OSError):  # the reason why the study stopped is reported instead
            write_summary(study.units, out / UNITS, out)
        raise
    try:
        write_summary(study.units, out / UNITS, out)
    except OSError as error:
        raise InputError(
            f"the tables of {out} cannot be written ({error.strerror}), but all units are kept; mend that and give the "
            "same command again"
        ) from None
    return said


def prepare(study: Study, out: Path) -> None:
    """The results folder with the study's copy and the environment."""
    try:
        writable(out)
        writable(out / UNITS)
        sweep(out / UNITS)
        text = study.path.read_text(encoding="utf-8")
        copy = out / COPY
        if not copy.is_file() or copy.read_text(encoding="utf-8") != text:
            write_whole(text, copy)
        write_environment(out)
    except OSError as error:
        raise InputError(f"cannot write to {out} ({error.strerror}); give another folder with --out") from None
