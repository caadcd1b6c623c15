"""What manoeuvres say of the next flight: the aircraft, the scatter between manoeuvres, each manoeuvre pooled."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import xarray as xr
from scipy.stats import chi2

from bayes_aero.atomic_write import write_whole
from bayes_aero.inference.posterior.posterior import Marginal, PosteriorStatus
from bayes_aero.parameter import Parameter


@dataclass(frozen=True)
class NextFlight:
    """Partial pooling of manoeuvres, in SI and radians.

    Every manoeuvre enters by the normal approximation of its own fit. Where the prior is lognormal, the logarithm
    scatters, and `scatter` is that times the aircraft's value.
    """

    parameters: tuple[Parameter, ...]
    manoeuvres: tuple[str, ...]  # those that count
    alone: dict[str, dict[str, tuple[float, float]]]  # estimate, corrected standard error: what a record determines
    pooled: dict[str, dict[str, Marginal]]  # by manoeuvre and parameter
    aircraft: dict[str, Marginal]  # the value around which manoeuvres scatter
    scatter: dict[str, Marginal]  # standard deviation between manoeuvres
    following: dict[str, Marginal]  # the value in a flight not yet flown
    narrowed: dict[str, float]  # deviation of the scatter over its prior's: 1 where the records say nothing of it
    undetermined: dict[str, tuple[str, ...]]  # the manoeuvres whose records say less of it than the prior
    left_out: dict[str, str]  # manoeuvres without a usable fit, with the reason
    tree: xr.DataTree  # groups `posterior` (aircraft, scatter, next_flight, manoeuvre) and `sample_stats`
    status: PosteriorStatus  # whether the draws of the scatter may be used
    seconds: float  # run time

    @property
    def at_best(self) -> tuple[float, float]:
        """95 % interval of the scatter over the estimates' own, were each manoeuvre known exactly (chi-square)."""
        free = len(self.manoeuvres) - 1
        low, high = (float((free / chi2.ppf(q, free)) ** 0.5) for q in (0.975, 0.025))
        return low, high

    def save(self, path: Path) -> None:
        """Write the draws to `path` as NetCDF, whole or not at all."""
        write_whole(self.tree.to_netcdf(engine="h5netcdf"), path)
