"""Variance inflation: by how much autocorrelated residuals multiply variances, and what it does to likelihoods."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float


def variance_inflation(variance: Float[np.ndarray, " k"], white: Float[np.ndarray, " k"]) -> Float[np.ndarray, " k"]:
    """Of each estimate, its variance over the one that white residuals would leave; 1 where these leave none."""
    return np.divide(variance, white, out=np.ones_like(white), where=white > 0.0)


def typical(inflation: Float[np.ndarray, " k"]) -> float:
    """Median of the variance inflation of several estimates, no less than that of white residuals."""
    return max(1.0, float(np.median(inflation))) if len(inflation) else 1.0


def nats(deviance: float, inflation: float) -> float:
    """Log likelihood that a decrease of the deviance of white residuals is worth.

    A likelihood that counts each sample for one in `inflation` has about the variances that autocorrelated residuals
    leave. What is below that of white residuals counts as theirs.
    """
    return deviance / (2.0 * max(inflation, 1.0))
