"""Posterior of the hyperparameters: train a stand-in, sample it by NUTS, check it, remove its error."""

from __future__ import annotations

import enum
import math
from collections.abc import Callable
from functools import lru_cache, partial
from itertools import combinations_with_replacement
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import xarray as xr
from arviz_base import from_dict
from arviz_stats.base import array_stats
from jaxtyping import Array, Float, Int
from numpyro.infer.hmc import hmc
from scipy.linalg import solve_triangular
from scipy.special import logsumexp

from bayes_aero.inference.gp.kernel import (
    ExactPoint,
    Optimum,
    Priors,
    ProfilePosterior,
    ReducedData,
    ReducedStats,
    Scaling,
    curvature,
    density_at,
    hyper_names,
    length_slice,
    log_posterior,
    noise_to_signal,
    stats_and_gradient,
)

# --- Emulator of the n x n statistics near the optimum: polynomials in (log l, log g), fitted with gradients.
#
# `logdet` and the logarithmic Cholesky factor of `gram` are smooth functions of u = (log l_1..d, log g), d + 1 numbers;
# every exact evaluation gives their values and all first derivatives, so a few tens of evaluations determine a full
# cubic. `reweight` measures the error of the stand-in on exact evaluations and removes it.

DEGREE = 4  # also the order of the coefficient tensor below
# With fewer rows than this times its terms, a degree is too high.
ROWS_PER_TERM = (0.0, 2.0, 2.0, 2.0, 3.0)
REACH = 2.0  # whitened distance from a supporting point up to which the stand-in is used
SUPPORT_GAP = 12.0  # nats below the best point up to which a point supports; others train with a small weight
PAD = 64  # the list of supporting points is padded to this times a power of two: few lengths, few compiled samplers


class Emulator(eqx.Module):
    """Polynomial stand-in of degree <= 4 in the whitened t: coefficients of s_a s_b, where s = (t, 1) x (t, 1)."""

    # Each monomial keeps one place in that tensor, the others are zero: dense products beat gathers in XLA, and the
    # shape does not depend on the degree, so that one compiled sampler serves every round.
    centre: Float[Array, " u"]
    whiten: Float[Array, "u u"]
    coefficients: Float[Array, "pairs pairs outputs"]
    support: Float[Array, "points u"]

    def __call__(self, u: Float[Array, " u"]) -> tuple[Float[Array, ""], Float[Array, "m m"], Float[Array, ""]]:
        """(logdet, gram, penalty) at u; the penalty, <= 0, excludes regions far from exact points."""
        t = self.whiten @ (u - self.centre)
        away = t - self.support
        squares = jnp.sum(away * away, axis=1)
        nearest = jnp.argmin(squares)
        distance = jnp.sqrt(squares[nearest] + 1e-12)
        outside = jnp.maximum(distance - REACH, 0.0)
        t = t - away[nearest] * outside / distance  # a polynomial is wrong far from its data: hold it at the border
        t1 = jnp.append(t, 1.0)
        pairs = (t1[:, None] * t1).ravel()
        z = pairs @ jnp.tensordot(pairs, self.coefficients, 1)
        m = u.shape[0] + 1
        lower = jnp.zeros((m, m)).at[np.tril_indices(m, -1)].set(z[m + 1 :])
        lower = lower + jnp.diag(jnp.exp(z[1 : m + 1]))
        return z[0], lower @ lower.T, -8.0 * outside**2


def outputs(point: ExactPoint) -> tuple[Float[np.ndarray, " outputs"], Float[np.ndarray, "u outputs"]]:
    """(logdet, log diagonal, strict lower part of chol gram) and their derivatives by u, NaN if unknown."""
    m = point.stats.gram.shape[0]
    lower = np.linalg.cholesky(point.stats.gram)
    rows = np.tril_indices(m, -1)

    def pack(logdet, diagonal, factor):
        return np.concatenate([[logdet], diagonal, factor[rows]])

    value, slopes = pack(point.stats.logdet, np.log(np.diag(lower)), lower), []
    if point.gradient is None:
        return value, np.full((point.u.size, value.size), np.nan)
    for d_logdet, d_gram in zip(point.gradient.logdet, point.gradient.gram, strict=True):
        inner = solve_triangular(lower, d_gram, lower=True)
        inner = solve_triangular(lower, inner.T, lower=True)
        d_lower = lower @ (np.tril(inner, -1) + 0.5 * np.diag(np.diag(inner)))
        slopes.append(pack(d_logdet, np.diag(d_lower) / np.diag(lower), d_lower))
    return value, np.array(slopes)


