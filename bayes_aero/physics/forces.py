"""From coefficients to accelerations: what `coefficients` takes apart, put together.

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


def pitch_acceleration(
    CL: Samples,
    CD: Samples,
    Cm: Samples,
    alpha: Samples,
    pressure: Samples,
    thrust: Samples,
    p: Samples,
    r: Samples,
    aircraft: Aircraft,
) -> Samples:
    """q-dot (rad/s2) from the moments of aerodynamics and thrust about the CG and from the terms of p and r (rad/s).

    Cm is about the aircraft's reference point.
    """
    a = aircraft
    CX, CZ = body_from_lift_drag(CL, CD, alpha)
    x, z = thrust_components(thrust, a)
    about_cg = Cm + CX * a.reference_point[2] / a.chord - CZ * a.reference_point[0] / a.chord
    moment = pressure * a.wing_area * a.chord * about_cg + x * a.engine[2] - z * a.engine[0]
    return (moment + (a.Iz - a.Ix) * p * r + a.Ixz * (r * r - p * p)) / a.Iy
