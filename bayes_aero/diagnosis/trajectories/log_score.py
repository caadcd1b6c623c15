"""Log score of a simulation on hold-out flights."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from bayes_aero.diagnosis.trajectories.results import Path
from bayes_aero.inference.scores import log_density, log_score_gain


@dataclass(frozen=True)
class HoldoutScore:
    """What is missed of every segment, flown by a fit to the others, divided by `noise_growth`.

    `inside`: the flight stayed in the envelope.
    """

    residual: tuple[Float[np.ndarray, "_ c"], ...]
    inside: bool = True

    @classmethod
    def of(
        cls, paths: Sequence[Path], outputs: Sequence[str], noise_growth: Sequence[Float[np.ndarray, "_ c"]]
    ) -> HoldoutScore:
        """From simulated segments, in order."""
        left = [np.stack([p.measured[n] - p.simulated[n] for n in outputs], axis=1) for p in paths]
        return cls(tuple(x / s for x, s in zip(left, noise_growth, strict=True)), all(p.inside for p in paths))

    def density(self) -> Float[np.ndarray, " m"]:
        """Log density of every sample but for what the noise_growth adds: normal, with the variance that the residuals
        themselves have, output by output."""
        r = np.concatenate(self.residual)
        return log_density(r, np.mean(r**2, axis=0)).sum(axis=1)


def holdout_gain(before: HoldoutScore, after: HoldoutScore, variance_inflation: float) -> tuple[float, float]:
    """Log density that `after` has beyond `before` on the same segments, over the variance inflation; deviation."""
    return log_score_gain(before.density(), after.density(), variance_inflation, [len(r) for r in before.residual])
