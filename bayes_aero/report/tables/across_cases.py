"""Estimates of a study's units side by side: do their intervals agree with their scatter?"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from bayes_aero.diagnosis.trajectory_result import LEVELS, DiagnosisView, HoldoutScores, View
from bayes_aero.inference.results import Identification
from bayes_aero.report.colours import COLOURS
from bayes_aero.report.style import NotDrawn, grid_of, housed
from bayes_aero.report.tables.table import BeforeAfter, Column, Estimate, Table, columns_of
from bayes_aero.report.text.phrases import WORDS, bracket, for_people, plain_unit, several

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


# --- The card's and the extended model side by side: hold-out scores, parameters, residuals.


def gain_table(view: DiagnosisView) -> Table | None:
    """Scores of each coefficient on hold-out data; nothing where nothing was added."""
    if view.unseen_scores is None:
        return None
    before, after = view.unseen_scores
    names = list(after)
    columns = [Column(names, page="coefficient")]
    for when, scores in (("before", before), ("after", after)):
        columns.append(Column([scores[name].r2 for name in names], page=f"R² {when}", form=".3f"))
        columns.append(Column([scores[name].rmse for name in names], page=f"RMSE {when} [-]", form=".4f"))
    by_manoeuvre = view.diagnosis.split == "manoeuvre"
    what = "each manoeuvre predicted from the others" if by_manoeuvre else "each block from the others"
    return Table(
        columns,
        f"Hold-out data ({what}): the card's model before, with all confirmed causes after",
        "5 Hz means. R² below zero: worse than a constant.",
    )


def holdout_table(unseen: HoldoutScores) -> Table:
    """Both models on each hold-out manoeuvre, and whether the difference is significant."""
    rows = []
    for k, manoeuvre in enumerate(unseen.names):
        before, after = (unseen.scores[model, "hold_out", k] for model in ("card", "extended"))
        rows += [(manoeuvre, n, BeforeAfter(before[n].r2, after[n].r2), unseen.gains[manoeuvre, n]) for n in before]
    column = columns_of(rows)
    worse = several(f"{name} of {manoeuvre}" for manoeuvre, name in unseen.worse()) or "no manoeuvre"
    return Table(
        [
            column(lambda r: r[0], page="manoeuvre"),
            column(lambda r: r[1], page="coefficient"),
            column(lambda r: r[2], page=("R²\ncard", "R²\nextended"), form=".3f"),
            column(lambda r: r[3], page="change of R²", form=lambda gain: f"{gain.r2:+z.3f} ± {gain.r2_sd:.3f}"),
            column(
                lambda r: r[3], page="log density\ngained", form=lambda gain: f"{gain.elpd:+z.1f} ± {gain.elpd_sd:.1f}"
            ),
        ],
        "Hold-out manoeuvres: the card's model and the extended model",
        f"{WORDS['notes']['holdout']} The log density decreases significantly (one-sided, 5 %) for {worse}.",
    )


def moves_table(view: View) -> Table:
    """The card's own parameters before and after."""
    column = columns_of([(name, m, *for_people(m.unit)) for name, m in view.moves.items()])
    return Table(
        [
            column(lambda r: f"{r[0]} {bracket(plain_unit(r[2]))}", page="parameter"),
            column(lambda r: Estimate(r[3] * r[1].before, r[3] * r[1].sd_before), page="card's model"),
            column(lambda r: Estimate(r[3] * r[1].after, r[3] * r[1].sd_after), page="extended model"),
            column(
                lambda r: (r[1].after - r[1].before) / r[1].sd_after if r[1].sd_after > 0.0 else None,
                page="change\n[standard errors]",
                form="+.1f",
            ),
        ],
        "The card's parameters, fitted without and with the causes",
        "± is one standard error, autocorrelation included.",
    )


