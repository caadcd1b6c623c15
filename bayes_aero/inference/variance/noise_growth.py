"""Growth of the residuals of simulated outputs with flow separation, by buffet and by errors of the stall model.

With constant noise the small residuals of minutes of attached flow would give a few seconds of stall the largest
weight.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float
from scipy.optimize import minimize_scalar

from bayes_aero.inference.likelihood.output_error import one_by_one
from bayes_aero.inference.likelihood.output_error_result import OutputErrorResult, OutputErrorStatus

MAX_GROWTH = 30.0  # noise added at full separation, in units of the noise of attached flow; our choice
MIN_X_RANGE = 0.05  # range of X over a record below which the growth is not estimated


@dataclass(frozen=True)
class SeparatedFlow:
    """Residuals of each output, and the separated share of the flow, 1 - X, between 0 and 1."""

    residual: Float[np.ndarray, "w n c"]
    separated: Float[np.ndarray, "w n"]
    inside: Bool[np.ndarray, "w n"]

    @classmethod
    def of(cls, fit: OutputErrorResult) -> SeparatedFlow | None:
        """Of a fit; None where the flow does not separate, or the simulation leaves the envelope."""
        if fit.status is OutputErrorStatus.LEFT_ENVELOPE or not np.isfinite(fit.cost):
            return None
        flown = fit.flown
        shown, found = one_by_one(flown, jnp.asarray(fit.estimate), jnp.asarray(fit.departure))
        if not all("X" in one.trajectory.outputs for one in found.values()):
            return None
        residual, separated = np.zeros((*flown.inside.shape, len(flown.outputs))), np.zeros(flown.inside.shape)
        at = [shown.index(name) for name in flown.outputs]
        for row, one in found.items():
            residual[row] = np.asarray(one.residual[0])[:, at]
            separated[row] = np.clip(1.0 - np.asarray(one.trajectory.outputs["X"][0]), 0.0, 1.0)
        if np.ptp(separated[flown.inside]) < MIN_X_RANGE:
            return None
        return cls(residual, separated, flown.inside)

    def growths(self, without: int | None = None) -> Float[np.ndarray, " c"]:
        """b of every output, (c,), from all segments or from all but one."""
        used = self.inside.copy()
        if without is not None:
            used[without] = False
        return np.array([_growth(self.residual[used, c], self.separated[used]) for c in range(self.residual.shape[2])])

    def noise_growth(self, without: int | None = None) -> Float[np.ndarray, "w n c"]:
        """1 + b (1 - X), (w, n, c)."""
        return 1.0 + self.growths(without) * self.separated[:, :, None]


def _growth(residual: Float[np.ndarray, " m"], separated: Float[np.ndarray, " m"]) -> float:
    """Maximum-likelihood b >= 0 of normal residuals with standard deviation proportional to 1 + b (1 - X).

    Autocorrelation of the residuals increases the error of b, but does not bias it.
    """

    def cost(b: float) -> float:
        size = 1.0 + b * separated
        return 0.5 * np.log(np.mean((residual / size) ** 2)) + np.mean(np.log(size))

    if not residual.any():  # no error, or no output
        return 0.0
    found: Any = minimize_scalar(cost, bounds=(0.0, MAX_GROWTH), method="bounded")  # it has no types of its own
    return float(found.x) if found.fun < cost(0.0) else 0.0
