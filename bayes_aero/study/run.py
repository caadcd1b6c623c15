"""A study: its file and units of work, whether each is up to date, how it is run, and what all have found."""

from __future__ import annotations

import errno
import hashlib
import itertools
import json
import math
import os
import re
import shutil
import sys
import time
import traceback
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from types import UnionType
from typing import Annotated, Any, Literal, get_args, get_origin

import msgspec

import bayes_aero
from bayes_aero.atomic_write import beside, put_folder, sweep, write_whole
from bayes_aero.errors import ERROR, InputError, no_space
from bayes_aero.flight.card import Card, known_keys, read_card, read_table, shipped_cards
from bayes_aero.flight.reading import READERS
from bayes_aero.flight.record import is_file, segment_of
from bayes_aero.jobs.options import (
    MAX_SEED,
    DiagnoseOptions,
    FlyOptions,
    IdentifyOptions,
    NoiseName,
    Options,
    ReadingOptions,
    SplitName,
)
from bayes_aero.jobs.store import (
    environment,
    environment_id,
    picked,
    provenance,
    safe_name,
    sha256_of,
    writable,
    write_environment,
    write_json,
)
from bayes_aero.model.model import Model
from bayes_aero.progress import Progress, quiet

TASKS: dict[str, type[Options]] = {"identify": IdentifyOptions, "diagnose": DiagnoseOptions, "fly": FlyOptions}
OPTIONS: dict[str, dict[str, Any]] = {
    task: {n: kind for of in (options, ReadingOptions) for n, kind in of.kinds().items() if n not in of.APART}
    for task, options in TASKS.items()
}
"""Kind of each option of a task; seeds, and of identify noise and split, are lists of the study instead."""
MAX_UNITS = 100_000
MAX_NAME_LENGTH = 90  # characters of a unit's name before its hash
Some = msgspec.Meta(min_length=1)


class StudyFile(msgspec.Struct):
    records: Annotated[tuple[str, ...], Some]
    title: str = ""
    task: Literal["identify", "diagnose", "fly"] = "identify"
    one_by_one: bool = False
    cards: Annotated[tuple[str, ...], Some] = ("attas",)
    seeds: Annotated[tuple[Annotated[int, msgspec.Meta(ge=0, le=MAX_SEED)], ...], Some] = (0,)
    splits: Annotated[tuple[SplitName, ...], Some] = ("random",)
    noise: Annotated[tuple[NoiseName, ...], Some] = ("buffet-ar1",)
    effects: Annotated[tuple[tuple[str, ...], ...], Some] = ((),)
    options: dict[str, Any] = {}


KEYS = StudyFile.__struct_fields__
SHAPES = {
    "records": 'a list of files, e.g. ["flights/*.csv"]', "title": "a text", "task": f"one of {', '.join(TASKS)}",
    "one_by_one": "true or false", "cards": 'a list of cards, e.g. ["attas"]',
    "seeds": f"a list of whole numbers from 0 to {MAX_SEED}, e.g. [0, 1]",
    "splits": f"a list of {', '.join(get_args(SplitName))}", "noise": f"a list of {', '.join(get_args(NoiseName))}",
    "effects": 'a list of lists of effects, e.g. [[], ["thrust_lag"]]', "options": "a section, [options]",
}  # fmt: skip
"""What each key must be."""
LISTS = ("records", "cards", "seeds", "splits", "noise", "effects")
WORDS = {bool: "write true or false", str: 'write names in quotes, e.g. "alpha,q"', float: "write a number"}


@dataclass(frozen=True)
class Unit:
    """One job as plain data, sent as JSON. Paths are absolute, and no part of its identity; `shown` are relative."""

    name: str
    task: str
    records: tuple[str, ...]
    shown: tuple[str, ...]
    card: str
    card_name: str
    seed: int
    split: str | None
    noise: str | None
    effects: tuple[str, ...]
    options: Mapping[str, Any] = field(default_factory=dict)

    def as_json(self) -> dict[str, Any]:
        return json.loads(json.dumps(asdict(self)))

    @classmethod
    def of_json(cls, given: Mapping[str, Any]) -> Unit:
        return cls(**{**given, **{key: tuple(given[key]) for key in ("records", "shown", "effects")}})

    @property
    def settings(self) -> dict[str, Any]:
        """Settings of the unit, without the paths of a machine."""
        every = {key: value for key, value in self.as_json().items() if key not in ("name", "shown", "card_name")}
        every |= {"records": list(self.shown), "card": self.card_name}
        return {key: value for key, value in every.items() if value is not None}


