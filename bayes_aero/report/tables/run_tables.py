"""Tables of a run: parameters by every method, validation by split, and the seed paper's Table 1 beside ours."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from rich.box import SIMPLE_HEAD
from rich.table import Table

from bayes_aero.inference.identification import Identification, Validation
from bayes_aero.inference.posterior.posterior import Posterior
from bayes_aero.inference.scores import score
from bayes_aero.physics.coefficients import NAMES
from bayes_aero.report.tables.comparison import (
    Estimate,
    alone,
    chosen_posteriors,
    decimals,
    engine_label,
    methods,
    noise_label,
    ordered,
    scatter,
    white_posterior,
)

# Table 1 of the seed paper: r and RMSE on 30 % of the samples, drawn at random.
PAPER_CARD, PAPER_SPLIT = "attas", "random"
PAPER = {
    "CL": (0.989818, 0.029438, 0.991374, 0.02712),
    "CD": (0.948576, 0.009290, 0.954557, 0.00875),
    "Cm": (0.466906, 0.011350, 0.902741, 0.00552),
}
PAPER_COLUMNS = ("mle_r", "mle_rmse", "gpr_r", "gpr_rmse")
MANOEUVRES_SHOWN = 3  # in the terminal's table; of more only the scatter


def parameter_table(identification: Identification) -> pd.DataFrame:
    """The model's parameters as rows; by every method, SI and radians. Methods not (yet) run have no columns."""
    mle = identification.mle
    rows = {}
    for name in ordered(mle.names, mle.parameters):
        i = mle.names.index(name)
        row: dict[str, Any] = {
            "unit": mle.units[i],
            "estimate": float(mle.estimate[i]),
            "crb": float(mle.crb[i]),
            "crb_corrected": float(mle.crb_corrected[i]),
        }
        if identification.truth is not None:
            row["flown"] = identification.truth.get(name, np.nan)
        row |= _posterior_columns(identification, name)
        for manoeuvre, fit in identification.alone.items():
            at = fit.names.index(name) if name in fit.names else None
            row[f"{manoeuvre}_estimate"] = np.nan if at is None else float(fit.estimate[at])
            row[f"{manoeuvre}_crb"] = np.nan if at is None else float(fit.crb[at])
        if identification.alone:
            row |= _scatter_columns(identification, name)
        rows[name] = row
    return pd.DataFrame.from_dict(rows, orient="index").rename_axis("parameter")


def _posterior_columns(identification: Identification, name: str) -> dict[str, float]:
    columns: dict[str, float] = {}
    white = white_posterior(identification)
    if white is not None:
        columns |= _summary(white, name, "white", interval=False)
    for key, posterior in chosen_posteriors(identification).items():
        columns |= _summary(posterior, name, key, interval=True)
    return columns


def _summary(posterior: Posterior, name: str, key: str, *, interval: bool) -> dict[str, float]:
    m = posterior.marginals.get(name)
    columns = {f"{key}_mean": m.mean if m else np.nan, f"{key}_sd": m.sd if m else np.nan}
    if interval:
        low, high = m.ci95 if m else (np.nan, np.nan)
        columns |= {f"{key}_ci95_low": low, f"{key}_ci95_high": high}
    return columns


def _scatter_columns(identification: Identification, name: str) -> dict[str, float]:
    found = scatter(identification, name)
    return {
        "between_manoeuvres_sd": found.sd if found else np.nan,
        "largest_difference_in_crb": found.in_crb if found else np.nan,
    }


def validation_table(identification: Identification) -> pd.DataFrame:
    """A row per split, fold and coefficient: scores of GPR and of maximum likelihood on the same test points.

    A split of several folds has a row for each (`fold` 1, 2, ...) and one over all their test points (`fold` all).
    """
    rows = []
    for split, folds in (identification.gp.splits if identification.gp else {}).items():
        for name in NAMES:
            if len(folds) > 1:
                rows += [_scores_row(split, str(k), name, [fold[name]]) for k, fold in enumerate(folds, start=1)]
            rows.append(_scores_row(split, "all", name, [fold[name] for fold in folds]))
    columns = ["split", "fold", "coefficient", "points", *_SCORES, *_COVERAGE, "gpr_k_hat", *_MLE_SCORES, "gpr_status"]
    return pd.DataFrame(rows, columns=columns).set_index(["split", "fold", "coefficient"])


_SCORES = ("gpr_r", "gpr_rmse", "gpr_theil", "gpr_r2")
_COVERAGE = ("gpr_coverage50", "gpr_coverage90", "gpr_coverage95")
_MLE_SCORES = ("mle_r", "mle_rmse")


def _scores_row(split: str, fold: str, name: str, folds: list[Validation]) -> dict[str, Any]:
    measured = np.concatenate([v.measured for v in folds])
    gp = score(measured, np.concatenate([v.gp for v in folds]))
    mle = score(measured, np.concatenate([v.mle for v in folds]))
    weights = [len(v.measured) for v in folds]
    k_hats = [v.k_hat for v in folds if v.k_hat is not None]
    row: dict[str, Any] = {"split": split, "fold": fold, "coefficient": name, "points": len(measured)}
    row |= dict(zip(_SCORES, (gp.r, gp.rmse, gp.theil, gp.r2), strict=True))
    for column, level in zip(_COVERAGE, (0.5, 0.9, 0.95), strict=True):
        shares = [v.coverage.get(level, np.nan) for v in folds]
        row[column] = float(np.average(shares, weights=weights))
    row["gpr_k_hat"] = max(k_hats) if k_hats else np.nan
    row |= dict(zip(_MLE_SCORES, (mle.r, mle.rmse), strict=True))
    return row | {"gpr_status": "; ".join(dict.fromkeys(v.status for v in folds))}


