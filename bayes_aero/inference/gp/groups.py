"""The sampled hyperparameters as an ArviZ DataTree, in physical units."""

import jax
import numpy as np
import xarray as xr
from arviz_base import from_dict
from jaxtyping import Float, Int

from bayes_aero.inference.gp.kernel import Scaling, hyper_names
from bayes_aero.inference.gp.posterior import Sampled
from bayes_aero.inference.gp.priors import Priors
from bayes_aero.inference.gp.sampling.sample import TEMPER

__all__ = ["posterior_tree", "systematic_resample"]

PRIOR_DRAWS = 2000


def systematic_resample(log_weight: Float[np.ndarray, "chains draws"], seed: int) -> Int[np.ndarray, " total"]:
    """Flat indices of as many equally weighted draws as there are weights, in order (systematic resampling)."""
    edges = np.cumsum(np.exp(log_weight.ravel()))
    positions = (np.random.default_rng(seed).uniform() + np.arange(edges.size)) / edges.size
    return np.minimum(np.searchsorted(edges / edges[-1], positions), edges.size - 1)


def posterior_tree(
    sampled: Sampled,
    at: Int[np.ndarray, " total"],
    scaling: Scaling,
    priors: Priors,
    names: tuple[str, ...],
    output_name: str,
    seed: int,
) -> xr.DataTree:
    """Groups: `posterior`, draws of the exact posterior with equal weights (the indices `at` of the weighted
    ones) and `sample_stats` of these; `prior`; `proposal`, the weighted draws before resampling, with their exact
    and stand-in log densities and PSIS log weights; `stand_in`, the full NUTS chains of theta, drawn
    from the stand-in to the power `variance_inflation`. Hyperparameters in
    physical units (`Scaling.physical`), save theta, which is log scaled.
    """
    weighted, chains = sampled.weighted, sampled.chains
    if weighted is None:
        raise ValueError("nothing was weighted")
    shape = weighted.exact.shape
    drawn = weighted.theta.reshape(-1, weighted.theta.shape[-1])[at].reshape(weighted.theta.shape)
    prior = np.asarray(priors.sample(jax.random.PRNGKey(seed), len(names), PRIOR_DRAWS))[None]
    groups = {
        "posterior": scaling.physical(drawn),
        "sample_stats": {
            "lp": weighted.exact.ravel()[at].reshape(shape),
            "proposal_index": at.reshape(shape),
        },
        "prior": scaling.physical(prior),
        "proposal": {
            **scaling.physical(weighted.theta),
            "lp": weighted.exact,
            "lp_stand_in": weighted.stand_in / TEMPER,
            "log_weight": weighted.log_weight,
        },
        "stand_in": {"theta": chains.theta, "lp": chains.log_density / TEMPER},
    }
    per_input = {"linear": ["input"], "length_scale": ["input"], "theta": ["hyperparameter"]}
    coords = {"input": list(names), "hyperparameter": hyper_names(names)}
    tree = from_dict(groups, dims=per_input, coords=coords)
    tree["stand_in"] = (
        tree["stand_in"]
        .to_dataset()
        .assign(rhat=("hyperparameter", chains.rhat), ess_bulk=("hyperparameter", chains.ess))
    )
    facts = {
        "k_hat": weighted.k_hat,
        "k_limit": weighted.k_limit,
        "weight_ess": weighted.ess,
        "rounds": sampled.rounds,
        "divergences": chains.divergences,
        "variance_inflation": TEMPER,
        "status": sampled.status.name,
        "output_name": output_name,
        "output_rms": scaling.rms,
        "input_mean": scaling.mean,
        "input_sd": scaling.sd,
    }
    tree.attrs.update(facts)
    tree["sample_stats"].attrs.update({"pareto_k": weighted.k_hat, "status": sampled.status.name})
    return tree
