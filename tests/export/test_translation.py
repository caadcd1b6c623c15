"""Traced functions as programs of elementary operations, against JAX itself and against numbers by hand."""

from __future__ import annotations

from dataclasses import replace
from math import exp, tanh

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from exported_models import stall

from bayes_aero.effects import CATALOGUE
from bayes_aero.errors import InputError
from bayes_aero.export.program import Builder, terms
from bayes_aero.export.translate import translated

FUNCTIONS = {
    "powers": lambda x, y: x**2 + x**3 - x**4 + x**7 + jnp.abs(y) ** x + jnp.cbrt(y) + jax.lax.rsqrt(1.0 + y * y),
    "exponentials": lambda x, y: jnp.exp(x) * jnp.log(2.0 + y) + jnp.expm1(x) - jnp.log1p(y) + jax.nn.sigmoid(9.0 * y),
    "angles": lambda x, y: jnp.sin(x) * jnp.cos(y) + jnp.tan(y) + jnp.arctan2(y, x) + jnp.arcsin(y) - jnp.arccos(y),
    "hyperbolic": lambda x, y: jnp.sinh(x) - jnp.cosh(y) * jnp.tanh(x - y) + jnp.arctan(y),
    "breaks": lambda x, y: jnp.where((x > 0.6) & ~(y < 0.1), x, -y) + jnp.clip(y, -0.2, 0.3) + jnp.sign(y) * x,
    "steps": lambda x, y: jnp.floor(3.0 * x) - jnp.ceil(3.0 * y) + jnp.maximum(x, y) * jnp.minimum(x, 0.5),
    "calls": lambda x, y: jax.jit(lambda z: jnp.square(z) / 3.0)(x) + jax.checkpoint(jnp.sin)(y) + jnp.hypot(x, y),
    "slopes": lambda x, y: jax.jvp(lambda z: jax.nn.sigmoid(z * y) * jnp.sqrt(z), (x,), (jnp.ones_like(x),))[1],
}


@pytest.mark.parametrize("name", FUNCTIONS)
def test_a_program_gives_what_the_traced_function_gives(name):
    function = FUNCTIONS[name]
    program = translated(lambda given: {"z": function(given["x"], given["y"])}, {"x": 0.7, "y": 0.2})
    rng = np.random.default_rng(4)
    x, y = rng.uniform(0.1, 1.0, 50), rng.uniform(-0.9, 0.9, 50)
    expected = [float(function(jnp.asarray(a), jnp.asarray(b))) for a, b in zip(x, y, strict=True)]
    np.testing.assert_allclose(program.evaluated({"x": x, "y": y})["z"], expected, rtol=1e-13, atol=1e-14)


def test_numbers_by_hand():
    program = translated(lambda given: {"z": jax.nn.sigmoid(2.0 * given["x"]) - 1.0}, {"x": 0.0})
    assert program.evaluated({"x": 0.3})["z"] == pytest.approx((1.0 + tanh(0.3)) / 2.0 - 1.0, abs=1e-16)
    assert program.evaluated({"x": -400.0})["z"] == -1.0
    program = translated(lambda given: {"z": jnp.exp(-given["x"]) / (1.0 + given["x"])}, {"x": 0.0})
    assert program.evaluated({"x": 2.0})["z"] == exp(-2.0) / 3.0


def test_what_changes_nothing_is_no_step():
    build = Builder()
    assert build.apply("add", "x", 0.0) == build.apply("mul", 1.0, "x") == build.apply("div", "x", 1.0) == "x"
    assert build.apply("mul", 0.0, "x") == 0.0
    assert build.apply("add", 1.0, build.apply("sub", "y", 1.0)) == "y"
    assert build.apply("sin", "x") == build.apply("sin", "x")
    assert build.apply("sub", 3.0, 1.0) == 2.0


def test_summands_keep_their_signs():
    program = translated(lambda g: {"z": g["a"] - (g["b"] - 2.0 * g["c"])}, {"a": 1.0, "b": 1.0, "c": 1.0})
    inputs = {"a": 3.0, "b": 5.0, "c": 7.0}
    parts = program.giving({str(i): x for i, (_, x) in enumerate(terms(program, "z"))})
    signs = [sign for sign, _ in terms(program, "z")]
    found = parts.evaluated(inputs)
    assert sorted(s * found[str(i)] for i, s in enumerate(signs)) == [-5.0, 3.0, 14.0]


def changed(increments):
    """The stall model with a user's own drag."""
    own = replace(CATALOGUE["separated_drag"], name="my_drag", increments=increments)
    model = stall().model
    effects = tuple(own if e.name == "separated_drag" else e for e in model.effects)
    return replace(stall(), model=replace(model, effects=effects))


@pytest.mark.parametrize(
    ("increments", "words"),
    [
        (lambda v, *_: {"CD": jnp.sum(jnp.arange(3.0) * v["CDX"])}, "several numbers at once"),
        (lambda v, s, *_: {"CD": v["CDX"] * s["dt"]}, "KeyError: 'dt'"),
        (lambda *given: {"CD": 0.1 if given[3]["X"] > 0.5 else 0.2}, "fails with TracerBoolConversionError"),
        (lambda *given: {"CD": jax.scipy.special.gammaln(given[3]["X"])}, "it uses lgamma"),
    ],
)
def test_an_effect_that_cannot_be_exported_is_named(increments, words):
    with pytest.raises(InputError, match="effect my_drag cannot be exported") as told:
        _ = changed(increments).program
    assert words in str(told.value)
    assert "\n" not in str(told.value)
