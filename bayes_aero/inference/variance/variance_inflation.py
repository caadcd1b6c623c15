"""Variance inflation: the factor by which autocorrelated residuals increase variances; likelihoods divided by it."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float


def variance_inflation(variance: Float[np.ndarray, " k"], white: Float[np.ndarray, " k"]) -> Float[np.ndarray, " k"]:
    """Variance of each estimate over that for white residuals; 1 where the latter is zero."""
    return np.divide(variance, white, out=np.ones_like(white), where=white > 0.0)


def median_inflation(inflation: Float[np.ndarray, " k"]) -> float:
    """Median of the variance inflation of several estimates, at least 1."""
    return max(1.0, float(np.median(inflation))) if len(inflation) else 1.0


def nats(deviance: float, inflation: float) -> float:
    """Log likelihood of a decrease of the deviance of white residuals, divided by the variance inflation (at least 1).

    A likelihood divided by `inflation` has about the variances of estimates under autocorrelated residuals.
    """
    return deviance / (2.0 * max(inflation, 1.0))
