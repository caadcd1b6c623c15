"""All units of a study as two tables, in CSV and Parquet: a row a unit, and a row a result."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from bayes_aero.atomic_write import write_whole
from bayes_aero.jobs.provenance import environment
from bayes_aero.report.html.page import put_page
from bayes_aero.report.pages.study import StudyContext, study_headline, study_page
from bayes_aero.study.case import MANIFEST
from bayes_aero.study.study import Study, Unit

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
