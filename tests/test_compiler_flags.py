"""Which emitters the compiler is asked for, and that a user's own choice stays."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

OWN = "--xla_cpu_use_fusion_emitters=true"


@pytest.mark.parametrize(
    ("flags", "found"),
    [
        ("", "--xla_cpu_use_fusion_emitters=false"),
        (
            "--xla_cpu_multi_thread_eigen=false",
            "--xla_cpu_multi_thread_eigen=false --xla_cpu_use_fusion_emitters=false",
        ),
        (OWN, OWN),
    ],
)
def test_the_former_emitters_are_asked_for_unless_flags_say_otherwise(flags, found):
    """And the compiler knows the flag: an unknown one would end the process at the first program."""
    code = "import os, bayes_aero, jax; print(os.environ['XLA_FLAGS']); print(float(jax.numpy.ones(2).sum()))"
    environment = os.environ | {"XLA_FLAGS": flags}
    told = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True)
    assert told.stdout.splitlines() == [found, "2.0"]