def design(
    t: Float[np.ndarray, "points u"], powers: Int[np.ndarray, "terms degree"]
) -> Float[np.ndarray, "rows terms"]:
    """Rows of the least-squares problem: monomial values at t, then their derivatives by each coordinate."""
    points, d = t.shape
    padded = np.hstack([t, np.ones((points, 1))])
    factors = padded[:, powers]  # (points, terms, degree)
    blocks = [factors.prod(axis=2)]
    for k in range(d):
        slope = np.zeros(factors.shape[:2])
        for j in range(powers.shape[1]):
            others = np.delete(factors, j, axis=2).prod(axis=2)
            slope += np.where(powers[:, j] == k, others, 0.0)
        blocks.append(slope)
    return np.concatenate(blocks)


def fit_emulator(
    points: list[ExactPoint], log_posterior: Float[np.ndarray, " points"], degree: int = DEGREE
) -> Emulator:
    """Weighted least squares on values and gradients of `points`, with the highest degree that they determine."""
    # The weight of a point follows from its `log_posterior`. Coordinates are whitened by the points near the best one.
    u, gap = np.array([p.u for p in points]), np.max(log_posterior) - log_posterior
    d = u.shape[1]
    near = gap <= max(SUPPORT_GAP, np.sort(gap)[min(3 * d, gap.size - 1)])
    centre, root = u[near].mean(axis=0), np.linalg.cholesky(np.cov(u[near].T))
    whiten = solve_triangular(root, np.eye(d), lower=True)
    t = (u - centre) @ whiten.T
    rows = sum(1 if p.gradient is None else d + 1 for p in points)
    while degree > 1 and ROWS_PER_TERM[degree] * math.comb(d + degree, degree) > rows:
        degree -= 1
    # Factor indices of every monomial up to this degree, padded with d (which stands for 1).
    powers = np.array(list(combinations_with_replacement(range(d + 1), degree)))
    values, slopes = zip(*(outputs(p) for p in points), strict=True)
    by_t = np.einsum("jk,pjz->kpz", root, np.array(slopes)).reshape(d * len(u), -1)
    weight = np.tile(1.0 / (1.0 + gap / SUPPORT_GAP) ** 2, d + 1)[:, None]
    left, right = design(t, powers) * weight, np.vstack([values, by_t]) * weight
    finite = np.all(np.isfinite(right), axis=1)
    coefficients, *_ = np.linalg.lstsq(left[finite], right[finite], rcond=1e-12)
    support = t[near]
    length = PAD * 2 ** max(0, math.ceil(math.log2(len(support) / PAD)))
    support = np.concatenate([support, np.repeat(support[:1], length - len(support), axis=0)])
    padded = np.pad(powers, ((0, 0), (0, DEGREE - powers.shape[1])), constant_values=d)
    tensor = np.zeros(((d + 1) ** 4, coefficients.shape[1]))
    tensor[np.ravel_multi_index(tuple(padded.T), (d + 1,) * 4)] = coefficients
    tensor = tensor.reshape((d + 1) ** 2, (d + 1) ** 2, -1)
    return Emulator(jnp.asarray(centre), jnp.asarray(whiten), jnp.asarray(tensor), jnp.asarray(support))


# --- NUTS over all 2d + 3 hyperparameters, on the stand-in density.

# The stand-in is sampled to this power: draws then reach a little further out than the posterior does, so the weights
# that bring them back are bounded where a stand-in without would miss a tail. Costs 5 % of the draws in 11 dimensions.
TEMPER = 0.9
RHAT_LIMIT, ESS_LIMIT = 1.01, 400.0


class Settings(NamedTuple):
    """Length of the NUTS run: `chains` chains of `warmup` + `draws` steps, together, vectorised."""

    warmup: int = 400
    draws: int = 500
    chains: int = 4


class Chains(NamedTuple):
    """NUTS output: theta (chains, draws, p), the log density sampled, divergences, per-parameter R-hat and bulk ESS."""

    theta: Float[np.ndarray, "chains draws p"]
    log_density: Float[np.ndarray, "chains draws"]
    divergences: int
    rhat: Float[np.ndarray, " p"]
    ess: Float[np.ndarray, " p"]

    @classmethod
    def of(cls, theta: np.ndarray, density: np.ndarray, divergences: int) -> Chains:
        columns = np.moveaxis(theta, -1, 0)
        rhat, ess = (np.array([f(c) for c in columns]) for f in (array_stats.rhat, array_stats.ess))
        return cls(theta, density, divergences, rhat, ess)

    def followed_by(self, then: Chains) -> Chains:
        theta, density = (np.concatenate([getattr(x, n) for x in (self, then)], 1) for n in ("theta", "log_density"))
        return Chains.of(theta, density, self.divergences + then.divergences)

    @property
    def mixed(self) -> bool:
        """Whether the chains agree and have enough independent draws (Vehtari et al. 2021)."""
        return bool(np.max(self.rhat) <= RHAT_LIMIT and np.min(self.ess) >= ESS_LIMIT)


