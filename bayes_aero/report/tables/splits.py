"""Sentences on the Gaussian process under each kind of hold-out data."""

from __future__ import annotations

from bayes_aero.inference.identification import GPReport, Identification
from bayes_aero.report.tables.run_tables import Pooled
from bayes_aero.report.text.phrases import several

LEAK = 0.02  # a correlation that falls by more from the random split to another one was leaked; our choice
NOTABLE = 0.001  # a difference of correlations not worth a sentence below; our choice
SAYS = {"random": "the random split", "block": "hold-out blocks", "manoeuvre": "a hold-out manoeuvre"}


def pooled_r(report: GPReport, split: str, name: str, engine: str) -> float:
    """Correlation over the test points of all folds; `engine` is gp or mle."""
    return getattr(Pooled.of([fold[name] for fold in report.splits[split]]), engine).r


def split_verdict(identification: Identification) -> list[str]:
    """Correlations by split, the leak of the random one, and hyperparameters that could not be sampled."""
    report = identification.gp
    if report is None:
        return []
    return [*_unsampled(report), *_leaks(report, identification.observations.dt)]


def _unsampled(report: GPReport) -> list[str]:
    first = report.splits[report.chosen][0]
    return [
        f"Gaussian process of {name}: no sampled hyperparameters ({first[name].status.rstrip('.')})."
        for name, fit in report.fits.items()
        if fit.posterior is None
    ]


def _leaks(report: GPReport, dt: float) -> list[str]:
    others = [split for split in ("block", "manoeuvre") if split in report.splits]
    if "random" not in report.splits or not others:
        return []
    names = tuple(report.splits["random"][0])
    r = {s: {n: pooled_r(report, s, n, "gp") for n in names} for s in ("random", *others)}
    numbers = several(f"{n} {' / '.join(f'{r[s][n]:.3f}' for s in r)}" for n in names)
    order = " / ".join(SAYS[s] for s in r)
    sentences = [f"GPR correlation with the measurement by {order}: {numbers}."]
    drops = {n: r["random"][n] - min(r[s][n] for s in others) for n in names}
    fallen = {n: drop for n, drop in drops.items() if drop > LEAK}
    behind = [sentence for s in ("random", others[-1]) for sentence in _behind(report, s, r[s])]
    if not fallen:
        return [sentences[0] + " The random split does not leak significantly.", *behind]
    sentences[0] += (
        f" The random split leaves neighbours {1000.0 * dt:.0f} ms away in the training set; the part lost without "
        f"them "
        f"({several(f'{n} -{drop:.2f}' for n, drop in fallen.items())}) is interpolation, not aerodynamics."
    )
    return [*sentences, *behind]


def _behind(report: GPReport, split: str, r: dict[str, float]) -> list[str]:
    """Coefficients that the Gaussian process predicts worse than the stall model."""
    mle = {n: pooled_r(report, split, n, "mle") for n in r}
    lost = [f"{n} ({mle[n]:.3f} against {r[n]:.3f})" for n in r if r[n] < mle[n] - NOTABLE]
    return [f"On {SAYS[split]} maximum likelihood correlates better than GPR in {several(lost)}."] if lost else []
