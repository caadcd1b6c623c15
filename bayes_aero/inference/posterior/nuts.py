"""The posterior by NumPyro's NUTS: the independent check on the one density."""

from __future__ import annotations

import time
from concurrent.futures import ThreadPoolExecutor
from functools import cache

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from numpyro.infer.hmc import HMCState, hmc

from bayes_aero.inference.posterior.laplace import Mode
from bayes_aero.inference.posterior.posterior import (
    Posterior,
    PosteriorStatus,
    assemble,
    constrain_draws,
    converged,
    diagnose,
)
from bayes_aero.inference.threads import cores
from bayes_aero.model.log_density import LogDensity
from bayes_aero.progress import Progress

CHAINS = 4
WARMUP = 500
STRETCH = 100  # draws of one compiled call; a warm-up or block that is no multiple runs on to the next one
BLOCK = 300  # draws per chain between two looks at the diagnostics
MAX_BLOCKS = 8
DIVERGENT_SHARE = 0.005
FIELDS = ("diverging", "num_steps", "accept_prob", "potential_energy")


def _potential(density: LogDensity, centre: Float[Array, " k"], factor: Float[Array, "k k"]):
    """Of whitened coordinates."""
    return lambda v: -density(centre + factor @ v)


@cache
def _kernel(warmup: int):
    """numpyro's functional NUTS, whose data are arguments: MCMC would compile anew for every data set, chain and block.

    One for every length of warm-up, which it keeps to itself once it was begun.
    """
    del warmup
    return hmc(potential_fn_gen=_potential, algo="NUTS")


@eqx.filter_jit
def _begin(target: tuple[LogDensity, Array, Array], warmup: int, key: Array, v: Float[Array, " k"]) -> HMCState:
    begin, _ = _kernel(warmup)
    key, _ = jax.random.split(key)  # as numpyro's NUTS does: the same draws
    return begin(v, warmup, dense_mass=True, target_accept_prob=0.95, model_args=target, rng_key=key)


@eqx.filter_jit
def _stretch(
    target: tuple[LogDensity, Array, Array], warmup: int, state: HMCState
) -> tuple[HMCState, tuple[Array, dict[str, Array]]]:
    _, sample = _kernel(warmup)

    def step(state: HMCState, _: None):
        state = sample(state, target)  # adapts for as long as state.i is below `warmup`
        return state, (state.z, {name: getattr(state, name) for name in FIELDS})

    return jax.lax.scan(step, state, None, length=STRETCH)


def sample_nuts(
    density: LogDensity,
    mode: Mode,
    *,
    seed: int = 0,
    chains: int = CHAINS,
    warmup: int = WARMUP,
    max_blocks: int = MAX_BLOCKS,
    progress: Progress | None = None,
    predictive: bool = True,
) -> Posterior:
    """Sample in blocks until every parameter reaches the targets of ESS and R-hat, at most `max_blocks` of them.

    Works on coordinates whitened by the curvature at the mode; starts are drawn from that Laplace approximation, each
    chain its own, so that R-hat can see a second mode nearby. `progress(text, share)` is called after every block.
    """
    began = time.perf_counter()
    start_key, run_key = jax.random.split(jax.random.PRNGKey(seed))
    target = density, jnp.asarray(mode.u), jnp.asarray(mode.factor)
    starts = jax.random.normal(start_key, (chains, density.size))
    states = [_begin(target, warmup, key, v) for key, v in zip(jax.random.split(run_key, chains), starts, strict=True)]

    def advance(states: list[HMCState]) -> list[tuple[HMCState, tuple[Array, dict[str, Array]]]]:
        with ThreadPoolExecutor(min(len(states), cores())) as pool:
            return list(pool.map(lambda state: jax.block_until_ready(_stretch(target, warmup, state)), states))

    for number in range(-(-warmup // STRETCH)):  # the first chain begins alone: the others find what it compiled
        ends = advance(states) if number else [*advance(states[:1]), *advance(states[1:])]
        states = [state for state, _ in ends]
    blocks, fields = [], []
    while True:
        for _ in range(BLOCK // STRETCH):
            ends = advance(states)
            states = [state for state, _ in ends]
            v = np.stack([np.asarray(drawn) for _, (drawn, _) in ends])
            blocks.append(np.asarray(constrain_draws(density, jnp.asarray(mode.unwhiten(v)))))
            fields.append({name: np.stack([np.asarray(told[name]) for _, (_, told) in ends]) for name in FIELDS})
        x = np.concatenate(blocks, axis=1)
        marginals = diagnose(x, density.names)
        done = converged(marginals) or x.shape[1] >= max_blocks * BLOCK
        if progress:
            least = min(m.ess_bulk for m in marginals.values())
            share = 1.0 if done else x.shape[1] / (max_blocks * BLOCK)
            progress(f"NUTS: {x.shape[1]} draws a chain, ESS {least:.0f}", share)
        if done:
            break
    joined = {name: np.concatenate([f[name] for f in fields], axis=1) for name in FIELDS}
    divergent = float(joined["diverging"].mean()) > DIVERGENT_SHARE
    return assemble(
        density,
        x,
        engine="nuts",
        seed=seed,
        seconds=time.perf_counter() - began,
        sample_stats={
            "diverging": joined["diverging"],
            "n_steps": joined["num_steps"],
            "acceptance_rate": joined["accept_prob"],
            "lp": -joined["potential_energy"],
        },
        marginals=marginals,
        status=PosteriorStatus.DIVERGENT if divergent else None,
        predictive=predictive,
    )