def emulated_density(
    theta: Float[Array, " p"], emulator: Emulator, n: Float[Array, ""], priors: Priors
) -> Float[Array, ""]:
    """The stand-in for log q(theta) + log p(y | theta), fenced to where it was trained."""
    d = (theta.shape[0] - 3) // 2
    u = jnp.append(theta[length_slice(d)], 2.0 * (theta[-1] - theta[d + 1]))
    logdet, gram, penalty = emulator(u)
    return small_posterior(theta, logdet, gram, n, priors) + penalty


_hessian = jax.jit(jax.hessian(emulated_density), static_argnums=3)


def laplace_root(
    theta: Float[np.ndarray, " p"], emulator: Emulator, n: float, priors: Priors
) -> Float[np.ndarray, "p p"]:
    """Square root of the Laplace covariance at theta; directions that the data leave open get an sd of 1.5."""
    hessian = np.asarray(_hessian(jnp.asarray(theta), emulator, jnp.asarray(n), priors))
    values, vectors = np.linalg.eigh(-0.5 * (hessian + hessian.T))
    return vectors / np.sqrt(np.maximum(values, 1.0 / 1.5**2))


@lru_cache(maxsize=8)
def _sampler(priors: Priors, settings: Settings):
    """numpyro's functional NUTS, compiled once for every shape of data: MCMC would compile anew for every run."""

    def potential(theta_map, root, n, emulator):
        """Of w, theta = optimum + root w: what differs between coefficients and rounds is an argument."""
        return lambda w: -TEMPER * emulated_density(theta_map + root @ w, emulator, n, priors)

    def chain(key, w, target):
        begin, sample = hmc(potential_fn_gen=potential, algo="NUTS")
        state = begin(
            w,
            settings.warmup,
            dense_mass=True,
            target_accept_prob=0.85,
            max_tree_depth=7,
            model_args=target,
            rng_key=key,
        )

        def step(state, _):
            state = sample(state, target)  # adapts for as long as state.i is below the warm-up
            return state, (state.z, -state.potential_energy, state.diverging)

        _, statistics = jax.lax.scan(step, state, None, length=settings.warmup + settings.draws)
        return jax.tree.map(lambda x: x[settings.warmup :], statistics)

    return jax.jit(jax.vmap(chain, in_axes=(0, 0, None)))


def sample_emulated(
    theta: Float[np.ndarray, " p"],
    emulator: Emulator,
    n: int,
    priors: Priors,
    settings: Settings,
    seed: int,
    start: Float[np.ndarray, "chains p"] | None = None,
) -> Chains:
    """NUTS on the stand-in density to the power `TEMPER`, from `start` or from around the optimum theta."""
    root = laplace_root(theta, emulator, float(n), priors)
    args = (jnp.asarray(theta), jnp.asarray(root), jnp.asarray(float(n)), emulator)
    keys = jax.random.split(jax.random.PRNGKey(seed))
    w = jax.random.normal(keys[0], (settings.chains, theta.size))
    if start is not None:
        w = jnp.asarray(np.linalg.solve(root, (start - theta).T).T)
    drawn = _sampler(priors, settings)(jax.random.split(keys[1], settings.chains), w, args)
    w, density, diverging = (np.asarray(x) for x in drawn)
    return Chains.of(theta + w @ root.T, density, int(diverging.sum()))


# --- From draws of the stand-in to draws of the exact posterior, with the stand-in's error measured and removed.
# Some draws of the NUTS run, thinned until nearly independent, are evaluated exactly at all n points; their log-
# ratios, exact minus stand-in, are Pareto-smoothed (PSIS, Vehtari et al. 2024, JMLR 25(72)) by ArviZ. The Pareto k
# says whether that works: above 0.7 the stand-in is refused.


K_LIMIT = 0.7  # largest Pareto k that is accepted; its standard error is about 0.2 on this few draws
ESS_SHARE = 0.3  # k judges the tail of the weights only; a stand-in beside the posterior shows in their ESS