def residual_tables(view: View) -> tuple[Table, Table]:
    """Each coefficient's residuals before and after: scores, Theil's parts, autocorrelation; then calibration."""
    models = [("card's", view.card), *([("extended", view.extended)] if view.changed else [])]
    rows = [(f"{name}, {label}", fitted.composition[name]) for name in view.coefficients for label, fitted in models]
    column, first = columns_of([numbers for _, numbers in rows]), Column([label for label, _ in rows], page="")
    shares = [
        column(
            lambda n, part=part: n[f"theil_{part}"], page=part, form=".0%", group="Theil's shares of the squared error"
        )
        for part in ("bias", "variance", "covariance")
    ]
    levels = [f"{level:g}" for level in LEVELS]
    return Table(
        [
            first,
            column(lambda n: n["r2"], page="R²", form=".3f"),
            column(lambda n: n["rmse"], page="RMSE [-]", form=".4f"),
            column(lambda n: n["theil"], page="Theil U", form=".3f"),
            *shares,
            column(lambda n: n["lag1"], page="lag-1\ncorrelation", form="+.2f"),
        ],
        "Residuals at the recorded rate, all manoeuvres fitted jointly",
        WORDS["notes"]["residuals"],
    ), Table(
        [
            first,
            *(column(lambda n, x=x: n["calibration"][x], page=f"{100.0 * float(x):.0f} %", form=".0%") for x in levels),
        ],
        "Calibration: share of 5 Hz residuals inside the fitted noise's bands",
        "A right noise model shows the heading's share in each column.",
    )


# --- What the validation figures draw: measured and predicted coefficients at the chosen split's test points.

GAP = 1.0  # s; a line is broken where its neighbouring points are further apart


@dataclass(frozen=True)
class PredictedPoints:
    """One coefficient at `index` (ascending) of the observations; `gp`, `low`, `high` are None without a GP."""

    index: np.ndarray
    measured: np.ndarray
    mle: np.ndarray
    gp: np.ndarray | None = None
    low: np.ndarray | None = None
    high: np.ndarray | None = None

    def of(self, manoeuvre: np.ndarray) -> PredictedPoints:
        """Only the points whose sample is marked in `manoeuvre`, a mask over all samples."""
        keep = manoeuvre[self.index]
        cut = (None if part is None else part[keep] for part in (self.gp, self.low, self.high))
        return PredictedPoints(self.index[keep], self.measured[keep], self.mle[keep], *cut)


def predicted(identification: Identification, coefficient: str) -> PredictedPoints:
    """Predictions at the chosen split's test points (all its folds); without a GP the fit at all samples."""
    if identification.gp is None:
        o = identification.observations
        column = o.coefficients.index(coefficient)
        return PredictedPoints(np.arange(o.n), np.asarray(o.measured)[:, column], identification.fitted[:, column])
    folds = [fold[coefficient] for fold in identification.gp.splits[identification.gp.chosen]]
    names = ("test", "measured", "mle", "gp", "gp_low", "gp_high")
    index, *columns = (np.concatenate([getattr(v, name) for v in folds]) for name in names)
    order = np.argsort(index, kind="stable")
    return PredictedPoints(index[order], *(column[order] for column in columns))


def what_is_shown(identification: Identification) -> str:
    """What the predictions were trained on and where they are shown, for titles."""
    if identification.gp is None:
        return "fit to all samples"
    text = {
        "random": "trained on a random 70 % of the samples, shown on the rest",
        "block": "trained on 70 % of the contiguous blocks, shown on the rest",
        "manoeuvre": "each manoeuvre predicted from the others",
    }
    return text.get(identification.gp.chosen, f"{identification.gp.chosen} split, test points")


def broken(time: np.ndarray, *columns: np.ndarray, gap: float = GAP) -> tuple[np.ndarray, ...]:
    """The columns with NaN put in wherever time jumps by more than `gap`, so that a line breaks there."""
    at = np.flatnonzero(np.diff(time) > gap) + 1
    return tuple(np.insert(np.asarray(c, float), at, np.nan) for c in (time, *columns))


def clock(identification: Identification) -> np.ndarray:
    """Time of every sample from the start of its manoeuvre, s."""
    o = identification.observations
    begin = np.array([o.time[o.manoeuvre == m][0] for m in range(len(o.names))])
    return o.time - begin[o.manoeuvre]
