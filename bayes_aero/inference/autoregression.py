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
    for k in np.flatnonzero(np.any(np.abs(roots) > ROOT, axis=1)):
        size = np.abs(roots[k])
        found[k] = -np.real(np.poly(np.where(size > ROOT, roots[k] * ROOT / np.maximum(size, 1e-300), roots[k])))[1:]
    return found


def impulse(phi: Float[np.ndarray, "*r p"], n: int) -> Float[np.ndarray, "*r n"]:
    """What autoregressions make of a single innovation of one: the first n samples."""
    weights = np.moveaxis(phi, -1, 0)
    order = len(weights)
    found = np.zeros((n + order, *phi.shape[:-1]))
    found[order] = 1.0
    for t in range(order + 1, order + n):
        found[t] = sum(weight * found[t - back] for back, weight in enumerate(weights, 1))
    return np.ascontiguousarray(np.moveaxis(found[order:], 0, -1))


class Driven:
    """Rows of innovations, made ready for one filter after another: `after` gives as many samples of each row."""

    def __init__(self, rows: Float[np.ndarray, "*r t"]) -> None:
        self.length = rows.shape[-1]
        self._size = _quick(2 * self.length)
        self._spectrum = np.fft.rfft(rows, self._size)

    def after(self, response: Float[np.ndarray, "*r t"]) -> Float[np.ndarray, "*r t"]:
        """The rows convolved with an impulse response that is as long as they are."""
        return np.fft.irfft(self._spectrum * np.fft.rfft(response, self._size), self._size)[..., : self.length]


def _quick(n: int) -> int:
    """The least length from n on, of powers of two times 1, 3 or 5, whose transform is quick."""
    power = 1 << max(n - 1, 1).bit_length()
    return min(size for size in (power, power * 3 // 4, power * 5 // 8) if size >= n)
