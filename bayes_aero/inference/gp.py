"""Gaussian-process regression of one output on a few inputs: `fit_gp`, and its result `GPFit`.

fit = fit_gp(X, y, names=("alpha", "elevator", "q", "V", "CL"), sample=True)
fit.predict(X_new).mean;  fit.posterior;  fit.status.value;  fit.k_hat
"""

from __future__ import annotations

import enum
import math
import os
import sys
import time
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple, get_args

import jax
import jax.numpy as jnp
import numpy as np
import xarray as xr
from arviz_base import from_dict
from arviz_stats.base import array_stats
from jaxtyping import Float, Int
from joblib import Parallel, delayed, parallel_config
from joblib.externals.loky.process_executor import TerminatedWorkerError
from scipy.linalg import cholesky, solve_triangular
from scipy.special import logsumexp, ndtr

from bayes_aero.errors import InputError
from bayes_aero.inference import gp_kernel as kernel
from bayes_aero.inference.mle import fit_mle
from bayes_aero.inference.results import GPReport, MleResult, Validation, score
from bayes_aero.model.model import Model
from bayes_aero.model.observations import Observations
from bayes_aero.processes import blas_threads, cores, exit_with, give_back_memory
from bayes_aero.progress import Progress, quiet

Matrix = Float[np.ndarray, "n d"] | Float[jax.Array, "n d"]
Vector = Float[np.ndarray, " n"] | Float[jax.Array, " n"]

# --- Posterior of the hyperparameters by importance sampling, each draw weighed by its exact density.
# Only u = (log l, log g) costs an n x n factorisation. It is drawn from a Student t about the optimum, adapted to its
# own weighed draws round by round; at each u the other hyperparameters w are drawn from a Student t about their own
# optimum, at no such cost, and their mean weight is that of u. The weights of u are Pareto-smoothed (PSIS, Vehtari et
# al. 2024, JMLR 25(72)) by ArviZ; the Pareto k says whether that works: above 0.7 the draws are refused. Source of the
# rounds: Cappe et al., J. Comp. Graph. Stat. 13 (2004) 907.

DEGREES_OF_FREEDOM = 5.0  # of the proposals: tails heavier than the posterior's
INNER_DRAWS = 16  # of w at each u
STEP = 1e-3  # of w, for the curvature there
WIDEST = 1.5  # standard deviation of a proposal in directions that the data leave open
K_LIMIT = 0.7  # largest Pareto k that is accepted; its standard error is about 0.2 on this few draws
ESS_SHARE = 0.3  # k judges the tail of the weights only; a proposal beside the posterior shows in their ESS


class SampleStatus(enum.Enum):
    """Result of the sampling of hyperparameters; the value is the text for the user."""

    accepted = "The re-weighted draws represent the exact posterior of the hyperparameters."
    not_sampled = "Only the most probable hyperparameters were asked for; set sample=True for their posterior."
    uneven_weights = (
        "Refused: a few draws carry most of the weight (Pareto k, effective sample size), so the proposal misses part "
        "of the exact posterior. Use the MAP, allow more rounds or draws, or give stronger hyperparameter priors."
    )
    not_positive_definite = (
        "Refused: the exact covariance could not be factorised at some draws. "
        "Use the MAP, or give the noise a prior with a larger median."
    )
    no_optimum = "Refused: the search for the most probable hyperparameters failed; see the MAP's status."


class Budget(NamedTuple):
    """Of the search for the mode and of the sampling, and the seed of both."""

    draws: int = 192  # of a round, a factorisation each
    rounds: int = 6  # of adaptation, at most
    starts: int = 16  # of the search for the mode
    seed: int = 0


class Weighted(NamedTuple):
    """Exactly evaluated draws, and whether their weights may be used; `k_hat` and `ess` judge them."""

    theta: Float[np.ndarray, "draws p"]
    exact: Float[np.ndarray, " draws"]  # log densities
    log_weight: Float[np.ndarray, " draws"]  # by PSIS, normalised
    k_hat: float
    ess: float
    status: SampleStatus


