"""What is exported: a model of effects with its values, and its coefficients as a list of elementary operations."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from bayes_aero import __version__
from bayes_aero.dynamics.aircraft import MIN_LAG, POINTS
from bayes_aero.effect import Effect, Stage
from bayes_aero.errors import InputError, plain_line
from bayes_aero.flight.channel import STANDARD_CHANNELS
from bayes_aero.model.model import Model
from bayes_aero.physics.aircraft import LATERAL, Aircraft

# --- A scalar function as a list of elementary operations, from which every export format is printed.

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
    operands: dict[Any, Operand] = dict(zip(jaxpr.invars, given, strict=True))
    operands |= {name: _number(x) for name, x in zip(jaxpr.constvars, constants, strict=True)}

    def read(x: Any) -> Operand:
        return _number(x.val) if hasattr(x, "val") else operands[x]

    for equation in jaxpr.eqns:
        arguments = tuple(read(x) for x in equation.invars)
        operands |= zip(equation.outvars, _applied(equation, arguments, builder), strict=True)
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
    return InputError(f"effect {effect} cannot be exported: it uses {what}; write it with elementary functions")


# --- The model.

LEAST = {"airspeed": 1.0, "density": 1e-3}
"""Signals that models divide by (q c/V, thrust over dynamic pressure), and what stands for them below it: m/s, kg/m3.

