"""Formulas that take NumPy's arrays and JAX's alike, in modules that do not import JAX: it takes seconds to load.

What a quick command needs (`check`, `card`) runs in NumPy; a fit traces the same lines with JAX. Data outside of
compiled programs are NumPy's: JAX compiles an operation of its own for each shape, which takes 20 ms. `namespace` is
the array API's `array_namespace`, which JAX's tracers do not have. Source: https://data-apis.org/array-api
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import Any

import numpy as np
from jaxtyping import Float

PLAIN = (np.ndarray, np.float64, float, int)
AnyArray = Any  # of either library; jaxtyping still checks its kind and shape
Samples = Float[AnyArray, "*#n"]  # some at one sample, or for many directions at once


def namespace(*arrays: Any) -> Any:
    """`jax.numpy` where any of the arrays is JAX's (a tracer is), else `numpy`."""
    jax = sys.modules.get("jax")
    if jax is None or all(type(x) in PLAIN for x in arrays):  # to ask whether an array is JAX's takes longer
        return np
    return jax.numpy if any(isinstance(x, jax.Array) for x in arrays) else np


class _Either:
    """Functions of whichever library their arguments belong to."""

    pi = np.pi

    def __getattr__(self, name: str) -> Callable[..., Any]:
        def call(*given: Any, **options: Any) -> Any:
            return getattr(namespace(*given), name)(*given, **options)

        return call


xp: Any = _Either()
"""`xp.sin(x)` is `numpy.sin(x)` or `jax.numpy.sin(x)`: for functions that take arrays, not lists of them."""
