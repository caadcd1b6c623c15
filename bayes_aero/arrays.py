"""Formulas that take NumPy's arrays and JAX's alike, in modules that do not import JAX: it takes seconds to load.

What a quick command needs (`check`, `card`) runs in NumPy; a fit traces the same lines with JAX. Data outside of
compiled programs are NumPy's: JAX compiles an operation of its own for each shape, which takes 20 ms. `namespace` is
the array API's `array_namespace`, which JAX's tracers do not have. Source: https://data-apis.org/array-api
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from functools import cache
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


def sine_and_cosine(x: Samples) -> tuple[Samples, Samples]:
    """Of an angle, rad. In programs of JAX a series has them by polynomials: the compiler computes what is cheap anew
    wherever it is used, and calls the C library for each sample."""
    lib = namespace(x)
    return (lib.sin(x), lib.cos(x)) if lib is np or x.ndim == 0 else _by_polynomials()(x)


# Minimax polynomials on an eighth of a turn, and a quarter turn in two parts. Source: FDLIBM (k_sin.c, k_cos.c), 1993.
SINE = (
    1.58969099521155010221e-10, -2.50507602534068634195e-08, 2.75573137070700676789e-06, -1.98412698298579493134e-04,
    8.33333333332248946124e-03, -1.66666666666666324348e-01, 1.0,
)  # fmt: skip
COSINE = (
    -1.13596475577881948265e-11, 2.08757232129817482790e-09, -2.75573143513906633035e-07, 2.48015872894767294178e-05,
    -1.38888888888741095749e-03, 4.16666666666666019037e-02, -0.5, 1.0,
)  # fmt: skip
QUARTER = 1.57079632673412561417, 6.07710050650619224932e-11


@cache
def _by_polynomials() -> Callable[[Any], tuple[Any, Any]]:
    import jax
    import jax.numpy as jnp

    @jax.custom_jvp
    def both(x):
        quarters = jnp.round(x * (2.0 / np.pi))
        y = (x - quarters * QUARTER[0]) - quarters * QUARTER[1]
        sin, cos = y * jnp.polyval(np.array(SINE), y * y), jnp.polyval(np.array(COSINE), y * y)
        turns = jnp.mod(quarters, 4.0)
        sin, cos = jnp.where(turns % 2.0 == 1.0, cos, sin), jnp.where(turns % 2.0 == 1.0, -sin, cos)
        return jnp.where(turns >= 2.0, -sin, sin), jnp.where(turns >= 2.0, -cos, cos)

    @both.defjvp
    def _(values, changes):
        sin, cos = both(*values)
        return (sin, cos), (cos * changes[0], -sin * changes[0])

    return both


class _Either:
    """Functions of whichever library their arguments belong to."""

    pi = np.pi

    def __getattr__(self, name: str) -> Callable[..., Any]:
        def call(*given: Any, **options: Any) -> Any:
            return getattr(namespace(*given), name)(*given, **options)

        return call


xp: Any = _Either()
"""`xp.sin(x)` is `numpy.sin(x)` or `jax.numpy.sin(x)`: for functions that take arrays, not lists of them."""
