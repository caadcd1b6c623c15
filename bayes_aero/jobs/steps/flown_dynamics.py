"""What a record is flown by: the card's model of effects, its linear system, or its accelerations and rates."""

from __future__ import annotations

from collections.abc import Sequence

from bayes_aero.diagnosis.consistency.sensor_errors import no_flight_path
from bayes_aero.dynamics.flight import Dynamics, aircraft_dynamics, taken_as_zero
from bayes_aero.dynamics.linear import linear_dynamics
from bayes_aero.dynamics.output_channels import FLIGHT
from bayes_aero.dynamics.path.path_sensors import path_dynamics
from bayes_aero.errors import InputError
from bayes_aero.flight.card.card import Card
from bayes_aero.flight.channel import STANDARD_CHANNELS
from bayes_aero.flight.record import FlightRecord
from bayes_aero.jobs.steps.spike_repair import spike_notes
from bayes_aero.model.joined_channels import Flights, despiked, join
from bayes_aero.model.model import Model
from bayes_aero.physics.flightpath import PATH_CORE
from bayes_aero.report.text.phrases import several


def flown_dynamics(
    records: Sequence[FlightRecord], card: Card, outputs: Sequence[str], *, path: bool
) -> tuple[Flights, Dynamics, list[str]]:
    """The records end to end without spikes, what flies them, and what to say of it.

    `path`: the recorded accelerations and rates fly them, not the card's model.
    """
    notes: list[str] = []
    dynamics: Dynamics
    if path:
        flights, spikes = despiked(join(records, card, PATH_CORE))
        if why := no_flight_path(records, card):
            raise InputError(f"the flight path cannot be reconstructed: {why}")
        flights, dynamics = path_dynamics(flights, card)
        unused = "psi" in flights.channels and "psi" not in dynamics.states
        notes += ["The heading is left out: it jumps or stands still, or bank was not recorded."] if unused else []
    elif card.linear is not None:
        flights, spikes = despiked(join(records, card, card.linear.inputs))
        dynamics = linear_dynamics(card, flights.lengths)
    else:
        flights, spikes = despiked(join(records, card, FLIGHT))
        dynamics = aircraft_dynamics(Model.from_card(card), flights, outputs)
        still = taken_as_zero(flights)
        notes += [f"Not recorded, and taken as zero: {several(still)}."] if still else []
        notes += [f"Held to the record: {several(dynamics.prescribed)}."] if dynamics.prescribed else []
    unseen = [n for n in dynamics.start if n not in flights.channels and n in STANDARD_CHANNELS]
    notes += [f"States that were not recorded begin at zero or as fitted: {several(unseen)}."] if unseen else []
    notes += spike_notes(spikes)
    return flights, dynamics, notes
