"""Restraints on estimates: priors that the data contradict, and active bounds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from bayes_aero.parameter import Parameter

CONFLICT_LIMIT = 3.0  # combined standard errors between prior and likelihood, beyond which a conflict is named
SENSITIVITY_LIMIT = 0.05  # distance per log2 of the power from which a posterior depends on the scaled part (the paper)
MIN_SHIFT = 1.0  # corrected standard errors; smaller changes of other estimates by a bound are not reported


@dataclass(frozen=True)
class PriorConflict:
    """A prior (mean, standard deviation), the estimate by likelihood alone, and their distance in combined standard
    errors."""

    name: str
    unit: str
    prior: tuple[float, float]
    likelihood: tuple[float, float]
    distance: float
    source: str


@dataclass(frozen=True)
class ActiveBound:
    """A parameter at its bound.

    `unbounded` is the estimate without the bound, `shifts` are the changes of the other estimates without it in
    corrected standard errors; both to first order.
    """

    name: str
    unit: str
    bound: float
    lower: bool
    unbounded: float
    shifts: Mapping[str, float]


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
        difference, scatter = x - mean, sd
        if p.prior.family == "lognormal" and x > 0.0:  # on the scale on which it is normal
            difference = p.prior.location * np.log(x / p.prior.location)
            scatter = sd * p.prior.location / x
        distance = abs(difference) / np.hypot(scatter, wide)
        if distance > CONFLICT_LIMIT:
            found.append(
                PriorConflict(p.name, p.unit, (mean, wide), (float(x), float(sd)), float(distance), p.prior.source)
            )
    return tuple(sorted(found, key=lambda c: -c.distance))


def active_bounds(
    parameters: Sequence[Parameter],
    estimate: Float[np.ndarray, " k"],
    gradient: Float[np.ndarray, " k"],
    inverse: Float[np.ndarray, "k k"],
    deviation: Float[np.ndarray, " k"],
    active: Sequence[bool] | np.ndarray,
) -> tuple[ActiveBound, ...]:
    """Effect of each active bound on the estimates.

    Args:
        parameters: the free ones.
        estimate: with the bounds.
        gradient: of the log-likelihood; zero except for the active parameters.
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
        shifts = {name: x for name, x in moves.items() if abs(x) > MIN_SHIFT}
        p, lower = parameters[i], bool(gradient[i] < 0.0)
        ordered = dict(sorted(shifts.items(), key=lambda item: -abs(item[1])))
        found.append(
            ActiveBound(p.name, p.unit, p.bounds[0 if lower else 1], lower, float(estimate[i] + step[i]), ordered)
        )
    return tuple(found)
