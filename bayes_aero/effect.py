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
from typing import Any, NamedTuple

from jaxtyping import Float

from bayes_aero.arrays import AnyArray, xp
from bayes_aero.parameter import Length, Lengths, Parameter, Prior, Role
from bayes_aero.physics.aircraft import COEFFICIENTS, LATERAL, NAMES, Aircraft, Axis
from bayes_aero.physics.kinematics import reduced, reduced_lateral, speed_ratio

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

    @cached_property
    def delays(self) -> bool:
        """Whether it corrects a delay of a channel."""
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
    prior: Prior | float,
    sizes: tuple[float, float],
    bounds: tuple[float, float] = (-math.inf, math.inf),
    **fields: Any,
) -> tuple[Parameter, tuple[float, float]]:
    """A parameter of `effect`, and its sizes; see `Parameter` and `Effect`. A number as prior is the standard deviation
    about zero. Unless stated, neutral is zero; estimation starts where a normal or lognormal prior lies, else there."""
    prior = prior if isinstance(prior, Prior) else Prior("normal", 0.0, prior)
    fields = {"neutral": 0.0} | fields
    fields = {"start": prior.location if prior.family in ("normal", "lognormal") else fields["neutral"]} | fields
    return Parameter(name, unit, description=description, prior=prior, bounds=bounds, **fields), sizes


def effect(
    name: str,
    claim: str,
    formula: str,
    increments: Callable[[Values, Signals, Aircraft, Known], Increments],
    *parameters: tuple[Parameter, tuple[float, float]],
    example: Example,
    **fields: Any,
) -> Effect:
    """An effect as one entry of a table (see `Effect`); it needs the signals and uses the parameters of its example."""
    sizes = {p.name: size for p, size in parameters}
    fields = {"kind": Kind.AERODYNAMICS, "stage": Stage.ATTACHED} | fields
    fields.setdefault("channels", tuple(n for n in example.signals if n not in MARKS))
    return Effect(
        name=name, claim=claim, formula=formula, increments=increments, parameters=tuple(p for p, _ in parameters),
        example=example, uses=tuple(n for n in example.parameters if n not in sizes), sizes=sizes, **fields,
    )  # fmt: skip


# --- Aerodynamic derivatives: linear in what they multiply.

DERIVATIVE = "a linear aerodynamic derivative; textbook form"
SEPARATED_SHARE = "derivative linear in the separated share 1 - X; our choice of form"
STALL_MODEL = "Jategaonkar 2015, ch. 12, Kirchhoff stall model"


class Regressor(NamedTuple):
    """What a derivative multiplies: how formulas write it, its signals, the product with a coefficient, how the worked
    example writes the numbers (the last signal of a rate is the airspeed), what the formula says of it, and the unit
    and the reference lengths of its coefficient."""

    symbol: str
    signals: tuple[str, ...]
    times: Callable[[Any, Signals, Aircraft], Any]
    by_hand: str = "{0:g} x {1:g}, by hand"
    remark: str = ""
    unit: str = "1/rad"
    lengths: tuple[Length, ...] = ()


def _deflection(symbol: str, channel: str) -> Regressor:
    return Regressor(symbol, (channel,), lambda c, s, _: c * s[channel], unit="1" if channel == "mach" else "1/rad")


def _rate(symbol: str, channel: str, per: Callable[..., Any], by_hand: str, length: Length) -> Regressor:
    return Regressor(
        symbol, (channel, "airspeed"), lambda c, s, a: per(c * s[channel], s["airspeed"], a),
        f"{{0:g}} x {{1:g}} x {by_hand}", f"; length and speed as `{per.__name__}` has them", "1", (length,),
    )  # fmt: skip


def _of_sides(surface: str, left: float, symbol: str, by_hand: str) -> Regressor:
    names = f"{surface}_left", f"{surface}_right"
    return Regressor(symbol, names, lambda c, s, _: c * 0.5 * (s[names[1]] + left * s[names[0]]), by_hand)


