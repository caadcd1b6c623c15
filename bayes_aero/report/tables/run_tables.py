"""Tables of a run: parameters by every method, validation by split, how well the model fits."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from bayes_aero.flight.health import only_following
from bayes_aero.inference.results import GPReport, Identification, Scores, Validation, interval_coverage, score
from bayes_aero.model.noise import Colour
from bayes_aero.report.frequency import band_text, frequency_columns
from bayes_aero.report.tables import comparison
from bayes_aero.report.tables.table import Column, Estimate, Table, columns_of, in_brackets, parameter_columns
from bayes_aero.report.text.phrases import WORDS, from_to, plus_minus, several, unparted
from bayes_aero.units import number

ON_TERMINAL, ON_PAGE = 3, 4  # manoeuvres fitted alone that are shown one by one; of more only the scatter
ML = "maximum likelihood\n± standard error"
SAMPLED = "posterior\nmean ± standard deviation, 95 % interval"


def parameter_table(run: Identification) -> Table:
    """The model's parameters by every method, SI and radians. Methods not (yet) run have no columns."""
    mle, (bound, corrected, *sampled) = run.mle, comparison.methods(run)
    names = comparison.ordered(mle.names, mle.parameters)
    truth = [] if run.truth is None else [run.truth.get(n) for n in names]
    columns = [
        *parameter_columns(names, [comparison.unit_of(run, n) for n in names]),
        *([Column(truth, page="true", terminal="flown", form=".4g")] if truth else []),
        Column(bound.of(names), ("estimate", "crb"), "Cramér–Rao", "ML (CRB)", group=ML),
        Column(corrected.of(names), ("", "crb_corrected"), "corrected", "sd\ncorr.", terminal_form=_sd, group=ML),
        *([Column(truth, "flown")] if truth else []),
    ]
    if run.noise is Colour.WHITE and sampled:
        columns.append(Column(sampled[0].of(names), ("white_mean", "white_sd")))
    # a terminal has the first; sentences tell where others differ
    posterior = next(iter(comparison.chosen_posteriors(run)), None)
    for m in sampled:
        white, label = m.key == "white", m.label.replace(", ", "\n", 1)
        files = tuple(f"{m.key}_{part}" for part in ("mean", "sd", *(() if white else ("ci95_low", "ci95_high"))))
        head = f"{comparison.engine_label(m.key)}\n{comparison.noise_label(run.noise)}" if m.key == posterior else None
        column = Column(m.of(names), files, label, "sd\nwhite" if white else head, _interval, group=SAMPLED)
        columns.append(replace(column, terminal_form=_sd if white else in_brackets))
    if run.frequency is not None:
        columns += frequency_columns(names, run.frequency, f"in band\n{band_text(run.frequency)}".replace(" to ", "-"))
    if run.alone:
        columns += _alone_columns(run, names)
    return Table(
        columns,
        "Parameters by every method",
        WORDS["notes"]["parameters"]
        + (" “True” are the values with which the records were simulated." if truth else ""),
        f"{run.card.title}; maximum likelihood "
        + unparted(mle.status.name.lower().replace("_", " "), only_following(run.health)),
        "In brackets: standard deviation in units of the last digit. SI and radians.",
        dense=True,
    )


def _alone_columns(run: Identification, names: Sequence[str]) -> Iterator[Column]:
    """Manoeuvres fitted alone: files have every fit, people those that are usable, or their scatter."""
    few = len(run.alone) <= ON_TERMINAL
    for (manoeuvre, fit), usable in zip(run.alone.items(), _usable(run, names), strict=True):
        own = comparison.bounds(fit, fit.crb)
        yield Column([own.get(n) for n in names], (f"{manoeuvre}_estimate", f"{manoeuvre}_crb"))
        yield Column(usable, terminal=f"{manoeuvre}\nalone" if few else None)
    found = [comparison.scatter(run, n) for n in names]
    head = None if few else f"sd of {len(run.alone)}\nalone"
    group = "manoeuvres fitted alone"
    yield Column([s and s.sd for s in found], "between_manoeuvres_sd", "scatter\n(sd)", head, 2, group=group)
    largest = [s and s.in_crb for s in found]
    yield Column(largest, "largest_difference_in_crb", "largest\ndifference", form=".1f", group=group)