def student_draws(
    rng: np.random.Generator, count: int, centre: Float[np.ndarray, " k"], root: Float[np.ndarray, "k k"]
) -> tuple[Float[np.ndarray, "count k"], Float[np.ndarray, " count"]]:
    """Draws of a Student t of scale `root` root', and their log densities but for a constant."""
    k, nu = len(centre), DEGREES_OF_FREEDOM
    z = rng.standard_normal((count, k)) * np.sqrt(nu / rng.chisquare(nu, (count, 1)))
    log_density = -0.5 * (nu + k) * np.log1p(np.sum(z**2, axis=1) / nu) - np.linalg.slogdet(root)[1]
    return centre + z @ root.T, log_density


def sample_posterior(
    optimum: kernel.Optimum, data: kernel.ReducedData, priors: kernel.Priors, *, budget: Budget = Budget()
) -> Weighted:
    """Weighed draws of theta from the exact posterior around `optimum`, with a status."""
    rng, k = np.random.default_rng(budget.seed), data.x.shape[1] + 2
    centre, covariance = optimum.u, kernel.curvature(optimum, data, priors)
    steps, box = STEP * np.eye(k), kernel.search_box(k - 2)  # beyond that of the search the posterior is cut off
    for number in range(budget.rounds):
        us, proposed = student_draws(rng, budget.draws, centre, np.linalg.cholesky(covariance))
        profile, status = kernel.ProfilePosterior(data, priors, optimum.theta[:k].copy()), SampleStatus.accepted
        theta, exact, ratio = np.tile(optimum.theta, (len(us), 1)), np.full(len(us), -np.inf), np.full(len(us), -np.inf)
        for i, u in enumerate(us):
            if np.any((u < box[:, 0]) | (u > box[:, 1])):
                continue
            try:
                point = kernel.exact_point(u, data, slopes=False)
                profile.inner(point)
                bends = [kernel.slopes(profile.w + s, point, data.n, priors).by_w for s in (*steps, *-steps)]
            except np.linalg.LinAlgError:
                status = SampleStatus.not_positive_definite
                continue
            bend = (np.array(bends[k:]) - bends[:k]) / (4.0 * STEP)
            values, vectors = np.linalg.eigh(bend + bend.T)  # of minus the second derivatives by w
            w, of_w = student_draws(rng, INNER_DRAWS, profile.w, vectors / np.sqrt(np.maximum(values, WIDEST**-2.0)))
            thetas = np.array([kernel.assemble(x, u) for x in w])
            density = np.array([kernel.density_at(t, point, data.n, priors) for t in thetas])
            weight = np.where(np.isfinite(density), density, -np.inf) - of_w
            if not np.isfinite(weight).any():
                continue
            ratio[i] = logsumexp(weight) - np.log(INNER_DRAWS) - proposed[i]
            at = rng.choice(INNER_DRAWS, p=np.exp(weight - logsumexp(weight)))
            theta[i], exact[i] = thetas[at], density[at]
        log_weight, k_hat = pareto_smooth(ratio)
        ess = float(np.exp(-np.asarray(logsumexp(2.0 * log_weight))))
        if status is SampleStatus.accepted and (k_hat > K_LIMIT or ess < ESS_SHARE * len(us)):
            status = SampleStatus.uneven_weights
        if status is SampleStatus.accepted or number == budget.rounds - 1:
            return Weighted(theta, exact, log_weight, k_hat, ess, status)
        share = np.exp(log_weight)  # of the posterior, as far as this round has found it
        mean, spread = share @ us, np.cov(us.T, aweights=share, ddof=0).reshape(covariance.shape)
        weigh = ess / (ess + len(centre) ** 2)  # few effective draws leave most of the proposal as it was
        covariance = (1.0 - weigh) * covariance + weigh * spread
        centre = (1.0 - weigh) * centre + weigh * mean
    raise AssertionError("the last round returns")


