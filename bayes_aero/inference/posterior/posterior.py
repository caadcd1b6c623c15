"""A sampled posterior: draws as an ArviZ DataTree, diagnostics, a status."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from pathlib import Path

import numpy as np
import xarray as xr
from jaxtyping import Float

from bayes_aero.atomic_write import write_whole


class PosteriorStatus(Enum):
    """Whether the draws may be used; the value is the text for the user."""

    CONVERGED = "converged"
    NOT_CONVERGED = (
        "not converged: R-hat or effective sample size missed its target; run longer, do not use the intervals"
    )
    DIVERGENT = "divergent transitions: the sampler could not follow the posterior; its tails are not trusted"


@dataclass(frozen=True)
class Marginal:
    """One parameter's posterior: mean, standard deviation, equal-tailed 95 % interval and diagnostics."""

    mean: float
    sd: float
    ci95: tuple[float, float]
    ess_bulk: float
    ess_tail: float
    rhat: float

    @property
    def ess(self) -> float:
        """Effective sample size of centre or tails, whichever is smaller."""
        return min(self.ess_bulk, self.ess_tail)


@dataclass(frozen=True)
class Posterior:
    """Draws of one sampler, in SI and radians.

    Attributes:
        engine: `emcee` or `nuts`.
        noise: noise model.
        names: the k parameters.
        tree: groups posterior, sample_stats, log_likelihood, prior, posterior_predictive and prior_predictive.
        marginals: by parameter.
        status: whether the draws may be used.
        seconds: run time, s.
    """

    engine: str
    noise: str
    names: tuple[str, ...]
    tree: xr.DataTree
    marginals: dict[str, Marginal]
    status: PosteriorStatus
    seconds: float

    def draws(self) -> Float[np.ndarray, "m k"]:
        """All draws, shape (m, k): chains one after the other, columns as `names`."""
        posterior = self.tree["posterior"].to_dataset()
        return np.stack([np.asarray(posterior[name]).reshape(-1) for name in self.names], axis=1)

    @property
    def covariance(self) -> Float[np.ndarray, "k k"]:
        """Posterior covariance of the parameters, shape (k, k)."""
        return np.cov(self.draws().T)

    def most_correlated(self, count: int) -> list[str]:
        """Names, in their order, of the `count` parameters whose largest correlation with another is largest."""
        size = np.abs(np.corrcoef(self.draws().T)) - np.eye(len(self.names))
        chosen = set(np.argsort(-size.max(axis=1), kind="stable")[:count].tolist())
        return [name for i, name in enumerate(self.names) if i in chosen]

    def save(self, path: Path) -> None:
        """Write `tree` to `path` as NetCDF, whole or not at all."""
        encoding = {
            f"/{group}": {name: {"zlib": True, "complevel": 4} for name in node.data_vars}
            for group, node in self.tree.children.items()
            if group in ("log_likelihood", "posterior_predictive", "prior_predictive")
        }
        write_whole(self.tree.to_netcdf(engine="h5netcdf", encoding=encoding), path)
