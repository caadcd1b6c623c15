"""Cramer-Rao bounds corrected for coloured residuals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Int, Shaped
from scipy.fft import next_fast_len
from scipy.optimize import nnls

LAG_SHARE = 0.2  # longest lag as a share of the shortest stretch; our choice, see `autocovariance`
BLOCK = 0.2  # s; noise is modelled in means over as much
SENSOR_MEMORY = (0.0, 0.3, 2.0)  # s: time constants of the modelled noise of a sensor; 0: white; our choice
DRAWS = 20  # of the modelled noise, for each mean


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


@dataclass(frozen=True)
class LinearFit:
    """A fit of k parameters and of the initial state of each of w segments, linear in the noise of the outputs.

    `D`: covariance of the parameters for white noise. `S`: sensitivities to them, with initial states at their optimum.
    `own`: sensitivities to initial states, whose priors have the `precision`, infinite where they are not fitted. `R`:
    variances of the residuals. Samples that are not `inside` are zeros.
    """

    D: Float[np.ndarray, "k k"]
    S: Float[np.ndarray, "w n c k"]
    own: Float[np.ndarray, "w n c s"]
    precision: Float[np.ndarray, " s"]
    R: Float[np.ndarray, " c"]
    inside: Bool[np.ndarray, "w n"]

    @cached_property
    def weights(self) -> Float[np.ndarray, "w n c k"]:
        """Derivatives of the estimates by the outputs."""
        return (self.S / self.R[:, None]) @ self.D

    @cached_property
    def _states(self) -> Float[np.ndarray, "w s s"]:
        """Covariance of the initial states at given parameters; zero where they are not fitted."""
        fitted = np.isfinite(self.precision)
        A = np.einsum("wncs,c,wnct->wst", self.own, 1.0 / self.R, self.own, optimize=True)
        A = A + np.diag(np.where(fitted, self.precision, 0.0))
        size = np.sqrt(np.einsum("wss->ws", A))
        scale = np.divide(1.0, size, out=np.zeros_like(size), where=fitted & (size > 0.0))
        scale = scale[:, :, None] * scale[:, None, :]
        return scale * np.linalg.pinv(scale * A, hermitian=True)

    def residual(self, noise: Float[np.ndarray, "... w n c"]) -> Float[np.ndarray, "... w n c"]:
        """What the fit leaves of the noise."""
        theta = np.einsum("wnck,...wnc->...k", self.weights, noise, optimize=True)
        states = np.einsum("wnct,...wnc->...wt", self.own, noise / self.R, optimize=True)
        states = np.einsum("wst,...wt->...ws", self._states, states)
        taken = np.einsum("wnck,...k->...wnc", self.S, theta, optimize=True)
        return noise - taken - np.einsum("wncs,...ws->...wnc", self.own, states, optimize=True)

    def corrected(self, residual: Float[np.ndarray, "w n c"]) -> Float[np.ndarray, " k"]:
        """Variances by `corrected_covariance`."""
        segment = np.nonzero(self.inside)[0]
        start = np.diff(segment, prepend=-1) != 0
        seen = (self.S[self.inside], self.R, residual[self.inside], segment, start)
        return np.diag(corrected_covariance(self.D, *seen))


def means(x: Shaped[np.ndarray, "w n ..."], size: int) -> Float[np.ndarray, "w m ..."]:
    """Means over `size` samples; those that remain at the end are left out."""
    whole = x.shape[1] // size * size
    return x[:, :whole].reshape(len(x), -1, size, *x.shape[2:]).mean(axis=2)


def calibration(fit: LinearFit, residual: Float[np.ndarray, "w n c"], dt: float) -> Float[np.ndarray, " k"]:
    """Variances of the estimates over those of `corrected_covariance`, (k,), for noise as the residuals show it.

    A fit takes out of the residuals what is like its sensitivities, above all what disturbs the flight and adds up in
    its motion; and the window, a fixed share of the record, leaves the variance uncertain. Both are calculated for a
    model of the noise: of each sensor, white and of first order with the time constants `SENSOR_MEMORY`, and random
    disturbances of each state, whose response is that to the initial state, later. The intensities are those with which
    the residuals, filtered by each response, have the expected mean squares after the fit.

    Source: Rao, J. Multivariate Analysis 1 (1971) 257 (intensities by expected squares); Beran, Biometrika 74 (1987)
    457 (calibration by draws of the estimated noise).

    Args:
        fit: in means over some samples.
        residual: of the outputs, in the same means.
        dt: time from one to the next, s.
    """
    (w, n, c), rng = residual.shape, np.random.default_rng(0)
    size = int(next_fast_len(2 * n) or 2 * n)
    time = dt * np.arange(n)[:, None, None]
    sensors = [np.sqrt(fit.R) * np.eye(c) * (np.exp(-time / x) if x else time == 0.0) for x in SENSOR_MEMORY]
    shapes = np.concatenate([*(np.broadcast_to(x, (w, n, c, c)) for x in sensors), fit.own], axis=3)
    norm = np.sqrt(np.einsum("wncj,c->j", shapes**2, 1.0 / fit.R))
    L = np.fft.rfft(shapes[..., norm > 0.0] / norm[norm > 0.0], size, axis=1)

    def left(intensity: Float[np.ndarray, " j"]) -> Float[np.ndarray, "d w n c"]:
        """Residuals of the fit to draws of the noise."""
        on = np.flatnonzero(intensity)
        white = rng.standard_normal((DRAWS, w, n, len(on))) * np.sqrt(intensity[on])
        spectrum = np.einsum("wfcj,dwfj->dwfc", L[..., on], np.fft.rfft(white, size, axis=2), optimize=True)
        return fit.residual(np.fft.irfft(spectrum, size, axis=2)[:, :, :n] * fit.inside[:, :, None])

    def squares(x: Float[np.ndarray, "d w n c"]) -> Float[np.ndarray, "d j"]:
        """Sums of squares of the projections on each response at each time."""
        along = np.einsum("wfcj,dwfc->dwfj", L.conj(), np.fft.rfft(x, size, axis=2), optimize=True)
        return np.sum(np.fft.irfft(along, size, axis=2)[:, :, :n] ** 2, axis=(1, 2))

    seen = squares(residual[None] / fit.R)[0]
    if not (np.all(np.isfinite(seen)) and np.all(seen > 0.0)):
        return np.ones(len(fit.D))
    expected = [squares(left(one) / fit.R).mean(axis=0) for one in np.eye(len(seen))]
    intensity = nnls(np.stack(expected, axis=1) / seen[:, None], np.ones(len(seen)), maxiter=100 * len(seen))[0]
    exact = squares(np.moveaxis(fit.weights, 3, 0)) @ intensity
    drawn = np.array([fit.corrected(x) for x in left(intensity)])
    moving = np.all(drawn > 0.0, axis=0)
    return np.where(moving, exact * np.mean(1.0 / np.where(moving, drawn, 1.0), axis=0), 1.0)