class SampleStatus(enum.Enum):
    """Result of the sampling of hyperparameters; the value is the text for the user."""

    accepted = "The re-weighted draws represent the exact posterior of the hyperparameters."
    not_sampled = "Only the most probable hyperparameters were asked for; set sample=True for their posterior."
    pareto_k = (
        "Refused: Pareto k is too large, so the stand-in density misses part of the exact posterior. "
        "Use the MAP, allow more rounds or design points, or give stronger hyperparameter priors."
    )
    few_effective = (
        "Refused: a few draws carry most of the weight, so the stand-in density sits beside the exact posterior. "
        "Use the MAP, allow more rounds or design points, or give stronger hyperparameter priors."
    )
    not_mixed = (
        "Refused: the NUTS chains disagree (R-hat above 1.01, or too few effective draws). "
        "Use the MAP, lengthen the chains, or give stronger hyperparameter priors."
    )
    not_positive_definite = (
        "Refused: the exact covariance could not be factorised at some draws. "
        "Use the MAP, or give the noise a prior with a larger median."
    )
    dependent = (
        "Refused: an input, or the output, is a linear combination of the inputs, and the stand-in density needs them "
        "independent. Use the MAP, or leave one of the inputs out."
    )
    no_optimum = "Refused: the search for the most probable hyperparameters failed; see the MAP's status."


class Weighted(NamedTuple):
    """Exactly evaluated draws; `k_hat` and `ess` of the weights judge them."""

    theta: Float[np.ndarray, "chains draws p"]
    exact: Float[np.ndarray, "chains draws"]
    stand_in: Float[np.ndarray, "chains draws"]  # log densities, as `exact`
    log_weight: Float[np.ndarray, "chains draws"]  # by PSIS, normalised over all draws
    k_hat: float
    ess: float
    failures: int
    stats: tuple[ReducedStats, ...] = ()  # of every draw, flat: they can train the next stand-in

    @property
    def status(self) -> SampleStatus:
        if self.failures:
            return SampleStatus.not_positive_definite
        if self.k_hat > K_LIMIT:
            return SampleStatus.pareto_k
        return SampleStatus.accepted if self.ess >= ESS_SHARE * self.exact.size else SampleStatus.few_effective


