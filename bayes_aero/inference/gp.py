"""Gaussian-process regression of one output on a few inputs: `fit_gp`, and its result `GPFit`.

fit = fit_gp(X, y, names=("alpha", "elevator", "q", "V", "CL"), sample=True)
fit.predict(X_new).mean;  fit.posterior;  fit.status.value;  fit.k_hat

Posterior of the hyperparameters: train a stand-in, sample it by NUTS, check it, remove its error.
"""

from __future__ import annotations

import enum
import math
from dataclasses import dataclass
from functools import lru_cache
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
from scipy.linalg import cho_solve, cholesky, solve_triangular
from scipy.special import logsumexp, ndtr

from bayes_aero.errors import InputError
from bayes_aero.inference.gp_kernel import (
    SAME_OPTIMUM,
    ExactPoint,
    MapStatus,
    Optimum,
    Priors,
    ProfilePosterior,
    ReducedData,
    Scaling,
    Theta,
    curvature,
    density_at,
    distinct,
    exact_point,
    factorise,
    find_map,
    length_slice,
    log_posterior,
    maximise,
    noise_to_signal,
    scaled_distance_kernel,
)
from bayes_aero.processes import blas_threads

Matrix = Float[np.ndarray, "n d"] | Float[jax.Array, "n d"]
Vector = Float[np.ndarray, " n"] | Float[jax.Array, " n"]

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


@jax.jit
def _outputs(
    logdet: Float[Array, ""], gram: Float[Array, "m m"], d_logdet: Float[Array, " u"], d_gram: Float[Array, "u m m"]
):
    """(logdet, log diagonal, strict lower part of chol gram), and their derivatives by u as rows."""

    def packed(logdet, gram):
        lower = jnp.linalg.cholesky(gram)
        return jnp.concatenate([logdet[None], jnp.log(jnp.diag(lower)), lower[np.tril_indices(len(gram), -1)]])

    slopes = jax.vmap(lambda *by_u: jax.jvp(packed, (logdet, gram), by_u)[1])(d_logdet, d_gram)
    return packed(logdet, gram), slopes


def _design(t: Float[np.ndarray, "points u"], exponents: Int[np.ndarray, "terms u"]) -> Float[np.ndarray, "rows terms"]:
    """Rows of the least-squares problem: monomials at t, then their derivatives by each coordinate."""

    def monomials(powers: np.ndarray) -> np.ndarray:
        return np.prod(t[:, None] ** np.maximum(powers, 0), axis=2)

    each = zip(exponents.T, np.eye(t.shape[1], dtype=int), strict=True)
    return np.concatenate([monomials(exponents), *(power * monomials(exponents - k) for power, k in each)])


def fit_emulator(points: list[ExactPoint], log_posterior: Float[np.ndarray, " points"]) -> Emulator:
    """Weighted least squares on values and gradients of `points`, with the highest degree that they determine."""
    # The weight of a point follows from its `log_posterior`. Coordinates are whitened by the points near the best one.
    u, gap = np.array([p.u for p in points]), np.max(log_posterior) - log_posterior
    d = u.shape[1]
    near = gap <= max(SUPPORT_GAP, np.sort(gap)[min(3 * d, gap.size - 1)])
    centre, root = u[near].mean(axis=0), np.linalg.cholesky(np.cov(u[near].T))
    whiten = solve_triangular(root, np.eye(d), lower=True)
    t = (u - centre) @ whiten.T
    values, slopes = map(np.array, zip(*(_outputs(*p[1:]) for p in points), strict=True))
    right = np.vstack([values, np.einsum("jk,pjz->kpz", root, slopes).reshape(d * len(u), -1)])
    finite = np.all(np.isfinite(right), axis=1)
    degree = DEGREE
    while degree > 1 and ROWS_PER_TERM[degree] * math.comb(d + degree, degree) > finite.sum():
        degree -= 1
    # Factor indices of every monomial up to this degree, padded with d (which stands for 1).
    powers = np.array(list(combinations_with_replacement(range(d + 1), degree)))
    left = _design(t, np.stack([np.sum(powers == k, axis=1) for k in range(d)], axis=1))
    weight = np.tile(1.0 / (1.0 + gap / SUPPORT_GAP) ** 2, d + 1)[finite, None]
    coefficients = np.linalg.lstsq(left[finite] * weight, right[finite] * weight, rcond=1e-12)[0]
    support = t[near]
    length = PAD * 2 ** max(0, math.ceil(math.log2(len(support) / PAD)))
    support = np.concatenate([support, np.repeat(support[:1], length - len(support), axis=0)])
    padded = np.pad(powers, ((0, 0), (0, DEGREE - degree)), constant_values=d)
    tensor = np.zeros(((d + 1) ** 4, coefficients.shape[1]))
    tensor[np.ravel_multi_index(tuple(padded.T), (d + 1,) * 4)] = coefficients
    tensor = tensor.reshape((d + 1) ** 2, (d + 1) ** 2, -1)
    return Emulator(jnp.asarray(centre), jnp.asarray(whiten), jnp.asarray(tensor), jnp.asarray(support))


