"""The posterior by NumPyro's NUTS: the independent check on the one density."""

from __future__ import annotations

import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cache, partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int
from numpyro.infer.hmc import HMCState, hmc
from numpyro.infer.hmc_util import dual_averaging

from bayes_aero.dynamics.kalman import NoisePoint, innovations_density
from bayes_aero.dynamics.segments import SegmentTrajectories
from bayes_aero.inference.ensemble import (
    Drawn,
    EnsembleLength,
    PosteriorMode,
    assemble,
    constrain_draws,
    converged,
    diagnose,
    find_mode,
    inside,
    sample_ensemble,
)
from bayes_aero.inference.output_error import FIRST_F, FIRST_R
from bayes_aero.inference.output_error_result import initial_state_sd
from bayes_aero.inference.prediction_error import PredictionErrorResult
from bayes_aero.inference.results import Posterior
from bayes_aero.model.noise import LogDensity
from bayes_aero.parameter import Parameter, Prior
from bayes_aero.processes import cores
from bayes_aero.progress import Progress

CALL_DRAWS = 100  # draws of one compiled call; warm-up and blocks are rounded up to a multiple
BLOCK_DRAWS = 300  # draws per chain between two checks of the diagnostics
DIVERGENT_SHARE = 0.005
FIRST_STEP = 0.5  # on the scale of the curvature at the mode, where no metric is adapted
FIELDS = ("diverging", "num_steps", "accept_prob", "potential_energy")


class WarmUp(NamedTuple):
    """Steps; acceptance to which the step size is adapted; whether a dense metric is adapted, too."""

    # A metric of few steps is worse than the curvature at the mode, on whose scale the chains begin: the covariance of
    # 75 draws of 26 independent normal coordinates has deviations of 0.4 to 1.6. Without a metric the step size is
    # adapted here, because NumPyro takes it from the last tenth of a short warm-up, which it begins with ten times the
    # step.
    steps: int = 500
    acceptance: float = 0.95
    metric: bool = True


class Chain(NamedTuple):
    """State of NumPyro's kernel, and of the dual averaging of the step size (of Hoffman and Gelman 2014)."""

    kernel: HMCState
    averaged: tuple[Any, ...]

    def with_step(self, size: Array) -> Chain:
        """Another step size."""
        return self._replace(kernel=self.kernel._replace(adapt_state=self.kernel.adapt_state._replace(step_size=size)))


@cache
def _kernel(warmup: WarmUp):
    """NumPyro's functional NUTS, with the data as arguments: MCMC would compile again for every data set and chain."""
    # One for each warm-up, which the kernel stores when it starts.
    del warmup
    potential = lambda density, centre, factor: lambda v: -density(centre + factor @ v)  # noqa: E731
    return hmc(potential_fn_gen=potential, algo="NUTS")


Target = tuple[LogDensity, Array, Array]
"""A density, with the centre and the factor of its whitened coordinates."""


@eqx.filter_jit
def _start_chain(target: Target, warmup: WarmUp, key: Array, v: Float[Array, " k"]) -> Chain:
    begin, _ = _kernel(warmup)
    key, _ = jax.random.split(key)  # as numpyro's NUTS does: the same draws
    setting: Any = {"target_accept_prob": warmup.acceptance, "model_args": target, "rng_key": key}
    if warmup.metric:
        setting |= {"dense_mass": True}
    else:
        setting |= {"adapt_step_size": False, "adapt_mass_matrix": False, "step_size": FIRST_STEP}
    first: Any = dual_averaging()[0]
    return Chain(begin(v, warmup.steps, **setting), first(jnp.log(FIRST_STEP)))


@eqx.filter_jit
def _draw_steps(
    target: Target, warmup: WarmUp, adapting: Array, chain: Chain
) -> tuple[Chain, tuple[Array, dict[str, Array]]]:
    _, sample = _kernel(warmup)
    _, update = dual_averaging()

    def step(chain: Chain, _: None):
        state = sample(chain.kernel, target)  # adapts a metric for as long as state.i is below the steps of `warmup`
        drawn = state.z, {name: getattr(state, name) for name in FIELDS}
        if warmup.metric:
            return chain._replace(kernel=state), drawn
        chain = Chain(state, update(warmup.acceptance - state.accept_prob, chain.averaged))
        return chain.with_step(jnp.where(adapting, jnp.exp(chain.averaged[0]), state.adapt_state.step_size)), drawn

    return jax.lax.scan(step, chain, None, length=CALL_DRAWS)


class NutsLength(NamedTuple):
    """Chains, their warm-up, and the most blocks of draws that follow it."""

    chains: int = 4
    warmup: WarmUp = WarmUp()
    max_blocks: int = 8