def pareto_smooth(log_ratio: Float[np.ndarray, "*shape"]) -> tuple[Float[np.ndarray, "*shape"], float]:
    """Normalised smoothed log weights and Pareto k. (ArviZ's psislw takes *minus* the log-ratio, as in LOO.)"""
    if np.ptp(log_ratio) < 1e-12:
        return np.full(log_ratio.shape, -np.log(log_ratio.size)), -np.inf  # no error, hence no tail to fit
    log_ratio = np.maximum(log_ratio, np.max(log_ratio) - 300.0)  # a weight of nothing is finite in the logarithm
    with np.errstate(divide="ignore", invalid="ignore"):  # where nearly all weight is that of a few draws
        smoothed, k_hat = (np.asarray(x, float) for x in array_stats.psislw(-log_ratio.ravel()))
    if not (np.all(np.isfinite(smoothed)) and np.isfinite(k_hat)):
        smoothed, k_hat = log_ratio.ravel(), np.inf
    return (smoothed - float(np.asarray(logsumexp(smoothed)))).reshape(log_ratio.shape), float(k_hat)


# --- The sampled hyperparameters as an ArviZ DataTree, in physical units.

PRIOR_DRAWS = 2000


def systematic_resample(log_weight: Float[np.ndarray, " draws"], seed: int) -> Int[np.ndarray, " draws"]:
    """Indices of as many equally weighted draws as there are weights, in order (systematic resampling)."""
    edges = np.cumsum(np.exp(log_weight))
    positions = (np.random.default_rng(seed).uniform() + np.arange(edges.size)) / edges.size
    return np.minimum(np.searchsorted(edges / edges[-1], positions), edges.size - 1)


def posterior_tree(
    weighted: Weighted,
    at: Int[np.ndarray, " draws"],
    scaling: kernel.Scaling,
    priors: kernel.Priors,
    names: tuple[str, ...],
    output_name: str,
    seed: int,
) -> xr.DataTree:
    """The posterior as an ArviZ DataTree; hyperparameters in physical units."""
    # `posterior`: draws of the exact posterior with equal weights (the indices `at` of the weighted ones), and
    # `sample_stats` of these; `prior`; `proposal`: the weighted draws, with their exact log densities and PSIS log
    # weights.
    prior = priors.sample(np.random.default_rng(seed), len(names), PRIOR_DRAWS)
    groups = {
        "posterior": scaling.physical(weighted.theta[at]),
        "sample_stats": {"lp": weighted.exact[at], "proposal_index": at},
        "prior": scaling.physical(prior),
        "proposal": scaling.physical(weighted.theta) | {"lp": weighted.exact, "log_weight": weighted.log_weight},
    }
    one_chain = {group: {name: x[None] for name, x in values.items()} for group, values in groups.items()}
    tree = from_dict(one_chain, dims={"linear": ["input"], "length_scale": ["input"]}, coords={"input": list(names)})
    tree.attrs |= {"k_hat": weighted.k_hat, "k_limit": K_LIMIT, "weight_ess": weighted.ess}
    tree.attrs |= {"status": weighted.status.name, "output_name": output_name, "output_rms": scaling.rms}
    tree.attrs |= {"input_mean": scaling.mean, "input_sd": scaling.sd}
    tree["sample_stats"].attrs |= {"pareto_k": weighted.k_hat, "status": weighted.status.name}
    return tree


# --- Predictions of the GP: mean, standard deviation and quantiles, at the MAP or over the posterior of theta.
# Over the posterior, the predictive distribution is an equal-weight mixture of Gaussians, one for each of a few
# draws; its quantiles are those of the mixture, not of a Gaussian with the mixture's sd. All are of the *measured*
# output: latent function plus white noise (see the caveat in `gp_kernel.py` on what white noise means here).
LEVELS = (0.5, 0.9, 0.95)
JITTER = 1e-11  # of the mean variance, on the diagonal: above rounding, where there is no noise

OfDraws = Float[np.ndarray, "draws n"]


