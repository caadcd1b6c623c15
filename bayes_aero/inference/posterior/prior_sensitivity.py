"""Sensitivity of a posterior to its priors: power-scaling of prior and likelihood.

Source: Kallioinen, Paananen, Burkner and Vehtari 2024, Stat. Comput. 34, 57; `psense` of ArviZ, by Pareto-smoothed
importance weights, without sampling again.
"""

from __future__ import annotations

from enum import Enum

import arviz_base as azb
import arviz_stats as azs
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
from jaxtyping import Array, Float

from bayes_aero.inference.likelihood.restraints import SENSITIVITY_LIMIT
from bayes_aero.inference.posterior.posterior import Posterior
from bayes_aero.model.log_density import LogDensity

DRAWS = 4000


class Dependence(Enum):
    """Whether the data or the prior decide a parameter, by its two sensitivities; the value is the text for the
    user."""

    DATA = "the data decide"
    BOTH = "prior and data conflict, or the prior is informative compared with the data"
    PRIOR = "the prior decides; the record contains little information on this parameter"
    NEITHER = "neither changes it: check its chains"


def prior_sensitivity(density: LogDensity, posterior: Posterior) -> pd.DataFrame:
    """A row per parameter: sensitivity to the prior, to the likelihood, and the conclusion (`Dependence`).

    All priors are scaled together. `posterior` is one of `density`. The Monte Carlo error of the sensitivities is about
    0.01 for some thousand draws.
    """
    tree = posterior.tree["posterior"].to_dataset()
    step = max(1, tree.sizes["chain"] * tree.sizes["draw"] // DRAWS)
    x = np.stack([np.asarray(tree[name])[:, ::step] for name in density.names], axis=-1)
    prior, likelihood = (np.asarray(values) for values in _parts(density, jnp.asarray(x)))
    groups = {
        "posterior": {name: x[..., i] for i, name in enumerate(density.names)},
        "log_prior": {"all": prior},
        "log_likelihood": {"all": likelihood},
    }
    both = azb.from_dict(groups)
    found = {part: azs.psense(both, group=part) for part in ("prior", "likelihood")}
    rows = {name: {part: float(found[part][name]) for part in found} for name in density.names}
    table = pd.DataFrame.from_dict(rows, orient="index")
    table["says"] = [_dependence(*row).value for row in table.to_numpy()]
    return table


def _dependence(prior: float, likelihood: float) -> Dependence:
    if likelihood >= SENSITIVITY_LIMIT:
        return Dependence.BOTH if prior >= SENSITIVITY_LIMIT else Dependence.DATA
    return Dependence.PRIOR if prior >= SENSITIVITY_LIMIT else Dependence.NEITHER


@eqx.filter_jit
def _parts(density: LogDensity, x: Float[Array, "chain draw k"]) -> tuple[Float[Array, "chain draw"], ...]:
    one = lambda row: (density.log_prior(row), density.log_likelihood(row))  # noqa: E731
    return jax.lax.map(lambda chain: jax.lax.map(one, chain), x)
