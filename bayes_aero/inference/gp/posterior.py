"""Posterior of the hyperparameters: train a stand-in, sample it, check it, remove its error."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import jax
import numpy as np
import xarray as xr
from arviz_base import from_dict
from jaxtyping import Float, Int

from bayes_aero.inference.gp.emulator import Emulator, ExactPoint, ReducedData, fit_emulator, stats_and_gradient
from bayes_aero.inference.gp.kernel import Priors, Scaling, hyper_names, noise_to_signal
from bayes_aero.inference.gp.optimum import Optimum, ProfilePosterior, curvature
from bayes_aero.inference.gp.sampling import (
    K_LIMIT,
    TEMPER,
    Chains,
    SampleStatus,
    Settings,
    Weighted,
    compiled_posterior,
    join,
    reweight,
    sample_emulated,
    thin,
)

DESIGN_SPREAD = 1.4  # the design is drawn this many times wider than the Laplace approximation
# A stand-in whose log density scatters by more is trained further, 12 gradients, before 128 exact draws judge it: on
# CD a scatter of 0.16 was refused after them.
PILOT_ERROR = 0.1
MAX_GAP = 30.0  # nats below the best point, beyond which a point no longer trains the stand-in


class Budget(NamedTuple):
    """Budget of the sampling: design points and pilots cost a gradient, exact draws a factorisation each;
    rounds of training at most, and extensions of a NUTS run that has not mixed."""

    design: int = 52
    pilots: int = 12
    exact: int = 128
    rounds: int = 8
    extensions: int = 2
    nuts: Settings = Settings()


class Sampled(NamedTuple):
    """Outcome: the NUTS chains on the stand-in, the exactly weighted draws (None if never reached) and verdict."""

    chains: Chains
    weighted: Weighted | None
    emulator: Emulator
    status: SampleStatus
    rounds: int


def sample_posterior(
    optimum: Optimum,
    data: ReducedData,
    priors: Priors,
    *,
    budget: Budget = Budget(),
    seed: int = 0,
    tell: Callable[[str], None] = lambda _: None,
) -> Sampled:
    """Draws of theta from the exact posterior around `optimum`, or the reason why there are none."""
    rng = np.random.default_rng(seed)
    covariance, points = curvature(optimum, data, priors)
    root = np.linalg.cholesky(covariance)
    while len(points) < budget.design:
        u = optimum.u + DESIGN_SPREAD * root @ rng.normal(size=optimum.u.size)
        points.append(ExactPoint(u, *stats_and_gradient(u, data)))
        tell(f"training the stand-in: {len(points)} of {budget.design}")
    for number in range(1, budget.rounds + 1):
        usable = [p for p in points if p.stats.ok]
        profile = ProfilePosterior(data, priors, optimum.theta[: data.x.shape[1] + 2].copy())
        level = np.array([profile.inner(p.u, p.stats).value for p in usable])
        kept = level > np.max(level) - MAX_GAP  # very improbable points would distort the stand-in
        emulator = fit_emulator([p for p, k in zip(usable, kept, strict=True) if k], level[kept])
        run = partial(sample_emulated, optimum.theta, emulator, data.n, priors, budget.nuts)
        tell(f"NUTS, round {number}")
        chains = run(seed + 100 * number)
        pilots, error = _pilot(chains, data, priors, budget.pilots, rng)
        points += pilots
        tell(f"round {number}: the stand-in errs by {error:.2g} in log density")
        last = number == budget.rounds
        if not last and not error < PILOT_ERROR:
            continue
        for again in range(1, budget.extensions + 1):
            if not chains.mixed:
                tell(f"NUTS, round {number}, extension {again}")
                chains = join(chains, run(seed + 100 * number + again, chains.theta[:, -1]))
        if not chains.mixed:
            if not last:  # a rough stand-in holds chains up; the pilots smooth the next one
                continue
            return Sampled(chains, None, emulator, SampleStatus.not_mixed, number)
        weighted = reweight(*thin(chains, budget.exact), data, priors, tell)
        if last or weighted.status is SampleStatus.accepted:
            return Sampled(chains, weighted, emulator, weighted.status, number)
        flat = weighted.theta.reshape(-1, weighted.theta.shape[-1])  # refused: values without derivatives train, too
        points += [ExactPoint(noise_to_signal(t), s, None) for t, s in zip(flat, weighted.stats, strict=False)]
    raise AssertionError("the last round returns")


def _pilot(
    chains: Chains, data: ReducedData, priors: Priors, count: int, rng: np.random.Generator
) -> tuple[list[ExactPoint], float]:
    """A few exact points at random draws, and the scatter of the stand-in's error over them (inf if any failed)."""
    flat = chains.theta.reshape(-1, chains.theta.shape[-1])
    at = rng.choice(len(flat), count, replace=False)
    us = [noise_to_signal(t) for t in flat[at]]
    points = [ExactPoint(u, *stats_and_gradient(u, data)) for u in us]
    if not all(p.stats.ok for p in points):
        return points, np.inf
    density = compiled_posterior(priors)
    pairs = zip(flat[at], points, strict=True)
    exact = np.array([density(t, p.stats.logdet, p.stats.gram, float(data.n))[0] for t, p in pairs], float)
    return points, float(np.std(exact - chains.log_density.ravel()[at] / TEMPER))


# --- The sampled hyperparameters as an ArviZ DataTree, in physical units.


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
        "k_limit": K_LIMIT,
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
