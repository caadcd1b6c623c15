"""Health of each channel by itself and against the others, before anything is computed from it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence

from bayes_aero.flight.card import Card
from bayes_aero.flight.health.air import across, air_data, derivatives, in_flight, on_ground
from bayes_aero.flight.health.channel import dropouts, frozen, held, idle, quantised, saturated, wrapped
from bayes_aero.flight.health.controls import control_responses, feedback
from bayes_aero.flight.health.finding import HealthFinding, decided, different_rates, same_records, short
from bayes_aero.flight.health.refuted import refuted
from bayes_aero.flight.record import FlightRecord

__all__ = ["HealthFinding", "channel_health"]

_CHECKS: tuple[Callable[[FlightRecord, Card], Iterable[HealthFinding]], ...] = (
    air_data, across, derivatives, dropouts, frozen, held, saturated, quantised, wrapped, short, idle, decided,
)  # fmt: skip


def channel_health(records: Sequence[FlightRecord], card: Card) -> tuple[HealthFinding, ...]:
    """Everything that is wrong with records by themselves, one finding a fault; grave findings first."""
    said: list[HealthFinding] = []
    for record in records:
        flown = in_flight(record, card)
        misread, read = refuted(flown, card)
        others = [finding for check in _CHECKS for finding in check(flown, card)]
        findings = _without_consequences([*misread, *others, *control_responses(read, card)])
        if not any(f.channel == "airspeed" and f.fault in ("unit", "airspeed_kind", "factor") for f in findings):
            said += on_ground(record, card)
        said += findings
    said += [*same_records(records), *different_rates(records), *feedback(records, card)]
    return tuple(sorted(said, key=lambda finding: not finding.grave))


def _without_consequences(said: list[HealthFinding]) -> list[HealthFinding]:
    """Each fault of a channel once, without what follows from another one. A dropout looks like a flat stretch, too, at
    an end of the channel's range; a density or airspeed in another unit makes level flight impossible as well."""
    dropped = {finding.channel for finding in said if finding.fault == "dropout"}
    said = [f for f in said if not (f.fault in ("frozen", "saturated", "quantised") and f.channel in dropped)]
    units, first = [f for f in said if f.fault == "unit"], {}
    for finding in units:
        first.setdefault(finding.channel, finding)
    blamed = {f.channel for f in said if f.fault in ("unit", "airspeed_kind", "density", "factor") and f.grave}
    return [
        f
        for f in said
        if not (f.fault == "unit" and first[f.channel] is not f)
        and not (f.fault == "load" and blamed & {"density", "airspeed", "dynamic_pressure", "static_pressure"})
    ]
