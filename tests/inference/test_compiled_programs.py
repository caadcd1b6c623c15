"""Compiled programs take memory mappings, of which Linux allows a process so many."""

from __future__ import annotations

import sys

import jax
import jax.numpy as jnp
import pytest

from bayes_aero.inference import compiled_programs
from bayes_aero.inference.compiled_programs import MAPPINGS, full_of_programs, give_back_memory

pytestmark = [
    pytest.mark.forgets,
    pytest.mark.skipif(sys.platform != "linux", reason="another system has no such limit"),
]


def mappings():
    return len(MAPPINGS.read_text().splitlines())


def test_programs_take_mappings_and_give_them_back():
    give_back_memory()
    before = mappings()
    for k in range(40):
        jax.jit(lambda x, k=k: jax.lax.scan(lambda c, y: (c + k * jnp.sin(y), c), 0.0, x)[0])(jnp.ones(3 + k))
    taken = mappings() - before
    assert taken >= 40
    give_back_memory()
    assert mappings() - before < 0.5 * taken


def test_a_process_is_full_near_the_limit_of_the_system(tmp_path, monkeypatch):
    limit = tmp_path / "max_map_count"
    monkeypatch.setattr(compiled_programs, "LIMIT", limit)
    assert not full_of_programs()  # no such limit
    for allowed, full in ((2 * mappings(), False), (mappings(), True)):
        limit.write_text(f"{allowed}\n")
        assert full_of_programs() is full
