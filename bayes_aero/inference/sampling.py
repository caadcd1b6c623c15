"""Posteriors by samplers: where they start, the posterior mode with its curvature; emcee; NumPyro's NUTS."""

from __future__ import annotations

import time
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from enum import Enum
from functools import cache, partial
from types import MappingProxyType
from typing import Any, NamedTuple

import arviz_base as azb
import arviz_stats as azs
import emcee
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from numpyro.infer.hmc import HMCState, hmc
from numpyro.infer.hmc_util import dual_averaging
from scipy import optimize

from bayes_aero.inference.results import Marginal, MleResult, Posterior, PosteriorStatus
from bayes_aero.model.noise import Density, LogDensity
from bayes_aero.processes import cores
from bayes_aero.progress import Progress

PRIOR_DRAWS, MIN_DRAWS = 8, 2  # of the prior, from which other modes are sought
MAX_SAMPLES_TIMES_DRAWS = 48_000  # fewer draws are used for longer records
MIN_OTHER_SHARE = 0.01  # of the probability, from which other modes are reported
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


@eqx.filter_jit
def _value_and_gradient(density: LogDensity, u: Float[Array, " k"]):
    return jax.value_and_grad(type(density).__call__, argnums=1)(density, u)


@dataclass
class _Point:
    """A point of a density, with the log-density and its gradient there."""

    density: LogDensity
    u: np.ndarray

    def __post_init__(self) -> None:
        value, slope = _value_and_gradient(self.density, jnp.asarray(self.u))
        self.value, self.slope = float(value), np.asarray(slope)

    @property
    def usable(self) -> bool:
        return bool(np.isfinite(self.value) and np.isfinite(self.slope).all())

    def factor(self, step: np.ndarray) -> tuple[np.ndarray, bool]:
        """Lower Cholesky factor of |H|^-1 with the negative Hessian H; true if H is positive definite."""
        # Away from the mode H may have negative eigenvalues. Their size is still the right scale of a step (saddle-free
        # Newton), so absolute values are taken; a lower limit keeps flat directions finite.
        rows = []  # central differences of the exact gradient
        for move, size in zip(np.diag(step), step, strict=True):
            forward, backward = (_Point(self.density, self.u + sign * move).slope for sign in (1.0, -1.0))
            rows.append((backward - forward) / (2.0 * size))
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

    def climb(self, factor: np.ndarray) -> _Point:

        def negative(v: np.ndarray) -> tuple[float, np.ndarray]:
            at = _Point(self.density, self.u + factor @ v)
            return (-at.value, -factor.T @ at.slope) if at.usable else (1e300, np.zeros(len(v)))

        begin = np.zeros(len(self.u))
        climbed = optimize.minimize(negative, begin, jac=True, method="L-BFGS-B", options={"maxiter": 200})
        return _Point(self.density, self.u + factor @ climbed.x)


def density_start(density: LogDensity, mle: MleResult) -> np.ndarray:
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


def find_mode(density: LogDensity, start: Float[np.ndarray, " k"], *, rounds: int = 12) -> PosteriorMode:
    """Maximise the log-density from `start` (x, bounded scale, strictly inside its bounds)."""
    # Each round computes the curvature and takes a Newton step if that increases the density, else steps of L-BFGS.
    at = _Point(density, np.asarray(density.unconstrain(jnp.asarray(start, float))))
    step = np.full(len(at.u), 1e-4)
    for _ in range(rounds):
        factor, positive_definite = at.factor(step)
        step = np.minimum(1e-3 * np.sqrt(np.sum(factor**2, axis=1)), 1e-2)
        move = factor @ (factor.T @ at.slope)
        gain = 0.5 * float(at.slope @ move)
        if positive_definite and gain < 1e-7:
            return PosteriorMode(at.u, factor, at.value, ModeStatus.CONVERGED)
        trial = _Point(density, at.u + move)
        if not (trial.usable and trial.value > at.value + 0.5 * gain):
            trial = at.climb(factor)
        if not (trial.usable and trial.value > at.value):
            break
        at = trial
    factor, positive_definite = at.factor(step)
    near = 0.5 * float(at.slope @ factor @ (factor.T @ at.slope)) < 1e-3
    status = ModeStatus.FLAT if not positive_definite else ModeStatus.CONVERGED if near else ModeStatus.NOT_CONVERGED
    return PosteriorMode(at.u, factor, at.value, status)


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
        if all(abs(mode.log_density - known.log_density) > SAME_LOG_DENSITY for known in distinct):
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


