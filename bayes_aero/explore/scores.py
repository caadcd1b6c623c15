"""How near a simulation is to the flight in a window of time."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

Series = Mapping[str, Float[np.ndarray, " n"]]


@dataclass(frozen=True)
class Score:
    """One output in a window, SI: RMS error of the result and now; share inside the tolerance (None: it has none)."""

    name: str
    before: float
    now: float
    within_before: float | None = None
    within: float | None = None


def scores(
    recorded: Series, before: Series, now: Series, window: Bool[np.ndarray, " n"], tolerances: Mapping[str, float]
) -> list[Score]:
    """One for each output that is `now` there, over the samples of `window`."""
    found = []
    for name, y in now.items():
        old, new = (np.abs(recorded[name] - x)[window] for x in (before[name], y))
        band = tolerances.get(name)
        shares = (None, None) if band is None else (float(np.mean(old <= band)), float(np.mean(new <= band)))
        found.append(Score(name, _rms(old), _rms(new), *shares))
    return found


def gain(
    recorded: Series,
    before: Series,
    now: Series,
    window: Bool[np.ndarray, " n"],
    deviations: Mapping[str, float],
    inflation: float,
) -> float:
    """Change of the log likelihood from the result to now, nats.

    Args:
        recorded: outputs (n,).
        before: simulated by the result.
        now: simulated now.
        window: samples that count.
        deviations: standard deviation of the normal residuals of each output that counts.
        inflation: samples that count for one, because residuals are coloured.

    Source:
        Jategaonkar, Flight Vehicle System Identification, 2nd ed. 2015, eq. 4.11, with a diagonal covariance.
    """
    total = 0.0
    for name, sd in deviations.items():
        old, new = (((recorded[name] - x)[window] / sd) ** 2 for x in (before[name], now[name]))
        total += 0.5 * float(np.sum(old) - np.sum(new))
    return total / inflation


def _rms(x: Float[np.ndarray, " n"]) -> float:
    return float(np.sqrt(np.mean(x**2))) if len(x) else float("nan")
