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
from bayes_aero.flight.card import Card
from bayes_aero.flight.record import FlightRecord
from bayes_aero.inference.gp import MAX_SAMPLES, GPFit, fit_gp, too_many
from bayes_aero.inference.gp.kernel import Priors
from bayes_aero.inference.mle import fit_mle
from bayes_aero.inference.results import GPReport, MleResult, MleStatus, Validation
from bayes_aero.inference.scores import score
from bayes_aero.model.model import Model
from bayes_aero.model.observations import Forming, Observations, observe
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
    """How Gaussian processes are trained."""

    # Hyperparameters are sampled, if `sample`, for the first fold of the split `chosen`; for the others, at their mode.
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
    began, names = time.perf_counter(), observations.coefficients
    chosen, left_out = training.chosen, ()
    kinds: tuple[SplitKind, ...] = KINDS
    if len(observations.names) < 2:
        kinds = tuple(kind for kind in kinds if kind != "manoeuvre")
        chosen = "block" if chosen == "manoeuvre" else chosen
    short = too_short(observations.manoeuvre, observations.dt)
    if short is not None:
        kinds = tuple(kind for kind in kinds if kind != "block")
        chosen = kinds[0] if chosen == "block" else chosen
        left_out = (
            f"The Gaussian process was not tested on hold-out blocks: {observations.names[short]} is shorter than two "
            f"blocks of {BLOCK_SECONDS:g} s.",
        )
    splits = {kind: make_splits(kind, observations.manoeuvre, observations.dt, training.seed) for kind in kinds}
    largest = max(len(f.train_idx) for folds in splits.values() for f in folds)
    if largest > MAX_SAMPLES:
        raise InputError(too_many(largest))
    X, z = gp_inputs(observations, inputs), np.asarray(observations.measured)
    tidy = largest >= WORTH_PROCESSES  # below, compiling anew for every fit costs more than memory is worth
    work = []
    for kind, folds in splits.items():
        for number, fold in enumerate(folds):
            sampled = training.sample and kind == chosen and number == 0
            own: tuple[Any, ...] = (X, inputs, fold, kind, number, sampled, training.seed, tidy, os.getpid())
            work += [_Work(name, z[:, i], *own) for i, name in enumerate(names)]
    work.sort(key=lambda task: not task.sampled)  # the long ones first
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
    fits = {name: fit for (_, _, name), (fit, _) in trained.items() if fit is not None}
    seconds = time.perf_counter() - began
    return GPReport(found, {n: fits[n] for n in names if n in fits}, chosen, seconds, left_out)


class _Work(NamedTuple):
    """One fit, for another process; `parent` is the id of the calling process."""

    coefficient: str
    z: Float[np.ndarray, " n"]
    X: Float[np.ndarray, "n d"]
    inputs: tuple[str, ...]
    fold: HoldoutSplit
    kind: SplitKind
    number: int  # of the fold
    sampled: bool
    seed: int
    tidy: bool
    parent: int

    def train(self) -> tuple[GPFit | None, dict[str, Any]]:
        """The fit, if it was sampled, and the process's part of a `Validation`."""
        exit_with(self.parent)
        train, test = self.fold.train_idx, self.fold.test_idx
        fit = fit_gp(
            self.X[train],
            self.z[train],
            input_names=self.inputs,
            output_name=self.coefficient,
            priors=Priors.quasi_steady(),
            sample=self.sampled,
            seed=self.seed,
            progress=lambda _: None,
        )
        if self.tidy:
            give_back_memory()
        measured, prediction = self.z[test], fit.predict(self.X[test])
        level = prediction.levels.index(LEVEL)
        part = {
            "gp": prediction.mean,
            "gp_low": prediction.low[level],
            "gp_high": prediction.high[level],
            "gp_scores": score(measured, prediction.mean),
            "coverage": prediction.coverage(measured),
            "k_hat": float(fit.k_hat) if np.isfinite(fit.k_hat) else None,
            "status": fit.status.value if self.sampled else fit.map_status.value,
        }
        return fit if self.sampled else None, part


