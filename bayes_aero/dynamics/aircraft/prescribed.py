"""Prescribed motion of an aircraft as recorded, and the outputs of its simulation."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence

import jax.numpy as jnp
from jaxtyping import Array

from bayes_aero.dynamics.aircraft.longitudinal import LATERAL
from bayes_aero.dynamics.aircraft.rigid_body import ANGLES
from bayes_aero.dynamics.output_channels import FORCES, RIGID
from bayes_aero.flight.axes import Axis
from bayes_aero.model.joined_channels import Flights
from bayes_aero.physics.filters import differentiate, smooth
from bayes_aero.physics.kinematics import RATES, Rotation, lever_arm

SIDE = ("p", "r", "beta", "phi")  # the lateral force follows from these where no accelerometer measures it
ENGINES = ("thrust", "thrust_left", "thrust_right")


def lateral_drives(inputs: Sequence[str], channels: Mapping[str, Array], flights: Flights) -> dict[str, Array]:
    """Inputs of longitudinal motion: recorded channels, angular accelerations p_dot and r_dot, the speed of sound."""
    found = {name: channels[name] for name in (*inputs, *LATERAL, "thrust", "density") if name in channels}
    for name in ("p", "r"):
        if name in channels:
            found[f"{name}_dot"] = _slope(channels[name], flights)
    return found | _side(channels, flights) | _sound(channels)


def rigid_drives(
    axes: Collection[Axis],
    held: Sequence[str],
    inputs: Sequence[str],
    channels: Mapping[str, Array],
    flights: Flights,
) -> dict[str, Array]:
    """Inputs of a rigid body: recorded channels, held states with their rates, forces of axes without a model."""
    found = {name: channels[name] for name in (*inputs, *ENGINES, "density") if name in channels}
    sloped = [n for n in (*RATES, "alpha") if n in held and n in channels]
    found |= {f"{name}_dot": _slope(channels[name], flights) for name in sloped}
    if Axis.LONGITUDINAL not in axes:
        rates = [channels[name] for name in RATES]
        turning = Rotation(*rates, *(_slope(x, flights) for x in rates))
        arm = lever_arm(turning, flights.aircraft.accelerometer)
        found |= {"force_x": channels["ax"] - arm[0], "force_z": channels["az"] - arm[2]}
    if Axis.LATERAL not in axes:
        found |= {"ay": channels["ay"]} if "ay" in channels else {}
        found |= _side(channels, flights)
    turns = {f"near_{n}": channels[n] for n in ("phi", "psi") if n in channels and n not in held}
    return found | turns | _sound(channels)


def rigid_outputs(axes: Collection[Axis], start: Collection[str]) -> tuple[str, ...]:
    """Outputs of a rigid body: simulated states, and accelerations of the modelled axes."""
    forces = {name for axis, names in FORCES.items() if axis in axes for name in names}
    simulated = (n for n in (*RIGID, *ANGLES, "altitude") if n in start)
    return (*simulated, *(n for n in ("ax", "ay", "az") if n in forces))


def _side(channels: Mapping[str, Array], flights: Flights) -> dict[str, Array]:
    """The rate of sideslip, where the lateral force follows from it."""
    if "ay" in channels or not all(name in channels for name in SIDE):
        return {}
    return {"beta_dot": _slope(channels["beta"], flights)}


def _sound(channels: Mapping[str, Array]) -> dict[str, Array]:
    """The speed of sound where Mach was recorded."""
    return {"sound": channels["airspeed"] / channels["mach"]} if {"mach", "airspeed"} <= set(channels) else {}


def _slope(x: Array, flights: Flights) -> Array:
    """Derivative of the smoothed channel, manoeuvre by manoeuvre."""
    begin, parts = 0, []
    for length in flights.lengths:
        part = slice(begin, begin + length)
        parts.append(differentiate(smooth(x[part]), flights.channels["dt"][begin]))
        begin += length
    return jnp.concatenate(parts)
