"""The report of a study: the state of its units and their joint results."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from bayes_aero.report.colours import COLOURS
from bayes_aero.report.html.page import Block, Facts, Report, page_table, picture, section
from bayes_aero.report.phrases import bracket, for_people, plain_unit, sentence, several
from bayes_aero.report.style import NotDrawn, grid_of, housed, save
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
    """The page of a study, from its tables."""
    found = estimates(context.units, context.results)
    return Report(
        title=f"Study: {context.title}",
        subtitle=f"{len(context.units)} units, each a run of {context.task}",
        verdict=study_headline(context),
        lead=[_lead(found, context.folder)],
        sections=[
            section("findings", "Findings over all units", lambda: _findings(context, found)),
            section("across", "Scatter and intervals", lambda: _across(found)),
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
    for cause, n in causes.most_common(1):
        parts.append(f"{cause} is named in {n} of {done}")
    compared, beyond = _beyond(estimates(context.units, context.results))
    if beyond:
        worst = max(beyond, key=lambda e: e.scatter / e.claimed)
        ratio = f"{worst.scatter / worst.claimed:.1f} times its intervals"
        parts.append(f"{worst.label} differs between units by {ratio}")
    elif compared:
        parts.append(f"no parameter differs between units by more than {MIN_RATIO:g} times its intervals")
    return f"{'; '.join(parts)}."


def _beyond(found: list[AcrossUnits]) -> tuple[list[AcrossUnits], list[AcrossUnits]]:
    """Estimates that several units have, by their most trusted method; those that scatter beyond their intervals."""
    compared = [group[0] for _, group in panels_of(found) if group and len(group[0].value) > 1]
    return compared, [e for e in compared if e.scatter > MIN_RATIO * e.claimed]


def _findings(context: StudyContext, found: list[AcrossUnits]) -> list[str]:
    """Verdicts by number, causes by how many units name them, and parameters that scatter beyond their intervals."""
    verdicts, causes, done = context.counted
    said = []
    if verdicts:
        said.append(f"Verdicts: {several(f'{n} {verdict}' for verdict, n in verdicts.most_common())}.")
    if causes:
        listed = several(f"{cause} {n}" for cause, n in causes.most_common())
        said.append(f"Causes, in how many units of {done}: {listed}.")
    doubtful = context.units[context.units["doubts"] != ""]
    if len(doubtful):
        listed = "; ".join(f"{name}: {why}" for name, why in zip(doubtful["unit"], doubtful["doubts"], strict=True))
        said.append(f"Records are in doubt in {len(doubtful)} of {done} units: {listed}.")
    if beyond := [f"{e.label} ({e.scatter / e.claimed:.1f} times)" for e in _beyond(found)[1]]:
        said.append(sentence("units_differ", estimates=beyond))
    return said


def _lead(found: list[AcrossUnits], folder: Path) -> tuple[Block, ...]:
    """The picture of all estimates; a study without any has none."""
    path = folder / "across.png"
    try:
        save(across(found), path)
    except NotDrawn:
        return ()
    groups = [group[0] for _, group in panels_of(found) if group]
    more = f" The first {MOST_PANELS} of {len(groups)} parameters." if len(groups) > MOST_PANELS else ""
    bars = "with its 95 % interval" if max(e.unit.max() for e in found) <= MOST_BARS else "without its interval"
    caption = f"Every unit's estimate {bars}, by the unit's number in the table below.{more}"
    return (picture(path, caption),)


def _across(found: list[AcrossUnits]) -> tuple[Any, ...]:
    if not found:
        return ()
    column = columns_of(found[:MOST_ROWS])
    columns = [
        column(lambda e: e.label, page="parameter"),
        column(lambda e: e.method, page="method", words=True),
        column(lambda e: len(e.value), page="units"),
        column(lambda e: float(np.mean(e.value)), page="mean", form=4),
        column(lambda e: plain_unit(e.si), page="unit", words=True),
        column(lambda e: e.scatter, page="scatter", form=2),
        column(lambda e: e.claimed, page="standard error", form=2),
        column(lambda e: e.scatter / e.claimed if e.claimed > 0.0 else None, page="ratio", form=2),
    ]
    left = len(found) - MOST_ROWS
    return table("across_units", columns), f"{left} more are in summary.csv." if left > 0 else ""


def _units(units: pd.DataFrame, folder: Path) -> Block:
    """Table of the units, those that are not done first; a name is a link to the unit's report."""
    shown = units.assign(number=np.arange(1, len(units) + 1))
    shown = shown.sort_values("state", key=lambda s: s == "done", kind="stable").head(MOST_UNITS)
    column, left = columns_of(shown.to_dict("records")), len(units) - len(shown)
    columns = [
        column(lambda row: row["unit"], page="unit"),
        column(lambda row: row["number"], page="number"),
        column(lambda row: row["state"], page="state", words=True),
        column(lambda row: row["seconds"], page="time", form=lambda seconds: f"{seconds:.0f} s"),
        *(column(lambda row, key=key: row[key] or None, page=key, words=True) for key in ("verdict", "error")),
    ]
    more = f"{left} more are in units.csv." if left else ""
    paths = [(name, folder / "units" / name / "report.html") for name in map(str, shown["unit"])]
    links = tuple(f"units/{quote(name)}/report.html" if path.is_file() else "" for name, path in paths)
    return replace(page_table(table("units", columns, left=more)), links=links)


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
DRAWN, MOST_PANELS, MOST_BARS = 2, 18, 60


