"""The model: a list of effects, the values held fixed, and the coefficients they give."""

from __future__ import annotations

import math
import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from difflib import get_close_matches
from functools import cached_property, lru_cache
from operator import add
from pathlib import Path
from types import ModuleType
from typing import Any

from jaxtyping import Float

from bayes_aero.arrays import AnyArray, namespace, xp
from bayes_aero.effect import NEUTRAL_FLOW, WINGS, Disturbance, Effect, Known, Stage
from bayes_aero.effects import CATALOGUE
from bayes_aero.errors import InputError
from bayes_aero.flight.card import Card
from bayes_aero.parameter import USUAL, Lengths, Parameter, Role, per_length
from bayes_aero.physics.aircraft import Aircraft, Axis, coefficients_of

Signals = Mapping[str, Float[AnyArray, "*#n"]]


@dataclass(frozen=True)
class Model:
    """A list of effects with their parameters.

    `fixed` parameters keep their value, the others are free. `lengths` convert the defaults of parameters to the card's
    reference lengths. `axes` say which coefficients it has. Hashable and without arrays, so it is static under
    `jax.jit`.
    """

    effects: tuple[Effect, ...]
    parameters: tuple[Parameter, ...]
    fixed: tuple[tuple[str, float], ...] = ()
    lengths: Lengths = USUAL
    axes: tuple[Axis, ...] = (Axis.LONGITUDINAL,)

    def __hash__(self) -> int:  # hashed on every call of a compiled function; the parts are many and immutable
        return self._hash

    @cached_property
    def _hash(self) -> int:
        return hash((self.effects, self.parameters, self.fixed, self.axes))

    @classmethod
    def of(
        cls,
        effects: Iterable[str | Effect],
        fixed: Mapping[str, float] | None = None,
        axes: Iterable[Axis] = (Axis.LONGITUDINAL,),
    ) -> Model:
        """Make a model.

        Args:
            effects: effects, or their names in the catalogue.
            fixed: values of parameters that are not fitted, in SI and radians.
            axes: which coefficients the model has.

        Raises:
            InputError: an effect or a parameter is unknown, two effects own the same parameter, or an effect adds to
                none of the model's coefficients.
        """
        axes = tuple(axes)
        chosen = tuple(e if isinstance(e, Effect) else effect_named(e) for e in effects)
        parameters = tuple(p for effect in chosen for p in effect.parameters)
        names = [p.name for p in parameters]
        for name in names:
            if names.count(name) > 1:
                raise InputError(f"two effects of the model own the parameter {name}; keep one of them")
        for effect in chosen:
            for name in effect.uses:
                if name not in names:
                    owners = " or ".join(e.name for e in CATALOGUE.values() if name in {p.name for p in e.parameters})
                    remedy = f"; add {owners} to the effects" if owners else ""
                    raise InputError(f"effect {effect.name} uses {name}, which no effect of the model owns{remedy}")
            if not effect.acts_on(axes):
                raise InputError(
                    f"effect {effect.name} acts on {', '.join(effect.example.increments)} of the "
                    f"{' and '.join(effect.axes)} axis, which the model lacks; remove it, or add "
                    f'"{effect.axes[0]}" to the axes ({", ".join(axes)})'
                )
        for name in fixed or {}:
            if name not in names:
                raise InputError(f"the fixed parameter {name} belongs to no effect of the model")
        return cls(chosen, parameters, tuple((fixed or {}).items()), axes=axes)

    @classmethod
    def from_card(cls, card: Card) -> Model:
        """Make the model of a card, with its starts, bounds and priors.

        Raises:
            InputError: the card has a linear system, or an effect or a parameter is unknown.
        """
        if card.linear is not None:
            raise InputError(f"card {card.name} states a linear system, which has no effects; use one with [model]")
        user_effects = own_effects(card.effect_files)
        try:
            model = cls.of([user_effects.get(name, name) for name in card.effects], card.fixed, card.axes)
        except InputError as reason:
            raise InputError(f"card {card.name}, [model]: {reason}") from None
        for name in card.changes:
            if name not in {p.name for p in model.parameters}:
                raise InputError(f"card {card.name}: [parameters.{name}] belongs to no effect of the model")
        lengths = lengths_of(card.aircraft)
        parameters = tuple(as_on_card(per_length(p, lengths), card) for p in model.parameters)
        return replace(model, parameters=parameters, lengths=lengths)

    def extended(self, *effects: str | Effect, fixed: Mapping[str, float] | None = None) -> Model:
        """This model with further effects; present parameters keep their starts, bounds and priors.

        Args:
            effects: effects, or their names in the catalogue.
            fixed: values of parameters that are not fitted, in SI and radians.

        Raises:
            InputError: an effect or a parameter is unknown.
        """
        present = {p.name: p for p in self.parameters}
        wider = Model.of((*self.effects, *effects), dict(self.fixed) | dict(fixed or {}), self.axes)
        parameters = tuple(present.get(p.name, per_length(p, self.lengths)) for p in wider.parameters)
        return replace(wider, parameters=parameters, lengths=self.lengths)

    @cached_property
    def free(self) -> tuple[Parameter, ...]:
        """The free parameters, in the order of every parameter vector."""
        fixed = dict(self.fixed)
        return tuple(p for p in self.parameters if p.name not in fixed)

    @cached_property
    def coefficients(self) -> tuple[str, ...]:
        """Names of the coefficients that it has: CL, CD, Cm of the longitudinal axis, CY, Cl, Cn of the lateral one."""
        return coefficients_of(self.axes)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the free parameters."""
        return tuple(p.name for p in self.free)

    @cached_property
    def places(self) -> dict[str, int]:
        """Index of each free parameter in a parameter vector."""
        return {name: index for index, name in enumerate(self.names)}

    @cached_property
    def acting(self) -> tuple[Effect, ...]:
        """Effects on the model's axes that are not fixed at neutral; those need not be computed."""
        fixed = dict(self.fixed)
        on_axes = (e for e in self.effects if e.acts_on(self.axes))
        return tuple(e for e in on_axes if not (e.parameters and e.absent_in(fixed)))

    def with_role(self, role: Role) -> tuple[str, ...]:
        """Names of the parameters with a role, of effects that act."""
        return tuple(p.name for effect in self.acting for p in effect.parameters if p.role is role)

    @cached_property
    def disturbances(self) -> tuple[Disturbance, ...]:
        """Random processes of the effects that act."""
        return tuple(e.disturbance for e in self.acting if e.disturbance is not None)

    @property
    def has_buffet(self) -> bool:
        """Whether a random process disturbs the forces (buffet)."""
        return any(e.disturbance is not None and e.stage > Stage.INFLOW for e in self.acting)

    @cached_property
    def two_wings(self) -> bool:
        """Whether an effect gives the right and the left wing different incidences."""
        return any(WINGS[0] in e.example.increments for e in self.acting)

    def break_angle(self, values: Mapping[str, Any]) -> float:
        """Angle of attack at which the flow separates, rad: infinite if it never does; the smallest of several."""
        return min((float(values[name]) for name in self.with_role(Role.BREAK_ANGLE)), default=math.inf)

    def lag(self, values: Mapping[str, Any]) -> Any:
        """Time constant of the separation point, chords travelled: 0 without a lag; those of several lags add."""
        return sum((values[name] for name in self.with_role(Role.LAG)), 0.0)

    @property
    def channels(self) -> tuple[str, ...]:
        """Channels that the effects need."""
        return tuple(dict.fromkeys(c for effect in self.effects for c in effect.channels))

    def values(self, theta: Float[AnyArray, " k"]) -> dict[str, Any]:
        """All parameter values by name, from the vector of the free ones."""
        return dict(self.fixed) | dict(zip(self.names, namespace(theta).unstack(theta), strict=True))

    def corrected(self, values: Mapping[str, Any], channels: Mapping[str, Any], aircraft: Aircraft) -> dict[str, Any]:
        """Recorded channels (whole manoeuvres end to end, with the marks of `Stage`) corrected for sensor errors."""
        # Delays first; then each other effect reads the channels without delays, and all corrections are added. Added
        # to a delay, a scale of the delayed channel would make a filter of two taps, which smooths. A scale and a bias
        # of one channel commute to first order. A bias of a rate and the position of a vane, whose angle depends on
        # that rate, do, too.
        in_time = self.in_time(values, channels, aircraft)
        return self._run((Stage.CHANNEL,), in_time, values, in_time, aircraft, delays=False)

    def in_time(self, values: Mapping[str, Any], channels: Mapping[str, Any], aircraft: Aircraft) -> dict[str, Any]:
        """Recorded channels corrected for delays alone."""
        return self._run((Stage.CHANNEL,), channels, values, channels, aircraft, delays=True)

    def actual_aircraft(self, values: Mapping[str, Any], aircraft: Aircraft) -> Aircraft:
        """The card's aircraft with the increments of all effects of stage AIRCRAFT; positions add by coordinates."""
        card = {f.name: getattr(aircraft, f.name) for f in fields(aircraft)}
        return Aircraft(**self._run((Stage.AIRCRAFT,), card, values, {}, aircraft))

    def inflow(self, values: Mapping[str, Any], signals: Signals, aircraft: Aircraft) -> dict[str, Any]:
        """Angles and `airspeed` of the flow, from those over ground and the gusts among `signals`: stage INFLOW."""
        over_ground = {name: signals[name] for name in ("alpha", "beta", "airspeed") if name in signals}
        return self._run((Stage.INFLOW,), over_ground, values, signals, aircraft)

    def static_separation(self, values: Mapping[str, Any], signals: Signals, aircraft: Aircraft) -> Any:
        """The separation point of a steady flow, without lag; the mean of two wings."""
        return self._separated((Stage.SEPARATION,), values, signals, aircraft)["X"]

    def static_points(self, values: Mapping[str, Any], signals: Signals, aircraft: Aircraft) -> tuple[Any, ...]:
        """Separation points of a steady flow: one, or those of the right and the left wing."""
        flow = self._separated((Stage.SEPARATION,), values, signals, aircraft)
        half = flow["X_difference"] / 2.0
        return (flow["X"] + half, flow["X"] - half) if self.two_wings else (flow["X"],)

    def attached(self, values: Mapping[str, Any], signals: Signals, aircraft: Aircraft) -> dict[str, Any]:
        """`CL_attached`, CD and Cm of the effects of stage ATTACHED alone."""
        return self._run((Stage.ATTACHED,), self._neutral(signals), values, signals, aircraft)

    def flow(
        self,
        values: Mapping[str, Any],
        signals: Signals,
        aircraft: Aircraft,
        X: Float[AnyArray, "*#n"] | tuple[Float[AnyArray, "*#n"], Float[AnyArray, "*#n"]] | None = None,
    ) -> dict[str, Any]:
        """The flow by all effects: X, the attached lift, the coefficients (see `effect.Known`)."""
        # `X` is given where it is a state of a simulation, and replaces the stages that compute it. With two wings it
        # has the values of the right and the left wing, or is their mean; their difference is then the static one.
        if X is None:
            flow = self._separated((Stage.SEPARATION, Stage.LAG), values, signals, aircraft)
        elif isinstance(X, tuple):
            flow = self._neutral(signals) | {"X": (X[0] + X[1]) / 2.0, "X_difference": X[0] - X[1]}
        elif not self.two_wings:
            flow = self._neutral(signals) | {"X": X}
        else:
            flow = self._separated((Stage.SEPARATION,), values, signals, aircraft) | {"X": X}
        flow = self._run((Stage.ATTACHED,), flow, values, signals, aircraft)
        flow["CL"] = flow["CL"] + flow["CL_attached"]
        return self._run((Stage.TOTAL,), flow, values, signals, aircraft)

    def _separated(
        self, stages: tuple[Stage, ...], values: Mapping[str, Any], signals: Signals, aircraft: Aircraft
    ) -> dict[str, Any]:
        """The flow after these stages of separation; with two wings X is the mean of both at their own incidence."""
        flow = self._run((Stage.INCIDENCE,), self._neutral(signals), values, signals, aircraft)
        if not self.two_wings:
            return self._run(stages, flow, values, signals, aircraft)
        half = flow["incidence_difference"] / 2.0
        right, left = (
            self._run(stages, flow | {"incidence": flow["incidence"] + side}, values, signals, aircraft)["X"]
            for side in (half, -half)
        )
        return flow | {"X": (right + left) / 2.0, "X_difference": right - left}

    def _neutral(self, signals: Signals) -> dict[str, Any]:
        zeros = xp.zeros_like(signals["alpha"])
        return {key: zeros + value for key, value in NEUTRAL_FLOW.items()} | {"incidence": signals["alpha"]}

    def _run(
        self,
        stages: tuple[Stage, ...],
        known: Known,
        values: Mapping[str, Any],
        signals: Mapping[str, Any],
        aircraft: Aircraft,
        delays: bool | None = None,
    ) -> dict[str, Any]:
        """`known` and the increments of these stages; `delays`: of delays alone, or of all others (None: of both)."""
        total = dict(known)
        for stage in stages:
            before = dict(total)
            for effect in self.acting:
                if effect.stage is stage and delays in (None, effect.delays):
                    for key, increment in effect.increments(values, signals, aircraft, before).items():
                        old = total[key]  # positions are tuples, which add by coordinates
                        total[key] = tuple(map(add, old, increment)) if isinstance(old, tuple) else old + increment
        return total

    def predicted(self, theta: Float[AnyArray, " k"], signals: Signals, aircraft: Aircraft) -> Float[AnyArray, "*n c"]:
        """Its `coefficients`, (n, c), from the free parameters in the order of `names` and channels (n,), SI."""
        flow = self.flow(self.values(theta), signals, aircraft)
        return namespace(flow["CL"]).stack([flow[name] for name in self.coefficients], axis=-1)


