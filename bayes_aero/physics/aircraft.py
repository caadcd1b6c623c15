"""The aircraft as constants, its axes and the names of their coefficients, and the standard atmosphere."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field, fields
from enum import StrEnum
from typing import Any

import numpy as np
from jaxtyping import Float

from bayes_aero.arrays import AnyArray, xp
from bayes_aero.units import number

# --- International Standard Atmosphere (ISO 2533:1975).

GRAVITY = 9.80665  # m/s2
GAS, GAMMA = 287.05287, 1.4  # J/(kg K) and ratio of the specific heats, of dry air
_T0, _LAPSE, _P0 = 288.15, 0.0065, 101325.0
_TOP, _HIGHEST = 11_000.0, 25_000.0  # m, of the troposphere and of what is asked here


def air(altitude: Float[AnyArray, "*#n"]) -> tuple[Float[AnyArray, "*#n"], Float[AnyArray, "*#n"]]:
    """Density (kg/m3) and speed of sound (m/s) of the troposphere at geopotential altitude (m), 0 to 11 km."""
    temperature = _T0 - _LAPSE * altitude
    pressure = _P0 * (temperature / _T0) ** (GRAVITY / (_LAPSE * GAS))
    return pressure / (GAS * temperature), xp.sqrt(GAMMA * GAS * temperature)


def standard_air(altitude: Float[np.ndarray, " n"]) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """As `air`, from -1 to 25 km; beyond 11 km the isothermal layer (to 20 km; the 5 km above are colder by 5 K)."""
    h = np.clip(altitude, -1000.0, _HIGHEST)
    density, sound = air(np.minimum(h, _TOP))
    return density * np.exp(-GRAVITY * np.maximum(h - _TOP, 0.0) / (GAS * (_T0 - _LAPSE * _TOP))), sound


def altitude_of_density(density: float) -> float:
    """Geopotential altitude (m) at which the standard atmosphere has this density (kg/m3): the inverse of `air`."""
    share = density / (_P0 / (GAS * _T0))
    return _T0 / _LAPSE * (1.0 - share ** (1.0 / (GRAVITY / (_LAPSE * GAS) - 1.0)))


# --- The aircraft as constants: mass, inertia, geometry, positions of sensors and engines.

Scalar = float | Float[AnyArray, ""]
Position = tuple[Scalar, Scalar, Scalar]


@dataclass(frozen=True)
class Aircraft:
    """Constants in SI; positions are from the centre of gravity in body axes (x forward, y right, z down).

    `reference_point`: of the moments; `engine`: where the total net thrust acts, inclined upward by
    `engine_inclination`; `tail_arm`: from the CG to the tailplane; `engine_arm`: of a left and a right engine from the
    plane of symmetry, which yaw the aircraft where `thrust_left` and `thrust_right` are recorded. `reference_speed`,
    `rate_length`, `lateral_rate_length`: how rates are made free of units; `lateral_length`: the length of Cl and Cn.
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


_NOT_METRES = dict.fromkeys(("Ix", "Iy", "Iz", "Ixz", "Ixy", "Iyz"), "kg m^2") | {
    "mass": "kg", "wing_area": "m^2", "aspect_ratio": "1", "engine_inclination": "rad", "reference_speed": "m/s",
}  # fmt: skip
AIRCRAFT_UNITS: dict[str, str] = {each.name: _NOT_METRES.get(each.name, "m") for each in fields(Aircraft)}
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
    """Least and greatest value of each quantity of an envelope during a flight, SI; the load factor is -az/g."""
    quantities = {name: np.asarray(flight[name]) for name in ("alpha", "beta", "phi", "airspeed") if name in flight}
    if "az" in flight:
        quantities["load_factor"] = -np.asarray(flight["az"]) / GRAVITY
    if "altitude" in flight:
        quantities["altitude_loss"] = np.asarray(flight["altitude"])[0] - np.asarray(flight["altitude"])
    return {name: (float(np.min(x)), float(np.max(x))) for name, x in quantities.items()}


# --- The coefficients' names by axis, and the channels that they are formed from (see `coefficients`).


class Axis(StrEnum):
    """The plane of symmetry (CL, CD, Cm) or out of it (CY, Cl, Cn)."""

    LONGITUDINAL = "longitudinal"
    LATERAL = "lateral"


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


# --- Channels of a trajectory: outputs, and channels that every simulation needs.

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
