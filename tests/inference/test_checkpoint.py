"""A run of emcee that is killed anywhere goes on to the very chain of an undisturbed one."""

from __future__ import annotations

import numpy as np
import pytest

from bayes_aero.errors import InputError
from bayes_aero.inference.posterior import ensemble
from bayes_aero.inference.posterior.checkpoint import STEPS, Checkpoint
from bayes_aero.inference.posterior.ensemble import sample_ensemble
from bayes_aero.inference.posterior.laplace import find_mode
from bayes_aero.model.log_density import LogDensity
from bayes_aero.parameter import Parameter, Prior


class Banana(LogDensity):
    """Two parameters, skewed enough for some hundred steps."""

    @property
    def parameters(self):
        return tuple(Parameter(name, "1", 0.0, 0.1, "-", Prior("normal", 0.0, 2.0)) for name in ("a", "b"))

    @property
    def noise_label(self):
        return "white"

    def log_likelihood(self, x):
        return -0.5 * ((x[0] - 0.5) ** 2 + (4.0 * (x[1] - x[0] ** 2)) ** 2)


class Killed(BaseException):
    """As sudden as a signal."""


@pytest.fixture(scope="module")
def target():
    density = Banana()
    return density, find_mode(density, np.array([0.1, 0.1]))


def sample(target, store=None, seed=3, progress=None):
    return sample_ensemble(*target, seed=seed, predictive=False, checkpoint=store, progress=progress)


def same(one, other):
    assert np.array_equal(one.draws(), other.draws())
    stats = [posterior.tree["sample_stats"].to_dataset() for posterior in (one, other)]
    assert np.array_equal(stats[0]["lp"], stats[1]["lp"])
    assert one.tree.attrs == other.tree.attrs


@pytest.fixture(scope="module")
def undisturbed(target):
    found = sample(target)
    assert found.tree.attrs["steps"] >= 300
    return found


def killed_while_sampling(target, store, steps):
    def progress(text, _):
        if text == f"emcee: {steps} steps":
            raise Killed

    with pytest.raises(Killed):
        sample(target, store, progress=progress)


def killed_while_burning_in(target, store, monkeypatch):
    calls, advance = [], ensemble._advance

    def dying(*arguments):
        calls.append(1)
        if len(calls) == 2:
            raise Killed
        advance(*arguments)

    with monkeypatch.context() as patched:
        patched.setattr(ensemble, "_advance", dying)
        with pytest.raises(Killed):
            sample(target, store)


def test_a_killed_run_ends_in_the_same_chain(target, undisturbed, tmp_path, monkeypatch):
    store = Checkpoint(tmp_path / "chain", {"record": "abc"})
    killed_while_burning_in(target, store, monkeypatch)
    killed_while_sampling(target, store, 100)
    killed_while_sampling(target, store, 300)
    advanced, advance = [], ensemble._advance
    with monkeypatch.context() as patched:
        patched.setattr(ensemble, "_advance", lambda s, n, b=None: (advanced.append(n), advance(s, n, b)))
        same(sample(target, store), undisturbed)
    assert sum(advanced) == undisturbed.tree.attrs["steps"] - 300  # nothing was done twice
    same(sample(target, store), undisturbed)  # once more, all of it from the disk
    store.remove()
    assert not (tmp_path / "chain").exists()


def test_a_damaged_stretch_costs_only_what_follows_it(target, undisturbed, tmp_path):
    store = Checkpoint(tmp_path, {})
    killed_while_sampling(target, store, 300)
    whole = (tmp_path / STEPS.format(100)).read_bytes()
    (tmp_path / STEPS.format(100)).write_bytes(whole[: len(whole) // 2])
    same(sample(target, store), undisturbed)


@pytest.mark.parametrize("made_from", [{"record": "other"}, {"record": "abc", "version": "2"}])
def test_the_chain_of_another_run_is_not_taken(target, undisturbed, tmp_path, made_from):
    killed_while_sampling(target, Checkpoint(tmp_path, {"record": "abc"}), 200)
    same(sample(target, Checkpoint(tmp_path, made_from)), undisturbed)


def test_another_seed_begins_anew(target, undisturbed, tmp_path):
    killed_while_sampling(target, Checkpoint(tmp_path, {}), 200)
    other = sample(target, Checkpoint(tmp_path, {}), seed=4)
    same(other, sample(target, seed=4))
    assert not np.array_equal(other.draws()[:50], undisturbed.draws()[:50])


def test_a_pickle_in_its_place_is_not_loaded(target, undisturbed, tmp_path):
    store = Checkpoint(tmp_path, {})
    killed_while_sampling(target, store, 200)

    class Bomb:
        def __reduce__(self):
            return (tmp_path.joinpath("exploded").touch, ())

    np.savez(tmp_path / STEPS.format(0), chain=np.array([Bomb()], object))
    same(sample(target, store), undisturbed)
    assert not (tmp_path / "exploded").exists()


def test_a_folder_that_cannot_be_written_is_said(target, tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="cannot write"):
        sample(target, Checkpoint(tmp_path / "file" / "chain", {}))