class Prediction(NamedTuple):
    """Predictive distribution at n points, in the unit of the output."""

    mean: Float[np.ndarray, " n"]  # of a new measurement, as `sd`
    sd: Float[np.ndarray, " n"]
    levels: tuple[float, ...]  # of the central intervals from `low` to `high`
    low: Float[np.ndarray, "levels n"]
    high: Float[np.ndarray, "levels n"]

    @classmethod
    def of_mixture(cls, means: OfDraws, latent: OfDraws, noise: Float[np.ndarray, " draws"]) -> Prediction:
        """Equal-weight mixture of Gaussians with `means`, latent variances and noise variances."""
        variance = latent + noise[:, None]
        sds = np.sqrt(variance)

        def quantile(probability: float) -> np.ndarray:
            """By bisection: the cdf is monotone and the ends bracket every component's quantile."""
            low, high = (means - 9.0 * sds).min(axis=0), (means + 9.0 * sds).max(axis=0)
            for _ in range(50):
                middle = 0.5 * (low + high)
                below = ndtr((middle - means) / sds).mean(axis=0) < probability
                low, high = np.where(below, middle, low), np.where(below, high, middle)
            return 0.5 * (low + high)

        low, high = (np.array([quantile(0.5 + sign * 0.5 * level) for level in LEVELS]) for sign in (-1.0, 1.0))
        return cls(means.mean(axis=0), np.sqrt(means.var(axis=0) + variance.mean(axis=0)), LEVELS, low, high)

    def coverage(self, measured: Float[np.ndarray, " n"]) -> dict[float, float]:
        """Share of `measured` inside each central interval, by level."""
        z = np.asarray(measured, float)
        inside = (z >= self.low) & (z <= self.high)
        return dict(zip(self.levels, inside.mean(axis=1).tolist(), strict=True))


