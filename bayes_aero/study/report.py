"""report.html of a study, from the tables that its units have left."""

from __future__ import annotations

from pathlib import Path

import pandas as pd

from bayes_aero.jobs.provenance.environment import environment
from bayes_aero.report.html.page import put_page
from bayes_aero.report.pages.study import StudyContext, study_headline, study_page
from bayes_aero.study.study import Study
from bayes_aero.study.summary import NUMBERS


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
