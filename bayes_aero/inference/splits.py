"""Splits into training and hold-out data: at random as published, in contiguous blocks, or by manoeuvre.

A random split of 25 Hz flight data is hardly a split: nearly every hold-out sample has a neighbour 40 ms away in the
training set, with residuals whose lag-1 correlation reaches 0.98. Its scores measure interpolation between neighbours.
With `block` only samples near block edges have such neighbours, with `manoeuvre` none.
"""

from dataclasses import dataclass
from typing import Literal, get_args

import jax
import numpy as np
from jaxtyping import Int

from bayes_aero.errors import InputError

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
