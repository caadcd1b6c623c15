"""Autoregressions of residuals by least squares, kept stationary."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

ORDER = 3  # at some 5 samples a second; our choice
MAX_ROOT = 0.995  # largest root: a memory of 40 s at 5 samples a second


def autoregression(
    folds: Sequence[Float[np.ndarray, "r _"]],
) -> tuple[Float[np.ndarray, "r p"], Float[np.ndarray, " r"]]:
    """Coefficients, and the standard deviation of the innovation, of one output in r records."""
    lags = [[x[:, ORDER - i : x.shape[1] - i] for i in range(ORDER + 1)] for x in folds]
    gram = np.empty((len(folds[0]), ORDER + 1, ORDER + 1))
    for i in range(ORDER + 1):
        for j in range(i, ORDER + 1):
            gram[:, i, j] = gram[:, j, i] = sum(np.einsum("rt,rt->r", lag[i], lag[j]) for lag in lags)
    past, right = gram[:, 1:, 1:], gram[:, 1:, :1]
    ridge = 1e-9 * np.trace(past, axis1=1, axis2=2) + 1e-300
    phi = stationary_coefficients(np.linalg.solve(past + ridge[:, None, None] * np.eye(ORDER), right)[:, :, 0])
    squares = sum(
        np.sum((now - sum(p[:, None] * x for p, x in zip(phi.T, past, strict=True))) ** 2, axis=1)
        for now, *past in lags
    )
    return phi, np.sqrt(squares / sum(lag[0].shape[1] for lag in lags))


def stationary_coefficients(phi: Float[np.ndarray, "r p"]) -> Float[np.ndarray, "r p"]:
    """Autoregressions with no root larger than `MAX_ROOT`; larger roots are scaled to it."""
    companion = np.zeros((len(phi), ORDER, ORDER))
    companion[:, 0] = phi
    companion[:, 1:, :-1] = np.eye(ORDER - 1)
    roots, limited = np.linalg.eigvals(companion), phi.copy()
    size = np.abs(roots)
    outside = np.any(size > MAX_ROOT, axis=1)
    inside = np.where(size > MAX_ROOT, roots * MAX_ROOT / np.maximum(size, 1e-300), roots)[outside]
    product = np.ones((len(inside), 1))  # of (1 - root L), by powers of the lag L
    for root in inside.T[:, :, None]:
        product = np.pad(product, ((0, 0), (0, 1))) - root * np.pad(product, ((0, 0), (1, 0)))
    limited[outside] = -np.real(product[:, 1:])
    return limited


def filtered_noise(
    phi: Float[np.ndarray, "p ..."],
    innovations: Float[np.ndarray, "t ..."],
    past: Float[np.ndarray, "p ..."] | None = None,
) -> Float[np.ndarray, "t ..."]:
    """x[t] = sum phi[i] x[t-1-i] + e[t] after the samples `past` (default: zeros), for many series at once.

    Time is the first axis; the loop runs over it alone.
    """
    order, weights = len(phi), phi[::-1]
    past = np.zeros((order, *innovations.shape[1:])) if past is None else past
    series = np.concatenate([past, innovations])
    for t in range(len(innovations)):
        series[t + order] += np.add.reduce(weights * series[t : t + order])
    return series[order:]


def stationary_series(
    phi: Float[np.ndarray, "p ..."], innovations: Float[np.ndarray, "t ..."]
) -> Float[np.ndarray, "t ..."]:
    """`filtered_noise` from the stationary distribution: each of the first samples is predicted from those before it.

    Source: Durbin's recursion, downwards; Brockwell and Davis, Time Series: Theory and Methods, 5.2.
    """
    order = len(phi)
    predictors, variances = [phi], [np.ones(phi.shape[1:])]
    for _ in range(order):
        longer, last = predictors[0], predictors[0][-1]
        share = 1.0 - last**2
        predictors.insert(0, (longer[:-1] + last * longer[-2::-1]) / share)
        variances.insert(0, variances[0] / share)
    first: list[np.ndarray] = []
    for k, e in enumerate(innovations[:order]):
        first.append(np.sqrt(variances[k]) * e + sum(c * x for c, x in zip(predictors[k], first[::-1], strict=True)))
    past = np.array(first).reshape(len(first), *innovations.shape[1:])
    return past if len(first) < order else np.concatenate([past, filtered_noise(phi, innovations[order:], past)])