def thin(chains: Chains, draws: int) -> tuple[np.ndarray, np.ndarray]:
    """About `draws` of all draws, the same evenly spaced ones of each chain, and their stand-in log densities."""
    each = max(draws // chains.theta.shape[0], 2)
    at = np.linspace(0, chains.theta.shape[1] - 1, each).round().astype(int)
    return chains.theta[:, at], chains.log_density[:, at]


def pareto_smooth(log_ratio: Float[np.ndarray, "*shape"]) -> tuple[Float[np.ndarray, "*shape"], float]:
    """Normalised smoothed log weights and Pareto k. (ArviZ's psislw takes *minus* the log-ratio, as in LOO.)"""
    if np.ptp(log_ratio) < 1e-12:
        return np.full(log_ratio.shape, -np.log(log_ratio.size)), -np.inf  # no error, hence no tail to fit
    smoothed, k_hat = array_stats.psislw(-log_ratio.ravel())
    smoothed = np.asarray(smoothed)
    return (smoothed - float(np.asarray(logsumexp(smoothed)))).reshape(log_ratio.shape), float(k_hat)


def reweight(
    theta: Float[np.ndarray, "chains draws p"],
    stand_in: Float[np.ndarray, "chains draws"],
    data: ReducedData,
    priors: Priors,
    tell: Callable[[str], None],
) -> Weighted:
    """Evaluate every theta exactly (one factorisation each) and weigh it."""
    flat = theta.reshape(-1, theta.shape[-1])
    exact: list[tuple[float, ReducedStats]] = []
    for i, t in enumerate(flat):
        exact.append(log_posterior(t, data, priors))
        tell(f"exact evaluation {i + 1} of {len(flat)}")
    value = np.array([x for x, _ in exact]).reshape(stand_in.shape)
    failures = int(np.sum(~np.isfinite(value)))
    if failures:
        nothing = np.full(value.shape, np.nan)
        return Weighted(theta, value, stand_in, nothing, np.inf, 0.0, failures)
    log_weight, k_hat = pareto_smooth(value - stand_in)
    ess = float(np.exp(-np.asarray(logsumexp(2.0 * log_weight))))
    return Weighted(theta, value, stand_in, log_weight, k_hat, ess, 0, tuple(stats for _, stats in exact))


# --- Log posterior of the hyperparameters from the reduced statistics, as compiled code; `kernel.slopes` has it with
# derivatives. log p(y | theta) = -1/2 y'K^-1 y - 1/2 log|K| - n/2 log 2 pi, and the MAP objective adds log q(theta).
# (Eq. 7 of the seed paper prints a logarithm around the whole sum by mistake.) Nothing differentiates through an n x n
# Cholesky: the n x n step has hand-written derivatives, through LAPACK.


def small_posterior(
    theta: Float[Array, " p"], logdet: Float[Array, ""], gram: Float[Array, "m m"], n, priors: Priors
) -> Float[Array, ""]:
    """log q(theta) + log p(y | theta) given the statistics at theta's own (l, g); exact, O(d^3)."""
    d = (theta.shape[0] - 3) // 2
    log_sf = theta[d + 1]
    root = jnp.exp(theta[: d + 1] - log_sf)  # D^1/2
    inner = jnp.eye(d + 1) + root[:, None] * gram[: d + 1, : d + 1] * root
    lower = jnp.linalg.cholesky(inner)
    t = jax.scipy.linalg.solve_triangular(lower, root * gram[: d + 1, d + 1], lower=True)
    quadratic = (gram[d + 1, d + 1] - t @ t) * jnp.exp(-2.0 * log_sf)
    log_k = n * 2.0 * log_sf + logdet + 2.0 * jnp.sum(jnp.log(jnp.diagonal(lower)))
    return -0.5 * (quadratic + log_k + n * jnp.log(2.0 * jnp.pi)) + priors.log_density(theta)


# --- The stand-in is trained until draws of it can be weighted.

DESIGN_SPREAD = 1.4  # the design is drawn this many times wider than the Laplace approximation
# A stand-in whose log density scatters by more is trained further, 12 gradients, before 128 exact draws judge it: on
# CD a scatter of 0.16 was refused after them.
PILOT_ERROR = 0.1
MAX_GAP = 30.0  # nats below the best point, beyond which a point no longer trains the stand-in


class Budget(NamedTuple):
    """Of the search for the mode and of the sampling, and the seed of both."""

    design: int = 52  # gradients, as `pilots`
    pilots: int = 12
    exact: int = 128  # draws, a factorisation each
    rounds: int = 8  # of training, at most
    extensions: int = 2  # of a NUTS run that has not mixed
    nuts: Settings = Settings()
    starts: int = 16  # of the search for the mode
    seed: int = 0


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
    tell: Callable[[str], None] = lambda _: None,
) -> Sampled:
    """Draws of theta from the exact posterior around `optimum`, or the reason why there are none."""
    seed = budget.seed
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
        flat = chains.theta.reshape(-1, chains.theta.shape[-1])  # a few draws judge the stand-in: exact less its own
        at = rng.choice(len(flat), budget.pilots, replace=False)
        us = [noise_to_signal(t) for t in flat[at]]
        pilots, error = [ExactPoint(u, *stats_and_gradient(u, data)) for u in us], np.inf
        if all(p.stats.ok for p in pilots):
            n, pairs = float(data.n), zip(flat[at], pilots, strict=True)
            exact = [density_at(t, p.u, p.stats, n, priors) for t, p in pairs]
            error = float(np.std(np.array(exact) - chains.log_density.ravel()[at] / TEMPER))
        points += pilots
        tell(f"round {number}: the stand-in errs by {error:.2g} in log density")
        last = number == budget.rounds
        if not last and not error < PILOT_ERROR:
            continue
        for again in range(1, budget.extensions + 1):
            if not chains.mixed:
                tell(f"NUTS, round {number}, extension {again}")
                chains = chains.followed_by(run(seed + 100 * number + again, chains.theta[:, -1]))
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
    """The posterior as an ArviZ DataTree; hyperparameters in physical units, save theta, which is log scaled."""
    # `posterior`: draws of the exact posterior with equal weights (the indices `at` of the weighted ones), and
    # `sample_stats` of these; `prior`; `proposal`: the weighted draws before resampling, with their exact and stand-in
    # log densities and PSIS log weights; `stand_in`: the full NUTS chains, of it to the power `variance_inflation`.
    weighted, chains = sampled.weighted, sampled.chains
    if weighted is None:
        raise ValueError("nothing was weighted")
    shape = weighted.exact.shape
    drawn = weighted.theta.reshape(-1, weighted.theta.shape[-1])[at].reshape(weighted.theta.shape)
    prior = np.asarray(priors.sample(jax.random.PRNGKey(seed), len(names), PRIOR_DRAWS))[None]
    groups = {
        "posterior": scaling.physical(drawn),
        "sample_stats": {"lp": weighted.exact.ravel()[at].reshape(shape), "proposal_index": at.reshape(shape)},
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
