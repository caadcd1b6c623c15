"""The aircraft as constants: mass, inertia, geometry, positions of sensors and engines."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from jaxtyping import Float

from bayes_aero.arrays import AnyArray
from bayes_aero.flight.atmosphere import GRAVITY
from bayes_aero.units import number

Scalar = float | Float[AnyArray, ""]
Position = tuple[Scalar, Scalar, Scalar]


@dataclass(frozen=True)
class Aircraft:
    """Constants in SI; positions are from the centre of gravity in body axes (x forward, y right, z down).

    `reference_point` is where the pitching moment is referred to; `engine` is the point at which the total net
    thrust acts, inclined upward by `engine_inclination`; `tail_arm` is the distance from the CG to the tailplane.
    `engine_arm` is the distance of a left and a right engine from the plane of symmetry, which yaw the aircraft where
    `thrust_left` and `thrust_right` are recorded. `reference_speed`, `rate_length` and `lateral_rate_length` say how
    rates and speeds are made free of units (see `physics.rates`); `lateral_length` is the length of Cl and Cn. Compiled
    programs take it apart: see `model.pytrees`.
    """

    mass: Scalar  # kg
    Ix: Scalar  # kg m2
    Iy: Scalar  # kg m2
    Iz: Scalar  # kg m2
    Ixz: Scalar  # kg m2
    wing_area: Scalar  # m2
    chord: Scalar  # m
    half_span: Scalar  # m
    aspect_ratio: Scalar  # -
    tail_arm: Scalar  # m
    reference_point: Position = (0.0, 0.0, 0.0)  # m
    accelerometer: Position = (0.0, 0.0, 0.0)  # m
    engine: Position = (0.0, 0.0, 0.0)  # m
    engine_inclination: Scalar = 0.0  # rad
    reference_speed: Scalar | None = None  # m/s; None: the airspeed of the moment
    rate_length: Scalar | None = None  # m; None: the chord
    lateral_length: Scalar | None = None  # m; None: the span
    lateral_rate_length: Scalar | None = None  # m; None: half the span
    engine_arm: Scalar = 0.0  # m
    Ixy: Scalar = 0.0  # kg m2
    Iyz: Scalar = 0.0  # kg m2

    @property
    def moment_length(self) -> Scalar:
        """Length of rolling and yawing moment coefficients, m."""
        return 2.0 * self.half_span if self.lateral_length is None else self.lateral_length


AIRCRAFT_UNITS: dict[str, str] = {
    "mass": "kg",
    **dict.fromkeys(("Ix", "Iy", "Iz", "Ixz"), "kg m^2"),
    "wing_area": "m^2",
    **dict.fromkeys(("chord", "half_span"), "m"),
    "aspect_ratio": "1",
    **dict.fromkeys(("tail_arm", "reference_point", "accelerometer", "engine"), "m"),
    "engine_inclination": "rad",
    "reference_speed": "m/s",
    **dict.fromkeys(("rate_length", "lateral_length", "lateral_rate_length", "engine_arm"), "m"),
    **dict.fromkeys(("Ixy", "Iyz"), "kg m^2"),
}
AIRCRAFT_KEYS: dict[str, str] = {**AIRCRAFT_UNITS, "span": "m"}
"""Keys of a card's [aircraft]: the constants, and the span in place of half of it."""
OPTIONAL = (  # the aspect ratio is the span squared over the wing area where it is not stated
    "aspect_ratio", "reference_point", "accelerometer", "engine", "engine_inclination", "reference_speed",
    "rate_length", "lateral_length", "lateral_rate_length", "engine_arm", "Ixy", "Iyz",
)  # fmt: skip

_NAN = float("nan")
NO_AIRCRAFT = Aircraft(_NAN, _NAN, _NAN, _NAN, _NAN, _NAN, _NAN, _NAN, _NAN, _NAN)
"""Stands on cards that state none: whatever is computed from it is not a number."""


# --- The ranges inside which a flight test is proposed.

UNITS = {
    "alpha": "rad", "beta": "rad", "phi": "rad", "airspeed": "m/s", "load_factor": "1", "altitude_loss": "m",
}  # fmt: skip
DEFAULT_RANGES = {
    "alpha": (-0.1, 0.45),
    "beta": (-0.35, 0.35),
    "phi": (-1.2, 1.2),
    "airspeed": (15.0, 300.0),
    "load_factor": (0.0, 2.5),  # 14 CFR 25.337(b): the least limit load factor of a transport; the others: our choice
    "altitude_loss": (-np.inf, 1500.0),
}


@dataclass(frozen=True)
class Envelope:
    """Least and greatest value of each quantity, SI; `stated`: by the card, of these quantities. `programmed_inputs`:
    the aircraft can fly inputs that a computer gives, such as multisines."""

    ranges: Mapping[str, tuple[float, float]] = field(default_factory=lambda: dict(DEFAULT_RANGES))
    stated: tuple[str, ...] = ()
    programmed_inputs: bool = False

    def left_by(self, excursion: Mapping[str, tuple[float, float]]) -> str | None:
        """The first quantity outside its range, in words; None where all are inside."""
        for name, (lower, upper) in self.ranges.items():
            if name not in excursion:
                continue
            least, most = excursion[name]
            if not (np.isfinite(least) and np.isfinite(most) and least >= lower and most <= upper):
                return f"{name} {number(least)} to {number(most)} (allowed {number(lower)} to {number(upper)})"
        return None


def excursion(flight: Mapping[str, Any]) -> dict[str, tuple[float, float]]:
    """Least and greatest value of each quantity of an envelope during a flight of these channels, SI. The load factor
    is -az/g, of the specific force along the body's z axis."""
    found = {name: np.asarray(flight[name]) for name in ("alpha", "beta", "phi", "airspeed") if name in flight}
    if "az" in flight:
        found["load_factor"] = -np.asarray(flight["az"]) / GRAVITY
    if "altitude" in flight:
        found["altitude_loss"] = np.asarray(flight["altitude"])[0] - np.asarray(flight["altitude"])
    return {name: (float(np.min(x)), float(np.max(x))) for name, x in found.items()}
