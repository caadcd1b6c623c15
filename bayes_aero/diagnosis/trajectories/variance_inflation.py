"""Variance inflation of a fit to trajectories."""

from __future__ import annotations

import numpy as np

from bayes_aero.inference.likelihood.output_error_result import THINNING, OutputErrorResult
from bayes_aero.inference.variance.coloured_bounds import corrected_covariance
from bayes_aero.inference.variance.variance_inflation import median_inflation, variance_inflation


def trajectory_variance_inflation(fit: OutputErrorResult) -> float:
    """Variance inflation in the median over the parameters.

    From Morelli and Klein's corrected covariance on means over `THINNING` samples (of white residuals a fifth of the
    variance is left there); the segments' states are among the parameters, unless they are fixed.
    """
    flown, k = fit.flown, len(fit.estimate)
    residual, S = fit.thinned_columns[..., 0], fit.thinned_columns[..., 1:]
    if fit.priors.fixed:
        S = S[..., :k]
    m = S.shape[1]
    inside = flown.inside[:, : m * THINNING].reshape(len(S), m, THINNING).all(axis=2)
    w, n, c, wide = S.shape
    own = np.zeros((w, n, c, k + w * (wide - k)))
    own[..., :k] = S[..., :k]
    for row in range(w):
        begin = k + row * (wide - k)
        own[row, :, :, begin : begin + wide - k] = S[row, :, :, k:]
    keep = inside.ravel()
    flat, r = own.reshape(w * n, c, -1)[keep], residual.reshape(w * n, c)[keep]
    start = np.concatenate([[True], np.diff(np.repeat(np.arange(w), n)[keep]) != 0])
    information = np.einsum("nci,c,ncj->ij", flat, 1.0 / fit.R, flat, optimize=True)
    used = np.diag(information) > 0.0
    scale = np.sqrt(np.diag(information)[used])
    D = np.linalg.pinv(information[np.ix_(used, used)] / np.outer(scale, scale), rcond=1e-10, hermitian=True)
    D = D / np.outer(scale, scale)
    corrected = corrected_covariance(D, flat[:, :, used], fit.R, r, np.repeat(np.arange(w), n)[keep], start)
    parameters = int(np.sum(used[:k]))
    return median_inflation(THINNING * variance_inflation(np.diag(corrected), np.diag(D))[:parameters])
