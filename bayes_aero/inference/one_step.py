"""Whether a filter's one-step predictions are calibrated: shares of innovations inside predictive intervals.

Each innovation is predicted from the samples before it and from the outputs before it in its own sample. Where model
and noise are right, innovations over their predicted standard deviations are independent and standard normal, and
their probability integral transforms are uniform. Where process noise and measurement noise were fitted to the same
record, the mean square of the scaled innovations is near 1, and the shares test the shape of the distribution. Sources:
Dawid 1984, J. R. Stat. Soc. A 147, 278; Diebold, Gunther and Tay 1998, Int. Econ. Rev. 39, 863.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float
from scipy.special import betainc
from scipy.stats import beta, norm

from bayes_aero.dynamics.innovations import neighbour_correlation
from bayes_aero.dynamics.kalman import Filtered
from bayes_aero.inference.covariance import standard_error_of_sum
from bayes_aero.inference.scores import COLOURED_INNOVATIONS, Calibration, OneStep, Predicted, Share

LEVELS = (0.5, 0.9, 0.95, 0.99)  # of central predictive intervals
SIGNIFICANCE = 0.05  # rate of false alarms for calibrated predictions, all outputs and levels together
MIN_INDEPENDENT = 30  # independent innovations below which calibration is undecided; our choice
NORMAL_SCORES = np.arange(-3.0, 3.01, 0.25)  # at which quantiles are compared
MIN_BEYOND = 2.0  # least number of innovations beyond a quantile
TINY = 1e-12


def probability_transform(found: Filtered) -> Float[np.ndarray, "w n c"]:
    """Probability integral transform Phi(e / sqrt(S)) of every innovation, NaN where nothing was measured."""
    return norm.cdf(_standardised(found))


def one_step(found: Filtered, errors: Float[np.ndarray, "w n c"], outputs: Sequence[str]) -> OneStep:
    """One-step predictions of filtered segments, (w, ...) in front; outputs with less than two innovations are left
    out.

    `errors`: measured minus predicted from the samples before, (w, n, c), SI, as `innovations.prediction_errors`.
    """
    z, u, correlation = _standardised(found), probability_transform(found), neighbour_correlation(found)
    columns = [c for c in range(len(outputs)) if np.isfinite(z[..., c]).sum() > 1]
    tests = len(LEVELS) * (len(columns) + (len(columns) > 1))
    by_output = {}
    for c in columns:
        rms = float(np.sqrt(np.nanmean(np.square(np.asarray(errors)[..., c]))))
        by_output[outputs[c]] = _assess(
            z[..., [c]], u[..., [c]], rms, bool(abs(correlation[c]) > COLOURED_INNOVATIONS), tests
        )
    return OneStep(by_output, _assess(z[..., columns], u[..., columns], None, False, tests))


def _standardised(found: Filtered) -> Float[np.ndarray, "w n c"]:
    z = np.asarray(found.innovation) / np.sqrt(np.asarray(found.variance))
    return np.where(np.asarray(found.used), z, np.nan)


def _assess(
    z: Float[np.ndarray, "w n c"], u: Float[np.ndarray, "w n c"], rms: float | None, coloured: bool, tests: int
) -> Predicted:
    used = np.isfinite(z)
    n, squares = int(used.sum()), np.where(used, np.square(z), 0.0)
    mean = squares.sum() / n
    centred = np.where(used, squares - mean, 0.0)
    inflation = _inflation(centred, used) or 1.0
    ratio = float(np.sqrt(mean))
    ratio_sd = float(np.sqrt(inflation * np.sum(centred**2)) / n) / max(2.0 * ratio, TINY)
    shares, independent = [], n / inflation
    for level in LEVELS:
        inside = used & (np.abs(u - 0.5) <= 0.5 * level)
        share = float(inside.sum() / n)
        inflation = _inflation(np.where(used, inside - share, 0.0), used) or inflation
        spread = max(share * (1.0 - share), level * (1.0 - level))
        # Two-sided binomial p-value of independent innovations; by the beta distribution, for they are no whole number.
        alone = n / inflation
        missed, chance = (1.0 - share) * alone, 1.0 - level
        at_most = float(betainc(max(alone - missed, TINY), missed + 1.0, level))
        at_least = float(betainc(max(missed, TINY), alone - missed + 1.0, chance))
        p = min(1.0, 2.0 * min(at_most, at_least))
        shares.append(Share(level, share, float(np.sqrt(inflation * spread / n)), p))
        independent = min(independent, alone)
    differences = [s.share - s.level for s in shares if s.p < SIGNIFICANCE / tests]
    if coloured and not differences:
        calibration = Calibration.COLOURED
    elif independent < MIN_INDEPENDENT:
        calibration = Calibration.UNDECIDED
    elif not differences:
        calibration = Calibration.CALIBRATED
    elif max(differences) < 0.0:
        calibration = Calibration.TOO_NARROW
    else:
        calibration = Calibration.TOO_WIDE if min(differences) > 0.0 else Calibration.NOT_NORMAL
    # Quantiles: order statistics of as many uniform values as there are independent innovations (Bonferroni).
    scores, rows = NORMAL_SCORES[n * norm.sf(np.abs(NORMAL_SCORES)) >= MIN_BEYOND], []
    tail, probabilities = 0.5 * SIGNIFICANCE / max(len(scores), 1), norm.cdf(scores)
    for score, value, q in zip(scores, np.quantile(z[used], probabilities), probabilities, strict=True):
        below = used & (z <= value)
        alone = n / (_inflation(np.where(used, below - below.sum() / n, 0.0), used) or 1.0)
        band = beta.ppf([tail, 1.0 - tail], q * (alone + 1.0), (1.0 - q) * (alone + 1.0))
        rows.append([score, value, *norm.ppf(band)])
    return Predicted(n, rms, (ratio, ratio_sd), tuple(shares), calibration, np.array(rows).reshape(-1, 4))


def _inflation(centred: Float[np.ndarray, "w n c"], used: Bool[np.ndarray, "w n c"]) -> float | None:
    """Variance inflation of the sum of `centred`, zero where not measured, by all correlation, >= 1; None if it is
    zero.
    """
    white = float(np.sum(centred**2))
    if white <= TINY:
        return None
    lengths = [int(np.max(np.flatnonzero(some), initial=-1)) + 1 for some in np.any(used, axis=2)]
    series = np.concatenate([one[:length].sum(axis=1) for one, length in zip(centred, lengths, strict=True)])
    return max(1.0, standard_error_of_sum(series, [length for length in lengths if length]) ** 2 / white)
