"""Effects injected into records that exist, on top of whatever these contain already."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np

from bayes_aero.diagnosis.candidate_set import DERIVED
from bayes_aero.effect import NEUTRAL_FLOW, Effect, Stage
from bayes_aero.effects import CATALOGUE
from bayes_aero.errors import InputError
from bayes_aero.flight.card.card import Card
from bayes_aero.flight.record import FlightRecord
from bayes_aero.model.derived_channels import with_sums
from bayes_aero.model.model import Model
from bayes_aero.model.observations import marks
from bayes_aero.physics.coefficients import condition_joined
from bayes_aero.simulate.sensor_faults import misrecorded

POSSIBLE = "only sensors, thrust and moments can be injected into a record"


def injected(
    records: Sequence[FlightRecord], effects: Mapping[str, Mapping[str, float]], card: Card, *, Cmde: float
) -> list[FlightRecord]:
    """The records as they would be if the aircraft had flown the same motion with `effects` (by name, values) in it.

    Sensor errors and thrust: what the faulty installation would have recorded of this flight. Effects on the pitching
    moment alone: the motion stays as it was if the pilot holds against them, so the elevator takes -dCm/Cmde, `Cmde`
    being its effectiveness, 1/rad; the lift of a force at the tail goes with it. Effects on lift or drag cannot be
    had without other motion, and are refused.
    """
    for name in effects:
        if name not in CATALOGUE:
            raise InputError(f"there is no effect {name!r} to inject; the catalogue has {', '.join(CATALOGUE)}")
    return [_one(record, effects, card, Cmde) for record in records]


def _one(record: FlightRecord, effects: Mapping[str, Mapping[str, float]], card: Card, Cmde: float) -> FlightRecord:
    given = {name: np.asarray(x) for name, x in with_sums(record, card).items()}
    channels = dict(given)
    dt = record.dt
    for name, values in effects.items():
        effect = CATALOGUE[name]
        missing = [c for c in effect.channels if c not in channels and c not in DERIVED]
        if missing:
            raise InputError(f"effect {name} needs channel {', '.join(missing)}, which {record.name} does not have")
        if effect.stage is Stage.CHANNEL:
            channels |= misrecorded(Model.of([effect]), values, channels, marks(record.n, dt), card.aircraft)
        else:
            moment = _moment(effect, values, channels, dt, card)
            channels["elevator"] = channels["elevator"] - moment / Cmde
    for name, parts in card.sums.items():
        channels |= _shared(parts, channels[name], {part: given[part] for part in parts})
    changed = {name for name in given if name not in card.sums and not np.array_equal(given[name], channels[name])}
    kept = {name: x for name, x in channels.items() if record.has(name) or name in changed}
    return FlightRecord.from_arrays(record.name, np.asarray(record.time), kept, f"{record.source}, effects injected")


def _shared(parts: Mapping[str, float], total: np.ndarray, given: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """A sum that was changed, shared among its parts: plain sums as it was shared, others by the parts' factors."""
    before = sum(factor * given[part] for part, factor in parts.items())
    if all(factor == 1.0 for factor in parts.values()):
        ratio = total / np.where(before == 0.0, 1.0, before)
        return {part: x * ratio for part, x in given.items()}
    square = sum(factor**2 for factor in parts.values())
    return {part: x + (total - before) * parts[part] / square for part, x in given.items()}


def _moment(
    effect: Effect, values: Mapping[str, float], channels: Mapping[str, np.ndarray], dt: float, card: Card
) -> np.ndarray:
    n = len(channels["alpha"])
    ends = jnp.full(n, dt), jnp.zeros(n, int), jnp.full(n, n - 1)
    signals = condition_joined({name: jnp.asarray(x) for name, x in channels.items()}, *ends)
    ones = jnp.ones(n)

    def increments(X: float) -> dict[str, Any]:
        known = {name: value * ones for name, value in NEUTRAL_FLOW.items()} | {"incidence": signals["alpha"]}
        found = effect.increments(values, signals, card.aircraft, known | {"X": X * ones})
        return {name: np.asarray(x) * np.ones(len(ones)) for name, x in found.items()}

    if effect.uses:
        raise InputError(
            f"effect {effect.name} rests on parameters of other effects ({', '.join(effect.uses)}); {POSSIBLE}"
        )
    if effect.stage < Stage.ATTACHED:
        raise InputError(f"effect {effect.name} changes the flow or the aircraft; {POSSIBLE}")
    found, apart = increments(1.0), increments(0.5)
    if any(not np.allclose(found[name], apart[name]) for name in found):
        raise InputError(f"effect {effect.name} depends on separation, which no record knows; {POSSIBLE}")
    moment = found.get("Cm", np.zeros(len(ones)))
    # A force at the tail is held by the elevator's, which acts there too: lift and moment vanish together.
    lift_of_tail = -moment * card.aircraft.chord / card.aircraft.tail_arm
    if not (set(found) <= {"Cm", "CL_attached"} and np.allclose(found.get("CL_attached", lift_of_tail), lift_of_tail)):
        raise InputError(f"effect {effect.name} changes more than the pitching moment; {POSSIBLE}")
    if not np.any(moment):
        raise InputError(f"effect {effect.name} makes no moment in this record; what it acts through does not move")
    return moment