@eqx.filter_jit
def _log_density(density: LogDensity, u: Float[Array, " k"], factor: Float[Array, "k k"], v: Float[Array, "m k"]):
    return jax.vmap(lambda row: density(u + factor @ row))(v)


class _IndependenceProposal:
    """Metropolis-Hastings proposal from one multivariate Student t, the same for every walker."""

    def __init__(self, centre: np.ndarray, factor: np.ndarray) -> None:
        self.centre, self.factor, self.inverse = centre, factor, np.linalg.inv(factor)

    def _log_density(self, v: np.ndarray) -> np.ndarray:
        squared = np.sum(((v - self.centre) @ self.inverse.T) ** 2, axis=1)
        return -0.5 * (DEGREES_OF_FREEDOM + v.shape[1]) * np.log1p(squared / DEGREES_OF_FREEDOM)

    def __call__(self, coords: np.ndarray, random: np.random.RandomState) -> tuple[np.ndarray, np.ndarray]:
        normal = random.standard_normal(coords.shape)
        spread = np.sqrt(DEGREES_OF_FREEDOM / random.chisquare(DEGREES_OF_FREEDOM, size=(len(coords), 1)))
        proposed = self.centre + (normal * spread) @ self.factor.T
        return proposed, self._log_density(coords) - self._log_density(proposed)


class _Target:
    """The density as emcee calls it; non-finite values are counted, not hidden."""

    def __init__(self, density: LogDensity, mode: PosteriorMode) -> None:
        self.density, self.rejected = density, 0
        self.frame = jnp.asarray(mode.u), jnp.asarray(mode.factor)

    def __call__(self, v: np.ndarray) -> np.ndarray:
        value = np.asarray(_log_density(self.density, *self.frame, jnp.asarray(v)))
        bad = ~np.isfinite(value)
        self.rejected += int(bad.sum())
        return np.where(bad, -np.inf, value)


class EnsembleLength(NamedTuple):
    """Independent ensembles, most steps of each, walkers (default: two for each parameter and four more)."""

    ensembles: int = 4
    max_steps: int = 4000
    walkers: int | None = None


def _sampler(target: _Target, walkers: int, proposal: _IndependenceProposal, seed: int) -> emcee.EnsembleSampler:
    moves = [(emcee.moves.MHMove(proposal), INDEPENDENT), (emcee.moves.DEMove(), 1.0 - INDEPENDENT)]
    sampler = emcee.EnsembleSampler(walkers, target.density.size, target, moves=moves, vectorize=True)
    random = np.random.RandomState(seed % 2**32)  # emcee takes this generator only
    sampler.random_state = random.get_state()
    return sampler


def _advance(samplers: list[emcee.EnsembleSampler], steps: int, begin: np.ndarray | None = None) -> None:
    """Advance every ensemble by `steps`, one thread a core; the density runs outside Python's lock."""
    starts = [None] * len(samplers) if begin is None else list(begin)
    with ThreadPoolExecutor(min(len(samplers), cores())) as pool:
        list(pool.map(lambda sampler, start: sampler.run_mcmc(start, steps), samplers, starts))


