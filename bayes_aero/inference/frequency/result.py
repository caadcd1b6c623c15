"""What a fit in the frequency domain gives."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float


@dataclass(frozen=True)
class FrequencyFit:
    """Estimates in a band, SI and radians.

    Attributes:
        band: lowest and highest frequency, Hz.
        lines: frequencies of all manoeuvres together.
        names: the parameters that the band shows, (k,).
        units: of these.
        estimate: their values.
        covariance: Cramer-Rao covariance (k, k), for residuals of one variance at all lines.
        corrected: the same with the variances of the lines themselves.
        information: of these parameters in the band, over the variances of the residuals (k, k).
        R: variance of the residuals by output; white noise at the samples has the same.
        unseen: free parameters that drop out with bias and drift.
        converged: whether the numbers mean something.
    """

    band: tuple[float, float]
    lines: int
    names: tuple[str, ...]
    units: tuple[str, ...]
    estimate: Float[np.ndarray, " k"]
    covariance: Float[np.ndarray, "k k"]
    corrected: Float[np.ndarray, "k k"]
    R: dict[str, float]
    unseen: tuple[str, ...]
    converged: bool

    @property
    def crb(self) -> Float[np.ndarray, " k"]:
        """Cramer-Rao standard errors."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def crb_corrected(self) -> Float[np.ndarray, " k"]:
        """Standard errors with the variances of the lines."""
        return np.sqrt(np.diag(self.corrected))
