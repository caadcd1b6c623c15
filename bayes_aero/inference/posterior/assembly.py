"""A posterior from the draws of a sampler: marginals with diagnostics, and predictions."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import NamedTuple

import arviz_base as azb
import arviz_stats as azs
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from bayes_aero.inference.posterior.posterior import Marginal, Posterior, PosteriorStatus
from bayes_aero.model.density import Density
from bayes_aero.model.log_density import LogDensity

TARGET_ESS = 400.0
TARGET_RHAT = 1.01
PREDICTIVE_DRAWS = 50  # per chain, for the groups with one value per sample
PREDICTIVE_VALUES = 20_000_000  # of each of these groups; a record of 200,000 samples keeps fewer draws


class Drawn(NamedTuple):
    """Draws x (chain, draw, k) of a sampler, its statistics and, if known, the marginals."""

    engine: str
    x: Float[np.ndarray, "chain draw k"]
    stats: Mapping[str, np.ndarray] = MappingProxyType({})
    marginals: dict[str, Marginal] | None = None
    divergent: bool = False


def diagnose(draws: Float[np.ndarray, "chain draw k"], names: tuple[str, ...]) -> dict[str, Marginal]:
    """Marginal summaries with ArviZ's rank-normalised R-hat and bulk effective sample size."""
    dataset = azb.from_dict({"posterior": {name: draws[..., i] for i, name in enumerate(names)}})["posterior"].dataset
    ess, tail, rhat = azs.ess(dataset), azs.ess(dataset, method="tail"), azs.rhat(dataset)
    found = {}
    for i, name in enumerate(names):
        flat = draws[..., i].ravel()
        low, high = np.quantile(flat, [0.025, 0.975])
        found[name] = Marginal(
            mean=float(flat.mean()),
            sd=float(flat.std(ddof=1)),
            ci95=(float(low), float(high)),
            ess_bulk=float(ess[name]),
            ess_tail=float(tail[name]),
            rhat=float(rhat[name]),
        )
    return found


def converged(marginals: dict[str, Marginal]) -> bool:
    """Every parameter reaches the targets of effective sample size (bulk and tail) and R-hat."""
    return all(m.ess >= TARGET_ESS and m.rhat <= TARGET_RHAT for m in marginals.values())


@eqx.filter_jit
def constrain_draws(density: LogDensity, u: Float[Array, "chain draw k"]) -> Float[Array, "chain draw k"]:
    """x of every u."""
    return jax.vmap(jax.vmap(density.constrain))(u)


@eqx.filter_jit
def _predictive(density: Density, x: Float[Array, "m k"], white: Float[Array, "m n c"]):
    """Log-likelihood per sample and replicated coefficients for each row of x; both (m, n, c)."""
    return jax.lax.map(lambda pair: (density.pointwise(pair[0]), density.replicate(*pair)), (x, white))


def assemble(density: LogDensity, drawn: Drawn, *, seed: int, seconds: float, predictive: bool = True) -> Posterior:
    """Turn draws of x into a `Posterior`.

    The groups with one value per sample (log_likelihood, posterior_predictive, prior_predictive) hold an evenly
    thinned share of the draws, in single precision, to keep the file small. `log_likelihood` is conditional on the
    samples before: under coloured noise LOO on it measures one-step prediction, not interpolation.
    """
    names, draws = density.names, drawn.x
    groups: dict[str, dict[str, np.ndarray]] = {"posterior": {name: draws[..., i] for i, name in enumerate(names)}}
    if drawn.stats:
        groups["sample_stats"] = dict(drawn.stats)
    rng = np.random.default_rng(seed)
    prior = density.sample_prior(rng, 1000)
    groups["prior"] = {name: prior[None, :, i] for i, name in enumerate(names)}
    dims: dict[str, list[str]] = {}
    if predictive and isinstance(density, Density):
        groups |= _sample_groups(density, draws, prior, rng)
        dims = {name: ["instant"] for name in density.model.coefficients}
    tree = azb.from_dict(groups, dims=dims)
    tree.attrs |= {"engine": drawn.engine, "noise": density.noise_label, "seed": seed}
    for parameter in density.parameters:
        for group in ("posterior", "prior"):
            tree[group][parameter.name].attrs["units"] = parameter.unit
    marginals = drawn.marginals or diagnose(draws, names)
    status = PosteriorStatus.CONVERGED if converged(marginals) else PosteriorStatus.NOT_CONVERGED
    status = PosteriorStatus.DIVERGENT if drawn.divergent else status
    return Posterior(drawn.engine, density.noise_label, names, tree, marginals, status, seconds)


def _sample_groups(
    density: Density, draws: np.ndarray, prior: np.ndarray, rng: np.random.Generator
) -> dict[str, dict[str, np.ndarray]]:
    (chains, length, size), names = draws.shape, density.model.coefficients
    most = PREDICTIVE_VALUES // (len(names) * chains * density.observations.n)
    kept = min(PREDICTIVE_DRAWS, length, max(2, most))
    thin = np.linspace(0, length - 1, kept).astype(int)
    shape = (chains, kept, density.observations.n, len(names))
    white = rng.standard_normal((chains * kept, *shape[2:]))
    loglik, replicated = _predictive(density, jnp.asarray(draws[:, thin].reshape(-1, size)), jnp.asarray(white))
    _, prior_replicated = _predictive(density, jnp.asarray(prior[: chains * kept]), jnp.asarray(white))

    def split(values: Array, leading: tuple[int, int]) -> dict[str, np.ndarray]:
        array = np.asarray(values, np.float32).reshape(*leading, *shape[2:])
        return {name: array[..., i] for i, name in enumerate(names)}

    return {
        "log_likelihood": split(loglik, shape[:2]),
        "posterior_predictive": split(replicated, shape[:2]),
        "prior_predictive": split(prior_replicated, (1, chains * kept)),
        "observed_data": {name: np.asarray(density.observations.measured[:, i]) for i, name in enumerate(names)},
    }
