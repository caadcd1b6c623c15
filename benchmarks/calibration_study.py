"""Simulation-based calibration: over data drawn from the prior, is the truth's rank among posterior draws uniform?"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
from jaxtyping import Float
from ranks import DRAWS, band_of, rank

from bayes_aero.inference.gp.groups import systematic_resample
from bayes_aero.inference.gp.kernel import hyper_names
from bayes_aero.inference.gp.optimum import find_map
from bayes_aero.inference.gp.posterior import Budget, sample_posterior
from bayes_aero.inference.gp.priors import Priors
from bayes_aero.inference.gp.reduced import ReducedData
from bayes_aero.inference.gp.sampling.reweight import SampleStatus
from bayes_aero.inference.gp.sampling.sample import Settings
from bayes_aero.inference.likelihood.mle import fit_mle
from bayes_aero.inference.posterior.ensemble import sample_ensemble
from bayes_aero.inference.posterior.laplace import density_start, search_modes
from bayes_aero.inference.posterior.nuts import sample_nuts
from bayes_aero.inference.posterior.posterior import Posterior
from bayes_aero.model.density import Density
from bayes_aero.model.model import Model
from bayes_aero.model.noise import Colour, Noise
from bayes_aero.model.observations import Observations

ENGINES: dict[str, Callable[..., Posterior]] = {"emcee": sample_ensemble, "NUTS": sample_nuts}


@dataclass(frozen=True)
class Replicate:
    """The truth's ranks among `DRAWS` draws, by parameter, and how the sampler says it ended."""

    seed: int
    ranks: Mapping[str, int]
    status: str


def stall_replicate(model: Model, observations: Observations, engine: str, seed: int) -> Replicate:
    """Parameters and AR(1) noise drawn from their priors, coefficients simulated, inferred as a user would.

    `observations` lend their signals only.
    """
    rng = np.random.default_rng([seed, 5])
    maker = Density(observations, model, Noise(Colour.AR1))
    x = maker.sample_prior(rng, 1)[0]
    white = jnp.asarray(rng.standard_normal((observations.n, 3)))
    data = observations.with_measured(maker.replicate(jnp.asarray(x), white))
    density = Density(data, model, Noise(Colour.AR1))
    mode = search_modes(density, density_start(density, fit_mle(model, data, seed=seed)), data.n, seed=seed)
    posterior = ENGINES[engine](density, mode, seed=seed, predictive=False)
    shuffled = rng.permutation(posterior.draws())
    return Replicate(
        seed, dict(zip(density.names, map(int, rank(x, shuffled)), strict=True)), posterior.status.name.lower()
    )


def process_replicate(inputs: Float[np.ndarray, "n d"], names: tuple[str, ...], seed: int) -> Replicate:
    """Hyperparameters drawn from their priors, a sample function with noise, sampled through the stand-in.

    `inputs` in deviations. Draws are those that exact weights resample; where they were refused, the stand-in's.
    """
    rng, priors = np.random.default_rng([seed, 6]), Priors()
    d = inputs.shape[1]
    theta = np.asarray(priors.sample(jax.random.PRNGKey(seed), d, 1))[0]
    y = np.linalg.cholesky(covariance(theta, inputs)) @ rng.standard_normal(len(inputs))
    data = ReducedData.of(inputs, y)
    best = find_map(data, priors, starts=4, polish=1, seed=seed)[0]
    found = sample_posterior(best, data, priors, budget=Budget(exact=400, nuts=Settings(300, 500, 4)), seed=seed)
    flat = found.chains.theta.reshape(-1, theta.size)
    if found.weighted is not None and found.status is SampleStatus.accepted:
        drawn = found.weighted.theta.reshape(-1, theta.size)
        flat = drawn[systematic_resample(found.weighted.log_weight, seed)]
    own = rank(theta, rng.permutation(flat))
    return Replicate(seed, dict(zip(hyper_names(names), map(int, own), strict=True)), found.status.name)


def covariance(theta: Float[np.ndarray, " p"], x: Float[np.ndarray, "n d"]) -> Float[np.ndarray, "n n"]:
    """Constant, linear, squared exponential and noise, written out: independent of the engine that it tests."""
    d = x.shape[1]
    constant, linear, signal = np.exp(theta[0]), np.exp(theta[1 : d + 1]), np.exp(theta[d + 1])
    length, noise = np.exp(theta[d + 2 : 2 * d + 2]), np.exp(theta[-1])
    scaled = x / length
    squared = ((scaled[:, None] - scaled[None]) ** 2).sum(axis=2)
    K = constant**2 + (x * linear) @ (x * linear).T + signal**2 * np.exp(-0.5 * squared)
    return K + noise**2 * np.eye(len(x))


def calibration_table(replicates: Sequence[Replicate]) -> pd.DataFrame:
    """A row per parameter: mean rank (0.5 wanted), share that 50 and 90 % intervals cover, inside the band or not."""
    rows = {}
    for name in replicates[0].ranks:
        ranks = np.array([r.ranks[name] for r in replicates])
        place = (ranks + 0.5) / (DRAWS + 1)
        rows[name] = {
            "replicates": len(ranks),
            "mean rank": place.mean(),
            "in 50 %": np.mean(np.abs(place - 0.5) <= 0.25),
            "in 90 %": np.mean(np.abs(place - 0.5) <= 0.45),
            "inside band": band_of(list(map(int, ranks))).inside,
        }
    return pd.DataFrame.from_dict(rows, orient="index")
