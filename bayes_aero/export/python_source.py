"""The model as one Python function that needs nothing but `math`: what an FMU evaluates."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from keyword import iskeyword

from bayes_aero.errors import InputError
from bayes_aero.export.identified import Identified
from bayes_aero.export.program import Operand, Program

WIDTH = 110
TAKEN = r"P|A|t\d+|math|parameters"
"""Names that the function uses itself."""
INFIX = {
    "add": ("+", 1), "sub": ("-", 1), "mul": ("*", 2), "div": ("/", 2), "lt": ("<", 0), "le": ("<=", 0),
    "gt": (">", 0), "ge": (">=", 0), "eq": ("==", 0), "ne": ("!=", 0),
}  # fmt: skip
MATH = ("sqrt", "cbrt", "exp", "expm1", "log", "log1p", "sin", "cos", "tan", "asin", "acos", "atan", "atan2", "sinh",
        "cosh", "tanh", "floor", "ceil", "pow")  # fmt: skip
OWN = {
    "logistic": "def _logistic(x):\n    return 1.0 / (1.0 + math.exp(-x)) if x >= 0.0 else math.exp(x) / "
    "(1.0 + math.exp(x))\n",
    "sign": "def _sign(x):\n    return float(x > 0.0) - float(x < 0.0)\n",
}
WORDS = {"min": "min({}, {})", "max": "max({}, {})", "abs": "abs({})", "and": "({} and {})", "or": "({} or {})",
         "not": "(not {})", "select": "({1} if {0} else {2})", "neg": "(-{})"}  # fmt: skip


def python_source(found: Identified) -> str:
    """The text of a Python file: parameters, constants and the function `aerodynamics`."""
    program = found.program
    used = {step.operation for step in program.steps}
    names = (*program.inputs_of("signal"), *program.inputs_of("state"))
    for name in names:
        if not name.isidentifier() or iskeyword(name) or re.fullmatch(TAKEN, name):
            raise InputError(f"channel {name} cannot be an argument in Python; give it another name on the card")
    read = program.inputs_of("parameter")
    values = {p.name: found.values[p.name] for p in found.exported.parameters if p.name in read}
    parts = [
        "import math\n",
        _table("PARAMETERS", values),
        _table("AIRCRAFT", {n: found.inputs[f"aircraft.{n}"] for n in program.inputs_of("aircraft")}),
        *(f"\n{OWN[name]}" for name in OWN if name in used),
        f"\ndef aerodynamics({', '.join((*names, 'parameters=PARAMETERS'))}):",
        f"    P, A = parameters, AIRCRAFT\n{_body(program)}",
    ]
    return "\n".join(parts)


def _table(name: str, rows: Mapping[str, float]) -> str:
    lines = [f"    {json.dumps(key)}: {float(value)!r}," for key, value in rows.items()]
    return "\n".join([f"{name} = {{", *lines, "}"])


def _body(program: Program) -> str:
    """Assignments and the returned dict; what is read once stands where it is read, if the line stays short."""
    known: dict[str, tuple[str, int]] = {name: (_input(name), 9) for name in program.inputs}
    uses, lines, number = program.uses, [], 0

    def value(x: Operand) -> tuple[str, int]:
        return known[x] if isinstance(x, str) else (repr(x), 9 if x >= 0.0 else 1)

    for step in program.steps:
        text, rank = _expression(step.operation, [value(x) for x in step.arguments])
        if uses[step.name] > 1 or len(text) > WIDTH - 30:
            number += 1
            lines.append(f"    t{number} = {text}")
            text, rank = f"t{number}", 9
        known[step.name] = (text, rank)
    lines.append("    return {")
    lines += [f'        "{name}": {value(x)[0]},' for name, x in program.outputs.items()]
    return "\n".join([*lines, "    }", ""])


def _input(name: str) -> str:
    kind, own = name.split(".", 1)
    return {"parameter": f"P[{json.dumps(own)}]", "aircraft": f"A[{json.dumps(own)}]"}.get(kind, own)


def _expression(operation: str, given: list[tuple[str, int]]) -> tuple[str, int]:
    """The text of an operation, and how tightly it binds."""
    if operation in INFIX:
        sign, rank = INFIX[operation]
        (left, first), (right, second) = given
        left = f"({left})" if first < rank or rank == 0 else left
        right = f"({right})" if second <= rank else right
        return f"{left} {sign} {right}", rank
    texts = [text for text, _ in given]
    if operation in WORDS:
        texts = [f"({t})" if rank < 9 and operation in ("neg", "not", "and", "or", "select") else t
                 for t, (_, rank) in zip(texts, given, strict=True)]  # fmt: skip
        return WORDS[operation].format(*texts), 9
    return f"{'math.' if operation in MATH else '_'}{operation}({', '.join(texts)})", 9