# --- Effects and parameters as a card or a caller chooses them.

TRANSPORT_SPAN = 21.5  # m, of the transport of some 20 t for which `effects` states sizes


def lengths_of(a: Aircraft) -> Lengths:
    """How often the card's reference lengths go into chord, half span and span."""
    given = (a.chord, a.rate_length), (a.half_span, a.lateral_rate_length), (2.0 * a.half_span, a.lateral_length)
    span = 2.0 * float(a.half_span) / TRANSPORT_SPAN
    rate, lateral_rate, moment = (1.0 if length is None else float(usual) / float(length) for usual, length in given)
    return Lengths(rate, lateral_rate, moment, span if math.isfinite(span) else 1.0)


def effect_named(name: str, among: Mapping[str, Effect] = CATALOGUE) -> Effect:
    """An effect of the catalogue by name; `InputError` with a similar name where there is none."""
    if name in among:
        return among[name]
    close = get_close_matches(name, among, n=3, cutoff=0.5)
    hint = f"did you mean {' or '.join(close)}?" if close else "bayes-aero effects lists them all"
    raise InputError(f"there is no effect {name!r}; {hint}")


def as_on_card(parameter: Parameter, card: Card) -> Parameter:
    """A parameter with the start, bounds and prior that a card states."""
    change = card.changes.get(parameter.name)
    if change is None:
        return parameter
    given = {key: value for key, value in vars(change).items() if value is not None}
    try:
        return parameter.changed(**given)
    except InputError as error:
        raise InputError(f"card {card.name}: {error}") from None


