"""The model as one Python function that needs nothing but `math`."""

from __future__ import annotations

import json
import re
from keyword import iskeyword

from bayes_aero.errors import InputError, plain_line
from bayes_aero.export.identified import Identified
from bayes_aero.export.program import Operand, Program, Step
from bayes_aero.export.text import about, meaning, unit, version, wrapped
from bayes_aero.flight.aircraft import AIRCRAFT_UNITS

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
    """The text of a Python file: parameters, constants, draws and the function `aerodynamics`."""
    program = with_rates(found)
    used = {step.operation for step in program.steps}
    signals, points = program.inputs_of("signal"), program.inputs_of("state")
    for name in (*signals, *points):
        if not name.isidentifier() or iskeyword(name) or re.fullmatch(TAKEN, name):
            raise InputError(f"channel {name} cannot be an argument in Python; give it another name on the card")
    names = (*signals, *points)
    head = f"def aerodynamics({', '.join((*names, 'parameters=PARAMETERS'))}):"
    parts = [
        f'"""{_quoted(wrapped(about(found), WIDTH))}\n"""\n\nimport math\n',
        _table(
            "PARAMETERS",
            [
                (p.name, found.values[p.name], f"{p.unit}: {p.description}".removeprefix("1: "))
                for p in _parameters(found)
            ],
        ),
        _table("AIRCRAFT", [(n, found.inputs[f"aircraft.{n}"], _unit_of(n)) for n in program.inputs_of("aircraft")]),
        *([] if found.draws is None else [_draws(found)]),
        *(f"\n{OWN[name]}" for name in OWN if name in used),
        f"\n{head}\n{_docstring(found, signals, points, program)}    P, A = parameters, AIRCRAFT\n{_body(program)}",
    ]
    return "\n".join(parts)


def with_rates(found: Identified) -> Program:
    """The program with the rate of each lagged separation point, too."""
    program = found.program
    if not found.lagged:
        return program
    outputs, steps = dict(program.outputs), list(program.steps)
    lag = outputs["lag"]
    for name in found.points:
        steps.append(Step(f"excess.{name}", "sub", (outputs[f"{name}_static"], f"state.{name}")))
        steps.append(Step(f"rate.{name}", "div", (f"excess.{name}", lag)))
        outputs[f"{name}_dot"] = f"rate.{name}"
    return Program(tuple(steps), outputs)


def _parameters(found: Identified) -> list:
    used = found.program.inputs_of("parameter")
    return [p for p in found.exported.parameters if p.name in used]


def _unit_of(constant: str) -> str:
    return AIRCRAFT_UNITS[constant.split(".")[0]]


def _quoted(text: str) -> str:
    """Words of a card or a record, which end no docstring."""
    return text.replace("\\", "/").replace('"', "'")


def _table(name: str, rows: list[tuple[str, float, str]]) -> str:
    lines = [f"    {json.dumps(key)}: {float(value)!r},  # {plain_line(remark)}" for key, value, remark in rows]
    return "\n".join([f"{name} = {{", *lines, "}"])


def _draws(found: Identified) -> str:
    drawn = found.draws
    assert drawn is not None
    rows = "\n".join(f"    ({', '.join(repr(float(x)) for x in row)},)," for row in drawn.values)
    return (
        f"DRAWN = {drawn.names!r}\n"
        f"# {drawn.origin}; parameters=PARAMETERS | dict(zip(DRAWN, DRAWS[k])) takes one of them\n"
        f"DRAWS = (\n{rows}\n)"
    )


def _docstring(found: Identified, signals: tuple[str, ...], points: tuple[str, ...], program: Program) -> str:
    lines = [f"{name}: {meaning(name)}{_behind(name)}." for name in signals]
    lines += [f"{name}: separation point, 1 attached, 0 separated; a state." for name in points]
    lines += ["parameters: PARAMETERS, or other values of the same names."]
    given = [f"{name}" for name in program.outputs]
    told = [f"coefficients {', '.join(n for n in given if n in found.exported.coefficients)}"]
    told += [f"{n}: {_said(n)}" for n in given if n not in found.exported.coefficients]
    body = "\n".join(f"        {line}" for line in lines)
    returned = wrapped([f"A dict: {'; '.join(told)}."], WIDTH, "        ")
    return (
        f'    """Aerodynamic coefficients of {_quoted(found.title)}, by {version()}.\n\n    Args:\n{body}\n\n'
        f'    Returns:\n{returned}\n    """\n'
    )


def _behind(channel: str) -> str:
    return "" if unit(channel) in ("", "1") else f", {unit(channel)}"


def _said(output: str) -> str:
    if output.endswith("_dot"):
        return "rate of the state, 1/s"
    if output == "lag":
        return "time constant of the state, s"
    return "its static value" if output.endswith("_static") else "separation point"


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
