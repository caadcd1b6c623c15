"""Runs a study: its units one after the other, or by a cluster; a repeated run resumes it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bayes_aero.atomic_write import sweep, write_whole
from bayes_aero.errors import InputError
from bayes_aero.jobs.io.result_file import writable
from bayes_aero.jobs.provenance import write_environment
from bayes_aero.study.case import CaseState, run_unit, state_of
from bayes_aero.study.study import Study, Unit
from bayes_aero.study.summary import write_summary

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
