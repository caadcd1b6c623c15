"""Do the sensors agree? The flight path alone, before any aerodynamics."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np

from bayes_aero.criticism.candidates import Field, field_of
from bayes_aero.criticism.diagnosis import SENSOR_KINDS
from bayes_aero.criticism.extension import Extension, extend
from bayes_aero.criticism.responses import Responses
from bayes_aero.criticism.state import linearised
from bayes_aero.flight.card import Card
from bayes_aero.flight.record import FlightRecord
from bayes_aero.model.flights import despiked, join
from bayes_aero.model.model import Model
from bayes_aero.model.own_effects import own_effects
from bayes_aero.physics.coefficients import REQUIRED
from bayes_aero.physics.flightpath import PATH, PATH_NEEDS

UNITY = {"density": 1.0, "thrust": 0.0}  # stand in for what the flight path does not use


def compatibility(records: list[FlightRecord], card: Card, *, seed: int = 0, most: int = 8) -> Extension:
    """Sensor errors and winds that the flight path asks for, as the first stage of a diagnosis finds them.

    Raises `InputError` where a channel of `PATH_NEEDS` is missing or a single manoeuvre is too short.
    """
    flights, _ = despiked(join(records, card, PATH_NEEDS))
    extra = {name: jnp.full(flights.n, UNITY[name]) for name in REQUIRED if name not in flights.channels}
    flights = type(flights)(
        flights.channels | extra, flights.aircraft, flights.manoeuvre, flights.time, flights.lengths, flights.names
    )
    whole = field_of(Model((), ()), flights, tuple(own_effects(card.effect_files).values()))
    sensors = tuple(e for e in whole.candidates if e.kind in SENSOR_KINDS)
    model = Model(sensors, tuple(p for e in sensors for p in e.parameters))
    field = Field(model, (), sensors, {})
    theta = np.array([field.neutral[name] for name in model.names])
    return extend(linearised(field, Responses.of(flights, model), PATH, theta), seed=seed, most=most)
