"""Estimates of a study's units side by side: do their intervals agree with their scatter?"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from bayes_aero.report.colours import COLOURS
from bayes_aero.report.style import NotDrawn, grid_of, housed
from bayes_aero.report.text.phrases import bracket, for_people

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
class Estimates:
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


def estimates(units: pd.DataFrame, results: pd.DataFrame) -> list[Estimates]:
    """Every parameter and method of a study, in the order of the results; values that are missing are left out."""
    number = {name: k for k, name in enumerate(units["unit"], start=1)}
    rows = results.dropna(subset=["value"])
    found = []
    for key, part in rows.groupby(["cause", "parameter", "method"], sort=False):
        cause, parameter, method = map(str, key)  # type: ignore[call-overload]
        column = {name: part[name].to_numpy(float) for name in ("value", "low95", "high95", "sd")}
        label = f"{cause}: {parameter}" if cause else parameter
        at = np.array([number[name] for name in part["unit"]])
        si = str(part["unit_of_value"].iloc[0])
        found.append(Estimates(label, method, si, at, column["value"], column["low95"], column["high95"], column["sd"]))
    return found


def panels_of(found: list[Estimates]) -> Iterator[tuple[str, list[Estimates]]]:
    """Parameters with the methods that are drawn, the most trusted interval first."""
    order = list(METHODS)
    for label in dict.fromkeys(e.label for e in found):
        mine = [e for e in found if e.label == label and e.method in METHODS]
        yield label, sorted(mine, key=lambda e: order.index(e.method))[:DRAWN]


@housed
def across(found: list[Estimates]) -> Figure:
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
            x = e.unit + (k - 0.5 * (len(group) - 1)) * 0.25
            if last <= MOST_BARS:
                ends = np.abs(factor * np.stack([e.value - e.low, e.high - e.value]))
                ends = np.where(np.isfinite(ends), ends, 0.0)
                shown = ax.errorbar(
                    x, factor * e.value, ends, fmt="os"[k], ms=3.5, lw=1.1, color=COLOURS[colour], label=name
                )
            else:
                shown = ax.plot(x, factor * e.value, ".", ms=2.5, color=COLOURS[colour], label=name)[0]
            labels.setdefault(name, shown)
        ax.set(title=label, xlim=(0.4, last + 0.6), ylabel=bracket(unit), xlabel="unit")
        ax.xaxis.set_major_locator(MaxNLocator(integer=True))
        ax.ticklabel_format(axis="y", useOffset=False)
    figure.legend(labels.values(), labels, loc="outside lower center", ncols=3)
    figure.suptitle("Estimates of all units, with 95 % intervals" if last <= MOST_BARS else "Estimates of all units")
    return figure
