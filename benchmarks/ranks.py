"""Ranks of the truth among posterior draws, and the band that uniform ranks stay in.

Source: Talts, Betancourt, Simpson, Vehtari and Gelman 2018, arXiv:1804.06788; the bands of the ranks' distribution
function are simultaneous, after Sailynoja, Burkner and Vehtari 2022, Stat. Comput. 32, 32 (ArviZ).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
from arviz_stats.ecdf_utils import ecdf_pit
from jaxtyping import Float, Int

DRAWS = 99  # posterior draws that a truth is ranked among: ranks 0 to 99
BAND = 0.95  # simultaneous over the whole distribution function of one parameter
BAND_DRAWS = 10_000  # simulated rank samples behind the band


@dataclass(frozen=True)
class Band:
    """Difference between the ranks' distribution function and the uniform one, and its simultaneous band."""

    at: Float[np.ndarray, " m"]
    difference: Float[np.ndarray, " m"]
    lower: Float[np.ndarray, " m"]
    upper: Float[np.ndarray, " m"]

    @property
    def inside(self) -> bool:
        """Whether the difference stays within the band everywhere."""
        return bool(np.all((self.difference >= self.lower) & (self.difference <= self.upper)))


def rank(truth: Float[np.ndarray, " k"], draws: Float[np.ndarray, "m k"]) -> Int[np.ndarray, " k"]:
    """How many of `DRAWS` evenly thinned draws lie below the truth."""
    kept = draws[np.linspace(0, len(draws) - 1, DRAWS).astype(int)]
    return np.sum(kept < truth, axis=0)


def band_of(ranks: Sequence[int]) -> Band:
    """Difference for ranks 0 to `DRAWS`, and its band. Within its rank a truth is placed at random."""
    n = len(ranks)
    within = np.random.default_rng(0).uniform(size=n)
    share = np.sort((np.asarray(ranks) + within) / (DRAWS + 1))
    at, lower, upper = _limits(n)
    return Band(at, np.searchsorted(share, at, side="right") / n - at, lower - at, upper - at)


@cache
def _limits(n: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Where the distribution function of n uniform values is looked at, and its band there."""
    uniform = np.linspace(0.0, 1.0, n)
    at, _, lower, upper = ecdf_pit(uniform, BAND, BAND_DRAWS, rng=np.random.default_rng(1))
    return np.asarray(at), np.asarray(lower), np.asarray(upper)
