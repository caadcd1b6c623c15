"""Whether results hold: hold-out samples, posteriors against records and priors, one-step predictions, the stall."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Mapping, Sequence
from enum import Enum
from typing import Any, Literal, NamedTuple, get_args

import arviz_base as azb
import arviz_stats as azs
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
from jax.scipy.special import ndtr
from jaxtyping import Array, Bool, Float, Int
from joblib import Parallel, delayed, parallel_config
from joblib.externals.loky.process_executor import TerminatedWorkerError
from scipy.special import betainc
from scipy.stats import beta, binom, norm

from bayes_aero.dynamics.innovations import neighbour_correlation
from bayes_aero.dynamics.kalman import Filtered
from bayes_aero.dynamics.trim import conditions, steady_flow
from bayes_aero.errors import InputError
from bayes_aero.flight.card import Card
from bayes_aero.flight.record import FlightRecord
from bayes_aero.inference.covariance import standard_error_of_sum
from bayes_aero.inference.gp import MAX_SAMPLES, Budget, GPFit, fit_gp, too_many
from bayes_aero.inference.gp_kernel import Priors
from bayes_aero.inference.mle import fit_mle
from bayes_aero.inference.results import (
    COLOURED_INNOVATIONS,
    SENSITIVITY_LIMIT,
    Calibration,
    GPReport,
    Histogram,
    Identification,
    Interval,
    MleResult,
    MleStatus,
    OneStep,
    PitResult,
    Posterior,
    PosteriorStatus,
    Predicted,
    Share,
    Stall,
    Validation,
    score,
)
from bayes_aero.model.model import Model
from bayes_aero.model.noise import Colour, Density, LogDensity, Noise
from bayes_aero.model.observations import Observations, observe
from bayes_aero.model.records import Forming
from bayes_aero.physics.aircraft import Aircraft
from bayes_aero.processes import cores, exit_with, give_back_memory
from bayes_aero.progress import Progress

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
    progress: Progress | None = None,
) -> GPReport:
    """Train on each split's training points and score on its test points, both models on the same ones."""
    # A split that the records do not allow (`manoeuvre` with one record) is left out.
    began, names, left_out = time.perf_counter(), observations.coefficients, ()
    splits = {}
    for kind in KINDS:
        short = too_short(observations.manoeuvre, observations.dt) if kind == "block" else None
        if short is not None:
            left_out = (
                f"The Gaussian process was not tested on hold-out blocks: {observations.names[short]} is shorter than "
                f"two blocks of {BLOCK_SECONDS:g} s.",
            )
        elif kind != "manoeuvre" or len(observations.names) > 1:
            splits[kind] = make_splits(kind, observations.manoeuvre, observations.dt, training.seed)
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
    found: dict[str, list[dict[str, Validation]]] = {kind: [{} for _ in folds] for kind, folds in splits.items()}
    for kind, folds in splits.items():
        for number, fold in enumerate(folds):
            test = fold.test_idx
            fit = fit_mle(model, observations.subset(fold.train_idx), start=mle.estimate, extra_starts=0)
            y = model.predicted(jnp.asarray(fit.estimate), observations.signals, observations.aircraft)
            for name, measured, by_mle in zip(names, z[test].T, np.asarray(y)[test].T, strict=True):
                both = {"measured": measured, "mle": by_mle, "mle_scores": score(measured, by_mle)}
                found[kind][number][name] = Validation(test=test, **both, **trained[kind, number, name][1])
    fits = {name: trained[chosen, 0, name][0] for name in names if training.sample}
    return GPReport(found, fits, chosen, time.perf_counter() - began, left_out)


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
    priors = Priors.quasi_steady()
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


def _trained(work: dict[tuple[str, int, str], Any], n: int, progress: Progress | None) -> dict[tuple, Any]:
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
                if progress:
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


