"""The job of `bayes-aero export`: an identified model in the form of another simulator, in a folder of its own."""

from __future__ import annotations

import csv
import io
import re
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from bayes_aero.atomic_write import beside, put_folder, write_whole
from bayes_aero.errors import InputError
from bayes_aero.export.fmu import write_fmu
from bayes_aero.export.identified import Identified, about, validity, version, wrapped
from bayes_aero.export.jsbsim import PROPERTIES, jsbsim_files
from bayes_aero.export.tables import write_tables
from bayes_aero.jobs.fitted import drawn, exported, read_identified
from bayes_aero.jobs.io.result_file import safe_name
from bayes_aero.jobs.provenance import picked, write_json

SCHEMA = "bayes_aero/export/1"
WIDTH = 100


def export(
    given: str, form: str, *, out: Path | None = None, card: str | None = None, draws: int = 0, seed: int = 0
) -> tuple[Path, dict[str, Any]]:
    """Write the model of a result, or of a card that states all values, as `form`, one of `FORMS`, with `draws`.

    `out`: the folder to make; default NAME_FORM in the working directory. `card`: that of the result, where it is not
    found by itself. Returns the folder, and what export.json says.
    """
    if form not in FORMS:
        raise InputError(f"there is no form {form!r} to export to; give one of {', '.join(FORMS)}")
    found, folder, told = read_identified(given, card)
    found = _renamed(found)
    if draws:
        found = replace(found, draws=drawn(found, folder, told, exported(found), draws, seed))
    target = out or Path(f"{found.name}_{form}")
    return target, write_export(found, form, target)


def write_export(found: Identified, form: str, target: Path) -> dict[str, Any]:
    """Write a model as `form` into the new folder `target`, and say what export.json says."""
    found = _renamed(found)
    if target.exists() or target.is_symlink():
        raise InputError(f"{target} exists; give another folder with --out")
    part = beside(target.absolute())
    try:
        part.mkdir(parents=True)
        facts = export_facts(found, form, FORMS[form](found, part))
        write_json(facts, part / "export.json")
        write_whole(wrapped((*about(found), *use_of(found, form)), WIDTH) + "\n", part / "README.txt")
        if found.draws is not None:
            text = io.StringIO(newline="")
            rows = ([repr(float(x)) for x in row] for row in found.draws.values)
            csv.writer(text).writerows([found.draws.names, *rows])
            write_whole(text.getvalue(), part / "draws.csv")
        put_folder(part, target.absolute())
    except OSError as reason:
        raise InputError(
            f"cannot write {target} ({reason.strerror or reason}); give another folder with --out"
        ) from None
    finally:
        shutil.rmtree(part, ignore_errors=True)
    return facts


def _renamed(found: Identified) -> Identified:
    """The model under a name that is one in XML and for every system's files."""
    name = re.sub(r"[^A-Za-z0-9_]", "_", found.name)
    return replace(found, name=safe_name(name if re.match(r"[A-Za-z_]", name) else f"_{name}"))


def write_jsbsim(found: Identified, folder: Path) -> tuple[str, ...]:
    """A root directory of JSBSim; the names of its files."""
    files = jsbsim_files(found)
    for name, text in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        write_whole(text, folder / name)
    return tuple(files)


FORMS: dict[str, Callable[[Identified, Path], tuple[str, ...]]] = {
    "jsbsim": write_jsbsim,
    "fmu": lambda found, folder: (write_fmu(found, folder).name,),
    "tables": write_tables,
}


def export_facts(found: Identified, form: str, files: tuple[str, ...]) -> dict[str, Any]:
    """What a program may want to know of the export."""
    read = found.program.inputs_of("parameter")
    return {
        "schema": SCHEMA,
        **picked(found, "name", "title"),
        "form": form,
        "version": version(),
        "files": list(files),
        "parameters": {
            p.name: {"value": found.values[p.name], "unit": p.unit} for p in found.exported.parameters if p.name in read
        },
        "inputs": list(found.program.inputs_of("signal")),
        "states": list(found.program.inputs_of("state")),
        "outputs": list(found.program.outputs),
        "flown": {name: list(found.flown[name]) for name in found.signals if name in found.flown},
        "sources": list(found.sources),
        "validity": list(validity(found)),
        "draws": None if found.draws is None else {"count": len(found.draws.values), "origin": found.draws.origin},
        "left_out": list(found.left_out),
    }


def use_of(found: Identified, form: str) -> tuple[str, ...]:
    """How the files of a form are used."""
    if form == "jsbsim":
        table = [f"{n}: {PROPERTIES[n][0]}" for n in found.program.inputs_of("signal") if n in PROPERTIES]
        return (
            f"This folder is a root directory of JSBSim with the aircraft {found.name}. For your own aircraft take the "
            "files of aerodynamics and of the system, put the system before the aerodynamics, and set AERORP to the "
            "aerodynamic reference point. The system declares what JSBSim does not have, bayes-aero/input/...",
            f"Read from JSBSim: {'; '.join(table)}.",
        )
    if form == "fmu":
        return ("FMI 2.0, co-simulation; it runs where Python runs. The time step solves the separation lag exactly.",)
    return (
        "A coefficient is the sum of its tables, each interpolated linearly; interpolation_error is the sum of the "
        "largest errors along the axes. X is an axis: take the incidence from its tables, the static X from "
        "X_static, and X through its lag where there is one.",
    )
