"""What the colour of a simulation's residuals costs: how many times it multiplies variances."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from bayes_aero.inference.likelihood.output_error_result import THINNED, OutputErrorResult
from bayes_aero.inference.variance.coloured_bounds import corrected_covariance


def variance_inflation(fit: OutputErrorResult) -> tuple[float, Float[np.ndarray, " k"]]:
    """How many times the residuals' colour multiplies the parameters' variances: median, and each.

    From Morelli and Klein's corrected covariance on means over `THINNED` samples (of white residuals a fifth of the
    variance is left there); the segments' states are among the parameters, unless they are fixed.
    """
    flown, k = fit.flown, len(fit.estimate)
    residual, S = fit.thinned[..., 0], fit.thinned[..., 1:]
    if fit.priors.fixed:
        S = S[..., :k]
    m = S.shape[1]
    inside = flown.inside[:, : m * THINNED].reshape(len(S), m, THINNED).all(axis=2)
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
    ratio = np.full(k, np.nan)
    places = np.flatnonzero(used[:k])
    ratio[places] = (np.diag(corrected) / np.diag(D))[: len(places)]
    if not len(places):  # the flights say nothing of any parameter
        return 1.0, ratio
    return max(1.0, THINNED * float(np.nanmedian(ratio))), ratio * THINNED
