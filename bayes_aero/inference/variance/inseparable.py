"""Parameters that a record cannot separate: what it knows of them is a combination, each alone is as good as unknown.

Source: Belsley, Kuh and Welsch, Regression Diagnostics (1980), ch. 3 (condition indices and proportions of variance);
so Klein and Morelli, Aircraft System Identification (2006), sec. 5.2.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

INDEX = 10.0  # condition index from which a near dependency counts (there: 5 to 10 weak, beyond 30 strong)
SHARE = 0.5  # of a variance that one dependency makes, from which a parameter is in it
WIDER = 3.0  # times that not knowing the others widens an interval, from which it is told; our choice
LINKED = 0.5  # partial correlation of two estimates, all others known, from which one dependency holds both; our choice
VAGUE = 0.2  # standard error over estimate from which an estimate is of little use: an interval of 40 %; our choice


@dataclass(frozen=True)
class Inseparable:
    """Parameters in one near dependency.

    Attributes:
        names: the parameters, the one that suffers most first.
        units: of each.
        estimates: of each, with its corrected standard error.
        wider: how many times the others, not being known, widen each interval.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    estimates: tuple[tuple[float, float], ...]
    wider: tuple[float, ...]


def inseparable(
    names: Sequence[str],
    units: Sequence[str],
    estimate: Float[np.ndarray, " k"],
    covariance: Float[np.ndarray, "k k"],
    deviation: Float[np.ndarray, " k"],
) -> tuple[Inseparable, ...]:
    """Sets of parameters that the record cannot separate, one of them at least vague for that alone.

    Args:
        names: of the parameters.
        units: of the parameters.
        estimate: of each.
        covariance: Cramer and Rao's; a parameter without variance is known.
        deviation: standard errors that allow for the residuals' autocorrelation.

    Returns:
        By how much those that suffer most do.
    """
    if not np.isfinite(covariance).all():
        return ()
    white = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    free = np.flatnonzero((white > 0.0) & np.isfinite(deviation))
    if len(free) < 2:
        return ()
    correlation = covariance[np.ix_(free, free)] / np.outer(white[free], white[free])
    information = np.linalg.pinv(correlation, rcond=1e-13, hermitian=True)
    inflation = np.maximum(np.diag(information), 1.0)
    partial = information / np.sqrt(np.outer(inflation, inflation))  # of unit diagonal: but for signs, correlations
    values, vectors = np.linalg.eigh(partial)
    parts = vectors**2 / np.maximum(values, 1e-13)
    shares = parts / parts.sum(axis=1, keepdims=True)
    vague = deviation > VAGUE * np.abs(estimate)
    near = np.sqrt(values[-1] / np.maximum(values, 1e-13)) > INDEX
    inside = (shares[:, near].sum(axis=1) > SHARE) & (np.sqrt(inflation) > WIDER)
    found = []
    for own in _dependencies([int(i) for i in np.argsort(-inflation) if inside[i]], np.abs(partial) > LINKED):
        at = [int(free[i]) for i in own]
        if any(vague[at]):
            found.append(
                Inseparable(
                    tuple(names[i] for i in at),
                    tuple(units[i] for i in at),
                    tuple((float(estimate[i]), float(deviation[i])) for i in at),
                    tuple(float(np.sqrt(inflation[i])) for i in own),
                )
            )
    return tuple(found)


def _dependencies(members: Sequence[int], linked: Bool[np.ndarray, "k k"]) -> list[list[int]]:
    """Members that hang together by their partial correlations.

    Those are near one within a dependency, of however many; directions of dependencies equally near are any mixture.
    """
    parts: list[list[int]] = []
    for i in members:
        mine = [part for part in parts if any(linked[i, j] for j in part)]
        parts = [part for part in parts if part not in mine] + [[*(j for part in mine for j in part), i]]
    return [sorted(part, key=members.index) for part in parts if len(part) > 1]
