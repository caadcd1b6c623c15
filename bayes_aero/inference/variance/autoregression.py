"""Autoregressions of residuals by least squares, kept stationary."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

ORDER = 3  # at some 5 samples a second; our choice
ROOT = 0.995  # largest root: a memory of 40 s at 5 samples a second


def autoregression(
    folds: Sequence[Float[np.ndarray, "r _"]],
) -> tuple[Float[np.ndarray, "r p"], Float[np.ndarray, " r"]]:
    """Coefficients and the innovation's deviation of one output in r records."""
    lags = [[x[:, ORDER - i : x.shape[1] - i] for i in range(ORDER + 1)] for x in folds]
    gram = np.empty((len(folds[0]), ORDER + 1, ORDER + 1))
    for i in range(ORDER + 1):
        for j in range(i, ORDER + 1):
            gram[:, i, j] = gram[:, j, i] = sum(np.einsum("rt,rt->r", lag[i], lag[j]) for lag in lags)
    past, right = gram[:, 1:, 1:], gram[:, 1:, :1]
    ridge = 1e-9 * np.trace(past, axis1=1, axis2=2) + 1e-300
    phi = stationary(np.linalg.solve(past + ridge[:, None, None] * np.eye(ORDER), right)[:, :, 0])
    squares = sum(
        np.sum((now - sum(p[:, None] * x for p, x in zip(phi.T, before, strict=True))) ** 2, axis=1)
        for now, *before in lags
    )
    return phi, np.sqrt(squares / sum(lag[0].shape[1] for lag in lags))


def stationary(phi: Float[np.ndarray, "r p"]) -> Float[np.ndarray, "r p"]:
    """Autoregressions with no root outside `ROOT`: those that are outside are drawn onto it."""
    companion = np.zeros((len(phi), ORDER, ORDER))
    companion[:, 0] = phi
    companion[:, 1:, :-1] = np.eye(ORDER - 1)
    roots, found = np.linalg.eigvals(companion), phi.copy()
    size = np.abs(roots)
    outside = np.any(size > ROOT, axis=1)
    inside = np.where(size > ROOT, roots * ROOT / np.maximum(size, 1e-300), roots)[outside]
    product = np.ones((len(inside), 1))  # of (1 - root L), by powers of the lag L
    for root in inside.T[:, :, None]:
        product = np.pad(product, ((0, 0), (0, 1))) - root * np.pad(product, ((0, 0), (1, 0)))
    found[outside] = -np.real(product[:, 1:])
    return found


def driven(
    phi: Float[np.ndarray, "p ..."],
    innovations: Float[np.ndarray, "t ..."],
    before: Float[np.ndarray, "p ..."] | None = None,
) -> Float[np.ndarray, "t ..."]:
    """x[t] = sum phi[i] x[t-1-i] + e[t] after the samples `before` (default: rest), for many series side by side: time
    comes first, so that it alone is looped over."""
    order, weights = len(phi), phi[::-1]
    rest = np.zeros((order, *innovations.shape[1:])) if before is None else before
    found = np.concatenate([rest, innovations])
    for t in range(len(innovations)):
        found[t + order] += np.add.reduce(weights * found[t : t + order])
    return found[order:]


def stationary_series(
    phi: Float[np.ndarray, "p ..."], innovations: Float[np.ndarray, "t ..."]
) -> Float[np.ndarray, "t ..."]:
    """`driven`, begun in its stationary distribution: what comes before the order is reached is predicted from the
    fewer samples that are there.

    Source: Durbin's recursion, downwards; Brockwell and Davis, Time Series: Theory and Methods, 5.2.
    """
    order = len(phi)
    predictors, variances = [phi], [np.ones(phi.shape[1:])]
    for _ in range(order):
        longer, last = predictors[0], predictors[0][-1]
        share = 1.0 - last**2
        predictors.insert(0, (longer[:-1] + last * longer[-2::-1]) / share)
        variances.insert(0, variances[0] / share)
    begun: list[np.ndarray] = []
    for k, e in enumerate(innovations[:order]):
        begun.append(np.sqrt(variances[k]) * e + sum(c * x for c, x in zip(predictors[k], begun[::-1], strict=True)))
    before = np.array(begun).reshape(len(begun), *innovations.shape[1:])
    return before if len(begun) < order else np.concatenate([before, driven(phi, innovations[order:], before)])
