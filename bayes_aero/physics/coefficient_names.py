"""The coefficients' names by axis, and the channels that they are formed from (see `coefficients`)."""

from __future__ import annotations

from collections.abc import Iterable

from bayes_aero.flight.channel import Axis

NAMES = ("CL", "CD", "Cm")
REQUIRED = ("ax", "az", "p", "q", "r", "alpha", "airspeed", "density", "thrust")
LATERAL = ("CY", "Cl", "Cn")
COEFFICIENTS: dict[Axis, tuple[str, ...]] = {Axis.LONGITUDINAL: NAMES, Axis.LATERAL: LATERAL}
FORMED_FROM: dict[Axis, tuple[str, ...]] = {Axis.LONGITUDINAL: REQUIRED, Axis.LATERAL: (*REQUIRED, "ay", "beta")}


def coefficients_of(axes: Iterable[Axis]) -> tuple[str, ...]:
    """Names of the coefficients of these axes, the longitudinal ones first."""
    chosen = set(axes)
    return tuple(name for axis, names in COEFFICIENTS.items() if axis in chosen for name in names)


def required_of(axes: Iterable[Axis]) -> tuple[str, ...]:
    """Channels that the coefficients of these axes are formed from."""
    chosen = set(axes)
    return tuple(dict.fromkeys(c for axis, names in FORMED_FROM.items() if axis in chosen for c in names))
