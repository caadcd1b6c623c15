"""Every split is a partition, and holds back what its name says."""

import numpy as np
import pytest

from bayes_aero.errors import InputError
from bayes_aero.inference.splits import BLOCK_SECONDS, make_splits

DT = 0.04


@pytest.fixture(params=range(4))
def index(request):
    rng = np.random.default_rng(request.param)
    return np.repeat(np.arange(rng.integers(2, 4)), rng.integers(1500, 3100))


@pytest.mark.parametrize("kind", ["random", "block", "manoeuvre"])
def test_each_split_is_a_partition_in_time_order(kind, index):
    for split in make_splits(kind, index, DT, seed=3):
        both = np.concatenate([split.train_idx, split.test_idx])
        assert np.array_equal(np.sort(both), np.arange(index.size))
        assert np.all(np.diff(split.train_idx) > 0)
        assert np.all(np.diff(split.test_idx) > 0)


def test_random_split_has_the_papers_size():
    (split,) = make_splits("random", np.zeros(5052, int), DT, seed=0)
    assert split.train_idx.size == 3536


@pytest.mark.parametrize("kind", ["random", "block"])
def test_the_seed_decides(kind, index):
    first, again, other = (make_splits(kind, index, DT, seed=s)[0].train_idx for s in (1, 1, 2))
    assert np.array_equal(first, again)
    assert not np.array_equal(first, other)


def test_blocks_are_contiguous_and_every_manoeuvre_contributes(index):
    (split,) = make_splits("block", index, DT, seed=5)
    length = round(BLOCK_SECONDS / DT)
    test = np.isin(np.arange(index.size), split.test_idx)
    for m in np.unique(index):
        part = test[index == m]
        assert 0.25 < part.mean() < 0.35
        edges = np.flatnonzero(np.diff(part))
        assert np.all(np.diff(edges) >= length)  # no run shorter than a block


def test_manoeuvre_split_holds_each_record_back_once(index):
    splits = make_splits("manoeuvre", index, DT, seed=0)
    held = [np.unique(index[s.test_idx]).tolist() for s in splits]
    assert held == [[m] for m in np.unique(index)]
    for s in splits:
        assert not np.intersect1d(index[s.train_idx], index[s.test_idx]).size


@pytest.mark.parametrize(
    ("kind", "index", "says"),
    [
        ("manoeuvre", np.zeros(100, int), "at least two records"),
        ("block", np.zeros(150, int), "too few for two blocks"),
        ("random", np.zeros(3, int), "at least 10 samples"),
    ],
)
def test_what_cannot_be_split_is_refused_in_words(kind, index, says):
    with pytest.raises(InputError, match=says):
        make_splits(kind, index, DT, 0)


def test_an_unknown_split_is_refused():
    with pytest.raises(Exception, match="alternate"):  # InputError, or the type hook before it
        make_splits("alternate", np.zeros(100, int), DT, 0)


def test_many_manoeuvres_are_held_back_in_ten_groups():
    index = np.repeat(np.arange(25), 4)
    folds = make_splits("manoeuvre", index, 0.04, 0)
    assert len(folds) == 10
    assert np.array_equal(np.sort(np.concatenate([f.test_idx for f in folds])), np.arange(100))
    for fold in folds:
        assert not set(index[fold.test_idx]) & set(index[fold.train_idx])
