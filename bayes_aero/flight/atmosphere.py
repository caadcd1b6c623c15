"""International Standard Atmosphere (ISO 2533:1975)."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from bayes_aero.arrays import AnyArray, xp

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
