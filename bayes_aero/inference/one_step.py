"""Whether a filter's one-step predictions are calibrated: shares of innovations inside predictive intervals.

Each innovation is predicted from the samples before it and from the outputs before it in its own sample. Where model
and noise are right, innovations over their predicted standard deviations are independent and standard normal, and
their probability integral transforms are uniform. Process noise and measurement noise make the mean of their squares
near 1 where they were fitted to the same record: shares then judge the shape of the distribution. Sources: Dawid 1984,
J. R. Stat. Soc. A 147, 278; Diebold, Gunther and Tay 1998, Int. Econ. Rev. 39, 863.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float
from scipy.special import betainc
from scipy.stats import beta, norm

from bayes_aero.dynamics.filtering.innovations import neighbour_correlation
from bayes_aero.dynamics.filtering.kalman import Filtered
from bayes_aero.inference.scores import COLOURED_INNOVATIONS, Calibration, OneStep, Predicted, Share
from bayes_aero.inference.variance.coloured_bounds import deviation_of_sum

LEVELS = (0.5, 0.9, 0.95, 0.99)  # of central predictive intervals
CHANCE = 0.05  # that shares of calibrated predictions, of all outputs and levels together, are said to depart
FEWEST = 30  # independent innovations below which nothing is judged; our choice
SCORES = np.arange(-3.0, 3.01, 0.25)  # normal scores at which quantiles are compared
TAIL = 2.0  # innovations that a quantile must have beyond it
TINY = 1e-12


def transform(found: Filtered) -> Float[np.ndarray, "w n c"]:
    """Probability integral transform Phi(e / sqrt(S)) of every innovation, NaN where nothing was measured."""
    return norm.cdf(_standardised(found))


def one_step(found: Filtered, errors: Float[np.ndarray, "w n c"], outputs: Sequence[str]) -> OneStep:
    """One-step predictions of segments that were filtered.

    Args:
        found: of `innovations.filtered`, (w, ...) in front.
        errors: measured minus predicted from the samples before, (w, n, c), SI, as `innovations.prediction_errors`.
        outputs: names of the c outputs; one that has less than two innovations is left out.
    """
    z, u, correlation = _standardised(found), transform(found), neighbour_correlation(found)
    kept = [c for c in range(len(outputs)) if np.isfinite(z[..., c]).sum() > 1]
    tests = len(LEVELS) * (len(kept) + (len(kept) > 1))
    told = {}
    for c in kept:
        rms = float(np.sqrt(np.nanmean(np.square(np.asarray(errors)[..., c]))))
        told[outputs[c]] = _predicted(
            z[..., [c]], u[..., [c]], rms, bool(abs(correlation[c]) > COLOURED_INNOVATIONS), tests
        )
    return OneStep(told, _predicted(z[..., kept], u[..., kept], None, False, tests))


def _standardised(found: Filtered) -> Float[np.ndarray, "w n c"]:
    z = np.asarray(found.innovation) / np.sqrt(np.asarray(found.variance))
    return np.where(np.asarray(found.used), z, np.nan)


def _predicted(
    z: Float[np.ndarray, "w n c"],
    u: Float[np.ndarray, "w n c"],
    rms: float | None,
    coloured: bool,
    tests: int,
) -> Predicted:
    there = np.isfinite(z)
    n, squares = int(there.sum()), np.where(there, np.square(z), 0.0)
    mean = squares.sum() / n
    away = np.where(there, squares - mean, 0.0)
    inflation = _inflation(away, there) or 1.0
    ratio = float(np.sqrt(mean))
    ratio_sd = float(np.sqrt(inflation * np.sum(away**2)) / n) / max(2.0 * ratio, TINY)
    shares, independent = [], n / inflation
    for level in LEVELS:
        inside = there & (np.abs(u - 0.5) <= 0.5 * level)
        share = float(inside.sum() / n)
        inflation = _inflation(np.where(there, inside - share, 0.0), there) or inflation
        spread = max(share * (1.0 - share), level * (1.0 - level))
        shares.append(Share(level, share, float(np.sqrt(inflation * spread / n)), _p(level, share, n / inflation)))
        independent = min(independent, n / inflation)
    calibration = _judged(shares, coloured, independent, tests)
    return Predicted(n, rms, (ratio, ratio_sd), tuple(shares), calibration, _quantiles(z, n))


def _inflation(away: Float[np.ndarray, "w n c"], there: Bool[np.ndarray, "w n c"]) -> float | None:
    """Variance inflation of the sum of `away` (mean zero, zero where nothing was measured): by autocorrelation, and by
    what the outputs of a sample have in common. Less than that of independent ones counts as theirs; None without any.
    """
    white = float(np.sum(away**2))
    if white <= TINY:
        return None
    lengths = [int(np.max(np.flatnonzero(some), initial=-1)) + 1 for some in np.any(there, axis=2)]
    series = np.concatenate([one[:length].sum(axis=1) for one, length in zip(away, lengths, strict=True)])
    return max(1.0, deviation_of_sum(series, [length for length in lengths if length]) ** 2 / white)


def _p(level: float, share: float, n: float) -> float:
    """Two-sided p-value of a share of `n` independent innovations: binomial, by the beta distribution where `n` is no
    whole number."""
    missed, chance = (1.0 - share) * n, 1.0 - level
    at_most = float(betainc(max(n - missed, TINY), missed + 1.0, level))
    at_least = float(betainc(max(missed, TINY), n - missed + 1.0, chance))
    return min(1.0, 2.0 * min(at_most, at_least))


def _judged(shares: Sequence[Share], coloured: bool, independent: float, tests: int) -> Calibration:
    apart = [s.share - s.level for s in shares if s.p < CHANCE / tests]
    if coloured and not apart:
        return Calibration.COLOURED
    if independent < FEWEST:
        return Calibration.UNDECIDED
    if not apart:
        return Calibration.CALIBRATED
    if max(apart) < 0.0:
        return Calibration.TOO_NARROW
    return Calibration.TOO_WIDE if min(apart) > 0.0 else Calibration.NOT_NORMAL


def _quantiles(z: Float[np.ndarray, "w n c"], n: int) -> Float[np.ndarray, "m 4"]:
    """See `Predicted`; order statistics of as many uniform values as there are independent innovations (Bonferroni)."""
    there = np.isfinite(z)
    scores = SCORES[n * norm.sf(np.abs(SCORES)) >= TAIL]
    found, p = np.quantile(z[there], norm.cdf(scores)), norm.cdf(scores)
    tail, rows = 0.5 * CHANCE / max(len(scores), 1), []
    for score, value, q in zip(scores, found, p, strict=True):
        below = there & (z <= value)
        independent = n / (_inflation(np.where(there, below - below.sum() / n, 0.0), there) or 1.0)
        band = beta.ppf([tail, 1.0 - tail], q * (independent + 1.0), (1.0 - q) * (independent + 1.0))
        rows.append([score, value, *norm.ppf(band)])
    return np.array(rows).reshape(-1, 4)
