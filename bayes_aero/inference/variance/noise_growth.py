"""How much more simulated outputs miss where the flow has separated: buffet, and a model at its roughest.

Taken as steady, the noise of minutes of quiet flight makes a few seconds of stall decide every parameter.
"""

from __future__ import annotations

from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float
from scipy.optimize import minimize_scalar

from bayes_aero.inference.likelihood.output_error import trajectories
from bayes_aero.inference.likelihood.output_error_result import OutputErrorResult, OutputErrorStatus

MOST = 30.0  # times the noise of attached flow that may be added at full separation; our choice
MOVES = 0.05  # range of X over a record below which it says nothing of separated flow


@dataclass(frozen=True)
class SeparatedFlow:
    """What a fit leaves of each output, and how far the flow is apart then: 1 - X, between 0 and 1."""

    residual: Float[np.ndarray, "w n c"]
    apart: Float[np.ndarray, "w n"]
    inside: Bool[np.ndarray, "w n"]

    @classmethod
    def of(cls, fit: OutputErrorResult) -> SeparatedFlow | None:
        """None where the flow does not separate, or the model cannot fly."""
        if fit.status is OutputErrorStatus.LEFT_ENVELOPE or not np.isfinite(fit.cost):
            return None
        flown = fit.flown
        found = trajectories(flown, jnp.asarray(fit.estimate), jnp.asarray(fit.departure))
        if "X" not in found.trajectory.outputs:
            return None
        apart = np.clip(1.0 - np.asarray(found.trajectory.outputs["X"]), 0.0, 1.0)
        if np.ptp(apart[flown.inside]) < MOVES:
            return None
        return cls(np.asarray(found.residual), apart, flown.inside)

    def growths(self, without: int | None = None) -> Float[np.ndarray, " c"]:
        """b of every output, from all segments or from all but one."""
        counts = self.inside.copy()
        if without is not None:
            counts[without] = False
        return np.array([_growth(self.residual[counts, c], self.apart[counts]) for c in range(self.residual.shape[2])])

    def noise_growth(self, without: int | None = None) -> Float[np.ndarray, "w n c"]:
        """1 + b (1 - X)."""
        return 1.0 + self.growths(without) * self.apart[:, :, None]


def _growth(residual: Float[np.ndarray, " m"], apart: Float[np.ndarray, " m"]) -> float:
    """Most likely b of independent normal residuals whose deviation is proportional to 1 + b (1 - X); none below zero.

    Colour makes it less certain than it looks, not larger or smaller on the whole.
    """

    def cost(b: float) -> float:
        size = 1.0 + b * apart
        return 0.5 * np.log(np.mean((residual / size) ** 2)) + np.mean(np.log(size))

    if not residual.any():  # nothing missed, or nothing there
        return 0.0
    found = minimize_scalar(cost, bounds=(0.0, MOST), method="bounded")
    return float(found.x) if found.fun < cost(0.0) else 0.0