def too_short(manoeuvre_index: Index, dt: float, block_seconds: float = BLOCK_SECONDS) -> int | None:
    """The first manoeuvre that has no two blocks; None where all have."""
    names, samples = np.unique(np.asarray(manoeuvre_index), return_counts=True)
    short = names[samples // max(round(block_seconds / dt), 1) < 2]
    return int(short[0]) if len(short) else None


# --- How far the published way of forming coefficients moves their parameters.
# As published, pitch acceleration and the other measured signals are smoothed, and the controls that the model answers
# to are not: what moves fast is then smaller in the measured coefficient than in the modelled one. With every signal
# filtered alike both sides are treated alike.

BEYOND = 2.0  # corrected deviations, from which a move is worth a word


def filter_mismatch_notes(records: Sequence[FlightRecord], card: Card, model: Model, mle: MleResult) -> tuple[str, ...]:
    """A sentence where estimates from published coefficients move once all signals are filtered alike."""
    sound = (MleStatus.CONVERGED, MleStatus.AT_BOUND)
    if mle.status not in sound:
        return ()
    alike = fit_mle(model, observe(records, card, model, Forming.MATCHED), start=mle.estimate, extra_starts=0)
    away = np.abs(alike.estimate - mle.estimate) / np.where(mle.crb_corrected > 0.0, mle.crb_corrected, np.inf)
    far = [i for i in np.argsort(-away) if away[i] > BEYOND]
    if alike.status not in sound or not far:
        return ()
    moves = "; ".join(
        f"{mle.names[i]} would be {alike.estimate[i]:.4g} {mle.units[i] if mle.units[i] != '1' else ''}".rstrip()
        + f" instead of {mle.estimate[i]:.4g} ({away[i]:.1f} corrected standard errors)"
        for i in far
    )
    return (
        "Coefficients are formed as published: measured accelerations are smoothed, control inputs of the model are "
        f"not, and alpha-dot is the derivative of the vane angle. With the same filter on all signals, {moves}. No "
        "interval here includes this difference; without --coefficients published both sides are filtered alike.",
    )


# --- Whether a posterior predicts what was measured (PIT).
# Under a correct model the values are uniform. Each sample is predicted one step ahead, given those before it in its
# manoeuvre; under white noise they carry no information, and the values are those of the predictive distribution.
# Sources: Dawid 1984, J. R. Stat. Soc. A 147, 278; Diebold, Gunther and Tay 1998, Int. Econ. Rev. 39, 863.

PIT_DRAWS = 200  # of the posterior: the probability of a sample hardly varies between them; our choice
MAX_BINS, MIN_PER_BIN = 20, 20
BAND = 0.95  # that all bars of uniform values lie inside


def pit_of(run: Identification) -> PitResult | None:
    """The transform of a run's samples by its first posterior under the chosen noise; None without a posterior."""
    engine = next((key for key in run.posteriors if key != "white"), None)
    if engine is None:
        return None
    posterior = run.posteriors[engine]
    density = Density.of(run.observations, run.model, Noise(Colour(posterior.noise)), run.mle.bias)
    values = pit(density, posterior.draws()[:, [posterior.names.index(name) for name in density.names]])
    columns, start = [values[:, c] for c in range(values.shape[1])], np.asarray(density.observations.start)
    bars, correlation = tuple(map(histogram, columns)), tuple(neighbours(column, start) for column in columns)
    return PitResult(engine, values, bars, correlation)


def pit(density: Density, x: Float[np.ndarray, "m k"]) -> Float[np.ndarray, "n c"]:
    """Posterior probability of less than what was measured, from draws `x` as rows; by sample and coefficient."""
    kept = x[np.linspace(0, len(x) - 1, min(len(x), PIT_DRAWS)).astype(int)]
    return np.asarray(_mean_probability(density, jnp.asarray(kept)))


@eqx.filter_jit
def _mean_probability(density: Density, x: Float[Array, "m k"]) -> Float[Array, "n c"]:
    # Noise is normal given the parameters, so each draw's probability is exact and their mean has no steps of 1/m.
    add = lambda total, row: (total + ndtr(density.standardised(row)), None)  # noqa: E731
    return jax.lax.scan(add, jnp.zeros_like(density.observations.measured), x)[0] / len(x)


def histogram(values: Float[np.ndarray, " n"]) -> Histogram:
    """Bars of `values`, with a band by Bonferroni: exact for one bar, a little wide for all together."""
    n = len(values)
    bins = int(np.clip(n // MIN_PER_BIN, 2, MAX_BINS))
    count, edges = np.histogram(values, bins=bins, range=(0.0, 1.0))
    tail = 0.5 * (1.0 - BAND) / bins
    lower, upper = binom.ppf([tail, 1.0 - tail], n, 1.0 / bins)
    return Histogram(edges, count * bins / n, float(lower * bins / n), float(upper * bins / n))


def neighbours(values: Float[np.ndarray, " n"], start: Bool[np.ndarray, " n"]) -> float:
    """Correlation of neighbouring values within manoeuvres, on the normal scale; 0 if they are independent."""
    z = norm.ppf(np.clip(values, 1e-12, 1.0 - 1e-12))
    inside = ~np.asarray(start, bool)[1:]
    return float(np.corrcoef(z[1:][inside], z[:-1][inside])[0, 1])


# --- Sensitivity of a posterior to its priors: power-scaling of prior and likelihood.
# Source: Kallioinen, Paananen, Burkner and Vehtari 2024, Stat. Comput. 34, 57; `psense` of ArviZ, by Pareto-smoothed
# importance weights, without sampling again.

PRIOR_SENSITIVITY_DRAWS = 4000


class Dependence(Enum):
    """Whether the data or the prior decide a parameter; the value is the text for the user."""

    DATA = "the data decide"
    BOTH = "prior and data conflict, or the prior is informative compared with the data"
    PRIOR = "the prior decides; the record contains little information on this parameter"
    NEITHER = "neither changes it: check its chains"


def prior_sensitivity(density: LogDensity, posterior: Posterior) -> pd.DataFrame:
    """A row per parameter: sensitivity to the prior, to the likelihood, and the conclusion (`Dependence`)."""
    # All priors are scaled together. `posterior` is one of `density`. The Monte Carlo error of the sensitivities is
    # about 0.01 for some thousand draws.
    tree = posterior.tree["posterior"].to_dataset()
    step = max(1, tree.sizes["chain"] * tree.sizes["draw"] // PRIOR_SENSITIVITY_DRAWS)
    x = np.stack([np.asarray(tree[name])[:, ::step] for name in density.names], axis=-1)
    prior, likelihood = (np.asarray(values) for values in _prior_and_likelihood(density, jnp.asarray(x)))
    groups = {
        "posterior": {name: x[..., i] for i, name in enumerate(density.names)},
        "log_prior": {"all": prior},
        "log_likelihood": {"all": likelihood},
    }
    both = azb.from_dict(groups)
    sensitivity = {part: azs.psense(both, group=part) for part in ("prior", "likelihood")}
    rows = {name: {part: float(sensitivity[part][name]) for part in sensitivity} for name in density.names}
    table = pd.DataFrame.from_dict(rows, orient="index")
    by = {(False, True): Dependence.DATA, (True, True): Dependence.BOTH, (True, False): Dependence.PRIOR}
    decided = (tuple(row >= SENSITIVITY_LIMIT) for row in table.to_numpy())
    table["says"] = [by.get(row, Dependence.NEITHER).value for row in decided]
    return table


@eqx.filter_jit
def _prior_and_likelihood(density: LogDensity, x: Float[Array, "chain draw k"]) -> tuple[Array, Array]:
    terms = lambda row: (density.log_prior(row), density.log_likelihood(row))  # noqa: E731
    return jax.lax.map(lambda chain: jax.lax.map(terms, chain), x)


# --- Whether a filter's one-step predictions are calibrated: shares of innovations inside predictive intervals.
# Each innovation is predicted from the samples before it and from the outputs before it in its own sample. Where model
# and noise are right, innovations over their predicted standard deviations are independent and standard normal, and
# their probability integral transforms are uniform. Where process noise and measurement noise were fitted to the same
# record, the mean square of the scaled innovations is near 1, and the shares test the shape of the distribution.
# Sources: Dawid 1984, J. R. Stat. Soc. A 147, 278; Diebold, Gunther and Tay 1998, Int. Econ. Rev. 39, 863.

LEVELS = (0.5, 0.9, 0.95, 0.99)  # of central predictive intervals
SIGNIFICANCE = 0.05  # rate of false alarms for calibrated predictions, all outputs and levels together
MIN_INDEPENDENT = 30  # independent innovations below which calibration is undecided; our choice
NORMAL_SCORES = np.arange(-3.0, 3.01, 0.25)  # at which quantiles are compared
MIN_BEYOND = 2.0  # least number of innovations beyond a quantile
TINY = 1e-12


def probability_transform(found: Filtered) -> Float[np.ndarray, "w n c"]:
    """Probability integral transform Phi(e / sqrt(S)) of every innovation, NaN where nothing was measured."""
    return norm.cdf(_standardised(found))


def one_step(found: Filtered, errors: Float[np.ndarray, "w n c"], outputs: Sequence[str]) -> OneStep:
    """One-step predictions of w filtered segments, from errors (w, n, c), of outputs with two innovations or more."""
    z, correlation = _standardised(found), neighbour_correlation(found)
    columns = [c for c in range(len(outputs)) if np.isfinite(z[..., c]).sum() > 1]
    tests = len(LEVELS) * (len(columns) + (len(columns) > 1))
    by_output = {}
    for c in columns:
        rms = float(np.sqrt(np.nanmean(np.square(np.asarray(errors)[..., c]))))
        coloured = bool(abs(correlation[c]) > COLOURED_INNOVATIONS)
        by_output[outputs[c]] = _assess(z[..., [c]], rms, coloured, tests)
    return OneStep(by_output, _assess(z[..., columns], None, False, tests))


def _standardised(found: Filtered) -> Float[np.ndarray, "w n c"]:
    z = np.asarray(found.innovation) / np.sqrt(np.asarray(found.variance))
    return np.where(np.asarray(found.used), z, np.nan)


def _assess(z: Float[np.ndarray, "w n c"], rms: float | None, coloured: bool, tests: int) -> Predicted:
    used, u = np.isfinite(z), norm.cdf(z)
    n, squares = int(used.sum()), np.where(used, np.square(z), 0.0)
    mean = squares.sum() / n
    centred = np.where(used, squares - mean, 0.0)
    inflation = _inflation(centred, used) or 1.0
    ratio = float(np.sqrt(mean))
    ratio_sd = float(np.sqrt(inflation * np.sum(centred**2)) / n) / max(2.0 * ratio, TINY)
    shares, independent = [], n / inflation
    for level in LEVELS:
        inside = used & (np.abs(u - 0.5) <= 0.5 * level)
        share = float(inside.sum() / n)
        inflation = _inflation(np.where(used, inside - share, 0.0), used) or inflation
        spread = max(share * (1.0 - share), level * (1.0 - level))
        # Two-sided binomial p-value of independent innovations; by the beta distribution, for they are no whole number.
        alone = n / inflation
        missed, chance = (1.0 - share) * alone, 1.0 - level
        at_most = float(betainc(max(alone - missed, TINY), missed + 1.0, level))
        at_least = float(betainc(max(missed, TINY), alone - missed + 1.0, chance))
        p = min(1.0, 2.0 * min(at_most, at_least))
        shares.append(Share(level, share, float(np.sqrt(inflation * spread / n)), p))
        independent = min(independent, alone)
    differences = [s.share - s.level for s in shares if s.p < SIGNIFICANCE / tests]
    calibration = (
        Calibration.COLOURED if coloured and not differences
        else Calibration.UNDECIDED if independent < MIN_INDEPENDENT
        else Calibration.CALIBRATED if not differences
        else Calibration.TOO_NARROW if max(differences) < 0.0
        else Calibration.TOO_WIDE if min(differences) > 0.0 else Calibration.NOT_NORMAL
    )  # fmt: skip
    # Quantiles: order statistics of as many uniform values as there are independent innovations (Bonferroni).
    scores, rows = NORMAL_SCORES[n * norm.sf(np.abs(NORMAL_SCORES)) >= MIN_BEYOND], []
    tail, probabilities = 0.5 * SIGNIFICANCE / max(len(scores), 1), norm.cdf(scores)
    for normal_score, value, q in zip(scores, np.quantile(z[used], probabilities), probabilities, strict=True):
        below = used & (z <= value)
        alone = n / (_inflation(np.where(used, below - below.sum() / n, 0.0), used) or 1.0)
        band = beta.ppf([tail, 1.0 - tail], q * (alone + 1.0), (1.0 - q) * (alone + 1.0))
        rows.append([normal_score, value, *norm.ppf(band)])
    return Predicted(n, rms, (ratio, ratio_sd), tuple(shares), calibration, np.array(rows).reshape(-1, 4))


def _inflation(centred: Float[np.ndarray, "w n c"], used: Bool[np.ndarray, "w n c"]) -> float | None:
    """Variance inflation of the sum of `centred` (zero: not measured) by all correlation, >= 1; None if it is zero."""
    white = float(np.sum(centred**2))
    if white <= TINY:
        return None
    lengths = [int(np.max(np.flatnonzero(some), initial=-1)) + 1 for some in np.any(used, axis=2)]
    series = np.concatenate([one[:length].sum(axis=1) for one, length in zip(centred, lengths, strict=True)])
    return max(1.0, standard_error_of_sum(series, [length for length in lengths if length]) ** 2 / white)


# --- The stall in two numbers with intervals: the highest steady lift coefficient, and the angle of it.
# Quasi-steady: CL(alpha) at alpha-dot = 0 and zero rates, all other signals at their median near the stall. The maximum
# is sought over the recorded angles; where it is at their edge, the record does not contain the stall.

POINTS = 241  # angles: less than 0.1 deg apart over 20 deg, and the maximum is found between them
CURVE_DRAWS = 400
QUANTILES = (0.025, 0.5, 0.975)
RATE_SHARES = (0.05, 0.95)  # quantiles of the recorded alpha-dot at which separation is shown beside the steady one


def stall_of(model: Model, draws: Float[np.ndarray, "m k"], signals: Mapping[str, Any], aircraft: Aircraft) -> Stall:
    """The stall over draws of the free parameters (columns as `model.names`), within the angles that `signals` hold."""
    thin = draws[np.unique(np.linspace(0, len(draws) - 1, min(CURVE_DRAWS, len(draws))).astype(int))]
    flown = np.asarray(signals["alpha"])
    alpha = np.linspace(float(flown.min()), float(flown.max()), POINTS)
    low, high = np.quantile(np.asarray(signals["alpha_dot"]), RATE_SHARES)
    rates = np.array([min(low, 0.0), 0.0, max(high, 0.0)])
    reference = conditions(signals)
    held = {name: jnp.asarray(value) for name, value in reference.items()}
    flows = _flows(model, jnp.asarray(thin), jnp.asarray(alpha), jnp.asarray(rates), held, aircraft)
    X, CL, CD = (np.asarray(flows[name]) for name in ("X", "CL", "CD"))  # (m, rates, angles)
    steady, drag = CL[:, 1], CD[:, 1]
    peak, place, edge = maxima(alpha, steady)
    return Stall(
        alpha=alpha,
        CL=np.quantile(steady, QUANTILES, axis=0),
        CD=np.quantile(drag, QUANTILES, axis=0),
        rates=rates,
        X=np.moveaxis(np.quantile(X, QUANTILES, axis=0), 0, 1),
        CL_max=Interval.of(peak),
        alpha_max=Interval.of(place),
        at_edge=float(np.mean(edge)),
        reference=reference,
    )


def stall_of_run(run: Identification) -> Stall | None:
    """CLmax and its angle from the first posterior that converged; without one there is none."""
    for key, posterior in run.posteriors.items():
        if key != "white" and posterior.status is PosteriorStatus.CONVERGED:
            of_model = [posterior.names.index(n) for n in run.model.names]
            return stall_of(
                run.model, posterior.draws()[:, of_model], run.observations.signals, run.observations.aircraft
            )
    return None


def maxima(x: Float[np.ndarray, " g"], y: Float[np.ndarray, "m g"]):
    """Maximum of every row, its position (by a parabola through three even points), and whether it is at an edge."""
    i = np.argmax(y, axis=1)
    edge = (i == 0) | (i == len(x) - 1)
    j = np.clip(i, 1, len(x) - 2)
    rows = np.arange(len(y))
    before, here, after = y[rows, j - 1], y[rows, j], y[rows, j + 1]
    bend = np.where(edge, -1.0, before - 2.0 * here + after)
    shift = np.where(edge | (bend >= 0.0), 0.0, 0.5 * (before - after) / np.where(bend < 0.0, bend, -1.0))
    step = x[1] - x[0]
    peak = np.where(edge, y[rows, i], here - 0.25 * (before - after) * shift)
    return peak, np.where(edge, x[i], x[j] + shift * step), edge


@eqx.filter_jit
def _flows(model, thetas: Float[Array, "m k"], alpha: Float[Array, " g"], rates: Float[Array, " r"], held, aircraft):
    flows = jax.vmap(lambda theta, rate: steady_flow(model, theta, alpha, rate, held, aircraft), in_axes=(None, 0))
    return jax.lax.map(lambda theta: flows(theta, rates), thetas)
