"""How far a simulation may be from flight: bands by output, each with its source. A card may replace them."""

from __future__ import annotations

import math
from collections.abc import Mapping
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


@dataclass(frozen=True)
class Limit:
    """The larger of a fixed difference (SI) and a share of the recorded quantity is permitted."""

    fixed: float = 0.0
    share: float = 0.0

    def of(self, measured: float) -> float:
        """The difference permitted, SI."""
        return max(self.fixed, self.share * abs(measured))


@dataclass(frozen=True)
class ObjectiveTest:
    """A test of one property of the motion: its entry and title, limits by quantity, and where they come from.

    A quantity without a limit must have the recorded direction. Of damping ratio and time to half or double amplitude
    one suffices.
    """

    entry: str
    title: str
    limits: Mapping[str, Limit]
    source: str

    @property
    def name(self) -> str:
        """Entry and title."""
        return f"{self.entry} {self.title}"


_A2A = "14 CFR Part 60 Appendix A, Table A2A"
_OF_2014 = "read in the edition of 2014, volume 2, page"
DUTCH_ROLL = ObjectiveTest(
    "2.d.7",
    "Dutch roll",
    {
        "period": Limit(0.5, 0.1), "damping ratio": Limit(0.02), "time to half or double": Limit(share=0.1),
        "bank after sideslip": Limit(1.0, 0.2),
    },
    f"{_A2A}, 2.d.7: +-0.5 s or +-10 % of period, +-10 % of time to half or double amplitude or +-0.02 of damping "
    f"ratio, +-20 % or +-1 s of the time between peaks of bank and sideslip, six cycles; {_OF_2014} 58",
)  # fmt: skip
SPIRAL = ObjectiveTest(
    "2.d.4",
    "spiral stability",
    {"bank after 20 s": Limit(math.radians(2.0), 0.1)},
    f"{_A2A}, 2.d.4: correct trend and +-2 deg or +-10 % bank angle in 20 s; {_OF_2014} 58",
)
ROLL_RESPONSE = ObjectiveTest(
    "2.d.2",
    "roll response",
    {"peak roll rate": Limit(math.radians(2.0), 0.1)},
    f"{_A2A}, 2.d.2: +-10 % or +-2 deg/s roll rate; {_OF_2014} 57; compared at its peak, our choice",
)
RUDDER_RESPONSE = ObjectiveTest(
    "2.d.6",
    "rudder response",
    {"peak yaw rate": Limit(math.radians(2.0), 0.1)},
    f"{_A2A}, 2.d.6: +-2 deg/s or +-10 % yaw rate; {_OF_2014} 58; compared at its peak, our choice",
)
SIDESLIP = ObjectiveTest(
    "2.d.8",
    "steady sideslip",
    {"sideslip": Limit(math.radians(1.0)), "bank": Limit(math.radians(2.0))},
    f"{_A2A}, 2.d.8: for given rudder +-2 deg bank, +-1 deg sideslip; {_OF_2014} 59",
)
STALL = ObjectiveTest(
    "2.c.8",
    "stall",
    {"bank before the stall": Limit(math.radians(2.0)), "roll-off": Limit()},
    f"14 CFR Part 60 Appendix B, 2.c.8: +-2 deg bank before stall warning or initial buffet; {_OF_2014} 161. Roll-off: "
    f"its direction; Table A2A, 2.c.8, {_UNCHECKED}",
)
OBJECTIVE_TESTS = (DUTCH_ROLL, SPIRAL, ROLL_RESPONSE, RUDDER_RESPONSE, SIDESLIP, STALL)
"""Of the lateral motion."""