@dataclass(frozen=True)
class Study:
    path: Path
    sha256: str
    title: str
    task: str
    units: tuple[Unit, ...]


def read_study(path: Path, *, trust_effects: bool = False) -> Study:
    """Read and check a study; a card with effect files is refused unless `trust_effects`, for they are code."""
    raw, table = read_table(path, "study")
    where, folder = f"study {path}", path.parent
    known_keys(table, KEYS, "key", f"{where}: ")
    try:
        study = msgspec.convert(table, StudyFile)
    except msgspec.ValidationError as reason:
        key = next((key for key in KEYS if f"$.{key}" in str(reason) or f"`{key}`" in str(reason)), None)
        if key is None:
            raise InputError(f"{where}: {reason}") from None
        given = f" and not {table[key]!r}" if key in table else ""
        raise InputError(f"{where}: {key} must be {SHAPES[key]}{given}") from None
    for key in LISTS:
        most, count = Counter(map(repr, getattr(study, key))).most_common(1)[0]
        if count > 1:
            raise InputError(f"{where}: {key} lists {most} twice")
        if study.task != "identify" and key in table and key in ("splits", "noise"):
            raise InputError(f"{where}: {key} is of no use to the task {study.task}; take it out")
    options = checked_options(study.options, study.task, where)
    cards = study_cards(study.cards, folder, where, trust_effects)
    check_variants(study.effects, cards, study.task, where)
    axes: list[Sequence[Any]] = [
        record_sets(study, folder, where),
        list(cards),
        study.effects,
        *((study.noise, study.splits) if study.task == "identify" else ([None], [None])),
        study.seeds,
    ]
    count = math.prod(map(len, axes))
    if count > MAX_UNITS:
        raise InputError(f"{where}: it makes {count} units, more than {MAX_UNITS}; split it into several studies")
    units = tuple(unit_of(study.task, folder, options, choice) for choice in itertools.product(*axes))
    return Study(path, hashlib.sha256(raw).hexdigest(), study.title or path.stem, study.task, units)


def card_of(unit: Unit) -> Card:
    card = read_card(unit.card)
    return replace(card, effects=(*card.effects, *unit.effects)) if unit.effects else card


def unit_of(task: str, folder: Path, options: Mapping[str, Any], choice: Any) -> Unit:
    records, card, effects, noise, split, seed = choice
    shown = tuple(Path(os.path.relpath(path, folder)).as_posix() for path in records)
    unit = Unit("", task, tuple(map(str, records)), shown, card[1], card[0], seed, split, noise, effects, dict(options))
    more = f"+{len(records) - 1}" if len(records) > 1 else ""
    parts = [segment_of(records[0]).label + more, Path(card[0]).stem, *effects, noise, split, f"seed{seed}"]
    words = "-".join(re.sub(r"[^A-Za-z0-9+_.]", "_", part) for part in parts if part)
    identity = hashlib.sha256(json.dumps(unit.settings, sort_keys=True).encode()).hexdigest()[:8]
    return replace(unit, name=f"{safe_name(words[:MAX_NAME_LENGTH])}-{identity}")


def record_sets(study: StudyFile, folder: Path, where: str) -> list[tuple[Path, ...]]:
    sets: list[tuple[Path, ...]] = []
    for pattern in study.records:
        if any(c in pattern for c in "*?["):
            start = Path(pattern).anchor
            try:
                relative = str(Path(pattern).relative_to(start)) if start else pattern
                there = (Path(start) if start else folder).glob(relative)
                files = sorted(p.resolve() for p in there if p.is_file() and p.suffix.lower() in READERS)
            except (ValueError, OSError) as reason:
                raise InputError(f"{where}: records {pattern!r} is no pattern of files ({reason})") from None
            if not files:
                ends = f"records end in {', '.join(READERS)}"
                raise InputError(f"{where}: no record matches {pattern!r} in {folder.resolve()}; {ends}")
        else:
            file = segment_of(folder / pattern).file
            if not is_file(file):
                raise InputError(f"{where}: record {pattern!r} does not exist in {folder.resolve()}; give its path")
            files = [Path(str(file.resolve()) + str(folder / pattern).removeprefix(str(file)))]
        sets += [(path,) for path in files] if study.one_by_one else [tuple(files)]
    return list(dict.fromkeys(sets))


