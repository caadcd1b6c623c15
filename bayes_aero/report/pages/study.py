"""The report of a study: the state of its units and their joint results."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple
from urllib.parse import quote

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from bayes_aero.report.page import Block, Facts, Report, picture, section
from bayes_aero.report.phrases import bracket, for_people, plain_unit, sentence, several
from bayes_aero.report.plots import COLOURS
from bayes_aero.report.style import NotDrawn, grid_of, housed, needed, save
from bayes_aero.report.table import columns_of, table

MOST_UNITS, MOST_ROWS = 200, 300  # of a table on the page; the files have all
MIN_RATIO = 1.5  # scatter between units over their standard errors from which it is reported


@dataclass(frozen=True)
class StudyContext:
    """A study's title, task, tables (columns as in units.csv and summary.csv), folder, and facts for the provenance."""

    title: str
    task: str
    units: pd.DataFrame
    results: pd.DataFrame
    folder: Path
    facts: Mapping[str, str]

    @property
    def counted(self) -> tuple[Counter[str], Counter[str], int]:
        """Units by verdict, units by the causes that they name, and how many are done."""
        done = self.units[self.units["state"] == "done"]
        pairs = set(zip(self.results["cause"], self.results["unit"], strict=True))
        verdicts = Counter(v.replace("_", " ") for v in done["verdict"] if v)
        return verdicts, Counter(cause for cause, _ in sorted(pairs) if cause), len(done)


def study_page(context: StudyContext) -> Report:
    estimated = estimates(context.units, context.results)
    return Report(
        title=f"Study: {context.title}",
        subtitle=f"{len(context.units)} units, each a run of {context.task}",
        verdict=study_headline(context),
        lead=[_lead(estimated, context.folder)],
        sections=[
            section("findings", "Findings over all units", lambda: _findings(context, estimated)),
            section("across", "Scatter and intervals", lambda: _across(estimated)),
            section("units", "The units", lambda: _units(context.units, context.folder)),
            section("provenance", "Provenance", lambda: Facts(tuple(context.facts.items()))),
        ],
    )


def study_headline(context: StudyContext) -> str:
    """State, verdicts, the commonest cause, and the parameter that scatters farthest beyond its intervals."""
    states = Counter(context.units["state"])
    total, ended = len(context.units), states.pop("done", 0)
    parts = [f"All {total} units are done" if total > 1 else "The unit is done"]
    if ended != total:
        others = several(f"{n} {state}" for state, n in states.items())
        parts = [f"{ended} of {total} units are done ({others})"]
    verdicts, causes, done = context.counted
    if verdicts:
        every = len(verdicts) == 1 and done > 1
        parts.append(several(f"{'all' if every else n} {verdict}" for verdict, n in verdicts.most_common()))
    parts += [f"{cause} is named in {n} of {done}" for cause, n in causes.most_common(1)]
    if beyond := _beyond(estimates(context.units, context.results)):
        worst = max(beyond, key=lambda e: e.scatter / e.claimed)
        parts.append(f"{worst.label} differs between units by {worst.scatter / worst.claimed:.1f} times its intervals")
    return f"{'; '.join(parts)}."


def _beyond(estimated: list[AcrossUnits]) -> list[AcrossUnits]:
    """Estimates that scatter between units beyond their intervals, by their most trusted method."""
    return [group[0] for _, group in panels_of(estimated) if group and group[0].scatter > MIN_RATIO * group[0].claimed]


def _findings(context: StudyContext, estimated: list[AcrossUnits]) -> list[str]:
    _, causes, done = context.counted
    listed = several(f"{cause} {n}" for cause, n in causes.most_common())
    texts = [f"Causes, in how many units of {done}: {listed}."] if causes else []
    doubtful = context.units[context.units["doubts"] != ""]
    if len(doubtful):
        listed = "; ".join(f"{name}: {why}" for name, why in zip(doubtful["unit"], doubtful["doubts"], strict=True))
        texts.append(f"Records are in doubt in {len(doubtful)} of {done} units: {listed}.")
    if beyond := [f"{e.label} ({e.scatter / e.claimed:.1f} times)" for e in _beyond(estimated)]:
        texts.append(sentence("units_differ", estimates=beyond))
    return texts


def _lead(estimated: list[AcrossUnits], folder: Path) -> tuple[Block, ...]:
    path = folder / "across.png"
    try:
        save(across(estimated), path)
    except NotDrawn:
        return ()
    about = f"Every unit's estimate, by its number in the table below; {MOST_PANELS} parameters at most."
    return (picture(path, about),)


def _across(estimated: list[AcrossUnits]) -> tuple[Any, ...]:
    if not estimated:
        return ()
    column = columns_of(estimated[:MOST_ROWS])
    columns = [
        column(lambda e: e.label, page="parameter"),
        column(lambda e: e.method, page="method", words=True),
        column(lambda e: len(e.rows), page="units"),
        column(lambda e: float(e.rows["value"].mean()), page="mean", form=4),
        column(lambda e: plain_unit(e.si), page="unit", words=True),
        column(lambda e: e.scatter, page="scatter", form=2),
        column(lambda e: e.claimed, page="standard error", form=2),
        column(lambda e: e.scatter / e.claimed if e.claimed > 0.0 else None, page="ratio", form=2),
    ]
    left = len(estimated) - MOST_ROWS
    return table("across_units", columns), f"{left} more are in summary.csv." if left > 0 else ""


