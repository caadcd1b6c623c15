"""Posteriors by samplers: where they start, the posterior mode with its curvature; emcee; NumPyro's NUTS."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from enum import Enum
from functools import cache
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.special import ndtr
from jaxtyping import Array, Bool, Float
from scipy import optimize
from scipy.stats import binom, norm

from bayes_aero.inference import results
from bayes_aero.model.observations import Colour, Density, LogDensity, Noise
from bayes_aero.processes import Compiled, side_by_side
from bayes_aero.progress import Progress, quiet

if TYPE_CHECKING:  # they take most of a second to load, which fits without a posterior do without
    import emcee
    import pandas as pd
    from numpyro.infer.hmc import HMCState

PRIOR_DRAWS, MIN_DRAWS = 8, 2  # of the prior, from which other modes are sought
MAX_SAMPLES_TIMES_DRAWS = 48_000  # fewer draws are used for longer records
MIN_OTHER_SHARE = 0.01  # of the probability, from which other modes are reported
ROUNDS_OF_CLIMBING = 12
SAME_LOG_DENSITY = 0.05  # difference of log-densities below which two modes are one; searches stop no nearer
MIN_RELATIVE_CURVATURE = 1e-8  # curvatures below this share of the largest count as this


class ModeStatus(Enum):
    """How the search for the mode ended; the value is the text for the user."""

    CONVERGED = "converged"
    NOT_CONVERGED = "the posterior mode was not reached; the samplers start from the best point found"
    FLAT = "the posterior is flat or saddle-shaped at its mode; some combination of parameters is not identified"


@dataclass(frozen=True)
class PosteriorMode:
    """`u` is the mode on the unbounded scale, `factor` the lower Cholesky factor of the inverse curvature there."""

    u: Float[np.ndarray, " k"]
    factor: Float[np.ndarray, "k k"]
    log_density: float
    status: ModeStatus
    other_share: float = 0.0  # of the probability, in other modes that `search_modes` found

    @property
    def log_mass(self) -> float:
        """Log of the probability around the mode by its Laplace approximation, without a constant."""
        return self.log_density + float(np.sum(np.log(np.diag(self.factor))))

    def unwhiten(self, v: Float[np.ndarray, "*m k"]) -> Float[np.ndarray, "*m k"]:
        """u of whitened coordinates v, in which the posterior is close to a standard normal."""
        return self.u + v @ self.factor.T


@Compiled
def _value_and_gradient(density: LogDensity, u: Float[Array, " k"]):
    return jax.value_and_grad(type(density).__call__, argnums=1)(density, u)


def _curvature(density: LogDensity, u: np.ndarray, step: np.ndarray) -> tuple[np.ndarray, bool]:
    """Lower Cholesky factor of |H|^-1 with the negative Hessian H at u; true if H is positive definite."""
    # Away from the mode H may have negative eigenvalues. Their size is still the right scale of a step (saddle-free
    # Newton), so absolute values are taken; a lower limit keeps flat directions finite.
    rows = []  # central differences of the exact gradient
    for move, size in zip(np.diag(step), step, strict=True):
        ends = (_value_and_gradient(density, jnp.asarray(u + sign * move))[1] for sign in (-1.0, 1.0))
        rows.append(np.subtract(*map(np.asarray, ends)) / (2.0 * size))
    H = (np.array(rows) + np.array(rows).T) / 2.0
    finite = np.isfinite(H).all(axis=1)
    if not finite.all():  # no density nearby in that direction: the largest curvature is taken
        largest = np.abs(np.diag(H)[finite]).max(initial=1.0)
        H = np.where(np.outer(finite, finite), H, np.diag(np.where(finite, 0.0, largest)))
    curvature = np.abs(np.diag(H))
    scale = np.sqrt(np.maximum(curvature, MIN_RELATIVE_CURVATURE**2 * curvature.max()))
    eigenvalues, vectors = np.linalg.eigh(H / np.outer(scale, scale))
    floor = MIN_RELATIVE_CURVATURE * np.abs(eigenvalues).max()
    covariance = (vectors / np.maximum(np.abs(eigenvalues), floor)) @ vectors.T / np.outer(scale, scale)
    return np.linalg.cholesky((covariance + covariance.T) / 2.0), bool(finite.all() and eigenvalues[0] > floor)


def density_start(density: LogDensity, mle: results.MleResult) -> np.ndarray:
    """Start of the search for the posterior mode: the maximum-likelihood estimate and the noise of its residuals."""
    # Estimate and prior are weighted by their precisions, because estimates with little information may be anywhere.
    deviation = dict(zip(mle.fit, np.sqrt(mle.R), strict=True))
    estimate, bound = (dict(zip(mle.names, x, strict=True)) for x in (mle.estimate, mle.crb))
    start = []
    for p in density.parameters:
        kind, _, coefficient = p.name.partition("_")
        value = p.start
        if p.name in estimate:  # the prior mean where the standard error is infinite
            mean, wide = p.prior.normal
            share = 1.0 / (1.0 + (bound[p.name] / wide) ** 2) if np.isfinite(bound[p.name]) else 0.0
            value = mean + share * (estimate[p.name] - mean)
        if kind == "sigma" and coefficient in deviation:
            value = deviation[coefficient]
        elif kind == "rho" and coefficient in mle.lag1:
            value = np.clip(mle.lag1[coefficient], -0.9, 0.9)
        start.append(inside(value, p.bounds))
    return np.array(start)


def inside(value: float, bounds: tuple[float, float]) -> float:
    """The value moved strictly inside the bounds, where the unbounded scale is finite."""
    lower, upper = bounds
    margin = 1e-3 * min(upper - lower, 1.0 + abs(value))
    return float(np.clip(value, lower + margin, upper - margin))


def find_mode(density: LogDensity, start: Float[np.ndarray, " k"]) -> PosteriorMode:
    """Maximise the log-density from `start` (x, bounded scale, strictly inside its bounds)."""

    def negative(v: np.ndarray, centre: np.ndarray, factor: np.ndarray) -> tuple[float, np.ndarray]:
        value, slope = map(np.asarray, _value_and_gradient(density, jnp.asarray(centre + factor @ v)))
        usable = np.isfinite(value) and np.isfinite(slope).all()
        return (-float(value), -factor.T @ slope) if usable else (1e300, np.zeros(len(v)))

    u, still = np.asarray(density.unconstrain(jnp.asarray(start, float))), np.zeros(len(start))
    step, options = np.full(len(u), 1e-4), {"maxiter": 200, "ftol": 1e-13}
    factor, positive_definite, cost, gain = np.eye(len(u)), False, np.inf, np.inf
    for _ in range(ROUNDS_OF_CLIMBING):  # L-BFGS, on the scale of the curvature where each round begins
        factor, positive_definite = _curvature(density, u, step)
        step = np.minimum(1e-3 * np.sqrt(np.sum(factor**2, axis=1)), 1e-2)
        cost, slope = negative(still, u, factor)
        gain = 0.5 * float(slope @ slope) if cost < 1e300 else np.inf  # that Newton's step promises
        if positive_definite and gain < 1e-7:
            break
        climbed = optimize.minimize(negative, still, (u, factor), "L-BFGS-B", jac=True, options=options)
        if not climbed.fun < cost:
            break
        u = u + factor @ climbed.x
    else:  # the last climb has left the point whose curvature is known
        factor, positive_definite = _curvature(density, u, step)
        cost, slope = negative(still, u, factor)
        gain = 0.5 * float(slope @ slope) if cost < 1e300 else np.inf
    near = ModeStatus.CONVERGED if gain < 1e-3 else ModeStatus.NOT_CONVERGED
    return PosteriorMode(u, factor, -cost, near if positive_definite else ModeStatus.FLAT)


def search_modes(
    density: LogDensity, start: Float[np.ndarray, " k"], samples: int, *, seed: int = 0, draws: int = PRIOR_DRAWS
) -> PosteriorMode:
    """The mode with most of the probability, of the modes reached from `start` and from prior draws."""
    # A sampler that starts in one mode does not find the others and still reports convergence. They are therefore
    # sought before. Fewer draws are used where there are many `samples`.
    count = max(MIN_DRAWS, min(draws, MAX_SAMPLES_TIMES_DRAWS // max(samples, 1)))
    others = density.sample_prior(np.random.default_rng([seed, 9]), count)
    modes = [find_mode(density, x) for x in (start, *others)]
    positive_definite = [mode for mode in modes if mode.status is ModeStatus.CONVERGED]
    if not positive_definite:
        return max(modes, key=lambda mode: mode.log_density)
    distinct: list[PosteriorMode] = []
    for mode in sorted(positive_definite, key=lambda mode: -mode.log_mass):
        if all(abs(mode.log_density - other.log_density) > SAME_LOG_DENSITY for other in distinct):
            distinct.append(mode)
    mass = np.exp([mode.log_mass - distinct[0].log_mass for mode in distinct])
    difference = abs(modes[0].log_density - distinct[0].log_density)
    same = modes[0].status is ModeStatus.CONVERGED and difference <= SAME_LOG_DENSITY
    return replace(modes[0] if same else distinct[0], other_share=float(1.0 - 1.0 / mass.sum()))


def other_modes(mode: PosteriorMode, where: str) -> tuple[str, ...]:
    """A sentence where other modes have more than `MIN_OTHER_SHARE` of the probability."""
    if mode.other_share < MIN_OTHER_SHARE:
        return ()
    return (
        f"{where}: the posterior has more than one mode; about {mode.other_share:.0%} of the probability lies outside "
        "the sampled one (by the modes' curvature), so the intervals may exclude other values of the parameters.",
    )


# --- The posterior by emcee: several independent ensembles on the one density.

DEGREES_OF_FREEDOM = 5.0  # of freedom of the independence proposal: tails heavier than the posterior's
INDEPENDENT = 0.7  # share of independence moves; the rest is differential evolution, which needs no good proposal
BURN_IN = 150  # steps of one round
ROUNDS = 4
MIN_ACCEPTANCE_GAIN = 1.1  # another round follows while the acceptance rises by this factor
STEPS_PER_CALL = 100
AUTOCORRELATION_TIMES = 30  # length of a run from which the estimate of its autocorrelation time is used


@Compiled
def _log_density(density: LogDensity, u: Float[Array, " k"], factor: Float[Array, "k k"], v: Float[Array, "m k"]):
    return jax.vmap(lambda row: density(u + factor @ row))(v)


def _independence_move(centre: np.ndarray, factor: np.ndarray) -> emcee.moves.MHMove:
    """Metropolis-Hastings moves proposed from one multivariate Student t, the same for every walker."""
    from emcee.moves import MHMove

    inverse = np.linalg.inv(factor)

    def log_density(v: np.ndarray) -> np.ndarray:
        squared = np.sum(((v - centre) @ inverse.T) ** 2, axis=1)
        return -0.5 * (DEGREES_OF_FREEDOM + v.shape[1]) * np.log1p(squared / DEGREES_OF_FREEDOM)

    def propose(coords: np.ndarray, random: np.random.RandomState) -> tuple[np.ndarray, np.ndarray]:
        normal = random.standard_normal(coords.shape)
        spread = np.sqrt(DEGREES_OF_FREEDOM / random.chisquare(DEGREES_OF_FREEDOM, size=(len(coords), 1)))
        proposed = centre + (normal * spread) @ factor.T
        return proposed, log_density(coords) - log_density(proposed)

    return MHMove(propose)


class EnsembleLength(NamedTuple):
    """Independent ensembles, most steps of each, walkers (default: two for each parameter and four more)."""

    ensembles: int = 4
    max_steps: int = 4000
    walkers: int | None = None


def _advance(samplers: list[emcee.EnsembleSampler], steps: int, begin: np.ndarray | None = None) -> None:
    """Advance every ensemble by `steps`, one thread a core; the density runs outside Python's lock."""
    starts = [None] * len(samplers) if begin is None else list(begin)
    side_by_side(lambda pair: pair[0].run_mcmc(pair[1], steps), zip(samplers, starts, strict=True))


