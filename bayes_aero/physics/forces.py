"""Forces and moments from coefficients; the inverse of `coefficients`.

Source: Klein and Morelli, *Aircraft System Identification*, 2006, ch. 3.
"""

from __future__ import annotations

from collections.abc import Mapping

import jax.numpy as jnp

from bayes_aero.arrays import Samples
from bayes_aero.flight.aircraft import Aircraft
from bayes_aero.physics.frames import body_from_lift_drag


def thrust_components(thrust: Samples, aircraft: Aircraft) -> tuple[Samples, Samples]:
    """Thrust along body x and z, N."""
    return thrust * jnp.cos(aircraft.engine_inclination), -thrust * jnp.sin(aircraft.engine_inclination)


def engine_moments(signals: Mapping[str, Samples], aircraft: Aircraft) -> tuple[Samples, Samples]:
    """Moments (N m) about body x and z of a left and a right engine `engine_arm` off the plane of symmetry.

    None where `thrust_left` and `thrust_right` (N) were not both recorded.
    """
    if "thrust_left" not in signals or "thrust_right" not in signals:
        nothing = jnp.zeros_like(signals["thrust"])
        return nothing, nothing
    along, down = thrust_components(signals["thrust_left"] - signals["thrust_right"], aircraft)
    return -aircraft.engine_arm * down, aircraft.engine_arm * along


def specific_force(
    CL: Samples, CD: Samples, alpha: Samples, pressure: Samples, thrust: Samples, aircraft: Aircraft
) -> tuple[Samples, Samples]:
    """Aerodynamics and thrust along body x and z over the mass, m/s2; `pressure` is dynamic, Pa."""
    CX, CZ = body_from_lift_drag(CL, CD, alpha)
    x, z = thrust_components(thrust, aircraft)
    force = pressure * aircraft.wing_area
    return (force * CX + x) / aircraft.mass, (force * CZ + z) / aircraft.mass


def moments(
    flow: Mapping[str, Samples],
    force: tuple[Samples, Samples, Samples],
    signals: Mapping[str, Samples],
    aircraft: Aircraft,
) -> tuple[Samples, Samples, Samples]:
    """Moments of aerodynamics and engines about body x, y and z through the centre of gravity, N m.

    Args:
        flow: Cl, Cm, Cn about the aircraft's reference point.
        force: specific force at the centre of gravity, body axes, m/s2; thrust is taken out of it.
        signals: `airspeed`, `density` and `thrust`, SI, with `thrust_left` and `thrust_right` where known.
        aircraft: with its corrected constants.
    """
    a = aircraft
    area = 0.5 * signals["density"] * jnp.square(signals["airspeed"]) * a.wing_area
    along, down = thrust_components(signals["thrust"], a)
    X, Y, Z = a.mass * force[0] - along, a.mass * force[1], a.mass * force[2] - down
    x, y, z = a.reference_point
    x_engine, y_engine, z_engine = a.engine
    roll, yaw = engine_moments(signals, a)
    L = area * a.moment_length * flow["Cl"] + y * Z - z * Y + y_engine * down + roll
    M = area * a.chord * flow["Cm"] + z * X - x * Z + z_engine * along - x_engine * down
    N = area * a.moment_length * flow["Cn"] + x * Y - y * X - y_engine * along + yaw
    return L, M, N


def lateral_force(CY: Samples, pressure: Samples, aircraft: Aircraft) -> Samples:
    """Aerodynamics along body y over the mass, m/s2; `pressure` is dynamic, Pa."""
    return pressure * aircraft.wing_area * CY / aircraft.mass