def gaussian_parts(
    theta: kernel.Theta, data: kernel.ReducedData, x_new: Float[np.ndarray, "k d"]
) -> tuple[Float[np.ndarray, " k"], Float[np.ndarray, " k"]]:
    """Mean and variance of the latent function at scaled inputs x_new (k, d), in scaled output units."""
    d, e = data.x.shape[1], np.exp(theta)
    length, slope, sf2 = e[d + 2 : 2 * d + 2], e[1 : d + 1] ** 2, e[d + 1] ** 2

    def covariance(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        return e[0] ** 2 + (a * slope) @ b.T + sf2 * kernel.scaled_distance_kernel(a / length, b / length)

    K = covariance(data.x, data.x)
    K[np.diag_indices_from(K)] += e[-1] ** 2 + JITTER * np.trace(K) / len(K)
    lower, cross = cholesky(K, lower=True, overwrite_a=True, check_finite=False), covariance(data.x, x_new)
    half, weight = (solve_triangular(lower, b, lower=True, check_finite=False) for b in (cross, data.fy[:, d + 1]))
    variance = e[0] ** 2 + x_new**2 @ slope + sf2 - np.einsum("ij,ij->j", half, half)
    return half.T @ weight, np.maximum(variance, 0.0)


# --- The fit.

MAX_SAMPLES = 8000


@dataclass(frozen=True, eq=False)
class GPFit:
    """A trained GP."""

    scaling: kernel.Scaling
    data: kernel.ReducedData
    optima: tuple[kernel.Optimum, ...]  # the distinct ones found, best first
    status: SampleStatus  # result of the sampling (`.value` is advice)
    sampled: Weighted | None
    draws: Float[np.ndarray, "draws p"] | None  # the posterior's theta, log scaled, equal weight
    posterior: xr.DataTree | None  # hyperparameters in physical units (`posterior_tree`); None unless accepted

    @property
    def map(self) -> dict[str, np.ndarray]:
        return self.scaling.physical(self.optima[0].theta)

    @property
    def map_status(self) -> kernel.MapStatus:
        return self.optima[0].status

    @property
    def k_hat(self) -> float:
        """Pareto k of the re-weighting to the exact posterior; NaN where it was not reached."""
        return self.sampled.k_hat if self.sampled else math.nan

    def predict(self, X_new: Matrix, *, draws: int = 24) -> Prediction:
        """Predictive distribution at X_new (k, d), physical units, over `draws` of the posterior or at the MAP."""
        thetas = self.optima[0].theta[None]
        if self.draws is not None:
            count = min(draws, len(self.draws))
            thetas = self.draws[np.linspace(0, len(self.draws) - 1, count).round().astype(int)]
        x_new = self.scaling.inputs(np.asarray(X_new, float))
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
    priors: kernel.Priors = kernel.Priors(),
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
    scaling = kernel.Scaling.of(X, y, names)
    data = kernel.ReducedData.of(scaling.inputs(X), y / scaling.rms)
    optima = tuple(kernel.find_map(data, priors, starts=budget.starts, seed=budget.seed))
    status, sampled, draws, tree = SampleStatus.not_sampled, None, None, None
    if sample and optima[0].status is kernel.MapStatus.not_positive_definite:
        status = SampleStatus.no_optimum
    elif sample:
        sampled = sample_posterior(optima[0], data, priors, budget=budget)
        status = sampled.status
    if sampled is not None and status is SampleStatus.accepted:
        best = sampled.theta[int(np.argmax(sampled.exact))]  # perhaps near an optimum that the starts did not find
        if np.max(np.abs(kernel.noise_to_signal(best) - optima[0].u)) > kernel.SAME_OPTIMUM:
            another = kernel.maximise(kernel.noise_to_signal(best), data, priors, w=best[: len(names) + 2])
            optima = tuple(kernel.distinct([*optima, another], len(optima) + 1))
        at = systematic_resample(sampled.log_weight, budget.seed)
        draws, tree = sampled.theta[at], posterior_tree(sampled, at, scaling, priors, names, output_name, budget.seed)
    return GPFit(scaling, data, optima, status, sampled, draws, tree)


def too_many(n: int) -> str:
    """Why so many samples are refused, and the alternatives."""
    return (
        f"n = {n} samples exceed the bound of {MAX_SAMPLES} of the exact Gaussian process (about "
        f"{5 * 8 * n**2 / 2**30:.0f} GiB and n^3 time); give shorter parts of the records, or a longer time step "
        "(--resample)"
    )


# --- Validation: trained and scored on splits of the records, beside maximum likelihood.

KINDS: tuple[SplitKind, ...] = ("random", "block", "manoeuvre")
LEVEL = 0.95
WORTH_PROCESSES = 1000  # training samples from which a process for each core pays for its start of some seconds


def gp_inputs(observations: Observations, names: tuple[str, ...]) -> Float[np.ndarray, "n d"]:
    """The regression inputs as columns, SI and radians."""
    for name in names:
        if name not in observations.signals:
            raise InputError(f"the Gaussian process needs the signal {name}; map it on the card or change [gp] inputs")
    return np.stack([np.asarray(observations.signals[name]) for name in names], axis=1)


class Training(NamedTuple):
    """How Gaussian processes are trained: hyperparameters are sampled, if `sample`, for the first fold of the split
    `chosen`; for the others, at their mode."""

    chosen: SplitKind
    seed: int = 0
    sample: bool = True


def validate(
    model: Model,
    observations: Observations,
    mle: MleResult,
    inputs: tuple[str, ...],
    training: Training,
    progress: Progress = quiet,
) -> GPReport:
    """Train on each split's training points and score on its test points, both models on the same ones."""
    # A split that the records do not allow is left out: of one manoeuvre alone, or of one shorter than two blocks.
    began, names, left_out, splits = time.perf_counter(), observations.coefficients, (), {}
    for kind in KINDS:
        try:
            splits[kind] = make_splits(kind, observations.manoeuvre, observations.dt, training.seed)
        except InputError:
            if kind == "random":
                raise
            if kind == "block":
                shortest = f"a manoeuvre is shorter than two blocks of {BLOCK_SECONDS:g} s"
                left_out = (f"The Gaussian process was not tested on hold-out blocks: {shortest}.",)
    chosen = next(k for k in (training.chosen, "block", "random") if k in splits)
    largest = max(len(f.train_idx) for folds in splits.values() for f in folds)
    if largest > MAX_SAMPLES:
        raise InputError(too_many(largest))
    X, z = gp_inputs(observations, inputs), np.asarray(observations.measured)
    work = {}  # the long ones, which are sampled, first
    every = [(kind, number) for kind, folds in splits.items() for number in range(len(folds))]
    for kind, number in sorted(every, key=lambda fold: fold != (chosen, 0)):
        sampled = training.sample and (kind, number) == (chosen, 0)
        for c, name in enumerate(names):
            work[kind, number, name] = X, z[:, c], (*inputs, name), splits[kind][number], (sampled, training.seed)
    trained = _trained(work, largest, progress)
    validated: dict[str, list[dict[str, Validation]]] = {kind: [{} for _ in folds] for kind, folds in splits.items()}
    for kind, folds in splits.items():
        for number, fold in enumerate(folds):
            test = fold.test_idx
            fit = fit_mle(model, observations.subset(fold.train_idx), start=mle.estimate, extra_starts=0)
            y = model.predicted(jnp.asarray(fit.estimate), observations.signals, observations.aircraft)
            for name, measured, by_mle in zip(names, z[test].T, np.asarray(y)[test].T, strict=True):
                both = {"measured": measured, "mle": by_mle, "mle_scores": score(measured, by_mle)}
                validated[kind][number][name] = Validation(test=test, **both, **trained[kind, number, name][1])
    fits = {name: trained[chosen, 0, name][0] for name in names if training.sample}
    return GPReport(validated, fits, chosen, time.perf_counter() - began, left_out)


def _train(
    parent: int,
    tidy: bool,
    X: Float[np.ndarray, "n d"],
    z: Float[np.ndarray, " n"],
    names: tuple[str, ...],
    fold: HoldoutSplit,
    sampled_with_seed: tuple[bool, int],
) -> tuple[GPFit, dict[str, Any]]:
    """One fit, in a process that ends with its `parent`, and its scores."""
    exit_with(parent)
    train, test, (sampled, seed) = fold.train_idx, fold.test_idx, sampled_with_seed
    priors = kernel.Priors.quasi_steady()
    fit = fit_gp(X[train], z[train], names=names, priors=priors, sample=sampled, budget=Budget(seed=seed))
    if tidy:
        give_back_memory()
    measured, prediction = z[test], fit.predict(X[test])
    level = prediction.levels.index(LEVEL)
    return fit, {
        "gp": prediction.mean,
        "gp_low": prediction.low[level],
        "gp_high": prediction.high[level],
        "gp_scores": score(measured, prediction.mean),
        "coverage": prediction.coverage(measured),
        "k_hat": float(fit.k_hat) if np.isfinite(fit.k_hat) else None,
        "status": fit.status.value if sampled else fit.map_status.value,
    }


def _trained(work: dict[tuple[str, int, str], Any], n: int, progress: Progress) -> dict[tuple, Any]:
    jobs, trained, tidy = 1, {}, n >= WORTH_PROCESSES  # fewer samples: compiling anew costs more than memory is worth
    if tidy:  # by cores and memory: each takes eight n x n matrices and 1 GiB for the compiler
        each = 8 * 8 * n**2 + 2**30
        free = os.sysconf("SC_AVPHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") if sys.platform == "linux" else 2 * each
        jobs = max(1, min(len(work), cores(), free // each))
        give_back_memory()
    # LAPACK holds Python's lock and gains little from a second thread at these sizes: one process a core.
    with parallel_config(backend="loky", inner_max_num_threads=1):
        tasks = (delayed(_train)(os.getpid(), tidy, *given) for given in work.values())
        results: Any = Parallel(n_jobs=jobs, return_as="generator")(tasks)
        try:
            for (kind, number, name), result in zip(work, results, strict=True):
                trained[kind, number, name] = result
                progress(f"gp: {name}, {kind} split", len(trained) / len(work))
        except TerminatedWorkerError:
            raise InputError(
                f"a process that trained on up to {n} samples was killed, probably for lack of memory; "
                "thin the records or free memory"
            ) from None
    return trained


# --- Splits into training and hold-out data: at random as published, in contiguous blocks, or by manoeuvre.
# A random split of 25 Hz flight data is hardly a split: nearly every hold-out sample has a neighbour 40 ms away in
# the training set, with residuals whose lag-1 correlation reaches 0.98. Its scores measure interpolation between
# neighbours. With `block` only samples near block edges have such neighbours, with `manoeuvre` none.

SplitKind = Literal["random", "block", "manoeuvre"]
Index = Int[np.ndarray, " n"] | Int[jax.Array, " n"]

TRAIN_SHARE = 0.7  # the seed paper's 70/30
MAX_FOLDS = 10  # of manoeuvres; more manoeuvres are held out in groups
BLOCK_SECONDS = 4.0  # our choice: about 100 samples, longer than the memory of the residuals (1-2 s)


class HoldoutSplit(NamedTuple):
    """One division of the samples: sorted indices `train_idx` and `test_idx`, disjoint and complete."""

    train_idx: Int[np.ndarray, " n_train"]
    test_idx: Int[np.ndarray, " n_test"]

    @classmethod
    def of(cls, train: np.ndarray) -> HoldoutSplit:
        return cls(np.flatnonzero(train), np.flatnonzero(~train))


def make_splits(
    kind: SplitKind, manoeuvre_index: Index, dt: float, seed: int, *, block_seconds: float = BLOCK_SECONDS
) -> list[HoldoutSplit]:
    """Splits of the samples whose manoeuvre is `manoeuvre_index` (n,), sampled every `dt` seconds."""
    # `random` and `block` give one 70/30 split (ask again with another seed for more); `manoeuvre` gives one fold for
    # each manoeuvre (beyond ten for each of ten groups), held back while all the others train: for two, both
    # directions.
    index = np.asarray(manoeuvre_index)
    if index.ndim != 1 or index.size < 10:
        raise InputError(f"A split needs a vector of at least 10 samples, got shape {index.shape}.")
    if not (np.isfinite(dt) and dt > 0):
        raise InputError(f"The sampling interval dt = {dt} s must be positive.")
    if kind == "manoeuvre":
        names = np.unique(index)
        if names.size < 2:
            raise InputError(
                "A manoeuvre split needs at least two records, one to train on and one to predict; "
                "add a record or use the block split."
            )
        return [HoldoutSplit.of(~np.isin(index, held)) for held in np.array_split(names, min(names.size, MAX_FOLDS))]
    if kind not in ("random", "block"):
        raise InputError(f"Unknown split {kind!r}; choose one of {', '.join(get_args(SplitKind))}.")
    rng, train, length = np.random.default_rng(seed), np.zeros(index.size, bool), round(block_seconds / dt)
    if kind == "random":
        train[rng.permutation(index.size)[: round(TRAIN_SHARE * index.size)]] = True
        return [HoldoutSplit.of(train)]
    for manoeuvre in np.unique(index):  # the same share of every manoeuvre trains
        samples = np.flatnonzero(index == manoeuvre)
        count = samples.size // max(length, 1)
        if length < 1 or count < 2:
            raise InputError(
                f"Manoeuvre {manoeuvre} has {samples.size} samples, too few for two blocks of {length}; "
                "choose another block length."
            )
        blocks = np.array_split(samples, count)  # lengths differ by a sample or so, none is a stub
        n_train = min(max(round(TRAIN_SHARE * count), 1), count - 1)
        for b in rng.permutation(count)[:n_train]:
            train[blocks[b]] = True
    return [HoldoutSplit.of(train)]