def study_cards(names: Sequence[str], folder: Path, where: str, trust_effects: bool) -> dict[tuple[str, str], Card]:
    """Cards by (name as given, absolute path), read once so that a bad one stops the study before it starts."""
    cards = {}
    for name in names:
        path: Path = shipped_cards().get(name) or folder / name
        if not is_file(path):
            shipped = ", ".join(shipped_cards())
            raise InputError(f"{where}: card {name!r} does not exist; give a .toml file beside the study, or {shipped}")
        card = read_card(path.resolve())
        if card.effect_files and not trust_effects:
            files = ", ".join(str(file) for file in card.effect_files)
            raise InputError(f"{where}: card {name!r} runs effect files ({files}); read them, then --trust-effects")
        cards[name, str(path.resolve())] = card
    return cards


def check_variants(given: Sequence[Sequence[str]], cards: Mapping[Any, Card], task: str, where: str) -> None:
    """Effects added to the cards' models: each variant must make a model with each card, or fly its linear system."""
    for names in given:
        for card in cards.values():
            try:
                if task == "fly" and card.linear is not None and not names:
                    from bayes_aero.dynamics.flight import linear_dynamics

                    linear_dynamics(card)
                else:
                    Model.from_card(replace(card, effects=(*card.effects, *names)))
            except InputError as reason:
                raise InputError(f"{where}: effects {list(names)} with card {card.name}: {reason}") from None


def checked_options(given: dict[str, Any], task: str, where: str) -> dict[str, Any]:
    """The section [options], each of the kind that the task's options have."""
    known_keys(given, OPTIONS[task], f"option of the task {task}", f"{where}: ")
    for key, value in given.items():
        kind = OPTIONS[task][key]
        kind = get_args(kind)[0] if get_origin(kind) is UnionType else kind  # what may be left out is optional
        bad = "it must be positive" if type(value) in (int, float) and not value > 0 else ""
        try:
            msgspec.convert(value, kind)
        except msgspec.ValidationError:
            bad = WORDS.get(kind, "write a whole number")
            bad = "write two frequencies in Hz, e.g. [0.1, 1.5]" if get_origin(kind) is tuple else bad
            bad = f"use one of {', '.join(get_args(kind))}" if get_origin(kind) is Literal else bad
        if bad:
            raise InputError(f"{where}: option {key} is {value!r}; {bad}")
    return given


# --- Whether a unit is up to date, and how it is run.

MANIFEST = "unit.json"
MIN_FREE_BYTES = 1 << 20  # of the disk, below which no unit starts
Task = Callable[[Unit, Path, Progress], None]


@dataclass(frozen=True)
class CaseState:
    """`state` is done, missing, changed, damaged or failed; `why` says what changed or failed."""

    state: str
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
        stored = json.loads(manifest.read_text(encoding="utf-8"))
        files, made_from, state = dict(stored["files"]), dict(stored["made_from"]), str(stored["state"])
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return CaseState("damaged", f"{MANIFEST} cannot be read")
    if state != "done":
        return CaseState("failed", str(stored.get("error", "")))
    words = []
    for key, now in fingerprint(unit).items():
        if now != (before := made_from.get(key)):
            names: list[str] = []
            if isinstance(now, dict) and isinstance(before, dict):
                names = sorted(n for n in {*now, *before} if now.get(n) != before.get(n))
            words.append(f"{key} {', '.join(names)}".strip().replace("_", " "))
    if words:
        return CaseState("changed", "; ".join(words))
    for name, sha256 in files.items():
        path = folder / name
        inside = ".." not in Path(name).parts and not Path(name).is_absolute()
        if not (inside and is_file(path)) or _sha256(path) != sha256:
            return CaseState("damaged", f"{name} is not what was written")
    return CaseState("done")


