"""Channels of a trajectory: what it is compared with, and what none can be without. Without JAX, for light commands."""

from __future__ import annotations

from collections.abc import Collection, Mapping

from bayes_aero.flight.axes import Axis

FLIGHT = ("airspeed", "alpha", "theta", "q")
RIGID = ("airspeed", "alpha", "beta", "p", "q", "r")
FORCES: Mapping[Axis, tuple[str, ...]] = {Axis.LONGITUDINAL: ("ax", "az"), Axis.LATERAL: ("ay",)}

OF_AXIS: Mapping[Axis, tuple[str, ...]] = {
    Axis.LONGITUDINAL: FLIGHT,
    Axis.LATERAL: tuple(dict.fromkeys((*FLIGHT, *RIGID, "phi"))),
}
"""Channels without which the motion of an axis cannot be flown."""


def needed_channels(axes: Collection[Axis]) -> tuple[str, ...]:
    """Channels without which no aircraft is flown whose model has these axes: where it begins, and given forces."""
    if Axis.LATERAL not in axes:
        return (*FLIGHT, "thrust", "density")
    forces = () if Axis.LONGITUDINAL in axes else FORCES[Axis.LONGITUDINAL]
    return (*RIGID, "phi", "theta", *forces, "thrust", "density")
