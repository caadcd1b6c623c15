"""Tables of an identification for the page: parameters by every method, fit, diagnostics of the samplers."""

from __future__ import annotations

import numpy as np

from bayes_aero.inference.identification import Identification
from bayes_aero.inference.posterior.posterior import Posterior
from bayes_aero.inference.scores import Scores, interval_coverage
from bayes_aero.physics.coefficients import NAMES
from bayes_aero.report.html.page import Table
from bayes_aero.report.html.parts import number
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
)
from bayes_aero.report.tables.run_tables import validation_table

MANOEUVRES_SHOWN = 4  # beyond, only their scatter
UNITS = {"1": "-", "c/V": "chords"}


def parameters(identification: Identification) -> Table:
    """Every parameter by every method."""
    mle, found = identification.mle, methods(identification)
    truth = identification.truth
    groups = [("", 1 if truth is None else 2), ("maximum likelihood\n± standard error", 2)]
    head = ["parameter", *([] if truth is None else ["true"]), "Cramér–Rao", "corrected"]
    sampled = found[2:]
    if sampled:
        groups.append(("posterior\nmean ± standard deviation, 95 % interval", len(sampled)))
        head += [method.label.replace(", ", "\n", 1) for method in sampled]
    if identification.alone:
        groups.append(("manoeuvres fitted alone", 2))
        head += ["scatter\n(sd)", "largest\ndifference"]
    rows = []
    for name in ordered(mle.names, mle.parameters):
        row = [_with_unit(identification, name)]
        if truth is not None:
            row.append(f"{truth[name]:.4g}" if name in truth else "–")
        row += [_pm(m.estimates.get(name)) for m in found[:2]]
        row += [f"{_pm(e)}\n{_range(e)}" for e in (m.estimates.get(name) for m in sampled)]
        if identification.alone:
            spread = scatter(identification, name)
            row += [number(spread.sd, 2), f"{spread.in_crb:.1f}"] if spread else ["–", "–"]
        rows.append(tuple(row))
    return Table(
        "Parameters by every method",
        tuple(head),
        tuple(rows),
        tuple(groups),
        note="SI units and radians. “Corrected” is the Cramér–Rao bound with the autocorrelation of the residuals. "
        "“Largest difference” compares manoeuvres, in Cramér–Rao "
        "standard errors of the difference; above 3 the bound does not explain it."
        + ("" if truth is None else " “True” are the values with which the records were simulated."),
    )


def each_alone(identification: Identification) -> Table | None:
    """Every parameter as each manoeuvre by itself has it; nothing where there is one, or too many for a table."""
    names = list(identification.alone)
    if not 1 < len(names) <= MANOEUVRES_SHOWN:
        return None
    rows = []
    for name in ordered(identification.mle.names, identification.mle.parameters):
        own = alone(identification, name)
        cells = (_pm(Estimate.normal(own[m][0], own[m][1])) if m in own else "–" for m in names)
        rows.append((_with_unit(identification, name), *cells))
    return Table("Each manoeuvre fitted alone (± Cramér–Rao)", ("parameter", *names), tuple(rows))


def _with_unit(identification: Identification, name: str) -> str:
    unit = identification.mle.units[identification.mle.names.index(name)]
    return f"{name} [{UNITS.get(unit, unit)}]"


def _pm(e: Estimate | None) -> str:
    if e is None or not np.isfinite(e.centre):
        return "–"
    if not (np.isfinite(e.sd) and e.sd > 0.0):
        return f"{e.centre:.4g}"
    places = decimals(e.sd)
    return f"{e.centre:.{places}f} ± {e.sd:.{places}f}"


def _range(e: Estimate | None) -> str:
    if e is None or not np.isfinite([e.low, e.high]).all():
        return "–"
    places = decimals(max(e.sd, 1e-12))
    return f"{e.low:.{places}f} to {e.high:.{places}f}"


