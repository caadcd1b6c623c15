"""How far standard manoeuvres, with the present records, tell effects apart."""

from __future__ import annotations

from types import MappingProxyType

from bayes_aero.diagnosis.design import (
    NOT_BY_HAND,
    candidates_of,
    noise_of,
    of_records,
    on_record,
    signals_of,
    worth_of,
)


def deviations(state, effects, flights, sizes=MappingProxyType({})):
    """By manoeuvre, and under "records" of the records alone: deviations of each ordered pair of effects."""
    chosen, noise = candidates_of(state, effects), noise_of(state)
    records = of_records(state, chosen, noise)
    present, own = records.information(), signals_of(records.state, chosen, worth_of(chosen, sizes))
    found = {"records": present.deviations(own)}
    for name, record in flights.flown.items():
        if name not in NOT_BY_HAND:
            there = on_record(state, flights.model, record, flights.theta, chosen, noise)
            found[name] = (present + there.information()).deviations(own)
    return found


def weakest(state, effects, flights, sizes=MappingProxyType({})):
    """The same of the closest pair."""
    return {name: min(of.values()) for name, of in deviations(state, effects, flights, sizes).items()}
