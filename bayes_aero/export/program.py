"""A scalar function as a list of elementary operations: what every export format is printed from."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from bayes_aero.errors import InputError

Operand = str | float  # the name of an input or of a step, or a number


OPERATIONS: dict[str, Callable[..., Any]] = {
    "add": np.add, "sub": np.subtract, "mul": np.multiply, "div": np.divide, "neg": np.negative, "pow": np.power,
    "sqrt": np.sqrt, "cbrt": np.cbrt, "exp": np.exp, "expm1": np.expm1, "log": np.log, "log1p": np.log1p,
    "sin": np.sin, "cos": np.cos, "tan": np.tan, "asin": np.arcsin, "acos": np.arccos, "atan": np.arctan,
    "atan2": np.arctan2, "sinh": np.sinh, "cosh": np.cosh, "tanh": np.tanh,
    "logistic": lambda x: 0.5 * (1.0 + np.tanh(0.5 * x)),
    "abs": np.abs, "sign": np.sign, "floor": np.floor, "ceil": np.ceil, "min": np.minimum, "max": np.maximum,
    "lt": np.less, "le": np.less_equal, "gt": np.greater, "ge": np.greater_equal, "eq": np.equal, "ne": np.not_equal,
    "and": np.logical_and, "or": np.logical_or, "not": np.logical_not, "select": np.where,
}  # fmt: skip
"""Every operation that a program may have, and its meaning. `select` is the second argument where the first is true."""


@dataclass(frozen=True)
class Operation:
    """One operation; its result has the `name`."""

    name: str
    operation: str
    arguments: tuple[Operand, ...]


@dataclass(frozen=True)
class Program:
    """Steps in their order, and the outputs by name. Inputs are named `parameter.CLa`, `signal.alpha`, `state.X`."""

    steps: tuple[Operation, ...]
    outputs: Mapping[str, Operand]

    @property
    def inputs(self) -> tuple[str, ...]:
        return tuple(sorted({*self.uses} - {step.name for step in self.steps}))

    def inputs_of(self, kind: str) -> tuple[str, ...]:
        """Names of the inputs of a kind (`parameter`, `signal`, `state`, `aircraft`), without it."""
        return tuple(name.removeprefix(f"{kind}.") for name in self.inputs if name.startswith(f"{kind}."))

    @property
    def uses(self) -> Counter[str]:
        read = (x for x in (*self.outputs.values(), *(x for s in self.steps for x in s.arguments)))
        return Counter(x for x in read if isinstance(x, str))

    def giving(self, outputs: Mapping[str, Operand]) -> Program:
        """The part that these outputs need."""
        needed = {x for x in outputs.values() if isinstance(x, str)}
        for step in reversed(self.steps):
            if step.name in needed:
                needed |= {x for x in step.arguments if isinstance(x, str)}
        return replace(self, steps=tuple(s for s in self.steps if s.name in needed), outputs=dict(outputs))

    def evaluated(self, inputs: Mapping[str, Any]) -> dict[str, Any]:
        """The outputs for numbers or arrays of inputs that broadcast."""
        values: dict[str, Any] = dict(inputs)

        def value(x: Operand) -> Any:
            return values[x] if isinstance(x, str) else x

        for step in self.steps:
            values[step.name] = OPERATIONS[step.operation](*(value(x) for x in step.arguments))
        return {name: value(x) for name, x in self.outputs.items()}


class Builder:
    """Makes a program step by step; equal steps are one, and operations on numbers are carried out."""

    def __init__(self) -> None:
        self._known: dict[tuple[str, tuple[Operand, ...]], str] = {}
        self._made: dict[Operand, tuple[str, tuple[Operand, ...]]] = {}

    def apply(self, operation: str, *given: Operand) -> Operand:
        """The result of an operation; sums with 0, products with 0 or 1 and quotients by 1 need none."""
        if all(isinstance(x, float) for x in given):
            return float(OPERATIONS[operation](*given))
        if operation == "add" and 0.0 in given:
            return given[0] if given[1] == 0.0 else given[1]
        if operation == "mul" and 0.0 in given:
            return 0.0
        if operation == "mul" and 1.0 in given:
            return given[0] if given[1] == 1.0 else given[1]
        if (operation == "sub" and given[1] == 0.0) or (operation in ("div", "pow") and given[1] == 1.0):
            return given[0]
        if operation == "add":  # y of x + (y - x), of which effects that replace a value consist
            for x, other in (given, given[::-1]):
                made, (first, *rest) = self._made.get(other, ("", ("",)))
                if made == "sub" and rest == [x]:
                    return first
        name = self._known.setdefault((operation, given), f"t{len(self._known) + 1}")
        self._made[name] = (operation, given)
        return name

    def program(self, outputs: Mapping[str, Operand]) -> Program:
        steps = tuple(Operation(name, operation, given) for (operation, given), name in self._known.items())
        return Program(steps, {}).giving(outputs)


def terms(program: Program, output: str) -> Iterable[tuple[float, Operand]]:
    """The summands of an output with their signs."""
    by_name = {step.name: step for step in program.steps}
    waiting: list[tuple[float, Operand]] = [(1.0, program.outputs[output])]
    while waiting:
        sign, x = waiting.pop()
        step = by_name.get(x) if isinstance(x, str) else None
        if step is None or step.operation not in ("add", "sub", "neg"):
            yield sign, x
            continue
        second = -sign if step.operation == "sub" else sign
        first = -sign if step.operation == "neg" else sign
        waiting += [(f, y) for f, y in zip((first, second), step.arguments, strict=False)]


# --- From a traced JAX function of scalars to a program of elementary operations.
# An effect is written once, as a function of arrays. Its trace names every operation that it does, so any effect can
# be printed in another language, a user's own too.

SAME = (  # of one number they change nothing
    "convert_element_type", "broadcast_in_dim", "reshape", "squeeze", "expand_dims", "copy", "copy_p", "stop_gradient",
    "reduce_precision",
)  # fmt: skip
INNER = ("jaxpr", "call_jaxpr", "fun_jaxpr")  # parameters under which a call keeps the function that it calls


def translated(function: Callable[[Mapping[str, Any]], Mapping[str, Any]], inputs: Mapping[str, float]) -> Program:
    """A function of scalars by name, traced at `inputs`, as a program."""
    given = {name: jnp.asarray(x, dtype=jnp.float64) for name, x in inputs.items()}
    names = tuple(given)

    def listed(*values: Any) -> dict[str, Any]:
        return dict(function(dict(zip(names, values, strict=True))))

    closed, shape = jax.make_jaxpr(listed, return_shape=True)(*given.values())
    builder = Builder()
    outputs = _inside(closed.jaxpr, closed.consts, names, builder)
    return builder.program(dict(zip(sorted(shape), outputs, strict=True)))


def _inside(jaxpr: Any, constants: Any, given: tuple[Operand, ...], builder: Builder) -> list[Operand]:
    known: dict[Any, Operand] = dict(zip(jaxpr.invars, given, strict=True))
    known |= {name: _number(x) for name, x in zip(jaxpr.constvars, constants, strict=True)}

    def read(x: Any) -> Operand:
        return _number(x.val) if hasattr(x, "val") else known[x]

    for equation in jaxpr.eqns:
        arguments = tuple(read(x) for x in equation.invars)
        known |= zip(equation.outvars, _applied(equation, arguments, builder), strict=True)
    return [read(x) for x in jaxpr.outvars]


def _applied(equation: Any, given: tuple[Operand, ...], builder: Builder) -> list[Operand]:
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
        if not 2 <= params["y"] <= 4:
            return [builder.apply("pow", given[0], float(params["y"]))]
        square = builder.apply("mul", given[0], given[0])  # small ones as products, which are exact to the last bit
        return [square if params["y"] == 2 else builder.apply("mul", square, given[0] if params["y"] == 3 else square)]
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


def _number(x: Any) -> float:
    array = np.asarray(x)
    if array.size != 1:
        raise _unknown("", "a table of numbers")
    return float(array.reshape(()))


def _unknown(where: str, what: str) -> InputError:
    effect = where.split("/")[-1] or "of the model"
    return InputError(
        f"effect {effect} cannot be exported: it uses {what}, which has no counterpart in the export formats; write it "
        "with arithmetic, elementary functions, comparisons and where"
    )
