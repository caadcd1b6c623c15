"""Cramer-Rao bounds corrected for coloured residuals."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.fft import next_fast_len

LAG_SHARE = 0.2  # longest lag as a share of the shortest stretch; our choice, see `autocovariance`
FIXED_SHARE = 1.23  # 95 % point of an estimate over its standard error by Parzen's window of `LAG_SHARE`, over 1.96
"""The window is a fixed share of the record, so its variance stays uncertain however long that is, and the fit has
taken out of the residuals what was like its sensitivities. 2.41 by simulation of a mean, as Kiefer and Vogelsang do
(fixed-b asymptotics), Econometric Theory 21 (2005) 1130. The constant follows from the window alone, but this rule was
chosen among some ten on eight simulated flights with coloured noise; fresh flights have not judged it."""


def autocovariance(residual: Float[np.ndarray, "n c"], lags: int) -> Float[np.ndarray, "m c c"]:
    """Autocovariance R(k) = (1/n) sum_i r_i r_(i-k)' for k = -lags .. lags, tapered by Parzen's window.

    The biased estimate with a positive-definite window keeps the sequence positive semidefinite, so no corrected
    variance can come out negative. The full untapered sequence would sum to nearly zero, because the fitted
    residuals are orthogonal to the sensitivities; the window is what makes it consistent.
    """
    n, _ = residual.shape
    size = int(next_fast_len(2 * n) or 2 * n)
    spectrum = np.fft.rfft(residual, size, axis=0)
    full = np.fft.irfft(np.einsum("fi,fj->fij", spectrum, spectrum.conj()), size, axis=0) / n
    k = np.arange(-lags, lags + 1)
    return full[k] * _parzen(k / (lags + 1.0))[:, None, None]


def _parzen(x: np.ndarray) -> np.ndarray:
    x = np.abs(x)
    return np.where(x <= 0.5, 1.0 - 6.0 * x**2 * (1.0 - x), 2.0 * (1.0 - np.minimum(x, 1.0)) ** 3)


def corrected_covariance(
    D: Float[np.ndarray, "k k"],
    S: Float[np.ndarray, "n c k"],
    R: Float[np.ndarray, " c"],
    residual: Float[np.ndarray, "n c"],
    manoeuvre: Int[np.ndarray, " n"],
    start: Bool[np.ndarray, " n"],
) -> Float[np.ndarray, "k k"]:
    """D [sum_i S_i' R^-1 sum_j Rvv(i-j) R^-1 S_j] D with D = (sum S' R^-1 S)^-1, manoeuvre by manoeuvre.

    Source: corrected bound of Morelli and Klein, J. Aircraft 1997; Rvv is the residuals' autocovariance. Manoeuvres
    are taken as independent. Where samples are left out (`start` inside a manoeuvre) only whole stretches count as
    neighbours, and the autocovariance is that of the longest stretch.
    """
    W = S / R[:, None]
    total = np.zeros_like(D)
    for number in np.unique(manoeuvre):
        inside = np.flatnonzero(manoeuvre == number)
        stretches = np.split(inside, np.flatnonzero(start[inside])[1:])
        longest = max(stretches, key=len)
        lags = max(1, int(LAG_SHARE * len(longest)))
        covariance = autocovariance(residual[longest], lags)
        for stretch in stretches:
            total += _sandwich(W[stretch], covariance)
    return D @ total @ D


def _sandwich(W: Float[np.ndarray, "n c k"], covariance: Float[np.ndarray, "m c c"]) -> Float[np.ndarray, "k k"]:
    """sum_ij W_i' Rvv(i-j) W_j by convolution over time."""
    n, lags = W.shape[0], (covariance.shape[0] - 1) // 2
    size = int(next_fast_len(n + 2 * lags) or n + 2 * lags)
    kernel = np.zeros((size, covariance.shape[1], covariance.shape[2]))
    kernel[np.arange(-lags, lags + 1)] = covariance
    spread = np.fft.irfft(
        np.einsum("fij,fjk->fik", np.fft.rfft(kernel, axis=0), np.fft.rfft(W, size, axis=0)), size, axis=0
    )[:n]
    return np.einsum("nci,ncj->ij", W, spread)


def standard_error_of_sum(values: Float[np.ndarray, " m"], lengths: Sequence[int]) -> float:
    """Standard error of the sum of an autocorrelated series of constant mean with independent stretches.

    From the autocovariance up to `LAG_SHARE` of each stretch, tapered by Parzen's window as in
    `corrected_covariance`. It is too small where the correlation time is nearly as long as that.
    """
    centred = (values - values.mean())[:, None]
    parts = np.split(centred, np.cumsum(lengths)[:-1])
    variance = sum(len(part) * autocovariance(part, max(1, int(LAG_SHARE * len(part)))).sum() for part in parts)
    return float(np.sqrt(variance * len(values) / (len(values) - 1)))
