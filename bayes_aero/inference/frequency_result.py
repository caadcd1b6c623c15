"""What a fit in the frequency domain gives."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Complex, Float


@dataclass(frozen=True)
class FrequencyFit:
    """Estimates in a band, SI and radians.

    Attributes:
        method: equation error or output error.
        band: lowest and highest frequency, Hz.
        lines: number of frequencies, of all manoeuvres together.
        names: the parameters that the band shows, (k,).
        units: of these.
        estimate: their values.
        covariance: Cramer-Rao covariance (k, k), for residuals of one variance at all lines.
        corrected: the same with the variances of the lines themselves; contains the squared bias.
        bias: by recording noise in the regressors, (k,); it is subtracted from the estimate. None: not subtracted.
        inner: inner products of the sensitivities by output, (k, k).
        R: variance of the residuals by output; white noise has the same at the samples.
        unseen: free parameters that drop out with bias and drift.
        at_bound: parameters that the band would move beyond a bound, and that are held there.
        converged: whether the numbers mean something.
        apart: differences from the fit in the time domain, in standard errors of the difference, by parameter.
    """

    method: str
    band: tuple[float, float]
    lines: int
    names: tuple[str, ...]
    units: tuple[str, ...]
    estimate: Float[np.ndarray, " k"]
    covariance: Float[np.ndarray, "k k"]
    corrected: Float[np.ndarray, "k k"]
    inner: Mapping[str, Float[np.ndarray, "k k"]]
    R: Mapping[str, float]
    unseen: tuple[str, ...]
    converged: bool
    at_bound: tuple[str, ...] = ()
    bias: Float[np.ndarray, " k"] | None = None
    apart: Mapping[str, float] = field(default_factory=dict)

    @property
    def crb(self) -> Float[np.ndarray, " k"]:
        """Cramer-Rao standard errors."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def crb_corrected(self) -> Float[np.ndarray, " k"]:
        """Standard errors with the variances of the lines."""
        return np.sqrt(np.diag(self.corrected))


@dataclass(frozen=True)
class FrequencyResponse:
    """An output over an input at frequencies (f,), Hz; SI.

    `measured` by cross spectra, with its standard `error`; `coherence` of the output with all inputs; `modelled` by the
    estimates in the band and by `draws` of them (d, f).
    """

    input: str
    output: str
    frequency: Float[np.ndarray, " f"]
    measured: Complex[np.ndarray, " f"]
    error: Float[np.ndarray, " f"]
    coherence: Float[np.ndarray, " f"]
    modelled: Complex[np.ndarray, " f"]
    draws: Complex[np.ndarray, "d f"]