def _burnt_in(
    density: LogDensity, mode: PosteriorMode, seed: int, length: EnsembleLength
) -> list[emcee.EnsembleSampler]:
    """Independent ensembles after their burn-in and their first steps."""
    import emcee

    size, walkers = density.size, length.walkers or 2 * (density.size + 2)
    frame = jnp.asarray(mode.u), jnp.asarray(mode.factor)

    def target(v: np.ndarray) -> np.ndarray:
        value = np.asarray(_log_density(density, *frame, jnp.asarray(v)))
        return np.where(np.isfinite(value), value, -np.inf)

    def sampler(centre: np.ndarray, factor: np.ndarray, own_seed: int) -> emcee.EnsembleSampler:
        moves = [(_independence_move(centre, factor), INDEPENDENT), (emcee.moves.DEMove(), 1.0 - INDEPENDENT)]
        made = emcee.EnsembleSampler(walkers, size, target, moves=moves, vectorize=True)
        made.random_state = np.random.RandomState(own_seed % 2**32).get_state()  # emcee takes this generator only
        return made

    begin = np.random.default_rng(seed).standard_normal((length.ensembles, walkers, size)) * 0.5
    proposal, before = (np.zeros(size), np.eye(size)), 0.0
    seeds = [1000 * seed + 10 * i for i in range(length.ensembles)]
    for number in range(ROUNDS):  # a skewed posterior takes several to fit the proposal to the draws
        samplers = [sampler(*proposal, own_seed + number) for own_seed in seeds]
        _advance(samplers, BURN_IN, begin)
        begin = np.stack([np.asarray(s.get_chain())[-1] for s in samplers])
        drawn = np.concatenate([np.asarray(s.get_chain(discard=BURN_IN // 3, flat=True)) for s in samplers])
        accepted = float(np.mean([s.acceptance_fraction for s in samplers]))
        proposal = drawn.mean(axis=0), np.linalg.cholesky(np.cov(drawn.T))
        if accepted < MIN_ACCEPTANCE_GAIN * before:
            break
        before = accepted
    samplers = [sampler(*proposal, own_seed + ROUNDS) for own_seed in seeds]
    _advance(samplers, STEPS_PER_CALL, begin)
    return samplers


def sample_ensemble(
    density: LogDensity,
    mode: PosteriorMode,
    *,
    seed: int = 0,
    length: EnsembleLength = EnsembleLength(),
    progress: Progress = quiet,
    predictive: bool = True,
) -> results.Posterior:
    """Sample until ESS and R-hat reach their targets and the run spans many autocorrelation times."""
    from emcee.autocorr import integrated_time

    began = time.perf_counter()
    samplers = _burnt_in(density, mode, seed, length)
    while True:
        steps, chain = samplers[0].iteration, np.concatenate([np.asarray(s.get_chain()) for s in samplers], axis=1)
        with np.errstate(invalid="ignore", divide="ignore"):  # of the slowest parameter, in steps
            tau = float(np.max(integrated_time(chain, tol=0, quiet=True)))
        tau = tau if np.isfinite(tau) else np.inf  # as when a walker has never moved
        progress(f"emcee: {steps} steps", min(1.0, steps / (AUTOCORRELATION_TIMES * tau)))
        if steps >= AUTOCORRELATION_TIMES * tau or steps >= length.max_steps:
            thin = max(1, int(tau / 2)) if np.isfinite(tau) else 1  # draws closer than that are nearly equal
            # One chain an ensemble, walkers end to end, so that R-hat compares ensembles.
            v = np.stack([np.swapaxes(np.asarray(s.get_chain(thin=thin)), 0, 1) for s in samplers])
            x = mode.unwhiten(v.reshape(len(samplers), -1, density.size))
            x = np.asarray(constrain_draws(density, jnp.asarray(x)))
            marginals = diagnose(x, density.names)
            if converged(marginals) or steps >= length.max_steps:
                break
        _advance(samplers, STEPS_PER_CALL)
    log_densities = np.stack([np.asarray(s.get_log_prob(thin=thin)).T.ravel() for s in samplers])
    drawn = Drawn("emcee", x, {"lp": log_densities}, marginals)
    posterior = assemble(density, drawn, seed=seed, seconds=time.perf_counter() - began, predictive=predictive)
    acceptance = float(np.mean([s.acceptance_fraction.mean() for s in samplers]))
    posterior.tree.attrs |= {"steps": steps, "autocorrelation_time": tau, "acceptance": acceptance}
    return posterior


# --- A posterior from the draws of a sampler: marginals with diagnostics, and predictions.

TARGET_ESS = 400.0
TARGET_RHAT = 1.01
PREDICTIVE_DRAWS = 50  # per chain, for the groups with one value per sample
PREDICTIVE_VALUES = 20_000_000  # of each of these groups; a record of 200,000 samples keeps fewer draws


class Drawn(NamedTuple):
    """Draws x (chain, draw, k) of a sampler, its statistics and, if known, the marginals."""

    engine: str
    x: Float[np.ndarray, "chain draw k"]
    stats: Mapping[str, np.ndarray] = MappingProxyType({})
    marginals: dict[str, results.Marginal] | None = None
    divergent: bool = False


def diagnose(draws: Float[np.ndarray, "chain draw k"], names: tuple[str, ...]) -> dict[str, results.Marginal]:
    """Marginal summaries with ArviZ's rank-normalised R-hat and bulk effective sample size."""
    import arviz_base as azb
    import arviz_stats as azs

    dataset = azb.from_dict({"posterior": {name: draws[..., i] for i, name in enumerate(names)}})["posterior"].dataset
    ess, tail, rhat = azs.ess(dataset), azs.ess(dataset, method="tail"), azs.rhat(dataset)
    marginals = {}
    for i, name in enumerate(names):
        flat = draws[..., i].ravel()
        low, high = np.quantile(flat, [0.025, 0.975])
        moments = float(flat.mean()), float(flat.std(ddof=1)), (float(low), float(high))
        marginals[name] = results.Marginal(*moments, *(float(x[name]) for x in (ess, tail, rhat)))
    return marginals


def converged(marginals: dict[str, results.Marginal]) -> bool:
    """Every parameter reaches the targets of effective sample size (bulk and tail) and R-hat."""
    return all(m.ess >= TARGET_ESS and m.rhat <= TARGET_RHAT for m in marginals.values())


@Compiled
def constrain_draws(density: LogDensity, u: Float[Array, "chain draw k"]) -> Float[Array, "chain draw k"]:
    """x of every u."""
    return jax.vmap(jax.vmap(density.constrain))(u)


@Compiled
def _predictive(density: Density, x: Float[Array, "m k"], white: Float[Array, "m n c"]):
    return jax.lax.map(lambda pair: (density.pointwise(pair[0]), density.replicate(*pair)), (x, white))


def assemble(
    density: LogDensity, drawn: Drawn, *, seed: int, seconds: float, predictive: bool = True
) -> results.Posterior:
    """Turn draws of x into a `Posterior`."""
    import arviz_base as azb

    # The groups with one value per sample (log_likelihood, posterior_predictive, prior_predictive) hold an evenly
    # thinned share of the draws, in single precision, to keep the file small. `log_likelihood` is conditional on the
    # samples before: under coloured noise LOO on it measures one-step prediction, not interpolation.
    names, draws, rng = density.names, drawn.x, np.random.default_rng(seed)
    prior = density.sample_prior(rng, 1000)
    groups: dict[str, Any] = {"posterior": {name: draws[..., i] for i, name in enumerate(names)}}
    groups |= {"sample_stats": dict(drawn.stats)} if drawn.stats else {}
    groups["prior"] = {name: prior[None, :, i] for i, name in enumerate(names)}
    dims: dict[str, list[str]] = {}
    if predictive and isinstance(density, Density):
        (chains, length, size), outputs, n = draws.shape, density.model.coefficients, density.observations.n
        kept = min(PREDICTIVE_DRAWS, length, max(2, PREDICTIVE_VALUES // (len(outputs) * chains * n)))
        thin = np.linspace(0, length - 1, kept).astype(int)
        white = jnp.asarray(rng.standard_normal((chains * kept, n, len(outputs))))
        loglik, replicated = _predictive(density, jnp.asarray(draws[:, thin].reshape(-1, size)), white)
        _, before = _predictive(density, jnp.asarray(prior[: chains * kept]), white)
        parts = {"log_likelihood": loglik, "posterior_predictive": replicated, "prior_predictive": before}
        for group, values in parts.items():
            leading = (1, chains * kept) if group == "prior_predictive" else (chains, kept)
            array = np.asarray(values, np.float32).reshape(*leading, n, len(outputs))
            groups[group] = {name: array[..., i] for i, name in enumerate(outputs)}
        groups["observed_data"] = dict(zip(outputs, np.asarray(density.observations.measured).T, strict=True))
        dims = {name: ["instant"] for name in outputs}
    tree = azb.from_dict(groups, dims=dims)
    tree.attrs |= {"engine": drawn.engine, "noise": density.noise_label, "seed": seed}
    for parameter in density.parameters:
        for group in ("posterior", "prior"):
            tree[group][parameter.name].attrs["units"] = parameter.unit
    marginals = drawn.marginals or diagnose(draws, names)
    reached = results.PosteriorStatus.CONVERGED if converged(marginals) else results.PosteriorStatus.NOT_CONVERGED
    status = results.PosteriorStatus.DIVERGENT if drawn.divergent else reached
    return results.Posterior(drawn.engine, density.noise_label, names, tree, marginals, status, seconds)


# --- The posterior by NumPyro's NUTS: the independent check on the one density.

CALL_DRAWS = 100  # draws of one compiled call; warm-up and blocks are rounded up to a multiple
BLOCK_DRAWS = 300  # draws per chain between two checks of the diagnostics
DIVERGENT_SHARE = 0.005
FIELDS = ("diverging", "num_steps", "accept_prob", "potential_energy")
Target = tuple[LogDensity, Array, Array]
"""A density, with the centre and the factor of its whitened coordinates."""


class NutsLength(NamedTuple):
    """Chains, steps of their warm-up, the most blocks of draws that follow it; the acceptance to which the step size is
    adapted, and whether a dense metric is adapted, too."""

    # A metric of few steps is worse than the curvature at the mode, on whose scale the chains begin: the covariance of
    # 75 draws of 26 independent normal coordinates has deviations of 0.4 to 1.6.
    chains: int = 4
    warmup: int = 500
    max_blocks: int = 8
    acceptance: float = 0.95
    metric: bool = True


@cache
def _kernel(length: NutsLength):
    """NumPyro's functional NUTS, with the data as arguments: MCMC would compile again for every data set and chain."""
    from numpyro.infer.hmc import hmc

    # One for each length of the warm-up, which the kernel stores when it starts.
    del length
    potential = lambda density, centre, factor: lambda v: -density(centre + factor @ v)  # noqa: E731
    return hmc(potential_fn_gen=potential, algo="NUTS")


@eqx.filter_jit  # not kept on disk: tracing it gives the kernel the length of the warm-up
def _start_chain(target: Target, length: NutsLength, key: Array, v: Float[Array, " k"]) -> HMCState:
    key, _ = jax.random.split(key)  # as numpyro's NUTS does: the same draws
    adapted: Any = {"dense_mass": length.metric, "adapt_mass_matrix": length.metric}
    adapted |= {"target_accept_prob": length.acceptance, "model_args": target, "rng_key": key}
    return _kernel(length)[0](v, length.warmup, **adapted)


@eqx.filter_jit
def _draw_steps(target: Target, length: NutsLength, state: HMCState):
    def step(state: HMCState, _: None):
        state = _kernel(length)[1](state, target)  # adapts for as long as state.i is below the warm-up
        return state, (state.z, {name: getattr(state, name) for name in FIELDS})

    return jax.lax.scan(step, state, None, length=CALL_DRAWS)


def sample_nuts(
    density: LogDensity,
    mode: PosteriorMode,
    *,
    seed: int = 0,
    length: NutsLength = NutsLength(),
    progress: Progress = quiet,
    predictive: bool = True,
) -> results.Posterior:
    """Sample in blocks until every parameter reaches the targets of ESS and R-hat, at most `max_blocks` of them."""
    # Works on coordinates whitened by the curvature at the mode; starts are drawn from that Laplace approximation, each
    # chain its own, so that R-hat can see a second mode nearby. `progress(text, share)` is called after every block.
    began, target = time.perf_counter(), (density, jnp.asarray(mode.u), jnp.asarray(mode.factor))
    start_key, run_key = jax.random.split(jax.random.PRNGKey(seed))
    starts = jax.random.normal(start_key, (length.chains, density.size))
    keys = jax.random.split(run_key, length.chains)
    chains = [_start_chain(target, length, key, v) for key, v in zip(keys, starts, strict=True)]

    def advanced(some: list[HMCState]) -> list[Any]:
        return side_by_side(lambda chain: jax.block_until_ready(_draw_steps(target, length, chain)), some)

    for number in range(-(-length.warmup // CALL_DRAWS)):  # the first chain starts alone and compiles
        parts = [chains] if number else [chains[:1], chains[1:]]
        chains = [chain for part in parts for chain, _ in advanced(part)]
    draws, fields, most = [], [], length.max_blocks * BLOCK_DRAWS
    while True:
        for _ in range(BLOCK_DRAWS // CALL_DRAWS):
            ends = advanced(chains)
            chains = [chain for chain, _ in ends]
            v = np.stack([np.asarray(drawn) for _, (drawn, _) in ends])
            draws.append(np.asarray(constrain_draws(density, jnp.asarray(mode.unwhiten(v)))))
            ends = [of_chain for _, (_, of_chain) in ends]
            fields.append({name: np.stack([np.asarray(of_chain[name]) for of_chain in ends]) for name in FIELDS})
        x = np.concatenate(draws, axis=1)
        marginals = diagnose(x, density.names)
        done = converged(marginals) or x.shape[1] >= most
        least = min(m.ess_bulk for m in marginals.values())
        progress(f"NUTS: {x.shape[1]} draws a chain, ESS {least:.0f}", 1.0 if done else x.shape[1] / most)
        if done:
            break
    by_field = {name: np.concatenate([part[name] for part in fields], axis=1) for name in FIELDS}
    keys = ("diverging", "n_steps", "acceptance_rate", "lp")
    stats: dict[str, np.ndarray] = dict(zip(keys, by_field.values(), strict=True))
    stats["lp"] = -stats["lp"]
    divergent = float(stats["diverging"].mean()) > DIVERGENT_SHARE
    drawn = Drawn("nuts", x, stats, marginals, divergent)
    return assemble(density, drawn, seed=seed, seconds=time.perf_counter() - began, predictive=predictive)


# --- Whether a posterior predicts what was measured (PIT).
# Under a correct model the values are uniform. Each sample is predicted one step ahead, given those before it in its
# manoeuvre; under white noise they carry no information, and the values are those of the predictive distribution.
# Sources: Dawid 1984, J. R. Stat. Soc. A 147, 278; Diebold, Gunther and Tay 1998, Int. Econ. Rev. 39, 863.

PIT_DRAWS = 200  # of the posterior: the probability of a sample hardly varies between them; our choice
MAX_BINS, MIN_PER_BIN = 20, 20
BAND = 0.95  # that all bars of uniform values lie inside


def pit_of(run: results.Identification) -> results.PitResult | None:
    """The transform of a run's samples by its first posterior under the chosen noise; None without a posterior."""
    engine = next((key for key in run.posteriors if key != "white"), None)
    if engine is None:
        return None
    posterior = run.posteriors[engine]
    density = Density.of(run.observations, run.model, Noise(Colour(posterior.noise)), run.mle.bias)
    values = pit(density, posterior.draws(density.names))
    columns, start = [values[:, c] for c in range(values.shape[1])], np.asarray(density.observations.start)
    bars, correlation = tuple(map(histogram, columns)), tuple(neighbours(column, start) for column in columns)
    return results.PitResult(engine, values, bars, correlation)


@Compiled
def _mean_probability(density: Density, x: Float[Array, "m k"]) -> Float[Array, "n c"]:
    # Noise is normal given the parameters, so each draw's probability is exact and their mean has no steps of 1/m.
    add = lambda total, row: (total + ndtr(density.standardised(row)), None)  # noqa: E731
    return jax.lax.scan(add, jnp.zeros_like(density.observations.measured), x)[0] / len(x)


def pit(density: Density, x: Float[np.ndarray, "m k"]) -> Float[np.ndarray, "n c"]:
    """Posterior probability of less than what was measured, from draws `x` as rows; by sample and coefficient."""
    kept = x[np.linspace(0, len(x) - 1, min(len(x), PIT_DRAWS)).astype(int)]
    return np.asarray(_mean_probability(density, jnp.asarray(kept)))


def histogram(values: Float[np.ndarray, " n"]) -> results.Histogram:
    """Bars of `values`, with a band by Bonferroni: exact for one bar, a little wide for all together."""
    n = len(values)
    bins = int(np.clip(n // MIN_PER_BIN, 2, MAX_BINS))
    count, edges = np.histogram(values, bins=bins, range=(0.0, 1.0))
    tail = 0.5 * (1.0 - BAND) / bins
    lower, upper = binom.ppf([tail, 1.0 - tail], n, 1.0 / bins)
    return results.Histogram(edges, count * bins / n, float(lower * bins / n), float(upper * bins / n))


def neighbours(values: Float[np.ndarray, " n"], start: Bool[np.ndarray, " n"]) -> float:
    """Correlation of neighbouring values within manoeuvres, on the normal scale; 0 if they are independent."""
    z = norm.ppf(np.clip(values, 1e-12, 1.0 - 1e-12))
    inside = ~np.asarray(start, bool)[1:]
    return float(np.corrcoef(z[1:][inside], z[:-1][inside])[0, 1])


# --- Sensitivity of a posterior to its priors: power-scaling of prior and likelihood.
# Source: Kallioinen, Paananen, Burkner and Vehtari 2024, Stat. Comput. 34, 57; `psense` of ArviZ, by Pareto-smoothed
# importance weights, without sampling again.

PRIOR_SENSITIVITY_DRAWS = 4000
SENSITIVITY_LIMIT = 0.05  # distance per log2 of the power from which a posterior depends on the scaled part (the paper)


def prior_sensitivity(density: LogDensity, posterior: results.Posterior) -> pd.DataFrame:
    """A row per parameter: sensitivity to the prior and to the likelihood, and whether it leans on the prior."""
    import arviz_base as azb
    import arviz_stats as azs
    import pandas as pd

    # All priors are scaled together. `posterior` is one of `density`. The Monte Carlo error of the sensitivities is
    # about 0.01 for some thousand draws.
    tree = posterior.tree["posterior"].to_dataset()
    step = max(1, tree.sizes["chain"] * tree.sizes["draw"] // PRIOR_SENSITIVITY_DRAWS)
    draws = {name: np.asarray(tree[name])[:, ::step] for name in density.names}
    terms = _prior_and_likelihood(density, jnp.asarray(np.stack(list(draws.values()), axis=-1)))
    groups: dict[str, Any] = {"posterior": draws}
    groups |= {f"log_{part}": {"all": np.asarray(x)} for part, x in zip(("prior", "likelihood"), terms, strict=True)}
    both = azb.from_dict(groups)
    sensitivity = {part: azs.psense(both, group=part) for part in ("prior", "likelihood")}
    rows = {name: {part: float(sensitivity[part][name]) for part in sensitivity} for name in density.names}
    leaning = {name: row | {"leans": row["prior"] >= SENSITIVITY_LIMIT} for name, row in rows.items()}
    return pd.DataFrame.from_dict(leaning, orient="index")


@Compiled
def _prior_and_likelihood(density: LogDensity, x: Float[Array, "chain draw k"]) -> tuple[Array, Array]:
    terms = lambda row: (density.log_prior(row), density.log_likelihood(row))  # noqa: E731
    return jax.lax.map(lambda chain: jax.lax.map(terms, chain), x)
