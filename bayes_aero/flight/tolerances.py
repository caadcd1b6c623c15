"""How far a simulation may be from flight: bands by output, each with its source. A card may replace them."""

from __future__ import annotations

import math
from dataclasses import dataclass

KNOT, GRAVITY = 0.514444, 9.80665
_STALL = "14 CFR Part 60 Appendix A, Table A2A, 2.c.8"
_SHORT = "14 CFR Part 60 Appendix A, Table A2A, 2.c.10"
_LATERAL = "14 CFR Part 60 Appendix A, Table A2A, 2.d"
_READ = "read in the edition of 2014, volume 2, page 57"
_UNCHECKED = "not checked against the text"


@dataclass(frozen=True)
class Tolerance:
    """Half the width of a band in SI, and where it comes from."""

    value: float
    source: str


TOLERANCES = {
    "airspeed": Tolerance(3.0 * KNOT, f"{_STALL}, +-3 kt; read in the 2014 edition's 2.c.8 of Appendix B"),
    "alpha": Tolerance(math.radians(2.0), f"{_STALL}, +-2 deg; {_UNCHECKED}"),
    "theta": Tolerance(math.radians(2.0), f"{_STALL}, +-2 deg; {_UNCHECKED}"),
    "q": Tolerance(math.radians(2.0), f"{_SHORT}, +-2 deg/s; {_READ}"),
    "az": Tolerance(0.1 * GRAVITY, f"{_SHORT}, +-0.10 g; {_READ}"),
    "p": Tolerance(math.radians(2.0), f"{_LATERAL}.2 (roll response), +-2 deg/s; {_READ}"),
    "r": Tolerance(math.radians(2.0), f"{_LATERAL}.6 (rudder response), +-2 deg/s; {_READ[:-2]}58"),
    "phi": Tolerance(math.radians(2.0), f"{_LATERAL}.4 (spiral stability), +-2 deg; {_READ[:-2]}58"),
    "beta": Tolerance(math.radians(1.0), f"{_LATERAL}.8 (steady sideslip), +-1 deg; {_READ[:-2]}59"),
}
"""Of the objective tests of a flight simulator's qualification; used as bands on the whole time history."""
