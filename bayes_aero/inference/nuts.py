"""The posterior by NumPyro's NUTS: the independent check on the one density."""

from __future__ import annotations

import time
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from numpyro.infer import MCMC, NUTS

from bayes_aero.inference.laplace import Mode
from bayes_aero.inference.posterior import Posterior, PosteriorStatus, assemble, constrain_draws, converged, diagnose
from bayes_aero.model.density import Density

CHAINS = 4
WARMUP = 200
BLOCK = 300  # draws per chain between two looks at the diagnostics
MAX_BLOCKS = 8
DIVERGENT_SHARE = 0.005
FIELDS = ("diverging", "num_steps", "accept_prob", "potential_energy")


def sample_nuts(
    density: Density,
    mode: Mode,
    *,
    seed: int = 0,
    chains: int = CHAINS,
    warmup: int = WARMUP,
    max_blocks: int = MAX_BLOCKS,
    progress: Callable[[str, float], None] | None = None,
    predictive: bool = True,
) -> Posterior:
    """Sample in blocks until every parameter reaches the targets of ESS and R-hat, at most `max_blocks` of them.

    Works on coordinates whitened by the curvature at the mode; starts are drawn from that Laplace approximation, each
    chain its own, so that R-hat can see a second mode nearby. `progress(text, share)` is called after every block.
    """
    began = time.perf_counter()
    start_key, run_key = jax.random.split(jax.random.PRNGKey(seed))

    centre, factor = jnp.asarray(mode.u), jnp.asarray(mode.factor)

    def potential(v: Float[Array, " k"]) -> Float[Array, ""]:
        return -density(centre + factor @ v)

    mcmc = MCMC(
        NUTS(potential_fn=potential, dense_mass=False, target_accept_prob=0.8),
        num_warmup=warmup,
        num_samples=BLOCK,
        num_chains=chains,
        chain_method="sequential",
        progress_bar=False,
    )
    mcmc.run(run_key, init_params=jax.random.normal(start_key, (chains, density.size)), extra_fields=FIELDS)
    blocks, fields = [], []
    while True:
        blocks.append(
            np.asarray(
                constrain_draws(density, jnp.asarray(mode.unwhiten(np.asarray(mcmc.get_samples(group_by_chain=True)))))
            )
        )
        fields.append({k: np.asarray(v) for k, v in mcmc.get_extra_fields(group_by_chain=True).items()})
        x = np.concatenate(blocks, axis=1)
        marginals = diagnose(x, density.names)
        done = converged(marginals)
        if progress:
            least = min(m.ess_bulk for m in marginals.values())
            progress(
                f"NUTS: {x.shape[1]} draws a chain, ESS {least:.0f}",
                1.0 if done else len(blocks) / max_blocks,
            )
        if done or len(blocks) >= max_blocks:
            break
        mcmc.post_warmup_state = mcmc.last_state
        run_key, block_key = jax.random.split(run_key)
        mcmc.run(block_key, extra_fields=FIELDS)
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
