"""What a model is fitted to: recorded channels as JAX arrays, conditioned signals and measured coefficients."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import fields, replace
from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from bayes_aero.effect import MARKS, Stage
from bayes_aero.errors import InputError
from bayes_aero.flight.card import Card
from bayes_aero.flight.reading import at_common_rate
from bayes_aero.flight.record import FlightRecord
from bayes_aero.model.model import Model
from bayes_aero.model.records import Flights, Forming, joined, named_apart, plain_marks, without_spikes
from bayes_aero.physics.aircraft import NAMES, Aircraft, required_of
from bayes_aero.physics.coefficients import alike_joined, condition_joined, stacked_coefficients
from bayes_aero.physics.filters import FILTER_STEP

# --- Plain classes that are pytrees of compiled programs.


def _register(kind: type, static: Collection[str] = ()) -> None:
    names = [field.name for field in fields(kind) if field.name not in static]

    def parts(whole: Any) -> tuple[list[tuple[Any, Any]], tuple[Any, ...]]:
        leaves = [(jax.tree_util.GetAttrKey(name), getattr(whole, name)) for name in names]
        return leaves, tuple(getattr(whole, name) for name in static)

    def whole(known: tuple[Any, ...], leaves: Any) -> Any:
        """Without the constructor's checks, because JAX replaces numbers by tracers."""
        made = object.__new__(kind)
        for name, part in zip((*names, *static), (*leaves, *known), strict=True):
            object.__setattr__(made, name, part)
        return made

    jax.tree_util.register_pytree_with_keys(kind, parts, whole)


_register(Aircraft)
_register(Flights, ("lengths", "names", "held"))


# --- Recorded channels of several manoeuvres, end to end, as JAX arrays, for effects that act on the record.


def response_scales(
    model: Model, values: Mapping[str, Any], channels: Mapping[str, Array], aircraft: Aircraft, names: Sequence[str]
) -> dict[str, Array]:
    """Derivative of each corrected channel of `names` with respect to the recorded channel."""

    def correct(name, series):
        return model.corrected(values, {**channels, name: series}, aircraft)[name]

    # One channel at a time: the influence of other channels (pitch rate on the vane's angle) does not count.
    series_by_name = {name: channels[name] for name in names if name in channels}
    return {name: jax.jvp(partial(correct, name), (x,), (jnp.ones_like(x),))[1] for name, x in series_by_name.items()}


def join(records: Sequence[FlightRecord], card: Card, *required: Any) -> Flights:
    """`joined`, for compiled programs."""
    flights = joined(records, card, *required)
    return replace(flights, channels={name: jnp.asarray(x) for name, x in flights.channels.items()})


def despiked(flights: Flights) -> tuple[Flights, dict[str, int]]:
    """The manoeuvres without spikes, and the number of replaced samples by channel; see `without_spikes`."""
    channels, count = without_spikes(flights.channels, flights.lengths)
    mended = {name: jnp.asarray(channels[name]) if name in count else x for name, x in flights.channels.items()}
    return replace(flights, channels=mended), count


# --- What a model is fitted to: conditioned signals and measured coefficients of one or more manoeuvres.

STEADY = ', or state it under [constants] (p = "0 deg/s", r = "0 deg/s") if the wings were level throughout'


