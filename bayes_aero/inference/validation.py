"""Validation of Gaussian processes and of maximum likelihood on the same hold-out samples, for every kind of split."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple, get_args

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int
from joblib import Parallel, delayed, parallel_config
from joblib.externals.loky.process_executor import TerminatedWorkerError

from bayes_aero.errors import InputError
from bayes_aero.inference.compiled_programs import cores, exit_with, give_back_memory
from bayes_aero.inference.gp import GPFit, Priors, fit_gp
from bayes_aero.inference.gp.fit import MAX_SAMPLES, too_many
from bayes_aero.inference.identification import GPReport, Validation
from bayes_aero.inference.likelihood.mle import fit_mle
from bayes_aero.inference.likelihood.mle_result import MleResult
from bayes_aero.inference.scores import score
from bayes_aero.model.model import Model
from bayes_aero.model.observations import Observations
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
    """How Gaussian processes are trained.

    Hyperparameters are sampled, if `sample`, for the first fold of the split `chosen`; for the others, at their mode.
    """

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
    """Train on each split's training points and score on its test points, both models on the same ones.

    A split that the records do not allow (`manoeuvre` with one record) is left out.
    """
    began = time.perf_counter()
    kinds, chosen, left_out = _allowed(observations, training.chosen)
    splits: dict[SplitKind, list[Split]] = {
        kind: make_splits(kind, observations.manoeuvre, observations.dt, training.seed) for kind in kinds
    }
    largest = max(len(f.train_idx) for folds in splits.values() for f in folds)
    if largest > MAX_SAMPLES:
        raise InputError(too_many(largest))
    tasks = [
        _Task(kind, number, i, observations.coefficients[i], training.sample and kind == chosen and number == 0)
        for kind, folds in splits.items()
        for number in range(len(folds))
        for i in range(len(observations.coefficients))
    ]
    tasks.sort(key=lambda task: not task.sampled)  # the long ones first
    X, z = gp_inputs(observations, inputs), np.asarray(observations.measured)
    tidy = largest >= WORTH_PROCESSES  # below, compiling anew for every fit costs more than memory is worth
    work = [_Work(X, z[:, t.column], inputs, splits[t.kind][t.fold], t, training, tidy, os.getpid()) for t in tasks]
    trained = _all_trained(work, largest, progress)
    found: dict[str, list[dict[str, Validation]]] = {kind: [{} for _ in folds] for kind, folds in splits.items()}
    for kind, folds in splits.items():
        for number, fold in enumerate(folds):
            predicted = _mle_prediction(model, observations, mle, fold)
            for i, name in enumerate(observations.coefficients):
                measured, by_mle = z[fold.test_idx, i], predicted[:, i]
                _, part = trained[kind, number, i]
                found[kind][number][name] = Validation(
                    test=fold.test_idx, measured=measured, mle=by_mle, mle_scores=score(measured, by_mle), **part
                )
    names = observations.coefficients
    fits = {names[i]: fit for (_, _, i), (fit, _) in trained.items() if fit is not None}
    return GPReport(found, {n: fits[n] for n in names if n in fits}, chosen, time.perf_counter() - began, left_out)


def _allowed(observations: Observations, chosen: SplitKind) -> tuple[tuple[SplitKind, ...], SplitKind, tuple[str, ...]]:
    """The splits that the records allow, the chosen one or its replacement, and sentences on the others."""
    kinds: tuple[SplitKind, ...] = KINDS
    if len(observations.names) < 2:
        kinds = tuple(kind for kind in kinds if kind != "manoeuvre")
        chosen = "block" if chosen == "manoeuvre" else chosen
    short = too_short(observations.manoeuvre, observations.dt)
    if short is None:
        return kinds, chosen, ()
    kinds = tuple(kind for kind in kinds if kind != "block")
    said = (
        f"The Gaussian process was not tested on hold-out blocks: {observations.names[short]} is shorter than two "
        f"blocks of {BLOCK_SECONDS:g} s."
    )
    return kinds, kinds[0] if chosen == "block" else chosen, (said,)


def _all_trained(work: Sequence[_Work], largest: int, progress: Progress | None) -> dict[tuple[str, int, int], Any]:
    """Results of `_trained` by kind of split, fold and coefficient."""
    trained: dict[tuple[str, int, int], Any] = {}
    jobs = _processes(len(work), largest)
    if work[0].tidy:
        give_back_memory()
    # LAPACK holds Python's lock and gains little from a second thread at these sizes: one process a core.
    with parallel_config(backend="loky", inner_max_num_threads=1):
        results: Any = Parallel(n_jobs=jobs, return_as="generator")(delayed(_trained)(one) for one in work)
        try:
            for one, result in zip(work, results, strict=True):
                task = one.task
                trained[task.kind, task.fold, task.column] = result
                if progress:
                    progress(f"gp: {task.coefficient}, {task.kind} split", len(trained) / len(work))
        except TerminatedWorkerError:
            raise InputError(
                f"a process that trained on up to {len(work[0].z)} samples was killed, probably for lack of memory; "
                "thin the records or free memory"
            ) from None
    return trained


def _processes(tasks: int, n: int) -> int:
    """Number of processes by cores and memory: each takes eight n x n matrices and 1 GiB for the compiler."""
    if n < WORTH_PROCESSES:
        return 1
    each = 8 * 8 * n**2 + 2**30
    free = os.sysconf("SC_AVPHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") if sys.platform == "linux" else 2 * each
    return max(1, min(tasks, cores(), free // each))


class _Task(NamedTuple):
    """One fit: fold `fold` of split `kind`, `coefficient` in `column`."""

    kind: SplitKind
    fold: int
    column: int
    coefficient: str
    sampled: bool


class _Work(NamedTuple):
    """A task with its data, for another process; `z` is its coefficient, `parent` the id of the calling process."""

    X: Float[np.ndarray, "n d"]
    z: Float[np.ndarray, " n"]
    inputs: tuple[str, ...]
    fold: Split
    task: _Task
    training: Training
    tidy: bool
    parent: int


def _mle_prediction(model: Model, observations: Observations, mle: MleResult, fold: Split) -> Float[np.ndarray, "m c"]:
    """Maximum likelihood on the training points, evaluated at the test points."""
    trained = fit_mle(model, observations.subset(fold.train_idx), start=mle.estimate, extra_starts=0)
    y = model.predicted(jnp.asarray(trained.estimate), observations.signals, observations.aircraft)
    return np.asarray(y)[fold.test_idx]


def _trained(work: _Work) -> tuple[GPFit | None, dict[str, Any]]:
    """The fit, if it was sampled, and the process's part of a `Validation`."""
    exit_with(work.parent)
    X, z, fold, sampled = work.X, work.z, work.fold, work.task.sampled
    fit = fit_gp(
        X[fold.train_idx],
        z[fold.train_idx],
        input_names=work.inputs,
        output_name=work.task.coefficient,
        priors=Priors.quasi_steady(),
        sample=sampled,
        seed=work.training.seed,
        progress=lambda _: None,
    )
    if work.tidy:
        give_back_memory()
    measured = z[fold.test_idx]
    prediction = fit.predict(X[fold.test_idx])
    level = prediction.levels.index(LEVEL)
    part = {
        "gp": prediction.mean,
        "gp_low": prediction.low[level],
        "gp_high": prediction.high[level],
        "gp_scores": score(measured, prediction.mean),
        "coverage": prediction.coverage(measured),
        "k_hat": float(fit.k_hat) if np.isfinite(fit.k_hat) else None,
        "status": fit.status.value if sampled else fit.map_status.value,
    }
    return fit if sampled else None, part