# --- NUTS over all 2d + 3 hyperparameters, on the stand-in density.
# log p(y | theta) = -1/2 y'K^-1 y - 1/2 log|K| - n/2 log 2 pi, and the MAP objective adds log q(theta). (Eq. 7 of the
# seed paper prints a logarithm around the whole sum by mistake.) Nothing differentiates through an n x n Cholesky: the
# n x n step has hand-written derivatives, through LAPACK.

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
        theta, density = (np.concatenate([before, after], 1) for before, after in zip(self[:2], then[:2], strict=True))
        return Chains.of(theta, density, self.divergences + then.divergences)

    @property
    def mixed(self) -> bool:
        """Whether the chains agree and have enough independent draws (Vehtari et al. 2021)."""
        return bool(np.max(self.rhat) <= RHAT_LIMIT and np.min(self.ess) >= ESS_LIMIT)


def small_posterior(
    theta: Float[Array, " p"], logdet: Float[Array, ""], gram: Float[Array, "m m"], n, priors: Priors
) -> Float[Array, ""]:
    """log q(theta) + log p(y | theta) given the statistics at theta's own (l, g); exact, O(d^3). `gp_kernel.slopes` has
    it with derivatives."""
    d = (theta.shape[0] - 3) // 2
    log_sf = theta[d + 1]
    root = jnp.exp(theta[: d + 1] - log_sf)  # D^1/2
    lower = jnp.linalg.cholesky(jnp.eye(d + 1) + root[:, None] * gram[: d + 1, : d + 1] * root)
    t = jax.scipy.linalg.solve_triangular(lower, root * gram[: d + 1, d + 1], lower=True)
    quadratic = (gram[d + 1, d + 1] - t @ t) * jnp.exp(-2.0 * log_sf)
    log_k = n * 2.0 * log_sf + logdet + 2.0 * jnp.sum(jnp.log(jnp.diagonal(lower)))
    return -0.5 * (quadratic + log_k + n * jnp.log(2.0 * jnp.pi)) + priors.log_density(theta)


def emulated_density(theta: Float[Array, " p"], emulator: Emulator, n, priors: Priors) -> Float[Array, ""]:
    """The stand-in for log q(theta) + log p(y | theta), fenced to where it was trained."""
    d = (theta.shape[0] - 3) // 2
    logdet, gram, penalty = emulator(jnp.append(theta[length_slice(d)], 2.0 * (theta[-1] - theta[d + 1])))
    return small_posterior(theta, logdet, gram, n, priors) + penalty


_hessian = jax.jit(jax.hessian(emulated_density), static_argnums=3)