def sample_nuts(
    density: LogDensity,
    mode: PosteriorMode,
    *,
    seed: int = 0,
    length: NutsLength = NutsLength(),
    progress: Progress | None = None,
    predictive: bool = True,
) -> Posterior:
    """Sample in blocks until every parameter reaches the targets of ESS and R-hat, at most `max_blocks` of them."""
    # Works on coordinates whitened by the curvature at the mode; starts are drawn from that Laplace approximation, each
    # chain its own, so that R-hat can see a second mode nearby. `progress(text, share)` is called after every block.
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
    stats = {
        name: np.concatenate([f[field] for f in chains.statistics], axis=1)
        for name, field in zip(("diverging", "n_steps", "acceptance_rate", "lp"), FIELDS, strict=True)
    }
    stats["lp"] = -stats["lp"]
    divergent = float(stats["diverging"].mean()) > DIVERGENT_SHARE
    drawn = Drawn("nuts", x, stats, marginals, divergent)
    return assemble(density, drawn, seed=seed, seconds=time.perf_counter() - began, predictive=predictive)


class _Chains:
    """Chains after their warm-up, with draws `x` and the statistics of NUTS."""

    def __init__(self, density: LogDensity, mode: PosteriorMode, length: NutsLength, seed: int) -> None:
        self.density, self.mode, self.warmup = density, mode, length.warmup
        self.x: list[np.ndarray] = []
        self.statistics: list[dict[str, np.ndarray]] = []
        self.target = density, jnp.asarray(mode.u), jnp.asarray(mode.factor)
        start_key, run_key = jax.random.split(jax.random.PRNGKey(seed))
        starts = jax.random.normal(start_key, (length.chains, density.size))
        keys = jax.random.split(run_key, length.chains)
        self.chains = [_start_chain(self.target, self.warmup, key, v) for key, v in zip(keys, starts, strict=True)]
        for number in range(-(-self.warmup.steps // CALL_DRAWS)):  # the first chain starts alone and compiles
            parts = [self.chains] if number else [self.chains[:1], self.chains[1:]]
            self.chains = [chain for part in parts for chain, _ in self._advance(part, adapting=True)]
        if not self.warmup.metric:
            self.chains = [chain.with_step(jnp.exp(chain.averaged[1])) for chain in self.chains]

    def draw(self, steps: int) -> None:
        """Add `steps` draws to every chain."""
        for _ in range(steps // CALL_DRAWS):
            ends = self._advance(self.chains, adapting=False)
            self.chains = [chain for chain, _ in ends]
            v = np.stack([np.asarray(drawn) for _, (drawn, _) in ends])
            self.x.append(np.asarray(constrain_draws(self.density, jnp.asarray(self.mode.unwhiten(v)))))
            every = [statistics for _, (_, statistics) in ends]
            self.statistics.append({name: np.stack([np.asarray(one[name]) for one in every]) for name in FIELDS})

    def _advance(self, chains: list[Chain], *, adapting: bool) -> list[tuple[Chain, tuple[Array, dict[str, Array]]]]:
        with ThreadPoolExecutor(max(1, min(len(chains), cores()))) as pool:
            step = partial(_draw_steps, self.target, self.warmup, jnp.asarray(adapting))
            return list(pool.map(lambda chain: jax.block_until_ready(step(chain)), chains))


# --- The posterior of a flight fitted with process noise: parameters, process noise and measurement noise, jointly.
# The density is that of `likelihood.prediction_error`, with the parameters' priors instead of their normal
# approximations, and weak lognormal priors of the noise, so that the posterior is proper where a process noise is
# not distinguishable from zero.
# A noise or gust of hardly any size has a posterior that is flat in its logarithm below what the record can tell,
# and falls off steeply above. Samplers therefore work on the logarithm of small and on the size of large ones
# (`knee`).

ENGINES = ("emcee", "nuts")  # the faster one first
KNEE_OF_PROCESS, KNEE_OF_MEASUREMENT = 0.5, 0.03  # of the median, see `Parameter.knee`
KNEE_OF_INTENSITY = 0.05  # of the prior's width
SPREAD = 2.0  # standard deviation of the logarithm of a process or measurement noise: a factor of 50 either way, 95 %


class InnovationsDensity(LogDensity):
    """Parameters: the dynamics' free ones, F_state (process noise), sigma_output (measurement noise)."""

    flown: SegmentTrajectories
    deviation: tuple[float, ...] = eqx.field(static=True)  # of the measured initial state
    # Medians of the priors: process noise by state (0 where there is none), standard deviations of the measurement
    # noise by output; SI.
    process: tuple[float, ...] = eqx.field(static=True)
    measurement: tuple[float, ...] = eqx.field(static=True)
    noise_label = "white, of states and measurements"  # pyright: ignore[reportAssignmentType]

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Of the dynamics, of the process noise, of the measurement noise."""
        dynamics = self.flown.dynamics
        motion = []
        for p in dynamics.free:
            intensity = p.name in dynamics.disturbance_parameters and p.prior.family == "halfnormal"
            motion.append(p.changed(knee=KNEE_OF_INTENSITY * p.prior.scale) if intensity else p)  # it may reach zero
        process = [
            _noise(f"F_{name}", f"process noise of {name}, in its unit per square root of a second", x, KNEE_OF_PROCESS)
            for name, x in zip(dynamics.states, self.process, strict=True)
            if x > 0.0
        ]
        measurement = [
            _noise(f"sigma_{name}", f"standard deviation of the noise of {name}", x, KNEE_OF_MEASUREMENT)
            for name, x in zip(self.flown.outputs, self.measurement, strict=True)
        ]
        return (*motion, *process, *measurement)

    @property
    def disturbed(self) -> Int[np.ndarray, " f"]:
        """Indices of the states with process noise."""
        return np.flatnonzero(np.array(self.process) > 0.0)

    def log_likelihood(self, x: Float[Array, " k"]) -> Float[Array, ""]:
        """Log likelihood of the innovations; minus infinity where the filter diverges."""
        k, c = len(self.flown.dynamics.free), len(self.flown.outputs)
        F = jnp.zeros(len(self.process)).at[self.disturbed].set(x[k:-c])
        point = NoisePoint(x[:k], F, x[-c:] ** 2)
        total = innovations_density(self.flown, point, jnp.asarray(self.deviation))
        return jnp.where(jnp.isfinite(total), total, -jnp.inf)

    def start(self, fit: PredictionErrorResult) -> Float[np.ndarray, " k"]:
        """The fit as a point of this density, moved inside its bounds."""
        least = np.exp(-2.0 * SPREAD)  # times the median: a process noise of the fit may vanish, a lognormal does not
        F = np.maximum(fit.F, least * np.array(self.process))[self.disturbed]
        free = zip(fit.estimate, self.flown.dynamics.free, strict=True)
        return np.array([*(inside(value, p.bounds) for value, p in free), *F, *np.sqrt(fit.R)])


def _noise(name: str, text: str, median: float, knee: float) -> Parameter:
    prior = Prior("lognormal", median, SPREAD, "weak, about output error's residuals; our choice")
    return Parameter(name, "SI", 0.0, median, text, prior, (0.0, np.inf), knee=knee * median)


SHORT = WarmUp(100, acceptance=0.8, metric=False)  # on a scale that the mode gives well


class PosteriorLength(NamedTuple):
    """Chains of both samplers for densities that take milliseconds: two each, one for each core of a small machine."""

    nuts: NutsLength = NutsLength(chains=2, warmup=SHORT, max_blocks=5)
    emcee: EnsembleLength = EnsembleLength(ensembles=2, max_steps=600)


def sample_innovations(
    flown: SegmentTrajectories,
    fit: PredictionErrorResult,
    R: Float[np.ndarray, " c"],
    *,
    seed: int = 0,
    length: PosteriorLength = PosteriorLength(),
    engines: Sequence[str] = ENGINES,
    progress: Progress | None = None,
) -> dict[str, Posterior]:
    """The posterior by emcee and by NUTS, or one of these `engines`, from the `fit` (with priors) of `fit_disturbed`,
    in coordinates scaled by the curvature at the mode."""
    density = innovations_posterior(flown, R)
    mode = find_mode(density, density.start(fit))
    asked: Any = {"seed": seed, "progress": progress, "predictive": False}
    samplers = {
        "emcee": lambda: sample_ensemble(density, mode, length=length.emcee, **asked),
        "nuts": lambda: sample_nuts(density, mode, length=length.nuts, **asked),
    }
    return {engine: samplers[engine]() for engine in engines}


def innovations_posterior(flown: SegmentTrajectories, R: Float[np.ndarray, " c"]) -> InnovationsDensity:
    """The density; `R` (c,) are variances of output error's residuals. A fixed initial state has no deviation."""
    # Medians of the noise are `FIRST_F` and `FIRST_R` as at the start of the fit; states without a sensor have none.
    dynamics = flown.dynamics
    deviation = np.zeros(len(dynamics.states)) if flown.fixed is not None else initial_state_sd(dynamics)
    sd = dict(zip(flown.outputs, map(float, np.sqrt(R)), strict=True))
    process = tuple(FIRST_F * sd[name] if name in sd else 0.0 for name in dynamics.states)
    measurement = tuple(float(np.sqrt(FIRST_R)) * sd[name] for name in flown.outputs)
    return InnovationsDensity(flown.nameless, tuple(map(float, deviation)), process, measurement)