# --- Splits into training and hold-out data: at random as published, in contiguous blocks, or by manoeuvre.
# A random split of 25 Hz flight data is hardly a split: nearly every hold-out sample has a neighbour 40 ms away in
# the training set, with residuals whose lag-1 correlation reaches 0.98. Its scores measure interpolation between
# neighbours. With `block` only samples near block edges have such neighbours, with `manoeuvre` none.

__all__ = ["Split", "SplitKind", "make_splits"]

SplitKind = Literal["random", "block", "manoeuvre"]
Index = Int[np.ndarray, " n"] | Int[jax.Array, " n"]

TRAIN_SHARE = 0.7  # the seed paper's 70/30
MAX_FOLDS = 10  # of manoeuvres; more manoeuvres are held out in groups
BLOCK_SECONDS = 4.0  # our choice: about 100 samples, longer than the memory of the residuals (1-2 s)


@dataclass(frozen=True, eq=False)
class Split:
    """One division of the samples: sorted indices `train_idx` and `test_idx`, disjoint and complete."""

    name: str
    train_idx: Int[np.ndarray, " n_train"]
    test_idx: Int[np.ndarray, " n_test"]


def make_splits(
    kind: SplitKind,
    manoeuvre_index: Index,
    dt: float,
    seed: int,
    *,
    block_seconds: float = BLOCK_SECONDS,
) -> list[Split]:
    """Splits of the samples whose manoeuvre is `manoeuvre_index` (n,), sampled every `dt` seconds.

    `random` and `block` give one 70/30 split (ask again with another seed for more); `manoeuvre` gives one
    fold for each manoeuvre (beyond ten for each of ten groups), held back while all the others train: for two, both
    directions.
    """
    index = np.asarray(manoeuvre_index)
    if index.ndim != 1 or index.size < 10:
        raise InputError(f"A split needs a vector of at least 10 samples, got shape {index.shape}.")
    if not (np.isfinite(dt) and dt > 0):
        raise InputError(f"The sampling interval dt = {dt} s must be positive.")
    if kind == "random":
        return [_random(index.size, seed)]
    if kind == "block":
        return [_block(index, round(block_seconds / dt), seed)]
    if kind == "manoeuvre":
        return _manoeuvre(index)
    raise InputError(f"Unknown split {kind!r}; choose one of {', '.join(get_args(SplitKind))}.")


