"""Noise of coefficients that grows as the flow separates."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from bayes_aero.diagnosis.screening.autocorrelation import autocorrelation_of
from bayes_aero.diagnosis.screening.regression import Fit
from bayes_aero.diagnosis.screening.selection_state import SelectionState
from bayes_aero.inference.variance.autoregression import ORDER


def noise_growth_of(state: SelectionState, fit: Fit) -> Float[np.ndarray, "m c"]:
    """Growth of each coefficient's noise with separation, 1 + b (1 - X), b >= 0, from the innovations' size.

    Least squares of |innovation| on 1 - X; noise of flight-path outputs does not grow.
    """
    coefficients = state.responses.model.coefficients
    if not set(state.outputs) & set(coefficients):
        return np.ones_like(state.residual)
    _, known = state.responses.evaluate(state.theta)
    apart = 1.0 - np.asarray(state.responses.block(known["X"]))
    residual = state.left(fit) * state.noise_growth
    colour = autocorrelation_of(residual, state.folds)
    noise_growth = np.ones_like(residual)
    for c, name in enumerate(state.outputs):
        if name not in coefficients or np.ptp(apart) < 0.05:
            continue
        size, x = [], []
        for fold in state.folds:
            r = residual[fold, c]
            past = np.stack([r[ORDER - i : len(r) - i] for i in range(1, ORDER + 1)])
            size.append(np.abs(r[ORDER:] - colour.phi[c] @ past))
            x.append(apart[fold][ORDER:])
        innovation = np.concatenate(size)
        slope, level = np.polyfit(np.concatenate(x), np.minimum(innovation, 10 * np.median(innovation)), 1)
        if level > 0.0:
            noise_growth[:, c] = 1.0 + max(0.0, slope / level) * apart
    return noise_growth
