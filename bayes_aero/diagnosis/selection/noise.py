"""The noise that a diagnosis leaves: its colour, growth and outliers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from bayes_aero.inference.scores import COLOURED_INNOVATIONS

# Lag-1 correlation of means over five samples, our choice from a dozen simulated flights: white noise leaves up to a
# third through the filter, and weak colour (0.5 from sample to sample) little more.
COLOURED = 0.36


@dataclass(frozen=True)
class NoiseReport:
    """Colour, growth with separation and outliers of the residuals, by coefficient."""

    lag1: Mapping[str, float]  # of means over five samples: at the recorded rate the filter makes 0.9 of white noise
    deviation: Mapping[str, float]
    noise_growth: Mapping[str, float]  # noise at full separation over that in attached flow
    outliers: Mapping[str, int]  # repaired samples by channel
    of_innovations: bool = False  # `lag1` is then that of neighbouring samples, which white noise leaves at 0

    @property
    def coloured(self) -> tuple[str, ...]:
        """Outputs whose residuals are correlated beyond what the filters of the reconstruction make."""
        if self.of_innovations:
            return tuple(name for name, r in self.lag1.items() if abs(r) > COLOURED_INNOVATIONS)
        return tuple(name for name, r in self.lag1.items() if r > COLOURED)

    @property
    def labels(self) -> tuple[str, ...]:
        """Which of colored, buffet, outliers are present."""
        found = []
        if self.coloured:
            found.append("colored")
        if max(self.noise_growth.values()) > 1.5:
            found.append("buffet")
        if sum(self.outliers.values()) > 0:
            found.append("outliers")
        return tuple(found)
