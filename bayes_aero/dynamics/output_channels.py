"""Channels of a trajectory: outputs, and channels that every simulation needs. Without JAX, so that commands start
fast.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping

from bayes_aero.flight.channel import Axis

FLIGHT = ("airspeed", "alpha", "theta", "q")
RIGID = ("airspeed", "alpha", "beta", "p", "q", "r")
FORCES: Mapping[Axis, tuple[str, ...]] = {Axis.LONGITUDINAL: ("ax", "az"), Axis.LATERAL: ("ay",)}

OF_AXIS: Mapping[Axis, tuple[str, ...]] = {  # channels without which the motion of an axis cannot be simulated
    Axis.LONGITUDINAL: FLIGHT,
    Axis.LATERAL: tuple(dict.fromkeys((*FLIGHT, *RIGID, "phi"))),
}


def needed_channels(axes: Collection[Axis]) -> tuple[str, ...]:
    """Channels that a simulation of these axes needs: initial states, and forces of axes without a model."""
    if Axis.LATERAL not in axes:
        return (*FLIGHT, "thrust", "density")
    forces = () if Axis.LONGITUDINAL in axes else FORCES[Axis.LONGITUDINAL]
    return (*RIGID, "phi", "theta", *forces, "thrust", "density")
