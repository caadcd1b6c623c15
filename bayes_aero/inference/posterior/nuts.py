"""The posterior by NumPyro's NUTS: the independent check on the one density."""

from __future__ import annotations

import time
from concurrent.futures import ThreadPoolExecutor
from functools import cache, partial
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from numpyro.infer.hmc import HMCState, hmc

from bayes_aero.inference.posterior.assembly import Drawn, assemble, constrain_draws, converged, diagnose
from bayes_aero.inference.posterior.laplace import Mode
from bayes_aero.inference.posterior.posterior import Posterior
from bayes_aero.inference.threads import cores
from bayes_aero.model.log_density import LogDensity
from bayes_aero.progress import Progress

CALL_DRAWS = 100  # draws of one compiled call; warm-up and blocks are rounded up to a multiple
BLOCK_DRAWS = 300  # draws per chain between two checks of the diagnostics
DIVERGENT_SHARE = 0.005
FIELDS = ("diverging", "num_steps", "accept_prob", "potential_energy")


def _potential(density: LogDensity, centre: Float[Array, " k"], factor: Float[Array, "k k"]):
    """Of whitened coordinates."""
    return lambda v: -density(centre + factor @ v)


@cache
def _kernel(warmup: int):
    """NumPyro's functional NUTS, with the data as arguments: MCMC would compile again for every data set and chain.

    One for each length of warm-up, which the kernel stores when it starts.
    """
    del warmup
    return hmc(potential_fn_gen=_potential, algo="NUTS")


@eqx.filter_jit
def _start_chain(target: tuple[LogDensity, Array, Array], warmup: int, key: Array, v: Float[Array, " k"]) -> HMCState:
    begin, _ = _kernel(warmup)
    key, _ = jax.random.split(key)  # as numpyro's NUTS does: the same draws
    return begin(v, warmup, dense_mass=True, target_accept_prob=0.95, model_args=target, rng_key=key)


@eqx.filter_jit
def _draw_steps(
    target: tuple[LogDensity, Array, Array], warmup: int, state: HMCState
) -> tuple[HMCState, tuple[Array, dict[str, Array]]]:
    _, sample = _kernel(warmup)

    def step(state: HMCState, _: None):
        state = sample(state, target)  # adapts for as long as state.i is below `warmup`
        return state, (state.z, {name: getattr(state, name) for name in FIELDS})

    return jax.lax.scan(step, state, None, length=CALL_DRAWS)


class NutsLength(NamedTuple):
    """Chains, steps of their warm-up, and the most blocks of draws that follow it."""

    chains: int = 4
    warmup: int = 500
    max_blocks: int = 8


def sample_nuts(
    density: LogDensity,
    mode: Mode,
    *,
    seed: int = 0,
    length: NutsLength = NutsLength(),
    progress: Progress | None = None,
    predictive: bool = True,
) -> Posterior:
    """Sample in blocks until every parameter reaches the targets of ESS and R-hat, at most `max_blocks` of them.

    Works on coordinates whitened by the curvature at the mode; starts are drawn from that Laplace approximation, each
    chain its own, so that R-hat can see a second mode nearby. `progress(text, share)` is called after every block.
    """
    began = time.perf_counter()
    chains = _Chains(density, mode, length, seed)
    most = length.max_blocks * BLOCK_DRAWS
    while True:
        chains.draw(BLOCK_DRAWS)
        x = np.concatenate(chains.x, axis=1)
        marginals = diagnose(x, density.names)
        done = converged(marginals) or x.shape[1] >= most
        if progress:
            least = min(m.ess_bulk for m in marginals.values())
            progress(f"NUTS: {x.shape[1]} draws a chain, ESS {least:.0f}", 1.0 if done else x.shape[1] / most)
        if done:
            break
    statistics = {name: np.concatenate([f[name] for f in chains.statistics], axis=1) for name in FIELDS}
    stats = {
        "diverging": statistics["diverging"],
        "n_steps": statistics["num_steps"],
        "acceptance_rate": statistics["accept_prob"],
        "lp": -statistics["potential_energy"],
    }
    divergent = float(statistics["diverging"].mean()) > DIVERGENT_SHARE
    drawn = Drawn("nuts", x, stats, marginals, divergent)
    return assemble(density, drawn, seed=seed, seconds=time.perf_counter() - began, predictive=predictive)


class _Chains:
    """Chains after their warm-up, with draws `x` and the statistics of NUTS."""

    def __init__(self, density: LogDensity, mode: Mode, length: NutsLength, seed: int) -> None:
        self.density, self.mode, self.warmup = density, mode, length.warmup
        self.x: list[np.ndarray] = []
        self.statistics: list[dict[str, np.ndarray]] = []
        self.target = density, jnp.asarray(mode.u), jnp.asarray(mode.factor)
        start_key, run_key = jax.random.split(jax.random.PRNGKey(seed))
        starts = jax.random.normal(start_key, (length.chains, density.size))
        keys = jax.random.split(run_key, length.chains)
        self.states = [_start_chain(self.target, self.warmup, key, v) for key, v in zip(keys, starts, strict=True)]
        for number in range(-(-self.warmup // CALL_DRAWS)):  # the first chain starts alone and compiles the program
            parts = [self.states] if number else [self.states[:1], self.states[1:]]
            self.states = [state for part in parts for state, _ in self._advance(part)]

    def draw(self, steps: int) -> None:
        """Add `steps` draws to every chain."""
        for _ in range(steps // CALL_DRAWS):
            ends = self._advance(self.states)
            self.states = [state for state, _ in ends]
            v = np.stack([np.asarray(drawn) for _, (drawn, _) in ends])
            self.x.append(np.asarray(constrain_draws(self.density, jnp.asarray(self.mode.unwhiten(v)))))
            self.statistics.append(
                {name: np.stack([np.asarray(statistics[name]) for _, (_, statistics) in ends]) for name in FIELDS}
            )

    def _advance(self, states: list[HMCState]) -> list[tuple[HMCState, tuple[Array, dict[str, Array]]]]:
        with ThreadPoolExecutor(max(1, min(len(states), cores()))) as pool:
            step = partial(_draw_steps, self.target, self.warmup)
            return list(pool.map(lambda state: jax.block_until_ready(step(state)), states))