def paper_table(identification: Identification) -> pd.DataFrame:
    """The seed paper's Table 1 (r and RMSE on held-back samples) from this run, the printed numbers beside ours.

    The printed ones are there where they compare: the ATTAS card and the random split. Another run shows its own chosen
    split alone; without a Gaussian process there are no held-back samples and the table is empty.
    """
    ours = [f"{column}_ours" for column in PAPER_COLUMNS]
    gp = identification.gp
    if gp is None:
        return pd.DataFrame(columns=ours).rename_axis("coefficient")
    compares = identification.card.name == PAPER_CARD and PAPER_SPLIT in gp.splits
    split = PAPER_SPLIT if compares else gp.chosen
    rows = {}
    for name in NAMES:
        folds = [fold[name] for fold in gp.splits[split]]
        row = _scores_row(split, "all", name, folds)
        rows[name] = {f"{column}_ours": row[column] for column in PAPER_COLUMNS}
        if compares:
            rows[name] |= {f"{c}_paper": x for c, x in zip(PAPER_COLUMNS, PAPER[name], strict=True)}
    table = pd.DataFrame.from_dict(rows, orient="index").rename_axis("coefficient")
    if not compares:
        return table
    return table.reindex(columns=[f"{c}_{who}" for c in PAPER_COLUMNS for who in ("paper", "ours")])


def write_csv(table: pd.DataFrame, path: Path) -> Path:
    """Write a table with its index, whole or not at all; floats keep every digit."""
    partial = path.with_name(path.name + ".part")
    try:
        table.to_csv(partial, lineterminator="\n")
        os.replace(partial, path)
    finally:
        partial.unlink(missing_ok=True)
    return path


def terminal_table(identification: Identification) -> Table:
    """The parameters for a terminal of 80 columns: estimate, both bounds, the posteriors, each manoeuvre alone."""
    mle = identification.mle
    status = mle.status.name.lower().replace("_", " ")
    caption = "In brackets: standard deviation in units of the last digit. SI and radians."
    table = Table(
        title=f"{identification.card.title}; maximum likelihood {status}",
        caption=caption,
        box=SIMPLE_HEAD,
        padding=0,
        pad_edge=False,
        show_edge=False,
    )
    columns = _terminal_columns(identification)
    table.add_column("", no_wrap=True)
    table.add_column("unit", no_wrap=True)
    for head, _ in columns:
        table.add_column(head, justify="right", overflow="fold", max_width=12)
    for name in ordered(mle.names, mle.parameters):
        table.add_row(name, mle.units[mle.names.index(name)], *(cell(name) for _, cell in columns))
    return table


def _terminal_columns(identification: Identification) -> list[tuple[str, Callable[[str], str]]]:
    """Heading, and the cell of a parameter, for every column behind the unit."""
    found = {method.key: method.estimates for method in methods(identification)}
    columns: list[tuple[str, Callable[[str], str]]] = []
    if identification.truth is not None:
        truth = identification.truth
        columns.append(("flown", lambda name: f"{truth[name]:.4g}" if name in truth else "-"))
    columns += [
        ("ML (CRB)", lambda name: _concise(found["crb"].get(name))),
        ("sd\ncorr.", lambda name: _deviation(found["crb_corrected"].get(name))),
    ]
    if "white" in found:
        columns.append(("sd\nwhite", lambda name: _deviation(found["white"].get(name))))
    if chosen_posteriors(identification):  # the first engine; the others agree or the verdict says so
        engine = next(iter(chosen_posteriors(identification)))
        head = f"{engine_label(engine)}\n{noise_label(identification.noise)}"
        columns.append((head, lambda name: _concise(found[engine].get(name))))
    if len(identification.alone) <= MANOEUVRES_SHOWN:
        columns += [(f"{m}\nalone", _alone_cell(identification, m)) for m in identification.alone]
    else:
        columns.append((f"sd of {len(identification.alone)}\nalone", _scatter_cell(identification)))
    return columns


def _alone_cell(identification: Identification, manoeuvre: str) -> Callable[[str], str]:
    def cell(name: str) -> str:
        single = alone(identification, name).get(manoeuvre)
        return concise(single[0], single[1]) if single else "-"

    return cell


def _scatter_cell(identification: Identification) -> Callable[[str], str]:
    def cell(name: str) -> str:
        found = scatter(identification, name)
        return f"{found.sd:.2g}" if found else "-"

    return cell


def _concise(estimate: Estimate | None) -> str:
    return concise(estimate.centre, estimate.sd) if estimate else "-"


def _deviation(estimate: Estimate | None) -> str:
    return f"{estimate.sd:.2g}" if estimate else "-"


def concise(value: float, sd: float) -> str:
    """`value(sd)` with two digits of sd, counted in the last digits of the value: -0.391(16)."""
    if not (np.isfinite(sd) and sd > 0.0):
        return f"{value:.4g}"
    places = decimals(sd)
    return f"{value:.{places}f}({round(sd * 10.0**places)})"
