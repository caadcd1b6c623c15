"""The effect: the contract of which a model consists.

A model is a list of effects. Every effect has, for each of its parameters, the neutral value at which it is absent, so
any list of effects can live in one compiled function with the absent ones held at neutral.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from enum import IntEnum, StrEnum
from functools import cache, cached_property
from typing import Any

from jaxtyping import Float

from bayes_aero.arrays import AnyArray
from bayes_aero.parameter import Lengths, Parameter, Prior, Role
from bayes_aero.physics.aircraft import COEFFICIENTS, LATERAL, NAMES, Aircraft, Axis

Values = Mapping[str, Any]
"""Parameter values by name."""

Signals = Mapping[str, Any]
"""Channels of the record and what is computed from them, by name."""

Known = Mapping[str, Any]
"""What the earlier stages have built: `incidence`, `X`, `CL_attached`, `CL`, `CD`, `Cm`, `CY`, `Cl`, `Cn`.

Where an effect adds to `incidence_difference` (right less left wing, rad), either wing has a separation point of its
own, X is their mean and `X_difference` the right less the left one.
"""

Increments = dict[str, Any]
"""What an effect adds to entries of `Known`."""


class Kind(StrEnum):
    """Where the cause lies."""

    AERODYNAMICS = "aerodynamics"
    PROPULSION = "propulsion"
    MASS = "mass"
    MEASUREMENT = "measurement"
    ENVIRONMENT = "environment"
    NOISE = "noise"


class Stage(IntEnum):
    """When an effect acts. An effect uses results of earlier stages, never of its own stage.

    CHANNEL effects get whole recorded channels (all manoeuvres end to end) as `signals` and return what to add to them
    to correct the record: a delay gets what was recorded, the others what is left of it without delays. `signals` also
    has `dt`, `start`, `elapsed` (s since the start of the manoeuvre), `first`, `last` (index of its first and last
    sample) and `mach_follows` (1 where an error of the airspeed is in the Mach number, too; else 0). AIRCRAFT effects
    return what to add to fields of the aircraft. INFLOW effects return what moving air adds to `alpha`, `beta` and
    `airspeed` of the flight over ground; a simulation alone asks them, for a record holds the flow itself. All other
    stages build `Known`, sample by sample. SEPARATION and LAG run once for either wing, at its own `incidence`, where
    an effect of INCIDENCE tells them apart.
    """

    CHANNEL = -1  # sensors, winds, thrust: errors of the record
    AIRCRAFT = 0  # mass properties: errors of the card
    INFLOW = 1  # motion of the air
    INCIDENCE = 2  # the angle of attack that acts on the separation point
    SEPARATION = 3  # the static separation point
    LAG = 4  # its dynamics
    ATTACHED = 5  # forces and moments of the attached flow
    TOTAL = 6  # what depends on separation or on the attached lift


WINGS = ("incidence_difference", "X_difference")
NEUTRAL_FLOW = {"X": 1.0, "CL_attached": 0.0} | dict.fromkeys((*WINGS, *NAMES, *LATERAL), 0.0)
"""Attached flow without forces: what `Known` holds before any effect acts (`incidence` starts as alpha)."""

_BESIDE = {Axis.LONGITUDINAL: ("CL_attached",), Axis.LATERAL: WINGS}
_OF_AXIS = {axis: {*names, *_BESIDE[axis]} for axis, names in COEFFICIENTS.items()}

MARKS = ("dt", "start", "elapsed", "first", "last", "mach_follows")
"""Signals of a CHANNEL or LAG effect that every record has: see `Stage`."""


@dataclass(frozen=True)
class Example:
    """A worked example: `parameters` and the `signals` of one sample give `increments`; `source` states its origin.

    A tuple stands for several samples of a signal, or for the three coordinates of a position.
    """

    parameters: Mapping[str, float]
    signals: Mapping[str, float | tuple[float, ...]]
    increments: Mapping[str, float | tuple[float, ...]]
    source: str
    known: Mapping[str, float] | None = None


@dataclass(frozen=True)
class Disturbance:
    """A random process of first order that disturbs the flight, x-dot = -rate x + white noise; a state of the filter.

    `state` names it and `unit` is its unit; the parameter `intensity` is its standard deviation. `rate(values, signals,
    aircraft)` is one over its correlation time, 1/s. The effect that it belongs to reads x among its signals.
    """

    state: str
    unit: str
    intensity: str
    rate: Callable[[Values, Mapping[str, Any], Aircraft], Any]


@dataclass(frozen=True, eq=False)
class Effect:
    """One physical cause. Two effects are equal only if they are the same object, so a model is hashable.

    `claim` is the sentence that a report prints with the effect. `increments(values, signals, aircraft,
    known)` is pure, works on one sample or on arrays of samples alike, and returns what to add to `known`; with every
    parameter at its neutral value each increment is exactly zero. `uses` names parameters that other effects own.
    `channels` are the signals it needs; a record without them makes the effect not testable.

    `sizes` gives for each parameter the smallest departure from neutral worth modelling and the largest plausible
    one (magnitudes, the parameter's unit; of its inverse where neutral is infinite). `scan` lists values of a
    parameter at which the effect is tried if its slope at neutral is zero or undefined (a lag, a break point).
    `together` states that the channels enter as one product or sum only, so the effect is testable wherever this
    product or sum moves: thrust over dynamic pressure, the mean of two spoilers.
    `candidate` states whether diagnosis may propose it; terms that replace others at one trim are for cards only.
    `disturbance`: the random process that it consists of, for a filter to follow; None for what is no noise.
    `axis`: the only axis on which it acts, where the coefficients that `example` adds to do not say so (see `axes`).
    `formula`: what `increments` adds, as people write it; where not given, the docstring of `increments`.
    """

    name: str
    kind: Kind
    stage: Stage
    claim: str
    parameters: tuple[Parameter, ...]
    channels: tuple[str, ...]
    increments: Callable[[Values, Mapping[str, Float[AnyArray, "*n"]], Aircraft, Known], Increments]
    example: Example
    source: str
    uses: tuple[str, ...] = ()
    sizes: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    scan: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    together: bool = False
    candidate: bool = True
    disturbance: Disturbance | None = None
    axis: Axis | None = None
    formula: str = ""

    def __post_init__(self) -> None:
        if not self.formula:
            object.__setattr__(self, "formula", (self.increments.__doc__ or "").strip())

    @cached_property
    def axes(self) -> tuple[Axis, ...]:
        """Axes on which it acts: that of the coefficients that it adds to, if it adds to nothing else; or all."""
        if self.axis is not None:
            return (self.axis,)
        if self.stage <= Stage.AIRCRAFT:
            return tuple(Axis)
        added = set(self.example.increments)
        return tuple(axis for axis, names in _OF_AXIS.items() if added <= names) or tuple(Axis)

    def acts_on(self, axes: Iterable[Axis]) -> bool:
        """Whether it acts on one of these axes: on no other model can it change a number."""
        return not set(self.axes).isdisjoint(axes)

    @property
    def neutral_values(self) -> dict[str, float]:
        """The neutral value of each parameter, by name."""
        return {p.name: p.neutral for p in self.parameters}

    @property
    def is_delay(self) -> bool:
        """Whether it is a delay of a channel."""
        return any(p.role is Role.DELAY for p in self.parameters)

    def absent_in(self, values: Values) -> bool:
        """Whether `values` has every parameter at its neutral value; values of other parameters do not matter."""
        return all(values.get(name) == x for name, x in self.neutral_values.items())


@cache
def sized(effect: Effect, card: Lengths) -> Effect:
    """The effect with its sizes in the reference lengths of a card; always the same object, for models are hashed."""
    span = card.span if effect.disturbance is None else 1.0  # gusts are no part of the aircraft
    times = {p.name: card.times(p) * (span if p.unit == "m" else 1.0) for p in effect.parameters}
    if all(x == 1.0 for x in times.values()):
        return effect
    return replace(effect, sizes={n: (times[n] * low, times[n] * high) for n, (low, high) in effect.sizes.items()})


def parameter(
    name: str,
    unit: str,
    description: str,
    prior: Prior,
    sizes: tuple[float, float],
    bounds: tuple[float, float] = (-math.inf, math.inf),
    *,
    neutral: float = 0.0,
    start: float | None = None,
    **fields: Any,
) -> tuple[Parameter, tuple[float, float]]:
    """A parameter of `effect`, and its sizes; see `Parameter` and `Effect`. It starts at neutral unless told."""
    start = neutral if start is None else start
    return Parameter(name, unit, neutral, start, description, prior, bounds, **fields), sizes


def effect(
    name: str,
    claim: str,
    formula: str,
    increments: Callable[[Values, Signals, Aircraft, Known], Increments],
    *parameters: tuple[Parameter, tuple[float, float]],
    example: Example,
    source: str,
    kind: Kind = Kind.AERODYNAMICS,
    stage: Stage = Stage.ATTACHED,
    channels: tuple[str, ...] | None = None,
    **fields: Any,
) -> Effect:
    """An effect as one entry of a table (see `Effect`); it needs the signals and uses the parameters of its example."""
    own = {p.name: sizes for p, sizes in parameters}
    return Effect(
        name, kind, stage, claim, tuple(p for p, _ in parameters),
        tuple(n for n in example.signals if n not in MARKS) if channels is None else channels, increments, example,
        source, uses=tuple(n for n in example.parameters if n not in own), sizes=own, formula=formula, **fields,
    )  # fmt: skip


class Untestable(str):
    """Why an effect is not testable, as `text` says of `names` (channels or parameters)."""

    NOT_RECORDED = "channel {} was not recorded"
    STILL = "channel {} does not move in this record"
    NOISE_ALONE = "channel {} shows nothing but noise in this record"
    LACKING = "the model has no {}"

    text: str
    names: tuple[str, ...]

    @classmethod
    def of(cls, text: str, names: Iterable[str]) -> Untestable:
        """The sentence."""
        found = cls(text.format(", ".join(names)))
        found.text, found.names = text, tuple(names)
        return found
