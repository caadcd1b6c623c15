"""Sensor errors that a flight-path reconstruction estimates: those of the catalogue that the recorded channels show."""

from __future__ import annotations

from dataclasses import replace

import jax.numpy as jnp

from bayes_aero.dynamics.path.flight_path import PathDynamics, heading, path_states
from bayes_aero.effect import Stage
from bayes_aero.effects import CATALOGUE
from bayes_aero.flight.axes import Axis
from bayes_aero.flight.card.card import Card
from bayes_aero.model.joined_channels import Flights
from bayes_aero.model.model import Model

COMMON = (
    "vane_position", "alpha_scale", "alpha_bias", "alpha_delay", "sideslip_vane_position", "sideslip_vane_height",
    "sideslip_scale", "sideslip_bias", "sideslip_delay", "airspeed_scale", "airspeed_bias", "pitot_pressure_bias",
    "pitch_attitude_bias", "bank_angle_bias",
)  # fmt: skip
"""Errors of an installation, equal in all manoeuvres."""
OWN = (
    "accel_x_bias", "accel_y_bias", "accel_z_bias", "roll_rate_bias", "pitch_rate_bias", "yaw_rate_bias",
    "vertical_wind",
)  # fmt: skip
"""Errors that drift from one manoeuvre to the next, and the wind."""
SHOWN_BY = dict.fromkeys(
    ("sideslip_vane_position", "sideslip_vane_height", "sideslip_scale", "sideslip_bias", "sideslip_delay",
     "accel_y_bias", "yaw_rate_bias"), "beta"
) | {"bank_angle_bias": "phi", "roll_rate_bias": "phi"}  # fmt: skip
"""For errors of lateral sensors, the state that depends on them."""
MARKS = {"dt", "start", "first", "last", "elapsed"}


def path_dynamics(flights: Flights, card: Card) -> tuple[Flights, PathDynamics]:
    """The flight path of these flights with the possible errors of their sensors.

    Effects of the card keep the card's parameters: `vane_position` fixed stays fixed.

    Returns:
        The flights, their heading without jumps of a half or a full turn, and the dynamics.
    """
    states = path_states(flights)
    recorded = {*flights.recorded, *MARKS}
    chosen = [
        name
        for name in (*COMMON, *OWN)
        if set(CATALOGUE[name].channels) <= recorded and SHOWN_BY.get(name, states[0]) in states
    ]
    model = Model.of(chosen, axes=tuple(Axis))  # the path depends on all axes
    if card.linear is None:
        stated = Model.from_card(card)
        errors = [e for e in stated.effects if e.stage is Stage.CHANNEL]
        names = {p.name for e in errors for p in e.parameters}
        known = {p.name: p for p in stated.parameters if p.name in names}
        model = Model.of(
            (*errors, *(e for e in model.effects if e not in errors)),
            {name: value for name, value in stated.fixed if name in names},
            model.axes,
        )
        model = replace(model, parameters=tuple(known.get(p.name, p) for p in model.parameters))
    own = tuple(p.name for name in OWN if name in chosen for p in CATALOGUE[name].parameters)
    if "psi" in states:
        turned = flights.channels | {"psi": jnp.asarray(heading(flights))}
        flights = Flights(turned, flights.aircraft, flights.manoeuvre, flights.time, flights.lengths, flights.names)
    return flights, PathDynamics(model, states, flights.lengths, own)