def run_unit(
    given: Mapping[str, Any], folder: str, *, task: Task | None = None, progress: Progress = quiet, failed: str = ""
) -> dict[str, Any]:
    """Run a unit (`Unit.as_json`) into `folder`, which appears when it is complete, with results or with error.txt.
    Returns name, state, seconds and error. `failed`: why it could not be run, which is then recorded."""
    unit, target = Unit.of_json(given), Path(folder)
    began, partial, error = time.perf_counter(), beside(target), failed
    shutil.rmtree(partial, ignore_errors=True)
    try:
        partial.mkdir(parents=True)
        if shutil.disk_usage(partial).free < MIN_FREE_BYTES:
            raise OSError(errno.ENOSPC, "")
        made_from = fingerprint(unit)
        if failed:
            write_whole(f"{failed}\n", partial / ERROR)
        else:
            error = _attempted(task or run_task, unit, partial, progress)
        seconds, state = round(time.perf_counter() - began, 2), "failed" if error else "done"
        files = sorted(p for p in partial.rglob("*") if p.is_file())
        content = {
            "schema": "bayes_aero/unit/1",
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
        again = "and give the same command again"
        if no_space(reason):
            kept = "units that were done are kept: free some space"
            raise InputError(f"the disk of {target.parent} is full; {kept} {again}") from None
        if isinstance(reason, OSError):
            raise InputError(f"cannot write to {target.parent} ({reason.strerror}); mend that {again}") from None
        raise
    finally:
        shutil.rmtree(partial, ignore_errors=True)
    if "jax" in sys.modules:
        from bayes_aero.processes import full_of_programs, give_back_memory

        if full_of_programs():  # units of many sizes compile many programs
            give_back_memory()
    return {"name": unit.name, "state": state, "seconds": seconds, "error": error}


def _attempted(task: Task, unit: Unit, out: Path, progress: Progress) -> str:
    """Empty, or why the task failed: a sentence for bad input, a traceback for a defect in the unit's folder."""
    try:
        task(unit, out, progress)
    except Exception as reason:  # the study continues
        if no_space(reason):
            raise
        bad = isinstance(reason, InputError)
        write_whole(f"{reason}\n" if bad else traceback.format_exc(), out / ERROR)
        return str(reason) if bad else f"{type(reason).__name__}: {reason}"
    return ""


def run_task(unit: Unit, out: Path, progress: Progress = quiet) -> None:
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


def write_summary(units: Sequence[Unit], folder: Path, out: Path) -> None:
    """units.csv and results.csv with their Parquet twins in `out`; units that are not done have no results."""
    import pandas as pd  # heavy, and a mistake in a study is reported before

    rows, results = [], []
    for unit in units:
        manifest = _json(folder / unit.name / MANIFEST)
        document = _json(folder / unit.name / RESULTS[unit.task])
        about = {"records": " + ".join(unit.shown), "card": unit.card_name, "effects": " + ".join(unit.effects)}
        about |= picked(unit, "noise", "split", "seed")
        state = manifest.get("state", "missing")
        status = document.get("mle", {}) if unit.task == "identify" else document
        verdict = status.get("verdict" if unit.task == "diagnose" else "status", "")
        facts = {"unit": unit.name, "state": state, "task": unit.task, **about, "seconds": manifest.get("seconds")}
        facts |= {"verdict": str(verdict), "doubts": "; ".join(doubts_of(unit, folder))}
        rows.append(facts | {"error": manifest.get("error", "")})
        if state == "done":
            results += [{"unit": unit.name, **about, **row} for row in result_rows(unit.task, document)]
    tables = (pd.DataFrame(rows), pd.DataFrame(results, columns=list(RESULT_COLUMNS)))
    for table, name in zip(tables, ("units", "summary"), strict=True):
        text = [c for c in table.columns if c not in NUMBERS]
        parquet = table.astype(dict.fromkeys(text, "string")).to_parquet(index=False)
        write_whole(table.to_csv(index=False, lineterminator="\n"), out / f"{name}.csv", flush=True)
        write_whole(parquet, out / f"{name}.parquet", flush=True)


def _json(path: Path) -> dict[str, Any]:
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}


def doubts_of(unit: Unit, folder: Path) -> list[str]:
    """What the results of a unit in `folder` say against its records, a sentence each; nothing of sound ones."""
    document = _json(folder / unit.name / RESULTS[unit.task])
    sentences = [str(finding["sentence"]) for finding in document.get("health", ()) if finding["grave"]]
    outcome = str((document.get("consistency") or {}).get("outcome", ""))
    corrected = unit.task == "diagnose" and outcome == "disagree_explained"
    disagree = outcome.startswith("disagree") and not corrected
    return sentences + (["the sensors disagree along the flight path (see the unit's report)"] if disagree else [])