def fit(identification: Identification) -> Table:
    """How well the fitted model follows each coefficient."""
    mle = identification.mle
    rows = []
    for name in NAMES:
        s: Scores = mle.fit[name]
        rows.append((name, f"{s.r:.4f}", f"{s.r2:.3f}", number(s.rmse), f"{s.theil:.3f}", f"{mle.lag1[name]:+.2f}"))
    return Table(
        "Fit of the maximum-likelihood model to all samples",
        ("", "correlation r", "R²", "RMSE [-]", "Theil U", "lag-1 correlation\nof residuals"),
        tuple(rows),
        note="R² is the share of the variance that is explained; Theil's U is 0 for a perfect fit and 1 for none. A "
        "lag-1 correlation near 0 means independent residuals.",
    )


def samplers(identification: Identification) -> list[Table]:
    """R-hat and effective sample sizes of every posterior."""
    tables = []
    for key, posterior in identification.posteriors.items():
        label = f"{engine_label(posterior.engine)}, {noise_label(posterior.noise)} noise"
        rows = [
            (n, f"{m.rhat:.4f}", f"{m.ess_bulk:.0f}", f"{m.ess_tail:.0f}")
            for n, m in ((n, posterior.marginals[n]) for n in ordered(posterior.names, identification.mle.parameters))
        ]
        note = f"Status: {posterior.status.value}. Targets: R-hat at most 1.01, both sample sizes at least 400."
        if key == "nuts":
            note += f" Divergent transitions: {_divergences(posterior)}."
        tables.append(Table(f"Convergence: {label}", ("", "R-hat", "bulk ESS", "tail ESS"), tuple(rows), note=note))
    return tables


def _divergences(posterior: Posterior) -> str:
    if "sample_stats" not in posterior.tree.children:
        return "not recorded"
    stats = posterior.tree["sample_stats"].to_dataset()
    return str(int(np.sum(np.asarray(stats["diverging"])))) if "diverging" in stats else "not recorded"


def coverage(identification: Identification) -> Table | None:
    """Share of the measured samples inside the posterior's predictive intervals."""
    rows = []
    for key, posterior in chosen_posteriors(identification).items():
        groups = posterior.tree.children
        if not {"posterior_predictive", "observed_data"} <= set(groups):
            continue
        predicted, observed = (posterior.tree[g].to_dataset() for g in ("posterior_predictive", "observed_data"))
        for name in NAMES:
            draws = np.asarray(predicted[name]).reshape(-1, observed[name].size)
            shares = interval_coverage(np.asarray(observed[name], float), draws.astype(float))
            rows.append((f"{engine_label(key)}, {name}", *(f"{share:.0%}" for share in shares.values())))
    if not rows:
        return None
    return Table(
        "Calibration: share of measured samples inside the predictive intervals",
        ("", "50 %", "90 %", "95 %"),
        tuple(rows),
        note="A calibrated model shows the heading's share in each column. More means that intervals are too wide, "
        "less "
        "that they are too narrow.",
    )


def validation(identification: Identification) -> Table | None:
    """Gaussian process and maximum likelihood on held-back samples."""
    if identification.gp is None:
        return None
    frame = validation_table(identification).reset_index()
    rows = [
        (
            f"{r['split']}, {r['coefficient']}",
            str(r["points"]),
            f"{r['mle_r']:.4f}",
            number(r["mle_rmse"]),
            f"{r['gpr_r']:.4f}",
            number(r["gpr_rmse"]),
            f"{r['gpr_coverage95']:.0%}",
            number(r["gpr_k_hat"], 2),
        )
        for r in frame.loc[frame["fold"] == "all"].to_dict(orient="records")
    ]
    return Table(
        "Hold-out samples: the stall model (maximum likelihood) and a Gaussian process (GPR)",
        ("split, coefficient", "points", "r", "RMSE [-]", "r", "RMSE [-]", "inside 95 %", "Pareto k"),
        tuple(rows),
        (("", 2), ("maximum likelihood", 2), ("GPR", 4)),
        note="A random split leaves neighbours of every sample in the training set and flatters the GPR; read the "
        "block and "
        "manoeuvre splits. Pareto k above 0.7 means that the sampled hyperparameters are not reliable.",
    )
