"""The standard inputs in six degrees of freedom, and those of the lateral axis, from straight level flight."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from bayes_aero.dynamics.simulated.manoeuvres import (
    ANYWHERE,
    RUN_IN,
    SECONDS,
    Series,
    StandardFlights,
    commands,
    multisine_inputs,
    pulses,
    rounded,
    stall_rise,
    steps,
    until,
)
from bayes_aero.dynamics.simulated.plant import SIGNALS, refuse_unsimulated
from bayes_aero.dynamics.simulated.rigid_pilot import fly_rigid
from bayes_aero.dynamics.simulated.rigid_trim import Condition, RigidTrim, rigid_trim
from bayes_aero.dynamics.simulated.simulate import Pilot
from bayes_aero.dynamics.simulated.trim import Trim
from bayes_aero.flight.aircraft import Aircraft
from bayes_aero.flight.envelope import Envelope, excursion
from bayes_aero.model.model import Model

LATERAL = ("aileron_doublet", "rudder_doublet", "stall_with_bank", "engine_steps")
REFERENCE_SIDESLIP = 0.05  # rad, of the steady sideslip that gives the bank per sideslip
AILERON, RUDDER = np.deg2rad(5.0), np.deg2rad(3.0)  # amplitudes of a transport in a flight test; our choice
BANK, UNEVEN = np.deg2rad(15.0), 0.3  # in the stall; of the left engine's thrust less the right one's over their sum
LATERAL_EXCITED_CHANNELS = {
    "aileron_doublet": "aileron", "rudder_doublet": "rudder", "engine_steps": "thrust_left", "multisine": "aileron",
}  # fmt: skip
"""Channels that each manoeuvre excites, in addition to `manoeuvres.EXCITED_CHANNELS`."""


def rigid_pilots(
    model: Model,
    values: Mapping[str, Any],
    aircraft: Aircraft,
    time: Series,
    airspeed: float,
    altitude: float,
    amplitude: float = 1.0,
) -> tuple[dict[str, Pilot], RigidTrim]:
    """The pilot of each manoeuvre, and the level flight in which all start; arguments as `standard_pilots`."""
    trim = rigid_trim(model, values, aircraft, Condition(airspeed, altitude))
    sideslipping = rigid_trim(model, values, aircraft, Condition(airspeed, altitude, sideslip=REFERENCE_SIDESLIP))
    bank_per_sideslip = (sideslipping.state["phi"] - trim.state["phi"]) / REFERENCE_SIDESLIP
    level = Trim(trim.state["alpha"], trim.thrust, 0.0)
    pilots = commands(time, level, stall_rise(model, values, level.alpha), bank_per_sideslip, amplitude)
    return pilots | lateral_commands(time, level, pilots["slow_stall"], amplitude), trim


def lateral_commands(time: Series, trim: Trim, stalling: Pilot, amplitude: float = 1.0) -> dict[str, Pilot]:
    """Doublets of aileron and rudder, multisines of these and the elevator, a stall in banked flight, unequal
    engines."""
    dt = float(time[1] - time[0])

    def doublets(size: float) -> Series:
        parts = []
        for begin, unit in ((5.0, 1.0), (20.0, 2.0), (40.0, 1.0)):
            parts += steps((begin, size), (begin + unit, -size), (begin + 2.0 * unit, 0.0))
        return rounded(amplitude * pulses(time, parts), 0.4, dt)

    def held(smooth: float, *points: tuple[float, float]) -> Series:
        return rounded(amplitude * pulses(time, steps(*points)), smooth, dt)

    zeros, (elevator, aileron, rudder) = np.zeros_like(time), amplitude * multisine_inputs(time, 3)
    level = Pilot(trim.alpha + zeros, trim.thrust + zeros, alpha_gain=0.05, rate_gain=0.0)
    return {
        "aileron_doublet": level._replace(aileron=doublets(AILERON)),
        "rudder_doublet": level._replace(rudder=doublets(RUDDER)),
        "multisine": level._replace(
            excitation=np.deg2rad(2.0) * elevator, aileron=AILERON * aileron, rudder=RUDDER * rudder
        ),
        "stall_with_bank": stalling._replace(phi=held(4.0, (10.0, BANK), (25.0, -BANK), (41.0, BANK), (52.0, 0.0))),
        "engine_steps": level._replace(uneven=held(1.5, (5.0, UNEVEN), (20.0, -UNEVEN), (35.0, UNEVEN), (50.0, 0.0))),
    }


def fly_rigid_standard(
    model: Model,
    values: Mapping[str, Any],
    aircraft: Aircraft,
    *,
    airspeed: float,
    altitude: float,
    dt: float,
    amplitude: float = 1.0,
    envelope: Envelope = ANYWHERE,
) -> StandardFlights:
    """As `fly_standard`, in six degrees of freedom: a model of both axes, and the manoeuvres of `LATERAL` as well."""
    for effect in model.acting:
        refuse_unsimulated(effect, SIGNALS | {"aileron", "thrust_left", "thrust_right"})
    n, before = round(SECONDS / dt) + 1, round(RUN_IN / dt)
    time = (np.arange(n + before) - before) * dt
    pilots, trim = rigid_pilots(model, values, aircraft, time, airspeed, altitude, amplitude)
    flown, refused = {}, {}
    for name, pilot in pilots.items():
        flight = fly_rigid(model, values, aircraft, pilot, trim, dt)
        channels = {key: x[before:] for key, x in flight.items() if np.ndim(x) == 1}
        if left := envelope.left_by(excursion(channels)):
            refused[name] = f"it leaves its envelope: {left}"
        else:
            flown[name] = channels | {"aileron_left": -channels["aileron"], "aileron_right": channels["aileron"]}
    return StandardFlights(flown, {name: until(pilots[name], time) for name in flown}, refused)
