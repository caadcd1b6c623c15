"""Scores of predictions against measurements: the four numbers and the coverages of the validation table, log scores,
and the calibration of one-step predictions."""

import enum
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from bayes_aero.arrays import AnyArray
from bayes_aero.errors import InputError
from bayes_aero.inference.covariance import standard_error_of_sum

Vector = Float[AnyArray, " n"]
Draws = Float[AnyArray, "draws points"]
OfPoints = Float[AnyArray, " points"]  # its length is checked in words
COLOURED_INNOVATIONS = 0.3  # correlation of neighbouring innovations beyond which something is not modelled; our choice


class ScoreStatus(enum.Enum):
    """Whether every score is defined; the value is the text for the user."""

    ok = "All four scores are defined."
    constant_measurement = "The measured channel does not vary: r and R2 are undefined; compare RMSE with the noise."
    constant_prediction = "The prediction does not vary: r is undefined; look at RMSE and R2."


@dataclass(frozen=True)
class Scores:
    """Scores of one predicted channel against its measurement.

    `r` is Pearson's correlation, `rmse` has the unit of the channel, `theil` is Theil's
    inequality coefficient rms(z - y)/(rms z + rms y) (0 perfect, 1 worst), `r2` is 1 - SSE/SST. A score that
    does not exist is NaN and `status` says which and why.
    """

    r: float
    rmse: float
    theil: float
    r2: float
    status: ScoreStatus = ScoreStatus.ok


class Calibration(enum.Enum):
    """Whether predictions are calibrated, and what is wrong if not."""

    CALIBRATED = "calibrated"
    TOO_NARROW = "too_narrow"
    TOO_WIDE = "too_wide"
    NOT_NORMAL = "not_normal"  # too narrow at one level, too wide at another
    COLOURED = "coloured"  # correct on average, but autocorrelated
    UNDECIDED = "undecided"


@dataclass(frozen=True)
class Share:
    """Share of the innovations inside a central predictive interval."""

    level: float  # probability of the interval
    share: float
    sd: float  # standard error, with the autocorrelation counted
    p: float  # p-value of calibrated predictions, with the autocorrelation counted


@dataclass(frozen=True)
class Predicted:
    """One-step predictions of one output, or of all outputs together."""

    count: int  # of innovations
    rms: float | None  # of measured minus predicted from the samples before, SI; None of all together
    ratio: tuple[float, float]  # rms of innovations over predicted standard deviations (1: calibrated); standard error
    shares: tuple[Share, ...]  # inside central intervals, by level
    calibration: Calibration  # by the shares and the autocorrelation
    # As rows: normal score, quantile of the innovations over their predicted standard deviations, and the band that
    # contains all quantiles of calibrated predictions with a probability of 95 %.
    quantiles: Float[np.ndarray, "m 4"]


@dataclass(frozen=True)
class OneStep:
    """One-step predictions by output, and those of all outputs together."""

    outputs: Mapping[str, Predicted]
    together: Predicted

    @property
    def status(self) -> str:
        """`calibrated`, `not_calibrated`, or `undecided` where there are too few innovations to tell."""
        found = {one.calibration for one in (*self.outputs.values(), self.together)}
        if found == {Calibration.CALIBRATED}:
            return "calibrated"
        return "undecided" if found <= {Calibration.CALIBRATED, Calibration.UNDECIDED} else "not_calibrated"


def _finite_pair(measured: Vector, predicted: OfPoints) -> tuple[np.ndarray, np.ndarray]:
    z, y = np.asarray(measured, float), np.asarray(predicted, float)
    if z.ndim != 1 or z.shape != y.shape or z.size < 2:
        raise InputError(f"Measured {z.shape} and predicted {y.shape} must be vectors of one length >= 2.")
    for name, x in (("measured", z), ("predicted", y)):
        if not np.all(np.isfinite(x)):
            at = int(np.flatnonzero(~np.isfinite(x))[0])
            raise InputError(f"The {name} channel is not finite at sample {at}; remove or repair that sample.")
    return z, y


def score(measured: Vector, predicted: OfPoints) -> Scores:
    """Scores of `predicted` (n,) against `measured` (n,), both in the unit of the channel."""
    z, y = _finite_pair(measured, predicted)
    residual = z - y
    rmse, rms_z, rms_y = (float(np.sqrt(np.mean(np.square(x)))) for x in (residual, z, y))
    size = rms_z + rms_y
    theil = rmse / size if size > 0 else 0.0
    # A spread below the rounding of the values themselves is no spread.
    z_varies = np.ptp(z) > 8 * np.finfo(float).eps * np.max(np.abs(z))
    y_varies = np.ptp(y) > 8 * np.finfo(float).eps * np.max(np.abs(y))
    r2 = 1.0 - float(np.sum(residual**2) / np.sum((z - z.mean()) ** 2)) if z_varies else float("nan")
    r = float(np.corrcoef(z, y)[0, 1]) if z_varies and y_varies else float("nan")
    status = ScoreStatus.ok
    if not z_varies:
        status = ScoreStatus.constant_measurement
    elif not y_varies:
        status = ScoreStatus.constant_prediction
    return Scores(r, rmse, theil, r2, status)


def log_density(error: Float[AnyArray, "*n"], variance: Float[AnyArray, "*#n"]) -> Float[np.ndarray, "*n"]:
    """Log density of each error of a normal prediction with this variance."""
    return -0.5 * (error**2 / variance + np.log(2.0 * np.pi * variance))


def log_score_gain(
    before: Float[np.ndarray, " m"], after: Float[np.ndarray, " m"], inflation: float, lengths: Sequence[int]
) -> tuple[float, float]:
    """Gain in log score of one prediction over another of the same hold-out data, and its standard error, nats."""
    # Log densities of m samples, in independent stretches of these `lengths`; the gain is over the variance
    # `inflation`.
    difference = (after - before) / inflation
    return float(difference.sum()), standard_error_of_sum(difference, lengths)


def log_score_gains(
    names: Sequence[str],
    before: Float[np.ndarray, "m c"],
    after: Float[np.ndarray, "m c"],
    inflation: float,
    lengths: Sequence[int],
) -> dict[str, tuple[float, float]]:
    """`log_score_gain` of each output by itself, by name; log densities are (m, c)."""
    pairs = zip(names, before.T, after.T, strict=True)
    return {name: log_score_gain(one, other, inflation, lengths) for name, one, other in pairs}


def interval_coverage(
    measured: Vector, draws: Draws, levels: tuple[float, ...] = (0.5, 0.9, 0.95)
) -> dict[float, float]:
    """Share of `measured` (n,) inside the central intervals of predictive `draws` (draws, n), by level."""
    z, y = np.asarray(measured, float), np.asarray(draws, float)
    if y.ndim != 2 or y.shape[1:] != z.shape or y.shape[0] < 2:
        raise InputError(f"Draws {y.shape} must be (draws >= 2, {z.size}) to go with {z.size} measurements.")
    _finite_pair(z, y[0])
    if not all(0 < level < 1 for level in levels):
        raise InputError(f"Interval levels {levels} must lie between 0 and 1, for instance 0.95.")
    coverage = {}
    for level in levels:
        low, high = np.quantile(y, [(1 - level) / 2, (1 + level) / 2], axis=0)
        coverage[level] = float(np.mean((z >= low) & (z <= high)))
    return coverage
