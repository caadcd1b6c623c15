"""Covariance from the scatter between blocks of a record, for any autocorrelation within a block.

Two other variances differ. `robust_bounds` corrects each block by its leverage (HC3) and not by their number, and
`coloured_bounds.standard_error_of_sum` has no blocks.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int


def cluster_covariance(
    contributions: Float[np.ndarray, "m k"], block: Int[np.ndarray, " m"]
) -> Float[np.ndarray, "k k"]:
    """Covariance of a sum whose expectation is zero: n/(n - 1) sum_g s_g s_g' with the sums s_g of n blocks.

    Args:
        contributions: to the sum, of each sample; residuals of a fit, weighed by sensitivities, give that of the score.
        block: of each sample, 0 to n - 1.

    Source: Liang and Zeger, Biometrika 73 (1986) 13.
    """
    count = int(block.max()) + 1
    sums = np.zeros((count, contributions.shape[1]))
    np.add.at(sums, block, contributions)
    return sums.T @ sums * count / (count - 1.0)


def jackknife_covariance(moves: Float[np.ndarray, "n k"]) -> Float[np.ndarray, "k k"]:
    """Covariance of an estimate from its `moves` when each of n blocks is left out: (n - 1)/n sum_g d_g d_g'.

    A block that alone determines a parameter has no residual in its direction. `cluster_covariance` takes this for
    agreement; the jackknife does not.

    Source: Bell and McCaffrey, Survey Methodology 28 (2002) 169, for moves from the estimate by all blocks; Efron and
    Tibshirani, An Introduction to the Bootstrap (1993), ch. 11, for moves from their mean.
    """
    return moves.T @ moves * (len(moves) - 1.0) / len(moves)