def _usable(run: Identification, names: Sequence[str]) -> list[list[Estimate | None]]:
    """By manoeuvre, its own estimates with Cramer-Rao bounds, where they are usable."""
    own = [comparison.alone(run, n) for n in names]
    return [[Estimate.normal(*one[m][:2]) if m in one else None for one in own] for m in run.alone]


def alone_table(run: Identification) -> Table | None:
    """Every parameter as each manoeuvre by itself has it; nothing where there is one, or too many for a page."""
    if not 1 < len(run.alone) <= ON_PAGE:
        return None
    names = comparison.ordered(run.mle.names, run.mle.parameters)
    own = [Column(values, page=m) for m, values in zip(run.alone, _usable(run, names), strict=True)]
    columns = [*parameter_columns(names, [comparison.unit_of(run, n) for n in names]), *own]
    return Table(columns, "Each manoeuvre fitted alone (± Cramér–Rao)")


def _sd(e: Estimate) -> str:
    return number(e.sd, 2)


def _interval(e: Estimate) -> str:
    return f"{plus_minus(e.centre, e.sd)}\n{from_to(e.low, e.high, e.sd)}"


@dataclass(frozen=True)
class PooledScores:
    """Validation of one coefficient over the test points of several folds together."""

    points: int
    gp: Scores
    mle: Scores
    coverage: dict[float, float]
    k_hat: float | None
    status: str

    @classmethod
    def of(cls, folds: Sequence[Validation]) -> PooledScores:
        """Scores over all points; coverage is weighted by points, and `k_hat` is the largest."""
        measured, gp, mle = (np.concatenate([getattr(v, key) for v in folds]) for key in ("measured", "gp", "mle"))
        weights = [len(v.measured) for v in folds]
        coverage = {
            level: float(np.average([v.coverage[level] for v in folds], weights=weights)) for level in folds[0].coverage
        }
        k_hat = max((v.k_hat for v in folds if v.k_hat is not None), default=None)
        status = "; ".join(dict.fromkeys(v.status for v in folds))
        return cls(len(measured), score(measured, gp), score(measured, mle), coverage, k_hat, status)


def validation_table(run: Identification, *, each_fold: bool = True) -> Table:
    """Scores of GPR and maximum likelihood on the same test points by split, fold (and all folds) and coefficient."""
    rows: list[tuple[str, str, str, PooledScores]] = []
    for split, folds in (run.gp.splits if run.gp else {}).items():
        for name in run.observations.coefficients:
            if each_fold and len(folds) > 1:
                rows += [(split, str(k), name, PooledScores.of([fold[name]])) for k, fold in enumerate(folds, start=1)]
            rows.append((split, "all", name, PooledScores.of([fold[name] for fold in folds])))
    column = columns_of([row[-1] for row in rows])
    ml, gpr = {"group": "maximum likelihood"}, {"group": "GPR"}
    return Table(
        [
            *(Column([row[k] for row in rows], name) for k, name in enumerate(("split", "fold", "coefficient"))),
            Column([f"{split}, {name}" for split, _, name, _ in rows], page="split, coefficient"),
            column(lambda p: p.points, "points", "points"),
            column(lambda p: p.mle.r, page="r", form=".4f", **ml),
            column(lambda p: p.mle.rmse, page="RMSE [-]", form=3, **ml),
            column(lambda p: p.gp.r, "gpr_r", "r", form=".4f", **gpr),
            column(lambda p: p.gp.rmse, "gpr_rmse", "RMSE [-]", form=3, **gpr),
            column(lambda p: p.gp.theil, "gpr_theil"),
            column(lambda p: p.gp.r2, "gpr_r2"),
            column(lambda p: p.coverage.get(0.5), "gpr_coverage50"),
            column(lambda p: p.coverage.get(0.9), "gpr_coverage90"),
            column(lambda p: p.coverage.get(0.95), "gpr_coverage95", "inside 95 %", form=".0%", **gpr),
            column(lambda p: p.k_hat, "gpr_k_hat", "Pareto k", form=2, **gpr),
            column(lambda p: p.mle.r, "mle_r"),
            column(lambda p: p.mle.rmse, "mle_rmse"),
            column(lambda p: p.status, "gpr_status"),
        ],
        "Hold-out samples: the stall model (maximum likelihood) and a Gaussian process (GPR)",
        WORDS["notes"]["validation"],
        index=3,
    )