class _Ensembles:
    """Independent ensembles after their burn-in and their first steps."""

    def __init__(self, density: LogDensity, mode: PosteriorMode, seed: int, length: EnsembleLength) -> None:
        self.target, self.walkers, size = _Target(density, mode), length.walkers or 2 * (density.size + 2), density.size
        begin = np.random.default_rng(seed).standard_normal((length.ensembles, self.walkers, size)) * 0.5
        proposal, before = _IndependenceProposal(np.zeros(size), np.eye(size)), 0.0
        seeds = [1000 * seed + 10 * i for i in range(length.ensembles)]
        for number in range(ROUNDS):  # a skewed posterior takes several to fit the proposal to the draws
            self.samplers = [_sampler(self.target, self.walkers, proposal, s + number) for s in seeds]
            _advance(self.samplers, BURN_IN, begin)
            begin = np.stack([np.asarray(s.get_chain())[-1] for s in self.samplers])
            found = np.concatenate([np.asarray(s.get_chain(discard=BURN_IN // 3, flat=True)) for s in self.samplers])
            accepted = float(np.mean([s.acceptance_fraction for s in self.samplers]))
            proposal = _IndependenceProposal(found.mean(axis=0), np.linalg.cholesky(np.cov(found.T)))
            if accepted < MIN_ACCEPTANCE_GAIN * before:
                break
            before = accepted
        self.samplers = [_sampler(self.target, self.walkers, proposal, s + ROUNDS) for s in seeds]
        _advance(self.samplers, STEPS_PER_CALL, begin)

    @property
    def autocorrelation_time(self) -> float:
        """Of the slowest parameter in steps; infinite where it is not defined, as when a walker has never moved."""
        chain = np.concatenate([np.asarray(s.get_chain()) for s in self.samplers], axis=1)
        with np.errstate(invalid="ignore", divide="ignore"):
            slowest = float(np.max(emcee.autocorr.integrated_time(chain, tol=0, quiet=True)))
        return slowest if np.isfinite(slowest) else np.inf

    def draws(self, thin: int) -> tuple[Float[np.ndarray, "chain draw k"], dict[str, np.ndarray]]:
        """One chain an ensemble, walkers end to end, so that R-hat compares ensembles; log-density and walker."""
        chains = np.stack([np.asarray(s.get_chain(thin=thin)) for s in self.samplers])  # ensemble draw walker k
        lp = np.stack([np.asarray(s.get_log_prob(thin=thin)).T for s in self.samplers])
        ensembles, walkers, draws = lp.shape
        stats = {
            "lp": lp.reshape(ensembles, -1),
            "walker": np.tile(np.repeat(np.arange(walkers), draws), (ensembles, 1)),
        }
        return np.swapaxes(chains, 1, 2).reshape(ensembles, -1, chains.shape[3]), stats


def sample_ensemble(
    density: LogDensity,
    mode: PosteriorMode,
    *,
    seed: int = 0,
    length: EnsembleLength = EnsembleLength(),
    progress: Progress | None = None,
    predictive: bool = True,
) -> Posterior:
    """Sample until ESS and R-hat reach their targets and the run spans many autocorrelation times."""
    began = time.perf_counter()
    ensembles = _Ensembles(density, mode, seed, length)
    while True:
        tau, steps = ensembles.autocorrelation_time, ensembles.samplers[0].iteration
        if progress:
            progress(f"emcee: {steps} steps", min(1.0, steps / (AUTOCORRELATION_TIMES * tau)))
        if steps >= AUTOCORRELATION_TIMES * tau or steps >= length.max_steps:
            thin = max(1, int(tau / 2)) if np.isfinite(tau) else 1  # draws closer than that are nearly equal
            v, stats = ensembles.draws(thin)
            x = np.asarray(constrain_draws(density, jnp.asarray(mode.unwhiten(v))))
            marginals = diagnose(x, density.names)
            if converged(marginals) or steps >= length.max_steps:
                break
        _advance(ensembles.samplers, STEPS_PER_CALL)
    drawn = Drawn("emcee", x, stats, marginals)
    posterior = assemble(density, drawn, seed=seed, seconds=time.perf_counter() - began, predictive=predictive)
    posterior.tree.attrs |= {
        "steps": steps,
        "thinned_by": thin,
        "autocorrelation_time": tau,
        "acceptance": float(np.mean([s.acceptance_fraction.mean() for s in ensembles.samplers])),
        "non_finite_densities": ensembles.target.rejected,
        "walkers": ensembles.walkers,
    }
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
    marginals: dict[str, Marginal] | None = None
    divergent: bool = False


def diagnose(draws: Float[np.ndarray, "chain draw k"], names: tuple[str, ...]) -> dict[str, Marginal]:
    """Marginal summaries with ArviZ's rank-normalised R-hat and bulk effective sample size."""
    dataset = azb.from_dict({"posterior": {name: draws[..., i] for i, name in enumerate(names)}})["posterior"].dataset
    ess, tail, rhat = azs.ess(dataset), azs.ess(dataset, method="tail"), azs.rhat(dataset)
    marginals = {}
    for i, name in enumerate(names):
        flat = draws[..., i].ravel()
        low, high = np.quantile(flat, [0.025, 0.975])
        moments = float(flat.mean()), float(flat.std(ddof=1)), (float(low), float(high))
        marginals[name] = Marginal(*moments, *(float(x[name]) for x in (ess, tail, rhat)))
    return marginals


def converged(marginals: dict[str, Marginal]) -> bool:
    """Every parameter reaches the targets of effective sample size (bulk and tail) and R-hat."""
    return all(m.ess >= TARGET_ESS and m.rhat <= TARGET_RHAT for m in marginals.values())


@eqx.filter_jit
def constrain_draws(density: LogDensity, u: Float[Array, "chain draw k"]) -> Float[Array, "chain draw k"]:
    """x of every u."""
    return jax.vmap(jax.vmap(density.constrain))(u)


@eqx.filter_jit
def _predictive(density: Density, x: Float[Array, "m k"], white: Float[Array, "m n c"]):
    return jax.lax.map(lambda pair: (density.pointwise(pair[0]), density.replicate(*pair)), (x, white))


def assemble(density: LogDensity, drawn: Drawn, *, seed: int, seconds: float, predictive: bool = True) -> Posterior:
    """Turn draws of x into a `Posterior`."""
    # The groups with one value per sample (log_likelihood, posterior_predictive, prior_predictive) hold an evenly
    # thinned share of the draws, in single precision, to keep the file small. `log_likelihood` is conditional on the
    # samples before: under coloured noise LOO on it measures one-step prediction, not interpolation.
    names, draws = density.names, drawn.x
    groups: dict[str, dict[str, np.ndarray]] = {"posterior": {name: draws[..., i] for i, name in enumerate(names)}}
    if drawn.stats:
        groups["sample_stats"] = dict(drawn.stats)
    rng = np.random.default_rng(seed)
    prior = density.sample_prior(rng, 1000)
    groups["prior"] = {name: prior[None, :, i] for i, name in enumerate(names)}
    dims: dict[str, list[str]] = {}
    if predictive and isinstance(density, Density):
        (chains, length, size), outputs, n = draws.shape, density.model.coefficients, density.observations.n
        most = PREDICTIVE_VALUES // (len(outputs) * chains * n)
        kept = min(PREDICTIVE_DRAWS, length, max(2, most))
        thin = np.linspace(0, length - 1, kept).astype(int)
        white = jnp.asarray(rng.standard_normal((chains * kept, n, len(outputs))))
        loglik, replicated = _predictive(density, jnp.asarray(draws[:, thin].reshape(-1, size)), white)
        _, before = _predictive(density, jnp.asarray(prior[: chains * kept]), white)
        parts = {"log_likelihood": loglik, "posterior_predictive": replicated, "prior_predictive": before}
        for group, values in parts.items():
            leading = (1, chains * kept) if group == "prior_predictive" else (chains, kept)
            array = np.asarray(values, np.float32).reshape(*leading, n, len(outputs))
            groups[group] = {name: array[..., i] for i, name in enumerate(outputs)}
        measured = np.asarray(density.observations.measured)
        groups["observed_data"] = {name: measured[:, i] for i, name in enumerate(outputs)}
        dims = {name: ["instant"] for name in outputs}
    tree = azb.from_dict(groups, dims=dims)
    tree.attrs |= {"engine": drawn.engine, "noise": density.label_of, "seed": seed}
    for parameter in density.parameters:
        for group in ("posterior", "prior"):
            tree[group][parameter.name].attrs["units"] = parameter.unit
    marginals = drawn.marginals or diagnose(draws, names)
    status = PosteriorStatus.CONVERGED if converged(marginals) else PosteriorStatus.NOT_CONVERGED
    status = PosteriorStatus.DIVERGENT if drawn.divergent else status
    return Posterior(drawn.engine, density.label_of, names, tree, marginals, status, seconds)


# --- The posterior by NumPyro's NUTS: the independent check on the one density.

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