@dataclass(frozen=True)
class AcrossUnits:
    """One parameter by one method in every unit that has it; `unit` counts units from 1, values in SI."""

    label: str
    method: str
    si: str
    unit: np.ndarray
    value: np.ndarray
    low: np.ndarray
    high: np.ndarray
    sd: np.ndarray

    @property
    def scatter(self) -> float:
        """Standard deviation between units; NaN for a single one."""
        return float(np.std(self.value, ddof=1)) if len(self.value) > 1 else float("nan")

    @property
    def claimed(self) -> float:
        """Root mean square of the units' own standard errors."""
        return float(np.sqrt(np.mean(np.square(self.sd))))


def estimates(units: pd.DataFrame, results: pd.DataFrame) -> list[AcrossUnits]:
    """Every parameter and method of a study, in the order of the results; values that are missing are left out."""
    number = {name: k for k, name in enumerate(units["unit"], start=1)}
    found = []
    for key, part in results.dropna(subset=["value"]).groupby(["cause", "parameter", "method"], sort=False):
        cause, parameter, method = map(str, key)  # type: ignore[call-overload]
        label, si = f"{cause}: {parameter}" if cause else parameter, str(part["unit_of_value"].iloc[0])
        columns = (part[name].to_numpy(float) for name in ("value", "low95", "high95", "sd"))
        found.append(AcrossUnits(label, method, si, np.array([number[name] for name in part["unit"]]), *columns))
    return found


def panels_of(found: list[AcrossUnits]) -> Iterator[tuple[str, list[AcrossUnits]]]:
    """Parameters with the methods that are drawn, the most trusted interval first."""
    order = list(METHODS)
    for label in dict.fromkeys(e.label for e in found):
        mine = [e for e in found if e.label == label and e.method in METHODS]
        yield label, sorted(mine, key=lambda e: order.index(e.method))[:DRAWN]


@housed
def across(found: list[AcrossUnits]) -> Figure:
    """A panel for each parameter: estimate and 95 % interval of every unit, by its number."""
    groups = [group for group in panels_of(found) if group[1]][:MOST_PANELS]
    if not groups:
        raise NotDrawn("no unit has an estimate")
    figure, axes = grid_of(len(groups), 3, (3.6, 2.3))
    last = max(int(e.unit.max()) for _, group in groups for e in group)
    labels = {}
    for ax, (label, group) in zip(axes, groups, strict=True):
        unit, factor = for_people(group[0].si)
        for k, e in enumerate(group):
            name, colour = METHODS[e.method]
            x, y = e.unit + (k - 0.5 * (len(group) - 1)) * 0.25, factor * e.value
            if last <= MOST_BARS:
                ends = np.abs(factor * np.stack([e.value - e.low, e.high - e.value]))
                ends = np.where(np.isfinite(ends), ends, 0.0)
                shown = ax.errorbar(x, y, ends, fmt="os"[k], ms=3.5, lw=1.1, label=name, color=COLOURS[colour])
            else:
                (shown,) = ax.plot(x, y, ".", ms=2.5, label=name, color=COLOURS[colour])
            labels.setdefault(name, shown)
        ax.set(title=label, xlim=(0.4, last + 0.6), ylabel=bracket(unit), xlabel="unit")
        ax.xaxis.set_major_locator(MaxNLocator(integer=True))
        ax.ticklabel_format(axis="y", useOffset=False)
    figure.legend(labels.values(), labels, loc="outside lower center", ncols=3)
    figure.suptitle("Estimates of all units, with 95 % intervals" if last <= MOST_BARS else "Estimates of all units")
    return figure