def fit_table(run: Identification) -> Table:
    """How well the fitted model follows each coefficient."""
    column = columns_of([(name, run.mle.fit[name], run.mle.lag1[name]) for name in run.mle.fit])
    return Table(
        [
            column(lambda r: r[0], page=""),
            column(lambda r: r[1].r, page="correlation r", form=".4f"),
            column(lambda r: r[1].r2, page="R²", form=".3f"),
            column(lambda r: r[1].rmse, page="RMSE [-]", form=3),
            column(lambda r: r[1].theil, page="Theil U", form=".3f"),
            column(lambda r: r[2], page="lag-1 correlation\nof residuals", form="+.2f"),
        ],
        "Fit of the maximum-likelihood model to all samples",
        WORDS["notes"]["fit"],
    )


def sampler_table(run: Identification, key: str) -> Table:
    """R-hat and effective sample sizes of one posterior."""
    posterior = run.posteriors[key]
    column = columns_of([(n, posterior.marginals[n]) for n in comparison.ordered(posterior.names, run.mle.parameters)])
    divergent = ""
    if key == "nuts":
        stats = posterior.tree["sample_stats"].to_dataset() if "sample_stats" in posterior.tree.children else {}
        count = int(np.sum(np.asarray(stats["diverging"]))) if "diverging" in stats else "not recorded"
        divergent = f" Divergent transitions: {count}."
    return Table(
        [
            column(lambda r: r[0], page=""),
            column(lambda r: r[1].rhat, page="R-hat", form=".4f"),
            column(lambda r: r[1].ess_bulk, page="bulk ESS", form=".0f"),
            column(lambda r: r[1].ess_tail, page="tail ESS", form=".0f"),
        ],
        f"Convergence: {comparison.engine_label(posterior.engine)}, {comparison.noise_label(posterior.noise)} noise",
        f"Status: {posterior.status.value}. Targets: R-hat at most 1.01, both sample sizes at least 400.{divergent}",
    )


def coverage_table(run: Identification) -> Table | None:
    """Share of the measured samples inside the posterior's predictive intervals."""
    rows = []
    for key, posterior in comparison.chosen_posteriors(run).items():
        if not {"posterior_predictive", "observed_data"} <= set(posterior.tree.children):
            continue
        predicted, observed = (posterior.tree[g].to_dataset() for g in ("posterior_predictive", "observed_data"))
        for name in run.observations.coefficients:
            draws = np.asarray(predicted[name], float).reshape(-1, observed[name].size)
            shares = interval_coverage(np.asarray(observed[name], float), draws)
            rows.append((f"{comparison.engine_label(key)}, {name}", *shares.values()))
    if not rows:
        return None
    first, *columns = zip(*rows, strict=True)
    heads = ("50 %", "90 %", "95 %")
    return Table(
        [Column(first, page=""), *(Column(c, page=h, form=".0%") for c, h in zip(columns, heads, strict=True))],
        "Calibration: share of measured samples inside the predictive intervals",
        WORDS["notes"]["coverage"],
    )


# --- Joint fit, manoeuvres alone and pooled, scatter between them and next flight.

POOLED_ON_TERMINAL = 2  # manoeuvres that are shown one by one; a file has all
PARTS = ("", "sd", "ci95_low", "ci95_high")