def laplace_root(theta: Theta, emulator: Emulator, n: int, priors: Priors) -> Float[np.ndarray, "p p"]:
    """Square root of the Laplace covariance at theta; directions that the data leave open get an sd of 1.5."""
    hessian = np.asarray(_hessian(jnp.asarray(theta), emulator, jnp.asarray(float(n)), priors))
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
        tuned = {"dense_mass": True, "target_accept_prob": 0.85, "max_tree_depth": 7}
        state = begin(w, settings.warmup, model_args=target, rng_key=key, **tuned)

        def step(state, _):
            state = sample(state, target)  # adapts for as long as state.i is below the warm-up
            return state, (state.z, -state.potential_energy, state.diverging)

        _, statistics = jax.lax.scan(step, state, None, length=settings.warmup + settings.draws)
        return jax.tree.map(lambda x: x[settings.warmup :], statistics)

    return jax.jit(jax.vmap(chain, in_axes=(0, 0, None)))


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
    points: tuple[ExactPoint, ...]  # of every draw, flat: they can train the next stand-in

    @property
    def status(self) -> SampleStatus:
        if not np.all(np.isfinite(self.exact)):
            return SampleStatus.not_positive_definite
        if self.k_hat > K_LIMIT:
            return SampleStatus.pareto_k
        return SampleStatus.accepted if self.ess >= ESS_SHARE * self.exact.size else SampleStatus.few_effective


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
) -> Weighted:
    """Evaluate every theta exactly (one factorisation each) and weigh it."""
    exact, points = zip(*(log_posterior(t, data, priors) for t in theta.reshape(-1, theta.shape[-1])), strict=True)
    value = np.array(exact).reshape(stand_in.shape)
    if not np.all(np.isfinite(value)):
        return Weighted(theta, value, stand_in, np.full(value.shape, np.nan), np.inf, 0.0, points)
    log_weight, k_hat = pareto_smooth(value - stand_in)
    ess = float(np.exp(-np.asarray(logsumexp(2.0 * log_weight))))
    return Weighted(theta, value, stand_in, log_weight, k_hat, ess, points)


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


def _run_nuts(
    optimum: Theta, emulator: Emulator, n: int, priors: Priors, settings: Settings, seed: int, start: np.ndarray | None
) -> Chains:
    """NUTS on the stand-in density to the power `TEMPER`, from `start` (chains, p) or from around the optimum."""
    root = laplace_root(optimum, emulator, n, priors)
    keys = jax.random.split(jax.random.PRNGKey(seed))
    w = jax.random.normal(keys[0], (settings.chains, optimum.size))
    if start is not None:
        w = jnp.asarray(np.linalg.solve(root, (start - optimum).T).T)
    target = jnp.asarray(optimum), jnp.asarray(root), jnp.asarray(float(n)), emulator
    drawn = _sampler(priors, settings)(jax.random.split(keys[1], settings.chains), w, target)
    w, density, diverging = (np.asarray(x) for x in drawn)
    return Chains.of(optimum + w @ root.T, density, int(diverging.sum()))


