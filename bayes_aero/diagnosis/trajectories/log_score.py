"""Log score of a simulation on hold-out flights."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from bayes_aero.diagnosis.trajectories.results import Path
from bayes_aero.inference.scores import log_density, log_score_gain, log_score_gains


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
        """Log density of every sample, all outputs together."""
        return self.densities().sum(axis=1)

    def densities(self) -> Float[np.ndarray, "m c"]:
        """Log density of every sample by output but for what the noise_growth adds: normal, with the variance that the
        residuals themselves have."""
        r = np.concatenate(self.residual)
        return log_density(r, np.mean(r**2, axis=0))


def holdout_gain(before: HoldoutScore, after: HoldoutScore, variance_inflation: float) -> tuple[float, float]:
    """Log density that `after` has beyond `before` on the same segments, over the variance inflation; deviation."""
    return log_score_gain(before.density(), after.density(), variance_inflation, [len(r) for r in before.residual])


def output_gains(
    names: Sequence[str], before: HoldoutScore, after: HoldoutScore, variance_inflation: float
) -> dict[str, tuple[float, float]]:
    """`holdout_gain` of each output by itself."""
    lengths = [len(r) for r in before.residual]
    return log_score_gains(names, before.densities(), after.densities(), variance_inflation, lengths)
