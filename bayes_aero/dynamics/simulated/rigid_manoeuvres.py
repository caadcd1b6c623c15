"""The standard inputs in six degrees of freedom, and those of aileron and rudder, from straight level flight."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from bayes_aero.dynamics.simulated.manoeuvres import Series, commands, pulses, rounded, stall_rise, steps
from bayes_aero.dynamics.simulated.rigid_trim import Condition, RigidTrim, rigid_trim
from bayes_aero.dynamics.simulated.simulate import Pilot
from bayes_aero.dynamics.simulated.trim import Trim
from bayes_aero.flight.aircraft import Aircraft
from bayes_aero.model.model import Model

LATERAL = ("aileron_doublet", "rudder_doublet")
SLIP = 0.05  # rad, at which the bank of a steady sideslip is asked for
AILERON, RUDDER = np.deg2rad(5.0), np.deg2rad(3.0)  # amplitudes of a transport in a flight test; our choice


def rigid_pilots(
    model: Model, values: Mapping[str, Any], aircraft: Aircraft, time: Series, airspeed: float, altitude: float
) -> tuple[dict[str, Pilot], RigidTrim]:
    """Who flies each manoeuvre, and the level flight in which all begin; arguments as `standard_pilots`."""
    trim = rigid_trim(model, values, aircraft, Condition(airspeed, altitude))
    slipping = rigid_trim(model, values, aircraft, Condition(airspeed, altitude, sideslip=SLIP))
    lean = (slipping.state["phi"] - trim.state["phi"]) / SLIP
    level = Trim(trim.state["alpha"], trim.thrust, 0.0)
    pilots = commands(time, level, stall_rise(model, values, level.alpha), lean)
    return pilots | lateral_commands(time, level), trim


def lateral_commands(time: Series, trim: Trim) -> dict[str, Pilot]:
    """Doublets of aileron and rudder, a short one and a long one."""
    dt = float(time[1] - time[0])

    def doublets(size: float) -> Series:
        parts = []
        for begin, unit in ((5.0, 1.0), (20.0, 2.0), (40.0, 1.0)):
            parts += steps((begin, size), (begin + unit, -size), (begin + 2.0 * unit, 0.0))
        return rounded(pulses(time, parts), 0.4, dt)

    still = np.zeros_like(time)
    level = Pilot(trim.alpha + still, trim.thrust + still, alpha_gain=0.05, rate_gain=0.0)
    return {
        "aileron_doublet": level._replace(aileron=doublets(AILERON)),
        "rudder_doublet": level._replace(rudder=doublets(RUDDER)),
    }