SYMBOLS = {
    "alpha": "alpha", "beta": "beta", "mach": "Mach", "elevator": "de", "stabilizer": "ih", "canard": "canard",
    "flap": "flap", "aileron": "da", "rudder": "dr",
}  # fmt: skip
HALF_SPAN = "10/{2:g}, by hand, half span 10 m"
MEAN = "(left + right)/2", "{0:g} x ({1:g} + {2:g})/2, by hand"
REGRESSORS = {
    "1": Regressor("", ("alpha",), lambda c, s, _: c + xp.zeros_like(s["alpha"]), "by definition", unit="1"),
    **{channel: _deflection(symbol, channel) for channel, symbol in SYMBOLS.items()},
    **{n: _rate(f"{n} c/V", n, reduced, "3/{2:g}, by hand, chord 3 m", Length.RATE) for n in ("q", "alpha_dot")},
    **{n: _rate(f"{n} b/2V", n, reduced_lateral, HALF_SPAN, Length.LATERAL_RATE) for n in ("p", "r")},
    "dlc": _of_sides("dlc", 1.0, *MEAN),
    "spoilers": _of_sides("spoiler", 1.0, *MEAN),
    "spoiler difference": _of_sides("spoiler", -1.0, "(right - left)/2", "{0:g} x ({2:g} - {1:g})/2, by hand"),
    "alpha beta": Regressor(
        "alpha beta", ("alpha", "beta"), lambda c, s, _: c * s["alpha"] * s["beta"], "{0:g} x {1:g} x {2:g}, by hand",
        unit="1/rad^2",
    ),
    "beta^2": Regressor(
        "beta^2", ("beta",), lambda c, s, _: c * s["beta"] * s["beta"], "{0:g} x ({1:g})^2, by hand",
        ": even in beta, for the aircraft is symmetric", "1/rad^2",
    ),
    "beta^3": Regressor(
        "beta^3", ("beta",), lambda c, s, _: c * s["beta"] * s["beta"] * s["beta"], "{0:g} x ({1:g})^3, by hand",
        ": odd in beta, for the aircraft is symmetric", "1/rad^3",
    ),
    "speed": Regressor(
        "V/V0", ("airspeed",), lambda c, s, a: c * speed_ratio(s["airspeed"], a),
        "{0:g} x {1:g}/100, by hand, V0 100 m/s",
        "; V0 is the card's reference_speed, or 100 m/s where the card names none. A stand-in, at one altitude, for "
        "Mach number, thrust and elasticity alike, so diagnosis never proposes it", "1",
    ),
}  # fmt: skip
FIELDS_OF_PARAMETER = ("unit", "start", "bounds", "sign", "limits", "place")


def derivative(
    name: str, claim: str, output: str, by: str, row: tuple[str, str, Any, Any], example: tuple[float, ...], **more: Any
) -> Effect:
    """`output` += parameter (`row`: name, description, prior, sizes) x regressor (`by`); x (1 - X) where `separated`: X
    of the example, as it is written. `example`: value of the parameter, of each signal and of the output. `remark`:
    more of the formula. Other fields are those of the parameter or of the effect."""
    (coefficient, text, prior, sizes), r = row, REGRESSORS[by]
    value, *signals, result = example
    by_hand, symbol, separation = r.by_hand.format(*example), r.symbol, None
    separated, remark = more.pop("separated", ""), more.pop("remark", "")
    fields = {"source": DERIVATIVE, "together": by in ("dlc", "spoilers", "spoiler difference")}
    if separated:
        above, _, below = separated.partition("/")
        separation = {"X": float(above) / float(below or 1)}
        share = f" x (1 - {separated})"
        by_hand = f"{value:g}{share}, by hand" if by == "1" else by_hand.replace(" x ", f"{share} x ", 1)
        symbol, fields = f"(1 - X) {symbol}", fields | {"source": SEPARATED_SHARE, "stage": Stage.TOTAL}
    of_parameter: dict[str, Any] = {key: more.pop(key) for key in FIELDS_OF_PARAMETER if key in more}
    unit, moment = of_parameter.pop("unit", r.unit), (Length.LATERAL_MOMENT,) if output in ("Cl", "Cn") else ()
    given = dict(zip(r.signals, signals, strict=True))
    return effect(
        name,
        claim,
        f"{output} += {coefficient} {symbol}".rstrip() + f"{remark}{r.remark}.",
        lambda v, s, a, flow: {
            output: r.times(v[coefficient] * (1.0 - flow["X"]) if separated else v[coefficient], s, a)
        },
        parameter(coefficient, unit, text, prior, sizes, lengths=(*moment, *r.lengths), **of_parameter),
        example=Example({coefficient: value}, given, {output: result}, by_hand, separation),
        **fields | more,
    )


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
        sentence = cls(text.format(", ".join(names)))
        sentence.text, sentence.names = text, tuple(names)
        return sentence