def _units(units: pd.DataFrame, folder: Path) -> Block:
    shown = units.assign(number=np.arange(1, len(units) + 1))
    shown = shown.sort_values("state", key=lambda s: s == "done", kind="stable").head(MOST_UNITS)
    column, left = columns_of(shown.to_dict("records")), len(units) - len(shown)
    columns = [
        *(column(lambda row, key=key: row[key], page=key) for key in ("unit", "number")),
        *(column(lambda row, key=key: row[key] or None, page=key, words=True) for key in ("state", "verdict", "error")),
        column(lambda row: row["seconds"], page="time [s]", form=".0f"),
    ]
    more = f"{left} more are in units.csv." if left else ""
    paths = [(name, folder / "units" / name / "report.html") for name in map(str, shown["unit"])]
    links = tuple(f"units/{quote(name)}/report.html" if path.is_file() else "" for name, path in paths)
    return replace(table("units", columns, left=more).text(), links=links)


# --- Estimates of the units side by side: do their intervals agree with their scatter?

METHODS = {
    "mle_corrected": ("maximum likelihood, corrected bound", "crb_corrected"),
    "output_error_corrected": ("output error, corrected bound", "crb_corrected"),
    "process_noise": ("prediction error with process noise, white innovations", "nuts"),
    "emcee": ("emcee", "emcee"),
    "nuts": ("NUTS", "nuts"),
    "mle": ("maximum likelihood, Cramér–Rao bound", "crb"),
    "output_error": ("output error, Cramér–Rao bound", "crb"),
    "flight path": ("flight path", "after"),
    "coefficients": ("coefficients", "after"),
    "trajectories": ("trajectories", "after"),
}
"""How a method is named and coloured; the first two of a parameter are drawn."""
DRAWN, MOST_PANELS = 2, 18


class AcrossUnits(NamedTuple):
    """One parameter by one method in every unit that has it; `rows` have SI values and, from 1, the units' numbers."""

    label: str
    method: str
    si: str
    rows: Any  # a data frame

    @property
    def scatter(self) -> float:
        """Standard deviation between units; NaN for a single one."""
        return float(self.rows["value"].std())

    @property
    def claimed(self) -> float:
        """Root mean square of the units' own standard errors."""
        return float(np.sqrt(np.mean(np.square(self.rows["sd"]))))


def estimates(units: pd.DataFrame, results: pd.DataFrame) -> list[AcrossUnits]:
    """Every parameter and method of a study, in the order of the results; values that are missing are left out."""
    number, every = {name: k for k, name in enumerate(units["unit"], start=1)}, []
    for key, part in results.dropna(subset=["value"]).groupby(["cause", "parameter", "method"], sort=False):
        cause, parameter, method = map(str, key)  # type: ignore[call-overload]
        label, si = f"{cause}: {parameter}" if cause else parameter, str(part["unit_of_value"].iloc[0])
        numbers = part[["value", "low95", "high95", "sd"]].astype(float)
        every.append(AcrossUnits(label, method, si, numbers.assign(number=[number[name] for name in part["unit"]])))
    return every


def panels_of(estimated: list[AcrossUnits]) -> Iterator[tuple[str, list[AcrossUnits]]]:
    """Parameters with the methods that are drawn, the most trusted interval first."""
    order = list(METHODS)
    for label in dict.fromkeys(e.label for e in estimated):
        mine = [e for e in estimated if e.label == label and e.method in METHODS]
        yield label, sorted(mine, key=lambda e: order.index(e.method))[:DRAWN]


@housed
def across(estimated: list[AcrossUnits]) -> Figure:
    every = needed([group for group in panels_of(estimated) if group[1]], "no unit has an estimate")
    groups = every[:MOST_PANELS]
    figure, axes = grid_of(len(groups), 3, (3.6, 2.3))
    last = max(int(e.rows["number"].max()) for _, group in groups for e in group)
    labels = {}
    for ax, (label, group) in zip(axes, groups, strict=True):
        unit, factor = for_people(group[0].si)
        for k, e in enumerate(group):
            (name, colour), value = METHODS[e.method], factor * e.rows["value"]
            ends = np.abs([value - factor * e.rows["low95"], factor * e.rows["high95"] - value])
            x, ends = e.rows["number"] + (k - 0.5 * (len(group) - 1)) * 0.25, np.where(np.isfinite(ends), ends, 0.0)
            look: dict[str, Any] = {"fmt": "os"[k], "color": COLOURS[colour], "ms": 3.0, "elinewidth": 0.8}
            labels.setdefault(name, ax.errorbar(x, value, ends, **look))
        ax.set(title=label, xlim=(0.4, last + 0.6), ylabel=bracket(unit), xlabel="unit")
        ax.xaxis.set_major_locator(MaxNLocator(integer=True))
        ax.ticklabel_format(axis="y", useOffset=False)
    figure.legend(labels.values(), labels, loc="outside lower center", ncols=3)
    figure.suptitle("Estimates of all units, with 95 % intervals")
    return figure
