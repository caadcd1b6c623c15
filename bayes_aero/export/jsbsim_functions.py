"""Programs as functions of JSBSim: one XML element an operation. Source: JSBSim reference manual, ch. Functions."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from copy import deepcopy
from xml.etree.ElementTree import Element, SubElement

from bayes_aero.export.program import Operand, Program

PREFIX = "bayes-aero"
"""Branch of the property tree for all that an export adds."""

SAME = {
    "add": "sum", "sub": "difference", "mul": "product", "div": "quotient", "pow": "pow", "sqrt": "sqrt", "exp": "exp",
    "log": "ln", "sin": "sin", "cos": "cos", "tan": "tan", "asin": "asin", "acos": "acos", "atan": "atan",
    "atan2": "atan2", "abs": "abs", "floor": "floor", "ceil": "ceil", "min": "min", "max": "max", "lt": "lt",
    "le": "le", "gt": "gt", "ge": "ge", "eq": "eq", "ne": "nq", "and": "and", "or": "or", "not": "not",
    "select": "ifthen",
}  # fmt: skip
LARGEST_EXPONENT = 700.0  # e to this is still a number

Node = Element


def value(x: float) -> Node:
    """A number, to the last bit."""
    node = Element("value")
    node.text = repr(float(x))
    return node


def read(name: str) -> Node:
    """The value of a property."""
    node = Element("property")
    node.text = name
    return node


def call(tag: str, *arguments: Node) -> Node:
    """An operation of JSBSim."""
    node = Element(tag)
    node.extend(arguments)
    return node


def named(tag: str, name: str, content: Node) -> Node:
    """A function under a name, with its content."""
    node = Element(tag, name=name)
    if tag == "fcs_function":
        SubElement(node, "function").append(content)
    else:
        node.append(content)
    return node


def _reciprocal_of_one_and(x: Node) -> Node:
    return call("quotient", value(1.0), call("sum", value(1.0), x))


def _exp(x: Node, factor: float) -> Node:
    return call("exp", call("min", value(LARGEST_EXPONENT), call("product", value(factor), x)))


COMPOSED: dict[str, Callable[[Node], Node]] = {
    "neg": lambda x: call("product", value(-1.0), x),
    "logistic": lambda x: _reciprocal_of_one_and(_exp(x, -1.0)),
    "tanh": lambda x: call(
        "difference", call("product", value(2.0), _reciprocal_of_one_and(_exp(x, -2.0))), value(1.0)
    ),
    "sinh": lambda x: call("product", value(0.5), call("difference", _exp(x, 1.0), _exp(deepcopy(x), -1.0))),
    "cosh": lambda x: call("product", value(0.5), call("sum", _exp(x, 1.0), _exp(deepcopy(x), -1.0))),
    "expm1": lambda x: call("difference", call("exp", x), value(1.0)),
    "log1p": lambda x: call("ln", call("sum", value(1.0), x)),
    "sign": lambda x: call("difference", call("gt", x, value(0.0)), call("lt", deepcopy(x), value(0.0))),
    "cbrt": lambda x: call("product", COMPOSED["sign"](x), call("pow", call("abs", deepcopy(x)), value(1.0 / 3.0))),
}
"""Operations that JSBSim does not have, by those that it has."""


def functions(
    program: Program, inputs: Mapping[str, Node], outputs: Mapping[str, str], steps: str = "step"
) -> list[Node]:
    """The program as functions in their order: steps that are read more than once, then the outputs.

    Args:
        program: steps and outputs.
        inputs: how each input is read.
        outputs: names of the properties of the outputs.
        steps: branch of the properties of the steps.
    """
    known, uses, found = dict(inputs), program.uses, []

    def node(x: Operand) -> Node:
        return deepcopy(known[x]) if isinstance(x, str) else value(x)

    for step in program.steps:
        arguments = [node(x) for x in step.arguments]
        if step.operation in SAME:
            content = call(SAME[step.operation], *arguments)
        else:
            content = COMPOSED[step.operation](*arguments)
        if uses[step.name] > 1:
            name = f"{PREFIX}/{steps}/{step.name}"
            found.append(named("function", name, content))
            content = read(name)
        known[step.name] = content
    for name, x in program.outputs.items():
        found.append(named("function", outputs[name], node(x)))
    return found
