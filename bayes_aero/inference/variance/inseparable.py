"""Parameters that a record cannot separate: it determines a combination of them, but none by itself.

Source: Belsley, Kuh and Welsch, Regression Diagnostics (1980), ch. 3 (condition indices and proportions of variance);
so Klein and Morelli, Aircraft System Identification (2006), sec. 5.2.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

INDEX = 10.0  # condition index from which a near dependency counts (there: 5 to 10 weak, beyond 30 strong)
VARIANCE_SHARE = 0.5  # share of a parameter's variance due to near dependencies from which it belongs to one
MIN_WIDENING = 3.0  # factor by which the unknown others widen an interval from which it is reported; our choice
MIN_PARTIAL = 0.5  # partial correlation of two estimates from which they share a dependency; our choice
MAX_RELATIVE_ERROR = 0.2  # standard error over estimate from which an estimate is of little use; our choice


@dataclass(frozen=True)
class Inseparable:
    """Parameters in one near dependency.

    Attributes:
        names: the parameters, the one with the largest variance inflation first.
        units: of each.
        estimates: of each, with its corrected standard error.
        wider: factor by which the unknown others widen each interval.
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
    """Sets of parameters that the record cannot separate, at least one of them with a large relative error.

    Args:
        names: of the parameters.
        units: of the parameters.
        estimate: of each.
        covariance: of Cramer and Rao, (k, k); a parameter without variance is known.
        deviation: standard errors corrected for autocorrelated residuals, (k,).

    Returns:
        The sets, the one with the largest variance inflation first.
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
    vague = deviation > MAX_RELATIVE_ERROR * np.abs(estimate)
    near = np.sqrt(values[-1] / np.maximum(values, 1e-13)) > INDEX
    inside = (shares[:, near].sum(axis=1) > VARIANCE_SHARE) & (np.sqrt(inflation) > MIN_WIDENING)
    found = []
    for own in _dependencies([int(i) for i in np.argsort(-inflation) if inside[i]], np.abs(partial) > MIN_PARTIAL):
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
    """Members connected by their partial correlations.

    Within a dependency of any size partial correlations are near one; the eigenvectors of equally near dependencies are
    arbitrary mixtures.
    """
    parts: list[list[int]] = []
    for i in members:
        mine = [part for part in parts if any(linked[i, j] for j in part)]
        parts = [part for part in parts if part not in mine] + [[*(j for part in mine for j in part), i]]
    return [sorted(part, key=members.index) for part in parts if len(part) > 1]