# --- A user's own effects: Python files that a card names.

MAX_BYTES = 1 << 20


def own_effects(files: Sequence[Path]) -> dict[str, Effect]:
    """Every `Effect` at the top level of `files`, by name."""
    # The files are Python code and are run. A card given by its path is trusted; a study needs --trust-effects. Each
    # content is run once, so that an effect is always the same object and its compiled programs are used again.
    effects: dict[str, Effect] = {}
    for path in files:
        try:
            if not path.is_file():
                raise FileNotFoundError("there is no such file")
            if path.stat().st_size > MAX_BYTES:
                raise ValueError(f"it has more than {MAX_BYTES} bytes")
            text = path.read_text(encoding="utf-8")
        except (OSError, ValueError) as error:
            raise InputError(f"effect file {path} cannot be read ({error}); mend the path on the card") from None
        for effect in _run(path, text):
            if effect.name in CATALOGUE or effect.name in effects:
                raise InputError(f"effect file {path}: the name {effect.name} is taken; give the effect another one")
            others = (*CATALOGUE.values(), *effects.values())
            taken = {p.name for e in others for p in e.parameters} & {p.name for p in effect.parameters}
            if taken:
                raise InputError(
                    f"effect file {path}: the parameter {', '.join(sorted(taken))} of {effect.name} belongs to another "
                    "effect; give it another name"
                )
            effects[effect.name] = effect
    return effects


@lru_cache(maxsize=32)
def _run(path: Path, text: str) -> tuple[Effect, ...]:
    module = ModuleType(f"own_effects_{path.stem}_{abs(hash((path, text))):x}")
    module.__file__ = str(path)
    sys.modules[module.__name__] = module  # dataclasses look their module up there
    try:
        exec(compile(text, str(path), "exec"), module.__dict__)
    except (Exception, SystemExit) as error:  # whatever a user's code may raise
        del sys.modules[module.__name__]
        raise InputError(f"effect file {path} does not run: {type(error).__name__}: {error}") from None
    defined = (value for value in vars(module).values() if isinstance(value, Effect))
    effects = tuple(e for e in defined if e is not CATALOGUE.get(e.name))  # built-in ones may be imported
    if not effects:
        raise InputError(f"effect file {path} defines no Effect at its top level; see bayes_aero/effects for examples")
    return tuple(dict.fromkeys(effects))
