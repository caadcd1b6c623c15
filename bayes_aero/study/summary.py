"""All units of a study as two tables, in CSV and Parquet: a row a unit, and a row a result."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from itertools import chain
from pathlib import Path
from typing import Any

import pandas as pd

from bayes_aero.atomic_write import write_whole
from bayes_aero.jobs.provenance import environment
from bayes_aero.report.html.page import put_page
from bayes_aero.report.pages.study import StudyContext, study_headline, study_page
from bayes_aero.study.case import MANIFEST
from bayes_aero.study.study import Study, Unit

UNIT_COLUMNS = (
    "unit", "state", "task", "records", "card", "effects", "noise", "split", "seed", "seconds", "verdict", "doubts",
    "error",
)  # fmt: skip
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
        about = _axes(unit)
        state = manifest.get("state", "missing")
        rows.append(
            {
                "unit": unit.name,
                "state": state,
                "task": unit.task,
                **about,
                "seconds": manifest.get("seconds"),
                "verdict": _verdict(unit, found),
                "doubts": "; ".join(doubts_of(unit, folder)),
                "error": manifest.get("error", ""),
            }
        )
        if state == "done":
            results += [{"unit": unit.name, **about, **row} for row in _results(unit, found)]
    tables = (pd.DataFrame(rows, columns=list(UNIT_COLUMNS)), pd.DataFrame(results, columns=list(RESULT_COLUMNS)))
    for table, name in zip(tables, ("units", "summary"), strict=True):
        _write(table, out / f"{name}.csv")
        _write(table, out / f"{name}.parquet")
    return tables


def _axes(unit: Unit) -> dict[str, Any]:
    return {
        "records": " + ".join(unit.shown),
        "card": unit.card_name,
        "effects": " + ".join(unit.effects),
        "noise": unit.noise,
        "split": unit.split,
        "seed": unit.seed,
    }


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


def _verdict(unit: Unit, found: dict[str, Any]) -> str:
    if unit.task == "diagnose":
        return str(found.get("verdict", ""))
    return str((found if unit.task == "fly" else found.get("mle", {})).get("status", ""))


def _results(unit: Unit, found: dict[str, Any]) -> Iterator[dict[str, Any]]:
    if unit.task == "fly":
        return chain(
            _estimates(found, {"output_error": "crb", "output_error_corrected": "sd_corrected"}),
            _estimates(_filtered(found), {"process_noise": "sd"}),
        )
    return _causes(found) if unit.task == "diagnose" else _parameters(found)


def _estimates(found: dict[str, Any], methods: dict[str, str]) -> Iterator[dict[str, Any]]:
    """A row for each parameter and method, which is named after the deviation taken; bounds are symmetric."""
    for name, p in found.get("parameters", {}).items():
        for method, key in methods.items():
            value, sd = p["estimate"], p[key]
            known = sd is not None
            yield {
                "method": method,
                "parameter": name,
                "unit_of_value": p["unit"],
                "value": value,
                "sd": sd,
                "low95": value - 1.96 * sd if known else None,
                "high95": value + 1.96 * sd if known else None,
                "status": found.get("status"),
            }


def _filtered(found: dict[str, Any]) -> dict[str, Any]:
    """The estimates with process noise in the form of the others; nothing where they were not asked for."""
    filtered = found.get("process_noise") or {}
    units = {name: p["unit"] for name, p in found.get("parameters", {}).items()}
    rows = {n: {"unit": units[n], "estimate": x, "sd": sd} for n, (x, sd) in filtered.get("estimates", {}).items()}
    return {"parameters": rows, "status": filtered.get("status")}


def _parameters(found: dict[str, Any]) -> Iterator[dict[str, Any]]:
    """Maximum likelihood, then a row for each parameter and posterior."""
    mle = found.get("mle", {})
    yield from _estimates(mle, {"mle": "crb", "mle_corrected": "crb_corrected"})
    units = {name: p["unit"] for name, p in mle.get("parameters", {}).items()}
    posterior = found.get("posterior", {})
    for engine, status in posterior.get("status", {}).items():
        for name, m in posterior.get(engine, {}).items():
            yield {
                "method": engine,
                "parameter": name,
                "unit_of_value": units.get(name, "1"),
                "value": m["mean"],
                "sd": m["sd"],
                "low95": m["ci95"][0],
                "high95": m["ci95"][1],
                "status": status["status"],
            }


def _causes(found: dict[str, Any]) -> Iterator[dict[str, Any]]:
    """A row for each parameter of each named cause."""
    for cause in found.get("causes", []):
        for name, size in cause["parameters"].items():
            yield {
                "method": cause["stage"],
                "cause": cause["name"],
                "parameter": name,
                "unit_of_value": size["unit"],
                "value": size["mean"],
                "sd": size["sd"],
                "low95": size["ci95"][0],
                "high95": size["ci95"][1],
                "status": found.get("verdict"),
            }


def _write(table: pd.DataFrame, path: Path) -> None:
    if path.suffix == ".csv":
        content: str | bytes = table.to_csv(index=False, lineterminator="\n")
    else:
        text = [c for c in table.columns if c not in NUMBERS]
        content = table.astype(dict.fromkeys(text, "string")).to_parquet(index=False)
    write_whole(content, path, flush=True)


# --- report.html of a study, from the tables that its units have left.


def put_report(study: Study, out: Path) -> tuple[str, tuple[str, ...]]:
    """Write the page into the results folder; return its verdict, and sentences on parts that could not be made."""
    context = _context(study, out)
    return study_headline(context), put_page(lambda: study_page(context), out)


def _context(study: Study, out: Path) -> StudyContext:
    here = environment()
    facts = {
        "Study": f"{study.path.name}, SHA-256 {study.sha256}",
        "Python": f"{here['python']} on {here['platform']}",
        "bayes_aero": here["bayes_aero"]["version"],
        "Each unit": "provenance.json in its folder has its inputs, versions, seed and command",
        "To restore": "environment/requirements.txt has every version",
    }
    return StudyContext(study.title, study.task, _table(out, "units"), _table(out, "summary"), out, facts)


def _table(out: Path, name: str) -> pd.DataFrame:
    table = pd.read_parquet(out / f"{name}.parquet")
    text = [column for column in table.columns if column not in NUMBERS]
    return table.assign(**{column: table[column].astype(object).fillna("") for column in text})