def sample_posterior(optimum: Optimum, data: ReducedData, priors: Priors, *, budget: Budget = Budget()) -> Sampled:
    """Draws of theta from the exact posterior around `optimum`, or the reason why there are none."""
    rng, d = np.random.default_rng(budget.seed), data.x.shape[1]
    covariance, points = curvature(optimum, data, priors)
    root = np.linalg.cholesky(covariance)
    while len(points) < budget.design:
        points.append(exact_point(optimum.u + DESIGN_SPREAD * root @ rng.normal(size=optimum.u.size), data))
    for number in range(1, budget.rounds + 1):
        usable = [p for p in points if p.ok]
        profile = ProfilePosterior(data, priors, optimum.theta[: d + 2].copy())
        level = np.array([profile.inner(p).value for p in usable])
        kept = level > np.max(level) - MAX_GAP  # very improbable points would distort the stand-in
        emulator = fit_emulator([p for p, k in zip(usable, kept, strict=True) if k], level[kept])
        target = optimum.theta, emulator, data.n, priors, budget.nuts
        chains = _run_nuts(*target, budget.seed + 100 * number, None)
        flat = chains.theta.reshape(-1, chains.theta.shape[-1])  # a few draws judge the stand-in: exact less its own
        at = rng.choice(len(flat), budget.pilots, replace=False)
        pilots = [exact_point(noise_to_signal(t), data) for t in flat[at]]
        exact = np.array([density_at(t, p, data.n, priors) for t, p in zip(flat[at], pilots, strict=True)])
        error = float(np.std(exact - chains.log_density.ravel()[at] / TEMPER))
        points += pilots
        last = number == budget.rounds
        if not last and not error < PILOT_ERROR:
            continue
        for again in range(1, budget.extensions + 1):
            if not chains.mixed:
                more = _run_nuts(*target, budget.seed + 100 * number + again, chains.theta[:, -1])
                chains = chains.followed_by(more)
        if not chains.mixed:
            if not last:  # a rough stand-in holds chains up; the pilots smooth the next one
                continue
            return Sampled(chains, None, emulator, SampleStatus.not_mixed, number)
        each = max(budget.exact // len(chains.theta), 2)  # evenly spaced draws of each chain
        at = np.linspace(0, chains.theta.shape[1] - 1, each).round().astype(int)
        weighted = reweight(chains.theta[:, at], chains.log_density[:, at], data, priors)
        if last or weighted.status is SampleStatus.accepted:
            return Sampled(chains, weighted, emulator, weighted.status, number)
        points += weighted.points  # refused: values without derivatives train, too
    raise AssertionError("the last round returns")


# --- The sampled hyperparameters as an ArviZ DataTree, in physical units.

PRIOR_DRAWS = 2000


def hyper_names(input_names: tuple[str, ...]) -> list[str]:
    """Flat names in the order of theta, for labels and messages."""
    linear, length = ([f"{kind}[{name}]" for name in input_names] for kind in ("linear", "length_scale"))
    return ["constant", *linear, "signal", *length, "noise"]


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
    assert weighted is not None
    shape, theta = weighted.exact.shape, weighted.theta
    drawn = theta.reshape(-1, theta.shape[-1])[at].reshape(theta.shape)
    prior = np.asarray(priors.sample(jax.random.PRNGKey(seed), len(names), PRIOR_DRAWS))[None]
    densities = {"lp": weighted.exact, "lp_stand_in": weighted.stand_in / TEMPER, "log_weight": weighted.log_weight}
    groups = {
        "posterior": scaling.physical(drawn),
        "sample_stats": {"lp": weighted.exact.ravel()[at].reshape(shape), "proposal_index": at.reshape(shape)},
        "prior": scaling.physical(prior),
        "proposal": scaling.physical(theta) | densities,
        "stand_in": {"theta": chains.theta, "lp": chains.log_density / TEMPER},
    }
    per_input = {"linear": ["input"], "length_scale": ["input"], "theta": ["hyperparameter"]}
    tree = from_dict(groups, dims=per_input, coords={"input": list(names), "hyperparameter": hyper_names(names)})
    mixing = {name: ("hyperparameter", x) for name, x in (("rhat", chains.rhat), ("ess_bulk", chains.ess))}
    tree["stand_in"] = tree["stand_in"].to_dataset().assign(mixing)
    tree.attrs |= {"k_hat": weighted.k_hat, "k_limit": K_LIMIT, "weight_ess": weighted.ess, "rounds": sampled.rounds}
    tree.attrs |= {"divergences": chains.divergences, "variance_inflation": TEMPER, "status": sampled.status.name}
    tree.attrs |= {"output_name": output_name, "output_rms": scaling.rms}
    tree.attrs |= {"input_mean": scaling.mean, "input_sd": scaling.sd}
    tree["sample_stats"].attrs |= {"pareto_k": weighted.k_hat, "status": sampled.status.name}
    return tree


# --- Predictions of the GP: mean, standard deviation and quantiles, at the MAP or over the posterior of theta.
# Over the posterior, the predictive distribution is an equal-weight mixture of Gaussians, one for each of a few
# draws; its quantiles are those of the mixture, not of a Gaussian with the mixture's sd. All are of the *measured*
# output: latent function plus white noise (see the caveat in `gp_kernel.py` on what white noise means here).
LEVELS = (0.5, 0.9, 0.95)


class Prediction(NamedTuple):
    """Predictive distribution at n points, in the unit of the output."""

    mean: Float[np.ndarray, " n"]  # of a new measurement, as `sd`
    sd: Float[np.ndarray, " n"]
    latent_sd: Float[np.ndarray, " n"]  # of the function without noise
    levels: tuple[float, ...]  # of the central intervals from `low` to `high`
    low: Float[np.ndarray, "levels n"]
    high: Float[np.ndarray, "levels n"]
    component_mean: Float[np.ndarray, "draws n"]  # of the Gaussians of the mixture
    component_sd: Float[np.ndarray, "draws n"]

    @classmethod
    def of_mixture(
        cls,
        means: Float[np.ndarray, "draws n"],
        latent: Float[np.ndarray, "draws n"],
        noise: Float[np.ndarray, " draws"],
    ) -> Prediction:
        """Equal-weight mixture of Gaussians with `means`, latent variances and noise variances."""
        between, sds = means.var(axis=0), np.sqrt(latent + noise[:, None])
        sd = np.sqrt(between + np.mean(sds**2, axis=0))

        def quantile(probability: float) -> np.ndarray:
            """By bisection: the cdf is monotone and the ends bracket every component's quantile."""
            low, high = (means - 9.0 * sds).min(axis=0), (means + 9.0 * sds).max(axis=0)
            for _ in range(50):
                middle = 0.5 * (low + high)
                below = ndtr((middle - means) / sds).mean(axis=0) < probability
                low, high = np.where(below, middle, low), np.where(below, high, middle)
            return 0.5 * (low + high)

        tails = [(1.0 - level) / 2.0 for level in LEVELS]
        low, high = (np.array([quantile(p) for p in ps]) for ps in (tails, [1.0 - tail for tail in tails]))
        latent_sd = np.sqrt(between + latent.mean(axis=0))
        return cls(means.mean(axis=0), sd, latent_sd, LEVELS, low, high, means, sds)

    def coverage(self, measured: Float[np.ndarray, " n"]) -> dict[float, float]:
        """Share of `measured` inside each central interval, by level."""
        z = np.asarray(measured, float)
        inside = (z >= self.low) & (z <= self.high)
        return dict(zip(self.levels, inside.mean(axis=1).tolist(), strict=True))


def gaussian_parts(
    theta: Theta, data: ReducedData, x_new: Float[np.ndarray, "k d"]
) -> tuple[Float[np.ndarray, " k"], Float[np.ndarray, " k"]]:
    """Mean and variance of the latent function at scaled inputs x_new (k, d), in scaled output units."""
    # With R, F, D of `gp_kernel`, S = R^-1 F (D^-1 + F'R^-1 F)^-1 and k_*: the explicit-basis form (Rasmussen and
    # Williams 2006, eq. 2.42) with a proper prior D on the basis. One factorisation and one triangular solve.
    d, factor = data.x.shape[1], factorise(noise_to_signal(theta), data)
    if factor is None:
        raise np.linalg.LinAlgError("covariance not positive definite at an accepted draw")
    lower, v = factor
    length, sf2 = np.exp(theta[d + 2 : 2 * d + 2]), np.exp(2.0 * theta[d + 1])
    root = np.exp(theta[: d + 1] - theta[d + 1])
    basis = data.fy[:, : d + 1] * root
    v_basis, v_y = v[:, : d + 1] * root, v[:, d + 1]
    inner = (cholesky(np.eye(d + 1) + basis.T @ v_basis, lower=True), True)
    weight = cho_solve(inner, basis.T @ v_y)  # posterior mean of the basis weights, in units of root
    cross = scaled_distance_kernel(data.x / length, x_new / length)  # (n, k)
    new = np.column_stack([np.ones(len(x_new)), x_new]) * root
    mean = new @ weight + cross.T @ (v_y - v_basis @ weight)
    extra = solve_triangular(inner[0], (new - cross.T @ v_basis).T, lower=True)
    half = solve_triangular(lower, cross, lower=True, check_finite=False)
    variance = 1.0 - np.einsum("ij,ij->j", half, half) + np.einsum("ij,ij->j", extra, extra)
    return mean, sf2 * np.maximum(variance, 0.0)


# --- The fit.

MAX_SAMPLES = 8000


@dataclass(frozen=True, eq=False)
class GPFit:
    """A trained GP."""

    input_names: tuple[str, ...]
    scaling: Scaling
    data: ReducedData
    optima: tuple[Optimum, ...]  # the distinct ones found, best first
    status: SampleStatus  # result of the sampling (`.value` is advice)
    sampled: Sampled | None
    draws: Float[np.ndarray, "draws p"] | None  # the posterior's theta, log scaled, equal weight
    posterior: xr.DataTree | None  # hyperparameters in physical units (`posterior_tree`); None unless accepted

    @property
    def map(self) -> dict[str, np.ndarray]:
        return self.scaling.physical(self.optima[0].theta)

    @property
    def map_status(self) -> MapStatus:
        return self.optima[0].status

    @property
    def k_hat(self) -> float:
        """Pareto k of the re-weighting to the exact posterior; NaN where it was not reached."""
        return self.sampled.weighted.k_hat if self.sampled and self.sampled.weighted else math.nan

    def predict(self, X_new: Matrix, *, draws: int = 24) -> Prediction:
        """Predictive distribution at X_new (k, d), physical units, over `draws` of the posterior or at the MAP."""
        X_new = np.asarray(X_new, float)
        if X_new.ndim != 2 or X_new.shape[1] != len(self.input_names) or not np.all(np.isfinite(X_new)):
            raise InputError(
                f"Inputs to predict at must be finite, (k, {len(self.input_names)}) for "
                f"{', '.join(self.input_names)}; got shape {X_new.shape}."
            )
        thetas = self.optima[0].theta[None]
        if self.draws is not None:
            count = min(draws, len(self.draws))
            thetas = self.draws[np.linspace(0, len(self.draws) - 1, count).round().astype(int)]
        x_new = self.scaling.inputs(X_new)
        with blas_threads(self.data.n):
            parts = [gaussian_parts(t, self.data, x_new) for t in thetas]
        means, latent = (np.array(p) for p in zip(*parts, strict=True))
        rms = self.scaling.rms
        return Prediction.of_mixture(rms * means, rms**2 * latent, rms**2 * np.exp(2.0 * thetas[:, -1]))


def fit_gp(
    X: Matrix,
    y: Vector,
    *,
    names: tuple[str, ...] = (),
    priors: Priors = Priors(),
    sample: bool = True,
    budget: Budget = Budget(),
) -> GPFit:
    """Train a DPSE Gaussian process on inputs X (n, d) and output y (n,), any units; `sample` adds the posterior."""
    # `names` of the inputs, and of the output behind them.
    X, y = np.asarray(X, float), np.asarray(y, float)
    *inputs, output_name = names or (*(f"x{i}" for i in range(X.shape[-1])), "y")
    names = tuple(inputs)
    if len(X) > MAX_SAMPLES:
        raise InputError(too_many(len(X)))
    if sample and any(q.family == "flat" for q in priors.each):
        raise InputError("A flat hyperparameter prior is improper: set sample=False or give proper priors.")
    scaling = Scaling.of(X, y, names)
    data = ReducedData.of(scaling.inputs(X), y / scaling.rms)
    optima = tuple(find_map(data, priors, starts=budget.starts, seed=budget.seed))
    status, sampled, draws, tree = SampleStatus.not_sampled, None, None, None
    if sample and optima[0].status is MapStatus.not_positive_definite:
        status = SampleStatus.no_optimum
    elif sample and data.dependent:
        status = SampleStatus.dependent
    elif sample:
        sampled = sample_posterior(optima[0], data, priors, budget=budget)
        status = sampled.status
    if sampled is not None and sampled.weighted is not None and status is SampleStatus.accepted:
        weighted = sampled.weighted
        flat = weighted.theta.reshape(-1, weighted.theta.shape[-1])
        best = flat[int(np.argmax(weighted.exact))]  # perhaps near an optimum that the starts did not find
        if np.max(np.abs(noise_to_signal(best) - optima[0].u)) > SAME_OPTIMUM:
            another = maximise(noise_to_signal(best), data, priors, w=best[: len(names) + 2])
            optima = tuple(distinct([*optima, another], len(optima) + 1))
        at = systematic_resample(weighted.log_weight, budget.seed)
        draws, tree = flat[at], posterior_tree(sampled, at, scaling, priors, names, output_name, budget.seed)
    return GPFit(names, scaling, data, optima, status, sampled, draws, tree)


def too_many(n: int) -> str:
    """Why so many samples are refused, and the alternatives."""
    return (
        f"n = {n} samples exceed the bound of {MAX_SAMPLES} of the exact Gaussian process (about "
        f"{5 * 8 * n**2 / 2**30:.0f} GiB and n^3 time); give shorter parts of the records, or a longer time step "
        "(--resample)"
    )
