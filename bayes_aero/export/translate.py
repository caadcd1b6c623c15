"""From a traced JAX function of scalars to a program of elementary operations.

An effect is written once, as a function of arrays. Its trace names every operation that it does, so any effect can be
printed in another language, a user's own too.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from bayes_aero.errors import InputError
from bayes_aero.export.program import OPERATIONS, Builder, Operand, Program

SAME = (
    "convert_element_type", "broadcast_in_dim", "reshape", "squeeze", "expand_dims", "copy", "copy_p", "stop_gradient",
    "reduce_precision",
)  # fmt: skip
"""Of one number they change nothing."""
INNER = ("jaxpr", "call_jaxpr", "fun_jaxpr")
"""Parameters under which a call keeps the function that it calls."""


def translated(function: Callable[[Mapping[str, Any]], Mapping[str, Any]], inputs: Mapping[str, float]) -> Program:
    """A function of scalars by name, traced at `inputs`, as a program.

    Raises:
        InputError: an effect does something that is no elementary operation of single numbers.
    """
    given = {name: jnp.asarray(x, dtype=jnp.float64) for name, x in inputs.items()}
    names = tuple(given)

    def listed(*values: Any) -> dict[str, Any]:
        return dict(function(dict(zip(names, values, strict=True))))

    closed, shape = jax.make_jaxpr(listed, return_shape=True)(*given.values())
    builder = Builder()
    found = _inside(closed.jaxpr, closed.consts, names, builder)
    return builder.program(dict(zip(sorted(shape), found, strict=True)))


def _inside(jaxpr: Any, constants: Any, given: tuple[Operand, ...], builder: Builder) -> list[Operand]:
    """The results of a traced function."""
    known: dict[Any, Operand] = dict(zip(jaxpr.invars, given, strict=True))
    known |= {name: _number(x, "") for name, x in zip(jaxpr.constvars, constants, strict=True)}

    def read(x: Any) -> Operand:
        return _number(x.val, "") if hasattr(x, "val") else known[x]

    for equation in jaxpr.eqns:
        arguments = tuple(read(x) for x in equation.invars)
        known |= zip(equation.outvars, _applied(equation, arguments, builder), strict=True)
    return [read(x) for x in jaxpr.outvars]


def _applied(equation: Any, given: tuple[Operand, ...], builder: Builder) -> list[Operand]:
    """The results of one equation of a trace."""
    name, params = equation.primitive.name, equation.params
    where = str(equation.source_info.name_stack)
    inner = next((params[key] for key in INNER if key in params), None)
    if inner is not None and name not in ("scan", "while", "cond"):
        return _inside(getattr(inner, "jaxpr", inner), getattr(inner, "consts", ()), given, builder)
    if any(x.aval.size != 1 for x in (*equation.invars, *equation.outvars)):
        raise _unknown(where, f"{name} of several numbers at once")
    if name in SAME:
        if jnp.issubdtype(equation.outvars[0].aval.dtype, jnp.integer) and not isinstance(given[0], float):
            raise _unknown(where, "rounding to whole numbers")
        return [given[0]]
    if name == "square":
        return [builder.apply("mul", given[0], given[0])]
    if name == "integer_pow":
        return [_power(given[0], params["y"], builder)]
    if name == "rsqrt":
        return [builder.apply("div", 1.0, builder.apply("sqrt", given[0]))]
    if name == "clamp":
        low, x, high = given
        return [builder.apply("min", builder.apply("max", x, low), high)]
    if name == "select_n" and len(given) == 3:
        return [builder.apply("select", given[0], given[2], given[1])]
    operation = "add" if name == "add_any" else name
    if operation not in OPERATIONS:
        raise _unknown(where, name)
    return [builder.apply(operation, *given)]


def _power(x: Operand, exponent: int, builder: Builder) -> Operand:
    """x to a whole number; small ones as products, which are exact to the last bit."""
    if not 2 <= exponent <= 4:
        return builder.apply("pow", x, float(exponent))
    square = builder.apply("mul", x, x)
    return square if exponent == 2 else builder.apply("mul", square, x if exponent == 3 else square)


def _number(x: Any, where: str) -> float:
    array = np.asarray(x)
    if array.size != 1:
        raise _unknown(where, "a table of numbers")
    return float(array.reshape(()))


def _unknown(where: str, what: str) -> InputError:
    effect = where.split("/")[-1] or "of the model"
    return InputError(
        f"effect {effect} cannot be exported: it uses {what}, which has no counterpart in the export formats; write it "
        "with arithmetic, elementary functions, comparisons and where"
    )
