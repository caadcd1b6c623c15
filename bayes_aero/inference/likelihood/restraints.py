"""What holds an estimate away from the value that the data support: priors that they contradict, and bounds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from bayes_aero.parameter import Parameter

AGAINST = 3.0  # combined standard errors between prior and likelihood, beyond which a conflict is named
SENSITIVE = 0.05  # distance per log2 of the power above which a posterior leans on what was scaled (the paper's)
PUSHED = 1.0  # corrected standard errors by which lifting a bound moves an estimate that is reported


@dataclass(frozen=True)
class PriorConflict:
    """A prior (mean, standard deviation) and the likelihood's own estimate, `apart` combined standard errors away."""

    name: str
    unit: str
    prior: tuple[float, float]
    likelihood: tuple[float, float]
    apart: float
    source: str


@dataclass(frozen=True)
class Bounded:
    """A parameter at its bound. To first order `without` is its value without it; `pushed` are the other estimates'
    moves then, in corrected standard errors."""

    name: str
    unit: str
    bound: float
    lower: bool
    without: float
    pushed: Mapping[str, float]


def prior_conflicts(
    parameters: Sequence[Parameter], estimate: Float[np.ndarray, " k"], deviation: Float[np.ndarray, " k"]
) -> tuple[PriorConflict, ...]:
    """Priors that the data contradict, the strongest conflict first.

    Args:
        parameters: the free ones.
        estimate: by likelihood alone.
        deviation: its standard error, corrected for the residuals' autocorrelation.
    """
    found = []
    for p, x, sd in zip(parameters, estimate, deviation, strict=True):
        if p.prior.family == "uniform" or not np.isfinite(sd):
            continue
        mean, wide = p.prior.normal
        away, scatter = x - mean, sd
        if p.prior.family == "lognormal" and x > 0.0:  # on the scale on which it is normal
            away = p.prior.location * np.log(x / p.prior.location)
            scatter = sd * p.prior.location / x
        apart = abs(away) / np.hypot(scatter, wide)
        if apart > AGAINST:
            found.append(
                PriorConflict(p.name, p.unit, (mean, wide), (float(x), float(sd)), float(apart), p.prior.source)
            )
    return tuple(sorted(found, key=lambda c: -c.apart))


def bounded(
    parameters: Sequence[Parameter],
    estimate: Float[np.ndarray, " k"],
    gradient: Float[np.ndarray, " k"],
    inverse: Float[np.ndarray, "k k"],
    deviation: Float[np.ndarray, " k"],
    active: Sequence[bool] | np.ndarray,
) -> tuple[Bounded, ...]:
    """What each active bound does.

    Args:
        parameters: the free ones.
        estimate: with the bounds.
        gradient: of the log-likelihood there; it vanishes but for the active parameters.
        inverse: of the information, active parameters included.
        deviation: corrected standard errors.
        active: whether a parameter is at its bound.
    """
    found = []
    for i in map(int, np.flatnonzero(active)):
        step = inverse[:, i] * gradient[i]
        if not np.isfinite(step).all():
            step = np.zeros_like(step)
        moves = {p.name: float(step[j] / deviation[j]) for j, p in enumerate(parameters) if j != i and deviation[j] > 0}
        pushed = {name: x for name, x in moves.items() if abs(x) > PUSHED}
        p, lower = parameters[i], bool(gradient[i] < 0.0)
        ordered = dict(sorted(pushed.items(), key=lambda item: -abs(item[1])))
        found.append(Bounded(p.name, p.unit, p.bounds[0 if lower else 1], lower, float(estimate[i] + step[i]), ordered))
    return tuple(found)
