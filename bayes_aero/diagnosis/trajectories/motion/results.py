"""Modes of motion of a fitted model."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

HALF = math.log(2.0)


@dataclass(frozen=True)
class FlownMode:
    """A mode with its uncertainty.

    Attributes:
        name: short period, phugoid, Dutch roll, roll, spiral; other where no name fits.
        eigenvalue: 1/s; of a pair the one of positive imaginary part.
        sd: standard errors of its real and imaginary part, 1/s.
        quantities: period, time_constant, time_to_half and time_to_double in s, damping_ratio; each with its standard
            error. What the data do not tell apart from none is left out.
    """

    name: str
    eigenvalue: complex
    sd: tuple[float, float]
    quantities: Mapping[str, tuple[float, float]]


@dataclass(frozen=True)
class Motion:
    """Modes about straight level flight (airspeed m/s, altitude m; NaN of linear cards).

    `filtered`: the modes are of the estimates with process noise, not of output error. `why_not` says why there are no
    modes.
    """

    airspeed: float
    altitude: float
    modes: tuple[FlownMode, ...] = ()
    why_not: str = ""
    filtered: bool = False