def _trained(work: Sequence[_Work], n: int, progress: Progress | None) -> dict[tuple[str, int, str], Any]:
    """Results by kind of split, fold and coefficient, of fits to `n` samples at most."""
    jobs, trained = 1, {}
    if n >= WORTH_PROCESSES:  # by cores and memory: each takes eight n x n matrices and 1 GiB for the compiler
        each = 8 * 8 * n**2 + 2**30
        free = os.sysconf("SC_AVPHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") if sys.platform == "linux" else 2 * each
        jobs = max(1, min(len(work), cores(), free // each))
        give_back_memory()
    # LAPACK holds Python's lock and gains little from a second thread at these sizes: one process a core.
    with parallel_config(backend="loky", inner_max_num_threads=1):
        results: Any = Parallel(n_jobs=jobs, return_as="generator")(delayed(_Work.train)(one) for one in work)
        try:
            for one, result in zip(work, results, strict=True):
                trained[one.kind, one.number, one.coefficient] = result
                if progress:
                    progress(f"gp: {one.coefficient}, {one.kind} split", len(trained) / len(work))
        except TerminatedWorkerError:
            raise InputError(
                f"a process that trained on up to {len(work[0].z)} samples was killed, probably for lack of memory; "
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


@dataclass(frozen=True, eq=False)
class HoldoutSplit:
    """One division of the samples: sorted indices `train_idx` and `test_idx`, disjoint and complete."""

    name: str
    train_idx: Int[np.ndarray, " n_train"]
    test_idx: Int[np.ndarray, " n_test"]

    @classmethod
    def of(cls, name: str, train: np.ndarray) -> HoldoutSplit:
        """From a mask over the samples, True where a sample trains."""
        return cls(name, np.flatnonzero(train), np.flatnonzero(~train))


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
        if names.size <= MAX_FOLDS:
            return [HoldoutSplit.of(f"manoeuvre {held}", index != held) for held in names]
        groups = np.array_split(names, MAX_FOLDS)
        return [HoldoutSplit.of(f"manoeuvres {held[0]} to {held[-1]}", ~np.isin(index, held)) for held in groups]
    if kind not in ("random", "block"):
        raise InputError(f"Unknown split {kind!r}; choose one of {', '.join(get_args(SplitKind))}.")
    rng, train, length = np.random.default_rng(seed), np.zeros(index.size, bool), round(block_seconds / dt)
    if kind == "random":
        train[rng.permutation(index.size)[: round(TRAIN_SHARE * index.size)]] = True
        return [HoldoutSplit.of(kind, train)]
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
    return [HoldoutSplit.of(kind, train)]


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
SHOWN = 4


def filter_mismatch_notes(records: Sequence[FlightRecord], card: Card, model: Model, mle: MleResult) -> tuple[str, ...]:
    """A sentence where estimates of `mle`, the fit to coefficients formed as published, move by more than their
    intervals allow for once all signals are filtered alike; none where they do not, or where either fit has failed."""
    sound = (MleStatus.CONVERGED, MleStatus.AT_BOUND)
    if mle.status not in sound:
        return ()
    alike = fit_mle(model, observe(records, card, model, Forming.MATCHED), start=mle.estimate, extra_starts=0)
    if alike.status not in sound:
        return ()
    sd = mle.crb_corrected
    away = np.abs(alike.estimate - mle.estimate) / np.where(sd > 0.0, sd, np.inf)
    far = [i for i in np.argsort(-away) if away[i] > BEYOND]
    if not far:
        return ()
    told = "; ".join(
        f"{mle.names[i]} would be {alike.estimate[i]:.4g} {mle.units[i] if mle.units[i] != '1' else ''}".rstrip()
        + f" instead of {mle.estimate[i]:.4g} ({away[i]:.1f} corrected standard errors)"
        for i in far[:SHOWN]
    )
    more = f", and {len(far) - SHOWN} more move" if len(far) > SHOWN else ""
    return (
        "Coefficients are formed as published: measured accelerations are smoothed, control inputs of the model are "
        f"not, and alpha-dot is the derivative of the vane angle. With the same filter on all signals, "
        f"{told}{more}. No "
        "interval here includes this difference; without --coefficients published both sides are filtered alike.",
    )