def result_rows(task: str, document: dict[str, Any]) -> Iterator[dict[str, Any]]:
    """A row for each parameter and method: fits, the deviation taken in their names, posteriors, causes."""

    def row(method: str, parameter: str, unit: str, estimate: Any, status: Any, **more: Any) -> dict[str, Any]:
        value, sd, *interval = estimate  # and where it is not symmetric, the interval of 95 %
        low, high = interval or ((None, None) if sd is None else (value - 1.96 * sd, value + 1.96 * sd))
        about = {"method": method, "parameter": parameter, "unit_of_value": unit, "value": value, "sd": sd}
        return about | {"low95": low, "high95": high, "status": status} | more

    for cause in document.get("causes", []):
        for name, size in cause["parameters"].items():
            estimate = (size["mean"], size["sd"], *size["ci95"])
            yield row(cause["stage"], name, size["unit"], estimate, document.get("verdict"), cause=cause["name"])
    fit = document.get("mle", {}) if task == "identify" else document
    fitted, methods = fit.get("parameters", {}), {"output_error": "crb", "output_error_corrected": "sd_corrected"}
    methods = {"mle": "crb", "mle_corrected": "crb_corrected"} if task == "identify" else methods
    for name, p in fitted.items():
        for method, key in methods.items():
            yield row(method, name, p["unit"], (p["estimate"], p[key]), fit.get("status"))
    filtered = document.get("process_noise") or {}
    for name, estimate in filtered.get("estimates", {}).items():
        yield row("process_noise", name, fitted[name]["unit"], estimate, filtered.get("status"))
    posterior = document.get("posterior", {}) if task == "identify" else {}
    for engine, status in posterior.get("status", {}).items():
        for name, m in posterior.get(engine, {}).items():
            unit = fitted[name]["unit"] if name in fitted else "1"
            yield row(engine, name, unit, (m["mean"], m["sd"], *m["ci95"]), status["status"])


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
    from bayes_aero.report.page import put_page  # these are heavy
    from bayes_aero.report.pages.study import StudyContext, study_headline, study_page

    context = StudyContext(study.title, study.task, _table(out, "units"), _table(out, "summary"), out, facts)
    return study_headline(context), put_page(lambda: study_page(context), out)


def _table(out: Path, name: str) -> Any:
    import pandas as pd

    return pd.read_csv(out / f"{name}.csv", keep_default_na=False, na_values={key: [""] for key in NUMBERS})


# --- Runs a study: its units one after the other, or by a cluster; a repeated run resumes it.

UNITS, COPY = "units", "study.toml"
Report = Callable[[int, int, Unit, str], None]
"""Called with the number of finished units, of all units, the running unit, and its stage."""
UnitRunner = Callable[[Iterable[tuple[Mapping[str, Any], str]]], Iterator[Mapping[str, Any]]]
"""Takes (description, folder) of units and yields the results of `run_unit` in any order, as a cluster does."""


class StoppedError(Exception):
    """Why the rest of a study cannot run now, in one sentence; finished units are kept."""


@dataclass(frozen=True)
class Planned:
    unit: Unit
    folder: Path
    state: CaseState


def plan(study: Study, out: Path) -> list[Planned]:
    folders = [out / UNITS / unit.name for unit in study.units]
    return [Planned(u, f, state_of(u, f)) for u, f in zip(study.units, folders, strict=True)]


def run_study(
    study: Study,
    out: Path,
    planned: Sequence[Planned],
    *,
    report: Report | None = None,
    runner: UnitRunner | None = None,
) -> dict[str, Mapping[str, Any]]:
    """Run the units that are not done; return the result of each by name. The summary is written in any case."""
    try:  # the results folder has the study's copy and the environment
        writable(out)
        writable(out / UNITS)
        sweep(out / UNITS)
        write_whole(study.path.read_text(encoding="utf-8"), out / COPY)
        write_environment(out)
    except OSError as error:
        raise InputError(f"cannot write to {out} ({error.strerror}); give another folder with --out") from None
    due = [p for p in planned if p.state.state != "done"]
    outcomes: dict[str, Mapping[str, Any]] = {}

    def one_by_one(work: Iterable[tuple[Mapping[str, Any], str]]) -> Iterator[Mapping[str, Any]]:
        for number, (given, folder) in enumerate(work):

            def progress(text: str, _: float, number: int = number) -> None:
                if report:
                    report(number, len(due), due[number].unit, text)

            progress("reading", 0.0)
            yield run_unit(given, folder, progress=progress)

    try:
        for outcome in (runner or one_by_one)([(p.unit.as_json(), str(p.folder)) for p in due]):
            outcomes[str(outcome["name"])] = outcome
    except BaseException:
        with suppress(OSError):  # the reason why the study stopped is reported instead
            write_summary(study.units, out / UNITS, out)
        raise
    try:
        write_summary(study.units, out / UNITS, out)
    except OSError as error:
        why = f"cannot be written ({error.strerror})"
        raise InputError(f"the tables of {out} {why}, but all units are kept; mend that and run it again") from None
    return outcomes
