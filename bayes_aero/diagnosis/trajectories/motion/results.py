"""Modes of motion of a fitted model, and what objective tests say of its free and commanded responses."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

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
class Compared:
    """One quantity of an objective test, as recorded and as simulated, in SI.

    Attributes:
        manoeuvre: name.
        entry: of the table of objective tests.
        test: its title.
        quantity: what is compared.
        unit: SI unit.
        measured: from the record, and its standard error (NaN where there is none).
        simulated: the same way from the simulated trajectory.
        limit: largest difference permitted; NaN where the test has no number.
        within: whether the test is met.
        remark: what the manoeuvre lacks of the test, or how it was met.
    """

    manoeuvre: str
    entry: str
    test: str
    quantity: str
    unit: str
    measured: tuple[float, float]
    simulated: float
    limit: float
    within: bool
    remark: str = ""


@dataclass(frozen=True)
class Motion:
    """Modes about straight level flight (airspeed m/s, altitude m; NaN of linear cards), and objective tests.

    `filtered`: the modes are of the estimates with process noise, not of output error. `why_not` says why there are no
    modes. `untested` has, by test and reason, the manoeuvres that cannot show it.
    """

    airspeed: float
    altitude: float
    modes: tuple[FlownMode, ...] = ()
    why_not: str = ""
    tests: tuple[Compared, ...] = ()
    untested: Mapping[str, Mapping[str, tuple[str, ...]]] = field(default_factory=dict)
    sources: Mapping[str, str] = field(default_factory=dict)
    filtered: bool = False