A simulator may be at rest; forces vanish there with the dynamic pressure.
"""


@dataclass(frozen=True)
class Draws:
    """Values (m, k) of the parameters `names` that are uncertain; `origin` says what they were drawn from."""

    names: tuple[str, ...]
    values: Float[np.ndarray, "m k"]
    origin: str


@dataclass(frozen=True)
class Identified:
    """A model of effects with values of its parameters, SI and radians."""

    name: str
    title: str
    model: Model
    aircraft: Aircraft  # the card's, which the effects of stage AIRCRAFT change
    values: Mapping[str, float]
    sources: tuple[str, ...]  # where the values come from
    flown: Mapping[str, tuple[float, float]] = field(default_factory=dict)  # range of each channel in the records
    draws: Draws | None = None

    @property
    def names(self) -> tuple[str, ...]:
        return self.model.names

    @property
    def bounds(self) -> dict[str, tuple[float, float]]:
        return {p.name: p.bounds for p in self.model.parameters}

    @cached_property
    def exported(self) -> Model:
        """The model without effects of sensors, of the record and of disturbed air."""
        kept = tuple(_scoped(e) for e in self.model.effects if _is_of_aircraft(e))
        owned = {p.name for e in kept for p in e.parameters}
        parameters = tuple(p for p in self.model.parameters if p.name in owned)
        fixed = tuple((name, x) for name, x in self.model.fixed if name in owned)
        return replace(self.model, effects=kept, parameters=parameters, fixed=fixed)

    @property
    def left_out(self) -> tuple[str, ...]:
        sentences = []
        for e in (e for e in self.model.acting if not _is_of_aircraft(e)):
            size = ", ".join(
                f"{p.name} = {self.values[p.name]:.4g} {p.unit}" for p in e.parameters if p.name in self.values
            )
            what = "the record, not the aircraft" if e.stage is Stage.CHANNEL else "a random process of the air"
            sentences.append(f"{e.name} ({size}) is not exported: it is {what}. {e.claim}")
        return tuple(sentences)

    @cached_property
    def actual_aircraft(self) -> Aircraft:
        return _constants(self.exported.actual_aircraft(self.values, self.aircraft), lambda _, x: float(x))

    @property
    def separates(self) -> bool:
        return any(e.stage in (Stage.SEPARATION, Stage.LAG) for e in self.exported.acting)

    @property
    def lagged(self) -> bool:
        return any(e.stage is Stage.LAG for e in self.exported.acting)

    @property
    def points(self) -> tuple[str, ...]:
        """Separation points: of the whole wing, or of the right and the left one."""
        if not self.separates:
            return ()
        return POINTS[1:] if self.exported.two_wings else POINTS[:1]

    @cached_property
    def signals(self) -> tuple[str, ...]:
        channels = (c for e in self.exported.acting for c in e.channels)
        return tuple(dict.fromkeys(("alpha", *(("airspeed",) if self.lagged else ()), *channels)))

    @cached_property
    def program(self) -> Program:
        """Coefficients and separation points. A lagged point X is an input `state.X`; the outputs then are its static
        value `X_static` and `lag`, the time constant in s with which it follows."""
        return self.traced(self._outputs, self.points if self.lagged else ())

    @property
    def inputs(self) -> dict[str, float]:
        values = {f"parameter.{name}": float(x) for name, x in self.values.items()}

        def keep(name: str, x: Any) -> float:
            return values.setdefault(f"aircraft.{name}", float(x))

        _constants(self.aircraft, keep)
        return values

    def traced(self, function: Callable[..., Mapping[str, Any]], states: Sequence[str]) -> Program:
        """A function of values, signals, aircraft and states, each by name, as a program."""
        first = {f"signal.{name}": 0.5 for name in self.signals} | {f"state.{name}": 0.5 for name in states}
        for name in (n for n in self.signals if n in STANDARD_CHANNELS):
            low, high = STANDARD_CHANNELS[name].plausible
            first[f"signal.{name}"] = 0.5 * (low + high) + 0.01 * (high - low)

        def outputs(given: Mapping[str, Any]) -> Mapping[str, Any]:
            values = {name: given[f"parameter.{name}"] for name in self.values}
            signals = {name: given[f"signal.{name}"] for name in self.signals}
            signals |= {n: jnp.maximum(signals[n], least) for n, least in LEAST.items() if n in signals}
            aircraft = _constants(self.aircraft, lambda name, _: given[f"aircraft.{name}"])
            aircraft = self.exported.actual_aircraft(values, aircraft)
            return function(values, signals, aircraft, {name: given[f"state.{name}"] for name in states})

        program = translated(outputs, self.inputs | first)
        order = sorted(program.outputs, key=lambda name: (*self.model.coefficients, name).index(name))
        return replace(program, outputs={name: program.outputs[name] for name in order})

    def coefficients(
        self, values: Mapping[str, Any], signals: Mapping[str, Any], aircraft: Aircraft, points: Sequence[Any]
    ) -> dict[str, Any]:
        """Coefficients at given separation points, of one wing or of the right and the left one."""
        X = tuple(points) if len(points) > 1 else next(iter(points), jnp.ones_like(signals["alpha"]))
        flow = self.exported.flow(values, signals, aircraft, X=X)
        return {name: flow[name] for name in self.exported.coefficients}

    @property
    def lift_slope(self) -> Program:
        """The derivative of CL by alpha-dot, s, as the output `slope`: how strongly the two depend on each other."""

        def outputs(values: Any, signals: Any, aircraft: Any, states: Any) -> dict[str, Any]:
            if "CL" not in self.exported.coefficients or "alpha_dot" not in signals:
                return {"slope": jnp.zeros_like(signals["alpha"])}
            rate = signals["alpha_dot"]
            lift = lambda rate: self._outputs(values, dict(signals) | {"alpha_dot": rate}, aircraft, states)["CL"]  # noqa: E731
            return {"slope": jax.jvp(lift, (rate,), (jnp.ones_like(rate),))[1]}

        return self.traced(outputs, self.points if self.lagged else ())

    def lag(self, values: Mapping[str, Any], signals: Mapping[str, Any], aircraft: Aircraft) -> dict[str, Any]:
        """The time constant of the separation point, s, where there is one."""
        if not self.lagged:
            return {}
        return {"lag": jnp.maximum(self.exported.lag(values), MIN_LAG) * aircraft.chord / signals["airspeed"]}

    def _outputs(
        self, values: Mapping[str, Any], signals: Mapping[str, Any], aircraft: Aircraft, states: Mapping[str, Any]
    ) -> dict[str, Any]:
        static = self.exported.static_points(values, signals, aircraft) if self.separates else ()
        outputs = self.coefficients(values, signals, aircraft, [*states.values()] or static)
        outputs |= {f"{n}_static" if states else n: x for n, x in zip(self.points, static, strict=True)}
        return outputs | self.lag(values, signals, aircraft)


def _is_of_aircraft(effect: Effect) -> bool:
    """Whether a simulator needs it: it is part of the aircraft, and no random process."""
    return effect.stage not in (Stage.CHANNEL, Stage.INFLOW) and effect.disturbance is None


def _scoped(effect: Effect) -> Effect:
    """The effect under its name in a trace, so that an operation without counterpart can be traced back to it."""

    def increments(*given: Any) -> Any:
        try:
            with jax.named_scope(effect.name):
                return effect.increments(*given)
        except InputError:
            raise
        except Exception as reason:  # whatever a user's own effect may raise on single numbers
            raise InputError(
                f"effect {effect.name} cannot be exported: for single numbers it fails with "
                f"{type(reason).__name__}: {reason}"
            ) from None

    return replace(effect, increments=increments)


def _constants(aircraft: Aircraft, made: Callable[[str, Any], Any]) -> Aircraft:
    """An aircraft whose constants are `made` of their names and values; those of a position are NAME.0 to NAME.2."""
    constants = {}
    for f in fields(aircraft):
        value = getattr(aircraft, f.name)
        if isinstance(value, tuple):
            constants[f.name] = tuple(made(f"{f.name}.{i}", x) for i, x in enumerate(value))
        else:
            constants[f.name] = None if value is None else made(f.name, value)
    return Aircraft(**constants)


# --- Sentences that every exported form has: origin, conventions, validity, what is left out.

CONVENTIONS = (
    "SI units and radians. Body axes x forward, y right, z down. CL and CD are lift and drag along the stability axes: "
    "CX = CL sin(alpha) - CD cos(alpha), CZ = -CL cos(alpha) - CD sin(alpha). CY is the side force along body y.",
    "Force = 0.5 density airspeed^2 wing_area coefficient. Moments are about the aerodynamic reference point.",
    "Surfaces: trailing edge down is positive, a rudder's to the left. aileron is half of right less left.",
)


def lengths(identified: Identified) -> tuple[str, ...]:
    a = identified.actual_aircraft
    rate, lateral = a.rate_length or a.chord, a.lateral_rate_length or a.half_span
    speed = "V" if a.reference_speed is None else f"{a.reference_speed:.6g} m/s"
    texts = [
        f"wing area {a.wing_area:.6g} m^2; Cm refers to the chord, {a.chord:.6g} m; q enters as q l/{speed} with "
        f"l = {rate:.6g} m (many texts: q c/2V)"
    ]
    if set(identified.exported.coefficients) & set(LATERAL):
        texts.append(
            f"Cl and Cn refer to {a.moment_length:.6g} m; p and r enter as p l/{speed} with l = {lateral:.6g} m "
            f"(half the span is {a.half_span:.6g} m)"
        )
    x, y, z = a.reference_point
    texts.append(f"aerodynamic reference point {x:.6g}, {y:.6g}, {z:.6g} m from the centre of gravity, body axes")
    return tuple(f"{text[0].upper()}{text[1:]}." for text in texts)


def validity(identified: Identified) -> tuple[str, ...]:
    flown = [n for n in identified.signals if n in identified.flown]
    if not flown:
        return ("The flown region is not stated: the values are a card's, or of an earlier version's result.",)
    parts = (f"{n} {identified.flown[n][0]:.4g} to {identified.flown[n][1]:.4g} {unit(n)}".rstrip(" 1") for n in flown)
    return (f"Flown region; outside it the model extrapolates: {', '.join(parts)}.",)


def states(identified: Identified) -> tuple[str, ...]:
    texts = []
    if identified.lagged:
        points = ", ".join(identified.points)
        texts.append(f"State {points}: the separation point (1 attached), lag dX/dt = X_static - X, first X_static.")
    elif identified.separates:
        texts.append(f"{', '.join(identified.points)}: the separation point (1 attached, 0 separated), without lag.")
    before = (Stage.INCIDENCE, Stage.SEPARATION)
    reading = [e for e in identified.exported.acting if "alpha_dot" in e.channels]
    if any(e.stage not in before or not identified.lagged for e in reading):
        texts.append(
            "The coefficients and alpha_dot depend on each other: a simulator solves for it, or lags alpha_dot."
        )
    return tuple(texts)


def about(identified: Identified) -> tuple[str, ...]:
    floors = [f"{n} below {LEAST[n]:g} {unit(n)}" for n in identified.program.inputs_of("signal") if n in LEAST]
    finite = (f"Coefficients are finite at rest: {' and '.join(floors)} counts as that value.",) if floors else ()
    drawn, uncertain = identified.draws, ()
    if drawn is not None:
        uncertain = (f"{len(drawn.values)} draws of {len(drawn.names)} parameters: {drawn.origin}.",)
    title = f"{identified.title}. Exported by bayes_aero {__version__}."
    general = (title, *identified.sources, *CONVENTIONS, *lengths(identified), *states(identified))
    return tuple(map(plain_line, (*general, *validity(identified), *finite, *uncertain, *identified.left_out)))


def unit(channel: str) -> str:
    """The SI unit of a channel; empty where the program does not know it."""
    return STANDARD_CHANNELS[channel].unit if channel in STANDARD_CHANNELS else ""


def meaning(channel: str) -> str:
    return STANDARD_CHANNELS[channel].description if channel in STANDARD_CHANNELS else "input of an effect"