def too_short(manoeuvre_index: Index, dt: float, block_seconds: float = BLOCK_SECONDS) -> int | None:
    """The first manoeuvre that has no two blocks; None where all have."""
    names, samples = np.unique(np.asarray(manoeuvre_index), return_counts=True)
    short = names[samples // max(round(block_seconds / dt), 1) < 2]
    return int(short[0]) if len(short) else None


def _split(name: str, train: np.ndarray) -> Split:
    """Split from a mask over the samples, True where a sample trains."""
    return Split(name, np.flatnonzero(train), np.flatnonzero(~train))


def _random(n: int, seed: int) -> Split:
    train = np.zeros(n, bool)
    train[np.random.default_rng(seed).permutation(n)[: round(TRAIN_SHARE * n)]] = True
    return _split("random", train)


def _block(index: np.ndarray, length: int, seed: int) -> Split:
    """Deal each manoeuvre's blocks of `length` samples: the same share of every manoeuvre trains."""
    rng = np.random.default_rng(seed)
    train = np.zeros(index.size, bool)
    for manoeuvre in np.unique(index):
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
    return _split("block", train)


def _manoeuvre(index: np.ndarray) -> list[Split]:
    names = np.unique(index)
    if names.size < 2:
        raise InputError(
            "A manoeuvre split needs at least two records, one to train on and one to predict; "
            "add a record or use the block split."
        )
    if names.size <= MAX_FOLDS:
        return [_split(f"manoeuvre {held}", index != held) for held in names]
    groups = np.array_split(names, MAX_FOLDS)
    return [_split(f"manoeuvres {held[0]} to {held[-1]}", ~np.isin(index, held)) for held in groups]
