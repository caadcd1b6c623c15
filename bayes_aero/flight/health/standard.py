"""The standard atmosphere in numbers, for what recorded air data are held against."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from bayes_aero.flight.tolerances import GRAVITY

GAS, GAMMA = 287.05287, 1.4  # J/(kg K) and ratio of the specific heats, of dry air
_T0, _P0, _LAPSE, _TOP, _HIGHEST = 288.15, 101325.0, 0.0065, 11_000.0, 25_000.0


def standard_air(altitude: Float[np.ndarray, " n"]) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Density (kg/m3) and speed of sound (m/s) at geopotential altitude (m), -1 to 25 km.

    Source: ISO 2533:1975, troposphere and isothermal layer (to 20 km; the 5 km above are colder by 5 K than taken).
    """
    h = np.clip(altitude, -1000.0, _HIGHEST)
    T = _T0 - _LAPSE * np.minimum(h, _TOP)
    pressure = _P0 * (T / _T0) ** (GRAVITY / (_LAPSE * GAS))
    pressure = pressure * np.exp(-GRAVITY * np.maximum(h - _TOP, 0.0) / (GAS * T))
    return pressure / (GAS * T), np.sqrt(GAMMA * GAS * T)