class Observations(eqx.Module):
    """Samples of all manoeuvres laid end to end."""

    signals: dict[str, Array]
    measured: Float[Array, "n c"]  # the named `coefficients`
    # Manoeuvres are independent: filtered one by one, lags and coloured noise start again where `start` is true.
    start: Bool[Array, " n"]
    manoeuvre: Int[np.ndarray, " n"]
    time: Float[np.ndarray, " n"]
    aircraft: Aircraft
    names: tuple[str, ...] = eqx.field(static=True)
    coefficients: tuple[str, ...] = eqx.field(static=True, default=NAMES)

    @property
    def n(self) -> int:
        return self.measured.shape[0]

    @property
    def dt(self) -> float:
        return float(np.median(np.asarray(self.signals["dt"])))

    @property
    def nameless(self) -> Observations:
        """The same without names, on which no number depends: compiled programs then serve records of any name."""
        return replace(self, names=())

    def subset(self, index: Int[np.ndarray, " m"]) -> Observations:
        """The samples `index`, in time order; one whose predecessor was left out starts a new stretch."""
        # No lag and no noise correlation is carried over a hole.
        index = np.sort(np.asarray(index))
        begins = np.asarray(self.start)[index] | np.concatenate([[True], np.diff(index) > 1])
        return replace(
            self,
            signals={k: v[index] for k, v in self.signals.items()} | {"start": jnp.asarray(begins)},
            measured=self.measured[index],
            start=jnp.asarray(begins),
            manoeuvre=self.manoeuvre[index],
            time=self.time[index],
        )

    def restarted(self, start: Bool[np.ndarray, " n"]) -> Observations:
        """The same samples with other marks of where lags and coloured noise start again."""
        flags = jnp.asarray(start)
        return eqx.tree_at(lambda o: (o.start, o.signals["start"]), self, (flags, flags))

    def thinned(self, step: int = FILTER_STEP) -> Observations:
        """Every `step`-th sample of each stretch, as a record of that lower rate (`dt` grows accordingly)."""
        begins = np.flatnonzero(np.asarray(self.start))
        ends = np.append(begins[1:], self.n)
        index = np.concatenate([np.arange(begin, end, step) for begin, end in zip(begins, ends, strict=True)])
        fewer = self.subset(index).restarted(np.asarray(self.start)[index])
        return eqx.tree_at(lambda o: o.signals["dt"], fewer, step * fewer.signals["dt"])

    def only(self, manoeuvre: int) -> Observations:
        return self.subset(np.flatnonzero(self.manoeuvre == manoeuvre))

    def with_measured(self, measured: Float[Array, "n c"]) -> Observations:
        return eqx.tree_at(lambda o: o.measured, self, jnp.asarray(measured))


def marks(n: int, dt: float, first: int = 0) -> dict[str, Array]:
    """Marks for effects of stage CHANNEL of one manoeuvre of `n` samples, the first at index `first`."""
    return {name: jnp.asarray(values) for name, values in plain_marks(n, dt, first).items()}


def observe(
    records: Sequence[FlightRecord], card: Card, model: Model, forming: Forming = Forming.MATCHED
) -> Observations:
    """Reconstruct the coefficients of every record, one a manoeuvre, and lay the manoeuvres end to end."""
    # Effects that act on the record or the aircraft itself are applied at the values the model fixes for them.
    if not records:
        raise InputError("there is no flight record to work on; name at least one file")
    named_apart(records)
    forming = Forming(forming)
    if forming is Forming.MATCHED:
        records = at_common_rate(records)
    values = dict(model.fixed)
    for effect in model.effects:
        free = [p.name for p in effect.parameters if p.name not in values]
        if effect.stage <= Stage.AIRCRAFT and free:
            raise InputError(
                f"effect {effect.name} changes the record or the aircraft itself, so {', '.join(free)} cannot be "
                "fitted to the coefficients; fix it on the card, or use bayes-aero diagnose to estimate it"
            )
    aircraft = model.actual_aircraft(values, card.aircraft)

    def remedy(need: str) -> str:
        return f"{need}, which the model needs; map it on the card{STEADY if need in ('p', 'r') else ''}"

    required = dict.fromkeys((*required_of(model.axes), *model.channels))
    flights = join(records, card, [need for need in required if need != "alpha_dot"], remedy)
    recorded = {key: flights.channels[key] for key in flights.recorded}
    marks_by_name = {key: flights.channels[key] for key in MARKS}
    signals, measured = _formed(model, forming, values, recorded, marks_by_name, aircraft)
    return Observations(
        signals=dict(sorted((signals | {key: marks_by_name[key] for key in ("dt", "start")}).items())),
        measured=measured,
        start=marks_by_name["start"],
        manoeuvre=flights.manoeuvre,
        time=flights.time,
        aircraft=aircraft,
        names=flights.names,
        coefficients=model.coefficients,
    )


@eqx.filter_jit
def _formed(
    model: Model,
    forming: Forming,
    values: Mapping[str, Any],
    joined: Mapping[str, Array],
    marks_by_name: Mapping[str, Array],
    aircraft: Aircraft,
) -> tuple[dict[str, Array], Float[Array, "n c"]]:
    true = model.corrected(values, {**joined, **marks_by_name}, aircraft)
    channels, ends = {key: true[key] for key in joined}, [marks_by_name[key] for key in ("dt", "first", "last")]
    if forming is Forming.MATCHED:
        signals = alike_joined(channels, aircraft.accelerometer, *ends)
    else:
        signals = condition_joined(channels, *ends)
    return signals, stacked_coefficients(signals, aircraft, model.coefficients)
