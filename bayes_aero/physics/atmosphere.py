"""International Standard Atmosphere, troposphere (ISO 2533:1975), 0 to 11 km."""

from __future__ import annotations

from jaxtyping import Float

from bayes_aero.arrays import AnyArray, xp

GRAVITY = 9.80665  # m/s2
GAS, GAMMA = 287.05287, 1.4  # J/(kg K) and ratio of the specific heats, of dry air
_T0, _LAPSE, _P0 = 288.15, 0.0065, 101325.0


def air(altitude: Float[AnyArray, "*#n"]) -> tuple[Float[AnyArray, "*#n"], Float[AnyArray, "*#n"]]:
    """Density (kg/m3) and speed of sound (m/s) at geopotential altitude (m)."""
    temperature = _T0 - _LAPSE * altitude
    pressure = _P0 * (temperature / _T0) ** (GRAVITY / (_LAPSE * GAS))
    return pressure / (GAS * temperature), xp.sqrt(GAMMA * GAS * temperature)


def altitude_of_density(density: float) -> float:
    """Geopotential altitude (m) at which the standard atmosphere has this density (kg/m3): the inverse of `air`."""
    share = density / (_P0 / (GAS * _T0))
    return _T0 / _LAPSE * (1.0 - share ** (1.0 / (GRAVITY / (_LAPSE * GAS) - 1.0)))
