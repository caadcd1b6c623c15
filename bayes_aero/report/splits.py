"""In words: what the ways to hold data back say of the Gaussian process."""

from __future__ import annotations

import numpy as np

from bayes_aero.inference.identification import GPReport, Identification
from bayes_aero.inference.scores import score
from bayes_aero.physics.coefficients import NAMES
from bayes_aero.report.style import several

LEAK = 0.02  # a correlation that falls by more from the random split to another one was leaked; our choice
SAYS = {"block": "held-back blocks", "manoeuvre": "an unseen manoeuvre"}


def pooled_r(report: GPReport, split: str, name: str, engine: str) -> float:
    """Correlation over the test points of all folds; `engine` is gp or mle."""
    folds = [fold[name] for fold in report.splits[split]]
    predicted = np.concatenate([getattr(v, engine) for v in folds])
    return score(np.concatenate([v.measured for v in folds]), predicted).r


def split_verdict(identification: Identification) -> list[str]:
    """Correlations by split, what the random one leaks, and hyperparameters that could not be sampled."""
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
    r = {s: {n: pooled_r(report, s, n, "gp") for n in NAMES} for s in ("random", *others)}
    numbers = several(f"{n} {' / '.join(f'{r[s][n]:.3f}' for s in r)}" for n in NAMES)
    order = " / ".join(["random split", *(SAYS[s] for s in others)])
    said = [f"GPR correlation with the measurement by {order}: {numbers}."]
    fallen = {n: (s, r["random"][n] - r[s][n]) for s in others for n in NAMES if r["random"][n] - r[s][n] > LEAK}
    if not fallen:
        return [said[0] + " The random split leaks nothing that matters."]
    said[0] += (
        f" The random split leaves neighbours {1000.0 * dt:.0f} ms away in the training set; what is lost without them "
        f"({several(f'{n} -{drop:.2f}' for n, (_, drop) in fallen.items())}) was interpolation, not aerodynamics."
    )
    hardest = others[-1]
    behind = {n: pooled_r(report, hardest, n, "mle") for n in NAMES}
    lost = [n for n in NAMES if r[hardest][n] < behind[n]]
    if lost:
        said.append(
            f"On {SAYS[hardest]} maximum likelihood correlates better than GPR in "
            + several(f"{n} ({behind[n]:.3f} against {r[hardest][n]:.3f})" for n in lost)
            + "."
        )
    return said