def next_flight_table(run: Identification) -> Table:
    """A row for each parameter, SI and radians; ValueError if the run has not pooled its manoeuvres."""
    found = run.next_flight
    if found is None:
        raise ValueError("the manoeuvres of this run are not pooled")
    names = comparison.ordered(found.aircraft, found.parameters)
    few = len(found.manoeuvres) <= POOLED_ON_TERMINAL
    joint = comparison.bounds(run.mle, run.mle.crb_corrected)
    name, unit, both = parameter_columns(names, [comparison.unit_of(run, n) for n in names])
    columns = [
        *(name, replace(unit, terminal=None), both),  # a terminal has the units above
        Column([joint[n] for n in names], ("joint", "joint_sd"), "joint", "joint", terminal_form=in_brackets),
    ]
    for m in found.manoeuvres:
        one_by_one = len(found.manoeuvres) <= ON_PAGE
        own = found.alone[m]
        single = [Estimate.normal(*own[n]) if n in own else None for n in names]
        for kind, values in (("alone", single), ("pooled", [Estimate.of(found.pooled[m][n]) for n in names])):
            heads = kind if one_by_one else None, f"{m}\npooled" if few and kind == "pooled" else None
            columns.append(Column(values, (f"{m}_{kind}", f"{m}_{kind}_sd"), *heads, group=m))
    for key, head, numbers, forms in (
        ("aircraft", "aircraft", found.aircraft, ("", in_brackets)),
        ("scatter", "scatter\n95 %", found.scatter, (_scatter_interval, _scatter_interval)),
        ("next_flight", "next flight\n95 %", found.following, (_digits, _digits)),
    ):
        files = tuple(f"{key}_{part}".rstrip("_") for part in PARTS)
        values = [Estimate.of(numbers[n]) for n in names]
        columns.append(Column(values, files, head, head.splitlines()[0], *forms))
    narrowed = [found.narrowed[n] for n in names]
    columns.append(Column(narrowed, "scatter_over_prior", "scatter\nover prior", "over\nprior", form=".2f"))
    note = "In brackets: standard deviation in units of the last digit; scatter and next flight: 95 % intervals."
    return Table(
        columns,
        "Joint fit, manoeuvres alone and pooled, and the next flight",
        WORDS["notes"]["next_flight"],
        terminal_note=note,
        dense=True,
    )


def _digits(e: Estimate) -> str:
    return from_to(e.low, e.high, e.sd)


def _scatter_interval(e: Estimate) -> str:
    """Of a scatter, whose lower end is near zero."""
    return f"{number(e.low, 2)} to {number(e.high, 2)}"


# --- Sentences on the Gaussian process under each kind of hold-out data.

LEAK = 0.02  # a correlation that falls by more from the random split to another one was leaked; our choice
NOTABLE = 0.001  # a difference of correlations not worth a sentence below; our choice
SAYS = {"random": "the random split", "block": "hold-out blocks", "manoeuvre": "a hold-out manoeuvre"}


def pooled_r(report: GPReport, split: str, name: str, engine: str) -> float:
    """Correlation over the test points of all folds; `engine` is gp or mle."""
    return getattr(PooledScores.of([fold[name] for fold in report.splits[split]]), engine).r


def split_verdict(identification: Identification) -> list[str]:
    """Correlations by split, the leak of the random one, and hyperparameters that could not be sampled."""
    report = identification.gp
    if report is None:
        return []
    first = report.splits[report.chosen][0]
    unsampled = {n: first[n].status.rstrip(".") for n, fit in report.fits.items() if fit.posterior is None}
    said = [f"Gaussian process of {name}: no sampled hyperparameters ({why})." for name, why in unsampled.items()]
    others = [split for split in ("block", "manoeuvre") if split in report.splits]
    if "random" not in report.splits or not others:
        return said
    names = tuple(report.splits["random"][0])
    r = {s: {n: pooled_r(report, s, n, "gp") for n in names} for s in ("random", *others)}
    numbers = several(f"{n} {' / '.join(f'{r[s][n]:.3f}' for s in r)}" for n in names)
    order = " / ".join(SAYS[s] for s in r)
    leak = " The random split does not leak significantly."
    drops = {n: r["random"][n] - min(r[s][n] for s in others) for n in names}
    fallen = {n: drop for n, drop in drops.items() if drop > LEAK}
    behind = []  # coefficients that the Gaussian process predicts worse than the stall model
    for split in ("random", others[-1]):
        mle = {n: pooled_r(report, split, n, "mle") for n in names}
        worse = {n: x for n, x in r[split].items() if x < mle[n] - NOTABLE}
        lost = several(f"{n} ({mle[n]:.3f} against {x:.3f})" for n, x in worse.items())
        if lost:
            behind.append(f"On {SAYS[split]} maximum likelihood correlates better than GPR in {lost}.")
    if fallen:
        away, lost = 1000.0 * identification.observations.dt, several(f"{n} -{x:.2f}" for n, x in fallen.items())
        leak = (
            f" The random split leaves neighbours {away:.0f} ms away in the training set; the part lost without them "
            f"({lost}) is interpolation, not aerodynamics."
        )
    return [*said, f"GPR correlation with the measurement by {order}: {numbers}.{leak}", *behind]
