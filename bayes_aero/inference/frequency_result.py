"""What a fit in the frequency domain gives."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Complex, Float


@dataclass(frozen=True)
class FrequencyFit:
    """Estimates in a band, SI and radians."""

    method: str  # equation error or output error
    band: tuple[float, float]  # lowest and highest frequency, Hz
    lines: int  # number of frequencies, of all manoeuvres together
    names: tuple[str, ...]  # of the parameters that the band shows
    units: tuple[str, ...]
    estimate: Float[np.ndarray, " k"]
    covariance: Float[np.ndarray, "k k"]  # of Cramer and Rao, for residuals of one variance at all lines
    corrected: Float[np.ndarray, "k k"]  # with the variances of the lines themselves, and the squared bias
    inner: Mapping[str, Float[np.ndarray, "k k"]]  # inner products of the sensitivities by output
    R: Mapping[str, float]  # variance of the residuals by output; white noise has the same at the samples
    unseen: tuple[str, ...]  # free parameters that drop out with bias and drift
    converged: bool
    at_bound: tuple[str, ...] = ()  # parameters that the band would move beyond a bound, and that are held there
    bias: Float[np.ndarray, " k"] | None = None  # by noise of the regressors, subtracted; None: not computed
    apart: Mapping[str, float] = field(default_factory=dict)  # from the time domain, in standard errors of that

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
    """An output over an input at frequencies (f,), Hz; SI."""

    input: str
    output: str
    frequency: Float[np.ndarray, " f"]
    measured: Complex[np.ndarray, " f"]  # by cross spectra
    error: Float[np.ndarray, " f"]  # standard error
    coherence: Float[np.ndarray, " f"]  # of the output with all inputs
    modelled: Complex[np.ndarray, " f"]  # by the estimates in the band
    draws: Complex[np.ndarray, "d f"]  # by draws of them
